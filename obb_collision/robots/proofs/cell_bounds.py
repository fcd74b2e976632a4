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

"""How far two bodies are apart in the middle of a cell, and how far their points move within it.

Joints are counted from the frame in which a direction n is fixed. The motion along n of a point p
by joints with axes w_i through o_i, whose values are off by at most d_i, is at most

    sum_i d_i |n.(w_i x (p - o_i))| + 1/2 sum_j r_j d_j (d_j + 2 sum_(i<j) d_i):

the second derivative by joints i <= j is w_i x (w_j x (p - o_j)), which is no longer than the
distance r_j of p from the axis of joint j. For a joint that slides, r_j is 1, and what belongs to
two that slide is left out. It is at most sum_i min(d_i, 2) r_i as well. r_j holds in the whole
cell: it is that in the middle, and what the joints behind j move.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.vec3 import (
    axes_of,
    combined,
    components,
    cross,
    dot,
    minus,
    negated,
    norm,
    plus,
    scaled,
    vector_at,
)
from obb_collision.queries.convex.distance import Search, search
from obb_collision.queries.convex.support import CORNERS, Core
from obb_collision.queries.meshes.tree_boxes import Place, moved, relative_pose
from obb_collision.robots.proofs.chains import Chain
from obb_collision.typing import Axes, Floats, Vector


class Moving(NamedTuple):
    """A convex body and what moves it."""

    chain: Chain
    blocks: Floats  #: (m, 3, LANES) corners in the frame of the link
    center: Vector  #: of a sphere around it
    sphere: float
    round: float  #: radius around each point of the hull of the corners
    reach: float  #: largest sum of magnitudes of coordinates of a point


class Work(NamedTuple):
    """What kernels write to: of each joint, for both bodies."""

    origins: Floats  #: (2, k, 3) in the frame between the links
    axes: Floats  #: (2, k, 3)
    far: Floats  #: (2, k) greatest distance of a point from the axis; 1 of those that slide
    widths: Floats  #: (2, k) half the width of the cell in its value


@njit
def work_for(a: Moving, b: Moving) -> Work:
    """Return room for one pair of bodies."""
    k = max(len(a.chain.axes), len(b.chain.axes))
    return Work(np.empty((2, k, 3)), np.empty((2, k, 3)), np.empty((2, k)), np.empty((2, k)))


@njit
def place_body(body: Moving, state: Floats, side: int, work: Work) -> Place:
    """Return where a body is, and write the axes of its joints."""
    chain = body.chain
    center, axes = vector_at(chain.places, 0), axes_of(chain.turns, 0)
    for i in range(len(chain.axes)):
        own = vector_at(chain.axes, i)
        axis = combined(axes, own)
        for k in range(3):
            work.origins[side, i, k], work.axes[side, i, k] = center[k], axis[k]
        value = chain.factors[i] * state[chain.columns[i]] + chain.offsets[i]
        if chain.slides[i]:
            center = plus(center, scaled(axis, value))
        else:
            axes = _product(axes, _turn(own, value))
        center = plus(center, combined(axes, vector_at(chain.places, i + 1)))
        axes = _product(axes, axes_of(chain.turns, i + 1))
    return Place(center, axes)


@njit
def _product(a: Axes, b: Axes) -> Axes:
    """Return the product of matrices, given and returned by columns."""
    return combined(a, b[0]), combined(a, b[1]), combined(a, b[2])


@njit
def _turn(axis: Vector, angle: float) -> Axes:
    """Return the columns of the rotation about a unit vector."""
    x, y, z = axis
    s, c = math.sin(angle), math.cos(angle)
    d = 2.0 * math.sin(0.5 * angle) ** 2
    return (
        (c + d * x * x, d * x * y + s * z, d * x * z - s * y),
        (d * x * y - s * z, c + d * y * y, d * y * z + s * x),
        (d * x * z + s * y, d * y * z - s * x, c + d * z * z),
    )


@njit
def core_of(body: Moving) -> Core:
    """Return the hull of the corners of a body, in the frame of its link."""
    zero = 0.0, 0.0, 0.0
    return Core(CORNERS, zero, 0.0, body.blocks, 0, len(body.blocks), body.reach, 0.0)


@njit
def distance_of(a: Moving, place_a: Place, b: Moving, place_b: Place) -> Search:
    """Return the distance of the hulls of corners; in the frame of a."""
    pose = relative_pose(place_a, place_b, a.reach + b.reach)
    start = plus(moved(pose, b.center), negated(a.center))
    return search(core_of(a), core_of(b), pose, start, np.inf)


@njit
def measure(
    body: Moving, place: Place, lower: Floats, upper: Floats, side: int, work: Work
) -> float:
    """Return how far points of a body move at most within a cell; write ``far`` and ``widths``."""
    chain = body.chain
    center = plus(place.center, combined(place.axes, body.center))
    spread = 0.0
    for i in range(len(chain.axes) - 1, -1, -1):
        column = chain.columns[i]
        width = 0.5 * abs(chain.factors[i]) * (upper[column] - lower[column])
        far = 1.0
        if not chain.slides[i]:
            arm = minus(center, vector_at(work.origins[side], i))
            far = norm(cross(vector_at(work.axes[side], i), arm)) + body.sphere + spread
        work.far[side, i], work.widths[side, i] = far, width
        spread += far * (width if chain.slides[i] else min(width, 2.0))
    return spread


@njit
def least_along(
    body: Moving, place: Place, n: Vector, spread: float, side: int, work: Work
) -> float:  # fmt: skip
    """Return a lower bound of n.p for all points p of a body in all of a cell."""
    count = len(body.chain.axes)
    slopes = np.empty((count, 4))
    curve = before = 0.0
    for i in range(count):
        axis, width = vector_at(work.axes[side], i), work.widths[side, i]
        if body.chain.slides[i]:
            slope, offset = (0.0, 0.0, 0.0), width * dot(n, axis)
            curve += width * before
        else:
            across = scaled(cross(n, axis), width)  # n.(w x (p - o)) = (n x w).(p - o)
            slope = components(place.axes, across)
            offset = dot(across, minus(place.center, vector_at(work.origins[side], i)))
            curve += work.far[side, i] * width * (0.5 * width + before)
            before += width
        slopes[i, 0], slopes[i, 1], slopes[i, 2] = slope
        slopes[i, 3] = offset
    own = components(place.axes, n)
    bent = straight = np.inf
    blocks = body.blocks
    for block in range(len(blocks)):
        for lane in range(blocks.shape[2]):
            x = blocks[block, 0, lane], blocks[block, 1, lane], blocks[block, 2, lane]
            along = dot(own, x)
            straight = min(straight, along)
            for i in range(count):
                along -= abs(
                    slopes[i, 0] * x[0] + slopes[i, 1] * x[1] + slopes[i, 2] * x[2] + slopes[i, 3]
                )
            bent = min(bent, along)
    return dot(n, place.center) + max(bent - curve, straight - spread) - body.round


@njit
def add_slopes(
    body: Moving, point: Vector, n: Vector, side: int, work: Work, slopes: Floats
) -> None:
    """Add how fast a point of a body moves along n with each variable."""
    chain = body.chain
    for i in range(len(chain.axes)):
        axis = vector_at(work.axes[side], i)
        speed = axis
        if not chain.slides[i]:
            speed = cross(axis, minus(point, vector_at(work.origins[side], i)))
        slopes[chain.columns[i]] += chain.factors[i] * dot(n, speed)


@njit
def add_curves(body: Moving, side: int, work: Work, curves: Floats) -> None:
    """Add what each variable has to do with the curvature of the path of a body."""
    chain = body.chain
    total = 0.0
    for i in range(len(chain.axes)):
        if not chain.slides[i]:
            total += work.widths[side, i]
    for i in range(len(chain.axes)):
        curves[chain.columns[i]] += work.widths[side, i] * work.far[side, i] * total
