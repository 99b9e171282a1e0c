"""Bodies and fragments as nodes of a viser scene: which are shown, their colours and poses; and which users hold.

A browser ends a drag when the node under the mouse disappears. So the node of a held fragment that breaks stays, too
small to be seen, and moves with the piece at the grip: the user keeps hold of that, as the simulator's hand does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np
import viser

from fracture_collision.records import CollisionBody, FragmentMesh, FragmentStates
from fracture_collision.viewer.page.page_events import Drag, Ray
from fracture_collision.viewer.page.page_plots import Census
from fracture_collision.viewer.page.server.page_stream import LiveValues
from fracture_collision.viewer.pictures.body_mesh import BodyMesh, mesh_of_body, mesh_of_fragment
from fracture_collision.viewer.pictures.gltf import glb_of_mesh
from fracture_collision.viewer.pictures.palette import Palette, display_colour
from fracture_collision.viewer.pictures.ray_picture import Camera

FLOOR_COLOUR, TILE_COLOUR = (186, 189, 194), (168, 171, 177)
FLOOR_TILE = 0.5  # [m]
FLOOR_FADE = 30.0  # [m] from the camera, where the floor has faded into the sky
UNKNOWN_COLOUR = (0.5, 0.5, 0.5)
SHADOW = 0.42  # darkness of shadows on the floor, 0..1
SKY = ((154, 182, 214), (226, 232, 238))  # above, at the horizon
SUN = (-0.9, -1.3, 2.0)  # towards it
SUN_COLOUR, SUN_STRENGTH = (255, 244, 228), 3.0
DAYLIGHT = 0.55  # strength of the light from all sides
OPENING = np.radians(38.0)  # of the camera

DragHandlers = dict[str, Callable[[Drag], None]]  # by viser's phase names: start, update, end


class _Fragment(NamedTuple):
    body_id: int
    glb: bytes  # binary glTF
    centre: np.ndarray  # (3,) [m], body frame
    corners: np.ndarray  # (n, 3) [m], body frame, of its surface


class SceneNodes:
    """All solid bodies and fragments. One thread at a time."""

    def __init__(self, server: viser.ViserServer, live: LiveValues, drag: DragHandlers) -> None:
        self._server = server
        self._live = live
        self._drag = drag
        self._round = 0  # node names are not reused in the next run: browsers may still have messages of the old one
        self._light_up()
        self._root = self._new_root()
        self._forget()

    def clear(self) -> None:
        """Remove everything for the next run."""
        for fragment_id in list(self._fragments):
            self.remove(fragment_id)
        self._root.remove()
        self._root = self._new_root()
        self._forget()

    def _new_root(self) -> viser.FrameHandle:
        self._round += 1
        return self._server.scene.add_frame(f"/run{self._round}", show_axes=False)

    def _forget(self) -> None:
        self._palette = Palette()
        self._bodies: dict[int, CollisionBody] = {}
        self._fragments: dict[int, _Fragment] = {}
        self._nodes: dict[int, viser.GlbHandle] = {}
        self._poses: dict[int, np.ndarray] = {}  # (7,) of the present ones
        self._grips = Grips()
        self._hidden: frozenset[int] = frozenset()  # present, but hidden because they occlude the view
        self._planes: set[int] = set()  # fragments that are the floor or a wall, drawn as grids
        self._counted: np.ndarray | None = None  # ids of the fragments of which `census` is
        self.census = Census(0, 0, 0, 0)  # of the last states whose fragments were all known
        self.floor: float | None = None  # [m] height of the highest one

    def add_body(self, body: CollisionBody) -> None:
        """Add a body; it is shown once states name its fragment, planes and static bodies at once."""
        self._bodies[body.body_id] = body
        self._palette.add(body)
        if np.any(body.plane):
            self._planes.add(body.fragment_id)
            self._add_plane(body)
            return
        self._add(body.fragment_id, body.body_id, mesh_of_body(body))
        if body.is_static:
            self._place([body.fragment_id], np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]]))

    def add_fragment(self, mesh: FragmentMesh, body_id: int) -> None:
        """Add the mesh of a fragment, which is shown once states name it."""
        if mesh.fragment_id not in self._planes:
            self._add(mesh.fragment_id, body_id, mesh_of_fragment(mesh))

    def remove(self, fragment_id: int) -> None:
        """Remove a fragment for good; nothing happens if it is unknown."""
        self._fragments.pop(fragment_id, None)
        self._poses.pop(fragment_id, None)
        node = self._nodes.pop(fragment_id, None)
        if node is not None:
            self._live.forget(node.name)
            node.remove()

    def remove_body(self, body_id: int) -> None:
        """Remove all fragments of a body for good."""
        for fragment_id in [f for f, fragment in self._fragments.items() if fragment.body_id == body_id]:
            self.remove(fragment_id)

    def place(self, states: FragmentStates, *, again: bool = False) -> bool:
        """Place everything by the states; fragments that they do not name are hidden, except static bodies.

        `again`: these states were placed before; place only what was added since.

        While a mesh is missing nothing is hidden: a body stays until its pieces arrive. Returns False in that case.
        """
        ids = [int(fragment_id) for fragment_id in states.fragment_ids]
        xyzw = states.orientations.reshape(-1, 4)
        poses = np.hstack((states.positions.reshape(-1, 3), xyzw[:, [3, 0, 1, 2]]))
        known = [i for i, fragment_id in enumerate(ids) if fragment_id in self._fragments]
        all_there = len(known) + len(self._planes.intersection(ids)) == len(ids)
        if again:
            known = [i for i in known if ids[i] not in self._poses]
        self._place([ids[i] for i in known], poses[known])
        if all_there:
            gone = set(self._poses) - set(ids)
            for fragment_id in sorted(gone):
                if not self._bodies[self._fragments[fragment_id].body_id].is_static:
                    del self._poses[fragment_id]
                    if not self._grips.keep(fragment_id, self._pieces()):
                        self._nodes[fragment_id].visible = False
            self._count(states.fragment_ids)
        if followers := self._grips.followers(self._poses, self._pieces()):
            self._live.pose([name for name, _ in followers], np.array([pose for _, pose in followers]))
        return all_there

    def _pieces(self) -> Iterator[Piece]:
        """The fragments that are present."""
        for fragment_id in self._poses:
            fragment = self._fragments[fragment_id]
            yield Piece(fragment_id, fragment.body_id, fragment.corners)

    def centre(self, fragment_id: int) -> np.ndarray | None:
        """(3,) [m], world: the centre of a fragment's surface; None if it is not present."""
        pose = self._poses.get(fragment_id)
        if pose is None:
            return None
        return pose[:3] + turned(self._fragments[fragment_id].centre, pose[3:])

    @property
    def poses(self) -> dict[int, np.ndarray]:
        """(7,) position [m] and unit quaternion w x y z, world, of every present fragment. Read only."""
        return self._poses

    def colour(self, fragment_id: int) -> tuple[float, float, float]:
        """Of its outside, 0..1 in display values; grey if unknown."""
        fragment = self._fragments.get(fragment_id)
        if fragment is None:
            return UNKNOWN_COLOUR
        return display_colour(self._palette.paint(fragment_id, fragment.body_id).outside)

    def hide(self, fragment_ids: frozenset[int]) -> None:
        """Hide exactly these fragments, wherever they are, to show what is behind them."""
        for fragment_id in self._hidden ^ fragment_ids:
            if fragment_id in self._poses:
                self._nodes[fragment_id].visible = fragment_id not in fragment_ids
        self._hidden = fragment_ids

    def cast_shadows(self, on: bool) -> None:
        """Without shadows a page costs a quarter of the GPU time."""
        self._sun.cast_shadow = on

    def view_of_all(self) -> Camera | None:
        """From the front, a little above, far enough away to see everything movable; None: there is nothing."""
        shown = [f for f in self._poses if not self._bodies[self._fragments[f].body_id].is_static] or list(self._poses)
        centres = np.array([self.centre(f) for f in shown]).reshape(-1, 3)
        if not len(centres):
            return None
        low, high = centres.min(axis=0), centres.max(axis=0)
        if self.floor is not None and not any(fragment_id not in shown for fragment_id in self._poses):
            low[2] = min(low[2], self.floor)  # nothing but the floor stops what falls
        target, size = 0.5 * (low + high), max(float(np.linalg.norm(high - low)), 0.5)
        return Camera(target + size * np.array([0.5, -1.5, 0.6]), target, OPENING)

    def _count(self, fragment_ids: np.ndarray) -> None:
        if self._counted is not None and np.array_equal(fragment_ids, self._counted):
            return
        self._counted = fragment_ids
        unbroken = pieces = others = 0
        broken = set()
        for fragment_id in self._poses:
            body = self._bodies[self._fragments[fragment_id].body_id]
            if body.is_static:
                continue
            if not self._palette.is_breakable(body.body_id):
                others += 1
            elif fragment_id == body.fragment_id:
                unbroken += 1
            else:
                pieces += 1
                broken.add(body.body_id)
        self.census = Census(unbroken, len(broken), pieces, others)

    def _add(self, fragment_id: int, body_id: int, mesh: BodyMesh) -> None:
        self.remove(fragment_id)
        glb = glb_of_mesh(mesh, self._palette.paint(fragment_id, body_id))
        self._fragments[fragment_id] = _Fragment(body_id, glb, mesh.centre, mesh.triangles.reshape(-1, 3))

    def _place(self, ids: list[int], poses: np.ndarray) -> None:
        names = []
        for fragment_id, pose in zip(ids, poses, strict=True):
            node = self._nodes.get(fragment_id)
            if node is None:
                node = self._nodes[fragment_id] = self._make_node(fragment_id, pose)
            elif fragment_id not in self._poses:
                node.visible = fragment_id not in self._hidden
            self._poses[fragment_id] = pose
            names.append(node.name)
        self._live.pose(names, poses)

    def _make_node(self, fragment_id: int, pose: np.ndarray) -> viser.GlbHandle:
        fragment = self._fragments[fragment_id]
        name = f"{self._root.name}/fragment{fragment_id}"
        node = self._server.scene.add_glb(
            name, fragment.glb, position=pose[:3], wxyz=pose[3:], visible=fragment_id not in self._hidden
        )
        if self._drag and not self._bodies[fragment.body_id].is_static:

            async def on_drag(event: viser.SceneNodeDragEvent) -> None:
                target, eye = np.array(event.end_position), np.array(event.client.camera.position)
                ray = Ray(eye, (target - eye) / max(float(np.linalg.norm(target - eye)), 1e-12))
                grip, held_at = np.array(event.start_position), self._poses.get(fragment_id)
                if event.phase == "start" and held_at is not None:
                    back = held_at[3:] * [1.0, -1.0, -1.0, -1.0]
                    self._grips.take(fragment_id, node, turned(grip - held_at[:3], back), fragment.body_id)
                elif event.phase == "end":
                    self._grips.release(fragment_id)
                self._drag[event.phase](Drag(fragment_id, grip, target, ray))

            node.on_drag("left")(on_drag)
        return node

    def _add_plane(self, body: CollisionBody) -> None:
        normal = body.plane[:3] / np.linalg.norm(body.plane[:3])
        point = -body.plane[3] / np.linalg.norm(body.plane[:3]) * normal
        is_floor = normal[2] > 0.999
        if is_floor:
            self.floor = float(point[2]) if self.floor is None else max(self.floor, float(point[2]))
        self._server.scene.add_grid(
            f"{self._root.name}/plane{body.body_id}", 6.0, 6.0, infinite_grid=is_floor, fade_distance=FLOOR_FADE,
            plane_color=FLOOR_COLOUR, plane_opacity=1.0 if is_floor else 0.4, shadow_opacity=SHADOW,
            cell_color=TILE_COLOUR, cell_size=FLOOR_TILE, section_color=TILE_COLOUR, section_size=4.0 * FLOOR_TILE,
            position=point, wxyz=_from_z_to(normal),
        )  # fmt: skip

    def _light_up(self) -> None:
        scene = self._server.scene
        scene.set_up_direction("+z")
        scene.configure_default_lights(False)
        scene.configure_environment_map("park", environment_intensity=DAYLIGHT)
        self._sun = scene.add_light_directional(
            "/sun", color=SUN_COLOUR, intensity=SUN_STRENGTH, cast_shadow=True, position=SUN
        )
        share = np.linspace(0.0, 1.0, 256)[:, None] ** 0.7
        rows = (1.0 - share) * np.array(SKY[0]) + share * np.array(SKY[1])
        scene.set_background_image(np.tile(rows[:, None], (1, 8, 1)).astype(np.uint8), format="png")


def turned(vectors: np.ndarray, wxyz: np.ndarray) -> np.ndarray:
    """(..., 3) vectors, rotated by unit quaternions w x y z (..., 4)."""
    across = np.cross(wxyz[..., 1:], vectors)
    return vectors + 2.0 * (wxyz[..., :1] * across + np.cross(wxyz[..., 1:], across))


def _from_z_to(normal: np.ndarray) -> np.ndarray:
    """(4,) quaternion w x y z that rotates the z axis to a unit vector."""
    half = np.array([1.0 + normal[2], -normal[1], normal[0], 0.0])
    if half[0] < 1e-9:
        return np.array([0.0, 1.0, 0.0, 0.0])
    return half / np.linalg.norm(half)


UNSEEN = 1e-6  # scale of a node


class _Grip(NamedTuple):
    node: viser.GlbHandle
    place: np.ndarray  # (3,) [m] in the body's frame
    body_id: int


class Piece(NamedTuple):
    """A fragment that may take the place of the one that broke."""

    fragment_id: int
    body_id: int
    corners: np.ndarray  # (n, 3) [m] of its surface, in the body's frame


class Grips:
    """By fragment; the browsers' events and the page's frames may come from two threads."""

    def __init__(self) -> None:
        self._grips: dict[int, _Grip] = {}
        self._heirs: dict[int, int] = {}  # piece held instead of a broken fragment

    def take(self, fragment_id: int, node: viser.GlbHandle, place: np.ndarray, body_id: int) -> None:
        """A user has taken hold of a fragment at `place` (3,) [m] of its body's frame."""
        self._grips[fragment_id] = _Grip(node, place, body_id)

    def release(self, fragment_id: int) -> None:
        """The user has let go."""
        grip = self._grips.pop(fragment_id, None)
        if self._heirs.pop(fragment_id, None) is not None and grip is not None:
            grip.node.visible = False
            grip.node.scale = 1.0

    def keep(self, fragment_id: int, pieces: Iterable[Piece]) -> bool:
        """A fragment has gone; returns whether its node stays, as it is held and has broken into some of `pieces`."""
        grip = self._grips.get(fragment_id)
        if grip is None or (heir := self._nearest(grip, pieces)) is None:
            return False
        self._heirs[fragment_id] = heir
        grip.node.scale = UNSEEN
        return True

    def followers(self, poses: dict[int, np.ndarray], pieces: Iterable[Piece]) -> list[tuple[str, np.ndarray]]:
        """The nodes that stayed, by name, and where they are now."""
        placed = []
        for fragment_id, heir in list(self._heirs.items()):
            grip = self._grips.get(fragment_id)
            if grip is None:
                continue
            if heir not in poses:  # it has broken, too
                next_heir = self._nearest(grip, pieces)
                if next_heir is None:
                    continue
                heir = self._heirs[fragment_id] = next_heir
            placed.append((grip.node.name, poses[heir]))
        return placed

    def _nearest(self, grip: _Grip, pieces: Iterable[Piece]) -> int | None:
        distances = {
            piece.fragment_id: float(np.min(np.sum((piece.corners - grip.place) ** 2, axis=1)))
            for piece in pieces
            if piece.body_id == grip.body_id and len(piece.corners)
        }
        return min(distances, key=distances.__getitem__) if distances else None
