"""REMOVE without replay: memory is reclaimed, and answers equal those of a replayed log."""

from __future__ import annotations

import numpy as np
import pytest
from worlds.gate_world import BRICK, crack, plane, record_bytes, rigid, sphere, tetrahedral

from fracture_collision import fracture
from fracture_collision.core.bodies import collision_geometry
from fracture_collision.core.bodies.body_validator import validate_body
from fracture_collision.core.bodies.collision_geometry import CollisionGeometry
from fracture_collision.core.patches.interlocked import SurfaceTable, _surface_at
from fracture_collision.geometry.generators import ball
from fracture_collision.records import BOX, REMOVE, CollisionBody, FractureEvent, FragmentStates, SolidPrimitive
from fracture_collision.world import CollisionWorld, Settings

BALL = ball(0.5, 0.25)
SETTINGS = Settings(threads=1)
AVERAGED = Settings(threads=1, method="glondu2014")


def removal(body_id: int) -> CollisionBody:
    return CollisionBody(body_id, 0, operation=REMOVE)


def breakable(number: int) -> CollisionBody:
    return CollisionBody(number, number, vertices=BALL.vertices.ravel(), tetrahedra=BALL.tetrahedra.ravel())


def box(number: int) -> CollisionBody:
    return CollisionBody(number, number, primitive=SolidPrimitive(BOX, (0.4, 0.3, 0.2)))


class Twins:
    """A world that receives all messages, and the log from which a second world can be built at any time."""

    def __init__(self, settings: Settings = SETTINGS) -> None:
        self.settings = settings
        self.world = CollisionWorld(settings)
        self.bodies: list[CollisionBody] = []
        self.events: list[FractureEvent] = []
        self.step = 0

    def add(self, *bodies: CollisionBody) -> None:
        for body in bodies:
            self.bodies.append(body)
            self.world.add_body(body)

    def add_event(self, event: FractureEvent) -> None:
        self.events.append(event)
        self.world.add_fracture(event)

    def agree(self) -> int:
        """Asserts that both answer with the same bytes; returns the number of contacts."""
        slow = CollisionWorld(self.settings)
        removed = {b.body_id for b in self.bodies if b.operation == REMOVE}
        for body in self.bodies:
            slow.add_body(body)
        for event in self.events:
            slow.add_fracture(event)
        self.step += 1
        random = np.random.default_rng(self.step)
        owner = {b.fragment_id: b.body_id for b in self.bodies if b.operation != REMOVE}
        for event in self.events:
            del owner[event.fragment_id]
            owner.update(dict.fromkeys(event.new_fragment_ids.tolist(), event.body_id))
        static = {b.body_id for b in self.bodies if b.is_static}
        ids = np.array(sorted(f for f, b in owner.items() if b not in removed | static))
        places = random.uniform(-0.02, 0.02, (len(ids), 3))
        states = FragmentStates(
            self.step, len(self.events), ids, places.ravel(), np.tile([0.0, 0.0, 0.0, 1.0], len(ids))
        )
        contacts = self.world.contacts(states)
        assert record_bytes(contacts) == record_bytes(slow.contacts(states))
        assert record_bytes(self.world.fragments()) == record_bytes(slow.fragments())
        for fragment_id in ids.tolist():
            mine, theirs = self.world.fragment_mesh(fragment_id), slow.fragment_mesh(fragment_id)
            assert record_bytes(mine) == record_bytes(theirs)
        return len(contacts.gaps)


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the CollisionGeometry methods called from here on."""
    done: list[str] = []
    adds = "add_tetrahedra", "add_triangles", "add_box", "add_sphere", "add_plane"
    for name in ("apply_fracture", "keep_only", *adds):
        real = getattr(CollisionGeometry, name)

        def noted(self, *arguments, _name=name, _real=real):
            done.append(_name)
            return _real(self, *arguments)

        monkeypatch.setattr(CollisionGeometry, name, noted)
    return done


def test_remove_replays_nothing(counted: list[str]) -> None:
    twins = Twins()
    twins.add(tetrahedral(1), plane(2), sphere(3), rigid(4), tetrahedral(5), box(6))
    twins.add_event(crack(1, 1, (10, 11), 0.1))
    twins.add_event(crack(2, 11, (12, 13), 0.3, above=0.1))
    twins.agree()
    for body_id in (3, 5, 6, 1):
        twins.add(removal(body_id))
        counted.clear()
        twins.world.fragments()
        assert counted == []
        twins.agree()
    # a body added and removed between two answers costs nothing either
    twins.add(sphere(30), removal(30))
    counted.clear()
    twins.world.fragments()
    assert counted == []
    assert twins.agree() > 0


@pytest.mark.parametrize("settings", [SETTINGS, AVERAGED], ids=["exact", "averaged"])
def test_reclaiming_memory_does_not_change_answers(
    settings: Settings, counted: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bodies of all kinds break, are removed and replaced by others; the pools are compacted each time."""
    monkeypatch.setattr(CollisionGeometry, "is_mostly_garbage", lambda self: True)
    twins = Twins(settings)
    twins.add(breakable(20), tetrahedral(1), plane(2), rigid(3), box(4), breakable(5), sphere(6), rigid(7))
    largest = {5: 5, 20: 20}  # a fragment by body
    events = twins.events

    def break_body(number: int) -> None:
        first = 100 * (len(events) + 10)
        event = fracture.voronoi(
            breakable(number), 3, len(events), fragment_id=largest[number], after=events, first_new_id=first
        )
        twins.add_event(event)
        largest[number] = int(event.new_fragment_ids[np.bincount(event.node_fragments).argmax()])

    twins.add_event(crack(1, 1, (10, 11), 0.1))
    break_body(5)
    twins.agree()
    break_body(20)
    twins.agree()
    for number, then in ((20, 5), (3, 5), (1, None), (4, None), (7, 5), (6, None)):
        twins.add(removal(number))
        counted.clear()
        assert twins.agree() > 0
        assert "keep_only" in counted
        if then is not None:
            break_body(then)
            assert twins.agree() > 0
        twins.add(box(200 + number), rigid(300 + number), tetrahedral(400 + number))
        assert twins.agree() > 0
    registry, told = twins.world._registry, twins.world.fragments()
    validate_body(registry.geometry, [registry.row_of(f) for f in told.fragment_ids[told.body_ids == 5].tolist()])


def test_added_and_removed_balls_leave_no_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(collision_geometry, "LEAST_GARBAGE", 1 << 14)
    world = CollisionWorld(SETTINGS)
    world.add_body(tetrahedral(1))
    sizes = []
    for number in range(10, 300):
        world.add_body(box(number) if number % 2 else breakable(number))
        world.add_body(removal(number - 1)) if number > 10 else None
        world.fragments()
        sizes.append(world._registry.geometry._tables.bytes_used)
    assert max(sizes[100:]) <= max(sizes[:100])
    assert len(world._registry.geometry._meshes) <= 3


def test_a_shared_mesh_stays_as_long_as_one_body_has_it(monkeypatch) -> None:
    monkeypatch.setattr(CollisionGeometry, "is_mostly_garbage", lambda self: True)
    twins = Twins()
    twins.add(breakable(1), breakable(2), plane(3))
    twins.agree()
    twins.add(removal(1))
    twins.agree()
    geometry = twins.world._registry.geometry
    twins.add(breakable(4))
    twins.agree()
    assert len(geometry._meshes) == 1
    for number in (2, 4):
        twins.add(removal(number))
    twins.world.fragments()
    assert not geometry._meshes
    twins.add(breakable(5))
    assert twins.agree() > 0


def test_events_of_a_removed_body_keep_no_arrays() -> None:
    world = CollisionWorld(SETTINGS)
    world.add_body(tetrahedral(1))
    world.add_fracture(crack(1, 1, (10, 11), 0.1))
    before = world.fragments().digest
    world.add_body(tetrahedral(2))
    world.add_body(removal(2))
    assert world.fragments().digest == before
    world.add_body(removal(1))
    assert [len(event.nodes) for event in world._ledger.events] == [0]
    late = CollisionWorld(SETTINGS)
    for body in (tetrahedral(1), removal(1)):
        late.add_body(body)
    late.add_fracture(crack(1, 1, (10, 11), 0.1))
    ask = FragmentStates(1, 1, np.empty(0), np.empty(0), np.empty(0))
    for each in (world, late):
        each.contacts(ask)
    assert world.fragments().digest == late.fragments().digest
    assert len(BRICK.vertices) == world.settings.max_nodes - world._ledger._room_for_nodes + len(BRICK.vertices)


def test_surfaces_kept_over_fractures_and_reclaimed_memory_equal_new_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(CollisionGeometry, "is_mostly_garbage", lambda self: True)
    world, random = CollisionWorld(SETTINGS), np.random.default_rng(3)
    for body in (breakable(10), breakable(20), rigid(30), box(40), breakable(50)):
        world.add_body(body)
    events, kept, made, last = list[FractureEvent](), 0, 0, {10: 10, 20: 20}
    for turn in range(6):
        number = 10 if turn % 3 == 2 else 20
        event = fracture.voronoi(
            breakable(number), 4, turn, fragment_id=last[number], after=events, first_new_id=100 * (turn + 1)
        )
        events.append(event)
        last[number] = int(event.new_fragment_ids[np.bincount(event.node_fragments).argmax()])
        world.add_fracture(event)
        world.fragments()
        pools, rows = world.geometry.pools, np.sort(world._registry.living().rows)
        table = world._whole_surfaces()
        table.of(pools, np.sort(random.choice(rows, len(rows) // 2, replace=False)))
        ours, fresh = table.of(pools, rows), SurfaceTable().of(pools, rows)
        kept, made = kept + np.count_nonzero(ours.stamps[rows] <= made), ours.stamps.max()
        for row in rows.tolist():
            for mine, right in zip(_surface_at(ours, row), _surface_at(fresh, row), strict=True):
                np.testing.assert_array_equal(mine, right)
    assert kept > 0
