"""`fracture-collision check-solver`: tests a contact solver, or a simulator node, against closed forms."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import inf
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from fracture_collision.cli.console import BadInput, Interruption
from fracture_collision.process.early_signals import INTERRUPTED

FAILS = 1  # exit status

EXAMPLES = """\b
Examples:
  fracture-collision check-solver                          the package's own solver
  fracture-collision check-solver mujoco                   MuJoCo's
  fracture-collision check-solver my_package.solver:make   yours, in this process
  fracture-collision check-solver mujoco --case slope --case rest
  fracture-collision check-solver --list                   all cases, and what each tests
  fracture-collision check-solver --node "simulator_node --ros-args -p scene:={scene} -p wait_for_subscribers:=2"
  fracture-collision check-solver --node "./my_simulator {scene}" --case core   what any simulator must pass

\b
A solver of yours in this process: `make(scene, looks_ahead)` returns a Dynamics, see
fracture_collision/simulation/dynamics.py. A node of yours: it reads the scene file {scene}, publishes the bodies, then
the states of each step, waits for the contacts of each, and ends after the scene's last step. docs/solvers.md has the
protocol.

\b
Exit status: 0: all cases pass; 1: some fail; 2: no such solver, case or command.
"""


@click.command("check-solver", epilog=EXAMPLES)
@click.argument("solver", required=False)
@click.option("--case", "names", multiple=True, metavar="NAME", help="Only this case; may be given several times. "
              "core: those that need neither bounces, nor fracture, nor long stacks.")  # fmt: skip
@click.option(
    "--node", "command", metavar="COMMAND", help="A command that simulates the scene file {scene} over topics."
)
@click.option("--list", "is_list", is_flag=True, help="List the cases and end.")
def check_solver(solver: str | None, names: tuple[str, ...], command: str | None, is_list: bool) -> None:
    """Test a contact SOLVER against closed forms: own (default), mujoco, or package.module:function.

    Each case is a short scene with a known result: a block on a slope, a stack, a blow that must just break a brick.
    The service of this package finds the contacts, the solver solves them. Prints each figure with the exact value and
    the bound, and for each failure its likely cause.

    With --node a simulator node of any language is tested: the service and a recorder run on a ROS domain of their own,
    the command runs each scene, and its recorded states are judged. Cases that no topic shows are left out.
    """
    console = Console()
    interruption = Interruption(console, "stopped")
    # Imported late: --help should not wait for numba.
    from fracture_collision.extras import MissingExtra
    from fracture_collision.solver_check.cases import CASES
    from fracture_collision.solver_check.check import Outcome, check_case
    from fracture_collision.solver_check.solver_runs import UnknownSolver

    if solver is not None and command is not None:
        raise BadInput(f"pass either a solver ({solver}) or --node, not both")
    chosen = [CASES[name] for name in _known(names)]
    if is_list:
        table = Table("case", "what it tests", "with --node")
        for case in chosen:
            table.add_row(case.name, case.title, "yes" if not case.not_by_node else f"no: {case.not_by_node}")
        console.print(table)
        return
    left_out = [case for case in chosen if command is not None and case.not_by_node]
    chosen = [case for case in chosen if case not in left_out]
    outcomes: list[Outcome] = []
    try:
        with _runner(solver or "own", command, interruption.check) as run, interruption.held():
            for number, case in enumerate(chosen):
                with console.status(f"{number + 1} of {len(chosen)}: {case.name}") as status:
                    def shown(name: str, part: Any, at: int = number, line: Any = status) -> Any:
                        line.update(f"{at + 1} of {len(chosen)}: {name}")
                        return run(name, part)

                    outcomes.append(check_case(case, shown))
                if not outcomes[-1].left_out:
                    _tell(console, outcomes[-1])
                interruption.check()
    except (UnknownSolver, MissingExtra) as error:
        raise BadInput(str(error)) from error
    except KeyboardInterrupt:
        console.print(f"stopped after {len(outcomes)} of {len(chosen)} cases", highlight=False)
        sys.exit(INTERRUPTED)
    reasons = {case.name: case.not_by_node for case in left_out}
    reasons |= {outcome.case.name: outcome.left_out for outcome in outcomes if outcome.left_out}
    outcomes = [outcome for outcome in outcomes if not outcome.left_out]
    console.print(_summary(outcomes))
    for name, reason in reasons.items():
        console.print(f"left out: {name}: {reason}", highlight=False, soft_wrap=True)
    failed = [outcome.case.name for outcome in outcomes if not outcome.passes]
    words = f"{len(outcomes) - len(failed)} of {len(outcomes)} cases pass"
    console.print(words + (f"; failed: {', '.join(failed)}" if failed else ""), highlight=False, soft_wrap=True)
    if failed:
        sys.exit(FAILS)


def _known(names: tuple[str, ...]) -> list[str]:
    """The cases named, in their order; all if none is. Raises BadInput."""
    from fracture_collision.near_names import did_you_mean
    from fracture_collision.solver_check.cases import CASES

    core = [case.name for case in CASES.values() if case.is_core]
    wanted: set[str] = set()
    for name in names:
        if name not in CASES and name != "core":
            hint = did_you_mean(name, [*CASES, "core"])
            raise BadInput(f"--case: no case {name!r}{hint or ';'} `fracture-collision check-solver --list` lists all")
        wanted.update(core if name == "core" else [name])
    return [name for name in CASES if name in wanted or not names]


@contextmanager
def _runner(solver: str, command: str | None, check: Callable[[], None]) -> Iterator[Callable[[str, Any], Any]]:
    """Yields what runs a part of a case. Raises BadInput, UnknownSolver, MissingExtra."""
    from fracture_collision.simulation.scene.scene import parse_scene

    if command is None:
        from fracture_collision.solver_check.solver_runs import factory_of, run_in_lockstep

        factory = factory_of(solver)
        yield lambda name, part: run_in_lockstep(
            factory, parse_scene(part.content, name), part.change, part.strike, check
        )
        return
    from fracture_collision.ros.runs.solver_run import BadCommand, command_words, run_node

    try:
        command_words(command, Path("scene.yaml"))
    except BadCommand as error:
        raise BadInput(f"--node: {error}") from error
    with tempfile.TemporaryDirectory(prefix="check_solver_") as folder:
        yield lambda name, part: run_node(command, part, name, Path(folder), check)


def _summary(outcomes: list[Any]) -> Table:
    """A row for each case, with the figure that comes closest to its bound, or is farthest beyond."""
    table = Table("case", "", "figures", "closest to its bound", "share of the bound")
    for outcome in outcomes:
        mark = "[green]pass[/]" if outcome.passes else "[red]FAIL[/]"
        closest, share = "-", "-"
        if outcome.figures:
            most = max(outcome.figures, key=lambda figure: inf if figure.share != figure.share else figure.share)
            closest, share = escape(most.what), f"{most.share:.2g}"
        table.add_row(outcome.case.name, mark, str(len(outcome.figures)), closest, share)
    return table


def _tell(console: Console, outcome: Any) -> None:
    """The figures of a case, and the likely causes of failures."""
    mark = "[green]pass[/]" if outcome.passes else "[red]FAIL[/]"
    console.print(f"[bold]{outcome.case.name}[/] {mark}: {escape(outcome.case.title)}", highlight=False, soft_wrap=True)
    table = Table()
    for column in ("", "measured", "exact", "bound", ""):
        table.add_column(column, justify="right" if column else "left")
    for figure in outcome.figures:
        passes = "" if figure.bound is None else "pass" if figure.passes else "[red]FAIL[/]"
        exact, bound = ("-" if x is None else f"{x:.5g}" for x in (figure.exact, figure.bound))
        table.add_row(escape(figure.what), f"{figure.measured:.5g}", exact, bound, passes)
    if outcome.figures:
        console.print(table)
    if outcome.error:
        console.print(f"  [red]{escape(outcome.error)}[/]", highlight=False, soft_wrap=True)
    causes = {figure.cause: figure.what for figure in reversed(outcome.figures) if not figure.passes}
    for cause, what in reversed(causes.items()):
        console.print(f"  {escape(what)}: likely cause: {escape(cause)}", highlight=False, soft_wrap=True)
