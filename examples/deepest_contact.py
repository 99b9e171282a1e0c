"""Prints the deepest contact of each step of a scene that runs in the same ROS domain."""

from contextlib import suppress

import rclpy
from fracture_collision.msg import ContactConstraintArray
from rclpy.executors import ExternalShutdownException


def on_contacts(contacts: ContactConstraintArray) -> None:
    """Print the contact with the smallest gap, if there is one."""
    if not contacts.gaps:
        return
    deepest = min(range(len(contacts.gaps)), key=contacts.gaps.__getitem__)
    pair = next(i for i, end in enumerate(contacts.pair_begin[1:]) if deepest < end)
    a, b, gap = contacts.fragment_a[pair], contacts.fragment_b[pair], contacts.gaps[deepest]
    print(f"step {contacts.step}: fragments {a} and {b}, gap {1e3 * gap:.3f} mm", flush=True)


if __name__ == "__main__":
    with suppress(KeyboardInterrupt, ExternalShutdownException):  # SIGINT, SIGTERM
        rclpy.init()
        node = rclpy.create_node("deepest_contact")
        node.create_subscription(ContactConstraintArray, "contact_constraints", on_contacts, 10)
        rclpy.spin(node)
