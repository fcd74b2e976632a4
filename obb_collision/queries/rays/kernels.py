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

"""Kernels of ``rays``: one ray against one box, and down the tree of bounds."""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.constants import PARALLEL, ROUNDOFF, UNDERFLOW
from obb_collision.queries.primitives.capsule_kernels import to_local, total
from obb_collision.queries.primitives.segments import Vector
from obb_collision.queries.rays.bounds_tree import CHILD, COUNT, STACK, START
from obb_collision.typing import Floats

#: By how much a box is enlarged for the decision, relative to its distance and half extents:
#: four times the bound of ``containment``, for origin and direction, with room for the slabs.
HIT_BOUND = 1024 * ROUNDOFF
#: Where the entries of the box and of the enlarged one differ by less than so many bounds, the ray
#: comes steeply enough for the first; else, as along a face, rounding may say where it enters.
STEEP = 8.0
#: Relative slack of distances along a ray: 32 unit roundoffs, and they are off by some 6.
DISTANCE_SLACK = 32 * ROUNDOFF


@njit
def slabs(o: Vector, v: Vector, h: Vector) -> tuple[float, float, int]:
    """Return where the line o + t v enters and leaves the box -h .. h, and by which axis.

    The entry lies after the exit where the line misses the box. The axis is -1 for a line that
    is parallel to none and enters nowhere.
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


@njit
def hit_box(
    origin: Vector, unit: Vector, centers: Floats, axes: Floats, half: Floats, b: int, reach: float
) -> tuple[float, int]:
    """Return the distance at which a ray hits box b, infinity if not within reach, and the axis.

    The axis of the face entered is -1 where the origin is in the box.
    """
    d = (origin[0] - centers[b, 0], origin[1] - centers[b, 1], origin[2] - centers[b, 2])
    h = (half[b, 0], half[b, 1], half[b, 2])
    o, v = to_local(axes, b, d), to_local(axes, b, unit)
    bound = HIT_BOUND * (total(d) + total(h)) + UNDERFLOW
    grown = (h[0] + bound, h[1] + bound, h[2] + bound)
    enter, leave, axis = slabs(o, v, grown)
    if enter > leave or leave < 0.0 or enter > reach:
        return np.inf, -1
    true_enter, true_leave, true_axis = slabs(o, v, h)
    if true_enter <= true_leave and true_enter - enter <= STEEP * bound:
        enter, axis = true_enter, true_axis
    if enter <= 0.0:
        return 0.0, -1
    return min(enter, reach), axis


@njit
def enters_bounds(limits: Floats, node: int, origin: Vector, unit: Vector, reach: float) -> float:
    """Return a distance before a ray can enter the bounds of a node, infinity if it can't."""
    enter, leave = 0.0, reach
    for i in range(3):
        if abs(unit[i]) < PARALLEL:
            continue
        near = (limits[node, i] - origin[i]) / unit[i]
        far = (limits[node, 3 + i] - origin[i]) / unit[i]
        if near > far:
            near, far = far, near
        enter = max(enter, near - DISTANCE_SLACK * abs(near))
        leave = min(leave, far + DISTANCE_SLACK * abs(far))
    return enter if enter <= leave else np.inf


@njit
def rays_kernel(
    origins: Floats, units: Floats, reaches: Floats,
    centers: Floats, axes: Floats, half: Floats,
    limits: Floats, nodes: np.ndarray, order: np.ndarray,
    hits: np.ndarray, distances: Floats, points: Floats, normals: Floats,
) -> None:  # fmt: skip
    """Write the nearest box (m,), distance (m,), point (m, 3) and normal (m, 3) of each ray."""
    stack, entries = np.empty(STACK, np.int64), np.empty(STACK)
    for n in range(len(origins)):
        origin = (origins[n, 0], origins[n, 1], origins[n, 2])
        unit = (units[n, 0], units[n, 1], units[n, 2])
        box, distance, axis = _nearest(
            origin, unit, reaches[n], centers, axes, half, limits, nodes, order, stack, entries
        )
        hits[n], distances[n] = box, distance
        side = 0.0
        if axis >= 0:
            way = unit[0] * axes[box, 0, axis] + unit[1] * axes[box, 1, axis]
            side = -1.0 if way + unit[2] * axes[box, 2, axis] > 0.0 else 1.0
        for k in range(3):
            points[n, k] = origin[k] + distance * unit[k] if box >= 0 else np.nan
            normals[n, k] = side * axes[box, k, max(axis, 0)] + 0.0 if box >= 0 else np.nan


@njit
def _nearest(
    origin: Vector, unit: Vector, reach: float, centers: Floats, axes: Floats, half: Floats,
    limits: Floats, nodes: np.ndarray, order: np.ndarray, stack: np.ndarray, entries: Floats,
) -> tuple[int, float, int]:  # fmt: skip
    """Return the nearest box, its distance and the axis of its face; -1, infinity, -1 for none."""
    box, best, axis = -1, np.inf, -1
    depth = 0
    enter = enters_bounds(limits, 0, origin, unit, reach)
    if enter < np.inf:
        stack[0], entries[0], depth = 0, enter, 1
    while depth > 0:
        depth -= 1
        node = stack[depth]
        if entries[depth] > best:
            continue
        child = nodes[node, CHILD]
        if child < 0:
            for m in range(nodes[node, START], nodes[node, START] + nodes[node, COUNT]):
                b = order[m]
                distance, face = hit_box(origin, unit, centers, axes, half, b, reach)
                if distance < best or (distance == best and b < box):
                    box, best, axis = b, distance, face
            continue
        first = enters_bounds(limits, child, origin, unit, min(reach, best))
        second = enters_bounds(limits, child + 1, origin, unit, min(reach, best))
        if first < second:  # the nearer one is on top
            first, second = second, first
            child, other = child + 1, child
        else:
            other = child + 1
        if first < np.inf:
            stack[depth], entries[depth] = child, first
            depth += 1
        if second < np.inf:
            stack[depth], entries[depth] = other, second
            depth += 1
    return box, best, axis
