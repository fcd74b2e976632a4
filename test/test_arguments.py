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

"""Arguments: what makes no sense is refused by its name, and arrays of every kind are read."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from contextlib import suppress
from itertools import count
from pathlib import Path
from threading import Event, Thread
from typing import Any

import numpy as np
import pytest
from each import each
from public_calls import BOXES, PLACED, POSE, Call, public_calls, scene
from support import refused

import obb_collision as oc
from obb_collision.scene.effects import EFFECTS
from obb_collision.shapes import Hull, Mesh, Sphere
from obb_collision.words import MAX_NAME, MAX_SHOWN, check_name, printable, shown

ERRORS = (ValueError, TypeError, KeyError)
CALLS = public_calls()
pytestmark = pytest.mark.filterwarnings("ignore:.*far from unit length", "ignore:time_budget")
HOSTILE: list[Any] = [
    *(0, -1, -2, 1, 2, 3, 4, 7, 8, 63, 64, 65, 255, 256, 2**31 - 1, 2**31, 2**32, 2**62, 2**63),
    *(2**64, -(2**31), -(2**63), 10**400, 0.5, 1.0, -0.5, 1e300, 1e308, 5e-324, float("nan")),
    *(float("inf"), -float("inf"), True, False, None, "1", "", "x", "\ud800", b"1", [], [1], ()),
    *({}, {"a": 1}, set(), object(), object, range(3), len, np.int8(-1), np.uint64(2**64 - 1), 1j),
    *(np.float32(2.0), np.bool_(True), np.array(3), np.datetime64("2020-01-01"), np.array("x")),
    *(np.empty(0), np.empty((0, 2)), np.empty((0, 3)), np.zeros((1, 1)), np.zeros((2, 2, 2))),
    *([[0, 1]], [[0, -1]], [[0, 9]], [[2**31, 2**32]], [[2**62, 1]], [[-(2**63), 0]], [[0.0, 1.0]]),
    *([[0, 1, 2]], [[0], [1]], [0, 1], [-1], [9], [2**40], [[0, 1], [1]], [["a", "b"]]),
    *([[None, 0]], ["a"], [None], np.array([[0, 1]], np.uint64) + np.uint64(2**63)),
    *(np.array([[0, 1]], np.int8), np.array([[True, False]]), np.array([None, {}], object)),
    *(np.array([[0, 1], [1, 0], [0, 0]])[::2], np.array([[0, 1]], object)),
    *(np.full((2, 3), np.nan), np.full((2, 3), np.inf), np.full((2, 3), 1e300), np.ones((3, 3))),
    *(np.ones((2, 3), complex), np.zeros((2, 3), "S1"), np.broadcast_to(np.zeros(3), (2, 3))),
    *(np.zeros((2, 7)), np.full((2, 7), -1e300), np.zeros((2, 6)), np.full((2, 6), 1e300)),
    *(np.zeros((1024, 0)), np.zeros((2, 3, 3)), np.zeros((4, 3)), np.zeros(7), np.full(7, np.nan)),
]
TETRAHEDRON = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
TREE = oc.MeshTrees.build(TETRAHEDRON, FACES)
ARRAYS_OF_TREES = oc.MeshTrees.join([TREE] * 2).arrays._asdict()


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
    report = made.check(effects=EFFECTS)
    for name in ("pairs", "verdicts", "accuracies"):
        assert not getattr(report, name).flags.writeable
    return report.names(), report.colliding


def about_trees(**given: Any) -> Any:
    """Ask about trees with other arrays; a number takes the place of the last one of its array."""
    for name, value in given.items():
        if np.ndim(value) == 0:
            given[name] = ARRAYS_OF_TREES[name].copy()
            with suppress(*ERRORS, OverflowError):  # no such number
                given[name][-1] = value
    bodies = oc.PlacedMeshes(oc.MeshTrees(**given), [0, 1], np.zeros((2, 3)), [np.eye(3)] * 2)
    return oc.verdicts(bodies, bodies, [[0, 1]]), bodies.trees.boxes(0, 3)


MORE = {
    "added": Call(
        added,
        {"vertices": TETRAHEDRON, "faces": FACES, "scale": [1.0] * 3, "max_points": 4}
        | {"max_distance": 1.0, "horizon": 1.0, "margin": 0.1},
    ),
    "about trees": Call(about_trees, ARRAYS_OF_TREES),
}


#: Refusals that name something else: a file, or what an argument makes too large.
UNNAMED = re.compile("not a regular file|must not exceed|offsets must be from")


def check_refusal(error: Exception, label: str, name: str) -> None:
    """Assert that a refusal is short and names an argument; lengths are told of others, too."""
    text = str(error)
    assert not type(error).__module__.startswith("numba"), (label, name, text)
    assert "._" not in text, text
    assert len(text) < 1000
    if label in MORE or UNNAMED.search(text):
        return
    assert isinstance(error, ERRORS), (label, name, text)
    words = [name, *CALLS[label].good] if re.search("length|shape|one row", text) else [name]
    words = ["index", "accuracy", "effect", "does not exist", "utf-8", *words]
    assert any(re.search(rf"\b{word.rstrip('s')}", text) for word in words), (label, name, text)


#: One value in so many is tried of each argument; all of them take a minute or two.
@pytest.mark.parametrize("step", [7, pytest.param(1, marks=pytest.mark.slow)])
def test_whatever_is_given_is_answered_or_refused_by_name(step: int) -> None:
    """Nothing that is handed to the library ends the process, or is read out of bounds."""
    number = 0
    for label, (function, good) in {**CALLS, **MORE}.items():
        if label in MORE or CALLS[label].works:
            function(**good)
        for name in good if label != "set_threads" else ():
            for wrong in HOSTILE[number % step :: step]:
                try:
                    with warnings.catch_warnings():
                        warnings.simplefilter("ignore")
                        function(**{**good, name: wrong})
                except (*ERRORS, IndexError) as error:
                    check_refusal(error, label, name)
            number += 1


#: A region may be without an end; of a cloud, points that are no numbers are left out.
TAKEN = (
    *("regions.Region minimum", "points_inside points", "shapes.Cloud points"),
    "RobotScene.own_points points",
    "Scene.obstacle_points = obstacle_points",
)


@each("number", [np.nan, -np.inf])
@each("label", [label for label, call in CALLS.items() if call.works])
def test_what_is_no_number_is_refused_by_name(label: str, number: float) -> None:
    function, good = CALLS[label]
    for name, value in good.items():
        numbers = np.array(value, float) if is_numeric(value) else np.empty(0)
        if numbers.size and f"{label} {name}" not in TAKEN:
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
        refused(rf"^{name} .*in row {row}\b", oc.Boxes, **bad)


@each("by", [1.1e-6, 1e-3, 1.0, 1e3])
def test_no_rotation_that_is_not_orthonormal(by: float) -> None:
    for place in range(9):
        rotation = np.eye(3)
        rotation.reshape(-1)[place] += by
        refused(r"^rotation .*orthonormal", oc.OBB, np.zeros(3), rotation, np.ones(3))


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
    refused(name, call)


def test_a_refused_change_leaves_the_box_as_it_was() -> None:
    box = oc.OBB([1.0, 2.0, 3.0], np.eye(3), [1.0, 2.0, 3.0])
    refused("half_extents", box.set, np.zeros(3), np.eye(3), [1.0, np.nan, 1.0])
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


FAR = 2**40


class Subclass(np.ndarray):
    """An array whose comparisons and copies lie."""

    def __lt__(self, other: Any) -> Any:
        return np.zeros(self.shape, bool)

    __ge__ = __gt__ = __lt__

    def copy(self, *_: Any) -> Any:
        return np.full(self.shape, FAR)

    def __len__(self) -> int:
        return 0


class Wrapped:
    """Anything that becomes an array."""

    def __init__(self, array: np.ndarray) -> None:
        self.array = array

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        return self.array


def mapped(array: np.ndarray, folder: Path) -> np.memmap:
    file = np.memmap(folder / "array", array.dtype, "w+", shape=array.shape)
    file[...] = array
    return np.memmap(folder / "array", array.dtype, "r", shape=array.shape)


def spread(array: np.ndarray) -> np.ndarray:
    """Return an array whose rows and columns are apart in memory, and backwards."""
    wide = np.zeros((2 * len(array), *(3 * size for size in array.shape[1:])), array.dtype)
    view = wide[::-2][(slice(None), *(slice(None, None, 3) for _ in array.shape[1:]))]
    view[...] = array
    return view


KINDS: dict[str, Callable[[np.ndarray, Path], Any]] = {
    "a list": lambda a, _: a.tolist(),
    "in Fortran's order": lambda a, _: np.asfortranarray(a),
    "apart in memory": lambda a, _: spread(a),
    "read-only": lambda a, _: np.frombuffer(a.tobytes(), a.dtype).reshape(a.shape),
    "big-endian": lambda a, _: a.astype(a.dtype.newbyteorder(">")),
    "unaligned": lambda a, _: np.frombuffer(b"\0" + a.tobytes(), a.dtype, -1, 1).reshape(a.shape),
    "of objects": lambda a, _: a.astype(object) if a.dtype.kind == "f" else a.astype(">i4"),
    "memory-mapped": mapped,
    "a subclass that lies": lambda a, _: a.view(Subclass),
    "masked": lambda a, _: np.ma.array(a),
    "wrapped": lambda a, _: Wrapped(a),
    "of another size": lambda a, _: a.astype("f4") if a.dtype.kind == "f" else a.astype("u2"),
}


GIVEN = {**CALLS, "Boxes[rows]": Call(lambda rows: BOXES[rows], {"rows": [1, 0]})}
ARRAYS = [
    (label, name)
    for label, call in GIVEN.items()
    for name, value in call.good.items()
    if call.works and is_numeric(value) and np.ndim(value) and np.size(value)
]


def bits(value: Any, levels: int = 3) -> Any:
    """Return what can be compared of a result: the arrays in it, and where objects are."""
    if isinstance(value, oc.Scene):
        return bits([value.boxes, value.objects.poses_of(value.indices)])
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.tobytes()
    if isinstance(value, (int, float, str, np.generic)):
        return repr(value)
    if isinstance(value, oc.Report) or levels == 0:
        return bits(value.pairs) if levels else None
    if not isinstance(value, (tuple, list)):
        names = getattr(value, "__dict__", getattr(value, "__slots__", ()))
        value = [getattr(value, name) for name in names]
    return [bits(part, levels - 1) for part in value]


@each("kind", KINDS)
@each("label, name", ARRAYS)
def test_arrays_of_every_kind_are_read(label: str, name: str, kind: str, tmp_path: Path) -> None:
    function, good = GIVEN[label]
    if label == "Boxes[rows]" and kind in ("a list", "wrapped"):
        return  # numpy's own rules of indexing
    given = KINDS[kind](np.array(good[name]), tmp_path)
    assert bits(function(**{**good, name: given})) == bits(function(**good))


@each("label, name", ARRAYS)
def test_what_is_given_is_not_kept(label: str, name: str) -> None:
    """What was given can be written afterwards: nothing refers to it."""
    function, good = GIVEN[label]
    given = np.array(good[name])
    found = function(**{**good, name: given})
    given[...] = FAR
    assert bits(found) == bits(function(**good))


def test_indices_that_kernels_follow_cannot_be_written() -> None:
    copies = {name: array.copy() for name, array in ARRAYS_OF_TREES.items()}
    trees = oc.MeshTrees(**copies)
    for name in copies:
        with pytest.raises(ValueError, match="read-only"):
            getattr(trees, name)[...] = 0
        before = getattr(trees, name).copy()
        copies[name][...] = 0
        assert np.array_equal(getattr(trees, name), before)
    for array in (PLACED.meshes, PLACED.trees.children, PLACED.trees.starts):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = FAR


@each("label, name, times", [
    ("verdicts", "pairs", 5000), ("contacts", "pairs", 500), ("verdicts of meshes", "pairs", 50),
    ("shapes.Mesh", "faces", 5000), ("Boxes.from_points", "offsets", 1),
    ("Scene.move_indices", "indices", 1),
])  # fmt: skip
def test_indices_may_be_written_by_another_thread(label: str, name: str, times: int) -> None:
    """They are refused, or those of before or after are used; nothing outside is touched."""
    function, good = CALLS[label]
    right = np.repeat(good[name], times, axis=0)
    given, ended, switched = right.copy(), Event(), count()

    def write() -> None:
        while not ended.is_set():
            given.reshape(-1)[-1] = FAR
            given[...] = right
            next(switched)

    writer = Thread(target=write)
    writer.start()
    try:
        answers = 0
        while answers < 20 or next(switched) < 20:
            with suppress(ValueError, KeyError):
                function(**{**good, name: given})
            answers += 1
    finally:
        ended.set()
        writer.join()


@each("number", [np.nan, np.inf, -np.inf, 1e308, -1e308])
@each("name", ["centers", "rotations", "half_extents"])
def test_boxes_that_are_written_afterwards_lead_nowhere(name: str, number: float) -> None:
    """The answers mean nothing, but no kernel reads or writes outside of its arrays.

    With numba's checks of bounds, an access outside raises IndexError.
    """
    rng = np.random.default_rng(5)
    poses = np.column_stack([rng.normal(size=(100, 3)), np.tile([0.0, 0.0, 0.6, 0.8], (100, 1))])
    written = oc.Boxes.from_poses(poses, np.full((100, 3), 0.2))
    getattr(written.arrays, name).reshape(100, -1)[rng.integers(0, 100, 30), 0] = number
    with np.errstate(all="ignore"):
        for rows in (oc.find_pairs(written), oc.find_pairs(written, written)):
            assert ((rows >= 0) & (rows < 100)).all()
        oc.any_collision(written)
        found = oc.points_inside(written, rng.normal(size=(1000, 3)))
        assert ((found.nearest >= -1) & (found.nearest < 1000)).all()


BAD_NAMES = ["", "\ud800/1", "a\x00b", "a\nb", "\x1b[31m", "a\u2028b", "a\x85", "x" * 10**6]


@each("name", [*BAD_NAMES, None, 3, b"a", ["a"]])
def test_what_is_no_name_is_refused_in_one_printable_line(name: Any) -> None:
    made = oc.Scene()
    for ask in (check_name, lambda name, _: made.add(name, Sphere(1.0))):
        with pytest.raises(ValueError, match=r"^name must ") as error:
            ask(name, "name")
        assert str(error.value).isprintable()
        assert len(str(error.value)) < 200
    assert len(made) == 0


@each("name", ["a", "gripper/1", "Ünïcode 物 🎲", "/5", " ", "x" * MAX_NAME])
def test_other_names_stay_as_they_are(name: str) -> None:
    assert check_name(name, "name") == name


class Sulky:
    """Can't be shown."""

    def __repr__(self) -> str:
        raise RuntimeError("no")


@each("value", [
        "x" * 10**6, "\ud800", 10**5000, dict.fromkeys(range(99), "a" * 99), np.zeros((99, 99)),
        [[["\n"] * 99] * 99] * 99, Sulky(), None, b"\x00" * 999,
    ])  # fmt: skip
def test_values_are_shown_in_a_short_line(value: Any) -> None:
    text = shown(value)
    assert 0 < len(text) <= MAX_SHOWN
    assert text.isprintable()
    text.encode()


def test_values_just_short_enough_are_shown_whole_and_what_is_not_printable_is_escaped() -> None:
    value = ["x" * 36, "x" * 36]
    assert (len(repr(value)), shown(value)) == (MAX_SHOWN, repr(value))
    assert shown(["x" * 36, "x" * 37]) == repr(value)[:-3] + "..."
    assert printable("a\nb\x00\ud800 é") == "a\\nb\\x00\\ud800 é"
