"""What a depth camera sees of a mesh that has burst: `depth_camera.py [FILE]` writes depth.png (extra: viewer)."""

import sys

import matplotlib.pyplot as plt
import numpy as np

from fracture_collision.fracture import voronoi
from fracture_collision.meshing import read_mesh
from fracture_collision.share import share_directory
from fracture_collision.world import CollisionBody, CollisionWorld, FragmentStates

WIDTH, HEIGHT, FOCAL_LENGTH = 320, 240, 300.0  # [pixels]
EYE, FARTHEST = np.array([0.15, -0.38, 0.12]), 0.6  # [m]

file = sys.argv[1] if len(sys.argv) > 1 else share_directory() / "config" / "meshes" / "bunny.npz"
mesh = read_mesh(file, longest_side=0.2)  # [m], about the origin
body = CollisionBody(body_id=1, fragment_id=1, vertices=mesh.vertices, tetrahedra=mesh.tetrahedra, density=2500.0)
event = voronoi(body, seeds=12, random=5, curvature=0.2, first_new_id=10)
world = CollisionWorld()
world.add_body(body)
world.add_body(CollisionBody(body_id=2, fragment_id=2, plane=(0.0, 0.0, 1.0, 0.13), is_static=True))
world.add_fracture(event)

# each fragment a third of its way out from the middle
ids = event.new_fragment_ids
registry = world.fragments()
centers = registry.centers_of_mass[np.searchsorted(registry.fragment_ids, ids)]
states = FragmentStates(1, 1, ids, centers / 3.0, [(0.0, 0.0, 0.0, 1.0)] * len(ids))

forward = -EYE / np.linalg.norm(EYE)
right = np.cross(forward, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(forward, [0.0, 0.0, 1.0]))
x, y = np.meshgrid(np.arange(WIDTH) - 0.5 * (WIDTH - 1), np.arange(HEIGHT) - 0.5 * (HEIGHT - 1))
rays = FOCAL_LENGTH * forward + x[..., None] * right + y[..., None] * np.cross(forward, right)
hits = world.cast_rays(states, np.tile(EYE, (WIDTH * HEIGHT, 1)), rays.reshape(-1, 3))
depths = hits.distances * FOCAL_LENGTH / np.linalg.norm(rays, axis=2).ravel()  # along the axis, as cameras measure them

image = np.minimum(depths, FARTHEST).reshape(HEIGHT, WIDTH)
plt.imsave("depth.png", image, cmap="viridis_r", vmin=image.min(), vmax=FARTHEST)
seen = np.unique(hits.fragment_ids[hits.fragment_ids >= 10])
print(f"depth.png: {len(seen)} of {len(ids)} fragments, {depths[hits.fragment_ids >= 10].min():.3f} m away the nearest")
