"""The kit for authors of solvers: both engines pass, and solvers with one deliberate mistake fail where they must."""

from __future__ import annotations

import math
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from fracture_collision.cli.commands import main
from fracture_collision.extras import missing_of
from fracture_collision.simulation.dynamics import Given, Solved
from fracture_collision.simulation.own_dynamics import OwnDynamics
from fracture_collision.simulation.scene.scene import Scene, load_scene, parse_scene
from fracture_collision.solver_check.cases import CASES, Figure, Part
from fracture_collision.solver_check.check import Outcome, check_case
from fracture_collision.solver_check.recorded import Recorded, matrices, rotation_vectors
from fracture_collision.solver_check.solver_runs import (
    UNTOUCHED,
    UnknownSolver,
    factory_of,
    run_in_lockstep,
    shuffled,
    thinned,
    with_bare_pairs,
)

QUICK = ("flight", "frames", "signs", "gaps", "drift", "strength", "fracture_in_flight", "robot")
ENGINES = [
    "own",
    pytest.param("mujoco", marks=pytest.mark.skipif(bool(missing_of("mujoco")), reason="MuJoCo is not installed")),
]


@cache
def outcome_of(name: str, solver: Any) -> Outcome:
    """A case's outcome; solver: a name, or a class made from OwnDynamics."""
    factory = factory_of(solver) if isinstance(solver, str) else solver.made

    def run(_: Any, part: Part) -> Recorded:
        scene = parse_scene(part.content, name)
        if name == "slope" and not isinstance(solver, str):
            scene = scene._replace(duration=0.4)  # half of it is judged; what is wrong shows at once
        return run_in_lockstep(factory, scene, part.change, part.strike)

    return check_case(CASES[name], run)


def words_of(outcome: Outcome) -> list[str]:
    """The figures out of bounds, with their causes."""
    return [f"{each.what} {each.measured} (exact {each.exact}): {each.cause}"
            for each in outcome.figures if not each.passes] + [outcome.error] * bool(outcome.error)  # fmt: skip


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in CASES]
)
@pytest.mark.parametrize("engine", ENGINES)
def test_an_engine_passes(engine: str, name: str) -> None:
    outcome = outcome_of(name, engine)
    if name == "robot" and missing_of("bullet"):
        assert "bullet" in outcome.left_out
        return
    assert outcome.passes and outcome.figures, words_of(outcome)


class Mistaken(OwnDynamics):
    """Solves contacts that are changed first."""

    @classmethod
    def made(cls, scene: Scene, looks_ahead: bool) -> Mistaken:
        """A factory, as check-solver takes it."""
        return cls(scene.time_step, scene.gravity, scene.solver, looks_ahead)

    def changed(self, given: Given) -> Given:
        """The contacts that it solves."""
        return given

    def solve(self, given: Given) -> Solved:
        return super().solve(self.changed(given))


class WithoutRobots(Mistaken):
    def carry(self, robot: Any) -> None:
        raise ValueError("its bodies are free")


def test_a_solver_without_robots_leaves_their_case_out() -> None:
    outcome = outcome_of("robot", WithoutRobots)
    assert outcome.left_out == "the solver has no robots (Dynamics.carry): its bodies are free"
    assert not outcome.figures and not outcome.error


def with_now(given: Given, **changes: Any) -> Given:
    """`given` with other columns of its present contacts."""
    contacts = given.contacts
    return given._replace(contacts=contacts._replace(now=contacts.now._replace(**changes)))


class Opposite(Mistaken):
    """Takes normals to point from b to a."""

    def changed(self, given: Given) -> Given:
        return with_now(given, normals=-given.contacts.now.normals)


class Frictionless(Mistaken):
    def changed(self, given: Given) -> Given:
        return with_now(given, friction=np.zeros_like(given.contacts.now.friction))


class Pyramid(Mistaken):
    """Limits the sum of the two tangents' impulses: weaker along the diagonals by the root of 2."""

    def changed(self, given: Given) -> Given:
        velocities = given.states.linear + self._time_step * self._gravity
        along = np.append(velocities, np.zeros((1, 3)), axis=0)[:, :2]
        pairs, now = given.contacts.pairs, given.contacts.now
        slip = along[pairs.body_b] - along[pairs.body_a]
        size, total = np.hypot(*slip.T), np.abs(slip).sum(axis=1)
        return with_now(given, friction=now.friction * np.where(total > 0.0, size / np.maximum(total, 1e-300), 1.0))


class Drifting(Mistaken):
    """Keeps the velocities that correct penetrations."""

    def advance(self, linear: Any, angular: Any, drift_linear: Any, drift_angular: Any) -> None:
        super().advance(
            linear + drift_linear, angular + drift_angular, np.zeros_like(linear), np.zeros_like(angular)
        )


class OneLess(Mistaken):
    """Ignores the last contact of each pair."""

    def solve(self, given: Given) -> Solved:
        now, pairs = given.contacts.now, given.contacts.pairs
        begin = now.pair_begin.astype(np.int64)
        kept = np.ones(len(now.gaps), bool)
        kept[begin[1:][np.diff(begin) > 0] - 1] = False
        of_contacts = ("points_a", "points_b", "normals", "gaps", "contact_ids")
        columns = {name: getattr(now, name)[kept] for name in of_contacts}
        counts = np.maximum(np.diff(begin) - 1, 0)
        fewer = now._replace(pair_begin=np.append(0, np.cumsum(counts)).astype(now.pair_begin.dtype), **columns)
        contacts = given.contacts._replace(now=fewer, pairs=pairs._replace(rest_gaps=pairs.rest_gaps[kept]))
        solved = super().solve(given._replace(contacts=contacts))
        impulses = np.zeros(len(kept))
        impulses[kept] = solved.normal_impulses
        return solved._replace(normal_impulses=impulses)


@pytest.mark.parametrize(
    ("solver", "case", "explanation"),
    [
        (Opposite, "signs", "the sign of normals"),
        (Frictionless, "slope", "friction is missing"),
        (Pyramid, "slope", "a pyramid"),
        (Drifting, "drift", "position correction ends up in the velocities"),
        (OneLess, "gaps", "the only contact of a pair is ignored"),
    ],
)
def test_a_wrong_solver_fails_with_its_cause(solver: type[Mistaken], case: str, explanation: str) -> None:
    outcome = outcome_of(case, solver)
    assert not outcome.passes
    assert any(explanation in each.cause for each in outcome.figures if not each.passes), words_of(outcome)


def test_a_pyramid_is_found_across_the_diagonal_alone() -> None:
    wrong = [each.what for each in outcome_of("slope", Pyramid).figures if not each.passes]
    assert wrong and all("diagonal" in what or "oblique" in what for what in wrong), wrong


def test_a_figure_passes_within_its_bound() -> None:
    for measured, exact, bound, passes, share in (
        (1.0, 1.0, 0.0, True, 0.0), (1.5, 1.0, 0.5, True, 1.0), (0.4, 1.0, 0.5, False, 1.2),
        (math.nan, 0.0, 1.0, False, math.nan), (2.0, 1.0, 0.0, False, math.inf), (math.nan, 0.0, 0.0, False, math.inf),
        (7.0, None, None, True, 0.0),
    ):  # fmt: skip
        figure = Figure("", measured, exact, bound)
        assert figure.passes == passes and figure.share == pytest.approx(share, nan_ok=True), figure


def test_an_error_of_a_solver_fails_the_case() -> None:
    class Raising(Mistaken):
        def changed(self, given: Given) -> Given:
            raise ZeroDivisionError("no contact has a mobility")

    outcome = outcome_of("gaps", Raising)
    assert not outcome.passes and "ZeroDivisionError: no contact has a mobility" in outcome.error


def test_scenes_come_back_from_their_files(tmp_path: Path) -> None:
    for case in CASES.values():
        for name, part in case.parts.items():
            file = tmp_path / "scene.yaml"
            file.write_text(yaml.safe_dump(part.content))
            again, first = load_scene(file), parse_scene(part.content, "scene")
            assert again.step_count == first.step_count <= 1000
            for one, other in zip(again.bodies, first.bodies, strict=True):
                assert np.array_equal(one.position, other.position), (case.name, name)
                assert np.array_equal(one.linear_velocity, other.linear_velocity)


def test_changed_lists_have_the_contacts_of_the_service() -> None:
    scene = parse_scene(CASES["lists"].parts["shuffled"].content, "lists")._replace(duration=0.01)
    contacts = run_in_lockstep(factory_of("own"), scene).contacts[1]
    mixed, fewer, more = shuffled(contacts), thinned(contacts._replace(step=UNTOUCHED)), with_bare_pairs(contacts)
    assert not np.array_equal(mixed.contact_ids, contacts.contact_ids)
    assert sorted(mixed.contact_ids) == sorted(contacts.contact_ids)
    assert np.diff(contacts.pair_begin)[0] == 2 * np.diff(fewer.pair_begin)[0] > 4
    assert thinned(contacts) is contacts and set(fewer.contact_ids) < set(contacts.contact_ids)
    assert (np.diff(more.pair_begin) == 0).sum() == 2 and np.array_equal(more.contact_ids, contacts.contact_ids)
    pairs = list(zip(more.fragment_a, more.fragment_b, strict=True))
    assert pairs == sorted(pairs)


def test_rotation_vectors_are_those_of_the_quaternions() -> None:
    for vector in ([0.3, -0.2, 0.9], [1e-9, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 3.1, 0.0]):
        angle = float(np.linalg.norm(vector))
        axis = np.array(vector) / max(angle, 1e-300)
        quaternion = np.append(np.sin(0.5 * angle) * axis, np.cos(0.5 * angle))
        assert rotation_vectors(matrices(quaternion[None]))[0] == pytest.approx(vector, abs=1e-12)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["mujoko"], "did you mean mujoco?"),
        (["no_such_package:make"], "no module 'no_such_package'"),
        (["fracture_collision.simulation.engines:dynamic_of"], "did you mean dynamics_of?"),
        (["--case", "slop"], "did you mean slope?"),
        (["--node", "true"], "has no {scene}"),
        (["--node", "no_such_simulator {scene}"], "no_such_simulator: no such command"),
        (["own", "--node", "true {scene}"], "not both"),
        (["builtins:dict"], "the factory raised TypeError"),
    ],
)
def test_bad_input_is_explained(arguments: list[str], words: str) -> None:
    result = CliRunner().invoke(main, ["check-solver", *arguments])
    assert result.exit_code == 2 and words in result.output, result.output


def test_what_is_no_dynamics_is_named() -> None:
    scene = parse_scene(CASES["flight"].parts["throw"].content, "throw")
    with pytest.raises(UnknownSolver, match="a dict, without add, remove"):
        run_in_lockstep(lambda scene, looks_ahead: {}, scene)  # type: ignore[arg-type, return-value]


def test_the_command_tells_what_fails_and_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules[__name__], "make_drifting", Drifting.made, raising=False)
    solver = f"{__name__}:make_drifting"
    result = CliRunner().invoke(main, ["check-solver", solver, "--case", "drift"])
    assert result.exit_code == 1, result.output
    assert "FAIL" in result.output and "correct poses in a solve of their own" in result.output
    result = CliRunner().invoke(main, ["check-solver", "--case", "drift"])
    assert result.exit_code == 0 and "1 of 1 cases pass" in result.output


def test_the_list_has_all_cases_and_why_some_are_left_out() -> None:
    result = CliRunner().invoke(main, ["check-solver", "--list"])
    assert result.exit_code == 0
    assert all(name in result.output for name in CASES) and "impulses" in result.output


EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "simulator_node.py"
NODES = {
    "simulator_node": "simulator_node --ros-args -p scene:={scene} -p wait_for_subscribers:=2",
    "example": f"python {EXAMPLE} --ros-args -p scene:={{scene}} -p subscribers:=2",
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("node", "cases"),
    [
        ("simulator_node", ("flight", "fracture", "strength", "bytes", "floor_force")),
        ("example", ("core",)),
    ],
)
def test_a_node_passes(node: str, cases: tuple[str, ...]) -> None:
    chosen = [word for case in cases for word in ("--case", case)]
    result = CliRunner().invoke(main, ["check-solver", *chosen, "--node", NODES[node]])
    assert result.exit_code == 0, result.output
    assert ("left out: floor_force: a node does not publish impulses" in result.output) == ("floor_force" in cases)


@pytest.mark.slow
def test_a_node_that_ends_early_fails_with_its_last_words() -> None:
    command = "python -c \"raise SystemExit('cannot read {scene}')\""
    result = CliRunner().invoke(main, ["check-solver", "--case", "frames", "--node", command])
    assert result.exit_code == 1
    assert "the command ended with status 1" in result.output and "cannot read /" in result.output
