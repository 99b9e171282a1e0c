"""All methods and settings in a world with curved and one with flat cracks; ours at other resolutions of that body."""

from __future__ import annotations

import re

import numpy as np

from benchmarks.peers.libraries.ours import Ours, setting_methods
from benchmarks.peers.libraries.ours_settings import RESOLUTION, named
from benchmarks.peers.measure import Progress, Row, measure
from benchmarks.peers.method import EXACT, Contacts, Method, no_contacts
from benchmarks.peers.methods import all_methods
from benchmarks.peers.worlds import DRAWS, SHELL_INNER, Frame, World, break_body, clustered_seeds, make_world
from benchmarks.speed_error.points import SILENT
from fracture_collision.geometry.generators import TetGeometry
from fracture_collision.geometry.sampled_bodies import sampled_ball, sampled_shell

QUICK_WORLDS, FULL_WORLDS = ("shell20w", "shell20"), ("ball20w", "ball20", "shell20w", "shell20")
# Frequencies of the outer surface in addition to that of `make_world`; with curved cracks, the fine one's truth takes
# minutes.
COARSE, FINE = 6, 16
# Slow methods that complete the picture; the other slow ones run only with all methods.
QUICK_TOO = ("mujoco v-hacd", "grids 24^3", "newton mesh")
# The same answers as another method, but slower; and no contact at all between two meshes, as with Silent.
LEFT_OUT = ("pybullet hull, by pairs", "pybullet concave")


class Silent(Method):
    """Reports nothing: its errors are the reference for the others'."""

    name = SILENT
    surface = EXACT

    def update(self, world: World, before: None) -> None:
        pass

    def query(self, world: World, state: None, frame: Frame) -> Contacts:
        return no_contacts()


def measure_all(quick: bool, repeats: int, progress: Progress) -> tuple[list[Row], dict[str, str]]:
    """Rows as in `benchmarks.peers`, and what is missing as in its `all_methods`."""
    peers, missing = all_methods()
    methods = [*setting_methods(), Silent(), *(peer for peer in peers if _is_wanted(peer, quick))]
    rows: list[Row] = []
    for name in QUICK_WORLDS if quick else FULL_WORLDS:
        progress(f"{name}: fracture and surfaces")
        world = make_world(name)
        rows += measure([world], methods, repeats, progress)
        for frequency in (COARSE,) if quick and world.is_curved else (COARSE, FINE):
            progress(f"{name}: the same at frequency {frequency}")
            row = Ours(named(RESOLUTION, frequency))
            rows += measure([resampled(world, frequency)], [row], repeats, progress)
    return rows, missing


def _is_wanted(peer: Method, quick: bool) -> bool:
    if isinstance(peer, Ours) or not peer.answers or peer.name in LEFT_OUT:
        return False
    return not quick or peer.is_quick or peer.name in QUICK_TOO


def resampled(world: World, frequency: int) -> World:
    """The same body, sampled with `frequency` on its outer surface and alike elsewhere, broken by the same seeds."""
    kind, count = re.fullmatch(r"(ball|shell)(\d+)w?", world.name).groups()
    inner = SHELL_INNER if kind == "shell" else 0.0
    seeds = _seeds_of(world, inner, int(count))
    return break_body(world.name, _body(inner, frequency), seeds, world.is_curved, world.mesher)


def _body(inner: float, frequency: int) -> TetGeometry:
    """As in make_world, whose frequencies are 11 for the ball, 10 and 7 for the shell, with 4,000 points inside."""
    if not inner:
        return sampled_ball(1.0, frequency, round(4000 * (frequency / 11) ** 3))
    return sampled_shell(1.0, inner, frequency, round(0.7 * frequency), round(4000 * (frequency / 10) ** 3))


def _seeds_of(world: World, inner: float, count: int) -> np.ndarray:
    """The draw of seeds (count, 3) [m] that make_world used.

    It is the first draw, or with flat cracks the first whose cells are the fragments.
    """
    vertices = world.body.vertices.reshape(-1, 3)
    for draw in range(1, DRAWS):
        seeds = clustered_seeds(vertices, inner, count, draw)
        if world.is_curved or all(_is_in_one_cell(f.nodes + f.centre, seeds) for f in world.fragments):
            return seeds
    raise ValueError(f"{world.name}: no draw of seeds has these fragments for cells")


def _is_in_one_cell(nodes: np.ndarray, seeds: np.ndarray) -> bool:
    nearest = np.argmin(np.linalg.norm(nodes[:, None] - seeds[None], axis=2), axis=1)
    return bool(np.all(nearest == nearest[0]))
