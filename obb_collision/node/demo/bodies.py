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

"""Shapes as triangles to draw, and the bodies of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import QhullError
from trimesh import Trimesh, convex, creation

from obb_collision.geometry.poses import as_poses
from obb_collision.geometry.shapes import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    Hull,
    Mesh,
    Shape,
    Sphere,
)
from obb_collision.node.demo.scene import DemoScene
from obb_collision.node.demo.shapes import SECTIONS

if TYPE_CHECKING:
    from obb_collision.node.demo.file_scene import FileScene

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Body:
    """What an object looks like: vertices (n, 3) in the world, metres; faces (m, 3); rgb 0..1.

    opacity: below 1 it is only its box, in its colour.
    """

    vertices: FloatArray
    faces: IntArray
    color: tuple[float, float, float]
    opacity: float = 1.0


def triangles_of(shape: Shape) -> tuple[FloatArray, IntArray]:
    """Return vertices (n, 3), metres, and faces (m, 3) of a shape, for drawing it."""
    if isinstance(shape, Mesh):
        return shape.vertices * np.array(shape.scale), shape.faces
    body = _unscaled(shape)
    return np.array(body.vertices) * np.array(shape.scale), np.array(body.faces)


def _unscaled(shape: Shape) -> Any:
    if isinstance(shape, Box):
        return creation.box(extents=shape.size)
    if isinstance(shape, Cylinder):
        return creation.cylinder(shape.radius, shape.length, sections=2 * SECTIONS)
    if isinstance(shape, Cone):
        body = creation.cone(shape.radius, shape.length, sections=2 * SECTIONS)
        return body.apply_translation((0.0, 0.0, -0.5 * shape.length))
    if isinstance(shape, Capsule):
        body = creation.capsule(shape.length, shape.radius, count=(SECTIONS, SECTIONS))
        return body.apply_translation(-body.bounds.mean(axis=0))
    if isinstance(shape, Sphere):
        return creation.icosphere(subdivisions=3, radius=shape.radius)
    if isinstance(shape, Ellipsoid):
        return creation.icosphere(subdivisions=3).apply_scale(shape.radii)
    if isinstance(shape, Hull):
        try:
            return convex.convex_hull(shape.points)
        except QhullError:  # a point, a line, a triangle
            rows = np.arange(len(shape.points))
            faces = np.stack([rows, np.roll(rows, -1), np.roll(rows, -2)], axis=1)
            return Trimesh(shape.points, faces, process=False)
    raise TypeError(f"the demo has no {type(shape).__name__}")


def corner_normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return unit normals (m, 3, 3) at the corners of faces: round where faces meet flatly.

    A corner's normal is the mean over the faces around its vertex within 40 degrees.
    """
    corners = vertices[faces]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    unit = flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-30)
    _, same = np.unique(np.round(vertices, 6), axis=0, return_inverse=True)
    owner = same.reshape(-1)[faces].reshape(-1)  # of each corner: which place it is at
    order = np.argsort(owner, kind="stable")
    starts = np.flatnonzero(np.diff(owner[order], prepend=-1))
    result = np.empty((len(owner), 3))
    for group in np.split(order, starts[1:]):
        around = unit[group // 3]
        near = around @ around.T > np.cos(np.radians(40.0))
        result[group] = near @ flat[group // 3]
    lengths = np.linalg.norm(result, axis=1, keepdims=True)
    return (result / np.maximum(lengths, 1e-30)).reshape(-1, 3, 3)


def bodies_of(scene: DemoScene | FileScene, time: float) -> list[Body]:
    """Return the bodies of a scene at a time."""
    centers, rotations = as_poses(scene.poses(time))
    bodies = []
    for row, (item, shape) in enumerate(zip(scene.items, scene.shapes(time), strict=True)):
        vertices, faces = triangles_of(shape)
        placed = vertices @ rotations[row].T + centers[row]
        bodies.append(Body(placed, faces, item.color, item.opacity))
    return bodies
