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

"""Motions whose hulls collide, decided by meshes: conservative advancement.

At a time up to which a motion is free, the distance of each pair over its largest speed (see
``motions``) is a time for which it stays free; the least of all pairs is added. Only pairs whose
hulls are near enough to collide within a horizon are looked at, and no farther than that is added.
It ends where the pair that is reached first is within the resolution, or touches.
"""

from __future__ import annotations

import numpy as np

from obb_collision._threads import run
from obb_collision.accuracy import Accuracy
from obb_collision.robots.checks.meshes import hull_distances, set_mesh_distances
from obb_collision.robots.checks.model import Model
from obb_collision.robots.checks.motions import PROBES, speeds_kernel
from obb_collision.robots.checks.state_checks import all_pairs, check_states
from obb_collision.scene.scene import Scene
from obb_collision.typing import Floats, Integers, Mask, Rows

#: The first horizon, of what is left of a motion; it grows where nothing is near.
FIRST_HORIZON = 0.125
#: A horizon over the time that was found free before.
GROWTH = 4.0
#: Rounds after which what is not free is undecided.
MOST_STEPS = 2000
#: What is left of a time when it is rounded.
SHORTER = 1.0 - 1e-9
#: Motions below which a second thread does not pay for speeds.
FEWEST_MOTIONS = 64


class MeshMotions:
    """Motions from starts to ends (n, joints) that are free up to times (n,)."""

    def __init__(
        self, model: Model, scene: Scene, reaches: Floats, starts: Floats, ends: Floats,
        times: Floats,
    ) -> None:  # fmt: skip
        self._model, self._scene, self._arrays = model, scene, model.arrays(scene)
        self._starts, self._ends = starts, ends
        self.times = times
        self.pairs = np.full((len(times), 2), -1)
        self.collide = np.zeros(len(times), np.bool_)
        self._horizons = FIRST_HORIZON * (1.0 - times)
        tests = self._arrays.tests
        count, pairs = tests.first, tests.pairs
        self._speeds = np.empty((len(times), count)), np.empty((len(times), len(pairs)))
        run(
            *(speeds_kernel, len(times), FEWEST_MOTIONS, self._arrays.tree, tests, reaches),
            *(starts, ends, *self._speeds),
        )
        self._columns = np.zeros((count, count), np.int64)
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
        grown = [
            np.where(spans[:, None] > 0.0, spans[:, None] * speeds[rows], 0.0)
            for speeds in self._speeds
        ]
        numbers, pairs = all_pairs(self._arrays, Accuracy.HULL, states, *grown)
        i, j = np.ascontiguousarray(pairs.T)
        outside, some = j >= self._arrays.tests.first, rows[numbers]
        speeds = self._speeds[0][some, i]
        speeds[~outside] = self._speeds[1][some[~outside], self._columns[i[~outside], j[~outside]]]
        limit = float((speeds * spans[numbers]).max(initial=0.0))
        states = np.ascontiguousarray(states[numbers])
        found = hull_distances(self._arrays, states, pairs, limit)
        set_mesh_distances(self._model, self._scene, states, pairs, found, limit, depths=False)
        return numbers, pairs, np.where(found.upper > 0.0, found.lower, 0.0), speeds

    def _states(self, rows: Rows, times: Floats) -> Floats:
        starts = self._starts[rows]
        return np.asarray(starts + times[:, None] * (self._ends[rows] - starts))

    def _collide_after(self, rows: Rows, resolution: float) -> Mask:
        """Return whether states of motions (k,) collide soon after their times."""
        collide = np.zeros(len(rows), np.bool_)
        fastest = np.maximum(
            self._speeds[0][rows].max(axis=1, initial=0.0),
            self._speeds[1][rows].max(axis=1, initial=0.0),
        )
        steps = np.divide(resolution, fastest, out=np.ones(len(rows)), where=fastest > 0.0)
        for probe in range(PROBES):
            times = self.times[rows] + steps * (2.0**probe)
            left = np.flatnonzero(~collide & (times <= 1.0))
            if len(left) == 0:
                break
            states = self._states(rows[left], times[left])
            found = check_states(self._model, self._scene, Accuracy.MESH, states, False)
            collide[left] = found.colliding
        return collide
