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

"""Arguments that make no sense are refused by their names, whichever function gets them."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from each import each
from public_calls import BOXES, POSE, public_calls, scene

import obb_collision as oc
from obb_collision.shapes import Hull, Mesh, Sphere
from obb_collision.words import MAX_NAME, MAX_SHOWN, check_name, printable, shown

ERRORS = (ValueError, TypeError, KeyError)
CALLS = public_calls()
WRONG: list[Any] = [
    None, True, -1, 3, 1.5, float("nan"), 10**400, 1j, "x", "\ud800", b"a", {}, {"a": 1}, [], [1],
    ["a"], [None], [[1, 2], [3]], (), set(), object(), object, range(3), lambda: 0, np.zeros(3),
    np.array("x"), np.array([None, {}], object), np.zeros((2, 2, 2)), np.array([True]), [[0, 99]],
]  # fmt: skip
pytestmark = pytest.mark.filterwarnings("ignore:.*far from unit length", "ignore:time_budget")


@each("label", CALLS)
def test_arguments_of_a_wrong_kind_are_refused_by_name(label: str) -> None:
    function, good = CALLS[label]
    if CALLS[label].works:
        function(**good)
    for number, name in enumerate(good, len(label)):
        for wrong in WRONG[number % 2 :: 2]:  # half of them each, in turn
            try:
                function(**{**good, name: wrong})
            except ERRORS as error:
                text = str(error)
                words = [one.rstrip("s") for one in (name, *good)]  # lengths are told of others
                words = words if re.search("length|shape|one row", text) else words[:1]
                usual = ("index", "accuracy", "effect", "no such file", "utf-8", *words)
                assert any(re.search(rf"\b{word}", text) for word in usual), (name, wrong, text)
                assert "._" not in text, text
                assert len(text) < 1000


#: A region may be without an end; of a cloud, points that are no numbers are left out.
TAKEN = {
    ("regions.Region", "minimum"), ("points_inside", "points"),
    ("Scene.obstacle_points =", "obstacle_points"),
}  # fmt: skip


@each("number", [np.nan, -np.inf])
@each("label", [label for label, call in CALLS.items() if call.works])
def test_a_number_that_is_none_is_refused_by_name_wherever_it_stands(
    label: str, number: float
) -> None:
    function, good = CALLS[label]
    for name, value in good.items():
        numbers = np.array(value, float) if is_numeric(value) else np.empty(0)
        if numbers.size and (label, name) not in TAKEN:
            numbers.reshape(-1)[-1] = number
            given = numbers if numbers.ndim else float(numbers)
            with pytest.raises(ERRORS, match=rf"\b{name.rstrip('s')}"):
                function(**{**good, name: given})


def is_numeric(value: Any) -> bool:
    """Return whether an argument is a number, or an array of some."""
    try:
        kind = np.asarray(value).dtype.kind
    except ValueError:
        return False
    return kind in "if" and not isinstance(value, (bool, oc.OBB, oc.AABB))


@each("name", ["centers", "rotations", "half_extents"])
def test_the_row_is_named(name: str) -> None:
    good = {"centers": np.zeros((5, 3)), "half_extents": np.ones((5, 3))}
    good["rotations"] = np.tile(np.eye(3), (5, 1, 1))
    for row in range(5):
        bad = {**good, name: good[name].copy()}
        bad[name][row].reshape(-1)[-1] = -np.inf
        with pytest.raises(ValueError, match=rf"^{name} .*in row {row}\b"):
            oc.Boxes(**bad)


@each("by", [1.1e-6, 1e-3, 1.0, 1e3])
def test_no_rotation_that_is_not_orthonormal(by: float) -> None:
    for place in range(9):
        rotation = np.eye(3)
        rotation.reshape(-1)[place] += by
        with pytest.raises(ValueError, match=r"^rotation .*orthonormal"):
            oc.OBB(np.zeros(3), rotation, np.ones(3))


@each("call, name", [
    (lambda: oc.OBB(half_extents=[1.0, 1.0, -1e-300]), "half_extents"),
    (lambda: oc.OBB.from_quaternion([0] * 3, [0] * 4, [1] * 3), "quaternion_xyzw"),
    (lambda: oc.Boxes.from_poses(np.zeros((2, 7)), np.ones((2, 3))), "poses"),
    (lambda: oc.AABB([1] * 3, [0] * 3), "minimum"),
    (lambda: oc.AABB.from_points(np.empty((0, 3))), "points"),
    (lambda: oc.OBB.from_points(np.empty((0, 3))), "points"),
    (lambda: oc.OBB().transformed(np.zeros((4, 4))), "matrix"),
    (lambda: oc.OBB().padded(-0.1), "margin"),
    (lambda: oc.verdicts(BOXES, BOXES[:1]), "same length"),
    (lambda: scene().check(effects="contact"), r"effect must be one of .*, got 'contact'"),
])  # fmt: skip
def test_numbers_that_make_no_sense_are_refused_by_name(call: Callable[[], Any], name: str) -> None:
    with pytest.raises(ValueError, match=name):
        call()


def test_a_refused_change_leaves_the_box_as_it_was() -> None:
    box = oc.OBB([1.0, 2.0, 3.0], np.eye(3), [1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match="half_extents"):
        box.set(np.zeros(3), np.eye(3), [1.0, np.nan, 1.0])
    assert box == oc.OBB([1.0, 2.0, 3.0], np.eye(3), [1.0, 2.0, 3.0])


@each("name", ["acuracy", "time_buget", "paddings", "points", "anything"])
def test_what_a_scene_has_not_cannot_be_set(name: str) -> None:
    made = scene()
    with pytest.raises(AttributeError, match=rf"Scene has no '{name}'") as error:
        setattr(made, name, "mesh")
    near = {"acuracy": "accuracy", "time_buget": "time_budget", "paddings": "padding"}
    assert name not in near or f"did you mean {near[name]}?" in str(error.value)


def test_a_budget_that_can_only_be_milliseconds_is_warned_about() -> None:
    with pytest.warns(UserWarning, match=r"time_budget is in seconds, got 5: 5 ms are 0\.005"):
        made = oc.Scene(time_budget=5)
    assert made.time_budget == 5.0
    made.time_budget = 0.005
    assert made.time_budget == 0.005


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("length", [2.0, 1e-3, 1e200, 0.89, 1.11])
def test_a_quaternion_far_from_unit_length_is_warned_about_once(length: float) -> None:
    poses = np.tile(POSE, (3, 1))
    poses[1, 6] = length
    said = r"^poses \(quaternion\) far from unit length in row 1: .*; taken as normalised$"
    with pytest.warns(UserWarning, match=said) as caught:
        found = oc.Boxes.from_poses(poses, np.ones((3, 3)))
    assert [warning.filename for warning in caught] == [__file__]
    np.testing.assert_array_equal(found.rotations[1], np.eye(3))
    with pytest.warns(UserWarning, match="quaternion_xyzw far from unit length:"):
        oc.OBB.from_quaternion([0, 0, 0], [0, 0, 0, length], [1, 1, 1])
    made = oc.Scene(accuracy="mesh")
    for name in "abc":
        made.add(name, Sphere(1.0))
    with pytest.warns(UserWarning, match=said):
        made.move_indices([2, 0, 1], poses)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made.check()  # not again
        oc.Boxes.from_poses([[*POSE[:6], 0.91], [*POSE[:6], 1.09]], np.ones((2, 3)))
    moved = poses.copy()
    moved[0, 6], moved[2, 0], moved[2, 6] = -1.0, 1.0, 0.0
    with pytest.raises(ValueError, match="zero quaternion in row 2"):  # row 1 has not moved
        made.move_indices([2, 0, 1], moved)


def test_a_level_is_a_name_a_number_or_itself() -> None:
    numbers = {"sphere": 0, "aabb": 1, "obb": 3, "hull": 5, "mesh": 6}
    assert {level.label: int(level) for level in oc.Accuracy} == numbers
    for level in oc.Accuracy:
        values: tuple[Any, ...] = level.label, int(level), level
        for value in values:
            assert oc.Scene(accuracy=value).accuracy == level


TETRAHEDRON = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
#: What is no boxes (or the like) at all has no attributes of them.
OBJECTS = ("a", "b", "boxes", "start", "end")
HOSTILE: list[Any] = [
    *(0, -1, -2, 1, 2, 3, 4, 7, 8, 63, 64, 65, 255, 256, 2**31 - 1, 2**31, 2**32, 2**62, 2**63),
    *(2**64, -(2**31), -(2**63), 0.5, 1.0, -0.5, 1e300, 1e308, 5e-324, float("nan")),
    *(float("inf"), -float("inf"), True, False, None, "1", "", b"1", [], [1], (), {}, object()),
    *(np.int8(-1), np.uint64(2**64 - 1), np.float32(2.0), np.bool_(True), np.array(3), 1j),
    np.datetime64("2020-01-01"),
    np.empty(0), np.empty((0, 2)), np.empty((0, 3)), np.zeros((1, 1)), np.zeros((2, 2, 2)),
    [[0, 1]], [[0, -1]], [[0, 9]], [[2**31, 2**32]], [[2**62, 1]], [[-(2**63), 0]], [[0.0, 1.0]],
    [[0, 1, 2]], [[0], [1]], [0, 1], [-1], [9], [2**40], [[0, 1], [1]], [["a", "b"]], [[None, 0]],
    np.array([[0, 1]], np.uint64) + np.uint64(2**63), np.array([[0, 1]], np.int8),
    np.array([[0, 1]], ">i8"), np.array([[True, False]]), np.asfortranarray([[0, 1], [1, 0]]),
    np.array([[0, 1], [1, 0], [0, 0]])[::2], np.ma.array([[0, 1]]), np.array([[0, 1]], object),
    np.full((2, 3), np.nan), np.full((2, 3), np.inf), np.full((2, 3), 1e300), np.ones((3, 3)),
    np.ones((2, 3), np.complex128), np.zeros((2, 3), "S1"), np.lib.stride_tricks.as_strided(
        np.zeros(3), (2, 3), (0, 8)
    ), np.zeros((2, 7)), np.full((2, 7), -1e300), np.zeros((2, 6)), np.full((2, 6), 1e300),
    np.zeros((1 << 10, 0)), np.zeros((2, 3, 3)), np.zeros((4, 3)), np.zeros(7), np.full(7, np.nan),
]  # fmt: skip
EVERY = ["separations", "contacts", "clearance", "sweep", "points"]


def trees() -> oc.MeshTrees:
    """Return two small trees."""
    tree = oc.MeshTrees.build(TETRAHEDRON, FACES)
    return oc.MeshTrees.join([tree, tree])


def added(**given: Any) -> Any:
    """Add a shape to a scene with a mesh, with an option of each effect; check it."""
    made = scene()
    made.add("c", Mesh(TETRAHEDRON, FACES), accuracy="mesh")
    made.add("d", Mesh(given["vertices"], given["faces"]), accuracy="mesh")
    made.add("e", Hull(TETRAHEDRON, given["scale"]), accuracy="hull")
    made.obstacle_points = np.zeros((3, 3))
    made.set_effect("contacts", max_points=given["max_points"])
    made.set_effect("clearance", max_distance=given["max_distance"])
    made.set_effect("sweep", horizon=given["horizon"])
    made.set_effect("points", margin=given["margin"])
    report = made.check(effects=EVERY)
    for name in ("pairs", "verdicts", "accuracies"):
        assert not getattr(report, name).flags.writeable
    return report.names(), report.colliding


def hostile_calls() -> Iterator[tuple[str, Callable[..., Any], dict[str, Any]]]:
    """Yield name, function and good arguments."""
    for label, call in CALLS.items():
        if label != "set_threads" and call.works:
            yield label, call.function, call.good
    good = {"vertices": TETRAHEDRON, "faces": FACES, "scale": [1.0] * 3, "max_points": 4}
    yield "added", added, {**good, "max_distance": 1.0, "horizon": 1.0, "margin": 0.1}
    arrays = {key: value for key, value in vars(trees()).items() if key != "arrays"}
    for name, value in arrays.items():

        def whole(value: Any, name: str = name) -> Any:
            made = oc.MeshTrees(**arrays | {name: value})
            bodies = oc.PlacedMeshes(made, [0, 1], np.zeros((2, 3)), [np.eye(3)] * 2)
            return oc.verdicts(bodies, bodies, [[0, 1]]), oc.verdicts(bodies, bodies, depth=3)

        def entry(value: Any, name: str = name, whole: Callable[..., Any] = whole) -> Any:
            changed = arrays[name].copy()
            try:
                changed[-1] = value
            except (*ERRORS, OverflowError):
                return None  # no such array
            return whole(changed)

        yield f"MeshTrees {name}", whole, {"value": value}
        yield f"MeshTrees {name}[-1]", entry, {"value": value[-1]}


def say(line: str) -> None:
    """Write a line at once: the process may end at the next call."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main() -> None:
    """Run the cases; print what is no answer and no clear error."""
    number, step = 0, int(sys.argv[1]) if len(sys.argv) > 1 else 1
    for name, function, good in hostile_calls():
        function(**good)  # what is good must work
        for argument in good:
            for which, value in enumerate(HOSTILE):
                number += 1
                if number % step:
                    continue
                say(f"{number} {name}({argument}=HOSTILE[{which}])")
                try:
                    with warnings.catch_warnings():
                        warnings.simplefilter("ignore")
                        function(**{**good, argument: value})
                except ERRORS as error:
                    if type(error).__module__.startswith("numba"):
                        say(f"FAILED {type(error).__name__}: {value!r}")
                except BaseException as error:
                    if argument not in OBJECTS or not isinstance(error, AttributeError):
                        say(f"FAILED {type(error).__name__}: {error} for {value!r}")
    say(f"done {number}")


#: One case in so many is run; all of them take a minute or two.
@pytest.mark.parametrize("step", [24, pytest.param(1, marks=pytest.mark.slow)])
def test_hostile_arguments_are_answered_or_refused(step: int) -> None:
    """Nothing that is handed to the library ends the process, or is read out of bounds."""
    source, support = Path(oc.__file__).parents[1], Path(__file__).parent / "support"
    ran = subprocess.run(
        [sys.executable, __file__, str(step)],
        env={**os.environ, "PYTHONPATH": f"{source}{os.pathsep}{support}"},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    lines = ran.stdout.splitlines()
    failed = [f"{case}: {line}" for case, line in pairwise(lines) if line.startswith("FAILED")]
    assert failed == []
    assert ran.returncode == 0, f"ended by {ran.returncode} in {lines[-1:]}: {ran.stderr[-2000:]}"
    assert lines[-1].startswith("done ")
    assert len(lines) > 20_000 // step


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


if __name__ == "__main__":
    main()
