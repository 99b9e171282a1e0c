"""The internals of collision detection on the page: sphere trees, the field on a plane, unlisted contacts.

Handlers.looking_inside supplies the data while a switch is on.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import trimesh
import viser

from fracture_collision.viewer.page.page_controls import on_update
from fracture_collision.viewer.page.page_events import InsideWanted, PlaneWanted
from fracture_collision.viewer.page.page_plots import Group, Plots
from fracture_collision.viewer.page.page_scene import SceneNodes, turned
from fracture_collision.viewer.page.server.page_stream import STILL, LiveValues

MILLI = 1e3
DEEPEST_LEVEL = 16  # of the slider: a tree of 2^16 points
MOST_SPHERES = 500  # drawn; more occlude each other and cost too much GPU time
ROUNDNESS = 2  # subdivisions of an icosahedron
SPHERE_OPACITY = 0.3
AXES = ("x", "y", "z")
# For a plane across each axis: the side of a run's initial camera. Fragments on that side occlude the plane and are
# hidden.
NEAR_SIDE = (1.0, -1.0, 1.0)
# World axes of the picture in a plane across each axis: right and down, so that up in the world is up in it.
RIGHT = np.array([[0.0, 1, 0], [1, 0, 0], [1, 0, 0]])
DOWN = np.array([[0.0, 0, -1], [0, 0, -1], [0, -1, 0]])
SHARED_COLOUR = np.array([235, 20, 20])  # inside two fragments at once
LINES = 6  # of equal depth, approximately
DARKEST = 0.35  # share of the surface colour, at the deepest point
DARKER_BAND = 0.85  # share of brightness of every other band
UNTURNED = np.array([1.0, 0.0, 0.0, 0.0], dtype=np.float32)  # quaternion w x y z
NOTHING = np.zeros((1, 1, 4), dtype=np.uint8)  # a picture

PLOTS: tuple[Group, ...] = (
    ("contacts: listed, and all that collide", ("contacts", "colliding")),
    ("unlisted penetration, mm", ("promised_mm", "unlisted_mm")),
)


class Spheres(NamedTuple):
    """Bounding spheres of one level of the fragments' sphere trees."""

    level: int
    deepest: int  # level of all trees
    fragment_ids: np.ndarray  # (n,)
    centres: np.ndarray  # (n, 3) [m] body frame
    radii: np.ndarray  # (n,) [m]; 0: a single sample, not drawn


class PlanePicture(NamedTuple):
    """Depths at the middles of the cells of a grid in a plane across a world axis."""

    axis: int
    place: float  # [m] along the axis
    corner: np.ndarray  # (2,) [m] lower corner of the grid, along the other two axes in order
    cell: float  # [m] edge
    owners: np.ndarray  # (rows, columns) fragment ids; negative: none. Columns go along the first of the two axes
    depths: np.ndarray  # (rows, columns) [m]
    shared: np.ndarray  # (rows, columns) bool: inside two fragments at once


class InsideFigures(NamedTuple):
    """An answer compared with all contacts at the same states."""

    time: float  # [s] simulated
    contacts: int  # listed
    colliding: int  # contacts without a limit
    unlisted_mm: float  # deepest penetration that is not listed, and deeper than what is of its pair
    promised_mm: float  # depth that the missed depth bounds allow to be unlisted
    collision_ms: float | None  # time of an answer
    is_replayed: bool = False  # computed by a copy of the service, because the paused scene makes no queries


class InsideView(NamedTuple):
    """None: not wanted, or empty."""

    spheres: Spheres | None = None
    plane: PlanePicture | None = None
    figures: InsideFigures | None = None


class Inside:
    """The switches and what they show. One thread at a time, except for the switches."""

    def __init__(
        self,
        server: viser.ViserServer,
        live: LiveValues,
        scene: SceneNodes,
        asks: Callable[[InsideWanted], None],
        changed: Callable[[], None],
    ) -> None:
        """On each change of the switches, `asks` is called with the request, then `changed`."""
        self._server, self._live, self._scene = server, live, scene
        self._view = InsideView()
        self._wanted = InsideWanted()
        self._spheres: Spheres | None = None  # received
        self._drawn: Spheres | None = None  # those of them that are drawn
        self._positions: np.ndarray | None = None  # (n, 3) [m] world, of the drawn ones, last sent
        self._colours = np.zeros((0, 3))  # of the drawn ones
        self._plane: PlanePicture | None = None  # shown in the picture
        gui = server.gui
        with gui.add_folder("Inside the service"):
            self._trees = gui.add_checkbox("sphere trees", False, hint="Bounding spheres of one level of all trees.")
            self._level = gui.add_slider("level", 0, DEEPEST_LEVEL, 1, 2)
            self._cut = gui.add_checkbox(
                "field on a plane", False,
                hint="Exact depths inside the fragments. Those that the plane cuts, or that hide it, are not drawn.",
            )  # fmt: skip
            self._axis = gui.add_dropdown("across", AXES, initial_value=AXES[1])
            self._share = gui.add_slider(
                "place", 0.0, 1.0, 0.01, 0.5,
                hint="From one end of the movable bodies to the other, as they were when the plane was switched on.",
            )  # fmt: skip
            self._count = gui.add_checkbox(
                "colliding points", False, hint="Counts all contacts that an answer without limits would list."
            )
            self._errors = gui.add_checkbox(
                "errors of answers", False,
                hint="The penetration that the service's settings leave unlisted; its times are plotted above.",
            )  # fmt: skip
            self._words = gui.add_markdown("")

        def told(_value: object) -> None:
            self._wanted = self._asked_for()
            asks(self._wanted)
            changed()

        for knob in (self._trees, self._level, self._cut, self._axis, self._share, self._count, self._errors):
            on_update(knob, told)
        self._balls, self._picture = _add_balls(server), _add_picture(server)
        self._plots: Plots  # by add_plots
        self._said = ""

    def add_plots(self) -> None:
        """Add the plots at the current place of the panel, hidden until switched on."""
        # drawn at once: rows are rare, and this may be the last
        self._plots = Plots(self._server.gui, PLOTS, visible=False, interval=0.0)

    def _asked_for(self) -> InsideWanted:
        return InsideWanted(
            int(self._level.value) if self._trees.value else None,
            PlaneWanted(AXES.index(self._axis.value), float(self._share.value)) if self._cut.value else None,
            self._count.value,
            self._errors.value,
        )

    def clear(self) -> None:
        """Reset for the next run."""
        self._view = InsideView()
        self._plots.clear()
        self.draw(None)

    def draw(self, view: InsideView | None) -> None:
        """`view` None: redraw the previous one, after a switch changed. Hides what is no longer wanted."""
        if view is not None:
            self._view = view
            if view.figures is not None:
                self._plots.add(view.figures)
        wanted, shown = self._wanted, self._view
        self._view = shown = InsideView(
            shown.spheres if wanted.level is not None else None,
            shown.plane if wanted.plane is not None else None,
            shown.figures if wanted.compares else None,
        )
        self._plots.show((wanted.colliding, wanted.errors))
        if shown.figures is not None:
            self._plots.draw()
        self._draw_spheres(shown.spheres)
        self._draw_plane(shown.plane)
        words = "\n\n".join(_words_of(shown, wanted))
        if words != self._said:
            self._words.content = self._said = words

    # --- sphere trees ----------------------------------------------------------------------------------------------

    def _draw_spheres(self, spheres: Spheres | None) -> None:
        if spheres is not self._spheres:
            self._spheres, self._drawn = spheres, None if spheres is None else _largest(spheres)
            self._positions = None
        self.move()

    def move(self) -> None:
        """Move the spheres with their fragments."""
        if self._drawn is None:
            self._balls.visible = False
            return
        poses = self._scene.poses
        ids = self._drawn.fragment_ids.tolist()
        here = np.array([fragment_id in poses for fragment_id in ids], dtype=bool)
        pose = np.array([poses[fragment_id] for fragment_id in ids if fragment_id in poses]).reshape(-1, 7)
        positions = pose[:, :3] + turned(self._drawn.centres[here], pose[:, 3:])
        before, self._positions = self._positions, positions
        if before is None or before.shape != positions.shape:
            colour = {fragment_id: self._scene.colour(fragment_id) for fragment_id in set(ids)}
            self._colours = np.array([colour[f] for f in ids]).reshape(-1, 3)[here]
        elif np.all(np.abs(positions - before) < STILL):
            self._positions = before
            return
        if len(positions):
            self._live.properties(
                self._balls.name,
                batched_positions=positions.astype(np.float32),
                batched_wxyzs=np.tile(UNTURNED, (len(positions), 1)),
                batched_scales=self._drawn.radii[here].astype(np.float32),
                batched_colors=(255.0 * self._colours).astype(np.uint8),
            )
        self._balls.visible = len(positions) > 0

    # --- the field on a plane --------------------------------------------------------------------------------------

    def _draw_plane(self, plane: PlanePicture | None) -> None:
        if plane is self._plane:
            return
        self._plane = plane
        self._scene.hide(frozenset() if plane is None else self._in_the_way(plane))
        if plane is None:
            self._picture.visible = False
            return
        rows, columns = plane.owners.shape
        middle = np.zeros(3)
        middle[plane.axis] = plane.place
        middle[[k for k in range(3) if k != plane.axis]] = plane.corner + 0.5 * plane.cell * np.array([columns, rows])
        right, down = RIGHT[plane.axis], DOWN[plane.axis]
        frame = np.column_stack((right, down, np.cross(right, down)))
        with self._server.atomic():
            self._picture.image = _coloured(plane, self._scene.colour)
            self._picture.render_width, self._picture.render_height = columns * plane.cell, rows * plane.cell
            self._picture.position = middle
            self._picture.wxyz = viser.transforms.SO3.from_matrix(frame).wxyz
            self._picture.visible = True

    def _in_the_way(self, plane: PlanePicture) -> frozenset[int]:
        """Fragments that the plane cuts, and those on its near side."""
        cut = set(np.unique(plane.owners[plane.owners >= 0]).tolist())
        side = NEAR_SIDE[plane.axis]
        centres = ((f, self._scene.centre(f)) for f in self._scene.poses)
        beyond = {f for f, centre in centres if centre is not None and side * (centre[plane.axis] - plane.place) > 0.0}
        return frozenset(cut | beyond)


def _add_balls(server: viser.ViserServer) -> viser.BatchedMeshHandle:
    ball = trimesh.creation.icosphere(ROUNDNESS, 1.0)
    return server.scene.add_batched_meshes_simple(
        "/spheres", ball.vertices, ball.faces, np.array([[1.0, 0.0, 0.0, 0.0]]), np.zeros((1, 3)),
        batched_scales=np.ones(1), batched_colors=np.full((1, 3), 128, dtype=np.uint8), opacity=SPHERE_OPACITY,
        lod="off", cast_shadow=False, receive_shadow=False, visible=False,
    )  # fmt: skip


def _add_picture(server: viser.ViserServer) -> viser.ImageHandle:
    return server.scene.add_image(
        "/plane_field", NOTHING, 1.0, 1.0, format="png", cast_shadow=False, receive_shadow=False, visible=False
    )


def _largest(spheres: Spheres) -> Spheres:
    """The MOST_SPHERES largest, without single samples."""
    chosen = np.argsort(-spheres.radii, kind="stable")[:MOST_SPHERES]
    chosen = chosen[spheres.radii[chosen] > 0.0]
    return spheres._replace(
        fragment_ids=spheres.fragment_ids[chosen], centres=spheres.centres[chosen], radii=spheres.radii[chosen]
    )


def line_distance(deepest: float) -> float:
    """1, 2 or 5 times a power of ten [m], for about LINES lines of equal depth."""
    wanted = deepest / LINES
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * min((1.0, 2.0, 5.0, 10.0), key=lambda step: abs(np.log(step * power / wanted))))


def _coloured(plane: PlanePicture, colour: Callable[[int], tuple[float, float, float]]) -> np.ndarray:
    """(rows, columns, 4) uint8, the first row at the top: each fragment's colour, darker with depth, in bands."""
    ids, inverse = np.unique(plane.owners, return_inverse=True)
    palette = np.array([(0.0, 0.0, 0.0) if f < 0 else colour(f) for f in ids.tolist()])
    deepest = plane.depths.max()
    light = np.ones(plane.depths.shape)
    if deepest > 0.0:
        light -= (1.0 - DARKEST) * plane.depths / deepest
        light[np.floor(plane.depths / line_distance(deepest)) % 2 == 1] *= DARKER_BAND
    picture = np.zeros((*plane.owners.shape, 4), dtype=np.uint8)
    picture[..., :3] = 255.0 * palette[inverse.reshape(plane.owners.shape)] * light[..., None]
    picture[plane.shared, :3] = SHARED_COLOUR
    picture[..., 3] = np.where(plane.owners >= 0, 255, 0)
    return picture[::-1]


def _words_of(view: InsideView, wanted: InsideWanted) -> list[str]:
    words = []
    if view.spheres is not None:
        spheres = view.spheres
        count = int(np.count_nonzero(spheres.radii))
        most = f"the {MOST_SPHERES} largest of " if count > MOST_SPHERES else ""
        words.append(f"level {spheres.level} of {spheres.deepest}: {most}{count:,} sphere{'s' * (count != 1)}")
    if wanted.plane is not None and view.plane is not None:
        plane, deepest = view.plane, view.plane.depths.max()
        words.append(f"{AXES[plane.axis]} = {plane.place:.3f} m: deepest point {MILLI * deepest:.1f} mm, bands of"
                     f" {MILLI * line_distance(deepest):g} mm; red: inside two fragments"
                     if deepest > 0.0 else f"{AXES[plane.axis]} = {plane.place:.3f} m: no fragment")  # fmt: skip
    figures = view.figures
    if figures is not None and wanted.colliding:
        words.append(f"**{figures.contacts:,}** contacts listed of **{figures.colliding:,}** colliding points")
    if figures is not None and wanted.errors:
        took = "" if figures.collision_ms is None else f"; collision {figures.collision_ms:.2f} ms"
        words.append(
            f"unlisted penetrations: up to **{figures.unlisted_mm:.3f} mm** deep, bound"
            f" **{figures.promised_mm:.3f} mm**{took}" + (" (by a copy of the service)" if figures.is_replayed else "")
        )
    return words
