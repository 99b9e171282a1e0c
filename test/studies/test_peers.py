"""The harness for comparison with other libraries: truth, scores, meshes; needs none of these libraries."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from benchmarks.peers import methods as registry
from benchmarks.peers.judging.score import FrameTruth, Score, score
from benchmarks.peers.judging.truth import Solids
from benchmarks.peers.libraries.ours import Ours
from benchmarks.peers.libraries.vertex_distances import Exact, NodeField
from benchmarks.peers.measure import Row, measure
from benchmarks.peers.method import Contacts, Method, contacts_of, no_contacts
from benchmarks.peers.report import ratios, write_csv
from benchmarks.peers.worlds import EDGES, Frame, Surface, World, break_body, volume
from fracture_collision.geometry.generators import ball, brick
from fracture_collision.geometry.tetrahedra import boundary_triangles, tetrahedron_volumes
from fracture_collision.world.fragment_mesh import THIN

OVERLAP = 0.01  # [m]
TIP = np.array([0.5, 0.2, 0.1])  # a point of the first block's face towards the second


@pytest.fixture(scope="module")
def blocks() -> Solids:
    """Two subdivided cubes of side 1 m, centred at the origin."""
    body = brick((1.0, 1.0, 1.0), 0.25)
    surface = Surface(body.vertices, boundary_triangles(body.tetrahedra).astype(np.int64))
    return Solids([surface, surface])


def placed(second: tuple[float, float, float]) -> Frame:
    """The first block at the origin, the other elsewhere."""
    positions = np.array([(0.0, 0.0, 0.0), second])
    unturned = np.tile([0.0, 0.0, 0.0, 1.0], (2, 1))
    return Frame("jitter", positions, np.tile(np.eye(3), (2, 1, 1)), unturned, positions)


def judged(solids: Solids, frame: Frame, answer: Contacts) -> Score:
    return score(solids, [FrameTruth(frame, solids.truth(frame), {(0, 1)}, {})], [answer])


def one_contact(depth: float, normal: tuple[float, float, float] = (1.0, 0.0, 0.0)) -> Contacts:
    return contacts_of([0], [1], TIP, TIP - depth * np.array(normal), normal, [depth])


def test_truth_of_a_known_penetration(blocks: Solids) -> None:
    # the second block's outline also lies within the first one's face, so that vertices of both are inside
    frame = placed((1.0 - OVERLAP, 0.05, 0.05))
    ((pair, true),) = blocks.truth(frame).items()
    assert pair == (0, 1)
    assert true.depth == pytest.approx(OVERLAP, abs=1e-9)
    np.testing.assert_allclose(true.nearest, (1.0, 0.0, 0.0), atol=1e-6)
    np.testing.assert_allclose(true.parting, (1.0, 0.0, 0.0), atol=0.05)


def test_wrong_depth_direction_and_witness_are_measured(blocks: Solids) -> None:
    got = judged(blocks, placed((1.0 - OVERLAP, 0.05, 0.05)), one_contact(3 * OVERLAP, (0.0, 1.0, 0.0)))
    assert got.error_mean == pytest.approx(2 * OVERLAP, abs=1e-9)
    assert got.nearest_median == pytest.approx(90.0, abs=1e-3)
    assert got.nearest_wrong == 1.0
    assert got.witness_max == pytest.approx(OVERLAP, abs=1e-9)  # the second's: it lies on the first's face, inside


def test_pairs_with_penetrating_samples_are_counted_separately(blocks: Solids) -> None:
    one, two = blocks.surfaces
    frame = placed((1.0 - OVERLAP, 0.05, 0.05))
    for point, seen in ((TIP, 1), (np.array([0.0, 0.0, 0.5]), 0)):
        got = judged(Solids([one, two], [point[None], np.zeros((0, 3))]), frame, no_contacts())
        assert (got.missed, got.samples_penetrating, got.samples_missed) == (1, seen, seen)


def test_a_contact_of_blocks_apart_is_false(blocks: Solids) -> None:
    got = judged(blocks, placed((1.0 + OVERLAP, 0.0, 0.0)), one_contact(OVERLAP))
    assert (got.penetrating, got.apart, got.false) == (0, 1, 1)
    got = judged(blocks, placed((1.0 + OVERLAP, 0.0, 0.0)), one_contact(0.001))  # within the allowed error
    assert (got.apart, got.false) == (1, 0)


def test_bars_that_cross_without_a_vertex_inside_are_not_apart() -> None:
    along, across = brick((4.0, 1.0, 1.0), 9.0), brick((1.0, 4.0, 1.0), 9.0)
    bars = Solids([Surface(b.vertices, boundary_triangles(b.tetrahedra).astype(np.int64)) for b in (along, across)])
    crossed, apart = placed((0.3, 0.3, 0.9)), placed((0.3, 0.3, 1.1))
    assert bars.edges_cross(0, 1, crossed) and not bars.edges_cross(0, 1, apart)
    assert judged(bars, crossed, one_contact(0.1)).false == 0
    assert judged(bars, apart, one_contact(0.1)).false == 1


@pytest.fixture(scope="module", params=(False, True), ids=("flat", "curved"))
def world(request: pytest.FixtureRequest) -> World:
    seeds = np.random.default_rng(5).uniform(-0.6, 0.6, (5, 3))
    return break_body("ball5", ball(1.0, 0.35), seeds, request.param, EDGES)


def test_meshes_close_and_fill_the_body(world: World) -> None:
    whole = tetrahedron_volumes(world.body.vertices.reshape(-1, 3), world.body.tetrahedra.reshape(-1, 4)).sum()
    assert sum(volume(f.mesh) for f in world.fragments) == pytest.approx(whole, rel=1e-12)
    assert sum(volume(f.exact) for f in world.fragments) == pytest.approx(whole, rel=1e-6)  # single precision


def test_ours_and_exact_vertices_in_one_run(world: World, tmp_path: Path) -> None:
    rows = measure([world], [Ours("ours"), Exact(), NodeField()], repeats=1)
    ours, exact, field = rows
    assert not any(row.failure for row in rows)
    assert min(row.update for row in rows) > 0.0
    assert np.isnan(field.query["jitter"]) and not field.score
    for kind, frames in (("touch", 1), ("jitter", 5), ("pile", 3)):
        assert ours.query[kind] > 0.0
        assert ours.score[kind].penetrating + ours.score[kind].apart <= frames * 10
        assert ours.score[kind].false == 0
        assert exact.score[kind].missed == exact.score[kind].false == 0
    jitter = ours.score["jitter"]
    assert jitter.samples_penetrating > 5 and jitter.samples_missed == 0
    # the surfaces that are the truth lack edges and triangles thinner than THIN of 2 m: two may have been neighbours
    assert jitter.witness_max < 2.0 * THIN * 2.0
    assert ours.score["touch"].deepest < 1e-6
    assert exact.score["jitter"].error_max < 1e-9
    assert exact.score["jitter"].nearest_median < 1e-3
    named = {what for _, what, _ in ratios(rows)}
    assert named == {
        "update: full exact field (libigl) / ours", "jittered query: exact vertices (the faster) / ours",
        "ours: touching / jittered query",
    }  # fmt: skip
    write_csv(rows, tmp_path / "peers.csv")
    with (tmp_path / "peers.csv").open() as file:
        read = list(csv.DictReader(file))
    assert [line["method"] for line in read] == [row.method for row in rows]
    assert float(read[0]["jitter_query"]) == pytest.approx(ours.query["jitter"], rel=1e-5)
    assert read[0]["cpu"] and "numpy" in read[0]["versions"] and read[2]["jitter_missed"] == ""


@pytest.mark.parametrize("world", [False], ids=["flat"], indirect=True)
def test_a_failing_method_is_reported_and_contacts_without_a_direction_are_left_out(world: World) -> None:
    class Broken(Method):
        name = "broken"

        def update(self, world: World, before) -> None:
            raise RuntimeError("no such mesh")

    class Blind(Exact):
        name = "blind"

        def query(self, world: World, state, frame: Frame) -> Contacts:
            found = super().query(world, state, frame)
            return found._replace(normals=np.full_like(found.normals, np.nan))

    broken, field, blind, exact = measure([world], [Broken(), NodeField(), Blind(), Exact()], repeats=2)
    assert isinstance(broken, Row) and broken.failure == "RuntimeError: no such mesh"
    assert not field.failure and field.rounds == 2
    assert not blind.failure and blind.score["jitter"].contacts == 0.0
    assert blind.score["jitter"].missed == exact.score["jitter"].penetrating > 0


def test_a_library_that_cannot_be_imported_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    real = registry.import_module

    def without_others(name: str):
        if name.rsplit(".", 1)[1] not in ("ours", "vertex_distances"):
            raise ImportError(f"not here: {name}")
        return real(name)

    monkeypatch.setattr(registry, "import_module", without_others)
    found, missing = registry.all_methods(slow=False)
    assert {"ours", "exact vertices (libigl)"} <= {method.name for method in found}
    assert set(missing) == set(registry.FAMILIES) - {"ours", "vertex_distances"}
