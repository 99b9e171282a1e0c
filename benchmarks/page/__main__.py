"""`python -m benchmarks.page`: latency from a published fracture to its fragments in a browser, and frame rate.

Service, live simulator and page are the processes that `fracture-collision play` starts. The first client draws
nothing and only receives what a browser would; the second is a Chromium without a GPU, on the nodes' machine.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from itertools import cycle
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import click
import yaml

from benchmarks.page.lookers import Looker, browser, taker
from benchmarks.page.person import PATIENCE, PLATES, Fracture, Person, scene_played, throw_at
from campaigns.soak import processor_seconds
from fracture_collision.share import share_directory

AFTERWARDS = 1.5  # [s] until everything caused by a ball has arrived
DRAWN = 1.0  # [s] in which the last arrivals are drawn, before the next ball flies
FRAGMENTS = 200
BALLS = 1.0  # [s] between two balls
WATCHED = 10.0  # [s] at most: the page sends no frames of fragments at rest
REST = 1.0e-3  # [J] all fragments together: in the end some forty kilograms creep by millimetres a second
ASKED_MS, ASKED_PICTURES = 100.0, 30.0

Look = Callable[[str], AbstractContextManager[Looker]]


class Busy(NamedTuple):
    """A scene whose material breaks into more than 200 pieces."""

    scene: str
    material: str
    fracture: dict[str, Any]  # overrides the scene's values
    aims: tuple[Sequence[float], ...] = ()  # [m] targets of successive balls: shards soon come to rest


LYING = tuple((x, y, z - 0.07) for x, y, z in PLATES)
BUSY = (
    Busy("bricks", "clay", {"minimum_mass": 0.5}),
    Busy("plates", "porcelain", {"minimum_mass": 0.01, "pattern": {"seeds": 60}}, PLATES + LYING),
)


def measure_fractures(look: Look, rounds: int) -> tuple[list[float], list[float]]:
    """[ms] from each published fracture until the last of its meshes is received, and until it is drawn."""
    handed, shown = [], []
    with scene_played("plates") as (run, person), look(run.address) as looker:
        for _ in range(rounds):
            person.begin_again()
            person.fractures.clear()
            for plate in PLATES:
                throw_at(person, plate)
                person.wait(AFTERWARDS)
            _latencies(person.fractures, looker, handed, shown)
    return handed, shown


def _latencies(fractures: list[Fracture], looker: Looker, handed: list[float], shown: list[float]) -> None:
    """Only fragments that reached a page count: one that breaks again at once has no mesh."""
    meshes, pictures = looker.meshes(), looker.shown()
    for fracture in fractures:
        first = {}
        for mesh in meshes:
            if fracture.time < mesh.time < fracture.time + 2 * AFTERWARDS and mesh.fragment_id in fracture.fragment_ids:
                first.setdefault(mesh.fragment_id, mesh.time)
        if first:
            came = max(first.values())
            handed.append(1e3 * (came - fracture.time))
            # the last frame with new geometry that belongs to this fracture
            end = min((other.time for other in fractures if other.time > came), default=came + DRAWN)
            drawn = [moment for moment in pictures if came < moment < end] or [m for m in pictures if m > came][:1]
            if drawn:
                shown.append(1e3 * (drawn[-1] - fracture.time))


def measure_pictures(look: Look, busy: Busy) -> str:
    """From 200 fragments until they come to rest, which loads the machine as much as possible."""
    with (
        tempfile.TemporaryDirectory() as folder,
        scene_played(str(_scene_file(Path(folder), busy))) as (run, person),
        look(run.address) as looker,
    ):
        person.begin_again()
        balls = cycle(busy.aims)
        deadline = time.monotonic() + PATIENCE
        while person.status.fragments < FRAGMENTS:
            if time.monotonic() > deadline:
                raise RuntimeError(f"in vain: {FRAGMENTS} fragments")
            _throw_next(person, balls)
        looker.pictures()
        before, step = [processor_seconds(node.pid) for node in run.nodes], person.status.step
        end = time.monotonic() + WATCHED
        while time.monotonic() < end and _moves(person):
            _throw_next(person, balls)
        pictures, status = looker.pictures(), person.status
        used = [processor_seconds(node.pid) - b for node, b in zip(run.nodes, before, strict=True)]
    shares = ", ".join(
        f"{node.name} {100.0 * seconds / pictures.seconds:.0f} %" for node, seconds in zip(run.nodes, used, strict=True)
    )
    rate = pictures.count / pictures.seconds
    words = f"{busy.scene}: {rate:.1f} pictures a second (asked: {ASKED_PICTURES:.0f}) of {status.fragments} fragments"
    words += f" in {pictures.seconds:.1f} s"
    if pictures.moved:
        words += f", {pictures.moved:.0f} of them moving; {1e3 * used[-1] / pictures.count:.1f} ms of the page's"
        words += " processor time a picture"
    words += f"; {(status.step - step) / pictures.seconds:.0f} steps a second, {status.contacts} contacts"
    return f"{words}; of a core: {shares}"


def _scene_file(folder: Path, busy: Busy) -> Path:
    content = yaml.safe_load((share_directory() / "config" / "scenes" / f"{busy.scene}.yaml").read_text())
    own = content["materials"][busy.material]["fracture"]
    pattern = own["pattern"] | busy.fracture.get("pattern", {})
    content["materials"][busy.material]["fracture"] = own | busy.fracture | {"pattern": pattern}
    file = folder / f"{busy.scene}.yaml"
    file.write_text(yaml.safe_dump(content))
    return file


def _throw_next(person: Person, places: Iterator[Sequence[float]]) -> None:
    """Throws a ball at the next place, if any; then waits for BALLS, or until all fragments are at rest."""
    place = next(places, None)
    if place is not None:
        throw_at(person, place)
    end = time.monotonic() + BALLS
    person.until(lambda: time.monotonic() > end or not _moves(person), "time")


def _moves(person: Person) -> bool:
    return person.status.kinetic_energy > REST


def _words(times: list[float]) -> str:
    ordered = sorted(times)
    within = sum(t <= ASKED_MS for t in ordered)
    return (
        f"median {median(ordered):.0f} ms, nine of ten within {ordered[int(0.9 * (len(ordered) - 1))]:.0f} ms, worst"
        f" {ordered[-1]:.0f} ms; {within} of {len(ordered)} within {ASKED_MS:.0f} ms"
    )


@click.command(context_settings={"show_default": True, "help_option_names": ["-h", "--help"]})
@click.option("--rounds", default=5, type=click.IntRange(min=1), help="Of four plates smashed one after another.")
@click.option("--browser/--no-browser", "draws", default=True, help="Also with a Chromium that draws.")
def main(rounds: int, draws: bool) -> None:
    """Print how long new fragments take to a browser, and how many pictures a second it gets."""
    ways: list[tuple[str, Look]] = [("handed out, nobody draws", taker)]
    if draws:
        ways.append(("Chromium, drawn by software on the nodes' own processors", browser))
    for title, look in ways:
        click.echo(f"{title}:")
        handed, shown = measure_fractures(look, rounds)
        click.echo(f"  fracture published to meshes in the browser: {_words(handed)}")
        if shown:
            click.echo(f"  fracture published to shown: {_words(shown)}")
        for busy in BUSY:
            click.echo(f"  {measure_pictures(look, busy)}")


if __name__ == "__main__":
    main(prog_name="python -m benchmarks.page")
