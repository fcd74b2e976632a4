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

"""The effect ``sweep`` above OBB: the sweeps of shapes, from where those of boxes end.

A shape is in its box and moves with it, so a pair of boxes that does not touch is done, and no
impact at a finer level is before that at a coarser one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NamedTuple, TypeAlias

import numpy as np

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.boxes import Boxes
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.queries.convex.support import ConvexBodies
from obb_collision.queries.meshes.placed import PlacedMeshes
from obb_collision.queries.sweep.convex import BodyMotion, convex_sweeps
from obb_collision.queries.sweep.meshes import join_motions, swept_mesh_bodies, swept_meshes
from obb_collision.queries.sweep.motion import OUTWARD, bounding_radii
from obb_collision.queries.sweep.moving import MovingBoxes
from obb_collision.queries.sweep.sweep import Sweeps
from obb_collision.scene.broad_phase.broad_phase import Pairs
from obb_collision.scene.effects.base import Cycle, Setting, take_rows
from obb_collision.scene.refinement.placed_shapes import PlacedShapes
from obb_collision.typing import Floats, Mask, Rows


class Ride(NamedTuple):
    """Motion of the boxes of slots (n,), and what is fixed to them with them."""

    slots: Rows  #: sorted
    moving: MovingBoxes
    now: Boxes  #: of the slots; their bodies are where they are at a check
    pivots: Floats  #: (n, 3) at the beginning: points fixed to the boxes that move straight


Swept: TypeAlias = "Callable[[PlacedShapes, Cycle, Ride, Pairs, Floats, float], Sweeps]"


def refined_sweeps(
    found: Sweeps, cycle: Cycle, ride: Ride, pairs: Pairs, setting: Setting
) -> Sweeps:
    """Return the sweeps of pairs (m, 2) of slots with those of shapes; found: of their boxes."""
    touching = np.flatnonzero(found.hits | found.undecided)
    some = cycle.levels(pairs[touching], setting, max(BY_LEVEL))
    if some is None or cycle.shapes is None:
        return found
    levels = np.full(len(pairs), np.int8(Accuracy.OBB))
    levels[touching] = some
    found = take_rows(found, np.arange(len(pairs)))  # to be written to
    duration = ride.moving.duration
    for level, compute in BY_LEVEL.items():
        rows = np.flatnonzero((levels >= level) & (found.hits | found.undecided))
        if len(rows) == 0:
            continue
        begin = found.free_until[rows] / duration * (1.0 - 4.0 * ROUNDOFF)
        tolerance = setting.values["tolerance"]
        new = compute(cycle.shapes, cycle, ride, pairs[rows], begin, tolerance)
        free = np.maximum(new.free_until * duration, found.free_until[rows])
        times = np.where(new.undecided, np.nan, free)
        new = replace(new, pairs=found.pairs[rows], free_until=free, times=times)
        for key, column in vars(found).items():
            column[rows] = vars(new)[key]
    return found


def motion_of(bodies: Boxes, rows: Rows, ride: Ride) -> BodyMotion:
    """Return the motion of bodies fixed to boxes ``rows`` of a ride, where they are at a check.

    bodies: their places, and any extents.
    """
    motion = ride.moving.motion
    arms = bodies.centers - ride.now.centers[rows]
    rotations = bodies.rotations
    if motion.seconds == 0.0:  # the check is the end of the motion
        back = motion.rotations[rows] @ ride.now.rotations[rows].transpose(0, 2, 1)
        arms, rotations = np.einsum("nij,nj->ni", back, arms), back @ rotations
    boxes = motion.starts[rows] - ride.pivots[rows]
    reaches = motion.radii[rows] + bounding_radii(boxes)
    return BodyMotion(
        ride.pivots[rows], motion.ends[rows], motion.seconds, rotations, motion.turns[rows],
        arms + boxes, motion.radii[rows], reaches * OUTWARD,
    )  # fmt: skip


def hull_sweeps(
    shapes: PlacedShapes, cycle: Cycle, ride: Ride, pairs: Pairs, begin: Floats, tolerance: float
) -> Sweeps:
    """Return the sweeps of pairs on HULL."""
    bodies, i, j = shapes.bodies(cycle.boxes, pairs)
    rows = np.searchsorted(ride.slots, np.unique(pairs))
    places = Boxes.trusted(bodies.centers, bodies.rotations, bodies.sizes[:, :3])
    motion = motion_of(places, rows, ride)
    return convex_sweeps(bodies, motion, np.column_stack([i, j]), begin, tolerance)


def triangle_sweeps(
    shapes: PlacedShapes, cycle: Cycle, ride: Ride, pairs: Pairs, begin: Floats, tolerance: float
) -> Sweeps:
    """Return the sweeps of pairs on MESH, with a mesh on at least one side.

    Round shapes are exact.
    """
    table = take_rows(NO_SWEEPS, np.zeros(len(pairs), np.int64))
    plain, some = shapes.round_sides(cycle.boxes, pairs)
    for rows, turned, a, radii_a, b, radii_b in shapes.sides(cycle.boxes, pairs[plain]):
        own = plain[rows]
        ends = np.where(turned[:, None], pairs[own, ::-1], pairs[own])
        motion = _motions(a, b, ends, ride)
        found = swept_meshes(a, radii_a, b, radii_b, motion, begin[own], tolerance)
        _fill(table, own, turned, found)
    if some is not None:
        motion = _motions(some.meshes, some.bodies, some.ends, ride)
        bodies = some.meshes, some.radii, some.bodies
        found = swept_mesh_bodies(*bodies, motion, begin[some.rows], tolerance)
        _fill(table, some.rows, some.turned, found)
    return table


def _motions(
    a: PlacedMeshes, b: PlacedMeshes | ConvexBodies, ends: Pairs, ride: Ride
) -> BodyMotion:
    """Return the motion of the bodies of slots (k, 2), those of b behind those of a."""
    first, second = (
        motion_of(
            Boxes.trusted(body.centers, body.rotations, body.centers),
            np.searchsorted(ride.slots, slots),
            ride,
        )
        for body, slots in zip((a, b), ends.T, strict=True)
    )
    return join_motions(first, second)


def _fill(table: Sweeps, rows: Rows, turned: Mask, found: Sweeps) -> None:
    """Write rows (k,) of a table; turned (k,): where a was the second of the pair."""
    found.normals[turned] *= -1.0
    for key, column in vars(table).items():
        column[rows] = vars(found)[key]


NO_SWEEPS = Sweeps(
    np.zeros((1, 2), np.int64), *np.zeros((2, 1), np.bool_), *np.zeros((2, 1)), *np.zeros((2, 1, 3))
)
BY_LEVEL: Mapping[Accuracy, Swept] = {
    Accuracy.HULL: hull_sweeps,
    Accuracy.MESH: triangle_sweeps,
}
