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

"""The descent of one tree, from its root to triangles, nearest first.

Branch and bound: of the boxes that wait, those too far are passed over, the nearest other is
replaced by its children or, if it has none, by its triangles. A question is three functions and
what they need: how far a box is, what a triangle adds to the answer, and how near boxes must be
from there on. All are compiled into whatever asks.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from obb_collision._jit import njit
from obb_collision.geometry.trees.obb_tree import TreeArrays
from obb_collision.typing import Floats

#: Rows of the stack: one is left behind at each level of a tree, at most 75, or of either of two
#: (``trees.build.MIN_SHARE``).
STACK = 256
#: A limit below which all boxes are but those that are infinitely far.
LARGEST = float(np.finfo(np.float64).max)


class Waiting(NamedTuple):
    """Work space: nodes that wait to be looked at, the next one last."""

    nodes: np.ndarray  #: (STACK, 2): of one tree in the first column, or of two
    bounds: Floats  #: (STACK,) how far they are at least


@njit
def no_waiting() -> Waiting:
    """Return work space for one descent after another."""
    return Waiting(np.empty((STACK, 2), np.int64), np.empty(STACK))


class Limited(Protocol):
    """The answer so far."""

    @property
    def limit(self) -> float:
        """Boxes farther than this are passed over; all where it is -inf."""


Q = TypeVar("Q")
A = TypeVar("A", bound=Limited)


@njit(merge=True)
def descend_nearest(
    trees: TreeArrays,
    root: int,
    question: Q,
    box_bound: Callable[[Q, Floats, int], float],
    with_triangle: Callable[[Q, TreeArrays, int, float, A], A],
    answer: A,
    waiting: Waiting,
) -> tuple[A, float]:
    """Return the answer after all triangles that count, and the least bound passed over.

    box_bound: at most how far what is in a node is, infinite where none of it counts; the limit is
    finite where that may be.
    with_triangle: the answer after a triangle, whose box has the bound given.
    """
    nodes, children, starts = trees.nodes, trees.children, trees.starts
    stack, bounds = waiting
    node, least, count, passed = root, box_bound(question, nodes, root), 0, np.inf
    while True:
        near = children[node]
        if least > answer.limit:
            passed = min(passed, least)
        elif near < 0:
            for k in range(starts[node, 0], starts[node, 1]):
                answer = with_triangle(question, trees, k, least, answer)
        else:
            far = near + 1
            first, second = box_bound(question, nodes, near), box_bound(question, nodes, far)
            if not first < second:
                near, far, first, second = far, near, second, first
            stack[count, 0], bounds[count] = far, second
            node, least, count = near, first, count + 1
            continue
        if count == 0:
            return answer, passed
        count -= 1
        node, least = stack[count, 0], bounds[count]
