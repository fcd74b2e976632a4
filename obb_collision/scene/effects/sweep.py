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

"""The effect ``sweep``: collisions between two checks, and collisions ahead.

Between the check before and this one every box moves from its pose then to its pose now. Pairs that
are apart at both, but not in between, are *passed*. From now on objects with a twist keep it over
the horizon, the others stand still; pairs that meet by then are *predicted*. Pairs that collide now
are in the report itself. Between checks the centre of a box moves straight; ahead it turns about
the origin of its pose, as the twist says. Pairs that may or may not meet are *undecided*: a caller
who must not miss a collision treats them as colliding from then on.

Above OBB the shapes are swept, fixed to these boxes, from the time at which the boxes meet: no
impact on a finer level is before that on a coarser one. Thin shapes may be in thick boxes, so there
every motion is swept, however short.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple, TypeAlias

import numpy as np

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.boxes import BoxArrays, Boxes
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.numerics.vec3 import lengths
from obb_collision.queries.convex.support import ConvexBodies
from obb_collision.queries.meshes.placed import PlacedMeshes
from obb_collision.queries.sweep.convex_convex import BodyMotion, convex_sweeps
from obb_collision.queries.sweep.mesh_body import swept_meshes
from obb_collision.queries.sweep.motion import (
    OUTWARD,
    MovingBoxes,
    bounding_radii,
    joined_motions,
    moved_between,
    sweep_needed,
    swept_bounds,
    twist_bounds,
)
from obb_collision.queries.sweep.sweep import LEAST_TOLERANCE, TOLERANCE, Sweeps, box_sweeps
from obb_collision.scene.broad_phase.broad_phase import NO_PAIRS, Pairs
from obb_collision.scene.effects.base import (
    ACCURACY,
    ACCURACY_OPTION,
    OBB,
    Cycle,
    Effect,
    Option,
    Outcome,
    PreviousCheck,
    Setting,
    isolated,
    meeting_pairs,
    take_rows,
    write_rows,
)
from obb_collision.scene.refinement.clouds import (
    CloudPairs,
    by_level,
    is_cloud_pair,
    least_of,
)
from obb_collision.scene.refinement.placed_shapes import PlacedShapes
from obb_collision.scene.store.region import balls_near
from obb_collision.typing import Floats, Mask, Rows


class BoxMotions(NamedTuple):
    """Motions of the boxes of slots (n,), and of the shapes fixed to these boxes."""

    slots: Rows  #: sorted
    moving: MovingBoxes
    now: Boxes  #: of the slots, at this check
    pivots: Floats  #: (n, 3) start of the points of the boxes that move straight
    minimum: Floats  #: (n, 3) corners of bounds that contain each motion
    maximum: Floats


Swept: TypeAlias = "Callable[[PlacedShapes, Cycle, BoxMotions, Pairs, Floats, float], Sweeps]"


def refined_sweeps(
    sweeps: Sweeps, cycle: Cycle, motions: BoxMotions, pairs: Pairs, setting: Setting
) -> Sweeps:
    """Replace the sweeps of boxes by sweeps of shapes, for pairs (m, 2) above OBB or of clouds."""
    shapes = cycle.shapes
    if shapes is None:
        return sweeps
    touching = np.flatnonzero(sweeps.hits | sweeps.undecided)
    high = cycle.levels(pairs[touching], setting, max(BY_LEVEL))
    clouds = is_cloud_pair(shapes.kinds, pairs)
    if high is None and not clouds[touching].any():
        return sweeps
    levels = np.full(len(pairs), np.int8(Accuracy.OBB))
    if high is not None:
        levels[touching] = high
    sweeps = take_rows(sweeps, np.arange(len(pairs)))  # a copy, to write to
    duration = motions.moving.duration
    tolerance = setting.values["tolerance"]

    def compute_rows(rows: Rows, compute: Swept) -> None:
        begin = sweeps.free_until[rows] / duration * (1.0 - 4.0 * ROUNDOFF)
        new = compute(shapes, cycle, motions, pairs[rows], begin, tolerance)
        free = np.maximum(new.free_until * duration, sweeps.free_until[rows])
        times = np.where(new.undecided, np.nan, free)
        new = replace(new, pairs=sweeps.pairs[rows], free_until=free, times=times)
        write_rows(sweeps, rows, new)

    for portion in shapes.nearest_first(cycle.boxes, pairs, levels):
        part = portion[~clouds[portion]]
        for level, compute in BY_LEVEL.items():
            rows = part[(levels[part] >= level) & (sweeps.hits[part] | sweeps.undecided[part])]
            if len(rows):
                compute_rows(rows, compute)
    of_clouds = touching[clouds[touching]]
    for level, of_level in by_level(shapes.reached(pairs, levels)[of_clouds]):
        compute_rows(of_clouds[of_level], partial(cloud_sweeps, level))
    return sweeps


def motion_of(bodies: PlacedMeshes | ConvexBodies, slots: Rows, motions: BoxMotions) -> BodyMotion:
    """Return the motion of bodies at a check, fixed to the boxes of slots."""
    rows, motion = np.searchsorted(motions.slots, slots), motions.moving.arrays
    arms = bodies.centers - motions.now.centers[rows]
    rotations = bodies.arrays.rotations
    if motion.seconds == 0.0:  # the check is the end of the motion
        back = motion.rotations[rows] @ motions.now.rotations[rows].transpose(0, 2, 1)
        arms, rotations = np.einsum("nij,nj->ni", back, arms), back @ rotations
    boxes = motion.starts[rows] - motions.pivots[rows]
    reaches = motion.radii[rows] + bounding_radii(boxes)
    return BodyMotion(
        motions.pivots[rows], motion.ends[rows], motion.seconds, rotations, motion.turns[rows],
        arms + boxes, motion.radii[rows], reaches * OUTWARD,
    )  # fmt: skip


def hull_sweeps(
    shapes: PlacedShapes,
    cycle: Cycle,
    motions: BoxMotions,
    pairs: Pairs,
    begin: Floats,
    tolerance: float,
) -> Sweeps:  # fmt: skip
    """Return the sweeps of pairs on HULL."""
    bodies, i, j = shapes.bodies(cycle.boxes, pairs)
    motion = motion_of(bodies, np.unique(pairs), motions)
    return convex_sweeps(bodies, motion, np.column_stack([i, j]), begin, tolerance)


def triangle_sweeps(
    shapes: PlacedShapes,
    cycle: Cycle,
    motions: BoxMotions,
    pairs: Pairs,
    begin: Floats,
    tolerance: float,
) -> Sweeps:  # fmt: skip
    """Return the sweeps of pairs on MESH, with a mesh on at least one side.

    Round shapes are exact.
    """
    table = take_rows(NO_SWEEPS, np.zeros(len(pairs), np.int64))
    for sides in shapes.exact_sides(cycle.boxes, pairs):
        first, second = sides.ends.T
        motion = joined_motions(
            motion_of(sides.a, first, motions), motion_of(sides.b, second, motions)
        )
        bodies = sides.a, sides.radii_a, sides.b, sides.radii_b
        sweeps = swept_meshes(*bodies, motion, begin[sides.rows], tolerance)
        sweeps.normals[sides.turned] *= -1.0
        write_rows(table, sides.rows, sweeps)
    return table


def cloud_sweeps(
    level: Accuracy,
    shapes: PlacedShapes,
    cycle: Cycle,
    motions: BoxMotions,
    pairs: Pairs,
    begin: Floats,
    tolerance: float,
) -> Sweeps:
    """Return when the first ball of each cloud meets the other object, on its level."""
    clouds = shapes.cloud_pairs(cycle.boxes, pairs)
    balls = clouds.balls_about(*_swept_boxes(clouds, motions))
    table = take_rows(NO_SWEEPS, np.zeros(len(pairs), np.int64))
    table.times[:] = table.free_until[:] = np.inf
    table.positions[:] = table.normals[:] = np.nan
    slots, i = np.unique(clouds.others[balls.rows], return_inverse=True)
    own, begin = clouds.clouds[balls.rows], begin[balls.rows]
    if len(balls.rows) == 0:
        return table
    if level == Accuracy.MESH:
        meshes, radii = clouds.meshes(slots[i])
        motion = motion_of(meshes, slots[i], motions), motion_of(balls.bodies, own, motions)
        bodies = meshes, radii, balls.bodies, None
        sweeps = swept_meshes(*bodies, joined_motions(*motion), begin, tolerance)
    else:
        both = clouds.with_balls(slots, level, balls)
        rows = np.column_stack([i, len(slots) + np.arange(len(i))])
        turned = motion_of(both, np.append(slots, own), motions)
        sweeps = convex_sweeps(both, turned, rows, begin, tolerance)
    met = np.flatnonzero(sweeps.hits | sweeps.undecided)
    first = met[least_of(balls.rows[met], sweeps.free_until[met])]
    rows, sweeps = balls.rows[first], take_rows(sweeps, first)
    sweeps.normals[clouds.turned[rows]] *= -1.0
    write_rows(table, rows, sweeps)
    return table


def _swept_boxes(clouds: CloudPairs, motions: BoxMotions) -> tuple[BoxArrays, Floats]:
    """Return bounds of the motions of the other objects, and how far (m,) points of clouds move."""
    rows, motion = np.searchsorted(motions.slots, clouds.others), motions.moving.arrays
    low, high = motions.minimum[rows], motions.maximum[rows]
    middle = 0.5 * low + 0.5 * high
    halves = np.nextafter(np.maximum(high - middle, middle - low), np.inf)
    around = BoxArrays(middle, np.tile(np.eye(3), (len(rows), 1, 1)), halves)
    own = np.searchsorted(motions.slots, clouds.clouds)
    starts, ends, seconds = motion.starts[own], motion.ends[own], motion.seconds
    ways = lengths(seconds * ends if seconds else ends - starts)
    reaches = motion.radii[own] + lengths(motion.arms[own])
    return around, (ways + lengths(motion.turns[own]) * reaches) * OUTWARD


NO_SWEEPS = Sweeps(
    np.zeros((1, 2), np.int64), *np.zeros((2, 1), np.bool_), *np.zeros((2, 1)), *np.zeros((2, 1, 3))
)
BY_LEVEL: Mapping[Accuracy, Swept] = {Accuracy.HULL: hull_sweeps, Accuracy.MESH: triangle_sweeps}


BLANK = Sweeps(NO_PAIRS, *np.empty((2, 0), np.bool_), *np.empty((2, 0)), *np.empty((2, 0, 3)))
NOTHING = Outcome(BLANK, 0)


@dataclass(frozen=True, eq=False)
class SweptPairs:
    """The ``Sweeps`` of pairs that hit or are undecided, sorted.

    passed: since the check before; times are fractions of the step, 0 then and 1 now. predicted:
    times are seconds from now.
    """

    passed: Sweeps
    predicted: Sweeps


class SweepEffect(Effect):
    """Continuous collision between checks, and prediction by twists."""

    name = "sweep"
    description = "Collisions between the last two states, and predicted collisions"
    options: Mapping[str, Option] = {
        "horizon": Option(
            1.0, 0.0, 3600.0, "Time for which twists are extrapolated (s). 0: no prediction."
        ),
        "tolerance": Option(
            TOLERANCE,
            LEAST_TOLERANCE,
            1.0,
            "Turning boxes closer than this fraction of the smaller radius count as touching.",
        ),
        ACCURACY: ACCURACY_OPTION,
    }
    lazy = False

    def run(self, cycle: Cycle, setting: Setting) -> Outcome:
        """Find passed and predicted collisions of objects that move far enough."""
        behind, ahead = _passed(cycle, setting), _predicted(cycle, setting)
        result = SweptPairs(behind.result, ahead.result)
        pairs = np.concatenate([behind.result.pairs, ahead.result.pairs])
        return Outcome(
            *(result, behind.count + ahead.count, behind.failures + ahead.failures),
            accuracies=cycle.levels(pairs, setting, max(BY_LEVEL)),
        )


def _passed(cycle: Cycle, setting: Setting) -> Outcome:
    before = cycle.before
    if before is None:
        return NOTHING
    count = min(len(before.enabled), len(cycle.enabled))
    same = cycle.enabled[:count] & before.enabled[:count]
    same &= cycle.store.born[:count] == before.born[:count]
    same &= (cycle.boxes.half_extents[:count] == before.boxes.half_extents[:count]).all(axis=1)
    slots = _passing(cycle, before, np.flatnonzero(same))
    start, end = before.boxes[slots], cycle.boxes[slots]
    needed = sweep_needed(start, end)
    selected = needed if cycle.shapes is None else moved_between(start, end)
    if setting.selected is not None:
        selected &= setting.selected[slots]
    if not selected.any():
        return NOTHING
    bounds = swept_bounds(start, end)
    pairs = meeting_pairs(cycle, slots, *bounds, selected)
    pairs = pairs[~_among(pairs, cycle.pairs, len(cycle.enabled))]
    motions = BoxMotions(slots, MovingBoxes(start, end), end, start.centers, *bounds)
    outcome = _swept(cycle, motions, pairs, setting)
    result = outcome.result
    begun = result.undecided | (result.times > 0.0)
    far = needed[np.searchsorted(slots, result.pairs)].any(axis=1)
    levels = cycle.levels(result.pairs, setting, max(BY_LEVEL))
    smaller = np.zeros(len(result.pairs), np.bool_)  # than their boxes
    if cycle.shapes is not None:
        smaller |= is_cloud_pair(cycle.shapes.kinds, result.pairs)
    if levels is not None:
        smaller |= levels > OBB
    if smaller.any():  # shapes may have been near enough, but apart
        far |= smaller
        then = before.pairs  # colliding pairs, of any region
        if before.poses is not None and cycle.shapes is not None:
            then = cycle.shapes.colliding_at(before.boxes, before.poses, result.pairs)
        begun |= smaller & ~_among(result.pairs, then, len(cycle.enabled))
    # the others collided before, and were reported then
    return replace(outcome, result=take_rows(result, begun & far))


def _predicted(cycle: Cycle, setting: Setting) -> Outcome:
    horizon = setting.values["horizon"]
    moving = cycle.enabled & cycle.store.twists.any(axis=1)
    if horizon == 0.0 or not moving.any():
        return NOTHING
    part = cycle.active | _coming(cycle, moving, horizon)
    selected = part & moving
    if setting.selected is not None:
        selected &= setting.selected
    if not selected.any():
        return NOTHING
    slots = np.flatnonzero(part)
    boxes, twists = cycle.boxes[slots], cycle.store.twists[slots]
    origins = cycle.store.poses[slots, :3]
    bounds = twist_bounds(boxes, twists, origins, horizon)
    pairs = meeting_pairs(cycle, slots, *bounds, selected[slots])
    pairs = pairs[~_among(pairs, cycle.pairs, len(cycle.enabled))]
    moved = MovingBoxes.from_twists(boxes, twists, horizon, origins=origins)
    return _swept(cycle, BoxMotions(slots, moved, boxes, origins, *bounds), pairs, setting)


def _passing(cycle: Cycle, before: PreviousCheck, slots: Rows) -> Rows:
    """Return the slots, among (n,), that may have come near the region on their way."""
    if cycle.region is None:
        return slots
    extents, starts, ends = cycle.boxes.half_extents, before.boxes.centers, cycle.boxes.centers
    elsewhere = slots[~cycle.active[slots]]
    middles = 0.5 * starts[elsewhere] + 0.5 * ends[elsewhere]
    ways = lengths(0.5 * ends[elsewhere] - 0.5 * starts[elsewhere])
    near = balls_near(cycle.region, middles, lengths(extents[elsewhere]) + ways)
    kept = cycle.active.copy()
    kept[elsewhere[near]] = True
    return slots[kept[slots]]


def _coming(cycle: Cycle, moving: Mask, horizon: float) -> Mask:
    """Return (slots,) which moving objects elsewhere may come near the region."""
    coming = np.zeros(len(moving), np.bool_)
    if cycle.region is not None:
        slots = np.flatnonzero(moving & ~cycle.active)
        origins, boxes = cycle.store.poses[slots, :3], cycle.boxes[slots]
        around = lengths(boxes.centers - origins) + lengths(boxes.arrays.half_extents)
        ways = horizon * lengths(cycle.store.twists[slots, :3])
        coming[slots] = balls_near(cycle.region, origins, around + ways)
    return coming


def _among(pairs: Pairs, others: Pairs, slots: int) -> Mask:
    """Return which pairs (k, 2) are among others."""
    keys, other_keys = (p[:, 0] * slots + p[:, 1] for p in (pairs, others))
    return np.isin(keys, other_keys)


def _swept(cycle: Cycle, motions: BoxMotions, pairs: Pairs, setting: Setting) -> Outcome:
    """Sweep pairs (k, 2) of slots."""
    rows = np.searchsorted(motions.slots, pairs)

    def query(row_pairs: Pairs) -> Sweeps:
        tolerance = setting.values["tolerance"]
        sweeps = box_sweeps(motions.moving, motions.moving, row_pairs, tolerance=tolerance)
        return refined_sweeps(sweeps, cycle, motions, motions.slots[row_pairs], setting)

    def name(row: int) -> str:
        return cycle.name(int(motions.slots[row]))

    good, sweeps, failures = isolated(query, rows, BLANK, name)
    kept = sweeps.hits | sweeps.undecided
    result = replace(take_rows(sweeps, kept), pairs=pairs[good[kept]])
    return Outcome(result, len(rows), failures)


EFFECT: Effect = SweepEffect()
