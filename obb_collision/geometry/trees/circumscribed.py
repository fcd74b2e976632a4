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

"""Points whose hull contains a shape with curved faces: prisms, pyramids, geodesic spheres.

Made for the shape before scaling, which is linear and so preserves containment, and larger than
necessary by CIRCUMSCRIBED_SLACK: more than all rounding.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from obb_collision.geometry.fitting.convex_hull import convex_hull
from obb_collision.geometry.shapes.primitives import (
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    Shape,
    Sphere,
)
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.typing import Floats, Integers

#: Sides of the polygon about a circle; its corners are 1.9 % farther out.
SIDES = 16
#: Relative excess of all coordinates: far above rounding, far below anything visible.
CIRCUMSCRIBED_SLACK = 8192 * ROUNDOFF


def outer_points(shape: Shape) -> Floats:
    """Return points (n, 3) whose hull contains a sphere, ellipsoid, cylinder, capsule or cone.

    ValueError for other shapes.
    """
    if isinstance(shape, Sphere):
        points = shape.radius * _outer_sphere()
    elif isinstance(shape, Ellipsoid):
        points = np.array(shape.radii) * _outer_sphere()
    elif isinstance(shape, Capsule):
        ends = np.array([[0.0, 0.0, 0.5 * shape.length], [0.0, 0.0, -0.5 * shape.length]])
        points = (shape.radius * _outer_sphere() + ends[:, None]).reshape(-1, 3)
    elif isinstance(shape, (Cylinder, Cone)):
        base = _outer_ring(shape.radius, -0.5 * shape.length)
        top = _outer_ring(0.0 if isinstance(shape, Cone) else shape.radius, 0.5 * shape.length)
        points = np.concatenate([base, top])
    else:
        raise ValueError(f"there is no hull about a {type(shape).__name__}")
    return points * np.array(shape.scale) * (1.0 + CIRCUMSCRIBED_SLACK)


def excess(shape: object, corners: Floats) -> float:
    """Return how far the hull of corners (k, 3) reaches at most beyond a shape of ``outer_points``.

    0 for other shapes. Each corner is compared with some point of the shape.
    """
    if not isinstance(shape, (Sphere, Ellipsoid, Capsule, Cylinder, Cone)):
        return 0.0
    scale = np.array(shape.scale)
    points = corners / scale
    if isinstance(shape, (Sphere, Ellipsoid)):
        radii = np.array(shape.radii if isinstance(shape, Ellipsoid) else shape.radius)
        lengths = np.linalg.norm(points / radii, axis=1)
        inner = points / np.maximum(lengths, 1.0)[:, None]
    else:
        inner, half = np.zeros_like(points), 0.5 * shape.length
        inner[:, 2] = np.clip(points[:, 2], -half, half)
        across = points - inner
        radii = np.full(len(points), shape.radius)
        if not isinstance(shape, Capsule):
            across[:, 2] = 0.0
        if isinstance(shape, Cone):
            radii *= (half - inner[:, 2]) / shape.length
        lengths = np.maximum(np.linalg.norm(across, axis=1), np.finfo(float).tiny)
        inner += across * np.minimum(radii / lengths, 1.0)[:, None]
    return float(np.linalg.norm((points - inner) * scale, axis=1).max()) * (1.0 + 64 * ROUNDOFF)


def geodesic_sphere(rounds: int) -> Floats:
    """Return points (n, 3) on the unit sphere: an icosahedron, its edges halved in each round.

    After 0, 1, 2, ... rounds 12, 42, 162, ... points.
    """
    a, b = 1.0, 0.5 * (1.0 + math.sqrt(5.0))
    signs = [(p, q) for p in (-1.0, 1.0) for q in (-1.0, 1.0)]
    points = np.array([np.roll((0.0, p * a, q * b), k) for p, q in signs for k in range(3)])
    points /= np.linalg.norm(points, axis=1)[:, None]
    for _ in range(rounds):
        faces = _faces(points)
        edges = np.sort(np.concatenate([faces[:, :2], faces[:, 1:], faces[:, ::2]]), axis=1)
        middles = points[np.unique(edges, axis=0)].sum(axis=1)
        points = np.concatenate([points, middles / np.linalg.norm(middles, axis=1)[:, None]])
    return points


@cache
def _outer_sphere() -> Floats:
    """Return points whose hull contains the unit sphere; they are 3.6 % farther out."""
    points = geodesic_sphere(2)
    a, b, c = points[_faces(points)].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    depths = np.abs(np.einsum("ij,ij->i", normals, a)) / np.linalg.norm(normals, axis=1)
    return points / depths.min()


def _outer_ring(radius: float, height: float) -> Floats:
    angles = 2.0 * np.pi * np.arange(SIDES) / SIDES
    reach = radius / math.cos(math.pi / SIDES)
    heights = np.full(SIDES, height)
    return np.stack([reach * np.cos(angles), reach * np.sin(angles), heights], axis=1)


def _faces(points: Floats) -> Integers:
    hull = convex_hull(points)
    assert hull is not None
    return hull.simplices.astype(np.int64)
