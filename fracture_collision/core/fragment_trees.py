"""The sphere trees of the fragments that a fracture makes, in the three ways that Glondu 2014, section 7.3 compares.

RESTRUCTURED: split, restructured and extended (6.2, 6.3). PLAIN: split without regard to the maximum-distance order, as
in the paper's earlier version, its reference [27]. REBUILT: built from nothing on the samples of the new surface. A
rebuilt tree has no interior nodes, so the next fracture builds again from the mesh and its cut edges. The body before
its first fracture has the same tree in all three.

Samples of a body are numbered: its n mesh nodes, then two for each mesh edge, n + 2 edge + side.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.core.sphere_tree import SphereTree, build_sphere_tree
from fracture_collision.core.sphere_tree_split import split_sphere_tree
from fracture_collision.core.tet_mesh import TetMesh

RESTRUCTURED = "restructured"
PLAIN = "plain"
REBUILT = "rebuilt"
TREES = (RESTRUCTURED, PLAIN, REBUILT)


def split_trees(
    old: SphereTree, mesh: TetMesh, part_of_node: np.ndarray, edges: np.ndarray, share: np.ndarray, count: int,
    ordered: bool,
) -> list[SphereTree]:  # fmt: skip
    """RESTRUCTURED (`ordered`) or PLAIN trees of parts 0 .. count - 1, from the tree `old` of what broke.

    part_of_node (n,) int32, -1: another fragment's; edges (k,): mesh edges that this fracture cuts, ascending; share
    (mesh edges, 2): where crack samples stand, see fracture_update.crack_samples. Centres of `old` may be moved.
    """
    n = len(mesh.nodes)
    at_crack = old.sample >= n
    node = old.sample.copy()
    node[at_crack] = mesh.edges[(old.sample[at_crack] - n) // 2, (old.sample[at_crack] - n) % 2]
    # samples of older cracks stand where the new ones left them
    points = _edge_points(mesh, old.sample[at_crack], share)
    moved = bool((points != old.center[at_crack]).any())
    if moved:
        old.center[at_crack] = points
    samples = (n + 2 * np.asarray(edges, dtype=np.int32)[:, None] + np.arange(2, dtype=np.int32)).ravel()
    parents = mesh.edges[edges].ravel()
    return split_sphere_tree(
        old, part_of_node[node], count, moved, _edge_points(mesh, samples, share), samples, parents,
        part_of_node[parents], ordered,
    )  # fmt: skip


def rebuilt_trees(mesh: TetMesh, part_of_node: np.ndarray, share: np.ndarray, count: int) -> list[SphereTree]:
    """REBUILT trees of parts 0 .. count - 1; arguments as in split_trees."""
    n = len(mesh.nodes)
    nodes = np.flatnonzero((part_of_node >= 0) & (mesh.on_surface != 0))
    edge, side = np.nonzero(np.isfinite(share))
    cracks = n + 2 * edge + side
    samples = np.concatenate([nodes, cracks]).astype(np.int32)
    points = np.vstack([mesh.nodes[nodes], _edge_points(mesh, cracks, share)])
    part = part_of_node[np.concatenate([nodes, mesh.edges[edge, side]])]
    by_part = np.argsort(part, kind="stable")
    trees = []
    for own in np.split(by_part, np.searchsorted(part[by_part], np.arange(1, count))):
        tree = build_sphere_tree(points[own], np.ones(len(own), np.uint8))
        trees.append(tree._replace(sample=samples[own][tree.sample]))
    return trees


def _edge_points(mesh: TetMesh, samples: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Positions (q, 3) [m] of crack samples: the share of their edge from their own end."""
    edge, side = (samples - len(mesh.nodes)) // 2, (samples - len(mesh.nodes)) % 2
    own, far = mesh.nodes[mesh.edges[edge, side]], mesh.nodes[mesh.edges[edge, 1 - side]]
    return own + share[edge, side][:, None] * (far - own)
