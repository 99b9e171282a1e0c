"""Bodies whose surface and interior are sampled separately."""

import numpy as np
import pytest

from fracture_collision.core.mesh.connected_pieces import connected_pieces
from fracture_collision.geometry.sampled_bodies import sampled_ball, sampled_shell
from fracture_collision.geometry.tetrahedra import (
    boundary_triangles,
    tetrahedron_volumes,
    unique_edges,
)


@pytest.mark.parametrize(
    ("mesh", "triangles", "surface_volume"),
    [
        (sampled_ball(1.0, 11, 4000), 2420, 4.18),
        (sampled_ball(1.0, 11, 435), 2420, 4.18),
        (sampled_shell(1.0, 0.85, 10, 7, 4000), 2980, 1.62),
    ],
    ids=["ball 4000", "ball 435", "shell"],
)
def test_sampled_bodies_are_connected_and_closed(mesh, triangles, surface_volume):
    boundary = boundary_triangles(mesh.tetrahedra)
    assert len(boundary) == triangles
    volumes = tetrahedron_volumes(mesh.vertices, mesh.tetrahedra)
    assert volumes.min() > 1e-4 * volumes.mean()
    # the volume under the boundary, by the divergence theorem: no overlap, no hole
    a, b, c = mesh.vertices[boundary].transpose(1, 0, 2)
    assert np.isclose(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0, volumes.sum(), rtol=1e-12)
    assert abs(volumes.sum() - surface_volume) < 0.02 * surface_volume
    edges = unique_edges(mesh.tetrahedra)
    assert connected_pieces(edges, np.zeros(len(mesh.vertices), dtype=np.int32)).max() == 0


def test_the_number_of_interior_points_is_as_requested():
    for wanted in (435, 4000):
        inside = np.linalg.norm(sampled_ball(2.0, 11, wanted).vertices, axis=1) < 2.0 - 1e-9
        assert abs(inside.sum() - wanted) <= 0.03 * wanted


def test_equal_arguments_give_equal_bytes():
    first, again = sampled_ball(1.0, 4, 100), sampled_ball(1.0, 4, 100)
    assert first.vertices.tobytes() == again.vertices.tobytes()
    assert first.tetrahedra.tobytes() == again.tetrahedra.tobytes()


def test_invalid_arguments_are_rejected_with_an_explanation():
    with pytest.raises(ValueError, match="inner_radius"):
        sampled_shell(1.0, 1.0, 4, 4, 10)
    with pytest.raises(ValueError, match="radius"):
        sampled_ball(-1.0, 4, 10)
