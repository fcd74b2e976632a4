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

"""The picture of the demo. It needs matplotlib, which is an optional dependency.

Notes stand in a margin, where they cover no object; the numbers of the first ones stand in the
scene. An inset enlarges a collision that is too small to see.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from scipy.spatial import ConvexHull
from trimesh.remesh import subdivide_to_size

from obb_collision.boxes import Boxes
from obb_collision.demo.listener import Color
from obb_collision.demo.snapshot import (
    DOUBTFUL,
    EDGE_COLORS,
    OVERLAPPING,
    STATE_COLORS,
    TOUCH_SIGN,
    TOUCHING,
    Body,
    DrawnScene,
    Label,
    diagonal_of,
    look_at,
    pieces,
)
from obb_collision.node.messages.box_markers import edge_points
from obb_collision.scene_files.description import View
from obb_collision.typing import Floats

#: Inches, and pixels per inch.
SIZE, DPI = (16.0, 9.0), 100
#: Share of the width for notes at the right; maximum number of notes, and of those with a number in
#: the scene; maximum characters of a note.
MARGIN, NOTES, MARKED, LETTERS = 0.235, 17, 5, 42
#: The top of the first note, and the distance to the next, shares of the height.
TOP, LINE = 0.84, 0.042
#: Share of the height for the scene, and half of that relative to the extent of the boxes.
HEIGHT, FILL = 0.8, 0.51
SIDES = np.array((-1.0, 1.0))
#: Edge of the inset, share of the width; half of the length that it shows, relative to the depth of
#: the collision, or at least to the smaller object.
INSET, ZOOM, LEAST = 0.19, 2.5, 0.25
NOTES_BESIDE_INSET = 8
LEGEND_COLUMNS = 9
#: Faces and edges are divided into pieces and drawn from far to near: length of a piece relative to
#: the visible length, and maximum number of pieces along a body.
PIECE, MOST_PIECES = 0.02, 60.0
#: How much nearer than they are edges are sorted, in pieces: sorting errs by half a piece.
NEARER = 0.6
#: Maximum number of triangles of a body; one with more is drawn as its convex hull.
MAX_TRIANGLES = 20_000
TO_LIGHT = np.array((0.36, -0.48, 0.80))
#: Pixels from a number to the place of its note.
BADGE = 26.0
#: Directions from the place to its number, the first one up, and positions on rings around it.
TURNS = np.radians(90.0 + 45.0 * np.array((0, 1, -1, 2, -2, 3, -3, 4)))
RINGS = np.concatenate(
    [k * np.stack([np.cos(TURNS), np.sin(TURNS)], axis=1) for k in range(1, MARKED + 1)]
)
#: Area (points squared) and width of the white rim (points) of a dot by form.
DOTS = {"dot": (40.0, 1.2), "line": (24.0, 1.0), "speck": (5.0, 0.0)}
#: Sum of red, green and blue above which a number is dark.
BRIGHT = 1.6
INK, GREY = (0.13, 0.15, 0.18), (0.42, 0.45, 0.49)


def save_picture(
    file: Path, snapshot: DrawnScene, title: str, subtitle: str, view: View | None = None
) -> None:
    """Write a picture of the scene as PNG; OSError if the file cannot be written."""
    figure = draw_picture(snapshot, title, subtitle, view)
    figure.savefig(file, format="png", pil_kwargs={"optimize": True})


def draw_picture(
    snapshot: DrawnScene, title: str, subtitle: str, view: View | None = None
) -> Figure:
    """Return the figure of the scene, with texts around it."""
    figure = Figure(figsize=SIZE, dpi=DPI)
    FigureCanvasAgg(figure)
    width = 1.0 - (MARGIN + 0.03 if snapshot.notes else 0.0)
    axes = figure.add_axes((0.0, 0.08, width, HEIGHT))
    axes.set_axis_off()
    camera = _Camera(*look_at(view, snapshot.boxes))
    _draw_floor(axes, camera, snapshot.boxes)
    _draw_solids(axes, camera, snapshot.wires(), PIECE * diagonal_of(snapshot.boxes))
    _draw_zones(axes, camera, snapshot)
    _draw_marks(axes, camera, snapshot)
    ends = camera.project(edge_points(snapshot.boxes))[:, :2]
    low, high = ends.min(axis=0), ends.max(axis=0)
    shape = np.array((SIZE[0] * width, SIZE[1] * HEIGHT))  # nothing is cut off, or stretched
    reach = FILL * shape * float(((high - low) / shape).max())
    axes.set(
        xlim=(low + high)[0] / 2 + reach[0] * SIDES, ylim=(low + high)[1] / 2 + reach[1] * SIDES
    )
    small = snapshot.small()
    for k in small[:1]:
        _draw_inset(figure, camera, snapshot, k)
    _draw_notes(axes, camera, snapshot.notes, NOTES_BESIDE_INSET if small else NOTES)
    figure.text(0.02, 0.935, title, fontsize=26, weight="bold", color=INK)
    figure.text(0.02, 0.895, subtitle, fontsize=14, color=GREY)
    handles = [_sign(*entry) for entry in snapshot.legend()]
    row: Any = {"facecolor": "white", "edgecolor": "none", "ncols": LEGEND_COLUMNS}
    row |= {"columnspacing": 1.6, "handlelength": 1.6}
    figure.legend(handles=handles, loc="lower left", fontsize=12, **row)
    return figure


class _Camera:
    """A camera with a viewpoint and a target; z is up."""

    def __init__(self, eye: Floats, target: Floats) -> None:
        self.eye = eye
        ahead = (target - eye) / np.linalg.norm(target - eye)
        right = np.cross(ahead, (0.0, 0.0, 1.0) if abs(ahead[2]) < 0.999 else (0.0, 1.0, 0.0))
        right /= np.linalg.norm(right)
        self._axes = np.stack([right, np.cross(right, ahead), ahead], axis=1)
        self._nearest = 0.02 * float(np.linalg.norm(target - eye))

    def project(self, points: Floats) -> Floats:
        """Return image x and y and the depth (..., 3) of points (..., 3)."""
        result: Floats = (points - self.eye) @ self._axes
        result[..., :2] /= np.maximum(result[..., 2:], self._nearest)
        return result


def _draw_floor(axes: Any, camera: _Camera, boxes: Boxes) -> None:
    bounds = boxes.aabb()
    low, high = bounds.minimum, bounds.maximum
    step = 10.0 ** np.round(np.log10(max(*(high - low)[:2], 1e-6) / 8.0))
    x, y = (np.arange(np.floor(low[k] / step), np.ceil(high[k] / step) + 1) * step for k in (0, 1))
    z = min(0.0, low[2])
    lines = [[(a, y[0], z), (a, y[-1], z)] for a in x] + [[(x[0], b, z), (x[-1], b, z)] for b in y]
    projected: Any = camera.project(np.array(lines))[..., :2]
    style: Any = {"colors": "0.88", "linewidths": 0.8, "zorder": 0, "clip_on": False}
    axes.add_collection(LineCollection(projected, **style))


def _draw_inset(figure: Any, camera: _Camera, snapshot: DrawnScene, row: int) -> None:
    """Draw the objects of a note, enlarged, in the margin."""
    note = snapshot.notes[row]
    height = INSET * SIZE[0] / SIZE[1]
    axes = figure.add_axes((1.0 - MARGIN, 0.1, INSET, height), xticks=[], yticks=[])
    axes.patch.set_alpha(0.0)
    for spine in axes.spines.values():
        spine.set(color=EDGE_COLORS[OVERLAPPING], linewidth=2.0)
    reach = max(ZOOM * note.depth, LEAST * note.extent)
    x, y, depth = camera.project(note.place)
    pair = [body for body in snapshot.wires() if body.name in note.names]
    sizes = {
        body.name: float(np.ptp(body.placed(body.triangles.vertices), axis=0).max())
        for body in pair
    }
    larger = max(sizes, key=lambda name: sizes[name], default="")
    _draw_solids(axes, camera, pair, PIECE * 2.0 * reach, behind=larger)
    *_, contacts = snapshot.marks()
    _draw_dots(axes, camera, contacts.points, contacts.color, *DOTS[contacts.form], 6.0)
    axes.set(xlim=x + reach / depth * SIDES, ylim=y + reach / depth * SIDES)
    title = f"{row + 1}, enlarged: {200.0 * reach:.0f} cm wide"
    figure.text(1.0 - MARGIN, 0.1 + height + 0.015, title, fontsize=11, color=INK)


def _draw_solids(
    axes: Any, camera: _Camera, bodies: Iterable[Body], piece: float, behind: str = ""
) -> None:
    """Draw faces, shaded in the colour of their state, and visible edges.

    behind: the name of an object whose faces are pale and behind all others.
    """
    faces, lines, drawn = list[_Part](), list[_Part](), set[str]()
    for body in map(_simplified, bodies):
        extent = np.ptp(body.triangles.vertices * body.triangles.scale, axis=0).max()
        size = max(piece, float(extent) / MOST_PIECES)
        normals, facing = _facing(body, camera.eye)
        lines.append(_edges_of(body, facing, size))
        if body.name not in drawn:  # else it is the box of a drawn body
            faces.append(_faces_of(body, normals, facing, size, body.name == behind))
            if body.state == TOUCHING:
                x, y, _ = camera.project(body.position)
                style = {"ha": "center", "va": "center", "clip_on": True, "zorder": 7}
                axes.text(x, y, TOUCH_SIGN, fontsize=20, **style)
        drawn.add(body.name)
    count = sum(len(part.corners) for part in faces)
    parts = [*faces, *lines]
    points = camera.project(np.concatenate([np.empty((0, 3, 3)), *(p.corners for p in parts)]))
    offsets = np.concatenate([np.empty(0), *(np.full(len(p.corners), p.offset) for p in parts)])
    order = np.argsort(-points[..., 2].mean(axis=1) - offsets, kind="stable")
    rgb = np.concatenate([np.empty((0, 3)), *(p.colors for p in parts)])[order]
    widths = np.where(order < count, 0.5, 1.3)
    triangles: Any = points[order][..., :2]
    axes.add_collection(
        PolyCollection(triangles, facecolors=rgb, edgecolors=rgb, linewidths=widths)
    )


class _Part(NamedTuple):
    """Triangles (n, 3, 3) with colours (n, 3), to be sorted by their depth plus an offset, m."""

    corners: Floats
    colors: Floats
    offset: float


def _edges_of(body: Body, facing: Floats, size: float) -> _Part:
    """Return the visible edges, in pieces; those of a body of unknown state are dashed."""
    seen = ((facing[body.triangles.sides] > 0.0) | (not body.triangles.closed)).any(axis=1)
    parts, _, number = pieces(body.edges()[seen], size)
    parts = parts[number % 2 == 0] if body.state == DOUBTFUL else parts
    colors = np.tile(EDGE_COLORS[body.state], (len(parts), 1))
    return _Part(parts[:, [0, 1, 1]], colors, -NEARER * size)  # before the faces beside them


def _faces_of(body: Body, normals: Floats, facing: Floats, size: float, behind: bool) -> _Part:
    """Return the visible faces, in pieces."""
    vertices, faces, scale, closed, *_ = body.triangles
    normals *= np.where(facing < 0.0, -1.0, 1.0)[:, None]
    light = 0.8 + 0.2 * np.clip(normals @ TO_LIGHT, 0.0, 1.0)
    shown = np.flatnonzero((facing > 0.0) | (not closed))
    vertices, faces, origin = subdivide_to_size(
        vertices * scale, faces[shown], size, max_iter=20, return_index=True
    )
    color = np.array(STATE_COLORS[body.state])
    color = 0.6 + 0.4 * color if behind else color
    corners = (vertices @ body.rotation.T + body.position)[faces]
    return _Part(corners, light[shown][origin][:, None] * color, np.inf if behind else 0.0)


def _simplified(body: Body) -> Body:
    """Return the convex hull of a body of too many triangles, and other bodies as they are."""
    if len(body.triangles.faces) <= MAX_TRIANGLES:
        return body
    faces = ConvexHull(body.triangles.vertices, qhull_options="QJ").simplices
    none = np.empty((0, 2), np.int64)
    hull = body.triangles._replace(faces=faces, closed=False, edges=none, sides=none)
    return body._replace(triangles=hull)


def _facing(body: Body, eye: Floats) -> tuple[Floats, Floats]:
    """Return the unit normals (m, 3) of faces, and the eye's distance in front of each (m,)."""
    placed = body.placed(body.triangles.vertices)[body.triangles.faces]
    normals = np.cross(placed[:, 1] - placed[:, 0], placed[:, 2] - placed[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    return normals, np.einsum("nk,nk->n", normals, eye - placed[:, 0])


def _draw_zones(axes: Any, camera: _Camera, snapshot: DrawnScene) -> None:
    for row, name in enumerate(snapshot.names):
        if name in snapshot.zones:
            color = snapshot.zones[name]
            box = snapshot.boxes[[row]]
            ends: Any = camera.project(edge_points(box))[:, :2]
            outline = ends[ConvexHull(ends, qhull_options="QJ").vertices]
            axes.fill(*outline.T, color=color, alpha=0.10, linewidth=0)
            axes.add_collection(
                LineCollection(
                    ends.reshape(-1, 2, 2), colors=[color], linewidths=1.4, linestyles="--"
                )
            )


def _draw_marks(axes: Any, camera: _Camera, snapshot: DrawnScene) -> None:
    """Draw contacts and closest points in front of objects, in which contacts are hidden."""
    for order, (name, color, form, points) in enumerate(snapshot.marks()):
        if form == "line":
            ends: Any = camera.project(points)[..., :2]
            axes.add_collection(LineCollection(ends, colors=[color], linewidths=2.0, zorder=4))
        z = order - 1.5 if name == "other point" else 3.0 + order  # other points are on the floor
        _draw_dots(axes, camera, points.reshape(-1, 3), color, *DOTS[form], z)


def _draw_dots(
    axes: Any, camera: _Camera, points: Floats, color: Color, size: float, rim: float, order: float
) -> None:
    x, y, _ = camera.project(points).T
    axes.scatter(x, y, size, [color], edgecolors="white", linewidths=rim, zorder=order)


def _draw_notes(axes: Any, camera: _Camera, notes: Sequence[Label], most: int) -> None:
    """List notes at the right, and mark the places of the first ones by their numbers."""
    places: list[Any] = []
    for k, note in enumerate(notes[:most]):
        text = note.text if len(note.text) <= LETTERS else note.text[: LETTERS - 1] + "…"
        y = TOP - k * LINE
        axes.figure.text(1.0 - MARGIN, y, text, fontsize=11, color=INK, va="center")
        if k < MARKED:
            ink = "white" if sum(note.color) < BRIGHT else INK
            style = {"color": ink, "weight": "bold", "ha": "center", "va": "center"}
            sign: Any = {
                "boxstyle": "circle,pad=0.25",
                "facecolor": note.color,
                "edgecolor": "white",
            }
            axes.figure.text(1.0 - MARGIN - 0.013, y, str(k + 1), bbox=sign, fontsize=9, **style)
            spot = axes.transData.transform(camera.project(note.place)[:2])
            at = next(  # beside the place, which remains visible
                at
                for at in spot + BADGE * RINGS
                if all(np.hypot(*(at - other)) >= BADGE for other in places)
            )
            places.append(at)
            ends = axes.transData.inverted().transform([spot, at])
            axes.plot(*ends.T, color=note.color, linewidth=1.5, zorder=10)
            axes.text(*ends[1], str(k + 1), bbox=sign, fontsize=9, zorder=20 - k, **style)
    if len(notes) > most:
        more = f"{len(notes) - most} more"
        axes.figure.text(1.0 - MARGIN, TOP - most * LINE, more, color=GREY, va="center")


def _sign(text: str, color: Color, form: str) -> Any:
    """Return the handle of a legend entry."""
    if form in ("dot", "speck"):
        return Line2D([], [], color=color, marker="o", markersize=8, linestyle="", label=text)
    if form == "line":
        return Line2D([], [], color=color, linewidth=2.0, label=text)
    if form == "zone":
        return Patch(facecolor=(*color, 0.15), edgecolor=color, label=text, linestyle="--")
    state = STATE_COLORS.index(color)
    style: Any = "--" if state == DOUBTFUL else "-"
    return Patch(facecolor=color, edgecolor=EDGE_COLORS[state], label=text, linestyle=style)
