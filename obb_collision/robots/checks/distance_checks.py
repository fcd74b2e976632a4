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

"""The least distance in each state: the kernel of ``distances`` called, and what it finds named.

Up to "obb_tree" it is that of boxes, at "hull" of hulls. At "mesh" hulls bound distances from
below: pairs are looked at in the order of these bounds, until none is less than what was found.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from obb_collision._threads import run
from obb_collision.accuracy import Accuracy
from obb_collision.robots.checks.distances import distances_kernel
from obb_collision.robots.checks.meshes import PairDistances, hull_distances, set_mesh_distances
from obb_collision.robots.checks.model import Arrays, Model
from obb_collision.robots.checks.reports import StateDistances
from obb_collision.robots.checks.state_checks import all_pairs
from obb_collision.scene.scene import Scene
from obb_collision.typing import Floats, Integers, Rows

#: States with distances below which a second thread does not pay.
FEWEST_DISTANCES = 8
#: Relative growth of distances: more than the roundings of what is compared with them.
GROWTH = 1.0 + 1e-9


def least_distances(
    model: Model, scene: Scene, accuracy: Accuracy, states: Floats, limit: float, self_pairs: bool
) -> StateDistances:
    """Return the least distance up to a limit in each state (n, joints)."""
    arrays = model.arrays(scene)
    if not self_pairs:
        none = np.empty((0, 2), np.int64)
        arrays = replace(arrays, tests=arrays.tests._replace(pairs=none))
    count = len(states)
    bounds, bodies = np.empty((count, 2)), np.empty((count, 2), np.int64)
    vectors = np.full((count, 3, 3), np.nan)
    run(
        *(distances_kernel, count, FEWEST_DISTANCES, arrays.tree, arrays.bodies, arrays.tests),
        *(int(accuracy) < Accuracy.HULL, states, limit, bounds, bodies, vectors),
    )
    if accuracy == Accuracy.MESH:
        found = PairDistances(bounds[:, 0], bounds[:, 1], vectors)
        _decide_meshes(model, scene, arrays, states, limit, found, bodies)
    if accuracy >= Accuracy.HULL:  # of the shapes, not of the prisms around them
        bounds[:, 1] += np.append(arrays.bodies.excess, 0.0)[bodies].sum(axis=1)
    vectors[:, :2] += model.origin
    swapped = arrays.owners[bodies[:, 0]] > arrays.owners[bodies[:, 1]]
    vectors[swapped, :2] = vectors[swapped, 1::-1]
    vectors[swapped, 2] *= -1.0
    return StateDistances(
        bounds[:, 0], bounds[:, 1], arrays.owners_of(bodies), vectors[:, :2], vectors[:, 2],
        arrays.names,
    )  # fmt: skip


def _decide_meshes(
    model: Model, scene: Scene, arrays: Arrays, states: Floats, limit: float,
    found: PairDistances, bodies: Integers,
) -> None:  # fmt: skip
    """Write the least distances of meshes, and their pairs (n, 2), over those of hulls."""
    rows = np.flatnonzero(bodies[:, 0] >= 0)
    some, first = np.ascontiguousarray(states[rows]), bodies[rows]
    best = PairDistances(*(values[rows] for values in found))
    set_mesh_distances(model, scene, some, first, best, limit, depths=True)
    reach = np.clip(best.lower, 0.0, limit) * GROWTH
    ends = arrays.tests.first, len(arrays.tests.pairs)
    grown = [np.repeat(reach[:, None], end, axis=1) for end in ends]
    numbers, pairs = all_pairs(arrays, Accuracy.HULL, some, *grown)
    others = (pairs != first[numbers]).any(axis=1)
    numbers, pairs = numbers[others], pairs[others]
    hulls = hull_distances(arrays, some[numbers], pairs, limit)
    for these in _rounds(numbers, hulls.lower):
        near = these[hulls.lower[these] < best.lower[numbers[these]]]
        if len(near) == 0:
            continue
        each = PairDistances(*(values[near] for values in hulls))
        given = np.ascontiguousarray(some[numbers[near]])
        set_mesh_distances(model, scene, given, pairs[near], each, limit, depths=True)
        less = each.lower < best.lower[numbers[near]]
        places = numbers[near[less]]
        first[places] = pairs[near[less]]
        for values, new in zip(best, each, strict=True):
            values[places] = new[less]
    beyond = ~(best.lower < limit)
    best.lower[beyond] = best.upper[beyond] = np.inf
    best.vectors[beyond], first[beyond] = np.nan, -1
    bodies[rows] = first
    for values, new in zip(found, best, strict=True):
        values[rows] = new


def _rounds(numbers: Rows, lower: Floats) -> list[Rows]:
    """Return rows of pairs: in the first round the one with the least bound of each state, ..."""
    order = np.lexsort([lower, numbers])
    places = np.arange(len(order)) - np.searchsorted(numbers[order], numbers[order])
    return [order[places == place] for place in range(int(places.max(initial=-1)) + 1)]
