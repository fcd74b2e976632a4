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

"""Shapes of markers as RViz draws them: what ``scale`` means for each type; and markers of shapes.

| type | the box is around |
|---|---|
| CUBE, SPHERE, CYLINDER | the unit body times ``scale`` (edge lengths, diameters, height along z) |
| TRIANGLE_LIST, MESH_RESOURCE | the vertices times ``scale`` |
| CUBE_LIST, SPHERE_LIST | each point alone: a body of edge lengths (diameters) ``scale`` |
| POINTS | each point alone: a sphere as wide as the larger of ``scale.x``, ``scale.y`` |
| LINE_LIST, LINE_STRIP | all points, each as wide as ``scale.x`` |
| ARROW | the drawn arrow, head included (RViz draws the head twice as wide as scale.y, scale.z) |
| TEXT_VIEW_FACING, ARROW_STRIP | refused: annotations, not bodies |

Shapes of a formula are made at once. What takes long, or reads a file, becomes a job for another
process: see ``scene.building``.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import PurePath
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import Point
from visualization_msgs.msg import Marker

from obb_collision import shapes
from obb_collision.geometry.fitting.candidates import complete_frame
from obb_collision.geometry.fitting.enclosing import enclose_points
from obb_collision.geometry.formats.parts import shortened
from obb_collision.node.messages.conversions import LARGEST_COORDINATE, SMALLEST_MEANT
from obb_collision.node.messages.errors import RefusedError
from obb_collision.scene.building.jobs import (
    CUBE_CORNERS,
    UNREADABLE,
    Bodies,
    BuildError,
    Job,
    MeshFile,
    Triangles,
    body_corners,
    perform,
)
from obb_collision.typing import Floats
from obb_collision.words import MAX_PATH

Signature = tuple[Any, ...]
"""Identifies a shape without fitting it: equal signatures, equal shapes."""

ARROW_HEAD = np.array((1.0, 2.0, 2.0))
"""Size of a drawn arrow in units of its scale: the head is twice as wide as the shaft."""

SCALE_AXES = {
    Marker.POINTS: 2,
    Marker.LINE_LIST: 1,
    Marker.LINE_STRIP: 1,
}
"""Number of components of ``scale`` that are used; all three where not named."""

LISTS = {
    Marker.CUBE_LIST: Marker.CUBE,
    Marker.SPHERE_LIST: Marker.SPHERE,
    Marker.POINTS: Marker.SPHERE,
}
"""Types of lists whose elements are objects of their own, and the types of these."""

NO_BODY = "no body"
"""Reason: a marker is an annotation, which can't collide."""
NO_POINTS = RefusedError("no points", "this marker type needs points")
ANNOTATIONS = (Marker.TEXT_VIEW_FACING, Marker.ARROW_STRIP)

IMMEDIATE = (Marker.CUBE, Marker.SPHERE, Marker.CYLINDER, Marker.ARROW)
"""Types whose shape is created immediately."""


@dataclass(frozen=True, eq=False)
class MarkerShape:
    """The shape of a marker: decoded, but not yet validated.

    kind: ``Marker.type``; scale (3,); points (n, 3), which may be a view on the message's bytes;
    resource, filename, data: the mesh resource, and the embedded mesh file (bytes of any kind).
    """

    kind: int
    scale: Floats
    points: Floats = field(default_factory=lambda: np.empty((0, 3)))
    resource: str = ""
    filename: str = ""
    data: Any = b""


@dataclass(frozen=True, eq=False)
class ShapePlan:
    """How to get a shape: the shape itself, or a job that builds it; the other is None."""

    signature: Signature
    shape: shapes.Shape | None = None
    job: Job | None = None


class Elements(NamedTuple):
    """The bodies of a list: their type, scale (3,), and places (n, 3) in the marker's frame."""

    kind: int
    scale: Floats
    points: Floats


def elements_of(marker: MarkerShape, most: int) -> Elements:
    """Return the bodies of a list of at most ``most``; RefusedError where it is not valid."""
    scale, points = _checked_scale(marker), marker.points
    if marker.kind == Marker.POINTS:
        scale = np.full(3, scale[:2].max())
    if len(points) == 0:
        raise NO_POINTS
    if len(points) > most:
        raise RefusedError("too many objects", f"a list of {len(points)}: {most} is the limit")
    _check_points(points)
    return Elements(LISTS[marker.kind], scale, points)


def plan_shape(marker: MarkerShape) -> ShapePlan:
    """Return how to get a marker's shape. RefusedError with the reason where it is no body.

    What takes time in proportion to the points or the file is left to the job, but for one look
    at their bytes, which identify those received before.
    """
    planner = PLANNERS.get(marker.kind)
    if planner is None:
        reason = NO_BODY if marker.kind in ANNOTATIONS else "unknown marker type"
        raise RefusedError(reason, f"type {marker.kind}")
    try:
        return planner(marker, _checked_scale(marker))
    except RefusedError:
        raise
    except ValueError as error:
        raise RefusedError("bad shape", str(error)) from error


def _checked_scale(marker: MarkerShape) -> Floats:
    """Return the scale (3,). RefusedError unless finite, and positive where it counts."""
    scale = marker.scale
    used = scale[: SCALE_AXES.get(marker.kind, 3)]
    if marker.kind == Marker.ARROW and len(marker.points):
        used = scale[:2]  # head length 0 is RViz's "choose one"
    meant = (used >= SMALLEST_MEANT) & (used <= LARGEST_COORDINATE)
    if not (np.isfinite(scale).all() and meant.all()):
        raise RefusedError("bad scale", f"{scale.tolist()} must be finite and positive")
    return scale


def _simple(marker: MarkerShape, scale: Floats, shape: shapes.Shape) -> ShapePlan:
    _ = shape.local_box  # fitted here, where a failure can still be refused
    return ShapePlan((marker.kind, *scale.tolist()), shape)


def _arrow(marker: MarkerShape, scale: Floats) -> ShapePlan:
    """Along x from the origin, or between two points with scale.x, scale.y as diameters."""
    if len(marker.points) == 1:
        raise RefusedError("array lengths differ", "an arrow has no points or two")
    if len(marker.points) == 0:
        from_tail = CUBE_CORNERS + np.array((0.5, 0.0, 0.0))
        body = shapes.Hull(from_tail * scale * ARROW_HEAD, fit="aabb")  # its best fit, bit for bit
        return _simple(marker, scale, body)
    ends = np.array(marker.points[:2], dtype=np.float64)  # RViz looks at no more
    _check_points(ends)
    shape = _between(ends, float(scale[:2].max()))
    return ShapePlan((marker.kind, *scale.tolist(), ends.tobytes()), shape)


def _between(ends: Floats, width: float) -> shapes.Shape:
    """Return the hull of a square bar between two points (2, 3), as wide as ``width``."""
    along = ends[1] - ends[0]
    if not along.any():
        return shapes.Hull(body_corners(ends[:1], np.full(3, width)), fit="aabb")
    rotation = complete_frame(along, np.zeros(3))
    sides = np.array([(0.0, i, k) for i in (-0.5, 0.5) for k in (-0.5, 0.5)]) * width
    corners = (ends[:, None] + sides @ rotation.T).reshape(-1, 3)
    _check_points(corners)
    center, half_extents = enclose_points(corners, rotation)
    if half_extents.max() > LARGEST_COORDINATE:
        return shapes.Hull(corners, fit="aabb")
    return shapes.Hull.fitted(corners, (center, rotation, half_extents))


def _check_points(points: Floats) -> None:
    if not (np.abs(points) <= LARGEST_COORDINATE).all():
        raise RefusedError("bad points", "points must be finite")


def _triangles(marker: MarkerShape, scale: Floats) -> ShapePlan:
    if len(marker.points) % 3:
        raise RefusedError(
            "array lengths differ", f"{len(marker.points)} points do not form triangles"
        )
    points, signature = _known_points(marker, scale)
    return ShapePlan(signature, job=Triangles(points, scale))


def _elements(marker: MarkerShape, scale: Floats) -> ShapePlan:
    found = elements_of(marker, len(marker.points))
    raise RefusedError("several bodies", f"the {len(found.points)} of a list have no one shape")


def _dots(marker: MarkerShape, scale: Floats) -> ShapePlan:
    points, signature = _known_points(marker, scale)
    widths = np.full(3, scale[: SCALE_AXES[marker.kind]].max())
    return ShapePlan(signature, job=Bodies(points, widths))


def _known_points(marker: MarkerShape, scale: Floats) -> tuple[Floats, Signature]:
    points = marker.points
    if len(points) == 0:
        raise NO_POINTS
    digest = _digest(np.ascontiguousarray(points).reshape(-1).view(np.uint8))
    return _kept(points), (marker.kind, *scale.tolist(), len(points), digest)


def _kept(points: Floats) -> Floats:
    """Return points that hold nothing else in memory: a message may be much larger."""
    holder: Any = points
    while isinstance(holder, np.ndarray) and holder.base is not None:
        holder = holder.base
    held = memoryview(holder).nbytes
    return points if held <= 2 * points.nbytes else points.copy()


def _digest(data: Any) -> bytes:
    return hashlib.blake2b(data, digest_size=16).digest()


def _mesh(marker: MarkerShape, scale: Floats) -> ShapePlan:
    uri = marker.resource
    if len(marker.data):
        data = bytes(marker.data)
        name = "mesh" + PurePath(marker.filename or uri).suffix
        signature = (marker.kind, *scale.tolist(), name, _digest(data))
        return ShapePlan(signature, job=MeshFile(name, scale, data))
    if "://" not in uri:  # RViz takes URIs only; a bare path depends on where the node was started
        raise RefusedError(UNREADABLE, f"{shortened(uri)!r} is not a file:// or package:// URI")
    if len(uri) > MAX_PATH:
        raise RefusedError(UNREADABLE, f"{shortened(uri)!r} has more than {MAX_PATH} characters")
    return ShapePlan((marker.kind, *scale.tolist(), uri), job=MeshFile(uri, scale))


PLANNERS: dict[int, Callable[[MarkerShape, Floats], ShapePlan]] = {
    Marker.CUBE: lambda given, scale: _simple(given, scale, shapes.Box(scale)),
    Marker.SPHERE: lambda given, scale: _simple(given, scale, shapes.Ellipsoid(0.5 * scale)),
    Marker.CYLINDER: lambda given, scale: _simple(
        given, scale, shapes.Cylinder(0.5, 1.0, scale=scale)
    ),
    Marker.ARROW: _arrow,
    Marker.TRIANGLE_LIST: _triangles,
    Marker.MESH_RESOURCE: _mesh,
    **dict.fromkeys(LISTS, _elements),
    Marker.LINE_LIST: _dots,
    Marker.LINE_STRIP: _dots,
}


def marker_shape_from_ros(marker: Marker) -> MarkerShape:
    """Return the shape in a marker."""
    return MarkerShape(
        int(marker.type),
        np.array((marker.scale.x, marker.scale.y, marker.scale.z), dtype=np.float64),
        np.array([(p.x, p.y, p.z) for p in marker.points], dtype=np.float64).reshape(-1, 3),
        marker.mesh_resource,
        marker.mesh_file.filename,
        marker.mesh_file.data,
    )


def shape_from_ros(marker: Marker) -> shapes.Shape:
    """Return the shape of a marker in its own frame, its local box fitted; built here and now.

    Raises RefusedError with a reason where the shape can't be built.
    """
    plan = plan_shape(marker_shape_from_ros(marker))
    if plan.job is None:
        assert plan.shape is not None
        return plan.shape
    try:
        built = plan.job.finish(perform(plan.job.task()))
    except BuildError as error:
        raise RefusedError(error.reason, error.detail) from error
    return built[0] if isinstance(built, tuple) else built


def shape_to_ros(shape: shapes.Shape) -> Marker:
    """Return the ADD marker of a Box, Sphere, Cylinder, Ellipsoid or Mesh; TypeError for others.

    Frame, namespace, id, pose and colour are the caller's.
    """
    scale = np.asarray(shape.scale, dtype=np.float64)
    marker = Marker(action=Marker.ADD)
    if isinstance(shape, shapes.Mesh):
        marker.type, size = Marker.TRIANGLE_LIST, scale
        corners = np.asarray(shape.vertices)[np.asarray(shape.faces).reshape(-1)]
        marker.points = [_point(corner) for corner in corners]
    elif isinstance(shape, shapes.Box):
        marker.type, size = Marker.CUBE, np.asarray(shape.size) * scale
    elif isinstance(shape, shapes.Sphere):
        marker.type, size = Marker.SPHERE, 2.0 * shape.radius * scale
    elif isinstance(shape, shapes.Ellipsoid):
        marker.type, size = Marker.SPHERE, 2.0 * np.asarray(shape.radii) * scale
    elif isinstance(shape, shapes.Cylinder):
        diameter = 2.0 * shape.radius
        marker.type, size = Marker.CYLINDER, np.array((diameter, diameter, shape.length)) * scale
    else:
        raise TypeError(f"no marker type draws a {type(shape).__name__}")
    marker.scale.x, marker.scale.y, marker.scale.z = (float(value) for value in size)
    return marker


def _point(corner: Floats) -> Point:
    return Point(x=float(corner[0]), y=float(corner[1]), z=float(corner[2]))
