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

"""Non-maximum suppression: of boxes that are the same thing seen twice, the best one is kept."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.validation import as_array, check_kind, check_lengths
from obb_collision.queries.verdict.overlap import iou
from obb_collision.scene.broad_phase.find_pairs import find_pairs
from obb_collision.typing import Rows
from obb_collision.words import shown


def nms(boxes: Boxes, scores: ArrayLike, threshold: float) -> Rows:
    """Return the boxes that greedy non-maximum suppression keeps.

    From the best score down, a box is kept unless its ``iou`` with one that is kept exceeds the
    threshold. Only boxes that overlap are compared.

    Parameters
    ----------
    boxes : Boxes
    scores : (n,) array_like
        Of equal ones the first row is the better one.
    threshold : float
        From 0, which keeps no two boxes that share volume, to 1, which keeps all.

    Returns
    -------
    (m,) array of int64
        Their rows, best first.

    Raises
    ------
    ValueError
        For scores that are not finite, or not one per box, and for another threshold.
    TypeError
        For anything but boxes.

    Examples
    --------
    >>> boxes = oc.Boxes([[0, 0, 0], [0.1, 0, 0], [9, 0, 0]], [np.eye(3)] * 3, [[1, 1, 1]] * 3)
    >>> oc.nms(boxes, [0.7, 0.9, 0.8], threshold=0.5).tolist()
    [1, 2]
    """
    check_kind(boxes, Boxes, "boxes")
    values = as_array(scores, "scores", (None,))
    check_lengths(boxes=boxes, scores=values)
    most = float(as_array(threshold, "threshold", ()))
    if not 0.0 <= most <= 1.0:
        raise ValueError(f"threshold must be from 0 to 1, got {shown(threshold)}")
    order = np.argsort(-values, kind="stable")
    ranks = np.empty_like(order)
    ranks[order] = np.arange(len(order))
    pairs = find_pairs(boxes)
    better, worse = np.sort(ranks[pairs[iou(boxes, boxes, pairs) > most]], axis=1).T
    worse = worse[np.argsort(better)]
    counts = np.bincount(better, minlength=len(order))
    ends = np.cumsum(counts)
    kept = np.ones(len(order), np.bool_)
    for rank in np.flatnonzero(counts):
        if kept[rank]:  # all that are better have been asked
            kept[worse[ends[rank] - counts[rank] : ends[rank]]] = False
    return order[kept]
