"""Direction of contacts between neighbours: along the nearest way out, or along the crack the two share.

    python benchmarks/rims.py [body ...]

Default: all bodies, and the plot docs/rims.png.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "test")]  # the ground truth lives with the tests

from rich.console import Console  # noqa: E402
from rich.progress import track  # noqa: E402
from truth.rims import BrokenBody, broken_body, jittered, measure, world_of  # noqa: E402

from fracture_collision.geometry.generators import (  # noqa: E402
    TetGeometry,
    ball,
    bowl,
    brick,
    plate,
    shell,
    torus,  # noqa: E402
)
from fracture_collision.records import FragmentStates  # noqa: E402
from fracture_collision.world import Settings  # noqa: E402

BODIES: dict[str, Callable[[], TetGeometry]] = {
    "ball": lambda: ball(1.0, 0.15),
    "shell": lambda: shell(1.0, 0.85, 0.16),
    "torus": lambda: torus(1.0, 0.4, 0.14),
    "plate": lambda: plate(2.0, 0.2, 0.2, 0.1),
    "bowl": lambda: bowl(2.0, 0.2, 0.25, 0.6),
    "coarse brick": lambda: brick((2.0, 1.0, 0.8), 0.2),
    "coarse ball": lambda: ball(1.0, 0.35),
}
PIECES, FRAMES = 20, 8
PLOTTED = ("ball", "shell", "torus")
DEEPER = Settings().penetration_tolerance
LEGEND = f"""
{PIECES} cells; {FRAMES} frames, each fragment moved by up to 1 % R and turned by up to 1 degree; contacts between
neighbours deeper than {DEEPER} R. off: share with a normal more than 30 degrees off the crack that the pattern drew;
opposed: of pairs of contacts nearer than 0.1 R, the share whose normals point against each other; turn: median and 99 %
of the angle between the normals of such a pair, true: between the crack's own directions there. Each first with normals
`nearest`, then with `crack`. deeper: depth along the crack less that along the nearest way, mean and largest, in R.
in place: share off of all contacts with every fragment where it was. time: of a frame, crack / nearest, medians.
"""


def main(names: list[str]) -> None:
    cells = ("contacts", "off", "", "opposed", "", "turn", "", "true", "deeper", "in place", "", "time")
    print(_line("body", "cracks", *cells), flush=True)
    angles: dict[tuple[str, bool], tuple[np.ndarray, np.ndarray]] = {}
    cases = [(name, curved) for name in names for curved in (False, True)]
    for name, curved in track(cases, "rims", console=Console(stderr=True)):
        row, angles[name, curved] = _row(broken_body(BODIES[name](), PIECES, curved))
        print(_line(name, "curved" if curved else "flat", *row), flush=True)
    print(LEGEND)
    if set(PLOTTED) <= set(names):
        _plot(angles)


def _plot(angles: dict[tuple[str, bool], tuple[np.ndarray, np.ndarray]]) -> None:
    """Share of contacts whose direction deviates from the crack's by more than an angle."""
    figure, panels = plt.subplots(1, 2, figsize=(9.0, 3.6), sharey=True)
    for panel, curved in zip(panels, (False, True), strict=True):
        for name, colour in zip(PLOTTED, ("tab:blue", "tab:orange", "tab:green"), strict=True):
            for way, off, style in zip(("nearest", "facing"), angles[name, curved], ("--", "-"), strict=True):
                panel.plot(np.sort(off), 100.0 * (1.0 - np.arange(len(off)) / len(off)), style, color=colour,
                           label=f"{name}, {way}")  # fmt: skip
        panel.axvline(30.0, color="grey", linewidth=0.8)
        panel.set(title=f"{'curved' if curved else 'flat'} cracks", xlabel="degrees off the crack's direction",
                  xlim=(0.0, 180.0), ylim=(0.005, 100.0), yscale="log")  # fmt: skip
    panels[0].set_ylabel("contacts farther off [%]")
    panels[1].legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(ROOT / "docs/rims.png", dpi=100)


def _row(broken: BrokenBody) -> tuple[list[str], tuple[np.ndarray, np.ndarray]]:
    settings = Settings(threads=1, selection="complete")
    worlds = [world_of(broken, settings._replace(normals=normals)) for normals in ("nearest", "facing")]
    frames = [jittered(broken, worlds[0], 0.01, 1.0, seed) for seed in range(FRAMES)]
    at_rest = [jittered(broken, worlds[0], 0.0, 0.0, 0)]
    nearest, crack = (measure(broken, world, frames, DEEPER) for world in worlds)
    rest = [measure(broken, world, at_rest, -np.inf).off for world in worlds]
    depths = [np.concatenate([-world.contacts(states).gaps for states in frames]) for world in worlds]
    extra = (depths[1] - depths[0])[depths[0] > 0.0] / (0.5 * broken.longest)
    turns = [f"{np.median(m.apart):.0f}/{np.quantile(m.apart, 0.99):.0f}" for m in (nearest, crack)]
    true = f"{np.median(crack.apart_in_truth):.0f}/{np.quantile(crack.apart_in_truth, 0.99):.0f}"
    row = [
        str(len(crack.angles)), f"{nearest.off:.1%}", f"{crack.off:.2%}",
        f"{nearest.opposed:.2%}", f"{crack.opposed:.3%}",
        *turns, true, f"{extra.mean():.4f}/{extra.max():.3f}", f"{rest[0]:.0%}", f"{rest[1]:.1%}",
        f"{_ratio(worlds, frames):.2f}",
    ]  # fmt: skip
    return row, (nearest.angles, crack.angles)


def _ratio(worlds, frames: list[FragmentStates]) -> float:
    """A frame's median time in the second world over that in the first, interleaved."""
    times = np.empty((2, 3 * len(frames)))
    for i in range(times.shape[1]):
        for k, world in enumerate(worlds):
            start = time.perf_counter()
            world.contacts(frames[i % len(frames)])
            times[k, i] = time.perf_counter() - start
    medians = np.median(times, axis=1)
    return float(medians[1] / medians[0])


def _line(body: str, cracks: str, *cells: str) -> str:
    return f"{body:13}{cracks:7}" + "".join(f"{cell:>13}" for cell in cells)


if __name__ == "__main__":
    unknown = set(sys.argv[1:]) - set(BODIES)
    if unknown:
        sys.exit(f"{', '.join(sorted(unknown))}: none of {', '.join(BODIES)}")
    main(sys.argv[1:] or list(BODIES))
