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

"""Markers -> shapes, as RViz draws them, each type with what its ``scale`` means there.

| type | the box is around |
|---|---|
| CUBE, SPHERE, CYLINDER | the unit body times ``scale`` (edge lengths, diameters, height along z) |
| TRIANGLE_LIST, MESH_RESOURCE | the vertices times ``scale`` |
| CUBE_LIST, SPHERE_LIST | all points, each a body of edge lengths (diameters) ``scale`` |
| POINTS | all points, each as wide as the larger of ``scale.x``, ``scale.y`` |
| LINE_LIST, LINE_STRIP | all points, each as wide as ``scale.x`` |
| ARROW | the drawn arrow, head included (RViz draws the head twice as wide as scale.y, scale.z) |
| TEXT_VIEW_FACING, ARROW_STRIP | refused: annotations, not bodies |
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import Point
from visualization_msgs.msg import Marker

from obb_collision.geometry import shapes
from obb_collision.node.conversions import LARGEST_COORDINATE, SMALLEST_MEANT, FloatArray
from obb_collision.node.errors import RefusedError

Signature = tuple[Any, ...]
"""What tells one shape from another without fitting it: equal signatures, equal shapes."""

NO_BODY = "no body"
"""Reason: a marker is an annotation, which can't collide."""
ANNOTATIONS = (Marker.TEXT_VIEW_FACING, Marker.ARROW_STRIP)

CUBE_CORNERS = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
"""Corners of the unit cube, (8, 3)."""

ARROW_HEAD = np.array((1.0, 2.0, 2.0))
"""Size of a drawn arrow in units of its scale: the head is twice as wide as the shaft."""

SCALE_AXES = {
    Marker.POINTS: 2,
    Marker.LINE_LIST: 1,
    Marker.LINE_STRIP: 1,
}
"""How many components of ``scale`` mean something; all three where not named."""

POINT_TYPES = (
    Marker.TRIANGLE_LIST,
    Marker.CUBE_LIST,
    Marker.SPHERE_LIST,
    Marker.POINTS,
    Marker.LINE_LIST,
    Marker.LINE_STRIP,
    Marker.ARROW,
)


def scale_from_ros(marker: Marker) -> FloatArray:
    """(3,) scale. Raises RefusedError ("bad scale") unless finite and positive where it counts."""
    scale = np.array((marker.scale.x, marker.scale.y, marker.scale.z))
    used = scale[: SCALE_AXES.get(marker.type, 3)]
    if marker.type == Marker.ARROW and marker.points:
        used = scale[:2]  # head length 0 is RViz's "choose one"
    meant = (used >= SMALLEST_MEANT) & (used <= LARGEST_COORDINATE)
    if not (np.isfinite(scale).all() and meant.all()):
        raise RefusedError("bad scale", f"{scale.tolist()} must be finite and positive")
    return scale


def points_from_ros(marker: Marker) -> FloatArray:
    """(n, 3) points. Raises RefusedError ("bad points") unless finite, "no points" without any."""
    points = np.array([(p.x, p.y, p.z) for p in marker.points], dtype=np.float64).reshape(-1, 3)
    if len(points) == 0:
        raise RefusedError("no points", "this marker type needs points")
    if not (np.abs(points) <= LARGEST_COORDINATE).all():
        raise RefusedError("bad points", "points must be finite")
    return points


def signature_from_ros(marker: Marker) -> Signature:
    """Signature of the marker's shape; equal to the last one means: only the pose is new.

    A mesh file counts as changed when its size or time of modification changes.
    Raises RefusedError where the marker can't be a body.
    """
    scale = scale_from_ros(marker) if marker.type in BUILDERS else None
    signature: Signature = (marker.type, *(() if scale is None else scale.tolist()))
    if scale is None:
        reason = NO_BODY if marker.type in ANNOTATIONS else "unknown marker type"
        raise RefusedError(reason, f"type {marker.type}")
    if marker.type == Marker.MESH_RESOURCE:
        return signature + _mesh_signature(marker)
    if marker.type in POINT_TYPES and marker.points:
        digest = hashlib.blake2b(points_from_ros(marker).tobytes(), digest_size=16)
        return (*signature, len(marker.points), digest.digest())
    return signature


def shape_from_ros(marker: Marker) -> shapes.Shape:
    """Shape of a marker in its own frame, its local box fitted.

    Raises RefusedError with a reason where the shape can't be built.
    """
    builder = BUILDERS.get(marker.type)
    if builder is None:
        raise RefusedError("unknown marker type", f"type {marker.type} is not a body")
    scale = scale_from_ros(marker)
    try:
        shape = builder(marker, scale)
        _ = shape.local_box  # fitted here, where a failure can still be refused
    except RefusedError:
        raise
    except ValueError as error:
        raise RefusedError("bad shape", str(error)) from error
    return shape


def shape_to_ros(shape: shapes.Shape) -> Marker:
    """ADD marker of a Box, Sphere, Cylinder, Ellipsoid or Mesh; TypeError for the others.

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


def _point(corner: FloatArray) -> Point:
    return Point(x=float(corner[0]), y=float(corner[1]), z=float(corner[2]))


def _cube(marker: Marker, scale: FloatArray) -> shapes.Shape:
    return shapes.Box(scale)


def _sphere(marker: Marker, scale: FloatArray) -> shapes.Shape:
    return shapes.Ellipsoid(0.5 * scale)


def _cylinder(marker: Marker, scale: FloatArray) -> shapes.Shape:
    return shapes.Cylinder(0.5, 1.0, scale=scale)


def _triangles(marker: Marker, scale: FloatArray) -> shapes.Shape:
    points = points_from_ros(marker)
    if len(points) % 3:
        raise RefusedError("array lengths differ", f"{len(points)} points are no triangles")
    return shapes.Mesh(points, np.arange(len(points)).reshape(-1, 3), scale=scale)


def _bodies(marker: Marker, scale: FloatArray) -> shapes.Shape:
    """Hull of cubes of edge lengths ``scale`` around all points."""
    points = points_from_ros(marker)
    return shapes.Hull((points[:, None] + CUBE_CORNERS * scale).reshape(-1, 3))


def _dots(marker: Marker, scale: FloatArray) -> shapes.Shape:
    return _bodies(marker, np.full(3, scale[: SCALE_AXES[marker.type]].max()))


def _arrow(marker: Marker, scale: FloatArray) -> shapes.Shape:
    """Along x from the origin, or between two points with scale.x, scale.y as diameters."""
    if not marker.points:
        from_tail = CUBE_CORNERS + np.array((0.5, 0.0, 0.0))
        return shapes.Hull(from_tail * scale * ARROW_HEAD)
    if len(marker.points) < 2:
        raise RefusedError("array lengths differ", "an arrow has no points or two")
    return _bodies(marker, np.full(3, scale[:2].max()))


def _mesh(marker: Marker, scale: FloatArray) -> shapes.Shape:
    uri = marker.mesh_resource
    try:
        if marker.mesh_file.data:
            suffix = Path(marker.mesh_file.filename or uri).suffix
            with tempfile.NamedTemporaryFile(suffix=suffix) as file:
                file.write(bytes(marker.mesh_file.data))
                file.flush()
                return shapes.Mesh.from_file(file.name, scale=scale)
        return shapes.Mesh.from_file(str(mesh_path(uri)), scale=scale)
    except ValueError as error:
        if isinstance(error, RefusedError):
            raise
        raise RefusedError("unreadable mesh", f"{uri}: {error}") from error


def _mesh_signature(marker: Marker) -> Signature:
    if marker.mesh_file.data:
        digest = hashlib.blake2b(bytes(marker.mesh_file.data), digest_size=16).digest()
        return (marker.mesh_resource, digest)
    try:
        status = mesh_path(marker.mesh_resource).stat()
    except OSError as error:
        raise RefusedError("unreadable mesh", f"{marker.mesh_resource}: {error}") from error
    return (marker.mesh_resource, status.st_mtime_ns, status.st_size)


def mesh_path(uri: str) -> Path:
    """File behind ``file://`` and ``package://`` URIs, or RefusedError ("unreadable mesh")."""
    if "://" not in uri:  # RViz takes URIs only; a bare path depends on where the node was started
        raise RefusedError("unreadable mesh", f"{uri!r} is no file:// or package:// URI")
    try:
        return shapes.resolve_path(uri)
    except ValueError as error:
        raise RefusedError("unreadable mesh", str(error)) from error


BUILDERS: dict[int, Callable[[Marker, FloatArray], shapes.Shape]] = {
    Marker.CUBE: _cube,
    Marker.SPHERE: _sphere,
    Marker.CYLINDER: _cylinder,
    Marker.TRIANGLE_LIST: _triangles,
    Marker.MESH_RESOURCE: _mesh,
    Marker.CUBE_LIST: _bodies,
    Marker.SPHERE_LIST: _bodies,
    Marker.POINTS: _dots,
    Marker.LINE_LIST: _dots,
    Marker.LINE_STRIP: _dots,
    Marker.ARROW: _arrow,
}
