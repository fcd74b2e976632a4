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

"""Input that makes no sense is refused at the edge: a ValueError that names the argument.

Never a boolean answer for NaN: every public way in is tried with every kind of nonsense. Names from
outside can be printed, sent and matched, and values in messages are short.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from each import each
from hypothesis import given
from hypothesis import strategies as st

import obb_collision as oc
from obb_collision.words import MAX_NAME, MAX_SHOWN, check_name, printable, shown

ROWS = 5
SINGULAR = {"centers": "center", "rotations": "rotation", "half_extents": "half_extents"}
NOT_NUMBERS = st.sampled_from([np.nan, np.inf, -np.inf, 1e301, -1e305])


def good_arrays() -> dict[str, np.ndarray]:
    return {
        "centers": np.zeros((ROWS, 3)),
        "rotations": np.tile(np.eye(3), (ROWS, 1, 1)),
        "half_extents": np.ones((ROWS, 3)),
    }


@given(st.sampled_from(sorted(good_arrays())), NOT_NUMBERS, st.integers(0, ROWS - 1), st.data())
def test_no_box_with_a_number_that_is_none(
    name: str, bad: float, row: int, data: st.DataObject
) -> None:
    arrays = good_arrays()
    place = tuple(data.draw(st.integers(0, 2)) for _ in arrays[name].shape[1:])
    arrays[name][(row, *place)] = bad
    with pytest.raises(ValueError, match=rf"^{name} .*in row {row}\b"):
        oc.Boxes(**arrays)
    with pytest.raises(ValueError, match=rf"^{SINGULAR[name]} "):
        oc.OBB(**{SINGULAR[key]: array[row] for key, array in arrays.items()})


@given(NOT_NUMBERS, st.integers(0, ROWS - 1), st.integers(0, 6))
def test_no_pose_with_a_number_that_is_none(bad: float, row: int, column: int) -> None:
    poses = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (ROWS, 1))
    poses[row, column] = bad
    with pytest.raises(ValueError, match=rf"^poses .*in row {row}\b"):
        oc.Boxes.from_poses(poses, np.ones((ROWS, 3)))


@given(st.floats(max_value=0.0, exclude_max=True, allow_infinity=False), st.integers(0, 2))
def test_no_negative_half_extents(negative: float, column: int) -> None:
    arrays = good_arrays()
    arrays["half_extents"][3, column] = negative
    with pytest.raises(ValueError, match=r"^half_extents .*in row 3"):
        oc.Boxes(**arrays)


@given(st.floats(1.1e-6, 1e3), st.integers(0, 2), st.integers(0, 2))
def test_no_rotation_that_is_not_orthonormal(by: float, i: int, j: int) -> None:
    arrays = good_arrays()
    arrays["rotations"][2, i, j] += by
    with pytest.raises(ValueError, match=r"^rotations .*in row 2"):
        oc.Boxes(**arrays)


@each("rotation", [np.zeros((3, 3)), np.ones((3, 3)), 2.0 * np.eye(3), np.diag([1.0, 1.0, 0.0])])
def test_no_matrix_that_is_no_rotation(rotation: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"^rotation .*orthonormal"):
        oc.OBB(np.zeros(3), rotation, np.ones(3))


BOX = oc.OBB([0.0, 0.0, 0.0], np.eye(3), [1.0, 1.0, 1.0])
NAN3 = [0.0, np.nan, 0.0]
INF3 = [0.0, 0.0, np.inf]
AROUND = oc.AABB([-1.0, -1.0, -1.0], [1.0, 1.0, 1.0])

Call = Callable[[], Any]
NONSENSE: list[tuple[str, Call]] = [
    ("center", lambda: oc.OBB([0.0, 0.0], np.eye(3), np.ones(3))),
    ("center", lambda: oc.OBB("here", np.eye(3), np.ones(3))),
    ("center", lambda: oc.OBB(None, np.eye(3), np.ones(3))),  # type: ignore[arg-type]
    ("rotation", lambda: oc.OBB(np.zeros(3), np.eye(4), np.ones(3))),
    ("half_extents", lambda: oc.OBB(np.zeros(3), np.eye(3), 1.0)),
    ("half_extents", lambda: oc.OBB(np.zeros(3), np.eye(3), [1.0, 1.0, -1e-300])),
    ("quaternion_xyzw", lambda: oc.OBB.from_quaternion(np.zeros(3), np.zeros(4), np.ones(3))),
    ("quaternion_xyzw", lambda: oc.OBB.from_quaternion(np.zeros(3), [0, 0, 1], np.ones(3))),
    ("poses", lambda: oc.Boxes.from_poses(np.zeros((2, 7)), np.ones((2, 3)))),
    ("poses", lambda: oc.Boxes.from_poses(np.zeros((2, 6)), np.ones((2, 3)))),
    ("same length", lambda: oc.Boxes(np.zeros((1, 3)), [np.eye(3)] * 2, np.ones((1, 3)))),
    ("centers", lambda: oc.Boxes(np.zeros(3), np.eye(3)[None], np.ones((1, 3)))),
    ("minimum", lambda: oc.AABB(NAN3, np.ones(3))),
    ("maximum", lambda: oc.AABB(np.zeros(3), INF3)),
    ("minimum", lambda: oc.AABB(np.ones(3), np.zeros(3))),
    ("points", lambda: oc.AABB.from_points(np.empty((0, 3)))),
    ("points", lambda: oc.AABB.from_points([NAN3])),
    ("points", lambda: oc.OBB.from_points(np.empty((0, 3)))),
    ("points", lambda: oc.OBB.from_points([NAN3, INF3])),
    ("fit", lambda: oc.OBB.from_points(np.eye(3), fit="guess")),
    ("points", lambda: BOX.contains(NAN3)),
    ("points", lambda: BOX.contains([NAN3, [0.0, 0.0, 0.0]])),
    ("points", lambda: BOX.contains([0.0, 0.0])),
    ("points", lambda: AROUND.contains(NAN3)),
    ("points", lambda: AROUND.contains([INF3])),
    ("margin", lambda: BOX.padded(np.nan)),
    ("margin", lambda: BOX.padded(-0.1)),
    ("matrix", lambda: BOX.transformed(np.full((4, 4), np.nan))),
    ("matrix", lambda: BOX.transformed(np.zeros((4, 4)))),
    ("matrix", lambda: BOX.transformed(np.eye(3))),
    ("same length", lambda: oc.verdicts(oc.Boxes(**good_arrays()), one_box())),
]


def one_box() -> oc.Boxes:
    return oc.Boxes(np.zeros((1, 3)), np.eye(3)[None], np.ones((1, 3)))


@each("name, call", NONSENSE)
def test_nonsense_is_refused_by_name(name: str, call: Call) -> None:
    with pytest.raises(ValueError, match=name):
        call()


def test_a_refused_change_leaves_the_box_as_it_was() -> None:
    box = oc.OBB([1.0, 2.0, 3.0], np.eye(3), [1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match="half_extents"):
        box.set(np.zeros(3), np.eye(3), [1.0, np.nan, 1.0])
    assert box == oc.OBB([1.0, 2.0, 3.0], np.eye(3), [1.0, 2.0, 3.0])


BAD_NAMES = ["", "\ud800/1", "a\x00b", "a\nb", "\x1b[31m", "a\u2028b", "a\x85", "x" * 10**6]


class Sulky:
    """Can't be shown."""

    def __repr__(self) -> str:
        raise RuntimeError("no")


@each("name", [*BAD_NAMES, None, 3, b"a", ["a"]])
def test_what_is_no_name_is_refused_in_one_printable_line(name: Any) -> None:
    with pytest.raises(ValueError, match=r"^name must ") as error:
        check_name(name, "name")
    assert str(error.value).isprintable()
    assert len(str(error.value)) < 200


@each("name", ["a", "gripper/1", "Ünïcode 物 🎲", "/5", " ", "x" * MAX_NAME])
def test_other_names_stay_as_they_are(name: str) -> None:
    assert check_name(name, "name") == name


@each("name", BAD_NAMES)
def test_no_scene_has_an_object_of_such_a_name(name: str) -> None:
    scene = oc.Scene()
    with pytest.raises(ValueError, match=r"^name must "):
        scene.add(name, oc.shapes.Box([1, 1, 1]))
    assert len(scene) == 0


@each("value", [
        "x" * 10**6, "\ud800", 10**5000, dict.fromkeys(range(99), "a" * 99), np.zeros((99, 99)),
        [[["\n"] * 99] * 99] * 99, Sulky(), None, b"\x00" * 999,
    ])  # fmt: skip
def test_values_are_shown_in_a_short_line(value: Any) -> None:
    text = shown(value)
    assert 0 < len(text) <= MAX_SHOWN
    assert text.isprintable()
    text.encode()


def test_values_of_just_the_length_that_is_shown_are_whole() -> None:
    value = ["x" * 36, "x" * 36]
    assert (len(repr(value)), shown(value)) == (MAX_SHOWN, repr(value))
    assert shown(["x" * 36, "x" * 37]) == repr(value)[:-3] + "..."


def test_what_cannot_be_printed_is_escaped() -> None:
    assert printable("a\nb\x00\ud800 é") == "a\\nb\\x00\\ud800 é"
