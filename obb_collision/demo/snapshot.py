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
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial import QhullError
from trimesh import Trimesh, convex, creation

from obb_collision import shapes
from obb_collision.boxes import Boxes
from obb_collision.demo.listener import Color, Cycle, is_touching, pair_of
from obb_collision.geometry.shapes.primitives import Primitive
from obb_collision.node import NamedPair
from obb_collision.node.parameters.sources import NAMESPACE
from obb_collision.scene_files.description import View
from obb_collision.shapes import Box, Shape
from obb_collision.typing import Floats, Integers

#: Corners of the polygon of a round body: enough for the eye, few enough for hundreds of bodies.
SECTIONS = 24
#: Angle between the faces at a sharp edge (rad), and maximum number of drawn edges of a body.
SHARP, MAX_EDGES = 0.6, 2000


class DrawnTriangles(NamedTuple):
    """Vertices (n, 3), faces (m, 3), and the scale (3,) from vertices to metres.

    Shapes that differ only by a scale share the arrays. closed: whether all faces point outwards,
    so that those seen from behind are hidden. edges (e, 2): vertices of sharp edges; sides (e, 2):
    the faces beside them.
    """

    vertices: Floats
    faces: Integers
    scale: Floats
    closed: bool
    edges: Integers
    sides: Integers


def _triangles(body: Any, closed: bool = True) -> DrawnTriangles:
    """Return a trimesh as triangles; one with too many sharp edges has none."""
    sharp = body.face_adjacency_angles > SHARP
    sharp &= np.count_nonzero(sharp) <= MAX_EDGES
    edges, sides = body.face_adjacency_edges[sharp], body.face_adjacency[sharp]
    vertices, faces = np.array(body.vertices), np.array(body.faces)
    return DrawnTriangles(vertices, faces, np.ones(3), closed, edges, sides)


@lru_cache(maxsize=10_000)
def triangles_of(shape: shapes.Shape) -> DrawnTriangles:
    """Return a shape as triangles in its own frame."""
    size: Any = 1.0
    if isinstance(shape, Primitive) and type(shape) in UNIT_BODIES:
        size, drawn = np.array(shape._reach(), np.float64), UNIT_BODIES[type(shape)]
    elif isinstance(shape, shapes.Capsule):
        count = SECTIONS, SECTIONS // 2
        body: Any = creation.capsule(shape.length, shape.radius, count=count)
        drawn = _triangles(body.apply_translation(-body.bounds.mean(axis=0)))
    elif isinstance(shape, shapes.Hull):
        drawn = _hull_triangles(shape)
    elif isinstance(shape, shapes.Mesh):
        drawn = _triangles(Trimesh(shape.vertices, shape.faces, process=False), closed=False)
    else:
        raise TypeError(f"the demo can't draw a {type(shape).__name__}")
    return drawn._replace(scale=np.array(shape.scale, np.float64) * size)


CUBE = _triangles(creation.box(extents=(2.0, 2.0, 2.0)))
BALL = _triangles(creation.icosphere(subdivisions=2))
_CONE: Any = creation.cone(1.0, 2.0, sections=SECTIONS)
#: Bodies that reach from -1 to 1 along each axis, by the shapes that are scaled copies of them.
UNIT_BODIES: dict[type, DrawnTriangles] = {
    shapes.Box: CUBE,
    shapes.Sphere: BALL,
    shapes.Ellipsoid: BALL,
    shapes.Cylinder: _triangles(creation.cylinder(1.0, 2.0, sections=SECTIONS)),
    shapes.Cone: _triangles(_CONE.apply_translation((0.0, 0.0, -1.0))),
}


def _hull_triangles(shape: shapes.Hull) -> DrawnTriangles:
    try:
        body: Any = convex.convex_hull(shape.points)
    except QhullError:  # a point, a line, a triangle
        rows = np.arange(len(shape.points))
        faces = np.stack([rows, np.roll(rows, -1), np.roll(rows, -2)], axis=1)
        body = Trimesh(shape.points, faces, process=False)
    return _triangles(body, closed=False)


FREE, ROBOT, TOUCHING, OVERLAPPING, DOUBTFUL = range(5)
STATE_NAMES = ("free", "free, of a robot", "touching", "overlapping", "unknown")
#: Colours of faces and of edges by state: only touching and overlapping have warning colours.
STATE_COLORS: tuple[Color, ...] = (
    (0.92, 0.93, 0.95),
    (0.42, 0.60, 0.86),
    (1.00, 0.72, 0.16),
    (0.93, 0.27, 0.25),
    (0.88, 0.80, 0.97),
)
EDGE_COLORS: tuple[Color, ...] = (
    (0.58, 0.61, 0.65),
    (0.13, 0.31, 0.60),
    (0.62, 0.38, 0.00),
    (0.66, 0.00, 0.06),
    (0.48, 0.18, 0.78),
)
#: A sign beside touching objects, for people who cannot tell amber from red.
TOUCH_SIGN = "≈"
#: Colours of contacts, closest points, predicted contacts, and points outside and in zones.
CONTACT_COLOR = (0.25, 0.02, 0.05)
NEAR_COLOR, PREDICTED_COLOR = (0.00, 0.45, 0.47), (0.45, 0.28, 0.10)
OUTSIDE_COLOR, INSIDE_COLOR = (0.55, 0.62, 0.70), (0.05, 0.12, 0.45)
#: Collisions less deep than this share of the scene's diagonal are too small to be seen.
SMALL = 0.02
#: Begin of the names of sensors, which are drawn as their points.
SOURCES = f"{NAMESPACE}/"
#: The viewpoint of a scene without its own: direction, and distance relative to the diagonal.
DIRECTION, DISTANCE = np.array((0.38, -0.78, 0.50)), 1.5


class Label(NamedTuple):
    """A note about a place (3,), m.

    extent: size of its smaller object, m; depth: of an overlap, m, NaN for other notes; names: the
    objects of a pair.
    """

    place: Floats
    text: str
    color: Color
    extent: float
    depth: float = np.nan
    names: tuple[str, ...] = ()


class Mark(NamedTuple):
    """Points (k, 3), m, of form "dot" or "speck", or ends (k, 2, 3) of lines, of form "line"."""

    name: str
    color: Color
    form: str
    points: Floats


class Body(NamedTuple):
    """An object as triangles, with position and rotation (3, 3)."""

    name: str
    state: int
    triangles: DrawnTriangles
    position: Floats
    rotation: Floats

    def placed(self, points: Floats) -> Floats:
        """Return points (..., 3) from the frame of the triangles in the world, m."""
        turned: Floats = (points * self.triangles.scale) @ self.rotation.T
        return turned + self.position

    def edges(self) -> Floats:
        """Return the ends (e, 2, 3) of the sharp edges in the world, m."""
        return self.placed(self.triangles.vertices)[self.triangles.edges]


def pieces(ends: Floats, length: float) -> tuple[Floats, Integers, Integers]:
    """Divide lines (n, 2, 3) into pieces (k, 2, 3); return also line and number of each (k,)."""
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    parts = np.maximum(np.ceil(lengths / length), 1).astype(np.int64)
    row = np.repeat(np.arange(len(ends)), parts)
    k = np.arange(len(row)) - np.repeat(np.cumsum(parts) - parts, parts)
    share = np.stack([k, k + 1], axis=1) / parts[row][:, None]
    start, step = ends[row, :1], (ends[:, 1:] - ends[:, :1])[row]
    return start + share[..., None] * step, row, k


NOTHING: Floats = np.empty((0, 3))


@dataclass(frozen=True)
class DrawnScene:
    """The output of a node to draw.

    names, boxes, states: of n objects. boxed: names of objects in pairs that boxes decided. shapes:
    known shapes by name; zones: colours of regions by name. contacts (k, 3) and predicted contacts
    (p, 3); near: closest points (c, 2, 3); cloud (m, 3); inside (m,): whether a point is in a zone
    or an object that counts points. notes: the most important first. strangers (s, 3): points of
    what only sensors see.
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
    boxed: frozenset[str] = frozenset()
    strangers: Floats = field(default_factory=lambda: NOTHING)

    def unknown(self) -> DrawnScene:
        """Return a copy in which collisions are unknown."""
        return replace(
            self,
            states=np.full(len(self.names), DOUBTFUL),
            contacts=NOTHING,
            predicted=NOTHING,
            near=np.empty((0, 2, 3)),
            notes=[],
            boxed=frozenset(),
        )

    def wires(self) -> Iterator[Body]:
        """Yield the objects, and the boxes of those in pairs that boxes decided."""
        rows = {name: row for row, name in enumerate(self.names)}
        for body in self.bodies():
            yield body
            if body.name in self.boxed:
                box = self.boxes[rows[body.name]]
                cube = CUBE._replace(scale=box.half_extents)
                yield body._replace(triangles=cube, position=box.center, rotation=box.rotation)

    def small(self) -> list[int]:
        """Return the rows of notes about overlaps of bodies that are too small to be seen."""
        limit = SMALL * diagonal_of(self.boxes)
        return [
            row
            for row, note in enumerate(self.notes)
            if note.depth < limit and not any(name.startswith(SOURCES) for name in note.names)
        ]

    def bodies(self) -> Iterator[Body]:
        """Yield the objects that are not zones, as boxes if their shapes are unknown."""
        for row, name in enumerate(self.names):
            if name in self.zones:
                continue
            box = self.boxes[row]
            center, rotation = box.center, box.rotation
            shape = self.shapes.get(name)
            if shape is None:
                shape = Box(np.maximum(2.0 * box.half_extents, 1e-9))
            else:  # from the frame of the box to that of the shape
                local_center, axes, _ = shape.local_box
                rotation = rotation @ axes.T
                center = center - rotation @ local_center
            yield Body(name, int(self.states[row]), triangles_of(shape), center, rotation)

    def legend(self) -> list[tuple[str, Color, str]]:
        """Return text, colour and form (of a mark, "box" or "zone") of everything drawn."""
        kinds = [s for n, s in zip(self.names, self.states, strict=True) if n not in self.zones]
        entries = [
            (f"{kinds.count(k)} {name}{f' {TOUCH_SIGN}' * (k == TOUCHING)}", STATE_COLORS[k], "box")
            for k, name in enumerate(STATE_NAMES)
            if k in kinds
        ]
        entries += [(name, color, "zone") for name, color in list(self.zones.items())[:6]]
        return entries + [mark[:3] for mark in self.marks() if len(mark.points)]

    def marks(self) -> list[Mark]:
        """Return the points and lines beside the objects."""
        return [
            Mark("other point", OUTSIDE_COLOR, "speck", self.cloud[~self.inside]),
            Mark("point in a zone", INSIDE_COLOR, "speck", self.cloud[self.inside]),
            Mark("point of a stranger", INSIDE_COLOR, "speck", self.strangers),
            Mark("closest points", NEAR_COLOR, "line", self.near),
            Mark("predicted contact", PREDICTED_COLOR, "dot", self.predicted),
            Mark("contact", CONTACT_COLOR, "dot", self.contacts),
        ]


def take_snapshot(
    cycle: Cycle, shapes: Mapping[str, Shape], zones: Mapping[str, Color]
) -> DrawnScene:
    """Return the drawing of a cycle; ValueError without boxes."""
    if not cycle.boxes.names:
        raise ValueError("no boxes received")
    boxes = cycle.boxes.without(SOURCES)  # boxes around the points of sensors
    names = boxes.names
    placed = Boxes.from_poses(boxes.poses, 0.5 * boxes.sizes)
    states = {name: ROBOT for name in names if name.partition("/")[0] in cycle.robots}
    states |= {names[row]: DOUBTFUL for row in np.flatnonzero(boxes.doubtful)}
    states |= {names[row]: OVERLAPPING for row in np.flatnonzero(boxes.colliding)}
    pairs = cycle.pairs.rows
    for pair in sorted(pairs, key=lambda pair: not is_touching(pair)):  # overlapping ones last
        states |= dict.fromkeys(pair[:2], TOUCHING if is_touching(pair) else OVERLAPPING)
    near = [(row.point_a, row.point_b) for row in _rows(cycle, "clearance")]
    predicted = [row.point for row in _rows(cycle, "sweep")]
    cloud = cycle.points
    inside = np.zeros(len(cloud), np.bool_)
    counted = zones.keys() | {row.name for row in _rows(cycle, "points")}
    for row in [row for row, name in enumerate(names) if name in counted]:
        local = (cloud - placed.centers[row]) @ placed.rotations[row]
        inside |= (np.abs(local) <= placed.half_extents[row]).all(axis=1)
    return DrawnScene(
        names=names,
        boxes=placed,
        states=np.array([states.get(name, FREE) for name in names]),
        shapes=shapes,
        zones=zones,
        contacts=_contacts(cycle, names, placed),
        predicted=np.array(predicted, np.float64).reshape(-1, 3),
        near=np.array(near, np.float64).reshape(-1, 2, 3),
        cloud=cloud,
        inside=inside,
        notes=_notes(cycle, names, placed, zones),
        boxed=cycle.pairs.by_box,
    )


def diagonal_of(boxes: Boxes) -> float:
    """Return the diagonal of all boxes, m."""
    bounds = boxes.aabb()
    return max(float(np.linalg.norm(bounds.maximum - bounds.minimum)), 1e-6)


def look_at(view: View | None, boxes: Boxes) -> tuple[Floats, Floats]:
    """Return viewpoint (3,) and target (3,): those of the view, or to see all boxes."""
    if view is not None:
        return np.array(view.eye), np.array(view.target)
    bounds = boxes.aabb()
    target = 0.5 * (bounds.minimum + bounds.maximum)
    reach = np.linalg.norm(bounds.maximum - bounds.minimum)
    return target + DISTANCE * reach * DIRECTION, target


def _notes(cycle: Cycle, names: list[str], boxes: Boxes, zones: Mapping[str, Color]) -> list[Label]:
    notes = []
    sizes = dict(zip(names, 2.0 * np.linalg.norm(boxes.half_extents, axis=1), strict=True))
    corners = boxes.centers + np.einsum("nij,nj->ni", boxes.rotations, boxes.half_extents)
    corner_of = dict(zip(names, corners, strict=True))

    def add(row: Any, place: Any, text: str, color: Color, depth: float = np.nan) -> None:
        extent = min((sizes[name] for name in row[:2] if name in sizes), default=0.0)
        text = f"{text} {pair_of(row)}"
        notes.append(Label(np.asarray(place), text, color, extent, depth, tuple(row[:2])))

    for row in _rows(cycle, "points"):
        if row.name in corner_of:
            color = zones.get(row.name, INSIDE_COLOR)
            text = f"{row.points} points in {row.name}"
            notes.append(Label(corner_of[row.name], text, color, sizes[row.name]))
    places = _places(cycle, names, boxes)
    for pair, place in sorted(
        places, key=lambda p: (is_touching(p[0]), -np.nan_to_num(p[0].depth))
    ):
        if is_touching(pair):
            add(pair, place, f"{TOUCH_SIGN} touching:", STATE_COLORS[TOUCHING])
        else:
            depth = "" if np.isnan(pair.depth) else f"{1e3 * pair.depth:.0f} mm deep:"
            add(pair, place, depth or "overlapping:", STATE_COLORS[OVERLAPPING], pair.depth)
    for row in sorted(_rows(cycle, "sweep"), key=lambda row: row.time):
        add(row, row.point, f"in {row.time:.1f} s:", PREDICTED_COLOR)
    for row in sorted(_rows(cycle, "clearance"), key=lambda row: row.distance):
        middle = 0.5 * (np.array(row.point_a) + np.array(row.point_b))
        add(row, middle, f"{1e3 * row.distance:.0f} mm apart:", NEAR_COLOR)
    return notes


def _contacts(cycle: Cycle, names: list[str], boxes: Boxes) -> Floats:
    """Return the contact points, and the place of each overlapping pair without one."""
    rows = _rows(cycle, "contacts")
    named = {(row.a, row.b) for row in rows}
    pairs = [(p, place) for p, place in _places(cycle, names, boxes) if not is_touching(p)]
    places = [place for pair, place in pairs if pair[:2] not in named]
    return np.array([*places, *(row.point for row in rows)], np.float64).reshape(-1, 3)


def _places(cycle: Cycle, names: list[str], boxes: Boxes) -> list[tuple[NamedPair, Floats]]:
    """Return the pairs with their places, or the middle of both centres for pairs without."""
    center_of, result = dict(zip(names, boxes.centers, strict=True)), []
    for pair, at in zip(cycle.pairs.rows, cycle.pairs.places, strict=True):
        if np.isfinite(at).all():
            result.append((pair, at))
        elif {pair.a, pair.b} <= center_of.keys():
            result.append((pair, 0.5 * (center_of[pair.a] + center_of[pair.b])))
    return result


def _rows(cycle: Cycle, effect: str) -> list[Any]:
    return cycle.effects.get(effect, [])
