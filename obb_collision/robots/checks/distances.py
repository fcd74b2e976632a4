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

"""Kernels for the least distance in each state, of all pairs of bodies that are checked.

Spheres and boxes bound the distance of a pair from below; the pair with the least bound comes
first, and others are looked at as long as theirs is below the least distance found.
"""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.trees.pool import Hulls
from obb_collision.numerics.vec3 import dot, minus, norm, vector_at
from obb_collision.queries.convex.depth import Polytope, room_for_depth
from obb_collision.queries.convex.distances import NO_START, Distance, body_distance
from obb_collision.queries.convex.support import BOX, CORNERS, Cores
from obb_collision.queries.verdict.pair_frame import box_at
from obb_collision.robots.bodies.state_arrays import (
    LINK_PLACING,
    Bodies,
    Placed,
    Tests,
    new_placed,
    place_state,
    placed_box,
)
from obb_collision.robots.checks.states import square_distance
from obb_collision.robots.kinematics.kinematics import Tree
from obb_collision.typing import Floats, Integers

#: Relative growth of spheres around boxes: more than what these are larger by.
SPHERE_GROWTH = 1.0 + 1e-9


@njit
def distances_kernel(
    tree: Tree, bodies: Bodies, tests: Tests, boxes: bool, states: Floats, limit: float,
    bounds: Floats, pairs: Integers, vectors: Floats, start: int, stop: int,
) -> None:  # fmt: skip
    """Write the least signed distance of each state up to a limit, negative where bodies collide.

    boxes: whether bodies are their boxes, or hulls; bounds (n, 2): between which it is; pairs
    (n, 2) of bodies, -1 for none; vectors (n, 3, 3): the closest points of both and the direction.
    """
    placed = new_placed(bodies, tests, len(tree.parents))
    cores, room = _box_cores(bodies) if boxes else _cores(bodies), room_for_depth()
    lower = np.empty(len(placed.grown))
    spheres = np.empty(len(bodies.spheres))
    for i in range(len(spheres)):
        h = vector_at(bodies.half_extents, i)
        spheres[i] = norm(h) * SPHERE_GROWTH if boxes else bodies.spheres[i]
    for n in range(start, stop):
        place_state(tree, bodies, tests, states, n, placed)
        for i in range(tests.first):
            if boxes:
                _place_box(bodies, placed, i, cores)
            else:
                _place_core(bodies, placed, i, cores)
        _bound_all(bodies, tests, placed, spheres, lower)
        bounds[n, 0] = bounds[n, 1] = np.inf
        pairs[n, 0] = pairs[n, 1] = -1
        best = limit
        if len(lower):
            best = _try_pair(
                cores, tests, int(lower.argmin()), best, n, bounds, pairs, vectors, room
            )
        for m in range(len(lower)):
            if lower[m] < best:
                best = _try_pair(cores, tests, m, best, n, bounds, pairs, vectors, room)


@njit
def pair_distances_kernel(
    tree: Tree, bodies: Bodies, tests: Tests, states: Floats, pairs: Integers, limit: float,
    bounds: Floats, vectors: Floats, start: int, stop: int,
) -> None:  # fmt: skip
    """Write the signed distance of the hulls of pair n (m, 2) of bodies in state n, up to a limit.

    bounds (2, m), vectors (m, 3, 3): as in ``distances_kernel``.
    """
    placed = new_placed(bodies, tests, len(tree.parents))
    cores, room = _cores(bodies), room_for_depth()
    for n in range(start, stop):
        place_state(tree, bodies, tests, states, n, placed)
        i, j = pairs[n, 0], pairs[n, 1]
        _place_core(bodies, placed, i, cores)
        if j < tests.first:
            _place_core(bodies, placed, j, cores)
        found = body_distance(cores, i, cores, j, NO_START, limit, room)
        bounds[0, n], bounds[1, n] = found.lower, found.upper
        for k in range(3):
            vectors[n, 0, k], vectors[n, 1, k] = found.a[k], found.b[k]
            vectors[n, 2, k] = found.normal[k]


@njit
def _pair_at(tests: Tests, m: int) -> tuple[int, int]:
    """Return the bodies of pair m: those of the robots first, then each with all of the world."""
    if m < len(tests.pairs):
        return tests.pairs[m, 0], tests.pairs[m, 1]
    count = len(tests.order)
    m -= len(tests.pairs)
    return m // count, tests.first + m % count


@njit
def _try_pair(
    cores: Cores, tests: Tests, m: int, best: float, n: int, bounds: Floats, pairs: Integers,
    vectors: Floats, room: Polytope,
) -> float:  # fmt: skip
    """Write the distance of pair m if it is less than the best one; return the lesser one."""
    i, j = _pair_at(tests, m)
    found: Distance = body_distance(cores, i, cores, j, NO_START, best, room)
    if not found.lower < best:
        return best
    bounds[n, 0], bounds[n, 1] = found.lower, found.upper
    pairs[n, 0], pairs[n, 1] = i, j
    for k in range(3):
        vectors[n, 0, k], vectors[n, 1, k] = found.a[k], found.b[k]
        vectors[n, 2, k] = found.normal[k]
    return found.lower


@njit
def _bound_all(
    bodies: Bodies, tests: Tests, placed: Placed, spheres: Floats, lower: Floats
) -> None:
    """Write lower bounds of all distances, infinite for pairs that do not count."""
    for m in range(len(lower)):
        i, j = _pair_at(tests, m)
        if j >= tests.first and len(tests.allowed) and tests.allowed[i, j - tests.first]:
            lower[m] = np.inf
            continue
        d = minus(vector_at(placed.centers, j), vector_at(placed.centers, i))
        lower[m] = np.sqrt(dot(d, d)) - spheres[i] - spheres[j]
        if j >= tests.first:
            box = box_at(placed.centers, placed.axes, bodies.half_extents, j)
            square = square_distance(box, d)
            if square > 0.0:
                lower[m] = max(lower[m], np.sqrt(square) - spheres[i])
        lower[m] -= 1e-9 * (norm(d) + spheres[i] + spheres[j])


@njit
def _cores(bodies: Bodies) -> Cores:
    """Return bodies as those of ``queries.convex``, those of the world in their place."""
    count = len(bodies.frames)
    cores = Cores(
        np.full(count, CORNERS, np.int8), np.zeros((count, 4)), bodies.rounds,
        Hulls(bodies.blocks, bodies.starts, bodies.radii), np.arange(count),
        np.zeros((count, 3)), np.zeros((count, 3, 3)),
    )  # fmt: skip
    for i in range(count):
        for k in range(3):
            cores.rotations[i, k, k] = 1.0
    return cores


@njit
def _box_cores(bodies: Bodies) -> Cores:
    """Return the boxes of bodies, those of the world in their place.

    They are larger by what kinematics round.
    """
    count = len(bodies.frames)
    cores = Cores(
        np.full(count, BOX, np.int8), np.zeros((count, 4)), np.zeros(count),
        Hulls(bodies.blocks, bodies.starts, bodies.radii), np.arange(count),
        bodies.centers.copy(), bodies.rotations.copy(),
    )  # fmt: skip
    for i in range(count):
        for k in range(3):
            cores.sizes[i, k] = bodies.half_extents[i, k] + LINK_PLACING * bodies.reaches[i]
    return cores


@njit
def _place_core(bodies: Bodies, placed: Placed, i: int, cores: Cores) -> None:
    """Place the hull of body i by its frame."""
    frame = bodies.frames[i]
    for k in range(3):
        cores.centers[i, k] = placed.positions[frame, k]
        for m in range(3):
            cores.rotations[i, k, m] = placed.rotations[frame, k, m]


@njit
def _place_box(bodies: Bodies, placed: Placed, i: int, cores: Cores) -> None:
    """Place the box of body i."""
    axes = placed_box(bodies, placed, i).axes
    for k in range(3):
        cores.centers[i, k] = placed.centers[i, k]
        for m in range(3):
            cores.rotations[i, m, k] = axes[k][m]
