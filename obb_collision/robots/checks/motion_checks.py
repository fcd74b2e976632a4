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

"""Which motions are valid: the kernel of ``motions`` called, and what it finds named."""

from __future__ import annotations

import numpy as np

from obb_collision._threads import run
from obb_collision.accuracy import Accuracy
from obb_collision.robots.checks.mesh_motions import MeshMotions
from obb_collision.robots.checks.model import Model
from obb_collision.robots.checks.motions import motions_kernel
from obb_collision.robots.checks.reports import MotionReport
from obb_collision.scene.scene import Scene
from obb_collision.typing import Floats

#: Motions below which a second thread does not pay: each takes many states.
FEWEST_MOTIONS = 4


def check_motions(
    model: Model, scene: Scene, accuracy: Accuracy, starts: Floats, ends: Floats, resolution: float
) -> MotionReport:
    """Return which motions from starts to ends (n, joints) are valid."""
    arrays = model.arrays(scene)
    count = len(starts)
    parameters, undecided = np.empty(count), np.empty(count, np.bool_)
    pairs = np.empty((count, 2), np.int64)
    reaches = model.joint_reaches(arrays, starts, ends)
    run(
        *(motions_kernel, count, FEWEST_MOTIONS, arrays.tree, arrays.bodies, arrays.tests),
        *(int(accuracy), reaches, starts, ends, resolution, parameters, undecided, pairs),
    )
    if accuracy == Accuracy.MESH:
        rows = np.flatnonzero(pairs[:, 0] >= 0)
        moves = MeshMotions(model, scene, reaches, starts[rows], ends[rows], parameters[rows])
        moves.advance(resolution)
        pairs[rows], free = moves.pairs, moves.pairs[:, 0] < 0
        undecided[rows] = ~free & ~moves.collide
        parameters[rows] = np.where(free, np.nan, moves.times)
    return MotionReport(
        parameters, undecided, model.out_of_limits(starts) | model.out_of_limits(ends),
        arrays.owners_of(pairs), arrays.names,
    )  # fmt: skip
