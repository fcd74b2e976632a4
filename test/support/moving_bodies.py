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

"""Convex bodies that move: families of pairs, and where they are at a time, in long doubles."""

from __future__ import annotations

import numpy as np
from convex_bodies import Pair, corners_of, family
from numpy.typing import NDArray
from sweep_motions import Twisting

from obb_collision.queries.convex.support import BOX, CORNERS, SEGMENT, ConvexBodies
from obb_collision.queries.sweep import BodyMotion
from obb_collision.typing import Floats, Integers

Long = NDArray[np.longdouble]
#: How they move: angles (rad) over the whole time, of which each body has one.
TURNS = {"straight": [0.0], "turning": [0.0, 1e-9, 0.1, 3.0], "fast": [20.0, 60.0]}


def joined(pair: Pair) -> ConvexBodies:
    """Return the bodies of both, one after the other."""
    a, b = (vars(x) for x in pair)
    columns = {key: np.concatenate([a[key], b[key]]) for key in a if key != "hulls"}
    return ConvexBodies(hulls=pair[0].hulls, **columns)


def radii_of(bodies: ConvexBodies) -> Floats:
    """Return the radii (n,) of spheres about the origins of bodies that hold them."""
    radii = np.hypot(
        np.hypot(bodies.sizes[:, 0], bodies.sizes[:, 1]), bodies.sizes[:, 2] + bodies.sizes[:, 3]
    )
    for n in np.flatnonzero(np.isin(bodies.kinds, (CORNERS, BOX, SEGMENT))).tolist():
        corners = corners_of(bodies, n)
        radii[n] = np.hypot(np.hypot(corners[:, 0], corners[:, 1]), corners[:, 2]).max()
    return np.asarray((radii + bodies.radii) * (1.0 + 1e-14))


def moving(
    name: str, kinds: tuple[str, str], count: int, seed: int, way: str
) -> tuple[ConvexBodies, BodyMotion, Integers]:
    """Return bodies of a family that approach each other, their motion, and the pairs of it."""
    pair = family(name, kinds, count, seed)
    bodies, rng = joined(pair), np.random.default_rng(seed + 1)
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
    """Return the origins (m, 3) and rotations (m, 3, 3) of bodies at a time each.

    By quaternions, where the library has Rodrigues' formula.
    """
    time = times.astype(np.longdouble)[:, None]
    turn = motion.turns[rows].astype(np.longdouble) * time
    angle = np.sqrt((turn * turn).sum(axis=1))[:, None]
    axis = np.divide(turn, angle, out=np.zeros_like(turn), where=angle > 0)
    x, y, z = (axis * np.sin(angle / 2)).T
    w = np.cos(angle / 2)[:, 0]
    matrix = np.empty((len(rows), 3, 3), np.longdouble)
    matrix[:, 0] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], 1)
    matrix[:, 1] = np.stack([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], 1)
    matrix[:, 2] = np.stack([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], 1)
    arms = np.einsum("nij,nj->ni", matrix, motion.arms[rows].astype(np.longdouble))
    pivots = motion.starts[rows] + motion.ends[rows].astype(np.longdouble) * time
    rotations = np.einsum("nij,njk->nik", matrix, motion.rotations[rows].astype(np.longdouble))
    return pivots + arms, rotations
