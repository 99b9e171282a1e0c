"""A copy of the service beside the page, to show internals of collision detection that the service does not publish.

Contacts are a function of bodies, events, states and settings, all of which are on topics, so the copy has the state of
the service. It is created when a switch is turned on and dropped when none is on. It runs in a thread of its own at a
few steps a second, the newest only. What the service's answers are compared with: all samples, at exact depths.
"""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Callable
from typing import Any, NamedTuple

from fracture_collision.cdr import Received
from fracture_collision.records import CollisionBody, ContactConstraintArray
from fracture_collision.ros.service.collision_run import CollisionRun
from fracture_collision.ros.wire.conversion import to_record
from fracture_collision.viewer.page.page_events import InsideWanted, PlaneWanted
from fracture_collision.viewer.page.page_inside import InsideFigures, InsideView, PlanePicture, Spheres
from fracture_collision.world import CollisionWorld, InvalidMessage, PaperSettings, Settings, StatesAhead
from fracture_collision.world.inspection import errors_of, every_contact, field_on_plane, reach_along, spheres_of_level
from fracture_collision.world.present import Present
from fracture_collision.world.settings import GLONDU2014

INTERVAL = 0.2  # [s] between two views, at least
BUSY_SHARE = 0.5  # of the time, at most: the service needs the processor too
REMEMBERED = 4  # states for which answers may still come
ENDING = 2.0  # [s] that a view may take when the page ends
# What an answer is compared with: all samples, at the exact depths.
TRUTH = Settings(method=GLONDU2014, paper=PaperSettings(field="exact"), threads=1)


class _Copy:
    """A world with the messages of the run, as far as they have been told."""

    def __init__(self, run_id: int, settings: Settings) -> None:
        self.run_id = run_id
        self._run, self._fed = CollisionRun(run_id, settings), 0

    def brought_to(self, job: _Job, settings: Settings) -> CollisionWorld:
        """With the job's bodies and events, and these settings."""
        if self._run.world.settings != settings:
            self._run.world.change_settings(settings)
        for said in job.log[self._fed : job.told]:
            if isinstance(said, CollisionBody):
                self._run.add_body(said)
            else:
                self._run.add_fracture(to_record(said))
        self._fed = job.told
        return self._run.world


class _Job(NamedTuple):
    """The input of one view."""

    run_id: int
    log: list[Any]  # bodies and events of the run; it grows
    told: int  # entries of it to apply
    states: Received
    answer: ContactConstraintArray | None  # the service's, to these states; None: computed here, or not wanted
    wanted: InsideWanted
    settings: Settings  # of the service
    collision_ms: float | None
    is_replayed: bool


class Mirror:
    """Receives what the page receives; calls `show` with the requested view, in its thread. `show` returns at once."""

    def __init__(self, show: Callable[[InsideView], None]) -> None:
        self._show = show
        self._news = threading.Condition()
        self._wanted = InsideWanted()
        self._settings = Settings()
        self._paused = False
        self._collision_ms: float | None = None
        self._closed = False
        self._run_id = 0
        self._log: list[Any] = []
        self._states: dict[int, Received] = {}  # the last ones, by step
        self._exchange: tuple[Received, ContactConstraintArray, Settings] | None = None  # the newest, and its settings
        self._is_new = False
        # used by the thread only
        self._copies: dict[str, _Copy] = {}  # the truth and, where it is needed, the service
        self._spheres: tuple[Any, Spheres] | None = None  # and what they were made for
        self._reach: tuple[Any, tuple[float, float]] | None = None  # likewise
        self._thread = threading.Thread(target=self._work, name="mirror", daemon=True)
        self._thread.start()

    # --- called by the page's node, from its thread ----------------------------------------------------------------

    @property
    def wants_contacts(self) -> bool:
        """Whether `hear_contacts` must be called."""
        return self._wanted.compares

    def new_run(self, run_id: int) -> None:
        """Stops showing anything of an earlier run."""
        with self._news:
            self._run_id = run_id
            self._log, self._states, self._exchange, self._is_new = [], {}, None, False

    def hear(self, message: Any) -> None:
        """Keeps a body (a record) or a fracture event (a message) for a copy that is created later."""
        self._log.append(message)

    def hear_states(self, states: Received) -> None:
        """Takes the newest states of the run."""
        with self._news:
            self._states[states.record.step] = states
            while len(self._states) > REMEMBERED:
                del self._states[next(iter(self._states))]
            self._have_news()

    def hear_contacts(self, contacts: ContactConstraintArray) -> None:
        """Takes the service's answer to earlier states; ignored if those are no longer kept."""
        with self._news:
            states = self._states.get(contacts.step)
            if states is not None:
                self._exchange = states, contacts, self._settings
                self._have_news()

    def hear_times(self, collision_ms: float) -> None:
        """Takes the time of the service's last answer [ms]."""
        self._collision_ms = collision_ms

    def hear_paused(self, paused: bool) -> None:
        """Takes whether the scene is paused."""
        with self._news:
            if paused != self._paused:
                self._paused = paused
                self._have_news()

    def hear_settings(self, values: dict[str, Any]) -> None:
        """Takes the service's settings, by name."""
        with self._news:
            self._settings = Settings(**values)
            self._have_news()

    def want(self, wanted: InsideWanted) -> None:
        """Takes which views the user requests."""
        with self._news:
            self._wanted, self._is_new = wanted, True
            self._news.notify()

    def close(self) -> None:
        """Ends the thread, after the current view or after ENDING."""
        with self._news:
            self._closed = True
            self._news.notify()
        self._thread.join(ENDING)

    def _have_news(self) -> None:
        if self._wanted.anything:
            self._is_new = True
            self._news.notify()

    # --- the thread ------------------------------------------------------------------------------------------------

    def _work(self) -> None:
        due = 0.0
        while True:
            with self._news:
                self._news.wait_for(lambda: self._closed or self._is_new)
                self._news.wait_for(lambda: self._closed, max(due - time.monotonic(), 0.0))
                if self._closed:
                    return
                self._is_new = False
                job = self._next_job()
            if job is None:
                self._copies.clear()
                self._spheres = self._reach = None
                continue
            began = time.monotonic()
            try:
                view = self._look(job)
            except (StatesAhead, InvalidMessage):  # the service reports it; the next states may be valid
                view = None
            except Exception:
                traceback.print_exc()
                view = None
            with self._news:
                if view is not None and job.run_id == self._run_id:
                    self._show(view)
            ended = time.monotonic()
            due = max(began + INTERVAL, ended + (ended - began) * (1.0 / BUSY_SHARE - 1.0))

    def _next_job(self) -> _Job | None:
        """None: there is nothing to show, or no view is requested."""
        if not self._wanted.anything or not self._states:
            return None
        states, answer, is_replayed = self._states[next(reversed(self._states))], None, False
        if self._wanted.compares:
            if self._exchange is not None and (not self._paused or self._exchange[0] is states):
                states, answer, settings = self._exchange
                if self._paused and settings != self._settings:
                    answer = None
            # the service gets no states while the scene is paused
            is_replayed = self._paused and answer is None
        return _Job(
            self._run_id, self._log, len(self._log), states, answer, self._wanted, self._settings, self._collision_ms,
            is_replayed,
        )  # fmt: skip

    def _look(self, job: _Job) -> InsideView:
        tolerances = job.settings.penetration_tolerance, job.settings.detection_tolerance
        truth = TRUTH._replace(penetration_tolerance=tolerances[0], detection_tolerance=tolerances[1])
        world = self._world(job, "truth", truth)
        states, wanted = job.states.record, job.wanted
        here = world.present(states)
        spheres = self._spheres_of(job, world, here, wanted.level) if wanted.level is not None else None
        plane = self._plane(job, world, here, wanted.plane) if wanted.plane is not None else None
        if wanted.plane is None:
            self._reach = None
        figures = None
        if wanted.compares and (job.answer is not None or job.is_replayed):
            figures = self._figures(job, world, here)
        return InsideView(spheres, plane, figures)

    def _world(self, job: _Job, of: str, settings: Settings) -> CollisionWorld:
        """The truth, or a copy of the service, with the job's bodies and events."""
        if of not in self._copies or self._copies[of].run_id != job.run_id:
            self._copies[of] = _Copy(job.run_id, settings)
        return self._copies[of].brought_to(job, settings)

    def _spheres_of(self, job: _Job, world: CollisionWorld, here: Present, level: int) -> Spheres:
        made_for = job.run_id, job.states.record.fracture_sequence, level, here.ids.tobytes()
        if self._spheres is None or self._spheres[0] != made_for:
            found = spheres_of_level(world, here, level)
            self._spheres = made_for, Spheres(level, found.deepest, found.fragment_ids, found.centres, found.radii)
        return self._spheres[1]

    def _plane(self, job: _Job, world: CollisionWorld, here: Present, wanted: PlaneWanted) -> PlanePicture | None:
        """Keeps the reach, so that a plane does not move with the scene."""
        made_for = job.run_id, wanted.axis
        if self._reach is None or self._reach[0] != made_for:
            reach = reach_along(world, here, wanted.axis)
            if reach is None:
                return None
            self._reach = made_for, reach
        low, high = self._reach[1]
        found = field_on_plane(world, here, wanted.axis, low + wanted.share * (high - low))
        return None if found is None else PlanePicture(*found)


    def _figures(self, job: _Job, world: CollisionWorld, here: Present) -> InsideFigures:
        states, answer, collision_ms = job.states.record, job.answer, job.collision_ms
        if answer is None or job.settings.lookahead:
            # without the contacts of a time to come, which collide with nothing now, the service's answer is this one
            service = self._world(job, "service", job.settings._replace(lookahead=0.0, threads=1))
            answer = service.contacts(states)
            if job.answer is None:
                collision_ms = 1e3 * (service.last_timings["broad_phase"] + service.last_timings["narrow_phase"])
        every = every_contact(world, states)
        errors = errors_of(answer, every, world, here, job.settings.penetration_tolerance)
        head = job.states.heading
        return InsideFigures(
            time=head.sec + 1e-9 * head.nanosec,
            contacts=errors.listed,
            colliding=errors.colliding,
            unlisted_mm=1e3 * errors.unlisted,
            promised_mm=1e3 * errors.promised,
            collision_ms=collision_ms,
            is_replayed=job.is_replayed,
        )
