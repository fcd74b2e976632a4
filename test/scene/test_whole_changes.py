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

"""A change of a scene either happens or does not: interrupts at any line, and the end of memory."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from linecache import getline
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest
from each import each
from processes import run_python
from scenes import at, random_poses

import obb_collision as oc
from obb_collision.scene import checker
from obb_collision.scene.store import placing, store
from obb_collision.shapes import Box, Capsule, Mesh, Sphere

PACKAGE = str(Path(oc.__file__).parent)
CORNERS = np.array([[0, 0, 0.8], [1, 0, 0], [0, 1, 0], [-1, -1, 0]])
PYRAMID = Mesh(CORNERS, np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]))


def scene_before(prepared: str) -> tuple[oc.Scene, oc.Report]:
    """Return a scene that has been checked and then prepared, and what the check found."""
    scene = oc.Scene(accuracy="mesh")
    names, poses = [f"box/{k}" for k in range(12)], [at(k) for k in range(12)]
    scene.add_boxes(names, np.full((12, 3), 0.5), poses)
    scene.add("ball", Sphere(0.4), at(0.5))
    scene.add("pyramid", PYRAMID, at(3.0))
    scene.add("own", Capsule(0.2, 0.5), at(5.0), padding=0.1, accuracy="obb")
    scene.add("spare", Box([1, 1, 1]), at(7.0))  # and all 16 slots are taken
    scene.allow("box/1", "*")
    scene.allow("box/2", "box/*")
    report = scene.check()
    PREPARED[prepared](scene)
    return scene, report


def fill(scene: oc.Scene) -> None:
    scene.objects.remove([2, 15])
    scene.add("new", PYRAMID, at(7.5))


def leave(scene: oc.Scene) -> None:
    scene.region = oc.regions.Region([-5, -5, -5], [5, 5, 5], halo=2.0)
    scene.check()
    scene.move("box/4", at(9.0))


SIZES, PLACES = np.ones((2, 3)), np.array([at(1.2), at(6.7)])
LEVELS, BALL = [oc.Accuracy.AABB, None], Sphere(0.5)
Change = Callable[[oc.Scene], Any]
CHANGES: dict[str, Change] = {
    "add": lambda s: s.add("new", PYRAMID, at(6.2), padding=0.01),
    "add in place": lambda s: s.add("pyramid", Sphere(0.3), at(4.4)),
    "add boxes": lambda s: s.add_boxes(["new", "ball"], SIZES, PLACES),
    "add bodies": lambda s: s.add_boxes(["new", "pyramid"], SIZES, PLACES, LEVELS, [BALL, BALL]),
    "begin": lambda s: s.objects.begin_boxes(["n", "m"], SIZES, PLACES, LEVELS, np.array([13])),
    "resize boxes": lambda s: s.objects.resize_boxes(np.array([3, 4]), SIZES),
    "grow": lambda s: s.objects.grow(np.array([3, 5]), np.array([0.3, 0.4])),
    "rename": lambda s: s.objects.rename(np.array([1, 2]), ["box/2x", "other"]),
    "renew": lambda s: s.objects.renew([1, 13]),
    "remove": lambda s: s.remove("pyramid"),
    "remove several": lambda s: s.objects.remove([2, 13, 12]),
    "clear": lambda s: s.clear(),
    "move": lambda s: s.move("pyramid", at(5.1)),
    "move all": lambda s: s.move_indices(s.indices, [at(1.1 * k) for k in range(len(s))]),
    "enable": lambda s: s.set_enabled("ball", False),
    "enable several": lambda s: s.objects.set_enabled([1, 12], [False, False]),
    "padding": lambda s: setattr(s, "padding", 0.3),
    "padding overrides": lambda s: setattr(s.objects, "padding_overrides", [("box/*", 0.3)]),
    "padding of one": lambda s: s.set_padding("ball", 0.3),
    "padding as all": lambda s: s.set_padding("own", None),
    "accuracy": lambda s: setattr(s, "accuracy", "aabb"),
    "accuracy of one": lambda s: s.set_accuracy("pyramid", "sphere"),
    "accuracy as all": lambda s: s.set_accuracy("own", None),
    "allow": lambda s: s.allow("box/2", "box/*", False),
    "allowed": lambda s: setattr(s.rules, "allowed", [("pyramid", "*", True)]),
    "check only": lambda s: setattr(s.rules, "check_only", [("pyramid", "*")]),
    "allowed within": lambda s: setattr(s.rules, "allowed_within", ["box"]),
    "region": lambda s: setattr(s, "region", oc.regions.Region([-5] * 3, [2.2, 5, 5], halo=2.0)),
    "max pairs": lambda s: setattr(s, "max_pairs", 2),
    "effect": lambda s: s.set_effect("clearance", "on", max_distance=0.2),
    "twist": lambda s: s.set_twist("ball", [1, 0, 0, 0, 0, 0]),
    "query": lambda s: s.query(PYRAMID, at(6.0)),
    "query of a box": lambda s: s.query(Box([1, 1, 1]), at(6.0), padding=0.1),
    "check": lambda s: s.check(["contacts", "clearance"]),
    "ask": lambda s: s.any_collision(),
}
#: What is asked, and what a scene has whose effects show none of it.
NO_CHANGE = ("query", "query of a box", "check", "ask", "renew", "twist")
#: What comes before a change: nothing; changes not checked yet; and a region.
PREPARED: dict[str, Change] = {"checked": lambda s: None, "changed": fill, "region": leave}


def seen(scene: oc.Scene) -> list[Any]:
    """Return what can be seen of a scene."""
    boxes, names = scene.boxes, scene.names
    report = scene.check(["contacts", "clearance"])
    return [
        *(names, scene.indices.tolist(), scene.rules.allowed, scene.padding, scene.accuracy),
        scene.objects.poses_of(scene.indices).tolist(),
        *(scene.rules.check_only, scene.rules.allowed_within),
        *(boxes.centers.tolist(), boxes.rotations.tolist(), boxes.half_extents.tolist()),
        *([scene.objects.shape_of(name) for name in names], scene.region, scene.max_pairs),
        *(report.names(), report.accuracies.tolist(), report.verdicts.tolist()),
        *(report.contacts.depths.tolist(), report.clearances.distances.tolist()),
        *(scene.objects.near.tolist(), scene.query(PYRAMID, at(2.5)), scene.any_collision()),
    ]


def seen_later(scene: oc.Scene) -> list[Any]:
    """Return what can be seen now, and after more changes."""
    found = seen(scene)
    scene.add_boxes(["late/1", "late/2"], np.ones((2, 3)), [at(2.2), at(4.2)])
    scene.remove("late/1")
    scene.check()
    for k in range(3):
        scene.add(f"late/{k + 3}", PYRAMID if k else Box([1, 1, 1]), at(k + 0.7))
    scene.padding, scene.accuracy = 0.05, "hull"
    scene.move_indices(scene.indices[:3], [at(2.0 * k) for k in range(len(scene.indices[:3]))])
    return found + seen(scene)


@cache
def seen_untouched(prepared: str) -> list[Any]:
    """Return what is seen later of a scene that was prepared and not changed."""
    scene, _report = scene_before(prepared)  # which stays in use
    return seen_later(scene)


def lines_of(change: Callable[[], Any], stop: int = -1) -> list[tuple[str, int]]:
    """Make a change and return the lines of the package it goes through; it is interrupted at one.

    stop: the number of that line, -1 for none.
    """
    lines: list[tuple[str, int]] = []

    def trace(frame: FrameType, event: str, _: Any) -> Any:
        if not frame.f_code.co_filename.startswith(PACKAGE):
            return None
        line = frame.f_code.co_filename, frame.f_lineno
        # the interpreter lets no interrupt come where it leaves a lock
        if event == "line" and not getline(*line).lstrip().startswith("with "):
            lines.append(line)
            if len(lines) - 1 == stop:
                raise KeyboardInterrupt
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        with suppress(KeyboardInterrupt):
            change()
    finally:
        sys.settrace(before)
    return lines


@each("prepared", PREPARED)
@each("name", CHANGES)
def test_an_interrupted_change_has_happened_or_not(name: str, prepared: str, pairs: int) -> None:
    warm, report = scene_before(prepared)
    CHANGES[name](warm)  # loads kernels, which is not what is interrupted here
    after, kept = scene_before(prepared)  # with a report in use, as later
    lines = lines_of(partial(CHANGES[name], after))
    del kept
    allowed = seen_untouched(prepared), seen_later(after)
    assert (allowed[0] == allowed[1]) == (name in NO_CHANGE)
    separations = report.separations.tolist()
    # the first and the last time that it comes to each line
    backwards = {line: len(lines) - 1 - n for n, line in enumerate(reversed(lines))}
    stops = sorted({*backwards.values(), *{line: n for n, line in enumerate(lines)}.values()})
    assert stops
    step = max(1, 90000 // pairs)
    for stop in stops[sum(map(ord, name + prepared)) % step :: step]:
        tried, report = scene_before(prepared)
        where = lines_of(partial(CHANGES[name], tried), stop)[-1]
        assert seen_later(tried) in allowed, where
        assert report.separations.tolist() == separations, where


def interrupt(*_: Any, **__: Any) -> None:
    raise KeyboardInterrupt


def two_boxes() -> oc.Scene:
    """Return a scene of two boxes apart, which has been checked."""
    scene = oc.Scene()
    scene.add_boxes(["a", "b"], np.ones((2, 3)), [at(0), at(5)])
    assert len(scene.check()) == 0
    return scene


def test_a_check_that_is_interrupted_loses_no_pair_later(monkeypatch: pytest.MonkeyPatch) -> None:
    poses = random_poses(200, np.random.default_rng(0), 2.0)
    scene = oc.Scene()
    scene.add_boxes([f"box/{k}" for k in range(200)], np.full((200, 3), 0.7), poses)
    pairs = scene.check().pairs
    assert len(pairs) > 100
    for k in range(200):  # so many that bounds are made anew
        scene.add(f"far/{k}", Box([0.1, 0.1, 0.1]), [100.0 + k, 0, 0, 0, 0, 0, 1])

    monkeypatch.setattr(checker, "run", interrupt)
    with pytest.raises(KeyboardInterrupt):
        scene.check()
    monkeypatch.undo()
    scene.check()
    for k in range(200):
        scene.move_indices([k], poses[[k]] + [1e-12, 0, 0, 0, 0, 0, 0])
        assert scene.check().pairs.tolist() == pairs.tolist(), k


def test_the_last_pose_of_an_object_counts_whatever_its_quaternion() -> None:
    # of unit length, but its rotation is not orthonormal to rounding
    loose = [0.8566620481794672, 0.0032782832822633614, 0.5158672540068304, 0.0006035819197282833]
    poses = np.array([[5.0, 0, 0, *loose], [1.0, 0, 0, 0, 0, 0, 1]])
    scene = oc.Scene()
    scene.add("box", Box([1, 1, 1]))
    for rows in ([0, 1], [1, 0], [0, 1], [1, 1], [0, 0], [1, 0]):  # some are where it is
        scene.check()
        scene.move_indices([0, 0], poses[rows])
        assert scene.objects.poses_of([0])[0].tolist() == poses[rows[-1]].tolist()
        assert scene.boxes.centers[0].tolist() == poses[rows[-1], :3].tolist()


@each("quaternion", [(0, 0, 0, 1), (0, 0, 0, 2)])
@pytest.mark.filterwarnings("ignore:poses .quaternion. far from unit length")
def test_interrupted_moves_can_be_redone(monkeypatch: pytest.MonkeyPatch, quaternion: Any) -> None:
    scene = two_boxes()
    monkeypatch.setattr(store, "run", interrupt)
    monkeypatch.setattr(placing, "place_boxes", interrupt)
    with pytest.raises(KeyboardInterrupt):
        scene.move("b", [0.5, 0, 0, *quaternion])
    monkeypatch.undo()
    scene.move("b", [0.5, 0, 0, *quaternion])
    assert scene.check().names() == [("a", "b")]


def test_what_is_checked_is_kept_before_it_counts_as_such(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = two_boxes()
    scene.move("b", at(0.5))
    settle = store.ObjectStore.settle

    def settle_and_interrupt(one: store.ObjectStore) -> None:
        settle(one)
        raise KeyboardInterrupt

    monkeypatch.setattr(store.ObjectStore, "settle", settle_and_interrupt)
    with pytest.raises(KeyboardInterrupt):
        scene.check()
    monkeypatch.undo()
    assert scene.check().names() == [("a", "b")]


#: Makes a row of boxes that fill their arrays, each of which meets the next, and changes it with a
#: little more memory than it has, in steps of some MiB, until each change has been possible.
SCRIPT = """
import ctypes
import resource
import numpy as np
import obb_collision as oc

FREE = resource.getrlimit(resource.RLIMIT_AS)
FAR = [0, 9, 0, 0, 0, 0, 1]

def used():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[0]) * resource.getpagesize()

def row(count):
    scene, poses = oc.Scene(), np.zeros((count, 7))
    poses[:, 0], poses[:, 6] = 0.9 * np.arange(count), 1.0
    names, sizes, every = [str(k) for k in range(count)], np.ones((count, 3)), np.arange(count)
    scene.add_boxes(names, sizes, poses)
    return scene, [
        lambda: scene.add("new", oc.shapes.Box([1, 1, 1]), FAR),
        lambda: scene.add_boxes(["more", "0"], 0.5 * sizes[:2], [FAR, FAR]),
        lambda: scene.add_boxes(names, 0.95 * sizes, poses),
        lambda: scene.move_indices(every, poses + [0, 1, 0, 0, 0, 0, 0]),
        lambda: setattr(scene, "padding", 0.001),
        lambda: scene.objects.remove(every[::2]),
        lambda: scene.query(oc.shapes.Box([1, 1, 1])),
    ]

def state(scene):
    boxes = scene.boxes
    arrays = boxes.centers, boxes.half_extents, scene.objects.poses_of(scene.indices)
    seen = scene.names, scene.padding, len(scene.check())
    return [*seen, *(hash(array.tobytes()) for array in arrays)]

scene, changes = row(3000)
for change in changes:  # kernels need memory, too
    change()
    state(scene), scene.check().depths

scene, changes = row(131072)
assert len(scene.check()) == 131071
failed = 0
for number, change in enumerate(changes):
    before, report = state(scene), scene.check()
    old, pairs = scene.boxes, report.pairs.copy()
    depths = oc.separations(old, old, pairs).separations if scene.indices[-1] < len(scene) else None
    for mebibytes in range(0, 800, STEP):
        ctypes.CDLL(None).malloc_trim(0)  # what the allocator keeps would do for some changes
        resource.setrlimit(resource.RLIMIT_AS, (used() + (mebibytes << 20), FREE[1]))
        try:
            change()
            break
        except MemoryError:
            failed += 1
        finally:
            resource.setrlimit(resource.RLIMIT_AS, FREE)
        assert state(scene) == before, (number, mebibytes)
    assert mebibytes < 800 - STEP, number
    assert depths is None or (report.separations == depths).all(), number
print(failed)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory as Linux has them")
def test_a_change_without_memory_for_it_does_not_happen() -> None:
    found = run_python("-c", SCRIPT.replace("STEP", "20"), OBB_COLLISION_THREADS="1")
    assert int(found.stdout) > 5
