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

"""Rays against boxes, down a binary tree over axis-aligned bounds: halves along the longest axis.

Bounds are only merged, never rounded. A node is a run of the order of boxes; a leaf has no child.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.constants import PARALLEL, ROUNDOFF, UNDERFLOW
from obb_collision.numerics.vec3 import ZERO, components, dot, minus, plus, scaled, sum_abs
from obb_collision.queries.verdict.sat import BoxAt
from obb_collision.typing import Floats, Vector

#: Boxes in a leaf.
LEAF_BOXES = 2
#: Rows of the stack: halving leaves a node on each level, so this is enough for 2^62 leaves.
RAY_STACK = 64
#: Limits (k, 6), numbers (k, 3) and order (n,) of a tree.
TreeNodes = tuple[Floats, np.ndarray, np.ndarray]
#: Columns of a node: first box in the order, number of boxes, first of its two children or -1.
NODE_START, NODE_COUNT, NODE_CHILD = 0, 1, 2


@njit
def build_ray_tree(bounds: Floats) -> TreeNodes:
    """Return bounds (k, 6) and numbers (k, 3) of nodes, the root first, and the order (n,).

    bounds (n, 6): least and largest corner of each box.
    """
    n = len(bounds)
    order = np.arange(n)
    limits = np.empty((max(2 * n, 1), 6))
    nodes = np.empty((max(2 * n, 1), 3), np.int64)
    _fill(nodes, 0, 0, n)
    used = 1
    node = 0
    while node < used:  # children come after their parents: the array is the queue
        start, count = nodes[node, NODE_START], nodes[node, NODE_COUNT]
        rows = order[start : start + count]
        longest = _merge(bounds, rows, limits[node])
        if count > LEAF_BOXES:
            middles = np.empty(count)
            for m in range(count):
                row = rows[m]
                middles[m] = 0.5 * bounds[row, longest] + 0.5 * bounds[row, 3 + longest]
            half = count // 2
            _halve(rows, middles, half)
            nodes[node, NODE_CHILD] = used
            _fill(nodes, used, start, half)
            _fill(nodes, used + 1, start + half, count - half)
            used += 2
        node += 1
    return limits[:used], nodes[:used], order


@njit
def _halve(rows: np.ndarray, values: Floats, half: int) -> None:
    """Move the rows of the least ``half`` values to the front, and the values (Hoare 1961)."""
    low, high = 0, len(rows) - 1
    while low < high:
        pivot, i, j = values[(low + high) // 2], low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                rows[i], rows[j] = rows[j], rows[i]
                values[i], values[j] = values[j], values[i]
                i, j = i + 1, j - 1
        if j < half < i:
            return
        low, high = (low, j) if half <= j else (i, high)


@njit
def _fill(nodes: np.ndarray, node: int, start: int, count: int) -> None:
    """Write a leaf; an assignment of rows takes two seconds to compile."""
    nodes[node, NODE_START], nodes[node, NODE_COUNT], nodes[node, NODE_CHILD] = start, count, -1


@njit
def _merge(bounds: Floats, rows: np.ndarray, out: Floats) -> int:
    """Write the bounds of all rows, and return the axis along which the middles spread most."""
    out[:3], out[3:] = np.inf, -np.inf
    best, widest = 0, -1.0
    for k in range(3):
        least, most = np.inf, -np.inf
        for row in rows:
            out[k] = min(out[k], bounds[row, k])
            out[3 + k] = max(out[3 + k], bounds[row, 3 + k])
            middle = 0.5 * bounds[row, k] + 0.5 * bounds[row, 3 + k]
            least, most = min(least, middle), max(most, middle)
        if most - least > widest:
            best, widest = k, most - least
    return best


#: By how much a box is enlarged for the decision, relative to its distance and half extents:
#: four times the bound of ``containment``, for origin and direction, with room for the slabs.
HIT_BOUND = 1024 * ROUNDOFF
#: Where the entries of the box and of the enlarged one differ by less than so many bounds, the ray
#: comes steeply enough for the first; else, as along a face, rounding may say where it enters.
STEEP_ENTRY = 8.0
#: Relative slack of distances along a ray: 32 unit roundoffs, and they are off by some 6.
DISTANCE_SLACK = 32 * ROUNDOFF


@njit
def slabs(o: Vector, v: Vector, h: Vector) -> tuple[float, float, int]:
    """Return where the line o + t v enters and leaves the box -h .. h, and by which axis.

    The entry lies after the exit if the line misses the box; then the axis may be -1.
    """
    enter, leave, axis = -np.inf, np.inf, -1
    for i in range(3):
        if abs(v[i]) < PARALLEL:
            if abs(o[i]) > h[i]:
                return np.inf, -np.inf, -1
            continue
        near, far = (-h[i] - o[i]) / v[i], (h[i] - o[i]) / v[i]
        if near > far:
            near, far = far, near
        if near > enter:
            enter, axis = near, i
        leave = min(leave, far)
    return enter, leave, axis


class Ray(NamedTuple):
    """A single ray or segment."""

    origin: Vector
    unit: Vector
    reach: float  #: how far it goes


class Rays(NamedTuple):
    """Rays: origins (m, 3), unit directions (m, 3), and how far they go (m,)."""

    origins: Floats
    units: Floats
    reaches: Floats


class HitArrays(NamedTuple):
    """Hits of rays: bodies (m,), distances (m,), points and normals (3, m), and faces (m,)."""

    bodies: np.ndarray
    distances: Floats
    points: Floats
    normals: Floats
    faces: np.ndarray


class RayTree(NamedTuple):
    """A tree of ``build_ray_tree``, and work space for its descent."""

    limits: Floats
    nodes: np.ndarray
    order: np.ndarray
    stack: np.ndarray  #: (RAY_STACK,) nodes
    entries: Floats  #: (RAY_STACK,) where the ray enters them


#: The distance; the axis of the face of a box, or the triangle, or a constant below; the normal.
Hit = tuple[float, int, Vector]
NO_FACE, ORIGIN_INSIDE = -1, -2
MISSED: Hit = (np.inf, NO_FACE, ZERO)


@njit(refcount=False)
def hit_box(ray: Ray, box: BoxAt) -> Hit:
    """Return when a ray hits a box; NO_FACE for an origin in it, and no normal yet."""
    d, h = minus(ray.origin, box.center), box.half_extents
    o, v = components(box.axes, d), components(box.axes, ray.unit)
    bound = HIT_BOUND * (sum_abs(d) + sum_abs(h)) + UNDERFLOW
    grown = (h[0] + bound, h[1] + bound, h[2] + bound)
    enter, leave, axis = slabs(o, v, grown)
    if enter > leave or leave < 0.0 or enter > ray.reach:
        return MISSED
    true_enter, true_leave, true_axis = slabs(o, v, h)
    if true_enter <= true_leave and true_enter - enter <= STEEP_ENTRY * bound:
        enter, axis = true_enter, true_axis
    if enter <= 0.0:
        return 0.0, NO_FACE, ZERO
    return min(enter, ray.reach), axis, ZERO


@njit(refcount=False)
def enters_bounds(limits: Floats, node: int, ray: Ray, reach: float) -> float:
    """Return a distance before a ray can enter the bounds of a node, infinity if it can't."""
    enter, leave = 0.0, reach
    for i in range(3):
        origin, unit = ray.origin[i], ray.unit[i]
        if abs(unit) < PARALLEL:
            continue
        near = (limits[node, i] - origin) / unit
        far = (limits[node, 3 + i] - origin) / unit
        if near > far:
            near, far = far, near
        enter = max(enter, near - DISTANCE_SLACK * abs(near))
        leave = min(leave, far + DISTANCE_SLACK * abs(far))
    return enter if enter <= leave else np.inf


#: By how much a ray may be off once it is moved ahead, relative to the origin's offset from the
#: centre (derivation in ``bodies``).
AHEAD_BOUND = 16 * ROUNDOFF


@njit(refcount=False)
def moved_ahead(ray: Ray, center: Vector, reach: float) -> tuple[Vector, float, float]:
    """Return a point of a ray seen from a centre, how far ahead it is, and its error.

    No point before it is within reach of the centre; -1 ahead if no point of the ray is.
    """
    d = minus(ray.origin, center)
    middle = -dot(d, ray.unit)
    if middle < -reach:
        return d, -1.0, 0.0
    ahead = max(middle - reach, 0.0)
    return plus(d, scaled(ray.unit, ahead)), ahead, AHEAD_BOUND * sum_abs(d)
