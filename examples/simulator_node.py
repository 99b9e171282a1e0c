"""A simulator in one file: runs a scene of unbreakable bodies beside `collision_node`, over topics.

    python examples/simulator_node.py --ros-args -p scene:=my_scene.yaml

Sequential impulses with friction, restitution and warm starting (docs/solvers.md); poses are corrected by velocities of
their own. It passes `fracture-collision check-solver --case core`, started with -p scene:={scene} -p subscribers:=2.
"""

import sys
import time

import numpy as np
import rclpy
from fracture_collision.msg import CollisionBody, ContactConstraintArray, FragmentRegistry, FragmentStates
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile
from scipy.spatial.transform import Rotation

from fracture_collision import records
from fracture_collision.ros.wire.conversion import heading, to_message, to_record
from fracture_collision.simulation.scene.scene import collision_body, load_scene

LATCHED = QoSProfile(history=HistoryPolicy.KEEP_ALL, durability=DurabilityPolicy.TRANSIENT_LOCAL)
RUN_ID = time.time_ns()
ITERATIONS, ACCURACY = 200, 1e-12  # [m/s] changes of velocity at which they end
SLOP, SHARE, FASTEST = 1e-4, 0.2, 0.3  # [m] not corrected; share of the rest corrected in a step; [m/s] at most
BOUNCES = 0.2  # [m/s] slower blows do not bounce


class Bodies:
    """The n bodies in motion. Velocities u (n, 6): of the frame until the masses are known, then of the centre."""

    def __init__(self, scene):
        moving = [(number, body) for number, body in enumerate(scene.bodies, 1) if not body.is_static]
        self.ids = [number for number, _ in moving]
        self.origins = self.x = np.array([body.position for _, body in moving])
        self.turns = Rotation.from_quat([body.orientation for _, body in moving])
        self.u = np.array([np.append(body.linear_velocity, body.angular_velocity) for _, body in moving])

    def take_masses(self, registry):
        """From the first registry."""
        rows = [list(registry.fragment_ids).index(number) for number in self.ids]
        self.masses, self.centers = registry.masses[rows], registry.centers_of_mass[rows]
        self.inertias = registry.inertias[rows][:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)  # body axes
        self.x = self.origins + self.turns.apply(self.centers)
        self.u[:, :3] += np.cross(self.u[:, 3:], self.x - self.origins)

    def fly(self, gravity, h):
        """Gravity, and the gyroscopic torque by the implicit midpoint rule."""
        self.u[:, :3] += h * gravity
        before = after = self.turns.inv().apply(self.u[:, 3:])
        for _ in range(40):
            mean = 0.5 * (before + after)
            torque = np.cross(np.einsum("nij,nj->ni", self.inertias, mean), mean)
            after = before + h * np.linalg.solve(self.inertias, torque[..., None])[..., 0]
        self.gyroscopic, self.u[:, 3:] = after - before, self.turns.apply(after)

    def move(self, poses, h):
        """Move by the velocities `poses` (n, 6); spins turn with the bodies."""
        mean, kept = (self.turns.inv().apply(u[:, 3:]) for u in (poses, self.u))
        self.x, self.turns = (
            self.x + h * poses[:, :3], self.turns * Rotation.from_rotvec(h * (mean - 0.5 * self.gyroscopic))
        )  # fmt: skip
        self.u[:, 3:], self.origins = self.turns.apply(kept), self.x - self.turns.apply(self.centers)

    def states(self, step, body_sequence):
        """What the service is asked about."""
        linear = self.u[:, :3] + np.cross(self.u[:, 3:], self.origins - self.x)
        return records.FragmentStates(
            step, 0, self.ids, self.origins, self.turns.as_quat(), linear, self.u[:, 3:], body_sequence
        )


def relax(matrix, v, normals, friction, least, p):
    """Change impulses p (3N,) [N s] until normal velocities are at least `least` (N,), with v (3N,) [m/s] without p."""
    blocks = [slice(3 * k, 3 * k + 3) for k in range(len(normals))]
    stiffest, v = [np.linalg.norm(matrix[at, at], 2) for at in blocks], v + matrix @ p
    for _ in range(ITERATIONS):
        largest = 0.0
        for k, (at, n) in enumerate(zip(blocks, normals, strict=True)):
            old, speed = p[at].copy(), n @ v[at]
            normal = max(n @ old + (least[k] - speed) / (n @ matrix[at, at] @ n), 0.0)
            tangent = old - (n @ old) * n - (v[at] - speed * n) / stiffest[k]
            size = np.linalg.norm(tangent)
            p[at] = normal * n + tangent * min(1.0, friction[k] * normal / max(size, 1e-300))
            change = matrix[:, at] @ (p[at] - old)
            v, largest = v + change, max(largest, np.abs(change).max())
        if largest < ACCURACY:
            break
    return p


def solve(contacts, bodies, remembered, h):
    """Velocities of bodies after the step; returns impulses by contact id, and velocities (n, 6) that move poses."""
    counts, n, gaps, normals = np.diff(contacts.pair_begin), len(bodies.ids), contacts.gaps, contacts.normals
    columns = (contacts.fragment_a, contacts.fragment_b, contacts.friction, contacts.restitution)
    a, b, friction, restitution = (np.repeat(column, counts) for column in columns)
    jacobian, every = np.zeros((len(gaps), 3, n + 1, 6)), np.arange(len(gaps))  # row n: what cannot move
    for fragments, sign in ((a, -1.0), (b, 1.0)):
        rows = np.array([bodies.ids.index(i) if i in bodies.ids else n for i in fragments], int)
        arms = 0.5 * (contacts.points_a + contacts.points_b) - np.vstack((bodies.x, np.zeros(3)))[rows]
        jacobian[every, :, rows, :3] = sign * np.eye(3)
        jacobian[every, :, rows, 3:] = sign * np.cross(arms[:, None], np.eye(3))
    jacobian = jacobian[:, :, :n].reshape(3 * len(gaps), n, 6)
    axes = bodies.turns.as_matrix()
    inverses = axes @ np.linalg.inv(bodies.inertias) @ axes.transpose(0, 2, 1)
    moved = np.concatenate(
        (jacobian[..., :3] / bodies.masses[:, None], np.einsum("knj,nji->kni", jacobian[..., 3:], inverses)), axis=2
    ).reshape(-1, 6 * n)  # changes of u by unit impulses
    jacobian = jacobian.reshape(-1, 6 * n)
    matrix, v = moved @ jacobian.T, jacobian @ bodies.u.ravel()
    speeds = (normals * v.reshape(-1, 3)).sum(axis=1)
    bounces = (speeds < -BOUNCES) & (gaps < -h * speeds)
    least = np.maximum(-np.maximum(gaps, 0.0) / h, np.where(bounces, -restitution * speeds, -np.inf))
    corrections = np.minimum(SHARE * (-gaps - SLOP) / h, FASTEST)
    p = np.array([remembered.get(i, np.zeros(3)) for i in contacts.contact_ids.tolist()]).reshape(-1, 3)
    p -= np.minimum((p * normals).sum(axis=1), 0.0)[:, None] * normals
    p = relax(matrix, v, normals, friction, least, p.ravel())
    bodies.u = bodies.u + (p @ moved).reshape(-1, 6)
    corrected = np.where(gaps < -SLOP, np.maximum(least, corrections), least)
    more = relax(matrix, v + matrix @ p, normals, friction, corrected, np.zeros(len(p)))
    poses = bodies.u + (more @ moved).reshape(-1, 6)
    return dict(zip(contacts.contact_ids.tolist(), p.reshape(-1, 3), strict=True)), poses


def main():
    """Run the scene to its end."""
    rclpy.init()
    node = rclpy.create_node("simulator_node")
    scene = load_scene(node.declare_parameter("scene", "wall").value)
    subscribers = node.declare_parameter("subscribers", 1).value
    body_publisher = node.create_publisher(CollisionBody, "bodies", LATCHED)
    state_publisher = node.create_publisher(FragmentStates, "fragment_states", 10)
    contacts, registries = [], []
    node.create_subscription(ContactConstraintArray, "contact_constraints", contacts.append, 10)
    node.create_subscription(FragmentRegistry, "fragments", registries.append, LATCHED)
    while min(state_publisher.get_subscription_count(), node.count_subscribers("contact_constraints")) < subscribers:
        rclpy.spin_once(node, timeout_sec=0.1)
    for number, body in enumerate(scene.bodies, 1):
        record = collision_body(number, body)._replace(sequence=number)
        body_publisher.publish(to_message(record, heading(0.0), RUN_ID))
    bodies, remembered, h = Bodies(scene), {}, scene.time_step
    for step in range(scene.step_count):
        if step:
            bodies.fly(scene.gravity, h)
        contacts.clear()
        while not any(c.run_id == RUN_ID and c.step == step for c in contacts) or not registries:
            states = bodies.states(step, len(scene.bodies))
            state_publisher.publish(to_message(states, heading(step * h), RUN_ID))
            deadline = time.monotonic() + 10.0
            while time.monotonic() < deadline and not (contacts and registries):
                rclpy.spin_once(node, timeout_sec=0.1)
        if not step:  # masses come with the first answer
            bodies.take_masses(to_record(registries[-1]))
            bodies.fly(scene.gravity, h)
        remembered, poses = solve(to_record(contacts[-1]), bodies, remembered, h)
        bodies.move(poses, h)
    state_publisher.wait_for_all_acked(Duration(seconds=1))
    rclpy.shutdown()


if __name__ == "__main__":
    sys.exit(main())
