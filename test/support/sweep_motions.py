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

"""Motions of boxes and convex bodies for tests of sweeps: families, and where they are at a time.

``MOTIONS[name](rng, n)`` gives start and end of n pairs, each as `Boxes` of 2 n rows: pair k is
rows 2 k and 2 k + 1. ``TURNING`` are those in which something turns.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from convex_bodies import CORNER_SIGNS, corners_of, family, moved
from numpy.typing import NDArray

from obb_collision import Boxes
from obb_collision.queries.convex.support import BOX_CORE, HULL_CORE, SEGMENT_CORE, ConvexBodies
from obb_collision.queries.sweep import BodyMotion
from obb_collision.typing import Floats, Integers
from tools.cases.placement import log_uniform, random_rotations, turns

Rng = np.random.Generator
Array = np.ndarray
Motion = tuple[Boxes, Boxes]


def pair_rows(n: int) -> Array:
    return np.arange(2 * n).reshape(-1, 2)


def mixed(a: Array, b: Array) -> Array:
    """Rows of a and b in turn."""
    return np.stack([a, b], axis=1).reshape(2 * len(a), *a.shape[1:])


def motion(
    start: tuple[Array, Array], end: tuple[Array, Array], rot: tuple[Array, Array],
    turned: tuple[Array, Array] | None, half: tuple[Array, Array],
) -> Motion:  # fmt: skip
    """Boxes from centers, rotations at the start and by which they turn, half extents."""
    first = mixed(*rot)
    last = first if turned is None else mixed(*turned) @ first
    extents = mixed(*half)
    return Boxes(mixed(*start), first, extents), Boxes(mixed(*end), last, extents)


def directions(rng: Rng, n: int) -> Array:
    vectors = rng.normal(size=(n, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def turn(rng: Rng, angles: Array) -> Array:
    return turns(directions(rng, len(angles)), angles)


def ordinary(rng: Rng, n: int) -> Motion:
    """Boxes of 0.1 to 1 m that cross a small room and turn by any angle."""
    centers = rng.uniform(-1.5, 1.5, (4, n, 3))
    half = rng.uniform(0.05, 0.5, (2, n, 3))
    turned = turn(rng, rng.uniform(0.0, 3.1, n)), turn(rng, rng.uniform(0.0, 3.1, n))
    rot = random_rotations(rng, n), random_rotations(rng, n)
    return motion((centers[0], centers[1]), (centers[2], centers[3]), rot, turned, tuple(half))


def bullets(rng: Rng, n: int) -> Motion:
    """Small boxes that fly and tumble up to 1000 m at walls of a hundredth of a millimetre."""
    wall = np.column_stack([log_uniform(rng, -5.0, -2.0, n), *rng.uniform(1.0, 3.0, (2, n))])
    bullet = log_uniform(rng, -3.0, -1.0, (n, 3))
    rot = random_rotations(rng, n)
    way = directions(rng, n) * log_uniform(rng, 0.0, 3.0, (n, 1))
    share = rng.random((n, 1))
    target = np.einsum("nij,nj->ni", rot, rng.uniform(-1.2, 1.2, (n, 3)) * wall)
    still = np.zeros((n, 3))
    angles = rng.uniform(0.0, 0.2, n) * rng.integers(0, 2, n), rng.uniform(0.0, 3.1, n)
    turned = turn(rng, angles[0]), turn(rng, angles[1])
    return motion((still, target - share * way), (still, target + (1.0 - share) * way),
                  (rot, random_rotations(rng, n)), turned, (wall, bullet))  # fmt: skip


def blades(rng: Rng, n: int) -> Motion:
    """Long blades side by side that spin by up to pi, nearly or wholly."""
    half = np.array([1.0, 0.05, 0.02]) * rng.uniform(0.5, 1.5, (n, 1))
    apart = directions(rng, n) * rng.uniform(0.02, 2.2, (n, 1))
    still = np.zeros((n, 3))
    almost = np.pi * (1.0 - log_uniform(rng, -9.0, 0.0, n))
    turned = turn(rng, almost), turn(rng, rng.uniform(0.0, 3.1, n))
    rot = random_rotations(rng, n), random_rotations(rng, n)
    return motion((still, apart), (0.05 * directions(rng, n), apart), rot, turned, (half, half))


def needles(rng: Rng, n: int) -> Motion:
    """Needles a thousand times as long as thick, turning and crossing."""
    half = np.column_stack([np.ones(n), *log_uniform(rng, -3.5, -2.0, (2, n))])
    start, end = rng.uniform(-0.7, 0.7, (2, n, 3)), rng.uniform(-0.7, 0.7, (2, n, 3))
    turned = turn(rng, rng.uniform(0.0, 2.0, n)), turn(rng, rng.uniform(0.0, 0.5, n))
    rot = random_rotations(rng, n), random_rotations(rng, n)
    return motion((start[0], start[1]), (end[0], end[1]), rot, turned, (half, half[:, [2, 0, 1]]))


def near(rng: Rng, n: int) -> Motion:
    """Boxes close to each other that move and turn a little: what a control cycle sees."""
    half = rng.uniform(0.05, 0.5, (2, n, 3))
    first = rng.uniform(-1.5, 1.5, (n, 3))
    second = first + rng.normal(size=(n, 3)) * 0.4
    moved = rng.normal(size=(2, n, 3)) * log_uniform(rng, -4.0, -1.0, (n, 1))
    turned = turn(rng, rng.uniform(0.0, 0.05, n)), turn(rng, log_uniform(rng, -12.0, -1.0, n))
    rot = random_rotations(rng, n), random_rotations(rng, n)
    end = first + moved[0], second + moved[1]
    return motion((first, second), end, rot, turned, tuple(half))


def resting(rng: Rng, n: int) -> Motion:
    """Boxes that start face to face, touching or a little apart, and slide, tilt or leave."""
    half = rng.integers(1, 17, (2, n, 3)) / 16.0
    rot = np.where(rng.random((n, 1, 1)) < 0.5, np.eye(3), random_rotations(rng, n))
    gap = rng.choice([0.0, 1e-9, 1e-5, 1e-3, 0.05], n)
    across = rng.uniform(-1.0, 1.0, (n, 3)) * half[0]
    across[:, 0] = half[0, :, 0] + half[1, :, 0] + gap
    second = np.einsum("nij,nj->ni", rot, across)
    way = np.einsum("nij,nj->ni", rot, rng.normal(size=(n, 3)) * rng.integers(0, 2, (n, 3)))
    turned = np.broadcast_to(np.eye(3), (n, 3, 3)), turn(rng, rng.uniform(0.0, 0.5, n))
    still = np.zeros((n, 3))
    return motion((still, second), (still, second + way), (rot, rot), turned, tuple(half))


def far_flights(rng: Rng, n: int) -> Motion:
    """Both fly a million metres and more, and meet on the way."""
    half = rng.uniform(0.05, 1.0, (2, n, 3))
    way = directions(rng, n) * log_uniform(rng, 3.0, 6.0, (n, 1))
    other = directions(rng, n) * log_uniform(rng, 0.0, 6.0, (n, 1))
    share = rng.random((n, 1))
    miss = rng.normal(size=(n, 3)) * 0.6
    turned = turn(rng, rng.uniform(0.0, 3.0, n)), turn(rng, rng.uniform(0.0, 3.0, n))
    start = -share * way, miss - share * other
    end = (1.0 - share) * way, miss + (1.0 - share) * other
    rot = random_rotations(rng, n), random_rotations(rng, n)
    return motion(start, end, rot, turned, tuple(half))


TURNING: dict[str, Callable[[Rng, int], Motion]] = {
    "ordinary": ordinary,
    "bullets at thin walls": bullets,
    "spinning blades": blades,
    "long needles": needles,
    "small motions, close together": near,
    "starting in contact": resting,
    "huge translations": far_flights,
}


class Twisting(NamedTuple):
    """n pairs of boxes that keep twists (2 n, 6) of their origins (2 n, 3), and for how long."""

    boxes: Boxes
    twists: Array
    origins: Array
    horizon: float


def twisting(
    centers: tuple[Array, Array], half: tuple[Array, Array], rot: tuple[Array, Array],
    linear: tuple[Array, Array], angular: tuple[Array, Array], arms: tuple[Array, Array],
    horizon: float,
) -> Twisting:  # fmt: skip
    """Pairs from what belongs to their first and second boxes."""
    boxes = Boxes(mixed(*centers), mixed(*rot), mixed(*half))
    twists = np.hstack([mixed(*linear), mixed(*angular)])
    return Twisting(boxes, twists, boxes.centers - mixed(*arms), horizon)


def spins(rng: Rng, n: int, turns: float) -> Array:
    """Angular velocities that give up to so many turns in a second."""
    return directions(rng, n) * (2.0 * np.pi * turns * rng.random((n, 1)))


def swinging(rng: Rng, n: int) -> Twisting:
    """Boxes beside their origins that cross a small room and go round them, up to a turn."""
    half = rng.uniform(0.05, 0.5, (2, n, 3))
    arms = directions(rng, n) * rng.uniform(0, 3, (n, 1)), directions(rng, n) * rng.random((n, 1))
    centers = rng.uniform(-1.5, 1.5, (2, n, 3))
    rot = random_rotations(rng, n), random_rotations(rng, n)
    linear = rng.normal(size=(n, 3)), rng.normal(size=(n, 3))
    angular = spins(rng, n, 1.0), spins(rng, n, 1.0) * rng.integers(0, 2, (n, 1))
    return twisting(tuple(centers), tuple(half), rot, linear, angular, arms, 1.0)


def carousels(rng: Rng, n: int) -> Twisting:
    """Small boxes on long arms that pass posts millimetres inside or outside of their circle."""
    arm = np.column_stack([log_uniform(rng, -1.0, 1.5, n), np.zeros((n, 2))])
    half = log_uniform(rng, -3.5, -2.0, (2, n, 3))
    angle = rng.uniform(0.1, 2.0 * np.pi, n)
    ring = arm[:, 0] + rng.normal(size=n) * half.max(axis=(0, 2)) * 1.5
    post = np.column_stack([ring * np.cos(angle), ring * np.sin(angle), np.zeros(n)])
    still = np.zeros((n, 3))
    rot = random_rotations(rng, n), random_rotations(rng, n)
    angular = np.column_stack([still[:, :2], log_uniform(rng, 0.0, 1.0, n)])
    return twisting((arm, post), tuple(half), rot, (still, still), (angular, still),
                    (arm, still), 3.0)  # fmt: skip


def fans(rng: Rng, n: int) -> Twisting:
    """Blades that turn up to 30 times beside walls that they just reach or just don't."""
    blade = np.array([0.5, 0.05, 0.01]) * rng.uniform(0.5, 1.0, (n, 3))
    wall = np.column_stack([log_uniform(rng, -3.0, -1.0, n), *rng.uniform(0.3, 3.0, (2, n))])
    reach = np.linalg.norm(blade[:, :2], axis=1)
    away = reach + wall[:, 0] + rng.choice([-0.05, -0.002, 0.002, 0.02, 0.1], n)
    side = np.column_stack([away, np.zeros((n, 2))])
    still, spin = np.zeros((n, 3)), 2.0 * np.pi * log_uniform(rng, 0.0, 1.5, n)
    drift = directions(rng, n) * log_uniform(rng, -3.0, 0.0, (n, 1)) * rng.integers(0, 2, (n, 1))
    lean = spins(rng, n, 0.02) * rng.integers(0, 2, (n, 1))
    arms = directions(rng, n) * 0.1 * rng.integers(0, 2, (n, 1)) * [1, 1, 0], still
    eyes = np.broadcast_to(np.eye(3), (n, 3, 3))
    return twisting((still, side), (blade, wall), (eyes, eyes), (drift, still),
                    (np.column_stack([still[:, :2], spin]), lean), arms, 1.0)  # fmt: skip


def spinners(rng: Rng, n: int) -> Twisting:
    """Rods that both turn many times, near each other or just out of reach."""
    half = np.array([1.0, 0.02, 0.02]) * rng.uniform(0.3, 1.0, (2, n, 1))
    apart = directions(rng, n) * rng.uniform(0.3, 2.5, (n, 1))
    still = np.zeros((n, 3))
    rot = random_rotations(rng, n), random_rotations(rng, n)
    angular = spins(rng, n, 20.0), spins(rng, n, 20.0)
    return twisting((still, apart), tuple(half), rot, (still, 0.1 * directions(rng, n)), angular,
                    (still, still), 1.0)  # fmt: skip


def shared_flight(rng: Rng, n: int) -> Twisting:
    """Boxes 1e7 m from the origin of the frame that fly at 1e6 m/s side by side, and meet."""
    near = swinging(rng, n)
    far, fast = 1e7 * directions(rng, 1), 1e6 * directions(rng, 1)
    boxes = Boxes(near.boxes.centers + far, near.boxes.rotations, near.boxes.half_extents)
    arms = near.boxes.centers - near.origins
    twists = near.twists + np.hstack([fast, np.zeros((1, 3))])
    straight = rng.random(n) < 0.3
    twists[np.repeat(straight, 2), 3:] = 0.0
    return Twisting(boxes, twists, boxes.centers - arms, 1.0)


def grains(rng: Rng, n: int) -> Twisting:
    """Boxes of a millimetre that tumble at each other from up to 100 km, 100 s away."""
    half = rng.uniform(2e-4, 1e-3, (2, n, 3))
    away = directions(rng, n) * log_uniform(rng, 0.0, 5.0, (n, 1))
    miss = rng.normal(size=(n, 3)) * 5e-4
    still = np.zeros((n, 3))
    rot = random_rotations(rng, n), random_rotations(rng, n)
    angular = spins(rng, n, 0.01), spins(rng, n, 0.01)
    arms = directions(rng, n) * 1e-3 * rng.integers(0, 2, (n, 1)), still
    speed = (miss - away) / rng.uniform(30.0, 90.0, (n, 1))
    return twisting((still, away), tuple(half), rot, (still, speed), angular, arms, 100.0)


def giants(rng: Rng, n: int) -> Twisting:
    """Crumbs of 10 micrometres on and beside slabs of a kilometre that turn."""
    slab = np.column_stack([log_uniform(rng, -3.0, 0.0, n), *rng.uniform(300.0, 1000.0, (2, n))])
    crumb = log_uniform(rng, -5.0, -3.0, (n, 3))
    gap = rng.choice([0.0, 1e-6, 1e-3, 0.1], n)
    place = np.column_stack([slab[:, 0] + np.linalg.norm(crumb, axis=1) + gap,
                             *rng.uniform(-250.0, 250.0, (2, n))])  # fmt: skip
    still = np.zeros((n, 3))
    eyes = np.broadcast_to(np.eye(3), (n, 3, 3))
    angular = spins(rng, n, 0.001), spins(rng, n, 1.0)
    return twisting((still, place), (slab, crumb), (eyes, random_rotations(rng, n)),
                    (still, 0.01 * directions(rng, n)), angular,
                    (100.0 * directions(rng, n), still), 1.0)  # fmt: skip


def drills(rng: Rng, n: int) -> Twisting:
    """Boxes that turn 1 to 100 times as they slide on a tilted plate and sink up to 5 cm into it.

    About a face's normal, the diagonal of a face or of all, of the plate or their own, or next to
    these; their centres are on the axis or beside it. A third stays above the plate.
    """
    plate = np.column_stack([log_uniform(rng, -3.0, -1.0, n), *rng.uniform(0.3, 1.5, (2, n))])
    half = log_uniform(rng, -2.0, -0.5, (n, 3))
    still, where = np.zeros((n, 3)), rng.random((6, n, 1, 1))
    rot = np.where(where[0] < 0.2, np.eye(3), random_rotations(rng, n))
    own = np.where(where[1] < 0.5, rot, random_rotations(rng, n))
    signs = rng.integers(-1, 2, (n, 3)) * np.where(where[2, :, 0] < 0.5, 1.0, half)
    signs[~signs.any(axis=1) | (where[3, :, 0, 0] < 0.4)] = [1.0, 0.0, 0.0]
    axis = np.einsum("nij,nj->ni", np.where(where[4] < 0.6, rot, own), signs)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    beside = rng.integers(0, 2, (2, n, 1))
    axis += directions(rng, n) * log_uniform(rng, -17.0, -1.0, (n, 1)) * beside[0]
    arms = directions(rng, n) * half.max(axis=1, keepdims=True)
    arms = np.where(where[5, :, 0] < 0.3, axis * arms[:, :1], arms) * beside[1]
    # how far below their origins they come, and so where they are above the plate
    corners = arms + np.einsum("nij,knj->kni", own, CORNER_SIGNS[:, None] * half)
    normal, unit = rot[:, :, 0], axis / np.linalg.norm(axis, axis=1, keepdims=True)
    rise, height = (normal * unit).sum(axis=1), (corners * unit).sum(axis=2)
    around = np.linalg.norm(corners - height[:, :, None] * unit, axis=2)
    reach = (around * np.linalg.norm(normal - rise[:, None] * unit, axis=1) - height * rise).max(0)
    sink = log_uniform(rng, -4.0, -1.3, n) * rng.choice([1.0, 1.0, -1.0], n)
    begin, end = rng.uniform(-0.9, 0.9, (2, n, 3)) * plate
    begin[:, 0] = plate[:, 0] + reach + np.maximum(log_uniform(rng, -4.0, -0.5, n), -sink)
    end[:, 0] = plate[:, 0] + reach - sink
    start, way = (np.einsum("nij,nj->ni", rot, v) for v in (begin, end - begin))
    times = 2.0 * np.pi * rng.choice([1.0, 1.6, 2.0, 5.0, 20.0, 50.0, 100.0], (2, n, 1))
    lean = normal * times[1] * (rng.random((n, 1)) < 0.2)
    return twisting((still, start + arms), (plate, half), (rot, own), (still, way),
                    (lean, axis * times[0]), (still, arms), 1.0)  # fmt: skip


TWISTING: dict[str, Callable[[Rng, int], Twisting]] = {
    "boxes beside their origins": swinging,
    "posts on the circle of an arm": carousels,
    "fans beside walls": fans,
    "rods that both spin": spinners,
    "far away, flying together": shared_flight,
    "grains from 100 km": grains,
    "crumbs and giants": giants,
    "drills beside tilted plates": drills,
}


Long = NDArray[np.longdouble]
#: How they move: angles (rad) over the whole time, of which each body has one.
TURNS = {"straight": [0.0], "turning": [0.0, 1e-9, 0.1, 3.0], "fast": [20.0, 60.0]}


def radii_of(bodies: ConvexBodies) -> Floats:
    """Return the radii (n,) of spheres about the origins of bodies that hold them."""
    radii = np.hypot(
        np.hypot(bodies.sizes[:, 0], bodies.sizes[:, 1]), bodies.sizes[:, 2] + bodies.sizes[:, 3]
    )
    for n in np.flatnonzero(np.isin(bodies.kinds, (HULL_CORE, BOX_CORE, SEGMENT_CORE))).tolist():
        corners = corners_of(bodies, n)
        radii[n] = np.hypot(np.hypot(corners[:, 0], corners[:, 1]), corners[:, 2]).max()
    return np.asarray((radii + bodies.radii) * (1.0 + 1e-14))


def moving(
    name: str, kinds: tuple[str, str], count: int, seed: int, way: str
) -> tuple[ConvexBodies, BodyMotion, Integers]:
    """Return bodies of a family that approach each other, their motion, and the pairs of it."""
    pair = family(name, kinds, count, seed)
    a, b = (vars(x) for x in pair)
    both = {key: np.concatenate([a[key], b[key]]) for key in a if key != "hulls"}
    bodies, rng = moved(pair[0], **both), np.random.default_rng(seed + 1)
    radii = radii_of(bodies)
    size = np.tile(radii.reshape(2, count).max(axis=0), 2)[:, None]
    size[size == 0.0] = 1.0  # points
    towards = pair[0].centers - pair[1].centers
    ways = rng.normal(size=(2 * count, 3)) * size * rng.choice([0.0, 0.3, 5.0], (2 * count, 1))
    # back first, so that what touches at the start comes from afar
    away = np.linalg.norm(towards / size[:count], axis=1, keepdims=True) * size[:count]
    unit = np.divide(towards, away, out=np.zeros_like(towards), where=away > 0.0)
    back = unit * size[:count] * rng.choice([0.0, 0.1, 3.0], (count, 1))
    ways[count:] = ways[:count] + back * 1.5 + towards * rng.choice([0.0, 0.5, 2.0], (count, 1))
    ways[count:] += rng.normal(size=(count, 3)) * size[:count] * rng.choice([0, 0.2], (count, 1))
    still = rng.random(2 * count) < 0.1
    ways[still] = 0.0
    bodies.centers[count:] -= back
    turns = rng.normal(size=(2 * count, 3)) * rng.choice(TURNS[way], (2 * count, 1))
    arms = rng.normal(size=(2 * count, 3)) * size * rng.choice([0.0, 1.0], (2 * count, 1))
    arms *= way != "straight"
    reaches = (radii + np.linalg.norm(arms / size, axis=1) * size[:, 0]) * (1.0 + 1e-14)
    pivots = bodies.centers - arms
    motion = BodyMotion(pivots, ways, 1.0, bodies.rotations, turns, arms, radii, reaches)
    rows = np.arange(count)
    return bodies, motion, np.stack([rows, count + rows], axis=1)


def motion_of_boxes(given: Twisting) -> BodyMotion:
    """Return the motion of boxes as that of any bodies, with time from 0 to 1."""
    boxes, arms = given.boxes, given.boxes.centers - given.origins
    radii = np.linalg.norm(boxes.half_extents, axis=1) * (1.0 + 1e-14)
    reaches = (radii + np.linalg.norm(arms, axis=1)) * (1.0 + 1e-14)
    ways = given.twists * given.horizon
    return BodyMotion(
        given.origins, ways[:, :3], 1.0, boxes.rotations, ways[:, 3:], arms, radii, reaches
    )


def places_at(motion: BodyMotion, rows: Integers, times: Floats) -> tuple[Long, Long]:
    """Return the origins (m, 3) and rotations (m, 3, 3) of bodies at a time each."""
    time = times.astype(np.longdouble)[:, None]
    matrix = turned_by(motion.turns[rows] * time)
    arms = np.einsum("nij,nj->ni", matrix, motion.arms[rows].astype(np.longdouble))
    pivots = motion.starts[rows] + motion.ends[rows].astype(np.longdouble) * time
    rotations = np.einsum("nij,njk->nik", matrix, motion.rotations[rows].astype(np.longdouble))
    return pivots + arms, rotations


def turned_by(vectors: Long) -> Long:
    """Return the matrices (m, 3, 3) of rotation vectors, in their precision.

    By quaternions, where the library has Rodrigues' formula.
    """
    angle = np.sqrt((vectors * vectors).sum(axis=1))[:, None]
    axis = np.divide(vectors, angle, out=np.zeros_like(vectors), where=angle > 0)
    x, y, z = (axis * np.sin(angle / 2)).T
    w = np.cos(angle / 2)[:, 0]
    matrix = np.empty((len(vectors), 3, 3), vectors.dtype)
    matrix[:, 0] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], 1)
    matrix[:, 1] = np.stack([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], 1)
    matrix[:, 2] = np.stack([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], 1)
    return matrix
