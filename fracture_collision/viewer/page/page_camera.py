"""The cameras of the connected browsers: where they begin, where they return to, and above which floor they stay."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import viser

from fracture_collision.viewer.pictures.ray_picture import Camera

FREE_ASPECT = 1.1  # of the part of the window that the panel leaves free
PANEL_SHARE = 0.25  # of the width of the window
WIDE = FREE_ASPECT / (1.0 - PANEL_SHARE)  # aspect of a window with that panel and that free part
UPRIGHT = 1.0  # windows narrower than this have no panel beside the scene, but below it
LIFT = 0.35  # of the target in such a window, as a share of its half height
LEAST_ASPECT = 0.1
ABOVE_FLOOR = 0.05  # [m] least height of a camera
NEAR_HOME = 0.01  # [m]


class Cameras:
    """One view for all browsers. Any thread may call; calls do not wait for the network."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._view: Camera | None = None
        self._fits = False  # whether the view is adapted to each window
        self._follows = True  # whether the next view also moves the cameras of open pages
        self._floor: float | None = None  # [m] height of its surface

    @property
    def has_view(self) -> bool:
        """Whether the present run has a view."""
        return self._view is not None

    def forget(self) -> None:
        """Await the view of the next run; until then cameras stay where they are."""
        self._view = self._floor = None

    def stand_on(self, floor: float | None) -> None:
        """Keep cameras above a floor at this height [m], if any, from their next movement on."""
        self._floor = floor

    def follow(self) -> None:
        """Move the cameras of open pages to the view: now, or as soon as the run has one."""
        self._follows = True
        if self._view is not None:
            self.look_from(self._view, self._fits)

    def look_from(self, camera: Camera, fits: bool, follow: bool = False) -> None:
        """Set where new pages begin and `go_home` leads to; open pages move there with or after `follow`.

        `fits`: adapt it to each window, so that the free part beside the panel shows what `camera` sees at FREE_ASPECT.
        """
        self._view, self._fits = camera, fits
        begin = fitted(camera, WIDE) if fits else camera
        first = self._server.initial_camera
        first.position, first.look_at = tuple(begin.position.tolist()), tuple(begin.target.tolist())
        first.fov = begin.opening
        if follow or self._follows:
            self._follows = False
            for client in self._server.get_clients().values():
                with suppress(ValueError):  # of a camera that is nowhere: a client need not be a browser
                    self.go_home(client)

    def _home(self, camera: viser.CameraHandle) -> Camera:
        assert self._view is not None
        return fitted(self._view, aspect_of(camera)) if self._fits else self._view

    def go_home(self, client: viser.ClientHandle) -> None:
        """Move a browser's camera to the view, if there is one."""
        if self._view is None:
            return
        camera = self._home(client.camera)
        with client.atomic():
            client.camera.position = camera.position  # it takes look_at along: look_at comes after it
            client.camera.look_at = camera.target
            client.camera.up_direction = np.array([0.0, 0.0, 1.0])
            client.camera.fov = camera.opening

    async def on_connect(self, client: viser.ClientHandle) -> None:
        """For each new browser: a coroutine, so that it precedes the first movement."""
        arrived = False  # the first cameras that a browser reports are not in its scene yet

        async def keep_above(camera: viser.CameraHandle) -> None:
            nonlocal arrived
            arrived = arrived or self._is_home(camera)
            if arrived:
                self._keep_above(camera)

        client.camera.on_update(keep_above)
        if self._fits and aspect_of(client.camera) < WIDE:
            self.go_home(client)

    def _is_home(self, camera: viser.CameraHandle) -> bool:
        return self._view is not None and bool(
            np.linalg.norm(self._home(camera).position - camera.position) < NEAR_HOME
        )

    def _keep_above(self, camera: viser.CameraHandle) -> None:
        if self._floor is None or camera.position[2] >= self._floor + 0.9 * ABOVE_FLOOR:
            return
        position, target = np.array(camera.position), np.array(camera.look_at)
        position[2] = self._floor + ABOVE_FLOOR
        target[2] = max(target[2], self._floor)
        with camera.client.atomic():
            camera.position = position
            camera.look_at = target


def aspect_of(camera: viser.CameraHandle) -> float:
    """Width of the window over its height, as far as the client tells anything sensible."""
    aspect = camera.image_width / camera.image_height if camera.image_height > 0 else WIDE
    return aspect if LEAST_ASPECT <= aspect <= 1.0 / LEAST_ASPECT else WIDE


def fitted(camera: Camera, aspect: float) -> Camera:
    """A camera for a window of this `aspect`, in whose free part everything is that `camera` sees at FREE_ASPECT.

    In wide windows the panel is on the right: the camera turns a little to the right. In narrow ones the panel may
    cover the lower half: the camera turns a little downwards, and moves back.
    """
    share = PANEL_SHARE if aspect >= UPRIGHT else 0.0
    farther = max(1.0, FREE_ASPECT / (aspect * (1.0 - share)))
    ahead = farther * (camera.target - camera.position)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    half_height = np.linalg.norm(ahead) * np.tan(0.5 * camera.opening)
    if share:
        shift = share * half_height * min(aspect, WIDE) * right
    else:
        shift = LIFT * half_height * np.cross(ahead, right) / np.linalg.norm(ahead)  # downwards
    return Camera(camera.target - ahead, camera.target + shift, camera.opening)
