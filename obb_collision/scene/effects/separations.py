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

"""The effect ``separations``: how deep each colliding pair is, along which axis, and where."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from obb_collision.geometry.boxes import Boxes
from obb_collision.queries.verdict.penetration import witness_kernel
from obb_collision.scene.broad_phase.broad_phase import Pairs
from obb_collision.scene.effects.base import Cycle, Option, Outcome, Setting, Table, pair_rows

BLANK: Table = (np.empty(0), *np.empty((2, 0, 3)))


class Separations:
    """Signed separations (k,), unit normals (k, 3) and a place (k, 3) of the colliding pairs."""

    name = "separations"
    options: Mapping[str, Option] = {}
    lazy = True

    def run(self, cycle: Cycle, setting: Setting) -> Outcome:
        """Compute the columns of ``Report.separations``, ``normals`` and ``points``."""
        return Outcome(*pair_rows(self.name, cycle, setting, _separations, BLANK))


def _separations(boxes: Boxes, pairs: Pairs) -> Table:
    columns = np.empty(len(pairs)), *np.empty((2, len(pairs), 3))
    witness_kernel(boxes.centers, boxes.rotations, boxes.half_extents, pairs, *columns)
    return columns
