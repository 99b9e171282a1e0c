"""surfaces: searched. No point of either surface is deeper than the answer's bound; crossing edges are contacts."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree
from truth.contact_truth import COARSE_SHAPES, SHAPES
from truth.surface_campaign import SEARCHED, PairDepth, campaign
from worlds.fractured_worlds import FracturedWorld, fractured_world, with_settings
from worlds.rods import OVERLAP, answer_of_rods, crossed, rod_of

from fracture_collision.core.mesh.surface_elements import ElementTable
from fracture_collision.core.mesh.surface_triangles import surface_triangles
from fracture_collision.records import FragmentStates
from fracture_collision.world import CollisionWorld, Settings

QUICK = {name: COARSE_SHAPES[name] for name in ("brick", "l_block", "torus")}


def assert_holds(judged: list[PairDepth]) -> None:
    assert not [it for it in judged if it.violates or it.is_missed or it.is_too_shallow]


def test_no_point_of_a_surface_is_deeper_than_the_bound() -> None:
    judged = list(campaign(120, 3, QUICK, generations=1))
    assert len(judged) >= 120
    assert_holds(judged)


def test_samples_alone_miss_some_penetrations() -> None:
    """Otherwise the test above could not fail."""
    sampled = SEARCHED._replace(surfaces="sampled")
    judged = list(campaign(120, 3, {"brick": QUICK["brick"]}, generations=1, settings=sampled))
    assert any(it.is_too_shallow for it in judged)


@pytest.mark.slow
@pytest.mark.timeout(14_400)
def test_no_point_of_ten_thousand_pairs_is_deeper_than_the_bound() -> None:
    assert_holds(list(campaign(10_000, 1, SHAPES)))


@pytest.mark.parametrize("kind", ["box", "tetrahedra", "triangles"])
def test_crossed_rods_have_a_contact_normal_to_both_edges(kind: str) -> None:
    states = crossed(-OVERLAP, 0.011)
    assert not (answer_of_rods(kind, Settings(threads=1, surfaces="sampled"), states).gaps < 0.0).any()
    answer = answer_of_rods(kind, Settings(threads=1, surfaces="searched"), states)
    (k,) = np.flatnonzero(answer.gaps < 0.0)
    np.testing.assert_allclose(answer.normals[3 * k : 3 * k + 3], [0.0, 0.0, 1.0], atol=1e-9)
    # the point is at the crossing of the edges, to a tenth of epsilon
    assert answer.gaps[k] == pytest.approx(-OVERLAP, abs=2e-4)
    np.testing.assert_allclose(answer.points_a[3 * k : 3 * k + 2], [0.011, 0.0], atol=2e-4)
    assert answer.missed_depth_bound[0] >= OVERLAP


@pytest.mark.parametrize("kind", ["box", "tetrahedra", "triangles"])
def test_rods_that_do_not_touch_have_no_contact(kind: str) -> None:
    answer = answer_of_rods(kind, Settings(threads=1, surfaces="searched"), crossed(0.003, 0.011))
    assert len(answer.gaps) == 0 and len(answer.fragment_a) == 0


def test_the_contact_keeps_its_id_while_the_rods_move() -> None:
    world = CollisionWorld(Settings(threads=1, surfaces="searched"))
    for body_id in (1, 2):
        world.add_body(rod_of("box", body_id))
    answers = [world.contacts(crossed(-OVERLAP, beside)) for beside in (0.010, 0.011, 0.012)]
    assert len({int(it.contact_ids[np.argmin(it.gaps)]) for it in answers}) == 1


@pytest.fixture(scope="module")
def case() -> FracturedWorld:
    return fractured_world(COARSE_SHAPES["torus"](), 6, 2, curved=True)


def wandering(case: FracturedWorld, steps: int) -> list[FragmentStates]:
    """States from one jittered place to another, first slowly, then fast."""
    start, end = case.states(0.01, 1), case.states(0.02, 2)
    shares = np.concatenate([np.linspace(0.0, 0.05, steps // 2), np.linspace(0.1, 1.0, steps - steps // 2)])
    return [
        start._replace(
            step=k + 1, positions=start.positions + share * (end.positions - start.positions),
        )
        for k, share in enumerate(shares)
    ]  # fmt: skip


def test_answers_do_not_depend_on_earlier_steps_or_threads(case: FracturedWorld) -> None:
    settings = Settings(threads=1, surfaces="searched")
    remembering = with_settings(case, settings)
    in_threads = with_settings(case, settings._replace(threads=2))
    forgetting = with_settings(case, settings._replace(neighbour_lists=False))
    for states in wandering(case, 24):
        truth = forgetting.contacts(states)
        for world in (remembering, in_threads):
            for one, other in zip(world.contacts(states), truth, strict=True):
                assert np.asarray(one).tobytes() == np.asarray(other).tobytes()


def test_elements_hold_all_of_a_surface(case: FracturedWorld) -> None:
    pools = case.geometry.pools
    rows = np.array([case.row(f) for f in case.oracle.fragment_ids])
    elements = ElementTable().of(pools, rows)
    for row in rows.tolist():
        triangles, _ = surface_triangles(pools, row, case.geometry.tet_range(row))
        begin, end = elements.begin[row], elements.end[row]
        corners = elements.corners[elements.first[begin] : elements.first[end]] + elements.origin[row]
        away, _ = cKDTree(corners).query(triangles.reshape(-1, 3))
        assert away.max() <= 1e-6
        for e in range(begin, end):
            own = elements.corners[elements.first[e] : elements.first[e + 1]].astype(np.float64)
            away = np.linalg.norm(own - elements.spheres[e, :3], axis=1)
            assert away.max() <= elements.spheres[e, 3] + 1e-6


def test_the_averaged_field_is_rejected() -> None:
    with pytest.raises(ValueError, match="surfaces: 'searched' needs field 'exact'"):
        CollisionWorld(Settings(field="averaged", surfaces="searched"))
