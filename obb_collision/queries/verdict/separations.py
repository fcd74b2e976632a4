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

"""Signed separation, axis and place of pairs of boxes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from obb_collision._threads import run
from obb_collision.geometry.boxes import Boxes
from obb_collision.queries.verdict.blocks import witness_kernel
from obb_collision.queries.verdict.pair_rows import as_pairs, one_set
from obb_collision.queries.verdict.verdict import Verdicts, pair_verdicts
from obb_collision.typing import Floats, Integers

#: Pairs below which a second thread does not pay: 50 us or so.
FEWEST_PAIRS = 512


@dataclass(frozen=True, eq=False)
class Separations:
    """Signed separations of m pairs of boxes.

    pairs (m, 2): rows of a and b, in a report indices of objects; separations (m,): metres,
    negative where the boxes overlap; normals (m, 3): unit, from the first to the second; positions
    (m, 3): metres, a place near both boxes.
    """

    pairs: Integers
    separations: Floats
    normals: Floats
    positions: Floats

    @classmethod
    def blank(cls, pairs: Integers) -> Separations:
        """Return room for pairs (m, 2)."""
        return cls(pairs, np.empty(len(pairs)), *np.empty((2, len(pairs), 3)))

    def __len__(self) -> int:
        return len(self.pairs)


@dataclass(frozen=True, eq=False)
class CertifiedSeparations(Separations):
    """The same with the certified verdicts (m,) int8 of the pairs."""

    verdicts: Verdicts


def box_separations(a: Boxes, b: Boxes, pairs: ArrayLike | None = None) -> CertifiedSeparations:
    """Return the signed separations of boxes, with their verdicts."""
    rows = as_pairs(a, b, pairs)
    found = pair_separations(*one_set(a, b, rows))
    verdicts = pair_verdicts(a, rows[:, 0].copy(), b, rows[:, 1].copy())
    return CertifiedSeparations(rows, found.separations, found.normals, found.positions, verdicts)


def pair_separations(boxes: Boxes, pairs: Integers) -> Separations:
    """Return the separation of each pair (m, 2) of rows of boxes, as ``witness`` has it."""
    found = Separations.blank(pairs)
    out = found.separations, found.normals, found.positions
    run(witness_kernel, len(pairs), FEWEST_PAIRS, boxes.arrays, pairs, *out)
    return found
