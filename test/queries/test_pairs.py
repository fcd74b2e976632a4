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

"""One convention: f(a, b, pairs=None) is row by row, or rows of both, for every question."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from each import each
from support import family, joined, refused

import obb_collision as oc

A, B = family("ordinary scene", 24)
BOTH, ROWS = joined(A, B)
PAIRS = np.argwhere(np.ones((24, 24)))[::7]
TWISTS = np.random.default_rng(0).normal(size=(48, 6))


def moving(boxes: oc.Boxes, rows: slice) -> oc.MovingBoxes:
    return oc.MovingBoxes.from_twists(boxes, TWISTS[rows], 2.0)


def posed(boxes: oc.Boxes, rows: slice) -> oc.MovingBoxes:
    end = oc.Boxes(boxes.centers + TWISTS[rows, :3], boxes.rotations, boxes.half_extents)
    return oc.MovingBoxes(boxes, end)


def still(boxes: oc.Boxes, rows: slice) -> oc.Boxes:
    return boxes


QUESTIONS: dict[str, tuple[Callable[..., Any], Callable[[oc.Boxes, slice], Any]]] = {
    "verdicts": (oc.verdicts, still),
    "separations": (oc.separations, still),
    "clearances": (oc.clearances, still),
    "near clearances": (partial(oc.clearances, max_distance=0.5), still),
    "contacts": (oc.contacts, still),
    "overlap_volumes": (oc.overlap_volumes, still),
    "iou": (oc.iou, still),
    "sweeps of boxes that stand": (oc.sweeps, still),
    "sweeps from pose to pose": (oc.sweeps, posed),
    "sweeps by twists": (oc.sweeps, moving),
}


def columns(answer: Any) -> dict[str, Any]:
    """Return the arrays of an answer, but for the rows that it is about."""
    if isinstance(answer, np.ndarray):
        return {"answer": answer}
    return {name: column for name, column in vars(answer).items() if name != "pairs"}


def assert_same(one: Any, other: Any) -> None:
    for name, column in columns(one).items():
        np.testing.assert_array_equal(column, columns(other)[name], err_msg=name)


@each("name", QUESTIONS)
def test_rows_of_two_sets_are_rows_of_one_that_holds_both(name: str) -> None:
    ask, make = QUESTIONS[name]
    a, b, both = make(A, slice(24)), make(B, slice(24, 48)), make(BOTH, slice(48))
    found = ask(a, b, PAIRS)
    assert_same(found, ask(both, both, PAIRS + np.array([0, 24])))
    assert_same(ask(a, b), ask(both, both, ROWS))
    assert_same(ask(a, b), ask(a, b, np.stack([np.arange(24)] * 2, axis=1)))
    assert all(len(column) == 0 for column in columns(ask(a, b, [])).values())
    if hasattr(found, "pairs"):
        rows = {tuple(pair) for pair in PAIRS.tolist()}
        assert {tuple(pair) for pair in found.pairs.tolist()} <= rows


@each("name", QUESTIONS)
def test_what_are_no_rows_of_both_is_refused(name: str) -> None:
    ask, make = QUESTIONS[name]
    a, b = make(A, slice(24)), make(B[:5], slice(5))
    refused("a and b must have the same length, got 24 and 5", ask, a, b)
    for bad in ([[0, 5]], [[24, 0]], [[-1, 0]]):
        refused("pairs must be rows of 24 and 5", ask, a, b, bad)
    refused(r"pairs must be rows of 24 and 5, got \[0, 5\] in row 1", ask, a, b, [[0, 1], [0, 5]])
    refused(r"pairs must have shape \(m, 2\)", ask, a, b, [0, 1])
    refused("pairs must be whole numbers", ask, a, b, [[0.0, 1.0]])
    with pytest.raises(TypeError, match="b must be"):
        ask(a, [[0, 1]])


def test_sets_that_move_at_different_times_are_refused() -> None:
    refused(
        "a and b must move during the same times",
        oc.sweeps,
        moving(A, slice(24)),
        posed(B, slice(24)),
    )
    against_still = oc.sweeps(moving(A, slice(24)), B)
    assert against_still.hits.any()
    assert (against_still.times[against_still.hits] <= 2.0).all()
    assert repr(moving(A, slice(24))) == "MovingBoxes(24 for 2 s)"
    assert repr(posed(A, slice(24))) == "MovingBoxes(24 from pose to pose)"
