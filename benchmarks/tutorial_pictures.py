"""Draws the pictures of docs/tutorial.md from the bodies and events that its code makes.

Usage: python -m benchmarks.tutorial_pictures [FOLDER], docs/ by default.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from benchmarks.snippets import DOCS, run
from fracture_collision.geometry.generators import shell
from fracture_collision.geometry.tetrahedra import boundary_triangles
from fracture_collision.records import CollisionBody, FractureEvent, FragmentStates
from fracture_collision.viewer.pictures.body_mesh import BodyMesh, mesh_of_body, mesh_of_fragment
from fracture_collision.viewer.pictures.palette import FAMILY_HUES, Palette, gap_colours
from fracture_collision.viewer.pictures.ray_picture import Camera, TriangleScene, render
from fracture_collision.world import CollisionWorld

WIDTH, HEIGHT, FINER = 420, 480, 2  # pixels; each is the mean of FINER^2
SPREAD = 0.45  # of the distance of a fragment from the body's middle, by which it is drawn apart
POINT = 0.0022  # [m] radius of a contact
SUN = np.array([-0.9, -0.1, 1.2])
Drawn = tuple[BodyMesh, np.ndarray, Any]  # a mesh, where it is drawn, its Paint


def spread(mesh: BodyMesh) -> np.ndarray:
    """Where to draw a fragment of a body about the origin so that its cracks are seen."""
    return SPREAD * mesh.centre


def fragments(body: CollisionBody, events: list[FractureEvent]) -> dict[int, BodyMesh]:
    """Meshes of the living fragments after `events`."""
    world = CollisionWorld()
    world.add_body(body)
    for event in events:
        world.add_fracture(event)
    world.contacts(FragmentStates(1, len(events), [], [], []))
    return {i: mesh_of_fragment(world.fragment_mesh(i)) for i in world.fragments().fragment_ids.tolist()}


def picture(drawn: Iterable[Drawn], points: tuple[np.ndarray, np.ndarray] | None = None) -> Image.Image:
    """Meshes above the floor, and balls at points (n, 3) [m] with linear colours (n, 3)."""
    parts = [
        (mesh.triangles + place, mesh.normals, np.where(mesh.is_crack[:, None], paint.crack, paint.outside),
         np.where(mesh.is_crack, 0.0, paint.shine))
        for mesh, place, paint in drawn
    ]  # fmt: skip
    if points is not None:
        ball = shell(POINT, 0.9 * POINT, 0.3 * POINT, layers=1)
        mesh = BodyMesh(ball.vertices, boundary_triangles(ball.tetrahedra))
        count = len(mesh.triangles)
        parts += [
            (mesh.triangles + point, mesh.normals, np.tile(colour, (count, 1)), np.full(count, 0.3))
            for point, colour in zip(*points, strict=True)
        ]
    scene = TriangleScene(*map(np.concatenate, zip(*parts, strict=True)), ground_height=-0.165)
    camera = Camera(np.array([-0.68, 0.42, 0.28]), np.array([0.0, 0.0, -0.012]), 0.42)
    image = render(scene, camera, FINER * WIDTH, FINER * HEIGHT, SUN, samples=16)
    return Image.fromarray(image).resize((WIDTH, HEIGHT), Image.Resampling.LANCZOS)


def side_by_side(images: list[Image.Image], file: Path) -> None:
    """One picture of several, with a white line between them."""
    sheet = Image.new("RGB", (len(images) * (WIDTH + 4) - 4, HEIGHT), "white")
    for k, image in enumerate(images):
        sheet.paste(image, (k * (WIDTH + 4), 0))
    sheet.quantize(256, Image.Quantize.MEDIANCUT).save(file, optimize=True)


def main(folder: Path) -> None:
    """Run the tutorial in a temporary folder, and draw."""
    with tempfile.TemporaryDirectory() as scratch:
        os.chdir(scratch)
        names, _ = run(DOCS / "tutorial.md")
        os.chdir(folder)
    body, event, second = names["bunny"], names["event"], names["second"]
    palette = Palette()
    for family in range(len(FAMILY_HUES)):
        palette.add(body._replace(body_id=family))
    whole = [(mesh_of_body(body), np.zeros(3), palette.paint(1, 0))]
    once, twice = fragments(body, [event]), fragments(body, [event, second])
    views = [
        [(mesh, spread(mesh), palette.paint(i, i % len(FAMILY_HUES))) for i, mesh in living.items()]
        for living in (once, twice)
    ]  # fmt: skip
    side_by_side([picture(whole), *map(picture, views)], folder / "tutorial_fragments.png")

    contacts, height = names["contacts"], np.array([0.0, 0.0, names["height"]])
    repeat = np.diff(contacts.pair_begin.astype(int))
    points, colours = [], []
    for ids, witnesses in ((contacts.fragment_a, contacts.points_a), (contacts.fragment_b, contacts.points_b)):
        owner = np.repeat(ids, repeat)
        is_shard = np.isin(owner, list(once))
        places = np.array([spread(once[i]) for i in owner[is_shard].tolist()])
        points.append(witnesses.reshape(-1, 3)[is_shard] - height + places)
        colours.append(gap_colours(contacts.gaps[is_shard]) ** 2)
    with_points = picture(views[0], (np.concatenate(points), np.concatenate(colours)))
    side_by_side([with_points], folder / "tutorial_contacts.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else DOCS)
