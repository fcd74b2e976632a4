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

"""Names from outside can be printed, sent and matched, and values in messages are short."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from each import each

import obb_collision as oc
from obb_collision.words import MAX_NAME, MAX_SHOWN, check_name, printable, shown

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
