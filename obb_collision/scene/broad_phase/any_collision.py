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

"""Does anything collide? Stops at the first pair that does."""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.boxes import BoxArrays, Boxes
from obb_collision.geometry.validation import as_flag, check_kind
from obb_collision.numerics.vec3 import vector_at
from obb_collision.queries.verdict.coarse import meeting_bounds
from obb_collision.queries.verdict.sat import box_at
from obb_collision.queries.verdict.verdict import OVERLAP, SEPARATE, box_verdict, exact_verdict
from obb_collision.scene.broad_phase.bounds_tree import BoundsTree, overlapping
from obb_collision.typing import Floats


def any_collision(a: Boxes, b: Boxes | None = None, *, exact: bool = False) -> bool:
    """Return whether any two boxes collide, of one set or between two; stops at the first pair.

    Parameters
    ----------
    a : Boxes
    b : Boxes, optional
        Without, any two of a; with it, one of a and one of b.
    exact : bool
        Decide by integer arithmetic what doubles can't tell from touching, which else counts.

    Returns
    -------
    bool
        Whether ``find_pairs`` with the same arguments finds a pair.

    Raises
    ------
    TypeError
        For anything but boxes.

    Examples
    --------
    >>> boxes = oc.Boxes([[0, 0, 0], [1, 0, 0], [9, 0, 0]], [np.eye(3)] * 3, [[1, 1, 1]] * 3)
    >>> oc.any_collision(boxes), oc.any_collision(boxes[:2], boxes[2:])
    (True, False)
    """
    check_kind(a, Boxes, "a")
    if b is not None:
        check_kind(b, Boxes, "b")
    return find_first(a, b, as_flag(exact, "exact"))[0]


def find_first(a: Boxes, b: Boxes | None, exact: bool) -> tuple[bool, int]:
    """Return whether any pair collides, and how many pairs were tested until that was clear."""
    others = a if b is None else b
    if len(a) == 0 or len(others) == 0:
        return False, 0
    tree = BoundsTree.build(*meeting_bounds(others))
    low, high = (tree.minimum, tree.maximum) if b is None else meeting_bounds(a)
    place = np.zeros(3, np.int64)
    both = a.arrays, others.arrays
    while True:
        other, verdict = _first_kernel(low, high, tree, *both, b is None, place)
        if other < 0:
            return False, int(place[2])
        if verdict == OVERLAP or not exact:
            return True, int(place[2])
        if exact_verdict(a, place[0], others, other) != SEPARATE:
            return True, int(place[2])


@njit
def _first_kernel(
    own_minimum: Floats, own_maximum: Floats, tree: BoundsTree,
    a: BoxArrays, b: BoxArrays, same: bool, place: np.ndarray,
) -> tuple[int, int]:  # fmt: skip
    """Return the next row of b that collides with the row ``place[0]`` of a, and the verdict.

    -1 for no more. place (3,): the row of a, how many rows of b have been tested for it, how many
    pairs in all; it is where to go on. same: both sets are one, of which each pair is tested once.
    """
    column = np.empty(len(tree.order), np.int64)
    while place[0] < len(own_minimum):
        row = place[0]
        low, high = vector_at(own_minimum, row), vector_at(own_maximum, row)
        least = row + 1 if same else 0
        reached = overlapping(tree, low, high, least, column)
        box = box_at(a, row)
        for other in column[place[1] : reached]:
            place[1] += 1
            place[2] += 1
            verdict = box_verdict(box, box_at(b, other))
            if verdict != SEPARATE:
                return other, verdict
        place[0], place[1] = row + 1, 0
    return -1, SEPARATE
