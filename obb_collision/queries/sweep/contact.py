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

"""Where do two boxes touch at the time of impact? One point of the contact, by features."""

from __future__ import annotations

import math

import numpy as np

from obb_collision._jit import njit
from obb_collision.queries.verdict.penetration import clamp_to_box
from obb_collision.queries.verdict.sat import (
    Vector,
    clamp,
    column,
    dot,
    minus,
    plus,
    scaled,
    vector,
)
from obb_collision.typing import Floats

#: A side that rises less than this over its length, relative to the sum of all half extents,
#: lies in the plane of contact.
TOUCH_FLAT = 1e-10
#: Edges whose directions have a sine squared below this have no one crossing.
PARALLEL_SQUARED = 1e-12
#: Projections onto one box, then the other: two flat features that meet settle in a few.
TOUCH_ROUNDS = 16
#: They end when the point moves less than this, relative to the sum of all half extents.
TOUCH_SETTLED = 1e-12


#: The middle of a vertex, edge or face, how many sides of the box it spans, and the last of them.
Feature = tuple[Vector, int, int]


@njit
def contact_point(
    ca: Vector,
    cb: Vector,
    rotations: Floats,
    half_extents: Floats,
    i: int,
    j: int,
    normal: Vector,
    axis: int,
) -> Vector:
    """Return the point where boxes i and j touch in a plane of the normal, from i to j.

    ca, cb: their centres; axis: the number of the normal's among the 15 (``separation``), which
    tells where to look first. The corner of either box if that is what touches, the
    crossing of two edges, else some point common to the flat features that meet.
    """
    size = 0.0
    for k in range(3):
        size += half_extents[i, k] + half_extents[j, k]
    flat = TOUCH_FLAT * size
    back = scaled(normal, -1.0)
    if axis < 3:  # a face of i: it is the other that may touch with a corner
        b, free_b, n = _support(cb, rotations, half_extents, j, back, flat)
        if free_b == 0:
            return b
        a, free_a, m = _support(ca, rotations, half_extents, i, normal, flat)
        if free_a == 0:
            return a
    else:
        a, free_a, m = _support(ca, rotations, half_extents, i, normal, flat)
        if free_a == 0:
            return a
        b, free_b, n = _support(cb, rotations, half_extents, j, back, flat)
        if free_b == 0:
            return b
    if free_a == 1 and free_b == 1:
        u, v = column(rotations, i, m), column(rotations, j, n)
        cosine = dot(u, v)
        square = 1.0 - cosine * cosine
        if square > PARALLEL_SQUARED:
            along = dot(minus(b, a), minus(u, scaled(v, cosine))) / square
            return plus(a, scaled(u, clamp(along, half_extents[i, m])))
    corner = a if free_a < free_b else b
    return _common(corner, ca, cb, rotations, half_extents, i, j, TOUCH_SETTLED * size)


@njit
def _common(
    point: Vector, ca: Vector, cb: Vector,
    rotations: Floats, half_extents: Floats, i: int, j: int, settled: float,
) -> Vector:  # fmt: skip
    """Return a point of both boxes near another, by projections onto one, then the other."""
    work = np.empty((3, 3))
    for k in range(3):
        work[0, k], work[1, k], work[2, k] = point[k], ca[k], cb[k]
    for _ in range(TOUCH_ROUNDS):
        moved = clamp_to_box(work[0], work[1], rotations[i], half_extents[i])
        if max(moved, clamp_to_box(work[0], work[2], rotations[j], half_extents[j])) <= settled:
            break
    return vector(work, 0)


@njit
def _support(
    center: Vector, rotations: Floats, half_extents: Floats, i: int, normal: Vector, flat: float
) -> Feature:
    """Return the middle of what is farthest along the normal (see ``Feature``)."""
    point, free, edge = center, 0, 0
    for k in range(3):
        side = column(rotations, i, k)
        rise = half_extents[i, k] * dot(normal, side)
        if abs(rise) <= flat:
            free += 1
            edge = k
        else:
            point = plus(point, scaled(side, math.copysign(half_extents[i, k], rise)))
    return point, free, edge
