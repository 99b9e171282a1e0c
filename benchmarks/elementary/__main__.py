"""Whether the elementary scenes end as they should: `python -m benchmarks.elementary`."""

from __future__ import annotations

import click

from benchmarks.elementary.ours import run
from benchmarks.elementary.scenes import SCENES, Setting, scene_of


@click.command(context_settings={"max_content_width": 120})
@click.option("--only", default="", help="Scenes whose names contain this.")
@click.option("--kinds", default="box,brick1,brick2", show_default=True)
@click.option("--scales", default="1", show_default=True)
@click.option("--steps", default="2.5", show_default=True, help="[ms] at scale 1.")
def main(only: str, kinds: str, scales: str, steps: str) -> None:
    """Runs the elementary scenes and says which end as they should."""
    total = wrong = 0
    for name, elementary in SCENES.items():
        if only not in name:
            continue
        for kind in kinds.split(","):
            for scale in map(float, scales.split(",")):
                for step in map(float, steps.split(",")):
                    setting = Setting(kind, scale, 1e-3 * step)
                    try:
                        trace = run(scene_of(name, elementary, setting), scale)
                        said = ", ".join(elementary.faults(trace))
                    except ArithmeticError as error:
                        said = repr(error)
                    total, wrong = total + 1, wrong + bool(said)
                    click.echo(f"{name:32} {kind:7} {scale:<6g} {step:<4g} {said or 'right'}")
    click.echo(f"{wrong} of {total} wrong")


if __name__ == "__main__":
    main()
