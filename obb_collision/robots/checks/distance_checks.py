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

"""The least distance in each state: the kernel of ``distances`` called, and what it finds named."""

from __future__ import annotations

import numpy as np

from obb_collision._threads import run
from obb_collision.robots.checks.distances import distances_kernel
from obb_collision.robots.checks.model import Model
from obb_collision.robots.checks.reports import StateDistances
from obb_collision.scene.scene import Scene
from obb_collision.typing import Floats

#: States with distances below which a second thread does not pay.
FEWEST_DISTANCES = 8


def least_distances(
    model: Model, scene: Scene, states: Floats, limit: float, self_pairs: bool
) -> StateDistances:
    """Return the least distance up to a limit in each state (n, joints)."""
    arrays = model.arrays(scene)
    tests = arrays.tests
    if not self_pairs:
        tests = tests._replace(pairs=np.empty((0, 2), np.int64))
    count = len(states)
    bounds, bodies = np.empty((count, 2)), np.empty((count, 2), np.int64)
    vectors = np.full((count, 3, 3), np.nan)
    run(
        *(distances_kernel, count, FEWEST_DISTANCES, arrays.tree, arrays.bodies, tests),
        *(states, limit, bounds, bodies, vectors),
    )
    vectors[:, :2] += model.origin
    swapped = arrays.owners[bodies[:, 0]] > arrays.owners[bodies[:, 1]]
    vectors[swapped, :2] = vectors[swapped, 1::-1]
    vectors[swapped, 2] *= -1.0
    return StateDistances(
        bounds[:, 0], bounds[:, 1], arrays.owners_of(bodies), vectors[:, :2], vectors[:, 2],
        arrays.names,
    )  # fmt: skip
