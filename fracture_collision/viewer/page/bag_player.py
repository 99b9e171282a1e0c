"""A recorded run in the page, with a time bar."""

from __future__ import annotations

import threading
import time
from bisect import bisect_left, bisect_right
from collections.abc import Callable

import numpy as np
import viser

from fracture_collision.records import FragmentStates
from fracture_collision.viewer.film.animated_gltf import animated_glb
from fracture_collision.viewer.film.recorded_run import RecordedRun
from fracture_collision.viewer.film.run_scene import RunScene, camera_of, chosen_moments
from fracture_collision.viewer.page.page import INTERVAL, Page
from fracture_collision.viewer.page.page_camera import FREE_ASPECT
from fracture_collision.viewer.page.page_plots import SHOWN, Figures
from fracture_collision.viewer.page.server.page_gate import LOCALHOST

MOMENTS = 6  # of the run from which the camera is chosen
SLIDER_INTERVAL = 0.2  # [s] between two movements of the time bar
SLOWEST, FASTEST = 0.02, 2.0


class BagPlayer:
    """Plays a run once from its beginning; afterwards the user controls it.

    Call `advance` often; its own page is served from construction to `close`.
    """

    def __init__(
        self, run: RecordedRun, host: str = LOCALHOST, port: int = 0, speed: float = 1.0, name: str = ""
    ) -> None:
        """Serve the page. `speed`: simulated seconds a second; `name`: of the recording.

        Raises BagError if the run lacks a body, OSError if the page cannot be served.
        """
        self._run = run
        self._moments = [states.time for states in run.states]
        self._rows: dict[int, Figures] = {}  # by index of the states, those needed so far
        bodies = (fragment for fragment, body_id in run.body_of.items() if len(run.bodies[body_id].tetrahedra))
        self._breakable = np.fromiter(bodies, np.int64)  # fragments of bodies that can break
        self._name = name
        self._exporting, self._exported = threading.Lock(), b""  # the run in one file, once somebody wants it
        self._lock = threading.RLock()
        self._playing, self._speed = True, min(max(speed, SLOWEST), FASTEST)
        self._at = 0.0  # [s] simulated, since the first states
        self._shown = -1  # index of the shown states
        self._advanced_at = time.monotonic()
        self._slider_at = 0.0
        camera = camera_of(RunScene(run), chosen_moments(run, MOMENTS), FREE_ASPECT)
        told = frozenset({"fragments", "contacts"} if run.answers else {"fragments"})
        self.page = Page(host=host, port=port, told=told, add_controls=self._add_controls, name=name)
        self.page.look_from(camera, fits=True)
        for body_id in sorted(run.bodies):
            self.page.add_body(run.bodies[body_id])
        for fragment_id in sorted(run.meshes):
            if fragment_id in run.body_of:
                self.page.add_fragment(run.meshes[fragment_id], run.body_of[fragment_id])

    def __enter__(self) -> BagPlayer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop playing and close the page."""
        self.page.close()

    @property
    def duration(self) -> float:
        """[s] simulated, from the first states to the last."""
        return self._moments[-1] - self._moments[0]

    def play_until(self, check: Callable[[], None]) -> None:
        """Play until `check`, called once per frame, raises."""
        while True:
            check()
            self.advance()
            time.sleep(INTERVAL)

    def advance(self) -> None:
        """Show the run at the current time."""
        with self._lock:
            now = time.monotonic()
            passed, self._advanced_at = now - self._advanced_at, now
            if self._playing:
                self._at += self._speed * passed
                if self._at >= self.duration:
                    self._at = self.duration
                    self._set_playing(False)
            self._show()
            if now - self._slider_at > SLIDER_INTERVAL or not self._playing:
                self._slider_at = now
                if abs(self._bar.value - self._at) > 0.5 * self._bar.step:
                    self._bar.value = round(self._at, 3)  # type: ignore[misc]  # mypy misses viser's setter

    def seek(self, moment: float) -> None:
        """Go to `moment` [s] simulated, since the first states."""
        with self._lock:
            self._at = min(max(moment, 0.0), self.duration)

    def play(self, playing: bool) -> None:
        """Continue, from the beginning if the end was reached; or pause."""
        with self._lock:
            if playing and self._at >= self.duration:
                self._at = 0.0
            self._set_playing(playing)

    def step(self, by: int) -> None:
        """Go `by` recorded states forward (back if negative) and pause."""
        with self._lock:
            self._set_playing(False)
            index = min(max(self._shown + by, 0), len(self._moments) - 1)
            self._at = self._moments[index] - self._moments[0]

    def _show(self) -> None:
        index = bisect_right(self._moments, self._moments[0] + self._at + 1e-9) - 1
        wants_contacts = self.page.wants_contacts
        if index == self._shown and wants_contacts == self._showed_contacts:
            return
        before, self._shown, self._showed_contacts = self._shown, index, wants_contacts
        states = self._run.states[index]
        self.page.show_states(
            FragmentStates(
                states.step, states.fracture_sequence, states.fragment_ids, states.positions,
                states.orientations,
            )
        )  # fmt: skip
        if wants_contacts:
            self.page.show_contacts(self._run.contacts(states.step))
        # The plots show the recording before this moment, even after a jump.
        begin = bisect_left(self._moments, states.time - SHOWN)
        begin = before + 1 if begin <= before < index else begin
        for row in range(begin, index + 1):
            self.page.show_figures(self._figures(row))

    def _figures(self, index: int) -> Figures:
        if index not in self._rows:
            states = self._run.states[index]
            contacts = self._run.contacts(states.step)
            self._rows[index] = Figures(
                states.time,
                contacts=None if contacts is None else len(contacts.gaps),
                fragments=int(np.isin(states.fragment_ids, self._breakable).sum()),
            )
        return self._rows[index]

    _showed_contacts = False

    def _animation(self) -> bytes:
        with self._exporting:
            if not self._exported:
                self._exported = animated_glb(self._run)
        return self._exported

    def _set_playing(self, playing: bool) -> None:
        self._playing = playing
        self._button.label = "pause" if playing else "play"
        self._button.icon = viser.Icon.PLAYER_PAUSE if playing else viser.Icon.PLAYER_PLAY

    def _add_controls(self, gui: viser.GuiApi) -> None:
        with gui.add_folder("Time"):
            step = max(self.duration / 1000.0, 1e-3)
            self._bar = gui.add_slider("time, s", 0.0, max(round(self.duration, 3), step), round(step, 6), 0.0)
            self._button = gui.add_button("pause", icon=viser.Icon.PLAYER_PAUSE)
            steps = gui.add_button_group("one step", ("back", "forward"))
            download = gui.add_button(
                "download .glb", icon=viser.Icon.DOWNLOAD, color="gray", hint="The run as a 3D animation in one file."
            )
            speed = gui.add_slider("speed", SLOWEST, FASTEST, 0.02, self._speed, hint="Simulated seconds per second.")

        # Coroutines, because viser calls those in order; its thread pool would not.
        @self._bar.on_update
        async def _(event: viser.GuiEvent) -> None:
            if event.client is not None:  # the user, not `advance`
                self.seek(self._bar.value)

        @self._button.on_click
        async def _(_event: viser.GuiEvent) -> None:
            self.play(not self._playing)

        @steps.on_click
        async def _(_event: viser.GuiEvent) -> None:
            self.step(1 if steps.value == "forward" else -1)

        @download.on_click
        def _(event: viser.GuiEvent) -> None:  # in a thread of viser's pool: it takes a while
            if event.client is not None:
                name = f"{self._name or 'run'}.glb"
                event.client.send_file_download(name, self._animation(), save_immediately=True)

        @speed.on_update
        async def _(event: viser.GuiEvent) -> None:
            if event.client is not None:
                with self._lock:
                    self._speed = float(speed.value)
