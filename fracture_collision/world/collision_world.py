"""The service without ROS: messages in, contacts out. A pure function of bodies, events and the states of the step."""

from __future__ import annotations

import copy
import os
from time import perf_counter
from typing import NamedTuple

import numpy as np

from fracture_collision.core.bodies.collision_geometry import CollisionGeometry
from fracture_collision.core.contacts.contact_choice import Rule
from fracture_collision.core.glondu2014.paper_pairs import query_by_paper
from fracture_collision.core.lookahead.motion import NO_MOTION, Motion, fastest, motion_of
from fracture_collision.core.memory.crew import Crew
from fracture_collision.core.memory.pair import Step
from fracture_collision.core.pair.broad_phase import NOTHING_PAIRED, Paired, pairs_within_reach
from fracture_collision.core.pair.narrow_phase import NOTHING_REMEMBERED, Remembered, Scene, query_pairs
from fracture_collision.core.patches.interlocked import SurfaceTable
from fracture_collision.core.queries.surface_trees import SurfaceTrees, surface_trees
from fracture_collision.core.search.kept_answer import PairContacts
from fracture_collision.core.search.passes import within_limit
from fracture_collision.core.search.scratch import Scratch, scratch_for
from fracture_collision.core.search.work_limit import share_work
from fracture_collision.process.compile_progress import report_compilation
from fracture_collision.records import (
    CollisionBody,
    ContactConstraintArray,
    FractureEvent,
    FragmentMesh,
    FragmentRegistry,
    FragmentStates,
)
from fracture_collision.world.contact_answer import contact_answer
from fracture_collision.world.first_start import compile_beside
from fracture_collision.world.fragment_mesh import fragment_mesh
from fracture_collision.world.gates.checks import identifier, indices, refuse
from fracture_collision.world.gates.errors import Rejection, StatesAhead
from fracture_collision.world.gates.states_gate import CheckedStates, check_states
from fracture_collision.world.ledger import Ledger
from fracture_collision.world.present import Present, find_fragments, take_places
from fracture_collision.world.queries import (
    ClosestPoints,
    Distances,
    Overlaps,
    RayHits,
    Sweep,
    cast_rays,
    check_way,
    closest_points,
    contains,
    distances,
    overlaps,
    place_of,
    places_of,
    sweep,
)
from fracture_collision.world.registry import Registry
from fracture_collision.world.settings import Settings, check_settings, settings_text

# [m], [rad] Largest translation and rotation accepted within the lookahead time.
FARTHEST_AHEAD = 1e5


class _Answered(NamedTuple):
    """The last query, the registry state and settings it was answered with, and the answer."""

    registry: Registry | None
    changes: int
    settings: Settings | None
    asked: tuple[bytes, ...]  # ids, positions and orientations, with lookahead also velocities; static bodies
    answer: ContactConstraintArray | None


_NOTHING_ANSWERED = _Answered(None, 0, None, (), None)


class CollisionWorld:
    """Bodies and fracture events in, contacts out; every method raises InvalidMessage if its input breaks a rule.

    Messages are validated completely before anything changes. Events are applied when states need their registry;
    states of an earlier one are answered from a registry rebuilt from the event log.
    """

    def __init__(self, settings: Settings | None = None) -> None:
        report_compilation()
        compile_beside()
        self.settings = settings if settings is not None else Settings()
        check_settings(self.settings)
        self._ledger = Ledger(self.settings)
        self._registry = Registry(self.settings)
        self._built_for: tuple[object, ...] | None = _built_for(self.settings)
        self._events_asked_with = 0  # number of events known at the last states
        self._crew = _crew_of(self.settings)
        self._scratch: tuple[Scratch, ...] = ()
        # Caches of the last answer, each with the state it is valid for; they speed up the next one, never change it
        self._remembered, self._remembered_of = NOTHING_REMEMBERED, self._what_is_remembered_of()
        self._whole, self._whole_of = SurfaceTable(), (self._registry, self._registry.renumbered)
        self._whole_at = self._registry.changes
        self._paired, self._paired_of = NOTHING_PAIRED, self._asked_of()
        self._answered = _NOTHING_ANSWERED
        self._trees: tuple[tuple[Registry, int, bytes], SurfaceTrees] | None = None
        self.last_timings: dict[str, float] = {"update": 0.0, "broad_phase": 0.0, "narrow_phase": 0.0}  # [s]
        self.last_visits = 0  # leaves and samples, or tree nodes, that the last answer looked at
        self.last_pairs = 0  # fragment pairs that its broad phase found

    def __getstate__(self) -> tuple[Settings, Ledger]:
        """What copies and pickles keep: the messages. The copy builds its bodies from them when it is first asked."""
        return self.settings, self._ledger

    def __setstate__(self, state: tuple[Settings, Ledger]) -> None:
        settings, ledger = state
        self.__init__(settings)  # type: ignore[misc]
        self._ledger, self._built_for = ledger, None

    def __copy__(self) -> CollisionWorld:
        """A world of its own, as copy.deepcopy makes: two that share their messages would be of no use."""
        return copy.deepcopy(self)

    def add_body(self, body: CollisionBody) -> None:
        """Add a body, or remove one (REMOVE). A repetition of a message changes nothing."""
        self._ledger.add_body(body)

    def add_fracture(self, event: FractureEvent) -> None:
        """Append an event to the log. A repetition of a message changes nothing."""
        self._ledger.add_fracture(event)

    @property
    def rejected_event(self) -> Rejection | None:
        """Of the next event, if it was rejected. States that need it are rejected until a corrected one is accepted."""
        return self._ledger.rejected

    def reject_body(self, sequence: int, reason: str) -> None:
        """Record that body message `sequence` arrived but cannot be read. States after it are rejected."""
        self._ledger.reject_body(sequence, reason)

    def reject_fracture(self, sequence: int, reason: str) -> None:
        """Record that event `sequence` arrived but cannot be read. No effect unless it is the next event."""
        self._ledger.reject(sequence, reason)

    def lacks(self, ahead: StatesAhead) -> bool:
        """Whether states that raised `ahead` would raise it again. Amortized O(1) per missing fragment."""
        return self._ledger.lacks(ahead)

    def change_settings(self, settings: Settings) -> None:
        """Answer from now on as a new world with `settings` and the same messages would.

        Bodies and events stay. Limits apply to later messages; existing content may exceed them.

        After a change of `method` or `paper`, the registry is rebuilt from the event log when it is next needed. Raises
        ValueError, and changes nothing, if a setting is out of range.
        """
        check_settings(settings)
        if settings.threads != self.settings.threads:
            self._crew, self._scratch = _crew_of(settings), ()
        self._ledger.change_limits(settings)
        self.settings = settings

    def forget(self) -> None:
        """Drop what is kept of earlier answers: the next has the same contacts and takes as long as a first one."""
        self._remembered, self._answered, self._paired = NOTHING_REMEMBERED, _NOTHING_ANSWERED, NOTHING_PAIRED

    def contacts(self, states: FragmentStates, pairs: np.ndarray | None = None) -> ContactConstraintArray:
        """All contacts of the fragments that `states` names, and of the static ones, at its registry.

        pairs (k, 2): only of these pairs of fragment ids, in any order. Raises StatesAhead for states of an event or a
        body that has not arrived yet, and InvalidMessage with its reason for those of an event that was rejected
        (`rejected_event`).
        """
        if pairs is None:
            return self._contacts(states)
        chosen = indices("pairs", pairs, 2)
        kept = self._remembered, self._remembered_of, self._answered  # of all pairs, for the next step
        self._remembered, self._answered = NOTHING_REMEMBERED, _NOTHING_ANSWERED
        try:
            return self._contacts(states, chosen)
        finally:
            self._remembered, self._remembered_of, self._answered = kept

    def _contacts(self, states: FragmentStates, chosen: np.ndarray | None = None) -> ContactConstraintArray:
        """Of all pairs, or of those `chosen` (k, 2)."""
        started = perf_counter()
        checked, moving = self._bring_to(states)
        updated = perf_counter()
        static_until = self._registry.static_until(checked.body_sequence)
        columns = checked[2:7] if self.settings.lookahead else checked[2:5]
        asked = (*(column.tobytes() for column in columns), static_until.to_bytes(8, "little"))
        if (again := self._answer_again(checked, asked)) is not None:
            self.last_visits = 0
            self.last_timings = {"update": updated - started, "broad_phase": 0.0, "narrow_phase": 0.0}
            return again
        here = take_places(checked, self._registry.living(), moving, static_until)
        rows, positions, rotations = here.rows, here.positions, here.rotations
        pools = self._registry.geometry.pools
        motion = self._motion_of(here)
        radius, paired = pairs_within_reach(
            pools.fragment, (rows, rotations, positions), motion, here.is_static, self.settings.detection_tolerance,
            self.settings.max_pairs, self._take_paired(),
        )  # fmt: skip
        pairs = paired.pairs
        if len(pairs) > self.settings.max_pairs:
            refuse(
                "limit_exceeded",
                f"positions: the boxes of more than {self.settings.max_pairs} pairs of fragments overlap (max_pairs)",
            )
        if chosen is not None:
            pairs = _chosen_pairs(here, pairs, chosen)
        pairs_found = perf_counter()
        found = self._query(Step(rows, rotations, positions, pairs), paired.boxes, motion)
        answer = contact_answer(checked, here, radius, pairs, found, self.settings)
        self._paired, self._answered = paired, _Answered(*self._asked_of(), asked, answer)
        answer = _copy_of(answer)
        self.last_visits, self.last_pairs = int(found.visits.sum()), len(pairs)
        self.last_timings = {
            "update": updated - started, "broad_phase": pairs_found - updated,
            "narrow_phase": perf_counter() - pairs_found,
        }  # fmt: skip
        return answer

    def _query(self, step: Step, boxes: np.ndarray, motion: Motion) -> PairContacts:
        """The contacts of all pairs of a Step whose fragments have these world boxes (n, 6) [m]."""
        settings, geometry = self.settings, self._registry.geometry
        pools = geometry.pools
        every, within = share_work(pools, step.rows, step.pairs, boxes, settings.max_work)
        rule = Rule(
            settings.contacts_per_pair, 2 * settings.contacts_per_pair, settings.penetration_tolerance,
            settings.detection_tolerance, every,
        )  # fmt: skip
        ranges, threads = (pools.fragment.sample_begin, pools.fragment.sample_end), self._crew.threads
        if geometry.paper is not None:
            paper = geometry.paper.pools
            ranges = paper.trees.ranges[:, 0], paper.trees.ranges[:, 1]
        self._scratch = scratch_for(
            len(pools.mesh.tetrahedra), ranges, step.rows, threads, self._scratch, geometry.searched.edges
        )
        own = self._scratch, self._crew
        if geometry.paper is not None:
            found = query_by_paper(pools, paper, step, rule, within, own)
        else:
            found, self._remembered = query_pairs(self._scene(step, motion), rule, *own, self._take_remembered())
        return within_limit(pools, step, found, settings.max_contacts, self._scratch[0])

    def _scene(self, step: Step, motion: Motion) -> Scene:
        geometry = self._registry.geometry
        return Scene(geometry.searched, step, motion, self._registry.changes, self._whole_surfaces())

    def distance(self, states: FragmentStates, pairs: np.ndarray) -> Distances:
        """How far the fragments of each of `pairs` (p, 2), ids, are from each other, and where; however far.

        Raises as `contacts` does, and for a fragment that does not take part at `states`, or two unbounded planes.
        """
        here, chosen = self.present(states), indices("pairs", pairs, 2)
        places = places_of(here, chosen)
        found = distances(self._registry.geometry.pools, self._surface_trees(here), here, places, self._crew)
        overlapping = np.flatnonzero(found.distances == 0.0)
        if len(overlapping):
            ids = np.sort(chosen[overlapping], axis=1).tolist()
            listed = {(pair.a, pair.b): pair for pair in self.contacts(states, pairs=chosen[overlapping]).pairs()}
            for k, pair in zip(overlapping.tolist(), (listed.get((a, b)) for a, b in ids), strict=True):
                if pair is None or not pair.gaps.min(initial=0.0) < 0.0:
                    continue
                c, is_turned = int(np.argmin(pair.gaps)), chosen[k, 0] > chosen[k, 1]
                points = (pair.points_b, pair.points_a) if is_turned else (pair.points_a, pair.points_b)
                found.distances[k], found.points_a[k], found.points_b[k] = pair.gaps[c], points[0][c], points[1][c]
        return found

    def sweep(self, states: FragmentStates, fragment_id: int, way: np.ndarray) -> Sweep:
        """What a fragment touches first if it moves by `way` (3,) [m], world, without turning, and all others stay.

        It touches where it is no more than 1e-7 of its R away, never deeper. Raises as `contacts` does, and for a
        fragment that does not take part at `states`, an unbounded plane, or no way at all.
        """
        here = self.present(states)
        given = check_way(self._registry.geometry.pools, here, fragment_id, way)
        k = place_of(here, fragment_id)
        return sweep(self._registry.geometry.pools, self._surface_trees(here), here, k, given, self._crew)

    def overlaps(self, states: FragmentStates, boxes: np.ndarray) -> Overlaps:
        """Which fragments overlap boxes (k, 6) [m], lower and upper corner, along the axes of the world.

        By the exact fragments, not by boxes around them. Raises as `contacts` does, and for a box that is inside out.
        """
        here = self.present(states)
        return overlaps(self._registry.geometry.pools, self._surface_trees(here), here, boxes)

    def cast_rays(self, states: FragmentStates, origins: np.ndarray, directions: np.ndarray) -> RayHits:
        """The first surface that each ray meets, of all fragments that take part at `states`; from either side.

        origins (n, 3) [m], directions (n, 3) of any length, world. Raises as `contacts` does, and for a direction of
        length 0.
        """
        here = self.present(states)
        return cast_rays(self._registry.geometry.pools, self._surface_trees(here), here, origins, directions)

    def closest_points(self, states: FragmentStates, fragment_id: int, points: np.ndarray) -> ClosestPoints:
        """The points of a fragment's surface that are nearest to points (n, 3) [m], world, with signed distances.

        Exact however far a point is, and on concave fragments. Raises as `contacts` does, and for a fragment that does
        not take part at `states`.
        """
        here = self.present(states)
        k = place_of(here, fragment_id)
        return closest_points(self._registry.geometry.pools, self._surface_trees(here), here, k, points)

    def contains(self, states: FragmentStates, fragment_id: int, points: np.ndarray) -> np.ndarray:
        """Which of the points (n, 3) [m], world, lie in a fragment: (n,) bool. Each point of a body lies in one."""
        here = self.present(states)
        return contains(self._registry.geometry.pools, here, place_of(here, fragment_id), points)

    def _surface_trees(self, here: Present) -> SurfaceTrees:
        """Trees of the surfaces of the fragments `here`, made when they are asked for."""
        asked = self._registry, self._registry.changes, here.rows.tobytes()
        if self._trees is None or self._trees[0] != asked:
            self._trees = asked, surface_trees(self._registry.geometry.pools, here.rows)
        return self._trees[1]

    @property
    def geometry(self) -> CollisionGeometry:
        """After the events of the last states; rows as in `present`."""
        return self._registry.geometry

    def present(self, states: FragmentStates) -> Present:
        """The fragments that take part at `states`, with their poses. Raises as `contacts` does."""
        checked, moving = self._bring_to(states)
        static_until = self._registry.static_until(checked.body_sequence)
        return take_places(checked, self._registry.living(), moving, static_until)

    def fragments(self) -> FragmentRegistry:
        """The registry of the last states, including bodies that arrived since; if events did, after all of them."""
        self._advance_to_news()
        return self._registry.record(settings_text(self.settings))

    def fragment_mesh(self, fragment_id: int) -> FragmentMesh:
        """Surface of a fragment for viewers: one that lives at the last states, or that `fragments` lists.

        Raises InvalidMessage for any other id.
        """
        number = identifier("fragment_id", fragment_id)
        self._advance(self._registry.sequence)
        row = self._registry.row_of(number)
        if row is None:
            self._advance_to_news()
            row = self._registry.row_of(number)
        if row is None:
            refuse("unknown_id", f"fragment_id: no living fragment {number}")
        return fragment_mesh(number, self._registry.geometry, row)

    def _advance_to_news(self) -> None:
        """Bring the registry to the last states or, if events were added since, to the last event."""
        known = len(self._ledger.events)
        self._advance(known if known > self._events_asked_with else self._registry.sequence)

    def _bring_to(self, states: FragmentStates) -> tuple[CheckedStates, np.ndarray]:
        """Validate the states and bring the registry to theirs; also returns indices of the living fragments named."""
        checked = check_states(states)
        self._ledger.require_bodies(checked.body_sequence)
        self._ledger.require_events(checked.fracture_sequence)
        if checked.fracture_sequence != self._registry.sequence:
            # rejected states must not move the registry
            self._ledger.require_living(checked.fragment_ids, checked.fracture_sequence)
        self._advance(checked.fracture_sequence)
        self._events_asked_with = len(self._ledger.events)
        return checked, self._find(checked, self._registry.living().ids)

    def _advance(self, sequence: int) -> None:
        """Bring the registry to `sequence` events and to the current bodies.

        Replays the log from the beginning if the registry is past `sequence`; removing a body replays nothing.
        """
        built_for = _built_for(self.settings)
        gone, added = self._ledger.take_changes()
        if sequence < self._registry.sequence or self._built_for != built_for:
            self._registry = Registry(self.settings)
            gone, added = [], list(self._ledger.bodies.values())
        self._built_for = None  # if this fails half-way, the next call rebuilds
        for body_id in gone:
            self._registry.remove_body(body_id)
        for body in added:
            self._registry.add_body(body)
        while self._registry.sequence < sequence:
            self._registry.apply(self._ledger.events[self._registry.sequence])
        self._built_for = built_for

    def _motion_of(self, here: Present) -> Motion:
        """How the fragments `here` move within the lookahead time."""
        time = self.settings.lookahead
        if not time:
            return NO_MOTION
        for name, velocities in (("linear_velocities", here.linear), ("angular_velocities", here.angular)):
            if fastest(velocities) * time > FARTHEST_AHEAD:
                refuse("out_of_range", f"{name}: beyond {FARTHEST_AHEAD:g} within lookahead = {time:g} s")
        fragment = self._registry.geometry.pools.fragment
        placed = here.rows, here.rotations, here.positions
        centers = self._registry.centers_of_mass(here.ids)
        return motion_of(fragment.kind, fragment.box, placed, centers, (here.linear, here.angular), time)

    def _answer_again(
        self, checked: CheckedStates, asked: tuple[bytes, ...]
    ) -> ContactConstraintArray | None:
        """The last answer, if the states equal the last ones; else None."""
        last = self._answered
        if last.answer is None or last[:3] != self._asked_of() or last.asked != asked:
            return None
        return _copy_of(last.answer)._replace(step=checked.step)

    def _asked_of(self) -> tuple[Registry, int, Settings]:
        return self._registry, self._registry.changes, self.settings

    def _take_paired(self) -> Paired:
        """Likewise for the broad phase; its cache is valid until the registry or the settings change."""
        holds_for = self._asked_of()
        paired = self._paired if self._paired_of == holds_for else NOTHING_PAIRED
        self._paired, self._paired_of = NOTHING_PAIRED, holds_for
        return paired

    def _take_remembered(self) -> Remembered:
        """Consume the cache; it is consumed even if the answer then fails."""
        holds_for = self._what_is_remembered_of()
        remembered = self._remembered if self._remembered_of == holds_for else NOTHING_REMEMBERED
        self._remembered, self._remembered_of = NOTHING_REMEMBERED, holds_for
        return remembered

    def _whole_surfaces(self) -> SurfaceTable:
        """Surfaces of concave fragments, built on demand; as they are divided now, whenever that is."""
        registry, (known, renumbered) = self._registry, self._whole_of
        if known is registry and renumbered + 1 == registry.renumbered and registry.moves is not None:
            self._whole.renumber(registry.moves)
        elif known is not registry or renumbered != registry.renumbered:
            self._whole, self._whole_at = SurfaceTable(), registry.changes
        if self._whole_at != registry.changes:
            self._whole.forget(registry.rows_broken_since(self._whole_at))
        self._whole_of, self._whole_at = (registry, registry.renumbered), registry.changes
        return self._whole

    def _what_is_remembered_of(self) -> tuple[Registry, int, Settings]:
        return self._registry, self._registry.renumbered, self.settings

    def _find(self, states: CheckedStates, ids: np.ndarray) -> np.ndarray:
        """Indices into `ids` of the fragments that the states name."""
        found = find_fragments(ids, states.fragment_ids)
        if found.min(initial=0) < 0:
            self._ledger.require_living(states.fragment_ids, states.fracture_sequence)
        return found


def _chosen_pairs(here: Present, pairs: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Those of `pairs` (p, 2), indices into the fragments `here`, that `chosen` (k, 2) names by their ids."""
    places = np.sort(places_of(here, chosen), axis=1)
    keys = pairs[:, 0] * len(here.ids) + pairs[:, 1]
    return np.ascontiguousarray(pairs[np.isin(keys, places[:, 0] * len(here.ids) + places[:, 1])])


def _copy_of(answer: ContactConstraintArray) -> ContactConstraintArray:
    """The receiver owns its answer and may change it."""
    return ContactConstraintArray._make([v.copy() if isinstance(v, np.ndarray) else v for v in answer])


def _built_for(settings: Settings) -> tuple[object, ...]:
    """The settings a registry is built with; a change of any of them rebuilds it from the event log."""
    return settings.method, settings.paper


def _crew_of(settings: Settings) -> Crew:
    return Crew(settings.threads or os.cpu_count() or 1)
