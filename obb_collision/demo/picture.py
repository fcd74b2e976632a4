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

"""The demo's still picture, by matplotlib: the only module that needs it, which is an extra.

Texts stand in margins of their own, so that they never cover an object or each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from scipy.spatial import ConvexHull
from trimesh.remesh import subdivide_to_size

from obb_collision.demo.snapshot import (
    CONTACT_COLOR,
    INSIDE_COLOR,
    NEAR_COLOR,
    OUTSIDE_COLOR,
    PREDICTED_COLOR,
    STATE_COLORS,
    Color,
    DrawnScene,
    Label,
    look_at,
)
from obb_collision.geometry.boxes import Boxes
from obb_collision.node.messages.box_markers import edge_points
from obb_collision.scene_files.description import View
from obb_collision.typing import Floats

#: Inches, and pixels per inch.
SIZE, DPI = (16.0, 9.0), 100
#: Share of the width at either side for notes; notes per side; characters of a note.
MARGIN, NOTES, LETTERS = 0.215, 16, 38
#: Where notes end and begin, and from one to the next, shares of the height.
TOP, BOTTOM, LINE = 0.84, 0.09, 0.042
LEGEND_COLUMNS = 9
#: With more objects than this, lines from notes to their places would hide what they are about.
MAX_NOTED = 100
#: Faces and edges are drawn in pieces of this share of the scene's diagonal, the farthest first.
PIECE = 0.03
#: More triangles than these of one body are drawn as their convex hull.
MAX_TRIANGLES = 20_000
TO_LIGHT = np.array((0.35, -0.55, 0.76))
INK, GREY = (0.13, 0.15, 0.18), (0.42, 0.45, 0.49)


def save_picture(
    file: Path, snapshot: DrawnScene, title: str, subtitle: str, view: View | None = None
) -> None:
    """Write a picture of what a node published as PNG. OSError for the file."""
    figure = draw_picture(snapshot, title, subtitle, view)
    figure.savefig(file, format="png", pil_kwargs={"optimize": True})


def draw_picture(
    snapshot: DrawnScene, title: str, subtitle: str, view: View | None = None
) -> Figure:
    """Return the figure: the scene in the middle, texts around it."""
    notes = snapshot.notes if len(snapshot.names) <= MAX_NOTED else []
    margin = MARGIN if notes else 0.02
    figure = Figure(figsize=SIZE, dpi=DPI)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((margin, 0.1, 1.0 - 2.0 * margin, 0.76))
    axes.set_axis_off()
    axes.set_aspect("equal", adjustable="box")
    camera = _Camera(*look_at(view, snapshot.boxes))
    _draw_floor(axes, camera, snapshot.boxes)
    _draw_solids(axes, camera, snapshot)
    _draw_zones(axes, camera, snapshot)
    _draw_marks(axes, camera, snapshot)
    ends = camera.project(edge_points(snapshot.boxes))[:, :2]
    axes.set(xlim=(ends[:, 0].min(), ends[:, 0].max()), ylim=(ends[:, 1].min(), ends[:, 1].max()))
    axes.apply_aspect()
    _draw_notes(axes, camera, notes)
    figure.text(0.02, 0.935, title, fontsize=26, weight="bold", color=INK)
    figure.text(0.02, 0.895, subtitle, fontsize=14, color=GREY)
    handles = [_sign(*entry) for entry in snapshot.legend()]
    row = {"ncols": LEGEND_COLUMNS, "columnspacing": 1.6, "handlelength": 1.6}
    figure.legend(handles=handles, loc="lower left", frameon=False, fontsize=12, **row)
    return figure


class _Camera:
    """Looks from a place to another; z is up."""

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
    low, high = boxes.world_bounds()
    low, high = low.min(axis=0), high.max(axis=0)
    step = 10.0 ** np.round(np.log10(max(*(high - low)[:2], 1e-6) / 8.0))
    x, y = (np.arange(np.floor(low[k] / step), np.ceil(high[k] / step) + 1) * step for k in (0, 1))
    z = min(0.0, low[2])
    lines = [[(a, y[0], z), (a, y[-1], z)] for a in x] + [[(x[0], b, z), (x[-1], b, z)] for b in y]
    projected: Any = camera.project(np.array(lines))[..., :2]
    axes.add_collection(LineCollection(projected, colors="0.88", linewidths=0.8, zorder=0))


def _draw_solids(axes: Any, camera: _Camera, snapshot: DrawnScene) -> None:
    """Draw faces shaded in the colour of their state, and the edges of the boxes."""
    low, high = snapshot.boxes.world_bounds()
    piece = PIECE * float(np.linalg.norm(high.max(axis=0) - low.min(axis=0)))
    corners, colors = [], []
    for body in snapshot.bodies():
        vertices, faces, scale, closed = body.triangles
        if len(faces) > MAX_TRIANGLES:
            faces, closed = ConvexHull(vertices, qhull_options="QJ").simplices, False
        vertices, faces = subdivide_to_size(vertices * scale, faces, piece, max_iter=20)
        placed = (vertices @ body.rotation.T + body.position)[faces]
        normals = np.cross(placed[:, 1] - placed[:, 0], placed[:, 2] - placed[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        facing = np.einsum("nk,nk->n", normals, camera.eye - placed[:, 0])
        shown = (facing > 0.0) | (not closed)
        normals *= np.where(facing < 0.0, -1.0, 1.0)[:, None]
        light = 0.74 + 0.26 * np.maximum(normals @ TO_LIGHT, 0.0)
        pale = 0.4 * np.array(STATE_COLORS[body.state]) + 0.6
        corners.append(placed[shown])
        colors.append((light[:, None] * pale)[shown])
    faces_count = sum(len(part) for part in corners)
    solid = np.array([name not in snapshot.zones for name in snapshot.names])
    edges, owner = _visible_edges(snapshot.boxes[solid], camera.eye, piece)
    corners.append(edges[:, [0, 1, 1]])
    colors.append(np.array(STATE_COLORS)[snapshot.states[solid][owner]].reshape(-1, 3))
    points = camera.project(np.concatenate(corners))
    depth = points[..., 2].mean(axis=1)
    depth[faces_count:] -= piece  # before the faces that they bound
    order = np.argsort(-depth, kind="stable")
    rgb = np.concatenate(colors)[order]
    widths = np.where(order < faces_count, 0.5, 1.3)
    triangles: Any = points[order][..., :2]
    axes.add_collection(
        PolyCollection(triangles, facecolors=rgb, edgecolors=rgb, linewidths=widths)
    )


def _visible_edges(boxes: Boxes, eye: Floats, piece: float) -> tuple[Floats, Any]:
    """Return the edges of faces that are seen, in pieces (k, 2, 3), and their boxes (k,)."""
    ends = edge_points(boxes).reshape(-1, 12, 2, 3)
    middles = ends.mean(axis=2) - boxes.centers[:, None]
    local = np.einsum("nij,nki->nkj", boxes.rotations, middles)
    sign = np.sign(local) * (np.abs(local) > 0.5 * boxes.half_extents[:, None])
    toward = np.einsum("nij,ni->nj", boxes.rotations, eye - boxes.centers)
    seen = (sign * toward[:, None] > boxes.half_extents[:, None]).any(axis=2)
    owner, ends = np.nonzero(seen)[0], ends[seen]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    parts = np.maximum(np.ceil(lengths / piece), 1).astype(np.int64)
    row = np.repeat(np.arange(len(ends)), parts)
    k = np.arange(len(row)) - np.repeat(np.cumsum(parts) - parts, parts)
    share = np.stack([k, k + 1], axis=1) / parts[row][:, None]
    start, step = ends[row, :1], (ends[:, 1:] - ends[:, :1])[row]
    return start + share[..., None] * step, owner[row]


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
    """Draw contacts, closest points and points over everything: contacts are inside of things."""

    def dots(points: Floats, color: Color, size: float, rim: float, order: float) -> None:
        x, y, _ = camera.project(points).T
        axes.scatter(x, y, size, [color], edgecolors="white", linewidths=rim, zorder=order)

    dots(snapshot.cloud[~snapshot.inside], OUTSIDE_COLOR, 2.0, 0.0, 0.5)
    dots(snapshot.cloud[snapshot.inside], INSIDE_COLOR, 6.0, 0.0, 3.0)
    near: Any = camera.project(snapshot.near)[..., :2]
    axes.add_collection(LineCollection(near, colors=[NEAR_COLOR], linewidths=2.0, zorder=4))
    dots(snapshot.near.reshape(-1, 3), NEAR_COLOR, 24.0, 1.0, 4.5)
    dots(snapshot.predicted, PREDICTED_COLOR, 60.0, 1.2, 5.0)
    dots(snapshot.contacts, CONTACT_COLOR, 36.0, 1.2, 6.0)


def _draw_notes(axes: Any, camera: _Camera, notes: Sequence[Label]) -> None:
    """Write the first notes at the sides, each at the one that it is nearer to, top down."""
    if not notes:
        return
    figure = axes.figure
    shown = notes[: 2 * NOTES]
    places = axes.transData.transform(camera.project(np.array([n.place for n in shown]))[:, :2])
    places = figure.transFigure.inverted().transform(places)
    rows = sorted(range(len(shown)), key=lambda k: float(places[k, 0]))
    middle = max(len(rows) - NOTES, min(NOTES, sum(places[k, 0] < 0.5 for k in rows)))
    for side, x in ((rows[:middle], 0.01), (rows[middle:], 1.0 - MARGIN + 0.01)):
        side.sort(key=lambda k: -places[k, 1])
        y = TOP
        for row, k in enumerate(side):  # at its place's height, as far as there is room
            y = min(y - LINE, max(float(places[k, 1]), BOTTOM + LINE * (len(side) - row)))
            text, color = shown[k].text, shown[k].color
            line = {"arrowstyle": "-", "color": color, "linewidth": 0.8, "alpha": 0.7, "shrinkB": 4}
            axes.annotate(
                text if len(text) <= LETTERS else text[: LETTERS - 1] + "…",
                tuple(places[k]),
                (x, y),
                "figure fraction",
                "figure fraction",
                arrowprops={**line, "relpos": (1.0 if x < 0.5 else 0.0, 0.5)},
                va="center",
                fontsize=11,
                color=INK,
                annotation_clip=False,
            )
    if len(notes) > len(shown):
        figure.text(0.98, 0.895, f"{len(notes) - len(shown)} more", ha="right", color=GREY)


def _sign(text: str, color: Color, form: str) -> Any:
    """Return what stands in the legend, drawn as in the picture."""
    if form == "dot":
        return Line2D([], [], color=color, marker="o", markersize=8, linestyle="", label=text)
    if form == "line":
        return Line2D([], [], color=color, linewidth=2.0, label=text)
    pale: Any = [0.6 + 0.4 * part for part in color] if form == "box" else (*color, 0.15)
    return Patch(
        facecolor=pale, edgecolor=color, label=text, linestyle="--" if form == "zone" else "-"
    )
