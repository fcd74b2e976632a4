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

"""Shapes as convex bodies for kernels: those with a formula exactly, the others by their hulls."""

from __future__ import annotations

import math

from obb_collision.geometry.shapes.primitives import (
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    Shape,
    Sphere,
)
from obb_collision.queries.convex.support import CONE, CORNERS, CYLINDER, ROUND, SEGMENT

#: Kind, sizes (4) and radius, as in ``Bodies``.
CoreSizes = tuple[int, float, float, float, float, float]


def core_of(shape: Shape) -> CoreSizes:
    """Return the core of a shape, none of its sizes too small; of a hull or mesh only the kind."""
    if not isinstance(shape, (Sphere, Ellipsoid, Capsule, Cylinder, Cone)):
        return CORNERS, 0.0, 0.0, 0.0, 0.0, 0.0
    x, y, z = shape.scale
    uniform = x == y == z
    half = 0.0 if isinstance(shape, (Sphere, Ellipsoid)) else _up(0.5 * shape.length, z)
    if isinstance(shape, (Sphere, Capsule)) and uniform:
        return SEGMENT, 0.0, 0.0, 0.0, half, _up(shape.radius, x)
    if isinstance(shape, Ellipsoid):
        a, b, c = shape.radii
    else:
        a = b = c = shape.radius
    if isinstance(shape, (Cylinder, Cone)):
        kind = CONE if isinstance(shape, Cone) else CYLINDER
        return kind, _up(a, x), _up(b, y), 0.0, half, 0.0
    return ROUND, _up(a, x), _up(b, y), _up(c, z), half, 0.0


def _up(size: float, scale: float) -> float:
    """Return a product, not too small."""
    return size if scale == 1.0 else math.nextafter(size * scale, math.inf)
