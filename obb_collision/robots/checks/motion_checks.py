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

"""Checks of motions: by kernels, and where hulls collide by meshes: conservative advancement.

At a time up to which a motion is free, the distance of each pair over its largest speed (see
``motions``) is a time for which it stays free; the least of all pairs is added. Only pairs whose
hulls are near enough to collide within a horizon are looked at, and no farther than that is added.
It ends where the pair that is reached first is within the resolution, or touches.
"""

from __future__ import annotations

import numpy as np

from obb_collision._threads import run
from obb_collision.accuracy import Accuracy
from obb_collision.robots.checks.arrays import PairValues
from obb_collision.robots.checks.distances import hull_distances
from obb_collision.robots.checks.meshes import set_mesh_distances
from obb_collision.robots.checks.model import Prepared
from obb_collision.robots.checks.motions import (
    BOUND_GROWTH,
    PROBES,
    FirstHits,
    Motions,
    joint_reaches,
    motions_kernel,
    speeds_kernel,
)
from obb_collision.robots.checks.reports import MotionReport
from obb_collision.robots.checks.states import all_pairs, check_states
from obb_collision.robots.kinematics.kinematics import FIXED, PRISMATIC
from obb_collision.typing import Floats, Integers, Mask, Rows

#: The first horizon, of what is left of a motion; it grows where nothing is near.
FIRST_HORIZON = 0.125
#: A horizon over the time that was found free before.
GROWTH = 4.0
#: Rounds after which what is not free is undecided.
MOST_STEPS = 2000
#: What is left of a time when it is rounded.
SHORTER = 1.0 - 1e-9
#: Motions below which a second thread does not pay, for checks and for speeds.
FEWEST_MOTIONS, FEWEST_SPEEDS = 4, 64


def check_motions(
    prepared: Prepared, accuracy: Accuracy, starts: Floats, ends: Floats, resolution: float
) -> MotionReport:
    """Return which motions from starts to ends (n, joints) are valid."""
    checked, count = prepared.checked, len(starts)
    motions = Motions(starts, ends, reaches_of(prepared, starts, ends))
    parameters, undecided, pairs = hits = FirstHits(
        np.empty(count), np.empty(count, np.bool_), np.empty((count, 2), np.int64)
    )
    level = int(accuracy)
    run(motions_kernel, count, FEWEST_MOTIONS, checked, level, motions, resolution, hits)
    if accuracy == Accuracy.MESH:
        rows = np.flatnonzero(pairs[:, 0] >= 0)
        moves = MeshMotions(
            prepared, motions._replace(starts=starts[rows], ends=ends[rows]), parameters[rows]
        )
        moves.advance(resolution)
        pairs[rows], free = moves.pairs, moves.pairs[:, 0] < 0
        undecided[rows] = ~free & ~moves.collide
        parameters[rows] = np.where(free, np.nan, moves.times)
    out = prepared.limits.exceeded(starts) | prepared.limits.exceeded(ends)
    return MotionReport(parameters, undecided, out, prepared.owners_of(pairs), prepared.names)


def reaches_of(prepared: Prepared, starts: Floats, ends: Floats) -> Floats:
    """Return ``Motions.reaches`` of motions from starts to ends (n, joints)."""
    bodies, first = prepared.checked.bodies, prepared.checked.tests.first
    moved = np.zeros(starts.shape[1])
    for states in (starts, ends):
        moved = np.maximum(moved, np.abs(states).max(axis=0, initial=0.0))
    extents = np.linalg.norm(bodies.centers[:first], axis=1) + bodies.spheres[:first]
    return joint_reaches(prepared.checked.tree, bodies.frames[:first], extents, moved)


def displacements(prepared: Prepared, states: Floats, deviations: Floats) -> Floats:
    """Return (n,) how far any point of a body moves at most if joints do by deviations (n, j).

    states (m, joints): between which joints are; no joint may be planar or floating.
    """
    reaches, tree = reaches_of(prepared, states, states), prepared.checked.tree
    moved = np.zeros((len(deviations), len(reaches)))
    for link, (kind, column) in enumerate(zip(tree.kinds, tree.columns, strict=True)):
        if kind == FIXED:
            continue
        by = np.abs(tree.multipliers[link] * deviations[:, column])[:, None]
        reach = np.where(kind == PRISMATIC, 1.0, reaches[:, link])
        moved += np.where(reaches[:, link] >= 0.0, by * reach, 0.0)
    largest: Floats = moved.max(axis=1, initial=0.0) * BOUND_GROWTH
    return largest


class MeshMotions:
    """Motions (n,) that are free up to times (n,)."""

    def __init__(self, prepared: Prepared, motions: Motions, times: Floats) -> None:
        self._prepared, self._checked, self._motions = prepared, prepared.checked, motions
        self.times, count = times, len(times)
        self.pairs = np.full((count, 2), -1)
        self.collide = np.zeros(count, np.bool_)
        self._horizons = FIRST_HORIZON * (1.0 - times)
        own, pairs = self._checked.tests.first, self._checked.tests.pairs
        self._speeds = PairValues(np.empty((count, own)), np.empty((count, len(pairs))))
        run(speeds_kernel, count, FEWEST_SPEEDS, self._checked, motions, self._speeds)
        self._columns = np.zeros((own, own), np.int64)
        self._columns[pairs[:, 0], pairs[:, 1]] = np.arange(len(pairs))

    def advance(self, resolution: float) -> None:
        """Set how far motions are free, and the pairs that end those that are not all the way."""
        rows, steps = np.arange(len(self.times)), 0
        while len(rows):
            rows, steps = self._step(rows, resolution, steps >= MOST_STEPS), steps + 1
        stopped = np.flatnonzero((self.pairs[:, 0] >= 0) & ~self.collide)
        self.collide[stopped] = self._collide_after(stopped, resolution)

    def _step(self, rows: Rows, resolution: float, is_last: bool) -> Rows:
        """Go on with motions (k,); return those that neither ended nor are free.

        is_last: whether those end, too, that something is near to.
        """
        times = self.times[rows]
        spans = np.minimum(self._horizons[rows], 1.0 - times)
        numbers, pairs, lower, speeds = self._near(rows, spans)
        with np.errstate(divide="ignore", invalid="ignore"):
            free = np.where(lower <= 0.0, 0.0, lower / speeds)
        order = np.lexsort([free, numbers])
        found, places = np.unique(numbers[order], return_index=True)
        first = order[places]  # the pair that is reached first
        steps = np.full(len(rows), np.inf)
        steps[found] = free[first] * SHORTER
        clear = steps >= spans
        late = np.where(clear, times + spans, times + steps)
        ended = np.zeros(len(rows), np.bool_)
        ended[found] = is_last | (lower[first] <= resolution)
        ended |= late <= times  # it moves too fast for any time to be free
        ended &= ~clear
        stop = ended[found]
        self.pairs[rows[found[stop]]] = pairs[first[stop]]
        self.collide[rows[found[stop]]] = lower[first[stop]] <= 0.0
        self.times[rows] = np.where(ended, times, late)
        self._horizons[rows] = np.where(clear, 2.0 * spans, GROWTH * steps)
        return rows[~ended & ~(clear & (late >= 1.0))]

    def _near(self, rows: Rows, spans: Floats) -> tuple[Rows, Integers, Floats, Floats]:
        """Return the pairs of motions that may collide within spans (k,) from their times.

        Numbers (m,) among the motions, pairs (m, 2), distances (m,) and speeds (m,).
        """
        states = self._states(rows, self.times[rows])
        near = PairValues(
            *(
                np.where(spans[:, None] > 0.0, spans[:, None] * speeds[rows], 0.0)
                for speeds in self._speeds
            )
        )
        numbers, pairs = all_pairs(self._checked, Accuracy.HULL, states, near)
        i, j = np.ascontiguousarray(pairs.T)
        own, some = j < self._checked.tests.first, rows[numbers]
        speeds = self._speeds.bodies[some, i]
        speeds[own] = self._speeds.pairs[some[own], self._columns[i[own], j[own]]]
        limit = float((speeds * spans[numbers]).max(initial=0.0))
        states = np.ascontiguousarray(states[numbers])
        found = hull_distances(self._checked, states, pairs, limit)
        set_mesh_distances(self._prepared, states, pairs, found, limit, depths=False)
        return numbers, pairs, np.where(found.upper > 0.0, found.lower, 0.0), speeds

    def _states(self, rows: Rows, times: Floats) -> Floats:
        starts, ends, _ = self._motions
        return np.asarray(starts[rows] + times[:, None] * (ends[rows] - starts[rows]))

    def _collide_after(self, rows: Rows, resolution: float) -> Mask:
        """Return whether states of motions (k,) collide soon after their times."""
        collide = np.zeros(len(rows), np.bool_)
        fastest = np.maximum(*(speeds[rows].max(axis=1, initial=0.0) for speeds in self._speeds))
        steps = np.divide(resolution, fastest, out=np.ones(len(rows)), where=fastest > 0.0)
        for probe in range(PROBES):
            times = self.times[rows] + steps * (2.0**probe)
            left = np.flatnonzero(~collide & (times <= 1.0))
            if len(left) == 0:
                break
            states = self._states(rows[left], times[left])
            found = check_states(self._prepared, Accuracy.MESH, states, False)
            collide[left] = found.colliding
        return collide
