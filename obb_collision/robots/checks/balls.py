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

"""The balls of clouds in the world of robots: searched by trees, tested one at a time.

A cloud may have a million balls, so it is one body, not a body per ball: kernels copy the bodies
once, and move that body to a ball before each test. The tree over the points of a cloud stays in
the cloud's frame; its leaves hold the points. In a pair of bodies the number ``count + k`` means
ball k, where ``count`` is the number of bodies.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.trees.bounds_tree import LANE_BITS, LEVELS, lowest, overlaps
from obb_collision.geometry.trees.clouds import Cloud
from obb_collision.numerics.intrinsics import LANES
from obb_collision.numerics.vec3 import (
    absolute,
    axes_of,
    combined,
    components,
    dot,
    minus,
    plus,
    rows_at,
    vector_at,
)
from obb_collision.queries.points.near_points import block_gap, box_distance
from obb_collision.queries.verdict.sat import BoxAt
from obb_collision.robots.checks.arrays import Clouds, LinkBodies
from obb_collision.typing import Floats, Integers, Rows, Vector


def clouds_of(
    clouds: Sequence[Cloud], bodies: Integers, centers: Floats, rotations: Floats
) -> Clouds:
    """Return clouds (c,) that have points, for kernels.

    bodies (c,): rows of their bodies. centers (c, 3), rotations (c, 3, 3): their places.
    """
    count = len(clouds)
    levels, tops = np.zeros((count + 1, LEVELS), np.int64), np.zeros(count, np.int64)
    nodes = [cloud.tree.nodes for cloud in clouds] or [np.empty((0, 6, LANES))]
    for n, cloud in enumerate(clouds):
        starts = cloud.tree.starts
        levels[n, : len(starts) - 1] += starts[:-1]
        levels[n + 1 :] += starts[-1]
        tops[n] = len(starts) - 2
    joined = nodes[0] if count < 2 else np.concatenate(nodes)
    return Clouds(bodies, centers, rotations, joined, levels, tops)


def bodies_at(clouds: Clouds, count: int, numbers: Integers) -> Integers:
    """Return the body of each number in pairs (...), of a ball its cloud's; count: of bodies."""
    if not len(clouds.bodies):
        return numbers
    balls, result = numbers >= count, numbers.copy()
    result[balls] = clouds.bodies[_owners_of(clouds, numbers[balls] - count)]
    return result


def centers_at(clouds: Clouds, balls: Rows) -> Floats:
    """Return the centres (k, 3) of balls (k,), metres, relative to the origin of bodies."""
    owners = _owners_of(clouds, balls)
    points = clouds.nodes[balls // LANES, :3, balls % LANES]
    turned = np.einsum("nij,nj->ni", clouds.rotations[owners], points)
    return np.asarray(turned + clouds.centers[owners])


def _owners_of(clouds: Clouds, balls: Rows) -> Rows:
    """Return the row (k,) of the cloud of each ball (k,)."""
    return np.searchsorted(clouds.levels[:-1, 0], balls // LANES, "right") - 1


@njit(inline=True, refcount=False)
def ball_center(clouds: Clouds, c: int, ball: int) -> Vector:
    """Return the centre of a ball of cloud c, relative to the origin of bodies."""
    nodes, block, lane = clouds.nodes, ball >> LANE_BITS, ball & (LANES - 1)
    point = nodes[block, 0, lane], nodes[block, 1, lane], nodes[block, 2, lane]
    return plus(vector_at(clouds.centers, c), components(rows_at(clouds.rotations, c), point))


@njit(inline=True, refcount=False)
def body_at(bodies: LinkBodies, clouds: Clouds, number: int) -> int:
    """Return the body of a number in a pair; a ball's is its cloud's, which is moved there."""
    count = len(bodies.frames)
    if number < count:
        return number
    c = cloud_at(clouds, number - count)
    j = clouds.bodies[c]
    x, y, z = ball_center(clouds, c, number - count)
    bodies.centers[j, 0], bodies.centers[j, 1], bodies.centers[j, 2] = x, y, z
    block = bodies.starts[j]
    for lane in range(LANES):
        bodies.blocks[block, 0, lane] = x
        bodies.blocks[block, 1, lane] = y
        bodies.blocks[block, 2, lane] = z
    return j


@njit(inline=True, refcount=False)
def cloud_at(clouds: Clouds, ball: int) -> int:
    """Return the cloud of a ball."""
    c = 0
    while ball >> LANE_BITS >= clouds.levels[c + 1, 0]:
        c += 1
    return c


@njit(refcount=False)
def find_balls(
    clouds: Clouds, c: int, start: Vector, end: Vector, reach: float, waiting: Integers,
    out: Integers, most: int,
) -> int:  # fmt: skip
    """Write the balls of cloud c near two points; return their number, ``most`` for no fewer.

    Those whose centres are in the bounds of both points, in the frame of the cloud, grown by reach.
    """
    nodes, starts = clouds.nodes, clouds.levels
    blocks, levels = waiting[0], waiting[1]
    axes, place = axes_of(clouds.rotations, c), vector_at(clouds.centers, c)
    x, y, z = components(axes, minus(start, place))
    u, v, w = components(axes, minus(end, place))
    x, u, y, v, z, w = min(x, u), max(x, u), min(y, v), max(y, v), min(z, w), max(z, w)
    levels[0], blocks[0] = clouds.tops[c], 0
    depth, count = 1, 0
    while depth > 0:
        depth -= 1
        level, block = levels[depth], blocks[depth]
        row = starts[c, level] + block
        mask = overlaps(
            nodes, row, x - reach, y - reach, z - reach, u + reach, v + reach, w + reach
        )
        while mask != 0:
            lane = lowest(mask)
            mask &= mask - 1
            if level > 0:
                levels[depth], blocks[depth] = level - 1, LANES * block + lane
                depth += 1
            else:
                out[count] = LANES * row + lane
                count += 1
                if count == most:
                    return count
    return count


@njit(inline=True, refcount=False)
def lowest_along(normal: Vector, lean: Vector, nodes: Floats, row: int, lane: int) -> float:
    """Return the least product of a normal, of magnitudes ``lean``, with bounds in a block."""
    low = nodes[row, 0, lane], nodes[row, 1, lane], nodes[row, 2, lane]
    high = nodes[row, 3, lane], nodes[row, 4, lane], nodes[row, 5, lane]
    return 0.5 * (dot(normal, plus(low, high)) - dot(lean, minus(high, low)))


@njit(refcount=False)
def balls_near(
    clouds: Clouds, c: int, box: BoxAt, limit: float, nearest: bool, waiting: Integers,
    out: Integers, normal: Vector, ahead: float,
) -> int:  # fmt: skip
    """Write the balls of cloud c whose centres are nearer to a box than a limit; return how many.

    nearest: only the nearest one. normal, ahead: centres farther than that along a unit normal are
    left out; zero and infinite for no such plane. Distances are those in the frame of the cloud,
    see ``near_points``; the errors of the places there are the caller's.
    """
    nodes, starts = clouds.nodes, clouds.levels
    blocks, levels = waiting[0], waiting[1]
    turn, place = axes_of(clouds.rotations, c), vector_at(clouds.centers, c)
    u, v, w = box.axes
    axes = components(turn, u), components(turn, v), components(turn, w)
    box = BoxAt(components(turn, minus(box.center, place)), axes, box.half_extents)
    sides = absolute(axes[0]), absolute(axes[1]), absolute(axes[2])
    ahead -= dot(normal, place)
    normal = components(turn, normal)
    lean = absolute(normal)
    (x, y, z), (u0, v0, w0) = box.center, combined(sides, box.half_extents)
    levels[0], blocks[0] = clouds.tops[c], 0
    depth, count = 1, 0
    while depth > 0:
        depth -= 1
        level, block = levels[depth], blocks[depth]
        row, reach = starts[c, level] + block, max(limit, 0.0)
        i, j, k = u0 + reach, v0 + reach, w0 + reach
        mask = overlaps(nodes, row, x - i, y - j, z - k, x + i, y + j, z + k)
        least, first = np.inf, -1
        while mask != 0:
            lane = lowest(mask)
            mask &= mask - 1
            if level > 0:
                child, gap = LANES * block + lane, block_gap(box, sides, nodes, row, lane)
                if gap > reach or lowest_along(normal, lean, nodes, row, lane) > ahead:
                    continue
                if gap < least:
                    least, first, child = gap, child, first
                if child >= 0:
                    levels[depth], blocks[depth] = level - 1, child
                    depth += 1
                continue
            point = nodes[row, 0, lane], nodes[row, 1, lane], nodes[row, 2, lane]
            gap = box_distance(box, point)
            if gap < limit and not dot(normal, point) > ahead:
                if nearest:
                    limit, count = gap, 0
                out[count] = LANES * row + lane
                count += 1
        if first >= 0:  # the nearest block is the next one
            levels[depth], blocks[depth] = level - 1, first
            depth += 1
    return count
