"""Splitting, restructuring and extending a sphere tree (Glondu 2014, 6.2 and 6.3), one nested node at a time."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from fracture_collision.core.glondu2014.sphere_tree import SphereTree


class Node:
    def __init__(self, sample: int, center: tuple, on_surface: bool, children: list[Node]) -> None:
        self.sample, self.center, self.on_surface, self.children = sample, center, on_surface, children
        self.added: list[Node] = []

    def leaves(self) -> Iterator[Node]:
        for child in self.children:
            yield from child.leaves()
        if not self.children:
            yield self

    def take_point_of(self, other: Node) -> None:
        self.sample, self.center, self.on_surface = other.sample, other.center, other.on_surface

    def radius(self) -> float:
        reached = [*self.leaves(), *(q for node in self.everything() for q in node.added)]
        return max(_distance(self.center, node.center) for node in reached)

    def everything(self) -> Iterator[Node]:
        yield self
        for child in self.children:
            yield from child.everything()


def _distance(a: tuple, b: tuple) -> float:
    x, y, z = (i - j for i, j in zip(a, b, strict=True))
    return math.sqrt(x * x + y * y + z * z)


def nested(tree: SphereTree, entry: int = 0) -> Node:
    children, child = [], entry + 1
    while child < entry + tree.size[entry]:
        children.append(nested(tree, child))
        child += tree.size[child]
    return Node(int(tree.sample[entry]), tuple(tree.center[entry].tolist()), bool(tree.on_surface[entry]), children)


def flat(root: Node) -> SphereTree:
    nodes = list(root.everything())
    return SphereTree(
        np.array([n.center for n in nodes]),
        np.array([n.radius() for n in nodes]),
        np.array([len(list(n.everything())) for n in nodes]),
        np.array([n.sample for n in nodes]),
        np.array([n.on_surface for n in nodes]),
    )


def fragment_tree(
    old: Node, fragment_of: dict[int, int], fragment: int, new: list[tuple[int, tuple, int]], ordered: bool
) -> Node:
    """The tree of one fragment; new: (sample, point, sample it hangs under) of each point of its new surface."""
    root = _copy(old, fragment_of, fragment)
    assert root is not None
    _restructure(root, ordered)
    for sample, point, under in new:
        _insert(root, Node(sample, point, True, []), under, ordered)
    for node in list(root.everything()):
        if node.added and not node.children:
            node.children = [Node(node.sample, node.center, node.on_surface, [])]
        node.children, node.added = node.children + node.added, []
    return root


def _copy(node: Node, fragment_of: dict[int, int], fragment: int) -> Node | None:
    """Each splitting node replicated for the fragment; a copy with one child is left out."""
    if not node.children:
        own = fragment_of[node.sample] == fragment
        return Node(node.sample, node.center, node.on_surface, []) if own else None
    kept = [c for c in (_copy(child, fragment_of, fragment) for child in node.children) if c is not None]
    if len(kept) < 2:
        return kept[0] if kept else None
    return Node(node.sample, node.center, node.on_surface, kept)


def _restructure(node: Node, ordered: bool) -> None:
    lost = all(leaf.sample != node.sample for leaf in node.leaves())
    if lost and ordered:
        closest = min(node.leaves(), key=lambda leaf: _squared(leaf.center, node.center))
        branch = node
        while branch is not closest:
            branch.take_point_of(closest)
            branch = next(c for c in branch.children if any(leaf is closest for leaf in c.leaves()))
    for child in node.children:
        _restructure(child, ordered)
    if lost and not ordered:
        node.take_point_of(node.children[0])


def _insert(root: Node, new: Node, under: int, ordered: bool) -> None:
    branch = [root]
    while branch[-1].children:
        branch.append(next(c for c in branch[-1].children if any(leaf.sample == under for leaf in c.leaves())))
    at = len(branch) - 1
    while (
        ordered
        and at > 0
        and branch[at].radius() <= _distance(branch[-1].center, new.center)
        and branch[at - 1].sample == under
    ):
        at -= 1
    branch[at].added.append(new)


def _squared(p: tuple, q: tuple) -> float:
    """Squared distance, for comparisons: a square root could make two different values equal."""
    return (p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2
