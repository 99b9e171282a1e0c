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

from fracture_collision import records
from fracture_collision.ros.wire.conversion import heading, to_message, to_record
from fracture_collision.simulation.scene.scene import collision_body, load_scene

LATCHED = QoSProfile(history=HistoryPolicy.KEEP_ALL, durability=DurabilityPolicy.TRANSIENT_LOCAL)
RUN_ID = time.time_ns()
ITERATIONS, ACCURACY = 200, 1e-12  # [m/s] changes of velocity at which they end
SLOP, SHARE, FASTEST = 1e-4, 0.2, 0.3  # [m] not corrected; share of the rest corrected in a step; [m/s] at most
BOUNCES = 0.2  # [m/s] slower blows do not bounce


def cross(r):
    """The matrix of r x."""
    return np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])


def turned(q, spin, time_step):
    """The quaternion x y z w after a turn by `spin` [rad/s], body axes."""
    angle = time_step * np.linalg.norm(spin)
    v = 0.5 * time_step * spin * np.sinc(0.5 * angle / np.pi)  # sin(angle / 2) along the spin
    s, p, w = np.cos(0.5 * angle), q[:3], q[3]
    q = np.append(w * v + s * p + np.cross(p, v), w * s - p @ v)
    return q / np.linalg.norm(q)


class Body:
    """A body in motion."""

    def __init__(self, number, start):
        self.id, self.origin, self.q = number, start.position, start.orientation
        self.u = np.append(start.linear_velocity, start.angular_velocity)  # of the frame, until the mass is known

    def rotation(self):
        """The matrix from the body frame to the world."""
        x, y, z, s = self.q
        return np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - s * z), 2 * (x * z + s * y)],
            [2 * (x * y + s * z), 1 - 2 * (x * x + z * z), 2 * (y * z - s * x)],
            [2 * (x * z - s * y), 2 * (y * z + s * x), 1 - 2 * (x * x + y * y)],
        ])  # fmt: skip

    def take_mass(self, registry):
        """Take mass, centre of mass and inertia from the first registry."""
        row = list(registry.fragment_ids).index(self.id)
        self.mass, self.center = registry.masses[row], registry.centers_of_mass[row]
        xx, xy, xz, yy, yz, zz = registry.inertias[row]
        self.inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        arm = self.rotation() @ self.center
        self.x = self.origin + arm  # centre of mass
        self.u[:3] += np.cross(self.u[3:], arm)

    def fly(self, gravity, time_step):
        """Gravity, and the gyroscopic torque by the implicit midpoint rule, body axes."""
        self.u[:3] += time_step * gravity
        before = self.rotation().T @ self.u[3:]
        after, inertia = before, self.inertia
        for _ in range(8):  # Newton
            m = 0.5 * (before + after)
            off = inertia @ (after - before) + time_step * np.cross(m, inertia @ m)
            slope = inertia + 0.5 * time_step * (cross(m) @ inertia - cross(inertia @ m))
            after = after - np.linalg.solve(slope, off)
        self.gyroscopic = after - before
        self.u[3:] = self.rotation() @ after

    def move(self, poses, time_step):
        """Move by the velocities `poses` (6,); the spin turns with the body."""
        spin, kept = self.rotation().T @ poses[3:] - 0.5 * self.gyroscopic, self.rotation().T @ self.u[3:]
        self.x, self.q = self.x + time_step * poses[:3], turned(self.q, spin, time_step)
        self.u[3:], self.origin = self.rotation() @ kept, self.x - self.rotation() @ self.center

    def origin_velocity(self):
        """[m/s] of the body frame's origin, as states have it."""
        return self.u[:3] + np.cross(self.u[3:], self.origin - getattr(self, "x", self.origin))


def relax(rows, u, least, p):
    """Change velocities u (n, 6) and impulses p (N, 3) [N s] until normal velocities are at least `least` (N,)."""
    for (sides, *_), impulse in zip(rows, p, strict=True):
        for i, _, moved in sides:
            u[i] += moved @ impulse
    for _ in range(ITERATIONS):
        largest = 0.0
        for k, (sides, n, mobility, stiffest, mu) in enumerate(rows):
            speed = sum(to @ u[i] for i, to, _ in sides)
            old, un = p[k], speed @ n
            normal = max(old @ n + (least[k] - un) / (n @ mobility @ n), 0.0)
            tangent = old - (old @ n) * n - (speed - un * n) / stiffest
            size = np.sqrt(tangent @ tangent)
            if size > mu * normal:
                tangent = tangent * (mu * normal / size)
            p[k] = normal * n + tangent
            for i, _, moved in sides:
                change = moved @ (p[k] - old)
                u[i] += change
                largest = max(largest, np.abs(change).max())
        if largest < ACCURACY:
            break


def solve(contacts, bodies, remembered, h):
    """Velocities of bodies after the step; returns impulses by contact id, and velocities (n, 6) that move poses."""
    at = {body.id: i for i, body in enumerate(bodies)}
    u = np.array([body.u for body in bodies])
    inverses = [np.linalg.inv(b.rotation() @ b.inertia @ b.rotation().T) for b in bodies]
    counts = np.diff(contacts.pair_begin.astype(int))
    columns = (contacts.fragment_a, contacts.fragment_b, contacts.friction, contacts.restitution)
    a_of, b_of, friction, restitution = (np.repeat(column, counts) for column in columns)
    rows, least, corrected, p = [], [], [], []
    for k, (n, g) in enumerate(zip(contacts.normals, contacts.gaps, strict=True)):
        point, sides = 0.5 * (contacts.points_a[k] + contacts.points_b[k]), []
        for fragment, sign in ((a_of[k], -1.0), (b_of[k], 1.0)):
            if (i := at.get(int(fragment))) is not None:
                to = sign * np.hstack((np.eye(3), -cross(point - bodies[i].x)))  # u to the velocity there
                moved = np.vstack((to[:, :3].T / bodies[i].mass, inverses[i] @ to[:, 3:].T))
                sides.append((i, to, moved))
        mobility = sum(to @ moved for _, to, moved in sides)
        rows.append((sides, n, mobility, np.linalg.norm(mobility, 2), friction[k]))
        un = n @ sum(to @ u[i] for i, to, _ in sides)
        bounces = un < -BOUNCES and g < -un * h
        least.append(max(-max(g, 0.0) / h, -restitution[k] * un if bounces else -np.inf))
        corrected.append(max(least[-1], min(SHARE * (-g - SLOP) / h, FASTEST) if g < -SLOP else -np.inf))
        old = remembered.get(int(contacts.contact_ids[k]), np.zeros(3))
        p.append(old - min(old @ n, 0.0) * n)
    relax(rows, u, least, p)
    for body, velocity in zip(bodies, u, strict=True):
        body.u = velocity.copy()
    if corrected != least:
        relax(rows, u, corrected, [np.zeros(3)] * len(p))  # of what is needed beside p
    return dict(zip(map(int, contacts.contact_ids), p, strict=True)), u


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
    bodies = [Body(i, body) for i, body in enumerate(scene.bodies, 1) if not body.is_static]
    remembered, h = {}, scene.time_step
    for step in range(scene.step_count):
        if step:
            for body in bodies:
                body.fly(scene.gravity, h)
        states = records.FragmentStates(
            step, 0, [b.id for b in bodies], [b.origin for b in bodies], [b.q for b in bodies],
            [b.origin_velocity() for b in bodies], [b.u[3:] for b in bodies], len(scene.bodies),
        )  # fmt: skip
        contacts.clear()
        while not any(c.run_id == RUN_ID and c.step == step for c in contacts) or not registries:
            state_publisher.publish(to_message(states, heading(step * h), RUN_ID))
            deadline = time.monotonic() + 10.0
            while time.monotonic() < deadline and not (contacts and registries):
                rclpy.spin_once(node, timeout_sec=0.1)
        if not step:  # masses come with the first answer
            for body in bodies:
                body.take_mass(to_record(registries[-1]))
                body.fly(scene.gravity, h)
        remembered, poses = solve(to_record(contacts[-1]), bodies, remembered, h)
        for body, velocity in zip(bodies, poses, strict=True):
            body.move(velocity, h)
    state_publisher.wait_for_all_acked(Duration(seconds=1))
    rclpy.shutdown()


if __name__ == "__main__":
    sys.exit(main())
