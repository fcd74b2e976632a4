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

"""Distances: the least one in each state, of all pairs of bodies that are checked.

Up to "obb" it is that of boxes, at "hull" of hulls. Spheres and boxes bound the distance of a pair
from below; the pair with the least bound comes first, and others are looked at as long as theirs is
below the least distance found. At "mesh" hulls bound distances in the same way.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from obb_collision._jit import Held, njit
from obb_collision._threads import run
from obb_collision.accuracy import Accuracy
from obb_collision.geometry.boxes import BoxArrays
from obb_collision.geometry.trees.pool import Hulls
from obb_collision.numerics.vec3 import dot, minus, norm, vector_at
from obb_collision.queries.convex.depth import Polytope, room_for_depth
from obb_collision.queries.convex.distances import NO_START, body_distance
from obb_collision.queries.convex.support import BOX, CORNERS, Cores
from obb_collision.queries.verdict.sat import box_at
from obb_collision.robots.checks.arrays import (
    LINK_PLACING,
    Checked,
    LinkBodies,
    Placed,
    Tests,
    new_placed,
    place_state,
    placed_box,
)
from obb_collision.robots.checks.gradients import distance_gradients
from obb_collision.robots.checks.meshes import PairDistances, set_mesh_distances
from obb_collision.robots.checks.model import Prepared
from obb_collision.robots.checks.reports import StateDistances
from obb_collision.robots.checks.states import all_pairs, square_distance
from obb_collision.typing import Floats, Integers, Rows

#: Relative growth of spheres around boxes: more than what these are larger by.
SPHERE_GROWTH = 1.0 + 1e-9
#: Relative growth of distances: more than the roundings of what is compared with them.
GROWTH = 1.0 + 1e-9
#: States with distances, and pairs, below which a second thread does not pay.
FEWEST_DISTANCES, FEWEST_PAIRS = 8, 32


class DistanceQuestion(NamedTuple):
    """States (n, joints) whose least distances up to a limit are asked for.

    boxes: whether bodies are their boxes, or hulls; given: whether only the pairs that are there.
    """

    checked: Checked
    boxes: bool
    given: bool
    states: Floats
    limit: float


class NearestPairs(NamedTuple):
    """The nearest pair of each state."""

    bounds: Floats  #: (n, 2) between which the distance is
    pairs: Integers  #: (n, 2) of bodies, -1 for none
    vectors: Floats  #: (n, 3, 3): the closest points of both, and the direction


class DistanceState(NamedTuple):
    """What the distances of one state are found with."""

    placed: Placed
    cores: Cores
    polytope: Polytope
    spheres: Floats  #: (b,) radii around bodies, or around their boxes
    lower: Floats  #: (p,) bounds of the distances of all pairs


@njit
def distances_kernel(
    held: Held,
    asked: tuple[bool, bool, Floats, float],
    found: tuple[Floats, Integers, Floats],
    start: int,
    stop: int,
) -> None:
    """Write the least signed distance of each state, negative where bodies collide.

    asked, found: ``DistanceQuestion`` and ``NearestPairs`` as plain tuples, which come from Python
    faster.
    """
    question, nearest = DistanceQuestion(held.value, *asked), NearestPairs(*found)
    bodies, placed, boxes = question.checked.bodies, new_placed(question.checked), question.boxes
    lower, spheres = np.empty(1 if question.given else len(placed.grown)), bodies.spheres.copy()
    for i in range(len(spheres) if boxes else 0):
        spheres[i] = norm(vector_at(bodies.half_extents, i)) * SPHERE_GROWTH
    room = DistanceState(placed, _cores(bodies, boxes), room_for_depth(), spheres, lower)
    _fill_distances(question, nearest, room, start, stop)


@njit(inline=True, refcount=False)
def _fill_distances(
    question: DistanceQuestion, nearest: NearestPairs, room: DistanceState, start: int, stop: int
) -> None:
    checked, boxes, given = question.checked, question.boxes, question.given
    bodies, tests, placed = checked.bodies, checked.tests, room.placed
    cores, lower = room.cores, room.lower
    bounds, pairs, vectors = nearest.bounds, nearest.pairs, nearest.vectors
    for n in range(start, stop):
        place_state(checked, question.states, n, placed)
        for i in range(tests.first):
            _place_core(bodies, placed, i, cores, boxes)
        best = question.limit
        if not given:
            _bound_all(bodies, tests, placed, room.spheres, lower)
            bounds[n, 0] = bounds[n, 1] = np.inf
            pairs[n, 0] = pairs[n, 1] = -1
        for k in range(-1, 0 if given else len(lower)):
            if given:
                i, j = pairs[n, 0], pairs[n, 1]
            elif len(lower) == 0 or (k >= 0 and not lower[k] < best):
                continue
            else:  # first the one with the least bound
                i, j = _pair_at(tests, k if k >= 0 else int(lower.argmin()))
            found = body_distance(cores, i, cores, j, NO_START, best, room.polytope)
            if not (given or found.lower < best):
                continue
            best = found.lower
            bounds[n, 0], bounds[n, 1] = found.lower, found.upper
            pairs[n, 0], pairs[n, 1] = i, j
            for m in range(3):
                vectors[n, 0, m], vectors[n, 1, m] = found.a[m], found.b[m]
                vectors[n, 2, m] = found.normal[m]


@njit(refcount=False)
def _pair_at(tests: Tests, m: int) -> tuple[int, int]:
    """Return the bodies of pair m: those of the robots first, then each with all of the world."""
    if m < len(tests.pairs):
        return tests.pairs[m, 0], tests.pairs[m, 1]
    count = len(tests.order)
    m -= len(tests.pairs)
    return m // count, tests.first + m % count


@njit(refcount=False)
def _bound_all(
    bodies: LinkBodies, tests: Tests, placed: Placed, spheres: Floats, lower: Floats
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
            box = box_at(BoxArrays(placed.centers, placed.axes, bodies.half_extents), j)
            square = square_distance(box, d)
            if square > 0.0:
                lower[m] = max(lower[m], np.sqrt(square) - spheres[i])
        lower[m] -= 1e-9 * (norm(d) + spheres[i] + spheres[j])


@njit
def _cores(bodies: LinkBodies, boxes: bool) -> Cores:
    """Return bodies, or their boxes, as those of ``queries.convex``; the world's in their place.

    Boxes are larger by what kinematics round.
    """
    count = len(bodies.frames)
    cores = Cores(
        np.full(count, BOX if boxes else CORNERS, np.int8),
        np.zeros((count, 4)),
        np.zeros(count) if boxes else bodies.rounds,
        Hulls(bodies.blocks, bodies.starts, bodies.radii),
        np.arange(count),
        np.zeros((count, 3)),
        np.zeros((count, 3, 3)),
    )
    for i in range(count):
        for k in range(3):
            cores.rotations[i, k, k] = 1.0
            if boxes:
                cores.sizes[i, k] = bodies.half_extents[i, k] + LINK_PLACING * bodies.reaches[i]
                cores.centers[i, k] = bodies.centers[i, k]
                for m in range(3):
                    cores.rotations[i, k, m] = bodies.rotations[i, k, m]
    return cores


@njit(refcount=False)
def _place_core(bodies: LinkBodies, placed: Placed, i: int, cores: Cores, boxes: bool) -> None:
    """Place the hull of body i by its frame, or its box."""
    frame = bodies.frames[i]
    if boxes:
        placed_box(bodies, placed, i)
    for k in range(3):
        cores.centers[i, k] = placed.centers[i, k] if boxes else placed.positions[frame, k]
        for m in range(3):
            turn = placed.axes[i, k, m] if boxes else placed.rotations[frame, k, m]
            cores.rotations[i, k, m] = turn


def hull_distances(
    prepared: Prepared, states: Floats, pairs: Integers, limit: float, boxes: bool = False
) -> PairDistances:
    """Return the distances of pairs (m, 2) of bodies in the state (m, joints) of their row.

    boxes: those of their boxes.
    """
    count = len(pairs)
    bounds, vectors = np.empty((count, 2)), np.empty((count, 3, 3))
    asked, found = (boxes, True, states, limit), (bounds, pairs.copy(), vectors)
    run(distances_kernel, count, FEWEST_PAIRS, prepared.held, asked, found)
    return PairDistances(bounds[:, 0], bounds[:, 1], vectors)


@njit
def _name_pairs(
    known: tuple[Integers, Floats, Floats], found: tuple[Floats, Integers, Floats], curved: bool
) -> None:
    """Turn pairs of bodies into those of what they belong to, and points into those of the scene.

    known: the owners and excess of bodies, and the origin. curved: whether upper bounds are to be
    those of the shapes, not of the prisms around them.
    """
    (owners, excess, origin), (bounds, pairs, vectors) = known, found
    for n in range(len(pairs)):
        i, j = pairs[n, 0], pairs[n, 1]
        if curved:
            bounds[n, 1] += excess[i] + excess[j]
        a, b = owners[i], owners[j]
        pairs[n, 0], pairs[n, 1] = min(a, b), max(a, b)
        for k in range(3):
            p, q = vectors[n, 0, k] + origin[k], vectors[n, 1, k] + origin[k]
            vectors[n, 0, k], vectors[n, 1, k] = (q, p) if a > b else (p, q)
            if a > b:
                vectors[n, 2, k] *= -1.0


def state_distances(
    prepared: Prepared,
    accuracy: Accuracy,
    states: Floats,
    limit: float,
    self_pairs: bool,
    every: bool,
    jacobian: bool,
) -> StateDistances:
    """Return distances up to a limit in states (n, joints): the least, or those of every pair."""
    if not self_pairs:
        prepared = prepared.without_self_pairs
    checked = prepared.checked
    ask = _all_distances if every else _least_distances
    rows, (bounds, bodies, vectors) = ask(prepared, accuracy, states, limit)
    gradients = None
    if jacobian:
        frames = np.append(checked.bodies.frames, 0)[bodies]  # of any where there is no pair
        given = np.ascontiguousarray(states[rows])
        points, along = np.ascontiguousarray(vectors[:, :2]), np.ascontiguousarray(vectors[:, 2])
        places = prepared.own.driven, frames, points, along
        gradients = distance_gradients(checked.tree, given, *places)
    known = prepared.checked.owners, prepared.excess, prepared.world.origin
    _name_pairs(known, (bounds, bodies, vectors), bool(accuracy >= Accuracy.HULL))
    if every:  # the least of each two names
        order = np.lexsort([bounds[:, 0], bodies[:, 1], bodies[:, 0], rows])
        keys = np.column_stack([rows, bodies])[order]
        first = np.ones(len(order), np.bool_)
        first[1:] = (keys[1:] != keys[:-1]).any(axis=1)
        kept = order[first]
        rows, bodies = rows[kept], bodies[kept]
        bounds, vectors = bounds[kept], vectors[kept]
        gradients = None if gradients is None else gradients[kept]
    lower, upper = bounds.T
    found = lower, upper, bodies, vectors[:, :2], vectors[:, 2]
    return StateDistances(*found, prepared.names, rows, gradients)


def _least_distances(
    prepared: Prepared, accuracy: Accuracy, states: Floats, limit: float
) -> tuple[Rows, NearestPairs]:
    """Return the least distance in each state."""
    count = len(states)
    vectors = np.empty((count, 3, 3))
    vectors.fill(np.nan)
    found = np.empty((count, 2)), np.empty((count, 2), np.int64), vectors
    asked = bool(accuracy < Accuracy.HULL), False, states, limit
    run(distances_kernel, count, FEWEST_DISTANCES, prepared.held, asked, found)
    nearest = NearestPairs(*found)
    if accuracy == Accuracy.MESH:
        _decide_meshes(prepared, states, limit, nearest)
    return np.arange(count), nearest


def _all_distances(
    prepared: Prepared, accuracy: Accuracy, states: Floats, limit: float
) -> tuple[Rows, NearestPairs]:
    """Return the distances of all pairs of bodies within a limit."""
    level = Accuracy.OBB if accuracy < Accuracy.HULL else Accuracy.HULL
    rows, pairs = all_pairs(prepared, level, states, prepared.within(np.full(1, limit)))
    given = np.ascontiguousarray(states[rows])
    bounds = hull_distances(prepared, given, pairs, limit, boxes=bool(accuracy < Accuracy.HULL))
    if accuracy == Accuracy.MESH:
        set_mesh_distances(prepared, given, pairs, bounds, limit, depths=True)
    kept = bounds.lower < limit
    lower_upper = np.column_stack([bounds.lower[kept], bounds.upper[kept]])
    return rows[kept], NearestPairs(lower_upper, pairs[kept], bounds.vectors[kept])


def _decide_meshes(prepared: Prepared, states: Floats, limit: float, nearest: NearestPairs) -> None:
    """Write the least distances of meshes, and their pairs, over those of hulls."""
    rows = np.flatnonzero(nearest.pairs[:, 0] >= 0)
    some, first = np.ascontiguousarray(states[rows]), nearest.pairs[rows]
    lower, upper = nearest.bounds[rows].T.copy()
    best = PairDistances(lower, upper, nearest.vectors[rows])
    set_mesh_distances(prepared, some, first, best, limit, depths=True)
    reach = np.clip(best.lower, 0.0, limit) * GROWTH
    numbers, pairs = all_pairs(prepared, Accuracy.HULL, some, prepared.within(reach))
    others = (pairs != first[numbers]).any(axis=1)
    numbers, pairs = numbers[others], pairs[others]
    hulls = hull_distances(prepared, some[numbers], pairs, limit)
    for these in _rounds(numbers, hulls.lower):
        again = these[hulls.lower[these] < best.lower[numbers[these]]]
        if len(again) == 0:
            continue
        each = PairDistances(*(values[again] for values in hulls))
        given = np.ascontiguousarray(some[numbers[again]])
        set_mesh_distances(prepared, given, pairs[again], each, limit, depths=True)
        less = each.lower < best.lower[numbers[again]]
        places = numbers[again[less]]
        first[places] = pairs[again[less]]
        for values, new in zip(best, each, strict=True):
            values[places] = new[less]
    beyond = ~(best.lower < limit)
    best.lower[beyond] = best.upper[beyond] = np.inf
    best.vectors[beyond], first[beyond] = np.nan, -1
    nearest.pairs[rows], nearest.vectors[rows] = first, best.vectors
    nearest.bounds[rows] = np.column_stack([best.lower, best.upper])


def _rounds(numbers: Rows, lower: Floats) -> list[Rows]:
    """Return rows of pairs: in the first round the one with the least bound of each state, ..."""
    order = np.lexsort([lower, numbers])
    places = np.arange(len(order)) - np.searchsorted(numbers[order], numbers[order])
    return [order[places == place] for place in range(int(places.max(initial=-1)) + 1)]
