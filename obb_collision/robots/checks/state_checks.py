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

"""Which states are valid: the kernels of ``states`` called, and what they find named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from obb_collision._threads import run
from obb_collision.accuracy import Accuracy
from obb_collision.robots.checks.meshes import collide_as_meshes
from obb_collision.robots.checks.model import Arrays, Model
from obb_collision.robots.checks.reports import StatePairs, StateReport
from obb_collision.robots.checks.states import all_pairs_kernel, first_pairs_kernel
from obb_collision.scene.scene import Scene
from obb_collision.typing import Floats, Integers, Rows

#: States below which a second thread does not pay: 0.1 ms of them.
FEWEST_STATES = 64


def check_states(
    model: Model, scene: Scene, accuracy: Accuracy, states: Floats, every: bool
) -> StateReport:
    """Return which states (n, joints) are valid; every: with all colliding pairs."""
    arrays = model.arrays(scene)
    first = np.empty((len(states), 2), np.int64)
    run(
        *(first_pairs_kernel, len(states), FEWEST_STATES, arrays.tree, arrays.bodies),
        *(arrays.tests, int(accuracy), states, first),
    )
    report = StateReport(model.out_of_limits(states), arrays.owners_of(first), arrays.names)
    if accuracy in (Accuracy.OBB_TREE, Accuracy.MESH):
        found = _decide_meshes(model, scene, accuracy, states, np.flatnonzero(first[:, 0] >= 0))
        pairs = np.full_like(first, -1)
        rows, places = np.unique(found.states, return_index=True)
        pairs[rows] = found.pairs[places]
        return replace(report, first_pairs=pairs, all_pairs=found if every else None)
    if every:
        found = _named_pairs(arrays, *all_pairs(arrays, accuracy, states))
        report = replace(report, all_pairs=found)
    return report


def _decide_meshes(
    model: Model, scene: Scene, accuracy: Accuracy, states: Floats, rows: Rows
) -> StatePairs:
    """Return the pairs that collide as meshes, or as trees of boxes, in the states of rows."""
    arrays, some = model.arrays(scene), np.ascontiguousarray(states[rows])
    numbers, pairs = all_pairs(arrays, accuracy, some)
    kept = collide_as_meshes(model, scene, accuracy, some[numbers], pairs)
    return _named_pairs(arrays, rows[numbers[kept]], pairs[kept])


def all_pairs(
    arrays: Arrays, accuracy: Accuracy, states: Floats, grown: Floats | None = None,
    grown_pairs: Floats | None = None,
) -> tuple[Rows, Integers]:  # fmt: skip
    """Return the states (m,), ascending, of all pairs (m, 2) of bodies that may collide.

    grown (n, robots' bodies), grown_pairs (n, p): distances (m) within which a body and the world,
    or a pair, count as colliding; zero by default.
    """
    if grown is None or grown_pairs is None:
        grown = np.zeros((1, arrays.tests.first))
        grown_pairs = np.zeros((1, len(arrays.tests.pairs)))
    checks = arrays.tree, arrays.bodies, arrays.tests, int(accuracy), states, grown, grown_pairs
    counts = np.zeros(len(states), np.int64)
    none = np.empty((0, 2), np.int64)
    run(all_pairs_kernel, len(states), FEWEST_STATES, *checks, counts, counts, none)
    ends = np.cumsum(counts)
    pairs = np.empty((int(ends[-1]) if len(ends) else 0, 2), np.int64)
    run(all_pairs_kernel, len(states), FEWEST_STATES, *checks, counts, ends, pairs)
    return np.repeat(np.arange(len(states)), counts), pairs


def _named_pairs(arrays: Arrays, states: Rows, pairs: Integers) -> StatePairs:
    """Return pairs of bodies as those of links and objects, each once per state."""
    unique = np.unique(np.column_stack([states, arrays.owners_of(pairs)]), axis=0)
    return StatePairs(unique[:, 0], unique[:, 1:])
