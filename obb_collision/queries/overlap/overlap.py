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

"""How much do two boxes overlap? The volume they share, and intersection over union.

The smaller box is clipped by the six half-spaces of the other (``clipping``). What is certain is
exact: 0 where ``verdicts`` does not say OVERLAP and for flat boxes, which have no volume; the whole
volume, and 1, for boxes that are the same set. The answer for b and a is that for a and b, bit for
bit.

Accuracy: a volume is off by at most VOLUME_BOUND. So thin boxes have as many digits as their
thickness has beside the size of the pair.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from obb_collision.geometry.boxes import Boxes, box_volumes
from obb_collision.queries.overlap.clipping import overlap_kernel
from obb_collision.queries.verdict.pair_rows import as_pairs, check_boxes, one_set
from obb_collision.queries.verdict.verdict import OVERLAP, pair_verdicts
from obb_collision.typing import Floats


def overlap_volumes(a: Boxes, b: Boxes, pairs: ArrayLike | None = None) -> Floats:
    """Return the volume that boxes share.

    Parameters
    ----------
    a, b : Boxes
    pairs : (m, 2) array_like of int, optional
        Rows of a and of b; without, each row of a against the same row of b.

    Returns
    -------
    (m,) array
        Cubic metres. Exactly 0 where ``verdicts`` does not say OVERLAP and for flat boxes; exactly
        the volume of both for boxes that are the same set, also with axes swapped or reversed.
        Positive otherwise. Infinite beyond 1.8e308.

    Raises
    ------
    ValueError
        For pairs that are no rows, and without pairs for different lengths.
    TypeError
        For anything but boxes.

    References
    ----------
    Sutherland, Hodgman, Reentrant Polygon Clipping (CACM 1974).

    Examples
    --------
    >>> boxes = oc.Boxes([[0, 0, 0], [1, 0, 0], [9, 0, 0]], [np.eye(3)] * 3, [[1, 1, 1]] * 3)
    >>> oc.overlap_volumes(boxes, boxes, [[0, 0], [0, 1], [0, 2]]).tolist()
    [8.0, 4.0, 0.0]
    """
    return _overlaps(a, b, pairs)[0]


def iou(a: Boxes, b: Boxes, pairs: ArrayLike | None = None) -> Floats:
    """Return intersection over union: the volume that boxes share by the volume that they cover.

    Parameters
    ----------
    a, b : Boxes
    pairs : (m, 2) array_like of int, optional
        Rows of a and of b; without, each row of a against the same row of b.

    Returns
    -------
    (m,) array
        From 0 to 1. Exactly 0 where ``overlap_volumes`` is, and exactly 1 for boxes that are the
        same set, also with axes swapped or reversed. Flat boxes have 1 with themselves, else 0.

    Raises
    ------
    ValueError
        For pairs that are no rows, and without pairs for different lengths.
    TypeError
        For anything but boxes.

    Examples
    --------
    >>> boxes = oc.Boxes([[0, 0, 0], [1, 0, 0], [9, 0, 0]], [np.eye(3)] * 3, [[1, 1, 1]] * 3)
    >>> oc.iou(boxes, boxes, [[0, 0], [0, 1], [0, 2]]).round(6).tolist()
    [1.0, 0.333333, 0.0]
    """
    return _overlaps(a, b, pairs)[1]


def _overlaps(a: Boxes, b: Boxes, pairs: ArrayLike | None) -> tuple[Floats, Floats]:
    check_boxes(a, b)
    rows = as_pairs(a, b, pairs)
    overlap = pair_verdicts(a, rows[:, 0].copy(), b, rows[:, 1].copy()) == OVERLAP
    boxes, rows = one_set(a, b, rows)
    volumes, ratios = np.empty(len(rows)), np.empty(len(rows))
    overlap_kernel(
        *(boxes.centers, boxes.rotations, boxes.half_extents, box_volumes(boxes.half_extents)),
        *(rows, overlap, volumes, ratios),
    )
    return volumes, ratios
