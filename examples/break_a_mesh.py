"""Breaks a mesh in eight, 1 mm deep in a floor, and prints the contacts of its fragments: `break_a_mesh.py [FILE]`."""

import sys

from fracture_collision.fracture import voronoi
from fracture_collision.meshing import read_mesh
from fracture_collision.share import share_directory
from fracture_collision.world import CollisionBody, CollisionWorld, FragmentStates

file = sys.argv[1] if len(sys.argv) > 1 else share_directory() / "config" / "meshes" / "bunny.npz"
mesh = read_mesh(file, longest_side=0.2)  # [m], about the origin
body = CollisionBody(body_id=1, fragment_id=1, vertices=mesh.vertices, tetrahedra=mesh.tetrahedra, density=2500.0)
event = voronoi(body, seeds=8, random=5, curvature=0.2, first_new_id=10)
world = CollisionWorld()
world.add_body(body)
world.add_body(CollisionBody(body_id=2, fragment_id=2, plane=(0.0, 0.0, 1.0, 0.0), is_static=True))
world.add_fracture(event)

ids, height = event.new_fragment_ids, -0.001 - mesh.vertices[:, 2].min()
contacts = world.contacts(FragmentStates(1, 1, ids, [(0.0, 0.0, height)] * len(ids), [(0.0, 0.0, 0.0, 1.0)] * len(ids)))
for pair in contacts.pairs():
    gaps, bound = 1e3 * pair.gaps, 1e3 * pair.missed_depth_bound
    found = f"{len(gaps)} contacts, deepest gap {min(gaps):.3f} mm; unlisted to {bound:.3f} mm"
    print(f"fragments {pair.a} and {pair.b}: {found}")
