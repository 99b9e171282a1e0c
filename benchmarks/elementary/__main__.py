"""Whether the elementary scenes end as they should, in our simulator and others: `python -m benchmarks.elementary`."""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Callable, Iterable
from importlib import import_module

import click
from rich.console import Console
from rich.table import Table

from benchmarks.elementary.scenes import SCENES, Elementary, Setting, Trace, scene_of
from fracture_collision.simulation.scene.scene import Scene

ENGINES = {"ours": "ours", "rapier": "in_rapier", "mujoco": "in_mujoco"}  # modules beside this one

Run = Callable[[Scene, float, float], Trace]
Counts = dict[str, dict[str, list[bool]]]  # whether each run was right, by scene and engine


def load(name: str) -> Run:
    """What runs scenes in an engine. ClickException for an unknown one, and if its library is missing."""
    if name not in ENGINES:
        raise click.ClickException(f"--engines {name}: is none of {', '.join(ENGINES)}")
    try:
        return import_module(f"benchmarks.elementary.{ENGINES[name]}").run
    except ImportError as error:
        raise click.ClickException(f"--engines {name}: {error}; `make peers` installs the libraries") from error


def said_of(run: Run, name: str, elementary: Elementary, setting: Setting) -> str:
    """What is wrong with a run; "" if nothing is."""
    try:
        trace = run(scene_of(name, elementary, setting), setting.scale, setting.turn)
        return ", ".join(elementary.faults(trace))
    except ArithmeticError as error:
        return repr(error)


def table_of(rights: Counts, engines: Iterable[str]) -> Table:
    """How many runs were right, by scene and engine."""
    table = Table("scene", *engines, title="right, of all runs")
    for name, of_scene in rights.items():
        table.add_row(name, *(_share(of_scene[engine]) for engine in engines))
    table.add_section()
    everything = ([right for of_scene in rights.values() for right in of_scene[engine]] for engine in engines)
    table.add_row("total", *map(_share, everything))
    return table


def _share(right: list[bool]) -> str:
    return f"{sum(right)} of {len(right)}"


@click.command(context_settings={"max_content_width": 120})
@click.option("--only", default="", help="Scenes whose names contain this.")
@click.option("--kinds", default="box,brick1,brick2", show_default=True, help="The first for scenes without kinds.")
@click.option("--scales", default="1", show_default=True)
@click.option("--steps", default="2.5", show_default=True, help="[ms] at scale 1.")
@click.option("--turns", default="0", show_default=True, help="[degrees] of the whole scene about the vertical axis.")
@click.option("--engines", default="ours", show_default=True, help=f"Of {', '.join(ENGINES)}.")
def main(only: str, kinds: str, scales: str, steps: str, turns: str, engines: str) -> None:
    """Runs the elementary scenes and says which end as they should."""
    runs = {name: load(name) for name in engines.split(",")}
    numbers = itertools.product(*([float(number) for number in each.split(",")] for each in (scales, steps, turns)))
    settings = [(scale, 1e-3 * step, turn) for scale, step, turn in numbers]
    rights: Counts = defaultdict(lambda: defaultdict(list))
    for name, elementary in SCENES.items():
        if only not in name:
            continue
        of_scene = kinds.split(",") if elementary.has_kinds else kinds.split(",")[:1]
        for kind, (scale, step, turn) in itertools.product(of_scene, settings):
            for engine, run in runs.items():
                said = said_of(run, name, elementary, Setting(kind, scale, step, turn))
                rights[name][engine].append(not said)
                click.echo(f"{name:32} {kind:9} {scale:<6g} {1e3 * step:<4g} {turn:<4g} {engine:7} {said or 'right'}")
    Console().print(table_of(rights, list(runs)))


if __name__ == "__main__":
    main()
