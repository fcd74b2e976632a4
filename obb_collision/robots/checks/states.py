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

"""Kernels that check one state of robots after another: which bodies may collide.

A body is a shape of a link, of something attached to one, or of the world. Tests go from cheap to
exact, and each lets through all that the next one reports: spheres, boxes by their separating axes,
convex hulls by a direction that certainly separates them.

What runs per state is compiled into one kernel (``refcount=False``): handing the arrays of all
bodies to a function, and counting references to them, takes longer than most of the tests.
"""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.accuracy import Accuracy
from obb_collision.numerics.vec3 import (
    components,
    dot,
    minus,
    negated,
    plus,
    rows_at,
    vector_at,
)
from obb_collision.queries.meshes.convex import Corners, apart
from obb_collision.queries.meshes.tree_boxes import place_at, relative_pose
from obb_collision.queries.verdict.coarse import faces_separate
from obb_collision.queries.verdict.pair_frame import Box, box_at, pair_of
from obb_collision.queries.verdict.verdict import SEPARATE, fast_verdict
from obb_collision.robots.bodies.state_arrays import (
    LINK_PLACING,
    Bodies,
    Placed,
    Tests,
    new_placed,
    place_state,
    placed_box,
    slack_of,
)
from obb_collision.robots.kinematics.kinematics import Tree
from obb_collision.scene.broad_phase.lanes import LANES, lowest, overlaps
from obb_collision.typing import Floats, Integers, Vector

SPHERE, AABB, FACES, HULL = (
    int(level) for level in (Accuracy.SPHERE, Accuracy.AABB, Accuracy.OBB_FACES, Accuracy.HULL)
)


@njit(inline=True, refcount=False)
def gather(
    bodies: Bodies, tests: Tests, placed: Placed, grown: Floats, grown_pairs: Floats, stop: bool
) -> int:
    """Write the pairs whose spheres overlap to candidates; return their number.

    grown (robots' bodies,), grown_pairs (p,): distances within which a body and the world, or a
    pair, count as colliding, metres. First the world, from the last link on: tips collide most.
    stop: whether to end with a pair that certainly collides, by balls within the bodies; it is then
    the first candidate, and the number is -1.
    """
    nodes, starts, order = tests.nodes, tests.levels, tests.order
    centers, spheres, inner = placed.centers, bodies.spheres, bodies.inner
    blocks, levels = placed.waiting[0], placed.waiting[1]
    candidates, limits = placed.candidates, placed.grown
    allowed, ruled = tests.allowed, len(tests.allowed) > 0
    count = 0
    for k in range(len(tests.links) if len(order) else 0):
        group = len(tests.links) - 1 - k
        frame, first, last = tests.links[group], tests.starts[group], tests.starts[group + 1]
        middle = components(rows_at(placed.rotations, frame), vector_at(tests.centers, group))
        x, y, z = plus(vector_at(placed.positions, frame), middle)
        radius = 0.0
        for i in range(first, last):
            radius = max(radius, grown[i] + 2.0 * slack_of(bodies, i, (x, y, z)))
        radius += tests.spheres[group]
        levels[0], blocks[0] = len(starts) - 2, 0
        depth = 1
        while depth > 0:
            depth -= 1
            level, block = levels[depth], blocks[depth]
            mask = overlaps(
                nodes, starts[level] + block,
                x - radius, y - radius, z - radius, x + radius, y + radius, z + radius,
            )  # fmt: skip
            while mask != 0:
                child = LANES * block + lowest(mask)
                mask &= mask - 1
                if level > 0:
                    levels[depth], blocks[depth] = level - 1, child
                    depth += 1
                    continue
                j = tests.first + order[child]
                b = box_at(centers, placed.axes, bodies.half_extents, j)
                for i in range(first, last):
                    if ruled and allowed[i, order[child]]:
                        continue
                    center = vector_at(centers, i)
                    square = square_distance(b, minus(b.center, center))
                    reach = spheres[i] + grown[i] + 2.0 * slack_of(bodies, i, center)
                    reach += LINK_PLACING * bodies.reaches[j]
                    if square > reach * reach * (1.0 + LINK_PLACING):
                        continue
                    candidates[count, 0], candidates[count, 1] = i, j
                    limits[count] = grown[i]
                    count += 1
                    if stop and bodies.boxes[j] and square <= inner[i] * inner[i]:
                        candidates[0, 0], candidates[0, 1] = i, j
                        return -1
    pairs = tests.pairs
    for n in range(len(pairs)):
        i, j = pairs[n, 0], pairs[n, 1]
        d = minus(vector_at(centers, j), vector_at(centers, i))
        reach = spheres[i] + spheres[j] + grown_pairs[n]
        reach += LINK_PLACING * (bodies.reaches[i] + bodies.reaches[j])
        candidates[count, 0], candidates[count, 1] = i, j
        limits[count] = grown_pairs[n]
        count += dot(d, d) <= reach * reach * (1.0 + LINK_PLACING)
    return count


@njit(inline=True, refcount=False)
def find_collision(bodies: Bodies, placed: Placed, count: int, level: int) -> int:
    """Return the first candidate that may collide, -1 if none does."""
    for n in range(count):
        i, j = placed.candidates[n, 0], placed.candidates[n, 1]
        if may_collide(bodies, placed, i, j, placed.grown[n], level):
            return n
    return -1


@njit(inline=True, refcount=False)
def may_collide(bodies: Bodies, placed: Placed, i: int, j: int, grown: float, level: int) -> bool:
    """Return whether bodies i and j are not certainly farther apart than ``grown`` on a level."""
    center, other = vector_at(placed.centers, i), vector_at(placed.centers, j)
    grown += slack_of(bodies, i, center) + slack_of(bodies, j, other)
    d = minus(other, center)
    reach = bodies.spheres[i] + bodies.spheres[j] + grown
    if dot(d, d) > reach * reach * (1.0 + LINK_PLACING):
        return False
    if level == SPHERE:
        return True
    b = placed_box(bodies, placed, j)
    a = placed_box(bodies, placed, i)
    near = bodies.spheres[j] + grown
    if square_distance(a, d) > near * near * (1.0 + LINK_PLACING):
        return False
    h = a.half_extents
    a = Box(a.center, a.axes, (h[0] + grown, h[1] + grown, h[2] + grown))
    if level == AABB:
        return _bounds_touch(d, a, b)
    pair, size = pair_of(a, b)
    if level == FACES:
        return not faces_separate(pair, size)
    if fast_verdict(pair, size) == SEPARATE:
        return False
    return level < HULL or not _hulls_apart(bodies, placed, i, j, d, grown)


@njit
def square_distance(b: Box, d: Vector) -> float:
    """Return the square of the distance of a point from a box; d: of the box's centre from it."""
    x, y, z = components(b.axes, d)
    f = b.half_extents
    x, y, z = max(abs(x) - f[0], 0.0), max(abs(y) - f[1], 0.0), max(abs(z) - f[2], 0.0)
    return x * x + y * y + z * z


@njit
def _bounds_touch(d: Vector, a: Box, b: Box) -> bool:
    """Return whether the world-axis-aligned boxes around two boxes have a common point."""
    for k in range(3):
        reach = 0.0
        for m in range(3):
            reach += a.half_extents[m] * abs(a.axes[m][k]) + b.half_extents[m] * abs(b.axes[m][k])
        if abs(d[k]) > reach:
            return False
    return True


@njit(inline=True, refcount=False)
def _hulls_apart(bodies: Bodies, placed: Placed, i: int, j: int, d: Vector, grown: float) -> bool:
    """Return whether a direction certainly separates two hulls; d: from one centre to the other."""
    a = place_at(placed.positions, placed.rotations, bodies.frames[i])
    b = place_at(placed.positions, placed.rotations, bodies.frames[j])
    pose = relative_pose(a, b, bodies.radii[i] + bodies.radii[j])
    reach = bodies.rounds[i] + bodies.rounds[j] + grown
    own = Corners(bodies.blocks, bodies.starts[i], bodies.starts[i + 1])
    other = Corners(bodies.blocks, bodies.starts[j], bodies.starts[j + 1])
    return apart(own, other, pose, negated(components(a.axes, d)), reach)


@njit
def first_pairs_kernel(
    tree: Tree, bodies: Bodies, tests: Tests, level: int, states: Floats, out: Integers,
    start: int, stop: int,
) -> None:  # fmt: skip
    """Write the first pair of bodies that may collide in each state to out (n, 2); -1 for none."""
    placed = new_placed(bodies, tests, len(tree.parents))
    grown, grown_pairs = np.zeros(tests.first), np.zeros(len(tests.pairs))
    _fill_first_pairs(
        tree, bodies, tests, level, states, placed, grown, grown_pairs, out, start, stop
    )


@njit(inline=True, refcount=False)
def _fill_first_pairs(
    tree: Tree, bodies: Bodies, tests: Tests, level: int, states: Floats, placed: Placed,
    grown: Floats, grown_pairs: Floats, out: Integers, start: int, stop: int,
) -> None:  # fmt: skip
    for n in range(start, stop):
        place_state(tree, bodies, tests, states, n, placed)
        count = gather(bodies, tests, placed, grown, grown_pairs, True)
        found = 0 if count < 0 else find_collision(bodies, placed, count, level)
        for k in range(2):
            out[n, k] = placed.candidates[found, k] if found >= 0 else -1


@njit
def all_pairs_kernel(
    tree: Tree, bodies: Bodies, tests: Tests, level: int, states: Floats, grown: Floats,
    grown_pairs: Floats, counts: Integers, ends: Integers, out: Integers, start: int, stop: int,
) -> None:  # fmt: skip
    """Write every pair that may collide to out (m, 2), that of state n up to row ``ends[n]``.

    Without room in out, only their numbers to counts (n,). grown (k, robots' bodies), grown_pairs
    (k, p): as for ``gather``, of each state, or one for all.
    """
    placed = new_placed(bodies, tests, len(tree.parents))
    for n in range(start, stop):
        row = n if len(grown) > 1 else 0
        if len(out) and counts[n] == 0:
            continue
        place_state(tree, bodies, tests, states, n, placed)
        count = gather(bodies, tests, placed, grown[row], grown_pairs[row], False)
        found = 0
        for m in range(count):
            i, j = placed.candidates[m, 0], placed.candidates[m, 1]
            if may_collide(bodies, placed, i, j, placed.grown[m], level):
                found += 1
                if len(out):
                    row = ends[n] - found
                    out[row, 0], out[row, 1] = i, j
        if len(out) == 0:
            counts[n] = found
