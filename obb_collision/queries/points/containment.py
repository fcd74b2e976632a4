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

"""Points inside one box, placed mesh or convex body, or within a margin of a mesh or convex body.

The surface counts as inside, and so does a point that doubles cannot tell from it. So no point of a
body is ever reported as outside. For a mesh these are points within 2^-41 of the reach of the mesh
and the offset from its origin. For a solid they are also points of which every ray passes too near
to an edge (``inside``), as happens beside slivers. For a convex body a core with a formula decides
by it, up to rounding. Radii, margins and hulls decide by the distance of the point, up to 1e-9 of
S, the offset of the point and the reach of the body.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from obb_collision._jit import njit
from obb_collision.geometry.trees.obb_tree import TreeArrays
from obb_collision.numerics.constants import CAREFUL_BOUND, MESH_UNDERFLOW, ROUNDOFF, UNDERFLOW
from obb_collision.numerics.exact import contains_exactly
from obb_collision.numerics.vec3 import (
    ZERO,
    absolute,
    careful_cross,
    components,
    dot,
    max_of,
    minus,
    norm,
    plus,
    scaled,
    sum_abs,
    vector_at,
)
from obb_collision.queries.convex.distance import rounding, search
from obb_collision.queries.convex.support import (
    BOX_CORE,
    CONE_CORE,
    CYLINDER_CORE,
    HULL_CORE,
    SEGMENT_CORE,
    Core,
    Cores,
    body_place,
    borrowed_core,
    support,
)
from obb_collision.queries.meshes.inside import OUTSIDE_MESH, point_side
from obb_collision.queries.meshes.placed import POINT_BOUND, Meshes, PairPose, body_at, node_at
from obb_collision.queries.meshes.trees import NodeStack, descend_nearest
from obb_collision.queries.meshes.triangle_distance import triangle_bounds
from obb_collision.queries.meshes.triangles import triangle_at
from obb_collision.queries.primitives.segments import unit_scale
from obb_collision.queries.verdict.sat import box_of
from obb_collision.typing import Axes, Floats, Vector

OUTSIDE = 0
DOUBTFUL = 1
INSIDE = 2

#: Bound of the fast stage, relative to abs(p - c) + sum h: rounding gives 6 units of 2^-53, and
#: taking a_i for the face normal, with axes orthonormal to 64 units, 2 x 96 more.
INSIDE_BOUND = 256 * ROUNDOFF


def contains(
    center: Floats, rotation: Floats, half_extents: Floats, points: Floats, exact: bool = False
) -> NDArray[np.bool_]:
    """Return (n,) whether each point (n, 3) lies in the closed box.

    Points that doubles can't distinguish from the surface count as inside (within 4e-15 of their
    distance from the centre and the half extent). ``exact=True`` decides them by integer
    arithmetic.
    """
    places = np.empty(len(points), np.int8)
    containment_kernel(center, rotation, half_extents, points, places)
    inside: NDArray[np.bool_] = places != OUTSIDE
    if exact:
        doubtful = np.flatnonzero(places == DOUBTFUL)
        inside[doubtful] = contains_exactly(center, rotation, half_extents, points[doubtful])
    return inside


@njit
def containment_kernel(
    center: Floats, axes: Floats, extents: Floats, points: Floats, out: np.ndarray
) -> None:
    """Write INSIDE, OUTSIDE or DOUBTFUL for each point."""
    box = box_of(center, axes, extents)
    for n in range(len(points)):
        out[n] = place_of(minus(vector_at(points, n), box.center), box.axes, box.half_extents)


@njit
def place_of(offset: Vector, axes: Axes, extents: Vector) -> int:
    """Return INSIDE, OUTSIDE or DOUBTFUL for an offset from the centre of a box."""
    excess = max_of(minus(absolute(components(axes, offset)), extents))
    size = extents[0] + extents[1] + extents[2]
    bound = INSIDE_BOUND * (sum_abs(offset) + size) + UNDERFLOW
    if excess > bound:
        return OUTSIDE
    if excess < -bound:
        return INSIDE
    return place_carefully(offset, axes, extents)


@njit
def place_carefully(offset: Vector, axes: Axes, extents: Vector) -> int:
    """Return the place of an offset from the centre, by face normals without rounding errors.

    Same bound as ``witness.careful_gap``: a point is a box. Uses tuples: slices of arrays slow
    loops down, even in a rarely taken branch.
    """
    place = INSIDE
    x, y, z = axes
    normals = (careful_cross(y, z), careful_cross(z, x), careful_cross(x, y))
    distance = norm(offset)
    for i in range(3):
        n = normals[i]
        along = abs(dot(n, offset))
        reach = abs(dot(n, axes[i])) * extents[i]
        bound = CAREFUL_BOUND * (distance + extents[i]) * norm(n) + UNDERFLOW
        if along - reach > bound:
            return OUTSIDE
        if along - reach >= -bound:
            place = DOUBTFUL
    return place


#: Relative slack of a margin: squares, sums and roots of distances are off by 8 roundoffs.
DISTANCE_ROUNDING = 2.0**-48


@njit(refcount=False)
def body_holds(bodies: Meshes, i: int, point: Vector, margin: float, waiting: NodeStack) -> bool:
    """Return whether a point is in body i, or not certainly farther from it than a margin."""
    trees, body = bodies.trees, body_at(bodies, i)
    d = minus(point, body.place.center)
    p = components(body.place.axes, d)
    error = POINT_BOUND * (sum_abs(d) + trees.radii[body.mesh]) + MESH_UNDERFLOW
    if trees.solid[body.mesh]:
        if point_side(trees, body.mesh, p, error, waiting) != OUTSIDE_MESH:
            return True
        if margin == 0.0:
            return False
    reach = margin * (1.0 + DISTANCE_ROUNDING) + 4.0 * error
    unit, _ = unit_scale(trees.radii[body.mesh] + reach)
    root, near = trees.roots[body.mesh], Nearby(unit * reach, False)
    at = PointAt(p, unit)
    return descend_nearest(trees, root, at, _box_apart, _with_near, near, waiting)[0].inside


class PointAt(NamedTuple):
    """A point in the frame of a mesh."""

    point: Vector
    unit: float  #: a power of two that scales the mesh to about 1


class Nearby(NamedTuple):
    """Whether a triangle is within the limit."""

    limit: float  #: scaled; -inf once a triangle is within it
    inside: bool


@njit(merge=True)
def _with_near(p: PointAt, trees: TreeArrays, n: int, _: float, near: Nearby) -> Nearby:
    if near.inside:
        return near
    a, b, c = triangle_at(trees.triangles, n)
    a, b, c = minus(a, p.point), minus(b, p.point), minus(c, p.point)
    a, b, c = scaled(a, p.unit), scaled(b, p.unit), scaled(c, p.unit)
    origin = ZERO, ZERO, ZERO
    lower = triangle_bounds((a, b, c), origin, a, 2.0 * near.limit)[0]
    return near if lower > near.limit else Nearby(-np.inf, True)


@njit(refcount=False)
def _box_apart(p: PointAt, nodes: Floats, n: int) -> float:
    """Return the distance of the box of a node from a point, scaled."""
    center, axes, half = node_at(nodes, n)
    d = components(axes, minus(p.point, center))
    square = 0.0
    for k in range(3):
        beyond = p.unit * (abs(d[k]) - half[k])
        square += beyond * beyond if beyond > 0.0 else 0.0
    return math.sqrt(square)


SAME_AXES: Axes = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
#: Relative slack of a formula: quotients, squares and their sum are off by 6 roundoffs.
FORMULA_ROUNDING = 16 * ROUNDOFF


@njit(refcount=False)
def convex_holds(bodies: Cores, i: int, point: Vector, margin: float) -> bool:
    """Return whether a point is in body i, or not certainly farther from it than a margin."""
    core, place = borrowed_core(bodies, i), body_place(bodies, i)
    d = minus(point, place.center)
    p = components(place.axes, d)
    pose = point_pose(p, sum_abs(d), core.reach + margin)
    if core.kind != HULL_CORE:
        if _by_formula(core, p, POINT_BOUND * pose.size + MESH_UNDERFLOW):
            return True
        if core.radius + margin == 0.0 and core.kind != SEGMENT_CORE:
            return False
    needed = core.radius + margin + rounding(pose)
    if core.radius + margin > 0.0 and SMALL < pose.size < LARGE:
        found = _approached(core, p, core.radius + margin, needed)
        if found >= 0:
            return found > 0
    return not search(core, point_core(core), pose, ZERO, needed).gap > needed


#: Steps towards a point, before a search that finds the distance itself.
APPROACHES = 4
#: Sizes (m) whose squares neither over- nor underflow.
SMALL, LARGE = 1e-100, 1e100


@njit(refcount=False)
def _approached(core: Core, p: Vector, reach: float, needed: float) -> int:
    """Return 1 if a point of the core is within reach of p, 0 if none is within needed, else -1.

    Steps of Frank and Wolfe (1956): x is in the core, and far the corner farthest towards p.
    """
    x = support(core, p)
    for _ in range(APPROACHES):
        v = minus(p, x)
        square = dot(v, v)
        if square <= reach * reach:
            return 1
        edge = minus(support(core, v), x)
        gap = square - dot(v, edge)
        if gap > 0.0 and gap * gap > (1.0 + FORMULA_ROUNDING) * needed * needed * square:
            return 0
        length = dot(edge, edge)
        if length == 0.0:
            return -1
        x = plus(x, scaled(edge, min(dot(v, edge) / length, 1.0)))
    return -1


@njit(inline=True, refcount=False)
def point_core(like: Core) -> Core:
    """Return a point as a core, of the same type in numba as that of a body."""
    return Core(SEGMENT_CORE, ZERO, 0.0, like.blocks, like.first, like.last, 0.0, 0.0)


@njit
def point_pose(p: Vector, offset: float, reach: float) -> PairPose:
    """Return the pose of a point in the frame of a body."""
    return PairPose(SAME_AXES, p, offset + reach, 0.0, 0.0)


@njit(refcount=False)
def _by_formula(core: Core, p: Vector, error: float) -> bool:
    """Return whether a point is in a core with a formula, or may be, within an error."""
    x, y = max(abs(p[0]) - error, 0.0), max(abs(p[1]) - error, 0.0)
    z = max(abs(p[2]) - core.half - error, 0.0)
    a, b, c = core.size
    if core.kind == BOX_CORE:
        return x <= a and y <= b and z <= c
    share = 1.0
    if core.kind == CONE_CORE:
        share = min((core.half - p[2] + error) / (2.0 * core.half), 1.0) if core.half > 0.0 else 1.0
    if core.kind == CONE_CORE or core.kind == CYLINDER_CORE or core.kind == SEGMENT_CORE:
        c = 0.0
    x, y, z = _of(x, a), _of(y, b), _of(z, c)
    return x * x + y * y + z * z <= share * share * (1.0 + FORMULA_ROUNDING) and share >= 0.0


@njit
def _of(x: float, half: float) -> float:
    """Return x / half, but infinity for x beyond a half axis of zero."""
    if half > 0.0:
        return x / half
    return 0.0 if x == 0.0 else 1e300
