"""Breaks a custom body in two and prints the contacts between its halves and the floor.

Start `collision_node` in the same ROS domain, then this file. It publishes all that the service needs from a simulator.
"""

import sys
import time
from array import array

import numpy as np
import rclpy
from fracture_collision.msg import CollisionBody, ContactConstraintArray, FractureEvent, FragmentStates
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile

from fracture_collision.geometry.generators import brick
from fracture_collision.geometry.tetrahedra import unique_edges

# Bodies and events are latched for late joiners: a restarted service receives the whole run from them.
LATCHED = QoSProfile(history=HistoryPolicy.KEEP_ALL, durability=DurabilityPolicy.TRANSIENT_LOCAL)
RUN_ID = time.time_ns()  # a new number is a new scene: the service discards the last one
BAR, FLOOR = 1, 2  # bodies
WHOLE, GROUND, LEFT, RIGHT = 1, 2, 3, 4  # fragments: ids are never reused


def floats(values) -> array:
    """Numbers of any shape as the flat array.array of a float64[] field."""
    return array("d", np.asarray(values, np.float64).tobytes())  # much faster than a list


def indices(values) -> array:
    """Whole numbers >= 0 of any shape as the flat array.array of a uint32[] field."""
    return array("I", np.asarray(values, np.uint32).tobytes())


# A bar of 40 x 10 x 10 cm about the origin of its own frame, as tetrahedra. Any tetrahedral mesh will do.
mesh = brick((0.4, 0.1, 0.1), 0.05)
bar = CollisionBody(run_id=RUN_ID, sequence=1, body_id=BAR, fragment_id=WHOLE, name="bar", density=2400.0, friction=0.5)
bar.header.frame_id = "world"
bar.vertices, bar.tetrahedra = floats(mesh.vertices), indices(mesh.tetrahedra)

floor = CollisionBody(run_id=RUN_ID, sequence=2, body_id=FLOOR, fragment_id=GROUND, name="floor", is_static=True)
floor.header.frame_id = "world"
floor.density, floor.friction = 2400.0, 0.5
floor.plane.coef = np.array([0.0, 0.0, 1.0, 0.0])  # solid where z < 0

# It breaks in the plane x = 1 cm. Each node is assigned to a fragment. Each edge between two fragments has the plane
# that cuts it: its unit normal, from the edge's first node to its second, and its offset.
CUT = 0.01
is_right = mesh.vertices[:, 0] > CUT
edges = unique_edges(mesh.tetrahedra)
edges = edges[is_right[edges[:, 0]] != is_right[edges[:, 1]]]
towards = np.where(is_right[edges[:, 1]], 1.0, -1.0)
fracture = FractureEvent(run_id=RUN_ID, sequence=1, body_id=BAR, fragment_id=WHOLE)
fracture.header.frame_id = "world"
fracture.new_fragment_ids = indices([LEFT, RIGHT])
fracture.nodes, fracture.node_fragments = indices(np.arange(len(mesh.vertices))), indices(is_right)
fracture.cut_edges = indices(edges)
fracture.cut_planes = floats(np.column_stack([towards, 0.0 * towards, 0.0 * towards, towards * CUT]))


def states(step: int, fractures: int, places: dict[int, tuple[float, float, float]]) -> FragmentStates:
    """Pose of each fragment's body frame [m]. `fractures`: number of fractures so far."""
    message = FragmentStates(run_id=RUN_ID, step=step, fracture_sequence=fractures, body_sequence=2)  # bar and floor
    message.header.frame_id = "world"
    message.fragment_ids, message.positions = indices(list(places)), floats(list(places.values()))
    message.orientations = floats([0.0, 0.0, 0.0, 1.0] * len(places))  # x y z w
    return message


def describe(contacts: ContactConstraintArray) -> None:
    """Print the number of contacts, the deepest gap and the missed depth bound of each pair."""
    print(f"step {contacts.step}, after {contacts.fracture_sequence} fractures:", flush=True)
    for pair, (a, b) in enumerate(zip(contacts.fragment_a, contacts.fragment_b, strict=True)):
        rows = slice(contacts.pair_begin[pair], contacts.pair_begin[pair + 1])
        gaps = contacts.gaps[rows]
        bound = 1e3 * contacts.missed_depth_bound[pair]
        deepest = f", the deepest gap {1e3 * min(gaps):.3f} mm" if gaps else ""
        print(
            f"  fragments {a} and {b}: {len(gaps)} contacts{deepest}; nothing deeper than {bound:.3f} mm is left out",
            flush=True,
        )


# In the air, on the floor, and broken: the halves 2 mm into the floor, 1 mm into each other.
STEPS = [
    states(0, 0, {WHOLE: (0.0, 0.0, 0.2)}),
    states(1, 0, {WHOLE: (0.0, 0.0, 0.05)}),
    states(2, 1, {LEFT: (0.0, 0.0, 0.048), RIGHT: (-0.001, 0.0, 0.048)}),
]

if __name__ == "__main__":
    rclpy.init()
    node = rclpy.create_node("break_your_own")
    body_publisher = node.create_publisher(CollisionBody, "bodies", LATCHED)
    event_publisher = node.create_publisher(FractureEvent, "fracture_events", LATCHED)
    state_publisher = node.create_publisher(FragmentStates, "fragment_states", 1)
    answers: list[ContactConstraintArray] = []
    node.create_subscription(ContactConstraintArray, "contact_constraints", answers.append, 1)

    print("waiting for collision_node", flush=True)
    while not state_publisher.get_subscription_count():
        rclpy.spin_once(node, timeout_sec=0.1)
    for body in (bar, floor):
        body_publisher.publish(body)
    event_publisher.publish(fracture)  # may arrive early: states contain the number of fractures they depend on
    for message in STEPS:
        # One answer per message. If none arrives it is sent again: either may be lost while nodes discover each other.
        while not any(answer.step == message.step and answer.run_id == RUN_ID for answer in answers):
            state_publisher.publish(message)
            rclpy.spin_once(node, timeout_sec=2.0)
        describe(answers[-1])
    node.destroy_node()
    rclpy.shutdown()
    sys.exit(0)
