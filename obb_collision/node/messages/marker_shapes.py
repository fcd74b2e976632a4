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

"""Markers -> shapes and back; what each type of marker means is in ``shape_plans``."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Point
from visualization_msgs.msg import Marker

from obb_collision import shapes
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.shape_plans import MarkerShape, plan_shape
from obb_collision.scene.building.errors import BuildError
from obb_collision.scene.building.jobs import perform
from obb_collision.typing import Floats


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
    """Shape of a marker in its own frame, its local box fitted; built here and now.

    Raises RefusedError with a reason where the shape can't be built.
    """
    plan = plan_shape(marker_shape_from_ros(marker))
    if plan.job is None:
        assert plan.shape is not None
        return plan.shape
    try:
        built = plan.job.finish(perform(plan.job.message() or {}))
    except BuildError as error:
        raise RefusedError(error.reason, error.detail) from error
    return built[0] if isinstance(built, tuple) else built


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


def _point(corner: Floats) -> Point:
    return Point(x=float(corner[0]), y=float(corner[1]), z=float(corner[2]))
