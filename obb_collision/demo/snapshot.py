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

"""A scene to draw, for picture and view: objects by state, contacts, distances, points."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial import QhullError
from trimesh import Trimesh, convex, creation

from obb_collision import shapes
from obb_collision.demo.listener import Listener, is_touching, pair_of
from obb_collision.geometry.boxes import Boxes
from obb_collision.node import NamedPair
from obb_collision.scene_files.description import View
from obb_collision.shapes import Box, Shape
from obb_collision.typing import Floats, Integers

#: Corners of a round body's polygon: round to the eye, few enough to draw hundreds.
SECTIONS = 24


class DrawnTriangles(NamedTuple):
    """Vertices (n, 3), faces (m, 3), and the scale (3,) that makes metres of the vertices.

    Equal shapes but for the scale share the same arrays. closed: whether the faces point outwards
    all around, so that those seen from behind are hidden.
    """

    vertices: Floats
    faces: Integers
    scale: Floats
    closed: bool = True


@lru_cache(maxsize=10_000)
def triangles_of(shape: shapes.Shape) -> DrawnTriangles:
    """Return a shape as triangles in its own frame."""
    scale = np.array(shape.scale, np.float64)
    if isinstance(shape, shapes.Box):
        return DrawnTriangles(*_unit_body("box"), scale * shape.size)
    if isinstance(shape, (shapes.Sphere, shapes.Ellipsoid)):
        radii = shape.radius if isinstance(shape, shapes.Sphere) else np.array(shape.radii)
        return DrawnTriangles(*_unit_body("sphere"), scale * radii)
    if isinstance(shape, (shapes.Cylinder, shapes.Cone)):
        size = np.array((shape.radius, shape.radius, shape.length))
        kind = "cylinder" if isinstance(shape, shapes.Cylinder) else "cone"
        return DrawnTriangles(*_unit_body(kind), scale * size)
    if isinstance(shape, shapes.Capsule):
        return DrawnTriangles(*_capsule(shape.radius, shape.length), scale)
    if isinstance(shape, shapes.Hull):
        return _hull_triangles(shape, scale)
    if isinstance(shape, shapes.Mesh):
        return DrawnTriangles(shape.vertices, shape.faces, scale, closed=False)
    raise TypeError(f"the demo can't draw a {type(shape).__name__}")


@cache
def _unit_body(kind: str) -> tuple[Floats, Integers]:
    """Return a body of length or radius 1 about the origin."""
    body: Any
    if kind == "box":
        body = creation.box(extents=(1.0, 1.0, 1.0))
    elif kind == "sphere":
        body = creation.icosphere(subdivisions=2)
    elif kind == "cylinder":
        body = creation.cylinder(1.0, 1.0, sections=SECTIONS)
    else:
        body = creation.cone(1.0, 1.0, sections=SECTIONS)
        body.apply_translation((0.0, 0.0, -0.5))
    return np.array(body.vertices), np.array(body.faces)


@cache
def _capsule(radius: float, length: float) -> tuple[Floats, Integers]:
    body: Any = creation.capsule(length, radius, count=(SECTIONS, SECTIONS // 2))
    body.apply_translation(-body.bounds.mean(axis=0))
    return np.array(body.vertices), np.array(body.faces)


def _hull_triangles(shape: shapes.Hull, scale: Floats) -> DrawnTriangles:
    try:
        body: Any = convex.convex_hull(shape.points)
    except QhullError:  # a point, a line, a triangle
        rows = np.arange(len(shape.points))
        faces = np.stack([rows, np.roll(rows, -1), np.roll(rows, -2)], axis=1)
        body = Trimesh(shape.points, faces, process=False)
    return DrawnTriangles(np.array(body.vertices), np.array(body.faces), scale, closed=False)


Color = tuple[float, float, float]

FREE, TOUCHING, OVERLAPPING, DOUBTFUL = 0, 1, 2, 3
STATE_NAMES = ("free", "touching", "overlapping", "stale or refused")
STATE_COLORS: tuple[Color, ...] = (
    (0.05, 0.56, 0.34),
    (0.93, 0.60, 0.05),
    (0.86, 0.10, 0.14),
    (0.50, 0.50, 0.50),
)
#: Colours of contacts, closest points, predicted contacts, and points outside and in zones.
CONTACT_COLOR = (0.25, 0.02, 0.05)
NEAR_COLOR, PREDICTED_COLOR = (0.10, 0.38, 0.75), (0.55, 0.20, 0.65)
OUTSIDE_COLOR, INSIDE_COLOR = (0.55, 0.62, 0.70), (0.05, 0.12, 0.45)
#: Where a scene without a view of its own is seen from: the direction, and the distance in terms of
#: its diagonal.
DIRECTION, DISTANCE = np.array((0.38, -0.78, 0.50)), 1.5


class Label(NamedTuple):
    """A text about a place (3,), m."""

    place: Floats
    text: str
    color: Color


class Body(NamedTuple):
    """An object as triangles that are placed at a position, turned by a rotation (3, 3)."""

    name: str
    state: int
    triangles: DrawnTriangles
    position: Floats
    rotation: Floats


@dataclass(frozen=True)
class DrawnScene:
    """A node's latest outputs.

    names, boxes, states: n objects. shapes: those known, by name; zones: colours of regions, by
    name. contacts (k, 3) and predicted contacts (p, 3); near: closest points (c, 2, 3); cloud
    (m, 3), and which of its points are inside of zones (m,). notes: the most important first.
    """

    names: list[str]
    boxes: Boxes
    states: Integers
    shapes: Mapping[str, Shape]
    zones: Mapping[str, Color]
    contacts: Floats
    predicted: Floats
    near: Floats
    cloud: Floats
    inside: npt.NDArray[np.bool_]
    notes: list[Label]

    def bodies(self) -> Iterator[Body]:
        """Yield the objects that are not zones; a box for one whose shape is not known."""
        for row, name in enumerate(self.names):
            if name in self.zones:
                continue
            box = self.boxes[row]
            center, rotation = box.center, box.rotation
            shape = self.shapes.get(name)
            if shape is None:
                shape = Box(np.maximum(2.0 * box.half_extents, 1e-9))
            else:  # the box is the shape's, moved: back to the shape's own frame
                local_center, axes, _ = shape.local_box
                rotation = rotation @ axes.T
                center = center - rotation @ local_center
            yield Body(name, int(self.states[row]), triangles_of(shape), center, rotation)

    def legend(self) -> list[tuple[str, Color, str]]:
        """Return text, colour and form ("box", "zone", "dot" or "line") of what is there."""
        kinds = [s for n, s in zip(self.names, self.states, strict=True) if n not in self.zones]
        entries = [
            (f"{kinds.count(k)} {name}", STATE_COLORS[k], "box")
            for k, name in enumerate(STATE_NAMES)
            if k in kinds
        ]
        entries += [(name, color, "zone") for name, color in list(self.zones.items())[:6]]
        marks = (
            (self.contacts, "contact", CONTACT_COLOR, "dot"),
            (self.predicted, "predicted contact", PREDICTED_COLOR, "dot"),
            (self.near, "closest points", NEAR_COLOR, "line"),
            (self.cloud[self.inside], "point in a zone", INSIDE_COLOR, "dot"),
            (self.cloud[~self.inside], "other point", OUTSIDE_COLOR, "dot"),
        )
        return entries + [(text, color, form) for rows, text, color, form in marks if len(rows)]


def take_snapshot(
    listener: Listener, shapes: Mapping[str, Shape], zones: Mapping[str, Color]
) -> DrawnScene:
    """Return what a listener has received. ValueError if there are no boxes among it."""
    boxes, names = listener.boxes, listener.boxes.names
    if not names:
        raise ValueError("no boxes received")
    placed = Boxes.from_poses(boxes.poses, 0.5 * boxes.sizes)
    states = {names[row]: DOUBTFUL for row in np.flatnonzero(boxes.doubtful)}
    pairs = listener.pairs.rows
    for pair in sorted(pairs, key=lambda pair: not is_touching(pair)):  # overlapping ones last
        states |= dict.fromkeys(pair[:2], TOUCHING if is_touching(pair) else OVERLAPPING)
    near = [(row.point_a, row.point_b) for row in _rows(listener, "clearance")]
    predicted = [row.point for row in _rows(listener, "sweep")]
    cloud = listener.points
    inside = np.zeros(len(cloud), np.bool_)
    for row in [row for row, name in enumerate(names) if name in zones]:
        local = (cloud - placed.centers[row]) @ placed.rotations[row]
        inside |= (np.abs(local) <= placed.half_extents[row]).all(axis=1)
    return DrawnScene(
        names=names,
        boxes=placed,
        states=np.array([states.get(name, FREE) for name in names]),
        shapes=shapes,
        zones=zones,
        contacts=_contacts(listener),
        predicted=np.array(predicted, np.float64).reshape(-1, 3),
        near=np.array(near, np.float64).reshape(-1, 2, 3),
        cloud=cloud,
        inside=inside,
        notes=_notes(listener, names, placed, zones),
    )


def look_at(view: View | None, boxes: Boxes) -> tuple[Floats, Floats]:
    """Return from where to look (3,) and where to (3,): a scene's own view, or at all boxes."""
    if view is not None:
        return np.array(view.eye), np.array(view.target)
    low, high = (corners for corners in boxes.world_bounds())
    low, high = low.min(axis=0), high.max(axis=0)
    target = 0.5 * (low + high)
    return target + DISTANCE * np.linalg.norm(high - low) * DIRECTION, target


def _notes(
    listener: Listener, names: list[str], boxes: Boxes, zones: Mapping[str, Color]
) -> list[Label]:
    notes = []
    corners = boxes.centers + np.einsum("nij,nj->ni", boxes.rotations, boxes.half_extents)
    corner_of = dict(zip(names, corners, strict=True))
    for row in _rows(listener, "points"):
        if row.name in corner_of:
            color = zones.get(row.name, INSIDE_COLOR)
            notes.append(Label(corner_of[row.name], f"{row.points} points in {row.name}", color))
    for pair, place in sorted(_overlapping(listener), key=lambda p: -np.nan_to_num(p[0].depth)):
        text = f"{1e3 * pair.depth:.0f} mm deep: {pair_of(pair)}"
        notes.append(Label(place, text, STATE_COLORS[OVERLAPPING]))
    for row in sorted(_rows(listener, "sweep"), key=lambda row: row.time):
        text = f"in {row.time:.1f} s: {pair_of(row)}"
        notes.append(Label(np.array(row.point), text, PREDICTED_COLOR))
    for row in sorted(_rows(listener, "clearance"), key=lambda row: row.distance):
        middle = 0.5 * (np.array(row.point_a) + np.array(row.point_b))
        notes.append(
            Label(middle, f"{1e3 * row.distance:.0f} mm apart: {pair_of(row)}", NEAR_COLOR)
        )
    return notes


def _contacts(listener: Listener) -> Floats:
    """Return the contact points, and the place of each pair that overlaps without one."""
    rows = _rows(listener, "contacts")
    have = {(row.a, row.b) for row in rows}
    places = [place for pair, place in _overlapping(listener) if pair[:2] not in have]
    return np.array([*places, *(row.point for row in rows)], np.float64).reshape(-1, 3)


def _overlapping(listener: Listener) -> list[tuple[NamedPair, Floats]]:
    """Return the pairs that overlap and where; not those for which it is not computed."""
    rows = zip(listener.pairs.rows, listener.places, strict=False)
    return [(pair, at) for pair, at in rows if not is_touching(pair) and np.isfinite(at).all()]


def _rows(listener: Listener, effect: str) -> list[Any]:
    return listener.effects[effect].rows if effect in listener.effects else []
