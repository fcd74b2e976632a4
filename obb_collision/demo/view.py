# Copyright 2026 The obb_collision developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""The live view in the browser. It needs viser, which is an optional dependency."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout
from datetime import datetime
from html import escape
from io import StringIO
from socket import create_server
from threading import Event, Thread
from time import monotonic, sleep
from traceback import format_exc
from typing import Any

import numpy as np

from obb_collision.boxes import Boxes
from obb_collision.demo.listener import Color, Listener
from obb_collision.demo.snapshot import (
    BALL,
    CUBE,
    DOUBTFUL,
    EDGE_COLORS,
    OUTSIDE_COLOR,
    OVERLAPPING,
    STATE_COLORS,
    TOUCH_SIGN,
    TOUCHING,
    Body,
    DrawnScene,
    DrawnTriangles,
    Label,
    diagonal_of,
    look_at,
    pieces,
    take_snapshot,
)
from obb_collision.demo.status import Status
from obb_collision.geometry.poses import quaternions_from_matrices
from obb_collision.node.messages.box_markers import edge_points
from obb_collision.scene_files.description import View as Viewpoint
from obb_collision.shapes import Shape
from obb_collision.typing import Floats

#: Updates of the browser per second, Hz: smooth to the eye.
RATE = 15.0
#: Maximum numbers: notes in the panel, numbered notes in the scene, signs of touching objects.
NOTES, MARKED, SIGNS = 14, 5, 8
#: Relative to the scene's diagonal: the diameters of contacts and of points, the radius of the glow
#: around a collision too small to be seen, and the dashes of unknown objects.
DOT, SPECK, GLOW, DASH = 0.007, 0.0025, 0.02, 0.008
#: Opacity of states that are not opaque: contact points are inside of overlapping objects.
OPACITY = {OVERLAPPING: 0.55, DOUBTFUL: 0.3}
#: A flight to a pair: number of steps, seconds of each, and the distance at its end relative to the
#: smaller object, or at least to the scene's diagonal.
STEPS, STEP, NEAR, NEAREST = 20, 0.03, 4.0, 0.05
#: Seconds without a status until the banner says STALE; and seconds until everything is drawn as
#: unknown, because no complete cycle arrived or its level is not that of the status any more.
SILENT, DISAGREED = 2.0, 0.5
LEVEL_COLORS = {
    "OK": (0.10, 0.50, 0.32),
    "ERROR": (0.80, 0.08, 0.10),
    "STALE": EDGE_COLORS[DOUBTFUL],
}
#: Makes rows of the list left-aligned and as high as text.
STYLE = (
    "<style>.mantine-Button-root{height:1.9em;margin-bottom:-.5em}"
    ".mantine-Button-inner{justify-content:flex-start}</style>"
)
#: Exponent from sRGB to linear colours, which viser takes for lines and batched bodies.
GAMMA = 2.2
#: Initial height of the field of view, radians.
FIELD = 0.65
#: Text of the panel while there is nothing to draw.
WAITING = "Waiting for the node. Its first start compiles kernels: see its log for the progress."


class BrowserView:
    """A scene in the browser. ImportError without viser, OSError for a port in use.

    host: "localhost" for this machine only, "0.0.0.0" for all network interfaces. handles: by name,
    the number of items drawn, and viser's handle, None for no items.
    """

    def __init__(self, port: int, host: str = "localhost", view: Viewpoint | None = None) -> None:
        import viser

        with create_server((host, 0)):
            pass  # an unknown host fails here; viser would wait for ever
        with redirect_stdout(StringIO()):  # it prints a frame around the address
            self._server = viser.ViserServer(host, port, label="obb_collision", verbose=False)
        self._server.gui.configure_theme(show_logo=False, show_share_button=False)
        self._server.gui.main_panel.dock_right()
        self.banner = self._server.gui.add_html("")
        self.panel = self._server.gui.add_html(_in_panel(WAITING))
        self.rows = [self._add_row(row) for row in range(NOTES)]
        self._notes: list[Label] = []  # of the rows
        self._view = view
        self._size = 0.0
        self.handles: dict[str, tuple[Any, Any]] = {}
        self.url = f"http://{host}:{self._server.get_port()}"

    def show(self, snapshot: DrawnScene, status: Status, silent: float = 0.0) -> None:
        """Draw a snapshot in place of the last one, with its status and notes."""
        self._begin(snapshot.boxes)
        zone = np.array([name in snapshot.zones for name in snapshot.names])
        zones = snapshot.boxes[zone]
        names = [name for name in snapshot.names if name in snapshot.zones]
        colors = np.array([snapshot.zones[name] for name in names]).reshape(-1, 3)
        with self._server.atomic():
            self._show_bodies(snapshot)
            self._show_edges(snapshot)
            edges = edge_points(zones).reshape(-1, 12, 2, 3)
            self._lines("edges of zones", edges, colors[:, None, None])
            self._meshes("zones", CUBE, zones, zones.half_extents, colors, 0.15)
            self._show_signs(snapshot)
            for name, color, form, points in snapshot.marks():
                if form == "line":
                    self._lines(name, points, color, 4.0)
                else:
                    self._dots(name, points, color, DOT if form == "dot" else SPECK)
            self._show_notes(snapshot)
            self.show_status(status, silent)

    def show_status(self, status: Status, silent: float) -> None:
        """Write a node's status into the banner; silent: seconds since it arrived."""
        _change(self.banner, content=STYLE + banner(status, silent))

    def fly_to(self, note: Label, camera: Any) -> None:
        """Move a client's camera to the place of a note; it keeps its direction."""
        eye, target = np.array(camera.position), np.array(camera.look_at)
        back = (eye - target) / max(float(np.linalg.norm(eye - target)), 1e-9)
        end = note.place + max(NEAR * note.extent, NEAREST * self._size) * back
        for step in range(1, STEPS + 1):
            share = 0.5 - 0.5 * np.cos(np.pi * step / STEPS)
            with camera.client.atomic():
                camera.position = eye + share * (end - eye)
                camera.look_at = target + share * (note.place - target)
            sleep(STEP)

    def show_lines(
        self, lines: list[tuple[Floats, Color]], status: Status, silent: float = 0.0
    ) -> None:
        """Draw edges (2 k, 3) of boxes, as a node publishes them for many objects."""
        with self._server.atomic():
            self.show_status(status, silent)
            if not lines:
                return
            ends = np.concatenate([ends for ends, _ in lines]).reshape(-1, 2, 3)
            low, high = ends.min(axis=(0, 1)), ends.max(axis=(0, 1))
            self._begin(Boxes([0.5 * (low + high)], [np.eye(3)], [0.5 * (high - low)]))
            counts = [len(part) // 2 for part, _ in lines]
            colors = np.repeat([color for _, color in lines], counts, axis=0)
            self._lines("edges of boxes", ends, colors[:, None])

    def clear(self) -> None:
        """Remove everything that is drawn, and the list of notes."""
        for _, handle in self.handles.values():
            if handle is not None:
                handle.remove()
        self.handles.clear()
        self._notes, self.panel.content = [], ""
        for button in self.rows:
            button.visible = False

    def close(self) -> None:
        """Stop the server."""
        with redirect_stdout(StringIO()):
            self._server.stop()

    def _begin(self, boxes: Boxes) -> None:
        """Set camera, floor and sizes for the first boxes."""
        if self._size:
            return
        self.panel.content = ""
        self._size = diagonal_of(boxes)
        eye, target = look_at(self._view, boxes)
        camera = self._server.initial_camera
        camera.position, camera.look_at, camera.fov = eye, target, FIELD
        camera.near, camera.far = 1e-3 * self._size, 1e2 * self._size
        cell = 10.0 ** round(np.log10(self._size / 12.0))
        floor = (target[0], target[1], min(0.0, boxes.aabb().minimum[2]))
        self._server.scene.add_grid(
            "/floor",
            1.4 * self._size,
            1.4 * self._size,
            position=floor,
            cell_size=cell,
            section_size=10.0 * cell,
            cell_color=(225, 225, 225),
            section_color=(205, 205, 205),
        )

    def _show_bodies(self, snapshot: DrawnScene) -> None:
        """Draw the bodies, in one batch those that differ only in size.

        Each opacity has a batch of all bodies, in which those of other opacities have no size: a
        batch with another number of bodies would be drawn anew, and flicker.
        """
        groups: dict[int, list[Body]] = defaultdict(list)
        for body in snapshot.bodies():
            groups[id(body.triangles.vertices)].append(body)
        names = set[str]()
        for key, bodies in groups.items():
            placed = Boxes(
                np.array([body.position for body in bodies]),
                np.array([body.rotation for body in bodies]),
                np.ones((len(bodies), 3)),
            )
            scales = np.array([body.triangles.scale for body in bodies])
            colors = np.array(STATE_COLORS)[[body.state for body in bodies]]
            own = np.array([OPACITY.get(body.state, 1.0) for body in bodies])
            for opacity in (1.0, *OPACITY.values()):
                name, shown = f"{opacity}/{key}", own == opacity
                if shown.any() or name in self.handles:
                    names.add(name)
                    sizes = scales * shown[:, None]
                    self._meshes(name, bodies[0].triangles, placed, sizes, colors, opacity)
        for name in [name for name in self.handles if "/" in name and name not in names]:
            self.handles.pop(name)[1].remove()

    def _show_edges(self, snapshot: DrawnScene) -> None:
        """Draw sharp edges, and boxes that decided a pair; those of unknown state are dashed."""
        lines, colors = [np.empty((0, 2, 3))], [np.empty((0, 3))]
        for body in snapshot.wires():
            ends = body.edges()
            if body.state == DOUBTFUL:
                ends, _, number = pieces(ends, DASH * self._size)
                ends = ends[number % 2 == 0]
            lines.append(ends)
            colors.append(np.tile(EDGE_COLORS[body.state], (len(ends), 1)))
        self._lines("edges", np.concatenate(lines), np.concatenate(colors)[:, None])

    def _show_signs(self, snapshot: DrawnScene) -> None:
        """Draw numbers of notes, signs of touching objects, and a glow around small overlaps."""
        signs: list[tuple[str, Floats]] = []
        for k, note in enumerate(snapshot.notes[:MARKED], start=1):
            far = [float(np.linalg.norm(at - note.place)) for _, at in signs]
            near = [distance < GLOW * self._size for distance in far]
            if True in near:  # one label for notes that would cover each other
                text, at = signs[near.index(True)]
                signs[near.index(True)] = f"{text}, {k}", at
            else:
                signs.append((f"{k}", note.place))
        touching = [body.position for body in snapshot.bodies() if body.state == TOUCHING]
        signs += [(TOUCH_SIGN, place) for place in touching[:SIGNS]]
        style = {"anchor": "bottom-center", "depth_test": False, "font_screen_scale": 1.25}
        for k in range(MARKED + SIGNS):
            text, place = signs[k] if k < len(signs) else ("", np.zeros(3))
            add, count = self._server.scene.add_label, int(k < len(signs))
            self._put(add, f"sign {k}", count, style, text=text, position=place)
        places = np.array([snapshot.notes[row].place for row in snapshot.small()]).reshape(-1, 3)
        glows = Boxes(places, np.tile(np.eye(3), (len(places), 1, 1)), np.ones(places.shape))
        radii = np.full(places.shape, GLOW * self._size)
        colors = np.tile(STATE_COLORS[OVERLAPPING], (len(places), 1))
        self._meshes("glow", BALL, glows, radii, colors, 0.3)

    def _meshes(
        self,
        name: str,
        triangles: DrawnTriangles,
        placed: Boxes,
        scales: Floats,
        colors: Floats,
        opacity: float,
    ) -> None:
        """Draw triangles once per box, at its pose, with scale and colour."""
        quaternions = quaternions_from_matrices(placed.arrays.rotations)[:, [3, 0, 1, 2]]
        self._put(
            self._server.scene.add_batched_meshes_simple,
            name,
            len(placed),
            {
                "vertices": triangles.vertices,
                "faces": triangles.faces,
                "opacity": None if opacity == 1.0 else opacity,
                "side": "front" if triangles.closed else "double",
                "flat_shading": len(triangles.faces) < 100,
                "cast_shadow": opacity == 1.0,
                "lod": "off",
            },
            batched_positions=placed.centers.astype(np.float32),
            batched_wxyzs=quaternions.astype(np.float32),
            batched_scales=scales.astype(np.float32),
            batched_colors=_bytes(colors**GAMMA),
        )

    def _lines(self, name: str, ends: Floats, color: Any, width: float = 2.0) -> None:
        """Draw lines (..., 2, 3), metres, of a width in pixels."""
        colors = np.broadcast_to(_bytes(np.array(color) ** GAMMA), ends.shape).reshape(-1, 2, 3)
        points = ends.reshape(-1, 2, 3).astype(np.float32)
        constant = {"thickness": width, "thickness_units": "screen"}
        add = self._server.scene.add_line_segments
        self._put(add, name, len(points), constant, points=points, colors=colors)

    def _dots(self, name: str, points: Floats, color: Color, size: float) -> None:
        constant = {
            "colors": _bytes(np.array(color)),
            "point_size": size * self._size,
            "point_shape": "circle",
            "precision": "float32",
            "point_shading": "flat",
        }
        add = self._server.scene.add_point_cloud
        self._put(add, name, len(points), constant, points=points.astype(np.float32))

    def _put(
        self,
        add: Callable[..., Any],
        name: str,
        count: int,
        constant: dict[str, Any],
        **values: Any,
    ) -> None:
        """Draw items, or change the values of drawn ones if their number is the same."""
        last_count, handle = self.handles.get(name, (0, None))
        if handle is None or last_count != count:
            if handle is not None:
                handle.remove()
            handle = add(f"/{name}", **constant, **values) if count else None
            self.handles[name] = count, handle
            return
        _change(handle, **values)

    def _add_row(self, row: int) -> Any:
        """Return a row of the list of notes; a click on it flies to its place."""
        button = self._server.gui.add_button("", visible=False, hint="Fly there")

        @button.on_click
        def _(event: Any) -> None:
            if event.client is not None and row < len(self._notes):
                self.fly_to(self._notes[row], event.client.camera)

        return button

    def _show_notes(self, snapshot: DrawnScene) -> None:
        """Write the legend and the notes into the panel."""
        lines = [_line(text, color) for text, color, _ in snapshot.legend()]
        self._notes = snapshot.notes[:NOTES]
        if len(snapshot.notes) > NOTES:
            lines.append(_line(f"{len(snapshot.notes)} notes, the first {NOTES}:", OUTSIDE_COLOR))
        _change(self.panel, content=_in_panel("".join(lines)))
        for k, button in enumerate(self.rows):
            note = self._notes[k] if k < len(self._notes) else None
            values: dict[str, Any] = {"visible": note is not None}
            if note is not None:
                color = tuple(_bytes(0.85 * np.array(note.color)).tolist())
                values |= {"label": f"{k + 1}   {note.text}", "color": color}
            _change(button, **values)


def _change(handle: Any, **values: Any) -> None:
    """Set the fields of a viser handle that differ."""
    for field, value in values.items():
        if not np.array_equal(getattr(handle, field), value):
            setattr(handle, field, value)


def banner(status: Status, silent: float) -> str:
    """Return level, reason, message and time as HTML; a silent node is STALE."""
    level, reason, message = status.level, status.values.get("reason", ""), status.message
    if not level or silent > SILENT:
        level, reason, message = "STALE", "silent", "no collision_status is received"
    time = datetime.fromtimestamp(status.stamp).strftime("%H:%M:%S") if status.stamp else ""
    return (
        f"<div style='background: {_rgb(LEVEL_COLORS[level])}; color: white; padding: .6em 1em'>"
        f"<span style='float: right'>{time}</span><b style='font-size: 150%'>{level}</b> "
        f"{escape(reason)}<div style='font-size: 85%'>{escape(message)}</div></div>"
    )


def _in_panel(content: str) -> str:
    return f"<div style='padding: 0 1em; font-size: 85%'>{content}</div>"


def _line(text: str, color: Color) -> str:
    style = f"color: {_rgb(color)}; -webkit-text-stroke: 1px grey"
    return f"<div><span style='{style}'>&#9632;</span> {escape(text)}</div>"


def _rgb(color: Color) -> str:
    return f"rgb({','.join(map(str, _bytes(np.array(color)).tolist()))})"


def _bytes(colors: Floats) -> Any:
    return np.round(255.0 * np.asarray(colors, np.float64)).astype(np.uint8)


class LiveView:
    """Updates a view from a listener in a thread, so that drawing does not delay the node."""

    def __init__(
        self,
        view: BrowserView,
        listener: Listener,
        shapes: Mapping[str, Shape] | None = None,
        zones: Mapping[str, Color] | None = None,
    ) -> None:
        self._view, self._listener = view, listener
        self._shapes, self._zones = shapes, zones or {}
        self._form = False, False  # whether objects, and lines, are drawn
        self._agreed = 0.0  # time when status and cycle last had the same level, s
        self._ended = Event()
        self._thread = Thread(target=self._run, name="view", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._ended.wait(1.0 / RATE):
            try:
                self.update()
            except Exception:  # the node goes on without a picture
                logger = self._listener.get_logger()
                logger.error(f"the view has an internal error\n{format_exc()}", once=True)

    def update(self) -> None:
        """Draw the listener's latest cycle, if it has one."""
        listener, now = self._listener, monotonic()
        cycle, status, silent = listener.cycle, listener.status, now - listener.heard
        if cycle is None:
            self._view.show_status(status, silent)
            return
        if cycle.status.level == status.level and now - cycle.at < SILENT:
            self._agreed = now
        is_current = now - self._agreed < DISAGREED
        shown = (cycle.status if is_current else status), silent
        form = bool(cycle.boxes.names), bool(cycle.boxes.lines)
        if form != self._form:
            self._view.clear()
        self._form = form
        if cycle.boxes.names:
            shapes = {**listener.shapes, **(self._shapes or {})}
            snapshot = take_snapshot(cycle, shapes, self._zones)
            self._view.show(snapshot if is_current else snapshot.unknown(), *shown)
        else:
            self._view.show_lines(cycle.boxes.lines, *shown)

    def close(self) -> None:
        """End the thread and stop the server."""
        self._ended.set()
        self._thread.join()
        self._view.close()
