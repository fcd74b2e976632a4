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

"""Contacts of many pairs of convex bodies: normal, depth, and a few points of the patch."""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.numerics.vec3 import dot, plus, scaled, vector_at
from obb_collision.queries.contacts.contacts import Contacts
from obb_collision.queries.convex.distances import ConvexDistances, in_world, turned_back
from obb_collision.queries.convex.patch import Flat, flat_room, frame_of, overlay, spread
from obb_collision.queries.convex.support import Bodies, ConvexBodies, body_place, core_at, support
from obb_collision.queries.meshes.tree_boxes import relative_pose
from obb_collision.typing import Floats, Integers, Vector

#: Pairs below which a second thread does not pay: 0.1 ms.
FEWEST_PAIRS = 32
#: What ``Contacts.axes`` has for pairs that are no boxes.
NO_AXIS = -1


def convex_contacts(
    a: ConvexBodies, b: ConvexBodies, pairs: Integers, i: Integers, j: Integers, max_points: int,
    distances: ConvexDistances,
) -> Contacts:  # fmt: skip
    """Return the contacts of bodies ``i[n]`` of a and ``j[n]`` of b; pairs (m, 2): their names.

    distances: of these pairs, without a limit.
    """
    found = Contacts.blank(pairs, max_points)
    found.axes[:] = NO_AXIS
    found.normals[:] = distances.normals
    run(
        *(_contact_kernel, len(i), FEWEST_PAIRS, a.arrays, i, b.arrays, j),
        *(distances.lower, distances.positions_a, distances.positions_b, found.normals),
        *(found.depths, found.counts, found.positions, found.position_depths),
    )
    return found


@njit
def _contact_kernel(
    a: Bodies, rows_a: np.ndarray, b: Bodies, rows_b: np.ndarray, lower: Floats, nearest_a: Floats,
    nearest_b: Floats, normals: Floats, depths: Floats, counts: np.ndarray, positions: Floats,
    position_depths: Floats, start: int, stop: int,
) -> None:  # fmt: skip
    flat = flat_room()
    for row in range(start, stop):
        positions[row], position_depths[row] = np.nan, np.nan
        counts[row] = 0
        depths[row] = max(-lower[row], 0.0)
        if lower[row] > 0.0:
            continue
        middle = scaled(plus(vector_at(nearest_a, row), vector_at(nearest_b, row)), 0.5)
        counts[row] = _write_patch(
            *(a, rows_a[row], b, rows_b[row], vector_at(normals, row), depths[row], middle, flat),
            *(positions[row], position_depths[row]),
        )


@njit
def _write_patch(
    a: Bodies, i: int, b: Bodies, j: int, normal: Vector, depth: float, middle: Vector, flat: Flat,
    positions: Floats, position_depths: Floats,
) -> int:  # fmt: skip
    """Write the points of one pair; middle: between those found deepest. Return their number."""
    core_a, core_b = core_at(a, i), core_at(b, j)
    place = body_place(a, i)
    pose = relative_pose(place, body_place(b, j), core_a.reach + core_b.reach)
    frame = frame_of(turned_back(place, normal))
    inner = depth - core_a.radius - core_b.radius
    count = overlay(core_a, core_b, pose, frame, inner, flat)
    count = spread(flat.a, count, len(positions))
    if count == 0:
        for k in range(3):
            positions[0, k] = middle[k]
        position_depths[0] = depth
        return 1
    # halfway between both foremost planes; points of flat bodies may be deepest and not foremost
    height = dot(frame.n, support(core_a, frame.n)) + core_a.radius - 0.5 * depth
    for n in range(count):
        x, y, low = vector_at(flat.a, n)
        p = plus(plus(scaled(frame.x, x), scaled(frame.y, y)), scaled(frame.n, height))
        point = in_world(place, p)
        for k in range(3):
            positions[n, k] = point[k]
        position_depths[n] = min(max(depth - low, 0.0), depth)
    return count
