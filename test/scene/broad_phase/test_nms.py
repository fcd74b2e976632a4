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

"""Non-maximum suppression keeps what the greedy definition keeps."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from scipy.spatial.transform import Rotation

import obb_collision as oc


def greedy(boxes: oc.Boxes, scores: list[float], threshold: float) -> list[int]:
    """Return the rows that are kept, by the definition: each against all that are kept."""
    kept: list[int] = []
    for row in sorted(range(len(scores)), key=lambda row: (-scores[row], row)):
        against = oc.iou(boxes, boxes, [(row, other) for other in kept] or np.zeros((0, 2), int))
        if not (against > threshold).any():
            kept.append(row)
    return kept


@each("seed", range(40))
def test_what_is_kept_is_what_the_definition_keeps(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(0, 80))
    seen = rng.integers(0, max(count // 3, 1), count)  # each thing about three times, some the same
    shifts = rng.choice([0.0, 0.05, 0.3], (count, 3))
    turned = Rotation.random(count + 1, random_state=seed).as_matrix()[:count]  # one, at least
    rotations = turned if seed % 2 else np.eye(3)
    boxes = oc.Boxes(
        rng.uniform(0, 3, (count, 3))[seen] + shifts,
        np.broadcast_to(rotations, (count, 3, 3)),
        np.tile([0.5, 0.4, 0.3 * (seed % 5 > 0)], (count, 1)),  # one family is flat
    )
    scores = rng.integers(0, 5, count) / 4.0  # many ties
    for threshold in (0.0, 0.2, 0.7, 1.0):
        kept = oc.nms(boxes, scores, threshold)
        assert kept.tolist() == greedy(boxes, scores.tolist(), threshold)
        assert kept.dtype == np.int64


@each("threshold", [-0.1, 1.1, np.nan])
def test_what_cannot_be_compared_is_refused(threshold: float) -> None:
    boxes = oc.Boxes(np.zeros((2, 3)), [np.eye(3)] * 2, np.ones((2, 3)))
    with pytest.raises(ValueError, match="threshold must be"):
        oc.nms(boxes, [1.0, 0.0], threshold)
    for scores in ([1.0, np.nan], [1.0]):
        with pytest.raises(ValueError, match="scores"):
            oc.nms(boxes, scores, 0.5)
