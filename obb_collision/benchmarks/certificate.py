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

"""What the certificate costs: the certified test beside the plain one, on the same candidates."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

import numpy as np

from obb_collision.benchmarks.cases.plain import plain_kernel
from obb_collision.geometry.boxes import Boxes
from obb_collision.queries.verdict.verdict import TOUCHING, verdict_kernel
from obb_collision.scene.broad_phase.broad_phase import find_candidates

#: Turns per kernel; the median of their ratios is robust on a noisy machine.
TURNS = 25


@dataclass(frozen=True)
class Cost:
    """Nanoseconds per candidate pair, and how many pairs doubles left undecided."""

    pairs: int
    plain_ns: float
    certified_ns: float
    ratio: float  #: median over the turns
    undecided: int


def measure_certificate(boxes: Boxes) -> Cost:
    """Time both kernels in turn on the candidate pairs of a scene."""
    candidates = find_candidates(*boxes.world_bounds())
    first, second = (np.ascontiguousarray(column) for column in candidates.T)
    arrays = (boxes.centers, boxes.rotations, boxes.half_extents)
    verdicts = np.empty(len(candidates), np.int8)
    times = np.empty((TURNS + 1, 2))
    for turn in range(TURNS + 1):
        for k, kernel in enumerate((plain_kernel, verdict_kernel)):
            start = perf_counter()
            kernel(*arrays, first, *arrays, second, verdicts, 0, len(verdicts))
            times[turn, k] = perf_counter() - start
    times = times[1:]  # the first turn compiles
    plain, certified = 1e9 * np.median(times, axis=0) / len(candidates)
    ratio = float(np.median(times[:, 1] / times[:, 0]))
    undecided = int((verdicts == TOUCHING).sum())
    return Cost(len(candidates), float(plain), float(certified), ratio, undecided)
