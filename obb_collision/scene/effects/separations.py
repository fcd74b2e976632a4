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

from obb_collision.accuracy import Accuracy
from obb_collision.queries.verdict.verdict import Separations, pair_separations
from obb_collision.scene.broad_phase.broad_phase import NO_PAIRS
from obb_collision.scene.effects.base import (
    ACCURACY,
    ACCURACY_OPTION,
    ByLevel,
    Cycle,
    Effect,
    Option,
    Outcome,
    Setting,
    pair_rows,
)
from obb_collision.scene.effects.surfaces import hull_separations, triangle_separations

BLANK = Separations.blank(NO_PAIRS)


class SeparationsEffect(Effect):
    """The ``Separations`` of the colliding pairs, as far as they are selected for it."""

    name = "separations"
    description = (
        "Depth, normal and position of pairs in collisions and collisions_text, where off gives NaN"
    )
    options: Mapping[str, Option] = {ACCURACY: ACCURACY_OPTION}

    def run(self, cycle: Cycle, setting: Setting) -> Outcome:
        """Compute what ``Report.separations``, ``normals`` and ``positions`` are read from."""
        return pair_rows(self.name, cycle, setting, pair_separations, BLANK, BY_LEVEL)


BY_LEVEL: ByLevel[Separations] = {
    Accuracy.HULL: hull_separations,
    Accuracy.MESH: triangle_separations,
}
EFFECT: Effect = SeparationsEffect()
