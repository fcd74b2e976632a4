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

Texts stand in a margin of their own, so that they never cover an object or each other; the first
ones have a number where they are about.
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
#: Share of the width at the right for notes; how many, and how many have a number in the scene;
#: characters of a note.
MARGIN, NOTES, MARKED, LETTERS = 0.235, 17, 5, 42
#: Where notes begin, and from one to the next, shares of the height.
TOP, LINE = 0.84, 0.042
#: Share of the height that the scene has, and half of it in terms of what the boxes take.
HEIGHT, FILL = 0.8, 0.51
SIDES = np.array((-1.0, 1.0))
LEGEND_COLUMNS = 9
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
    """Return the figure: the scene, and texts around it."""
    figure = Figure(figsize=SIZE, dpi=DPI)
    FigureCanvasAgg(figure)
    width = 1.0 - (MARGIN + 0.03 if snapshot.notes else 0.0)
    axes = figure.add_axes((0.0, 0.08, width, HEIGHT))
    axes.set_axis_off()
    camera = _Camera(*look_at(view, snapshot.boxes))
    _draw_floor(axes, camera, snapshot.boxes)
    _draw_solids(axes, camera, snapshot)
    _draw_zones(axes, camera, snapshot)
    _draw_marks(axes, camera, snapshot)
    ends = camera.project(edge_points(snapshot.boxes))[:, :2]
    low, high = ends.min(axis=0), ends.max(axis=0)
    shape = np.array((SIZE[0] * width, SIZE[1] * HEIGHT))  # nothing is cut off, or stretched
    reach = FILL * shape * float(((high - low) / shape).max())
    axes.set(
        xlim=(low + high)[0] / 2 + reach[0] * SIDES, ylim=(low + high)[1] / 2 + reach[1] * SIDES
    )
    _draw_notes(axes, camera, snapshot.notes)
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
    """List the first notes at the right, and mark the places of the first few by their numbers."""
    for k, note in enumerate(notes[:NOTES]):
        text = note.text if len(note.text) <= LETTERS else note.text[: LETTERS - 1] + "…"
        y = TOP - k * LINE
        axes.figure.text(1.0 - MARGIN, y, text, fontsize=11, color=INK, va="center")
        if k < MARKED:
            style = {"color": "white", "weight": "bold", "ha": "center", "va": "center"}
            sign: Any = {"boxstyle": "circle,pad=0.25", "facecolor": note.color, "linewidth": 0}
            axes.figure.text(1.0 - MARGIN - 0.013, y, str(k + 1), bbox=sign, fontsize=9, **style)
            x, y, _ = camera.project(note.place)
            axes.text(x, y, str(k + 1), bbox=sign, fontsize=9, zorder=20 - k, **style)
    if len(notes) > NOTES:
        more = f"{len(notes) - NOTES} more"
        axes.figure.text(1.0 - MARGIN, TOP - NOTES * LINE, more, color=GREY, va="center")


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
