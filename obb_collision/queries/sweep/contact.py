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

from obb_collision._jit import njit
from obb_collision.numerics.vec3 import (
    clamp,
    clamped,
    components,
    dot,
    max_abs,
    minus,
    pick,
    pick_axis,
    plus,
    scaled,
)
from obb_collision.queries.verdict.pair_frame import Box
from obb_collision.typing import Vector

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
def contact_point(a: Box, b: Box, normal: Vector, axis: int) -> Vector:
    """Return the point where two boxes touch in a plane of the normal, from a to b.

    axis: the number of the normal's among the 15 (``sat``), which
    tells where to look first. The corner of either box if that is what touches, the
    crossing of two edges, else some point common to the flat features that meet.
    """
    size = 0.0
    for k in range(3):
        size += a.half_extents[k] + b.half_extents[k]
    flat = TOUCH_FLAT * size
    back = scaled(normal, -1.0)
    if axis < 3:  # a face of a: it is the other that may touch with a corner
        q, free_b, edge_b = _support(b, back, flat)
        if free_b == 0:
            return q
        p, free_a, edge_a = _support(a, normal, flat)
        if free_a == 0:
            return p
    else:
        p, free_a, edge_a = _support(a, normal, flat)
        if free_a == 0:
            return p
        q, free_b, edge_b = _support(b, back, flat)
        if free_b == 0:
            return q
    if free_a == 1 and free_b == 1:
        u, v = pick_axis(a.axes, edge_a), pick_axis(b.axes, edge_b)
        cosine = dot(u, v)
        square = 1.0 - cosine * cosine
        if square > PARALLEL_SQUARED:
            along = dot(minus(q, p), minus(u, scaled(v, cosine))) / square
            return plus(p, scaled(u, clamp(along, pick(a.half_extents, edge_a))))
    return _common(p if free_a < free_b else q, a, b, TOUCH_SETTLED * size)


@njit
def _common(point: Vector, a: Box, b: Box, settled: float) -> Vector:
    """Return a point of both boxes near another, by projections onto one, then the other."""
    for _ in range(TOUCH_ROUNDS):
        point, first = _clamp_to_box(point, a)
        point, second = _clamp_to_box(point, b)
        if max(first, second) <= settled:
            break
    return point


@njit
def _clamp_to_box(point: Vector, box: Box) -> tuple[Vector, float]:
    """Return the nearest point of the box, and the largest step there along an axis."""
    along = components(box.axes, minus(point, box.center))
    excess = minus(along, clamped(along, box.half_extents))
    for k in range(3):
        if excess[k] != 0.0:
            point = minus(point, scaled(box.axes[k], excess[k]))
    return point, max_abs(excess)


@njit
def _support(box: Box, normal: Vector, flat: float) -> Feature:
    """Return the middle of what is farthest along the normal (see ``Feature``)."""
    point, free, edge = box.center, 0, 0
    for k in range(3):
        side, extent = box.axes[k], box.half_extents[k]
        rise = extent * dot(normal, side)
        if abs(rise) <= flat:
            free += 1
            edge = k
        else:
            point = plus(point, scaled(side, math.copysign(extent, rise)))
    return point, free, edge
