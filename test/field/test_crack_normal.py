"""Normals at cracks: against the slow twin, and against the direction of the pattern's cracks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from oracles.brute_force import distances
from oracles.crack_normal import SharedCrack
from truth.contact_truth import ContactTruth, Poses, pairs_of, sample_ids, surface_samples
from truth.rims import broken_body, jittered, measure, world_of
from worlds.fractured_worlds import SETTINGS, fractured_world, samples_of, with_settings
from worlds.sampled_worlds import EVERY, SampledWorld, in_order, sampled_world

from fracture_collision.core.mesh.sample_numbers import EDGES, NODES
from fracture_collision.geometry.generators import ball, brick, plate, shell, torus
from fracture_collision.records import ContactConstraintArray, FragmentStates
from fracture_collision.world import CollisionWorld, Settings

FACING = Settings(threads=1, contacts_per_pair=EVERY)  # of a SampledWorld
NEAREST = SETTINGS._replace(contacts_per_pair=EVERY)
SAME = 1e-9
BODIES = {
    "ball": lambda: ball(1.0, 0.2),
    "shell": lambda: shell(1.0, 0.85, 0.2),
    "torus": lambda: torus(1.0, 0.4, 0.18),
    "plate": lambda: plate(2.0, 0.2, 0.2, 0.1),
}


@pytest.mark.parametrize("cracks", ["flat", "curved"])
@pytest.mark.parametrize("shape", ["ball", "brick"])
def test_contacts_equal_those_of_the_slow_twin(shape: str, cracks: str) -> None:
    geometry = ball(1.0, 0.45) if shape == "ball" else brick((2.0, 1.0, 0.8), 0.4)
    case = fractured_world(geometry, seeds=5, generations=2, curved=cracks == "curved")
    near = FACING.detection_tolerance
    worlds = with_settings(case, NEAREST), sampled_world(case, FACING)
    shared: dict[tuple[int, int], SharedCrack] = {}
    turned = kept = 0
    # far enough to touch fragments that are not neighbours, near enough to touch cracks
    for seed, distance in enumerate((0.01, 0.05, 0.3)):
        states = case.states(distance, seed)
        poses = Poses(states)
        plain, answer = (in_order(world.contacts(states)) for world in worlds)
        assert np.array_equal(answer.contact_ids, plain.contact_ids)
        for (a, b), (rows, _) in pairs_of(answer).items():
            samples = _is_sample_of(case, a, b, answer.contact_ids[rows])
            for i, of_a in zip(range(rows.start, rows.stop), samples, strict=True):
                f, g = (b, a) if of_a else (a, b)
                at = (answer.points_a if of_a else answer.points_b).reshape(-1, 3)[i]
                x = poses.to_body(f, at[None])[0]
                sign = -1.0 if of_a else 1.0
                normal, before = (
                    sign * poses.rotation[f].T @ found.normals.reshape(-1, 3)[i] for found in (answer, plain)
                )
                if (f, g) not in shared:
                    shared[f, g] = SharedCrack(case.oracle, f, g)
                right = shared[f, g].turned(x, -float(plain.gaps[i]), near)
                if not right or any(np.isnan(r.depth) for r in right):
                    is_kept = np.array_equal(normal, before) and answer.gaps[i] == plain.gaps[i]
                    kept += is_kept
                    if not right:
                        assert is_kept
                        continue
                    if is_kept:
                        continue
                off = [max(np.abs(r.normal - normal).max(), abs(r.depth + answer.gaps[i])) for r in right]
                assert np.nanmin(off) < SAME, (a, b, i, right, normal, answer.gaps[i])
                turned += 1
    assert turned > 50 and kept > 20


def _is_sample_of(case, a: int, b: int, ids: np.ndarray) -> np.ndarray:
    return np.isin(ids, sample_ids(a, b, surface_samples(case, a)[1]))


@pytest.mark.parametrize("cracks", ["flat", "curved"])
@pytest.mark.parametrize("shape", BODIES)
def test_few_normals_point_away_from_the_crack(shape: str, cracks: str) -> None:
    broken = broken_body(BODIES[shape](), 16, cracks == "curved")
    worlds = world_of(broken, NEAREST), world_of(broken, FACING, SampledWorld)
    frames = [jittered(broken, worlds[0], 0.01, 1.0, seed) for seed in range(4)]
    deeper = FACING.penetration_tolerance
    is_corner = _corners_of(worlds[1])
    nearest = measure(broken, worlds[0], frames, deeper)
    crack = measure(broken, worlds[1], frames, deeper, lambda answer: ~is_corner(answer))
    corners = measure(broken, worlds[1], frames, deeper, is_corner)
    assert len(crack.angles) > 500
    assert nearest.off > 0.04  # rims are affected
    # where a curved crack bends within a tetrahedron, its edges' planes do not give one direction for all of it
    curved = cracks == "curved"
    assert crack.off < (0.06 if curved else 0.01)
    assert crack.opposed < (0.004 if curved else 0.001)
    # where three cracks meet, all are equally near
    assert len(corners.angles) > 500
    assert corners.off < (0.16 if curved else 0.025)
    assert corners.opposed < (0.04 if curved else 0.01)
    # for half of the pairs, normals turn hardly more than the crack itself
    assert np.median(crack.apart) <= np.median(crack.apart_in_truth) + (3.0 if curved else 2.0)
    assert np.quantile(crack.apart, 0.95) <= np.quantile(crack.apart_in_truth, 0.95) + (15.0 if curved else 10.0)


def _corners_of(world: CollisionWorld) -> Callable[[ContactConstraintArray], np.ndarray]:
    """Mask of the contacts whose samples are where three or more cracks meet."""
    mesh, fragments = world.geometry.pools.mesh.first[0], world.fragments().fragment_ids.tolist()
    count = len(fragments)
    in_place = FragmentStates(1, 1, np.array(fragments), np.zeros(3 * count), np.tile((0.0, 0.0, 0.0, 1.0), count))
    rows = world.present(in_place).rows
    ids = []
    for own, row in zip(fragments, rows.tolist(), strict=True):
        _, samples = samples_of(world.geometry, row)
        samples = np.unique(samples[samples >= mesh[NODES] + 2 * mesh[EDGES]])
        ids += [sample_ids(own, other, samples) for other in fragments if other != own]
    return lambda answer: np.isin(answer.contact_ids, np.concatenate(ids))


def test_fragments_in_place_touch_along_their_cracks() -> None:
    """All gaps are 0: there the nearest surface depends on rounding, but the crack's direction does not."""
    broken = broken_body(BODIES["shell"](), 16, curved=True)
    off = []
    for world in (world_of(broken, NEAREST), world_of(broken, FACING, SampledWorld)):
        off.append(measure(broken, world, [jittered(broken, world, 0.0, 0.0, 0)], -np.inf).off)
    assert off[0] > 0.1
    assert off[1] < 0.05


def test_witnesses_are_on_the_surface_and_no_contact_is_less_deep() -> None:
    case = fractured_world(shell(1.0, 0.8, 0.5), seeds=6, curved=True)
    truth, states = ContactTruth(case), case.states(0.02, 5)
    answer, plain = (
        in_order(world.contacts(states)) for world in (sampled_world(case, FACING), with_settings(case, NEAREST))
    )
    inside = plain.gaps < 0.0
    assert (answer.gaps[inside] <= plain.gaps[inside] + SAME).all()
    assert (answer.gaps[inside] < plain.gaps[inside] - SAME).any()
    poses = Poses(states)
    for (a, b), (rows, _) in pairs_of(answer).items():
        ids = answer.contact_ids[rows]
        of_a = _is_sample_of(case, a, b, ids)
        for other, points, mine in ((b, answer.points_b, of_a), (a, answer.points_a, ~of_a)):
            witness = poses.to_body(other, points.reshape(-1, 3)[rows][mine])
            assert distances(witness, truth.surface(other)).max(initial=0.0) < 1e-12
