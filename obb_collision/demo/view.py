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

"""The live view in the browser, by viser: the only module that needs it, which is an extra."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout
from html import escape
from io import StringIO
from socket import create_server
from threading import Event, Thread
from time import monotonic
from traceback import format_exc
from typing import Any

import numpy as np

from obb_collision.demo.listener import Listener
from obb_collision.demo.snapshot import (
    CONTACT_COLOR,
    INSIDE_COLOR,
    NEAR_COLOR,
    OUTSIDE_COLOR,
    OVERLAPPING,
    PREDICTED_COLOR,
    STATE_COLORS,
    Body,
    Color,
    DrawnScene,
    DrawnTriangles,
    look_at,
    take_snapshot,
    triangles_of,
)
from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.poses import quaternions_from_matrices
from obb_collision.node.messages.box_markers import edge_points
from obb_collision.scene_files.description import View as Viewpoint
from obb_collision.shapes import Box, Shape
from obb_collision.typing import Floats

#: Updates of the browser per second, Hz: smooth to the eye; and of the panel: legible.
RATE, PANEL_RATE = 15.0, 3.0
#: Notes in the panel.
NOTES = 20
#: Diameter of a contact's dot and of a point, in terms of the scene's diagonal.
DOT, SPECK = 0.007, 0.0015
#: Colours of lines and of bodies drawn many times are linear in viser, all others are sRGB.
GAMMA = 2.2
#: Height of the field of view at first, radians.
FIELD = 0.65
#: What the panel says while there is nothing to draw.
WAITING = "Waiting for the node. Its first start compiles kernels: see its log for the progress."
CUBE = triangles_of(Box((1.0, 1.0, 1.0)))


class BrowserView:
    """A scene in the browser. ImportError without viser, OSError for the port.

    host: "localhost" for this machine only, "0.0.0.0" for all that reach it. handles: by name, how
    many there are of what is drawn, and viser's handle, None for none.
    """

    def __init__(self, port: int, host: str = "localhost", view: Viewpoint | None = None) -> None:
        import viser

        with create_server((host, 0)):
            pass  # viser waits for ever for a host that does not exist
        with redirect_stdout(StringIO()):  # it prints a frame around the address
            self._server = viser.ViserServer(host, port, label="obb_collision", verbose=False)
        self._server.gui.configure_theme(show_logo=False, show_share_button=False)
        self._server.gui.main_panel.dock_right()
        self.panel = self._server.gui.add_html(_in_panel(WAITING))
        self._view = view
        self._size, self._next_panel = 0.0, 0.0
        self.handles: dict[str, tuple[Any, Any]] = {}  # with what they were made from
        self.url = f"http://{host}:{self._server.get_port()}"

    def show(self, snapshot: DrawnScene) -> None:
        """Draw a snapshot in place of the last one."""
        self._begin(snapshot.boxes)
        zone = np.array([name in snapshot.zones for name in snapshot.names])
        edges = edge_points(snapshot.boxes).reshape(-1, 12, 2, 3)
        with self._server.atomic():
            self._show_bodies(snapshot)
            colors = np.array(STATE_COLORS)[snapshot.states]
            for k, name in enumerate(snapshot.names):
                colors[k] = snapshot.zones.get(name, colors[k])
            self._lines("edges of boxes", edges, colors[:, None, None])
            zones = snapshot.boxes[zone]
            self._meshes("zones", CUBE, zones, 2.0 * zones.half_extents, colors[zone], 0.15)
            self._lines("closest points", snapshot.near, NEAR_COLOR, 4.0)
            self._dots("contacts", snapshot.contacts, CONTACT_COLOR, DOT)
            self._dots("predicted contacts", snapshot.predicted, PREDICTED_COLOR, DOT)
            self._dots("points in zones", snapshot.cloud[snapshot.inside], INSIDE_COLOR, SPECK)
            self._dots("points", snapshot.cloud[~snapshot.inside], OUTSIDE_COLOR, SPECK)
        if monotonic() >= self._next_panel:
            self._next_panel = monotonic() + 1.0 / PANEL_RATE
            self._write(snapshot)

    def show_lines(self, lines: list[tuple[Floats, Color]]) -> None:
        """Draw edges (2 k, 3) of boxes, as a node publishes them for many objects."""
        ends = np.concatenate([ends for ends, _ in lines]).reshape(-1, 2, 3)
        low, high = ends.min(axis=(0, 1)), ends.max(axis=(0, 1))
        self._begin(Boxes([0.5 * (low + high)], [np.eye(3)], [0.5 * (high - low)]))
        counts = [len(part) // 2 for part, _ in lines]
        colors = np.repeat([color for _, color in lines], counts, axis=0)
        self._lines("edges of boxes", ends, colors[:, None])

    def close(self) -> None:
        """Stop the server."""
        with redirect_stdout(StringIO()):
            self._server.stop()

    def _begin(self, boxes: Boxes) -> None:
        """Set camera, floor and sizes by the first boxes."""
        if self._size:
            return
        self.panel.content = ""
        low, high = boxes.world_bounds()
        low, high = low.min(axis=0), high.max(axis=0)
        self._size = max(float(np.linalg.norm(high - low)), 1e-6)
        eye, target = look_at(self._view, boxes)
        camera = self._server.initial_camera
        camera.position, camera.look_at, camera.fov = eye, target, FIELD
        camera.near, camera.far = 1e-3 * self._size, 1e2 * self._size
        cell = 10.0 ** round(np.log10(self._size / 12.0))
        floor = (target[0], target[1], min(0.0, low[2]))
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
        """Draw the bodies, those that differ only in size together."""
        names: dict[str, list[Body]] = defaultdict(list)
        for body in snapshot.bodies():
            kind = "overlapping" if body.state == OVERLAPPING else "bodies"
            names[f"{kind}/{id(body.triangles.vertices)}"].append(body)
        for name in [name for name in self.handles if "/" in name and name not in names]:
            self.handles.pop(name)[1].remove()
        for name, bodies in names.items():
            placed = Boxes(
                np.array([body.position for body in bodies]),
                np.array([body.rotation for body in bodies]),
                np.ones((len(bodies), 3)),
            )
            scales = np.array([body.triangles.scale for body in bodies])
            colors = np.array(STATE_COLORS)[[body.state for body in bodies]]
            # what overlaps is translucent: contact points are inside of it
            opacity = 0.55 if name.startswith("overlapping") else None
            self._meshes(name, bodies[0].triangles, placed, scales, colors, opacity)

    def _meshes(
        self,
        name: str,
        triangles: DrawnTriangles,
        placed: Boxes,
        scales: Floats,
        colors: Floats,
        opacity: float | None = None,
    ) -> None:
        """Draw triangles many times: placed and turned as boxes are, by scales and colours."""
        quaternions = quaternions_from_matrices(placed.rotations)[:, [3, 0, 1, 2]]
        self._put(
            self._server.scene.add_batched_meshes_simple,
            name,
            len(placed),
            {
                "vertices": triangles.vertices,
                "faces": triangles.faces,
                "opacity": opacity,
                "side": "front" if triangles.closed else "double",
                "flat_shading": len(triangles.faces) < 100,
                "cast_shadow": opacity is None,
                "lod": "off",
            },
            batched_positions=placed.centers.astype(np.float32),
            batched_wxyzs=quaternions.astype(np.float32),
            batched_scales=scales.astype(np.float32),
            batched_colors=_bytes(colors**GAMMA),
        )

    def _lines(self, name: str, ends: Floats, color: Any, width: float = 2.0) -> None:
        """Draw lines (..., 2, 3), metres; the width in pixels."""
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
        """Draw something, or change what is drawn of it; anew when there are more or fewer."""
        known, handle = self.handles.get(name, (0, None))
        if handle is None or known != count:
            if handle is not None:
                handle.remove()
            handle = add(f"/{name}", **constant, **values) if count else None
            self.handles[name] = count, handle
            return
        for field, value in values.items():
            if not np.array_equal(getattr(handle, field), value):
                setattr(handle, field, value)

    def _write(self, snapshot: DrawnScene) -> None:
        """Write what the colours mean, and the notes, into the panel."""
        lines = [(text, color) for text, color, _ in snapshot.legend()]
        notes = [(note.text, note.color) for note in snapshot.notes[:NOTES]]
        if len(snapshot.notes) > NOTES:
            notes.append((f"{len(snapshot.notes) - NOTES} more", OUTSIDE_COLOR))
        content = "<hr>".join("".join(_line(*line) for line in part) for part in (lines, notes))
        content = _in_panel(content)
        if content != self.panel.content:
            self.panel.content = content


def _in_panel(content: str) -> str:
    return f"<div style='padding: 0 1em; font-size: 85%'>{content}</div>"


def _line(text: str, color: Color) -> str:
    rgb = ",".join(map(str, _bytes(np.array(color)).tolist()))
    return f"<div><span style='color: rgb({rgb})'>&#9632;</span> {escape(text)}</div>"


def _bytes(colors: Floats) -> Any:
    return np.round(255.0 * np.asarray(colors, np.float64)).astype(np.uint8)


class LiveView:
    """Updates a view from a listener, in a thread: drawing must not delay the node."""

    def __init__(
        self,
        view: BrowserView,
        listener: Listener,
        shapes: Mapping[str, Shape] | None = None,
        zones: Mapping[str, Color] | None = None,
    ) -> None:
        self._view, self._listener = view, listener
        self._shapes, self._zones = shapes, zones or {}
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
        """Draw what the listener has, as soon as it has anything."""
        listener = self._listener
        if listener.boxes.names:
            shapes = {**listener.shapes, **(self._shapes or {})}
            self._view.show(take_snapshot(listener, shapes, self._zones))
        elif listener.boxes.lines:
            self._view.show_lines(listener.boxes.lines)

    def close(self) -> None:
        """End the thread and take the server down."""
        self._ended.set()
        self._thread.join()
        self._view.close()
