"""The page's copy of the service: it has the service's bodies and events, and works only while a view is open."""

from __future__ import annotations

import queue
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pytest
from stages.browser import until
from truth.contact_truth import COARSE_SHAPES, ContactTruth, piled
from worlds.fractured_worlds import SETTINGS as TRUE
from worlds.fractured_worlds import FracturedWorld, fractured_world, with_settings

from fracture_collision.cdr import Heading, Received
from fracture_collision.records import FragmentStates
from fracture_collision.ros.nodes.page_mirror import Mirror
from fracture_collision.ros.wire.conversion import heading, to_message
from fracture_collision.viewer.page.page_events import InsideWanted, PlaneWanted
from fracture_collision.viewer.page.page_inside import InsideFigures, InsideView
from fracture_collision.world import Settings
from fracture_collision.world.inspection import (
    errors_of,
    every_contact,
    field_on_plane,
    reach_along,
    spheres_of_level,
)

PATIENCE = 60.0  # [s]
RUN = 17
SETTINGS = Settings(threads=1, contacts_per_pair=3)
BOTH = InsideWanted(colliding=True, errors=True)


@pytest.fixture(scope="module")
def truth() -> ContactTruth:
    return ContactTruth(fractured_world(COARSE_SHAPES["brick"](), seeds=4, generations=2, curved=True))


class Stage(NamedTuple):
    """A mirror, the views it has shown, and a service beside it."""

    mirror: Mirror
    shown: queue.Queue[InsideView]
    truth: ContactTruth

    @property
    def case(self) -> FracturedWorld:
        return self.truth.case

    def states(self, step: int) -> FragmentStates:
        return piled(self.truth, step, 0.3)._replace(step=step)

    def tell_log(self, run_id: int = RUN) -> None:
        self.mirror.new_run(run_id)
        bodies, events = self.case.messages
        for body in bodies:
            self.mirror.hear(body)
        for event in events:
            self.mirror.hear(to_message(event, heading(0.0), run_id))

    def tell_step(self, step: int, settings: Settings = SETTINGS, run_id: int = RUN) -> None:
        """Passes states and the service's answer to the mirror."""
        states = self.states(step)
        self.mirror.hear_states(Received(Heading(step, 0, "world"), run_id, states))
        if self.mirror.wants_contacts:
            self.mirror.hear_contacts(with_settings(self.case, settings).contacts(states))

    def next_view(self) -> InsideView:
        return self.shown.get(timeout=PATIENCE)

    def next_figures(self) -> InsideFigures:
        """Skips views from before the answer."""
        while (figures := self.next_view().figures) is None:
            pass
        return figures

    def true_errors(self, step: int, settings: Settings = SETTINGS):
        states, epsilon = self.states(step), settings.penetration_tolerance  # ridges too short for it are skipped
        world = with_settings(self.case, TRUE._replace(penetration_tolerance=epsilon))
        answer, every = with_settings(self.case, settings).contacts(states), every_contact(world, states)
        return errors_of(answer, every, world, world.present(states), epsilon)


@pytest.fixture
def stage(truth: ContactTruth) -> Iterator[Stage]:
    shown: queue.Queue[InsideView] = queue.Queue()
    made = Stage(Mirror(shown.put), shown, truth)
    made.mirror.hear_settings(SETTINGS._asdict())
    made.tell_log()
    yield made
    made.mirror.close()
    assert not made.mirror._thread.is_alive()


def test_the_mirror_is_idle_without_viewers_and_then_follows_the_run(stage: Stage) -> None:
    stage.tell_step(1)
    stage.tell_step(2)
    assert not stage.mirror._copies and not stage.mirror._is_new and stage.shown.empty()
    stage.mirror.want(InsideWanted(level=1, plane=PlaneWanted(2, 0.25)))
    view = stage.next_view()
    world = with_settings(stage.case, TRUE)
    here = world.present(stage.states(2))
    spheres = spheres_of_level(world, here, 1)
    assert (view.spheres.level, view.spheres.deepest) == (1, spheres.deepest)
    for name in ("fragment_ids", "centres", "radii"):
        assert np.array_equal(getattr(view.spheres, name), getattr(spheres, name))
    low, high = reach_along(world, here, 2)
    plane = field_on_plane(world, here, 2, low + 0.25 * (high - low))
    assert np.array_equal(view.plane.owners, plane.owners) and np.array_equal(view.plane.depths, plane.depths)
    assert view.figures is None
    stage.tell_step(3)
    moved = stage.next_view()
    assert moved.spheres is view.spheres and moved.plane.place == view.plane.place  # spheres and plane are unchanged
    assert not np.array_equal(moved.plane.owners, view.plane.owners)
    stage.mirror.want(InsideWanted(level=4))
    deeper = stage.next_view()
    assert deeper.spheres.level == 4 and len(deeper.spheres.radii) > len(view.spheres.radii) and deeper.plane is None


def test_an_answer_is_compared_with_all_colliding_samples(stage: Stage) -> None:
    stage.mirror.want(BOTH)
    stage.mirror.hear_times(0.7)
    stage.tell_step(5)
    figures = stage.next_figures()
    errors = stage.true_errors(5)
    assert (figures.time, figures.contacts, figures.colliding) == (5.0, errors.listed, errors.colliding)
    assert figures.contacts < figures.colliding
    assert figures.unlisted_mm == pytest.approx(1e3 * errors.unlisted) and errors.unlisted <= errors.promised > 0.0
    assert figures.promised_mm == pytest.approx(1e3 * errors.promised)
    assert figures.collision_ms == 0.7 and not figures.is_replayed


def test_lookahead_contacts_do_not_count_as_colliding(stage: Stage) -> None:
    settings = SETTINGS._replace(lookahead=0.1)
    states = stage.states(5)
    places = np.reshape(states.positions, (-1, 3))
    states = states._replace(linear_velocities=3.0 * (places.mean(axis=0) - places))
    answer = with_settings(stage.case, settings).contacts(states)
    touching = with_settings(stage.case, SETTINGS).contacts(states)
    assert len(answer.gaps) > len(touching.gaps)
    stage.mirror.hear_settings(settings._asdict())
    stage.mirror.want(BOTH)
    stage.mirror.hear_states(Received(Heading(5, 0, "world"), RUN, states))
    stage.mirror.hear_contacts(answer)
    figures = stage.next_figures()
    assert figures.contacts == len(touching.gaps)
    assert figures.colliding == len(every_contact(with_settings(stage.case, TRUE), states).gaps)


def test_a_viewer_joins_a_paused_scene_and_settings_take_effect_at_once(stage: Stage) -> None:
    stage.mirror.hear_paused(True)
    stage.tell_step(5)  # the answer is not requested
    stage.mirror.want(BOTH)
    figures, errors = stage.next_view().figures, stage.true_errors(5)
    assert figures.is_replayed and (figures.contacts, figures.colliding) == (errors.listed, errors.colliding)
    for changes in (
        {"contacts_per_pair": 32}, {"penetration_tolerance": 0.05}, {"method": "glondu2014"}, {"max_work": 100},
    ):  # fmt: skip
        settings = SETTINGS._replace(**changes)
        stage.mirror.hear_settings(settings._asdict())
        figures = stage.next_view().figures
        errors = stage.true_errors(5, settings)
        assert figures.is_replayed and figures.collision_ms > 0.0
        assert (figures.time, figures.contacts, figures.colliding) == (5.0, errors.listed, errors.colliding)
        assert figures.unlisted_mm == pytest.approx(1e3 * errors.unlisted)
        assert figures.promised_mm == pytest.approx(1e3 * errors.promised)
    # one step is made, and the service answers it
    stage.tell_step(6, settings)
    while (figures := stage.next_view().figures).time < 6.0:
        pass
    while figures.is_replayed:
        figures = stage.next_view().figures
    assert figures.contacts == stage.true_errors(6, settings).listed


def test_a_new_run_starts_afresh_and_the_mirror_stops_without_viewers(stage: Stage) -> None:
    stage.mirror.want(InsideWanted(level=0))
    stage.tell_step(1)
    assert stage.next_view().spheres is not None
    stage.tell_log(RUN + 1)
    states = FragmentStates(1, 0, np.array([1]), np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))  # before any fracture
    stage.mirror.hear_states(Received(heading(0.0), RUN + 1, states))
    assert stage.next_view().spheres.fragment_ids.tolist() == [1]
    # states of an unknown registry are skipped; the next ones are answered
    stage.mirror.hear_states(Received(heading(0.0), RUN + 1, states._replace(step=2, fracture_sequence=9)))
    stage.mirror.hear_states(Received(heading(0.0), RUN + 1, states._replace(step=3)))
    assert stage.next_view().spheres.fragment_ids.tolist() == [1]
    stage.mirror.want(InsideWanted())
    until(lambda: stage.mirror._copies, lambda copies: not copies)
    stage.tell_step(4)
    assert not stage.mirror._is_new and stage.shown.empty()
