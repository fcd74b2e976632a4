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

"""Shapes as triangles to draw."""

from __future__ import annotations

from functools import cache, lru_cache
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import QhullError
from trimesh import Trimesh, convex, creation

from obb_collision import shapes
from obb_collision.typing import Floats, Integers

#: Corners of a round body's polygon: round to the eye, few enough to draw hundreds.
SECTIONS = 24


class Triangles(NamedTuple):
    """Vertices (n, 3), faces (m, 3), and the scale (3,) that makes metres of the vertices.

    Equal shapes but for the scale share the same arrays. closed: whether the faces point outwards
    all around, so that those seen from behind are hidden.
    """

    vertices: Floats
    faces: Integers
    scale: Floats
    closed: bool = True


@lru_cache(maxsize=10_000)
def triangles_of(shape: shapes.Shape) -> Triangles:
    """Return a shape as triangles in its own frame."""
    scale = np.array(shape.scale, np.float64)
    if isinstance(shape, shapes.Box):
        return Triangles(*_unit_body("box"), scale * shape.size)
    if isinstance(shape, (shapes.Sphere, shapes.Ellipsoid)):
        radii = shape.radius if isinstance(shape, shapes.Sphere) else np.array(shape.radii)
        return Triangles(*_unit_body("sphere"), scale * radii)
    if isinstance(shape, (shapes.Cylinder, shapes.Cone)):
        size = np.array((shape.radius, shape.radius, shape.length))
        kind = "cylinder" if isinstance(shape, shapes.Cylinder) else "cone"
        return Triangles(*_unit_body(kind), scale * size)
    if isinstance(shape, shapes.Capsule):
        return Triangles(*_capsule(shape.radius, shape.length), scale)
    if isinstance(shape, shapes.Hull):
        return _hull_triangles(shape, scale)
    if isinstance(shape, shapes.Mesh):
        return Triangles(shape.vertices, shape.faces, scale, closed=False)
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


def _hull_triangles(shape: shapes.Hull, scale: Floats) -> Triangles:
    try:
        body: Any = convex.convex_hull(shape.points)
    except QhullError:  # a point, a line, a triangle
        rows = np.arange(len(shape.points))
        faces = np.stack([rows, np.roll(rows, -1), np.roll(rows, -2)], axis=1)
        body = Trimesh(shape.points, faces, process=False)
    return Triangles(np.array(body.vertices), np.array(body.faces), scale, closed=False)
