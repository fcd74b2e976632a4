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

"""Convex bodies as kernels see them: a core, known by its farthest points, and a radius about it.

A body is everything within ``radius`` of its core; the core is the hull of corners, a box, a
cylinder, a cone, or the sum of an ellipsoid and a segment along z, in a frame of its own. Spheres
and capsules are cores without volume. Padding is part of the radius and therefore exact.

Shapes with a formula are cores exactly (``core_of``), the others by their hulls.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.fitting.enclosing import round_up
from obb_collision.geometry.shapes.primitives import (
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    Shape,
    Sphere,
)
from obb_collision.geometry.trees.obb_tree import no_trees
from obb_collision.geometry.trees.pool import Hulls
from obb_collision.numerics.intrinsics import farthest
from obb_collision.numerics.vec3 import fast_norm, sum_abs, vector_at
from obb_collision.queries.meshes.placed import Meshes, Place, PlacedMeshes, place_at
from obb_collision.typing import Floats, Mask, Rows, Vector

#: Kinds of cores; sizes are (x, y, z, half).
HULL_CORE = 0  #: corners of a hull; no sizes
BOX_CORE = 1  #: half extents x, y, z
SEGMENT_CORE = 2  #: from -half to half along z; a point, if half is zero
ROUND_CORE = 3  #: an ellipsoid with half axes x, y, z, swept along that segment
CYLINDER_CORE = 4  #: half axes x, y of its ends, at -half and half
CONE_CORE = 5  #: the same of its base, at -half; its apex is at half


class Cores(NamedTuple):
    """The arrays of n bodies for kernels; body i is at centers[i], turned by rotations[i]."""

    kinds: np.ndarray  #: (n,) int8
    sizes: Floats  #: (n, 4)
    radii: Floats  #: (n,) about the core
    hulls: Hulls
    rows: np.ndarray  #: (n,) of the hull of those with corners
    centers: Floats
    rotations: Floats


class Core(NamedTuple):
    """The core of one body, in its own frame."""

    kind: int
    size: Vector
    half: float
    blocks: Floats  #: of all hulls; its own are first to last - 1
    first: int
    last: int
    reach: float  #: no point of the body has a larger sum of magnitudes of its coordinates
    radius: float


#: Kinds of cores that are neither polytopes nor segments.
CURVED_CORES = (ROUND_CORE, CYLINDER_CORE, CONE_CORE)
#: Placeholder for the hulls of bodies without corners.
NO_HULLS = Hulls.of(np.zeros((1, 3)))


@dataclass(frozen=True, eq=False)
class ConvexBodies:
    """n convex bodies at centers (n, 3), with rotations (n, 3, 3); not checked.

    kinds (n,) int8, sizes (n, 4), radii (n,): as in ``Cores``; rows (n,): of the hulls.
    """

    kinds: np.ndarray
    sizes: Floats
    radii: Floats
    hulls: Hulls
    rows: Rows
    centers: Floats
    rotations: Floats

    def __len__(self) -> int:
        return len(self.kinds)

    @property
    def arrays(self) -> Cores:
        """The fields, for kernels."""
        return Cores(*vars(self).values())

    def take(self, rows: Rows | Mask, margin: float | Floats = 0.0) -> ConvexBodies:
        """Return the bodies of some rows, grown by a margin (m)."""
        fields = {name: value[rows] for name, value in vars(self).items() if name != "hulls"}
        return replace(self, **{**fields, "radii": fields["radii"] + margin})


class Solids(NamedTuple):
    """Either placed meshes, grown by radii (n,), or convex bodies; the other set is empty.

    One kernel takes both: a kernel for each kind takes twice as long to compile.
    """

    meshes: Meshes
    radii: Floats
    cores: Cores


def solids_of(bodies: PlacedMeshes | ConvexBodies, radii: Floats) -> Solids:
    """Return bodies for kernels that take either kind."""
    rows, places = np.empty(0, np.int64), (np.empty((0, 3)), np.empty((0, 3, 3)))
    if isinstance(bodies, ConvexBodies):
        return Solids(Meshes(no_trees(), rows, *places), radii, bodies.arrays)
    empty = Cores(np.empty(0, np.int8), np.empty((0, 4)), np.empty(0), NO_HULLS, rows, *places)
    return Solids(bodies.arrays, radii, empty)


@njit
def core_at(bodies: Cores, i: int) -> Core:
    """Return the core of body i."""
    kind, size, half, first, last, reach, radius = _numbers_at(bodies, i)
    return Core(kind, size, half, bodies.hulls.blocks, first, last, reach, radius)


@njit(inline=True, refcount=False)
def borrowed_core(bodies: Cores, i: int) -> Core:
    """Return the core of body i, for kernels that count no references."""
    kind, size, half, first, last, reach, radius = _numbers_at(bodies, i)
    return Core(kind, size, half, bodies.hulls.blocks, first, last, reach, radius)


@njit(inline=True, refcount=False)
def _numbers_at(bodies: Cores, i: int) -> tuple[int, Vector, float, int, int, float, float]:
    """Return the fields of a core without the corners of all hulls."""
    kind = bodies.kinds[i] + 0  # int64 like the constants: int8 would compile all twice
    size, half = vector_at(bodies.sizes, i), bodies.sizes[i, 3]
    first = last = 0
    radius = bodies.radii[i]
    reach = sum_abs(size) + half + 2.0 * radius
    if kind == HULL_CORE:
        row = bodies.rows[i]
        first, last = bodies.hulls.starts[row], bodies.hulls.starts[row + 1]
        reach = bodies.hulls.radii[row] + 2.0 * radius
    return kind, size, half, first, last, reach, radius


@njit(inline=True, refcount=False)
def body_place(bodies: Cores, i: int) -> Place:
    """Return the pose of body i."""
    return place_at(bodies.centers, bodies.rotations, i)


@njit(refcount=False)
def support(core: Core, n: Vector) -> Vector:
    """Return a point of the core that reaches farthest along n, of whatever length."""
    if core.kind == HULL_CORE:
        return farthest(core.blocks, core.first, core.last, n)
    (x, y, z), half = core.size, math.copysign(core.half, n[2])
    if core.kind == BOX_CORE:
        return math.copysign(x, n[0]), math.copysign(y, n[1]), math.copysign(z, n[2])
    if core.kind == SEGMENT_CORE:
        return 0.0, 0.0, half
    if core.kind == ROUND_CORE:
        u = x * n[0], y * n[1], z * n[2]
        length = fast_norm(u)
        if length > 0.0:
            return x * (u[0] / length), y * (u[1] / length), z * (u[2] / length) + half
        return 0.0, 0.0, half
    u = x * n[0], y * n[1], 0.0
    length = fast_norm(u)
    rim = (0.0, 0.0, half)
    if length > 0.0:
        rim = x * (u[0] / length), y * (u[1] / length), half
    if core.kind == CYLINDER_CORE:
        return rim
    if length - core.half * n[2] < core.half * n[2]:
        return 0.0, 0.0, core.half
    return rim[0], rim[1], -core.half


#: Kind, sizes (4) and radius, as in ``Cores``.
CoreSizes = tuple[int, float, float, float, float, float]


def core_of(shape: Shape) -> CoreSizes:
    """Return the core of a shape, sizes rounded up; of a hull or mesh only the kind."""
    if not isinstance(shape, (Sphere, Ellipsoid, Capsule, Cylinder, Cone)):
        return HULL_CORE, 0.0, 0.0, 0.0, 0.0, 0.0
    x, y, z = shape.local_box[2].tolist()
    if isinstance(shape, (Cylinder, Cone)):
        kind = CONE_CORE if isinstance(shape, Cone) else CYLINDER_CORE
        return kind, x, y, 0.0, z, 0.0
    half = 0.0
    if isinstance(shape, Capsule):
        scale = Fraction(shape.scale[2])
        lengths = Fraction(shape.radius) * scale, Fraction(shape.length) / 2 * scale
        z, half = (round_up(length.numerator, length.denominator) for length in lengths)
    if len(set(shape.scale)) == 1 and not isinstance(shape, Ellipsoid):
        return SEGMENT_CORE, 0.0, 0.0, 0.0, half, z
    return ROUND_CORE, x, y, z, half, 0.0
