"""Breaks tetrahedral bodies: functions that make the FractureEvents that `CollisionWorld.add_fracture` accepts.

    voronoi   into the Voronoi cells of seeds, with flat or curved cracks
    planes    along planes
    labels    as a label for each node says

All of them take a body, one of its fragments and the events so far, and return one event. Lengths are in metres, in the
body frame. Pieces follow the mesh: each node belongs to one fragment, each part of a cell that mesh edges connect is a
fragment of its own, and a part without a node goes to its neighbours (the virtual-node rule: Molino, Bao, Fedkiw 2004).
So does a part thinner than a thousandth of an edge.
"""

from fracture_collision.fracture.breaking import labels, planes, voronoi

__all__ = ["labels", "planes", "voronoi"]
