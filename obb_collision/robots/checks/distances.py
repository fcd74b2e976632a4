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

"""Distances: the least one in each state, of all pairs of bodies that are checked, and gradients.

Up to "obb" distances are those of boxes, at "hull" those of hulls. Spheres and boxes give lower
bounds: the pair with the least bound is computed first, then every pair whose bound is below the
least distance so far. At "mesh", hulls give lower bounds in the same way.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from obb_collision._jit import Held, njit
from obb_collision._threads import run
from obb_collision.accuracy import Accuracy
from obb_collision.geometry.boxes import BoxArrays
from obb_collision.geometry.poses import multiply_quaternions, rotate_vectors, rotation_of
from obb_collision.geometry.trees.pool import Hulls
from obb_collision.numerics.vec3 import ZERO, components, cross, dot, minus, norm, vector_at
from obb_collision.queries.convex.depth import DepthRoom, room_for_depth
from obb_collision.queries.convex.distances import body_distance
from obb_collision.queries.convex.support import BOX_CORE, HULL_CORE, Cores
from obb_collision.queries.verdict.sat import box_at
from obb_collision.robots.checks.arrays import (
    LINK_PLACING,
    Checked,
    LinkBodies,
    PairValues,
    Placed,
    Tests,
    new_placed,
    place_state,
    placed_box,
    slack_of,
    with_own_clouds,
    without_clouds,
)
from obb_collision.robots.checks.balls import ball_center, balls_near, body_at
from obb_collision.robots.checks.meshes import PairDistances, set_mesh_distances
from obb_collision.robots.checks.model import Prepared
from obb_collision.robots.checks.reports import StateDistances
from obb_collision.robots.checks.states import all_pairs, gather, square_distance
from obb_collision.robots.kinematics.kinematics import (
    PLANAR,
    PRISMATIC,
    Tree,
    link_poses,
    place_links,
)
from obb_collision.typing import Floats, Integers, Mask, Rows

#: Relative growth of spheres around boxes: more than the growth of the boxes themselves.
SPHERE_GROWTH = 1.0 + 1e-9
#: Relative growth of distances: more than the roundings of bounds that are compared with them.
GROWTH = 1.0 + 1e-9
#: Minimum number of states, and of pairs, for a second thread.
FEWEST_DISTANCES, FEWEST_PAIRS = 8, 32
#: Minimum number of gradients for a second thread.
FEWEST_GRADIENTS = 256


class DistanceQuestion(NamedTuple):
    """States (n, joints) to find least distances in, up to a limit.

    boxes: whether of the boxes of bodies, instead of their hulls; one_pair: whether of one pair per
    state, which the output holds already.
    """

    checked: Checked
    boxes: bool
    one_pair: bool
    states: Floats
    limit: float


class NearestPairs(NamedTuple):
    """The nearest pair of each state."""

    bounds: Floats  #: (n, 2) lower and upper bound of the distance
    pairs: Integers  #: (n, 2) of bodies, -1 for none
    vectors: Floats  #: (n, 3, 3) the closest points of both, and the direction


class DistanceState(NamedTuple):
    """Arrays for the distances of one state."""

    placed: Placed
    cores: Cores
    polytope: DepthRoom
    spheres: Floats  #: (b,) radii of spheres around bodies, or around their boxes
    lower: Floats  #: (p,) lower bounds of the distances of candidates
    near: PairValues  #: the limit for all pairs; no rows if there is none
    objects: Checked  #: without the clouds, which are asked after them
    plane: Floats  #: (4,) of the last pair: the unit normal, and the lower bound along it


@njit
def distances_kernel(
    held: Held,
    question: tuple[bool, bool, Floats, float],
    output: tuple[Floats, Integers, Floats],
    start: int,
    stop: int,
) -> None:
    """Write the least signed distance of each state, negative where bodies collide.

    question, output: ``DistanceQuestion`` and ``NearestPairs`` as plain tuples, which arrive from
    Python faster.
    """
    asked = DistanceQuestion(with_own_clouds(held.value), *question)
    nearest = NearestPairs(*output)
    bodies, placed, boxes = asked.checked.bodies, new_placed(asked.checked), asked.boxes
    objects, tests, plane = without_clouds(asked.checked), asked.checked.tests, np.empty(4)
    count = len(tests.pairs) + tests.first * len(tests.order)
    lower, spheres = np.empty(1 if asked.one_pair else count), bodies.spheres.copy()
    for i in range(len(spheres) if boxes else 0):
        spheres[i] = norm(vector_at(bodies.half_extents, i)) * SPHERE_GROWTH
    cores = _cores(asked.checked, boxes)
    limits = 1 if asked.limit < np.inf and not boxes else 0
    near = PairValues(np.empty((limits, tests.first)), np.empty((limits, len(tests.pairs))))
    near.bodies[:], near.pairs[:] = asked.limit, asked.limit
    room = DistanceState(placed, cores, room_for_depth(), spheres, lower, near, objects, plane)
    _fill_distances(asked, nearest, room, start, stop)


@njit(inline=True, refcount=False)
def _fill_distances(
    question: DistanceQuestion, nearest: NearestPairs, room: DistanceState, start: int, stop: int
) -> None:
    checked, boxes, one_pair = question.checked, question.boxes, question.one_pair
    bodies, tests, placed = checked.bodies, checked.tests, room.placed
    cores, lower, candidates = room.cores, room.lower, placed.candidates
    bounds, pairs = nearest.bounds, nearest.pairs
    for n in range(start, stop):
        place_state(checked, question.states, n, placed)
        for i in range(tests.first):
            _place_core(bodies, placed, i, cores, boxes)
        best, count, least = question.limit, 1, 0
        if not one_pair:
            if len(room.near.bodies) > 0:
                count = gather(room.objects, placed, room.near, 0, False, True)
            else:
                count = _all_candidates(tests, candidates)
            least = _bound_all(bodies, tests, placed, room.spheres, count, lower)
            bounds[n, 0] = bounds[n, 1] = np.inf
            pairs[n, 0] = pairs[n, 1] = -1
        for k in range(-1, 0 if one_pair else count):
            if one_pair:
                i, j = pairs[n, 0], pairs[n, 1]
            elif count == 0 or (k >= 0 and not lower[k] < best):
                continue
            else:  # the pair with the least bound first
                m = k if k >= 0 else least
                i, j = candidates[m, 0], candidates[m, 1]
            best = _closer(question, nearest, room, n, i, j, best)
        if not one_pair:
            _ask_clouds(question, nearest, room, n, best)


@njit(merge=True)
def _closer(
    question: DistanceQuestion,
    nearest: NearestPairs,
    room: DistanceState,
    n: int,
    i: int,
    number: int,
    best: float,
) -> float:
    """Write the distance of a pair if it is the least so far in state n; return the least."""
    bodies, cores, vectors = question.checked.bodies, room.cores, nearest.vectors
    j = body_at(bodies, question.checked.clouds, number)
    if j != number and question.boxes:
        for k in range(3):
            cores.centers[j, k] = bodies.centers[j, k]
    near = body_distance(cores, i, cores, j, ZERO, best, room.polytope)
    room.plane[0], room.plane[1], room.plane[2] = near.normal
    room.plane[3] = near.lower
    if not (question.one_pair or near.lower < best):
        return best
    nearest.bounds[n, 0], nearest.bounds[n, 1] = near.lower, near.upper
    nearest.pairs[n, 0], nearest.pairs[n, 1] = i, number
    for m in range(3):
        vectors[n, 0, m], vectors[n, 1, m] = near.a[m], near.b[m]
        vectors[n, 2, m] = near.normal[m]
    return near.lower


@njit(merge=True)
def _ask_clouds(
    question: DistanceQuestion, nearest: NearestPairs, room: DistanceState, n: int, best: float
) -> None:
    """Write the least distance from clouds, if it is the least in state n.

    The ball nearest to the box of a body first, then all whose distance from it is less.
    """
    checked, placed = question.checked, room.placed
    bodies, tests, clouds = checked.bodies, checked.tests, checked.clouds
    count, balls = len(bodies.frames), placed.balls
    for c in range(len(clouds.bodies)):
        j = clouds.bodies[c]
        for k in range(tests.first):
            i = tests.first - 1 - k
            if len(tests.allowed) and tests.allowed[i, j - tests.first]:
                continue
            box = placed_box(bodies, placed, i)
            error = slack_of(bodies, i, box.center) + LINK_PLACING * bodies.reaches[j]
            slack, waiting = bodies.spheres[j] + error, placed.waiting
            if balls_near(clouds, c, box, best + slack, True, waiting, balls, ZERO, np.inf) == 0:
                continue
            ball = balls[0]
            best = _closer(question, nearest, room, n, i, count + ball, best)
            # the body is behind a plane across the normal, and balls ahead of it are farther
            normal = room.plane[0], room.plane[1], room.plane[2]
            far = dot(normal, ball_center(clouds, c, ball)) + best - room.plane[3] + 4.0 * error
            found = balls_near(clouds, c, box, best + slack, False, waiting, balls, normal, far)
            for m in range(found):
                if balls[m] != ball:
                    best = _closer(question, nearest, room, n, i, count + balls[m], best)


@njit(refcount=False)
def _all_candidates(tests: Tests, candidates: Integers) -> int:
    """Write all pairs, those of robots' bodies first; return their number."""
    own, count = len(tests.pairs), len(tests.order)
    for m in range(own):
        candidates[m, 0], candidates[m, 1] = tests.pairs[m, 0], tests.pairs[m, 1]
    for m in range(tests.first * count):
        candidates[own + m, 0], candidates[own + m, 1] = m // count, tests.first + m % count
    return own + tests.first * count


@njit(refcount=False)
def _bound_all(
    bodies: LinkBodies, tests: Tests, placed: Placed, spheres: Floats, count: int, lower: Floats
) -> int:
    """Write lower bounds of the distances of candidates; return the number of the least one.

    They are infinite for pairs that do not count.
    """
    least = 0
    for m in range(count):
        i, j = placed.candidates[m, 0], placed.candidates[m, 1]
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
        least = m if lower[m] < lower[least] else least
    return least


@njit
def _cores(checked: Checked, boxes: bool) -> Cores:
    """Return bodies, or their boxes, as ``Cores``; those of the world are placed already.

    Boxes are larger by the roundings of kinematics. Balls of clouds stay balls.
    """
    bodies, balls = checked.bodies, checked.clouds.bodies
    count = len(bodies.frames)
    cores = Cores(
        np.full(count, BOX_CORE if boxes else HULL_CORE, np.int8),
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
    for c in range(len(balls) if boxes else 0):
        j = balls[c]
        cores.sizes[j, 0] = cores.sizes[j, 1] = cores.sizes[j, 2] = 0.0
        cores.radii[j] = bodies.rounds[j] + LINK_PLACING * bodies.reaches[j]
    return cores


@njit(refcount=False)
def _place_core(bodies: LinkBodies, placed: Placed, i: int, cores: Cores, boxes: bool) -> None:
    """Place the hull of body i, or its box, in a state."""
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
    """Return the distances of pairs (m, 2) of bodies, or of their boxes, in states (m, joints)."""
    count = len(pairs)
    bounds, vectors = np.empty((count, 2)), np.empty((count, 3, 3))
    question, output = (boxes, True, states, limit), (bounds, pairs.copy(), vectors)
    run(distances_kernel, count, FEWEST_PAIRS, prepared.held, question, output)
    return PairDistances(bounds[:, 0], bounds[:, 1], vectors)


@njit
def _name_pairs(
    scene: tuple[Integers, Floats, Floats], nearest: tuple[Floats, Integers, Floats], curved: bool
) -> None:
    """Replace pairs of bodies by rows of names, and move points to the frame of the scene.

    scene: the owners and the excess of bodies, and the origin. curved: whether to make upper bounds
    those of curved shapes, which are smaller than their hulls.
    """
    (owners, excess, origin), (bounds, pairs, vectors) = scene, nearest
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
    """Return the least distance up to a limit in states (n, joints), or that of every pair."""
    if not self_pairs:
        prepared = prepared.without_self_pairs
    ask = _all_distances if every else _least_distances
    rows, (bounds, numbers, vectors) = ask(prepared, accuracy, states, limit)
    bodies = prepared.bodies_at(numbers)
    gradients = _gradients(prepared, states[rows], bodies, vectors) if jacobian else None
    scene = prepared.checked.owners, prepared.excess, prepared.world.origin
    _name_pairs(scene, (bounds, bodies, vectors), bool(accuracy >= Accuracy.HULL))
    if every:  # the nearest bodies of each pair of names
        order = np.lexsort([bounds[:, 0], bodies[:, 1], bodies[:, 0], rows])
        keys = np.column_stack([rows, bodies])[order]
        first = np.ones(len(order), np.bool_)
        first[1:] = (keys[1:] != keys[:-1]).any(axis=1)
        kept = order[first]
        rows, bodies = rows[kept], bodies[kept]
        bounds, vectors = bounds[kept], vectors[kept]
        gradients = None if gradients is None else gradients[kept]
    pairs = bodies, vectors[:, :2], vectors[:, 2]
    return StateDistances(bounds[:, 0], bounds[:, 1], *pairs, prepared.names, rows, gradients)


def distance_rates(
    prepared: Prepared, accuracy: Accuracy, state: Floats, velocities: Floats, limit: float
) -> tuple[Floats, Integers, Floats]:
    """Return the distances (m,) up to a limit in a state (1, joints) of all pairs of bodies.

    And the rows (m, 2) of their names, and the rates (m,), m/s, at which they grow while joints
    move at velocities (joints,). Each ball of a cloud is a pair of its own.
    """
    _, (bounds, numbers, vectors) = _all_distances(prepared, accuracy, state, limit)
    states = np.repeat(state, len(numbers), axis=0)
    gradients = _gradients(prepared, states, prepared.bodies_at(numbers), vectors)
    return bounds[:, 0], prepared.owners_of(numbers), gradients @ velocities


def _gradients(prepared: Prepared, states: Floats, bodies: Integers, vectors: Floats) -> Floats:
    """Return the gradients (m, joints) of the distances of pairs (m, 2) in states (m, joints)."""
    checked = prepared.checked
    frames = np.append(checked.bodies.frames, 0)[bodies]  # any frame if there is no pair
    points, along = np.ascontiguousarray(vectors[:, :2]), np.ascontiguousarray(vectors[:, 2])
    places = prepared.own.driven, frames, points, along
    return distance_gradients(checked.tree, np.ascontiguousarray(states), *places)


def _least_distances(
    prepared: Prepared, accuracy: Accuracy, states: Floats, limit: float
) -> tuple[Rows, NearestPairs]:
    """Return the least distance in each state."""
    count = len(states)
    vectors = np.empty((count, 3, 3))
    vectors.fill(np.nan)
    nearest = NearestPairs(np.empty((count, 2)), np.empty((count, 2), np.int64), vectors)
    question = bool(accuracy < Accuracy.HULL), False, states, limit
    run(distances_kernel, count, FEWEST_DISTANCES, prepared.held, question, tuple(nearest))
    if accuracy == Accuracy.MESH:
        _decide_meshes(prepared, states, limit, nearest)
    return np.arange(count), nearest


def _all_distances(
    prepared: Prepared, accuracy: Accuracy, states: Floats, limit: float
) -> tuple[Rows, NearestPairs]:
    """Return the distances of all pairs of bodies within a limit."""
    level = Accuracy.OBB if accuracy < Accuracy.HULL else Accuracy.HULL
    rows, pairs = all_pairs(prepared, level, states, prepared.within(np.full(1, limit)))
    near = np.ascontiguousarray(states[rows])
    bounds = hull_distances(prepared, near, pairs, limit, boxes=bool(accuracy < Accuracy.HULL))
    if accuracy == Accuracy.MESH:
        set_mesh_distances(prepared, near, pairs, bounds, limit, depths=True)
    kept = bounds.lower < limit
    lower_upper = np.column_stack([bounds.lower[kept], bounds.upper[kept]])
    return rows[kept], NearestPairs(lower_upper, pairs[kept], bounds.vectors[kept])


def _decide_meshes(prepared: Prepared, states: Floats, limit: float, nearest: NearestPairs) -> None:
    """Replace the least distances of hulls, and their pairs, by those of meshes."""
    rows = np.flatnonzero(nearest.pairs[:, 0] >= 0)
    states, first = np.ascontiguousarray(states[rows]), nearest.pairs[rows]
    lower, upper = nearest.bounds[rows].T.copy()
    best = PairDistances(lower, upper, nearest.vectors[rows])
    set_mesh_distances(prepared, states, first, best, limit, depths=True)
    reach = np.clip(best.lower, 0.0, limit) * GROWTH
    numbers, pairs = all_pairs(prepared, Accuracy.HULL, states, prepared.within(reach))
    others = (pairs != first[numbers]).any(axis=1)
    numbers, pairs = numbers[others], pairs[others]
    hulls = hull_distances(prepared, states[numbers], pairs, limit)
    order = np.lexsort([hulls.lower, numbers])
    ranks = np.arange(len(order)) - np.searchsorted(numbers[order], numbers[order])
    for rank in range(int(ranks.max(initial=-1)) + 1):  # a pair of each state, by its bound
        again = order[ranks == rank]
        again = again[hulls.lower[again] < best.lower[numbers[again]]]
        if len(again) == 0:
            continue
        closer = PairDistances(*(values[again] for values in hulls))
        near = np.ascontiguousarray(states[numbers[again]])
        set_mesh_distances(prepared, near, pairs[again], closer, limit, depths=True)
        less = closer.lower < best.lower[numbers[again]]
        places = numbers[again[less]]
        first[places] = pairs[again[less]]
        for values, new in zip(best, closer, strict=True):
            values[places] = new[less]
    beyond = ~(best.lower < limit)
    best.lower[beyond] = best.upper[beyond] = np.inf
    best.vectors[beyond], first[beyond] = np.nan, -1
    nearest.pairs[rows], nearest.vectors[rows] = first, best.vectors
    nearest.bounds[rows] = np.column_stack([best.lower, best.upper])


def distance_gradients(
    tree: Tree, states: Floats, driven: Mask, frames: Rows, points: Floats, directions: Floats
) -> Floats:
    """Return the gradients (m, joints) of distances by the joints, in states (m, joints).

    A distance along a direction n changes by n times the difference of the velocities of the
    closest points. To first order it does not matter that these move on their links.
    driven: of ``OwnBodies``; frames (m, 2): those of the points (m, 2, 3); directions (m, 3):
    from the first to the second point, NaN for none.
    """
    gradients = np.zeros(states.shape)
    question = tree, driven, states, frames, points, directions
    run(_fill_gradients, len(states), FEWEST_GRADIENTS, *question, gradients)
    for link in np.flatnonzero(tree.kinds >= PLANAR).tolist():
        _add_free(*question, link, gradients)
    return gradients


@njit
def _fill_gradients(
    tree: Tree, driven: Mask, states: Floats, frames: Rows, points: Floats, directions: Floats,
    gradients: Floats, start: int, stop: int,
) -> None:  # fmt: skip
    """Write the gradients by the first variable of each joint."""
    poses, identity = np.empty((1, len(tree.parents), 7)), (0.0, 0.0, 0.0, 1.0)
    for n in range(start, stop):
        along = vector_at(directions, n)
        if np.isnan(along[0]):
            gradients[n] = np.nan
            continue
        place_links(tree, states, n, poses, 0)
        for link in range(len(tree.parents)):
            first, second = driven[frames[n, 0], link], driven[frames[n, 1], link]
            if first == second:  # the joint moves both points, or none
                continue
            parent, turn = tree.parents[link], identity
            if parent >= 0:
                x, y = poses[0, parent, 3], poses[0, parent, 4]
                turn = x, y, poses[0, parent, 5], poses[0, parent, 6]
            rate = along
            if tree.kinds[link] < PRISMATIC:
                p, q = points[n, 1 if second else 0], poses[0, link]
                rate = cross((p[0] - q[0], p[1] - q[1], p[2] - q[2]), along)
            change = dot(components(rotation_of(turn), vector_at(tree.directions, link)), rate)
            sign = 1.0 if second else -1.0
            gradients[n, tree.columns[link]] += sign * tree.multipliers[link] * change


def _add_free(
    tree: Tree, driven: Mask, states: Floats, frames: Rows, points: Floats, directions: Floats,
    link: int, gradients: Floats,
) -> None:  # fmt: skip
    """Add the gradients by all but the first variable of a planar or floating joint."""
    poses, parent, column = link_poses(tree, states), tree.parents[link], tree.columns[link]
    moved = driven[frames, link].astype(np.float64) * (-1.0, 1.0)  # (m, 2)
    force = moved[:, :, None] * directions[:, None]
    turning = np.cross(points - poses[:, link, None, :3], force).sum(axis=1)
    along = force.sum(axis=1)
    identity = np.tile((0.0, 0.0, 0.0, 1.0), (len(states), 1))
    outer = poses[:, parent, 3:] if parent >= 0 else identity
    axis = rotate_vectors(outer, np.broadcast_to(tree.directions[link], along.shape))
    across = rotate_vectors(outer, np.broadcast_to(tree.across[link], along.shape))
    third = np.cross(axis, across)
    gradients[:, column + 1] += (across * along).sum(axis=1)
    if tree.kinds[link] == PLANAR:
        gradients[:, column + 2] += (third * turning).sum(axis=1)
        return
    gradients[:, column + 2] += (third * along).sum(axis=1)
    frame = multiply_quaternions(outer, np.broadcast_to(tree.rotations[link], outer.shape))
    _add_turns(states[:, column + 3 : column + 7], frame, turning, gradients[:, column + 3 :])


def _add_turns(quaternions: Floats, frame: Floats, turning: Floats, out: Floats) -> None:
    """Add the gradients by quaternions (m, 4), which kinematics normalises, in frames (m, 4)."""
    lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
    units = quaternions / lengths
    back = units * (-1.0, -1.0, -1.0, 1.0)
    for k in range(4):
        change = (np.eye(4)[k] - units * units[:, k : k + 1]) / lengths
        rate = 2.0 * multiply_quaternions(change, back)[:, :3]
        out[:, k] += (rotate_vectors(frame, rate) * turning).sum(axis=1)
