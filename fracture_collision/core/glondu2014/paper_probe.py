"""penetration(p) of Glondu 2014, section 4.4: by the averaged field inside broken bodies, exact everywhere else."""

from __future__ import annotations

from fracture_collision.core.field.elementary_queries import INSIDE, Probe, bounded_probe, inside_tetrahedron
from fracture_collision.core.field.flood import NO_SOURCE
from fracture_collision.core.glondu2014.averaged_field import averaged_penetration
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.kinds import TETRAHEDRA
from fracture_collision.core.memory.pools import NEVER_BROKEN


@query_kernel
def paper_probe(pools, paper, f, point, near, deep, scratch):
    """elementary_queries.bounded_probe of a point (x, y, z) [m] in fragment `f`'s frame, with the field of PaperPools.

    The averaged field has no error bound: most_depth, which has, is then more than minus the distance.
    """
    fragment = pools.fragment
    if paper.is_averaged and fragment.kind[f] == TETRAHEDRA and fragment.node_shift[f] != NEVER_BROKEN:
        x, y, z = point
        t = inside_tetrahedron(pools, f, x, y, z)
        if t >= 0:
            d, nx, ny, nz, most = averaged_penetration(pools, paper.field, f, t, x, y, z)
            return Probe(INSIDE, -d, nx, ny, nz, x + d * nx, y + d * ny, z + d * nz, most, NO_SOURCE, -1, t)
    return bounded_probe(pools, f, point, near, deep, -1, False, scratch)
