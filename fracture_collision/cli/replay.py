"""`fracture-collision replay`: replays a recorded run and compares its answers with those recorded."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from fracture_collision.cli.console import BadInput, Interruption, options_as
from fracture_collision.process.early_signals import INTERRUPTED

OTHERWISE = 1  # exit status: some answer differs from the recorded one
INCOMPLETE = 3  # exit status: some question has no answer in the bag, or some answer no question
UNANSWERED = 4  # exit status: some question cannot be answered

EXAMPLES = """\b
Examples:
  fracture-collision replay out/smash/bag                  all steps, as fast as possible
  fracture-collision replay out/smash/bag --ros            ... by a separate collision_node, over DDS
  fracture-collision replay out/smash/bag --steps 160:200  from step 160 to before step 200
  fracture-collision replay out/smash/bag --steps 300:     from the middle on
  fracture-collision replay out/smash/bag --backwards --loop 3 --threads 8
  fracture-collision replay out/smash/bag --rate 0.5       at half the recorded pace
  fracture-collision replay bag --settings contacts_per_pair=6   for a bag without settings

\b
Exit status: 0: all answers equal the recorded ones; 1: some differ; 2: not a bag, or no run in it; 3: all that could be
compared are equal, but the bag lacks answers, or the states of some answers; 4: a step cannot be answered, as the bag
lacks bodies or fracture events before it, or the service failed. 1 takes precedence over 3.
"""


class NothingCompared(click.ClickException):
    """The bag has no answer to any of the replayed questions."""

    exit_code = INCOMPLETE


class NotAnswered(click.ClickException):
    """A question that cannot be answered."""

    exit_code = UNANSWERED


class StepRange(click.ParamType):
    """A:B as (A, B), each an int or None."""

    name = "A:B"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """(first, end), None where a side is empty; a usage error unless both are whole numbers >= 0."""
        if not isinstance(value, str):
            return value
        first, colon, end = value.partition(":")
        try:
            numbers = tuple(int(part) if part else None for part in (first, end))
        except ValueError:
            numbers = (-1,)
        if not colon or any(number is not None and number < 0 for number in numbers):
            self.fail(f"{value!r}: pass A:B, from step A to before step B; either may be left out", param, ctx)
        return numbers


class PlayOptions(NamedTuple):
    """Which questions are asked, in what order and how fast."""

    rate: float | None  # times the recorded pace; None: as fast as possible
    steps: tuple[int | None, int | None] | None  # from the first to before the second; None: no limit
    backwards: bool
    loops: int


@click.command(epilog=EXAMPLES)
@click.argument("bag", type=click.Path(exists=True, path_type=Path))
@click.option("--ros", is_flag=True, help="Query a separate collision_node, over DDS.")
@click.option(
    "--rate", type=click.FloatRange(min=0.0, min_open=True),
    help="Multiple of the recorded pace, unless answers take longer.  [default: as fast as possible]",
)  # fmt: skip
@click.option(
    "--threads", type=click.IntRange(min=0), default=0, show_default=True,
    help="Threads of the service; 0: one per core.",
)  # fmt: skip
@click.option("--steps", type=StepRange(), help="From step A to before step B.  [default: all]")
@click.option("--backwards", is_flag=True, help="Play the last step first.")
@click.option("--loop", "loops", type=click.IntRange(min=1), default=1, show_default=True, help="Number of plays.")
@click.option(
    "--settings", multiple=True, metavar="NAME=VALUE[,...]",
    help="Settings of the service, in place of the recorded ones; may be given several times.",
)  # fmt: skip
@click.option("--namespace", help="Namespace of the topics, for a bag with several services.")
@options_as(PlayOptions)
def replay(
    bag: Path, ros: bool, threads: int, settings: tuple[str, ...], namespace: str | None, options: PlayOptions
) -> None:
    """Repeat the queries of BAG and compare the answers with the recorded ones, byte for byte.

    BAG is a rosbag2 folder or one .mcap file, recorded by recorder_node or `ros2 bag record`, which may have been
    killed. The service gets bodies, fracture events and states as they were recorded. Prints one SHA-256 over all
    answers, by step, which does not depend on order, pace, number of plays and number of threads; the first number
    that differs from the recording, if any does; and the times that answers took.
    """
    console = Console()
    interruption = Interruption(console, "stopped before the first step")
    # Imported late: --help should not wait for numba.
    from fracture_collision.bag.exchanges import answers_missing, read_runs
    from fracture_collision.bag.mcap_file import BagError
    from fracture_collision.bag.reader import missing_words
    from fracture_collision.cli.scene import parse_settings
    from fracture_collision.replay import Order, Replay, Unanswered, settings_of

    played: Any = None
    try:
        words = missing_words(bag)
        runs = read_runs(bag, namespace)
        try:
            found = settings_of(bag, {**parse_settings(settings), "threads": threads}, namespace)
        except BagError:
            raise
        except ValueError as error:
            raise click.UsageError(str(error)) from error
        order = Order(*(options.steps or (None, None)), options.backwards, options.loops)
        for sentence in (*words, *found.words):
            console.print(f"note: {sentence}", highlight=False, soft_wrap=True)
        # A node must be stopped in order; loading kernels into this process may be cut short.
        with (
            interruption.held() if ros else nullcontext(),
            _service(ros, found.settings, console, interruption.check) as (service, refusals),
        ):
            played = Replay(runs, service, order, options.rate, interruption.check)
            with _bar(console) as bar, interruption.held():
                task = bar.add_task("replaying", total=played.total)
                for done in played:
                    bar.update(task, completed=done)
                    interruption.check()
    except KeyboardInterrupt:
        done, total = (played.report().answers, played.total) if played else (0, "all")
        console.print(f"stopped after {done} of {total} steps")
        if played:
            _tell(played.report(), refusals, console)
        sys.exit(INTERRUPTED)
    except BagError as error:
        raise BadInput(str(error)) from error
    except Unanswered as error:
        raise NotAnswered(str(error)) from error
    _tell(played.report(), refusals, console)
    if not played.report().exact:
        sys.exit(OTHERWISE)
    if not played.report().compared:
        raise NothingCompared(f"nothing was compared: {answers_missing(bag, namespace)}")
    if not played.report().complete:
        sys.exit(INCOMPLETE)


@contextmanager
def _service(
    ros: bool, settings: Any, console: Console, wait: Callable[[], None]
) -> Iterator[tuple[Any, dict[str, str]]]:
    """The service that answers, and the messages it rejects."""
    with ExitStack() as stack:
        if ros:
            from fracture_collision.ros.runs.replay_run import OverDds

            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="replay_")))
            with console.status("starting collision_node; after a change of the sources this takes minutes"):
                service: Any = stack.enter_context(OverDds(settings, folder / "collision_node.log", wait))
            yield service, {}
            return
        from fracture_collision.replay import InProcess
        from fracture_collision.world.warm_up import compile_kernels

        with console.status("loading kernels; after a change of the sources this takes minutes"):
            compile_kernels(progress=lambda _: None)
        service = InProcess(settings)
        yield service, service.refusals


def _bar(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("steps"), TimeElapsedColumn(),
        console=console,
    )  # fmt: skip


def _tell(report: Any, refusals: dict[str, str], console: Console) -> None:
    def say(text: str) -> None:
        console.print(text, highlight=False, soft_wrap=True)

    if not report.answers:
        return
    say(f"{report.digest}  {report.steps} steps")
    for kind, reason in refusals.items():
        say(f"rejected: {kind}: {reason}")
    if report.contradicted:
        say(f"{_count(report.contradicted)} answered in two ways in this replay, first step {report.contradicted[0]}")
    if report.recorded_twice:
        say(f"{_count(report.recorded_twice)} answered in two ways in the bag, first step {report.recorded_twice[0]}")
    if report.differing:
        words = f"{report.differing} of {report.compared} answers differ from the recorded ones"
        say(f"{words}; the first: {report.difference.words()}")
    elif report.compared:
        say(f"all {report.compared} answers equal the recorded ones, byte for byte")
    if report.unrecorded:
        say(f"the bag has no answer to {report.unrecorded} of these steps")
    if report.unasked:
        steps = "1 step" if len(report.unasked) == 1 else f"{len(report.unasked)} steps"
        say(f"the bag has answers, but no states, of {steps}, first step {report.unasked[0]}")
    milliseconds = 1e3 * report.seconds
    say(f"time per answer: {np.median(milliseconds):.2f} ms median, {milliseconds.max():.2f} ms worst")


def _count(steps: list[int]) -> str:
    return "1 step was" if len(steps) == 1 else f"{len(steps)} steps were"
