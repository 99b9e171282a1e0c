"""A browser page that shows a run live and reports user input to handlers.

It takes records from any source: a bag player, ROS subscriptions. Calls never wait for the network: they hand new data
to the page's own thread, which sends the newest to the browsers about thirty times a second, meshes and removals at
once. viser serves the page and keeps its content, so that browsers may connect, disconnect and reconnect at any time,
several at once.
"""

from __future__ import annotations

import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Sequence

import viser

from fracture_collision.records import CollisionBody, ContactConstraintArray, FragmentMesh, FragmentStates
from fracture_collision.viewer.page.page_camera import Cameras
from fracture_collision.viewer.page.page_contacts import ContactLayers
from fracture_collision.viewer.page.page_controls import Controls, add_help, help_text
from fracture_collision.viewer.page.page_events import Handlers, Joint, ServiceSliders, Start
from fracture_collision.viewer.page.page_inside import Inside, InsideView
from fracture_collision.viewer.page.page_plots import Figures, Plots, Summary, check_told, plots_of
from fracture_collision.viewer.page.page_scene import DragHandlers, SceneNodes
from fracture_collision.viewer.page.server.page_document import TITLE, Document
from fracture_collision.viewer.page.server.page_gate import LOCALHOST, bracketed, started_server, stop_server
from fracture_collision.viewer.page.server.page_stream import LiveValues, run_script, show_notice
from fracture_collision.viewer.pictures.ray_picture import Camera

INTERVAL = 1.0 / 32.0  # [s] between two frames: some are late, and thirty a second should remain
MOST_BEHIND = 3.0 * INTERVAL  # [s] At most this backlog of frames, missed because states were late, is caught up.
BRAND = (38, 94, 150)


class Page:
    """Use as a context manager, or `close` it. Calls may come from any one thread; `handlers` run in another."""

    def __init__(
        self,
        handlers: Handlers | None = None,
        start: Start | None = None,
        host: str = LOCALHOST,
        port: int = 0,
        told: frozenset[str] = frozenset(),
        add_controls: Callable[[viser.GuiApi], None] | None = None,
        name: str = "",
    ) -> None:
        """Serve the page; `port` 0: any free one.

        `told`: the fields of Figures that will be set; only those get a plot. `add_controls` adds the controls of a
        recording above all others. `name`: of the recording, for the title. Raises OSError if the address cannot be
        served, ValueError if `told` contains a name that is not a figure.
        """
        handlers, start = handlers or Handlers(), start or Start()
        check_told(told)
        self._document = Document(name or start.scene, has_arrow_commands=handlers.arrow is not None)
        self._server = started_server(host, port, self._document, TITLE)
        self.address = f"http://{bracketed(host)}:{self._server.get_port()}"
        self._server.gui.configure_theme(show_logo=False, show_share_button=False, brand_color=BRAND)
        self._live = LiveValues(self._server)
        drag: DragHandlers = {}
        if handlers.drag_begun and handlers.drag_moved and handlers.drag_ended:
            drag = {"start": handlers.drag_begun, "update": handlers.drag_moved, "end": handlers.drag_ended}
        self._scene = SceneNodes(self._server, self._live, drag)
        self._cameras = Cameras(self._server)
        self._summary = Summary(self._server.gui)
        add_help(self._server, help_text(handlers, start, add_controls is not None))
        if add_controls is not None:
            add_controls(self._server.gui)
        self._controls = Controls(self._server, handlers, start)
        self._add_reset_view()
        self._layers = ContactLayers(self._server, self._live, self._redraw_contacts)
        shadows = self._server.gui.add_checkbox("shadows", True, hint="Switch off on a slow graphics processor.")
        shadows.on_update(lambda _event: self._order(lambda: self._scene.cast_shadows(shadows.value)))
        self._shadows = shadows
        self._inside: Inside | None = None
        if handlers.looking_inside:
            self._inside = Inside(self._server, self._live, self._scene, handlers.looking_inside, self._redraw_inside)
        self._plots = self._add_plots(told)
        self._server.on_client_connect(self._cameras.on_connect)
        self._server.on_client_connect(self._retitle)
        self._server.on_client_connect(self._live.send_all)

        self._news = threading.Condition()
        self._orders: deque[Callable[[], None]] = deque()  # in the order given
        self._states: FragmentStates | None = None  # newest, until shown
        self._placed: FragmentStates | None = None  # last shown
        self._contacts: ContactConstraintArray | None = None
        self._contacts_are_new = False
        self._figures: list[Figures] = []
        self._view: InsideView | None = None
        self._inside_is_new = False
        self._busy = self._closed = False
        self.pictures = 0  # states sent to the browsers so far
        self.paint_seconds = 0.0  # CPU time spent on that, meshes included
        self._thread = threading.Thread(target=self._paint, name="page", daemon=True)
        self._thread.start()

    def __enter__(self) -> Page:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def browsers(self) -> int:
        """Number of connected browsers."""
        return len(self._server.get_clients())

    @property
    def messages_sent(self) -> int:
        """Messages to each browser: poses, up to two each, and contact layers."""
        return self._live.messages_sent

    @property
    def wants_contacts(self) -> bool:
        """Whether any contact layer is switched on; if not, contacts need not be fetched."""
        return self._layers.wanted

    def new_run(self) -> None:
        """Remove everything from the page, including data not shown yet."""
        with self._news:
            self._orders.clear()
            self._states = self._contacts = None
            self._contacts_are_new = True
            self._figures = []
            self._view = None
            self._order(self._clear)

    def add_body(self, body: CollisionBody) -> None:
        """Planes and static bodies appear at once, others as soon as states name their fragment."""
        self._order(lambda: self._scene.add_body(body))

    def remove_body(self, body_id: int) -> None:
        """Remove a body with all its fragments."""
        self._order(lambda: self._scene.remove_body(body_id))

    def add_fragment(self, mesh: FragmentMesh, body_id: int) -> None:
        """It appears as soon as states name it. Until all fragments of the states are known, the previous ones stay."""
        self._order(lambda: self._scene.add_fragment(mesh, body_id))

    def look_from(self, camera: Camera, fits: bool = False) -> None:
        """Without this call, the page chooses the camera at the first states of a run. Open pages move there.

        `fits`: adapt it to each window, as Cameras.look_from does.
        """
        self._order(lambda: self._cameras.look_from(camera, fits, follow=True))

    def show_scene(self, name: str) -> None:
        """Name the scene that runs: in the title and its control. If it is another one, cameras move to its view."""

        def show() -> None:
            self._document.name = name
            for client in self._server.get_clients().values():
                self._retitle(client)
            self._controls.show_scene(name)
            self._cameras.follow()

        if name != self._document.name:
            self._order(show)

    def add_scene(self, name: str) -> None:
        """Offer one more scene."""
        self._order(lambda: self._controls.add_scene(name))

    def show_rate(self, achieved: float, requested: float, paused: bool, step_ms: float = 0.0) -> None:
        """Simulated time over real time; to be called several times a second. `step_ms`: Summary.show_rate."""
        self._summary.show_rate(time.monotonic(), achieved, requested, paused, step_ms)
        self._controls.show_paused(paused)

    def cast_shadows(self, on: bool) -> None:
        """Same as the switch on the page."""
        self._shadows.value = on  # type: ignore[misc]  # mypy misses viser's setter

    def show_service(self, service: ServiceSliders) -> None:
        """Move the service sliders; calls no handler."""
        self._controls.show_service(service)

    def show_robot(self, joints: Sequence[Joint], angles: Sequence[float]) -> None:
        """Show sliders of the robot's joints, which are at `angles` [rad], [m], until the next run."""
        self._order(lambda: self._controls.show_robot(joints, angles))

    def show_torques(self, torques: Sequence[float]) -> None:
        """Show the torques [N m], [N] of the joints of show_robot; to be called several times a second."""
        self._order(lambda: self._controls.show_torques(torques))

    def notify(self, words: str) -> None:
        """Show a notification for some seconds in all connected browsers."""
        for client in self._server.get_clients().values():
            show_notice(client, words)

    def show_states(self, states: FragmentStates) -> None:
        """Show states; those not yet shown are skipped."""
        with self._news:
            self._states = states
            self._news.notify()

    def show_contacts(self, contacts: ContactConstraintArray | None) -> None:
        """Show contacts in the layers that are switched on; None: show none."""
        with self._news:
            self._contacts, self._contacts_are_new = contacts, True
            self._news.notify()

    def show_figures(self, figures: Figures) -> None:
        """All figures are plotted, including those of steps that are not shown."""
        with self._news:
            self._figures.append(figures)
            self._news.notify()

    def show_inside(self, view: InsideView) -> None:
        """The view that Handlers.looking_inside requested; plotted too, unless a newer view replaces it first."""
        with self._news:
            self._view, self._inside_is_new = view, True
            self._news.notify()

    def flush(self, timeout: float = 10.0) -> None:
        """Wait until everything handed over has been passed on to the browsers. Raises TimeoutError."""
        with self._news:
            if not self._news.wait_for(lambda: self._closed or not (self._busy or self._has_news()), timeout):
                raise TimeoutError(f"the page has not sent everything within {timeout} s")

    def close(self) -> None:
        """End the page for all browsers."""
        with self._news:
            self._closed = True
            self._news.notify_all()
        self._thread.join()
        stop_server(self._server)

    def _order(self, order: Callable[[], None]) -> None:
        with self._news:
            self._orders.append(order)
            self._news.notify()

    def _redraw_contacts(self) -> None:
        with self._news:
            self._contacts_are_new = True
            self._news.notify()

    def _redraw_inside(self) -> None:
        with self._news:
            self._inside_is_new = True
            self._news.notify()

    def _add_plots(self, told: frozenset[str]) -> Plots:
        groups = plots_of(told)
        if not groups and self._inside is None:
            return Plots(self._server.gui, ())
        with self._server.gui.add_folder("Last seconds"):
            plots = Plots(self._server.gui, groups)
            if self._inside is not None:
                self._inside.add_plots()
        return plots

    def _add_reset_view(self) -> None:
        button = self._server.gui.add_button("reset view", icon=viser.Icon.FOCUS_CENTERED, color="gray")

        @button.on_click
        async def _(event: viser.GuiEvent) -> None:
            if event.client is not None:
                self._cameras.go_home(event.client)

    def _retitle(self, client: viser.ClientHandle) -> None:
        run_script(client, self._document.retitling())

    def _clear(self) -> None:
        self._placed = None
        self._scene.clear()
        self._cameras.forget()
        self._summary.clear()
        self._controls.show_robot((), ())
        self._plots.clear()
        if self._inside is not None:
            self._inside.clear()

    def _has_news(self) -> bool:
        return bool(self._orders or self._states is not None or self._contacts_are_new or self._figures
                    or self._inside_is_new)  # fmt: skip

    def _paint(self) -> None:
        due = time.monotonic()  # of the next frame
        while True:
            with self._news:
                self._busy = False
                self._news.notify_all()
                self._news.wait_for(lambda: self._closed or self._has_news())
                if not self._orders:  # limits the frame rate; orders do not wait
                    self._news.wait_for(lambda: self._closed or self._orders, max(due - time.monotonic(), 0.0))
                if self._closed:
                    return
                orders, self._orders = self._orders, deque()
                states, self._states = self._states, None
                figures, self._figures = self._figures, []
                contacts, redraw, self._contacts_are_new = self._contacts, self._contacts_are_new, False
                view, self._view = self._view, None
                look, self._inside_is_new = self._inside_is_new, False
                self._busy = True
            if states is not None:  # figures follow their states, and must not delay the next states
                due = max(due, time.monotonic() - MOST_BEHIND) + INTERVAL
            began = time.thread_time()
            try:
                self._show(orders, states, figures, contacts, redraw)
                if self._inside is not None and look:
                    self._inside.draw(view)
                elif self._inside is not None and states is not None:
                    self._inside.move()
            except Exception:  # one frame failed; the next may succeed
                traceback.print_exc()
            self.paint_seconds += time.thread_time() - began

    def _show(
        self,
        orders: deque[Callable[[], None]],
        states: FragmentStates | None,
        figures: list[Figures],
        contacts: ContactConstraintArray | None,
        redraw: bool,
    ) -> None:
        for order in orders:  # builds meshes: outside `atomic`, so that finished messages go out meanwhile
            order()
        with self._server.atomic():  # else each message would wake the sending thread
            if states is not None:
                self._placed = states
                self.pictures += 1
            if self._placed is not None and (states is not None or orders):  # the last states may name a new fragment
                all_there = self._scene.place(self._placed, again=states is None)
                if all_there:
                    self._note_scene()
        if orders:
            self._server.flush()  # else new nodes would wait in the buffer for more messages, as poses may
        if redraw:
            self._layers.draw(contacts, self._scene.centre)
        for row in figures:
            self._plots.add(row if row.fragments is not None else row._replace(fragments=self._scene.census.fragments))
        if figures:
            self._plots.draw()
            self._summary.show_figures(figures[-1])

    def _note_scene(self) -> None:
        """Once all fragments of the states are known."""
        self._cameras.stand_on(self._scene.floor)
        if not self._cameras.has_view and (view := self._scene.view_of_all()) is not None:
            self._cameras.look_from(view, fits=True)
        self._summary.show_census(self._scene.census)
