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

"""A change of a scene either happens or does not, should memory end."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from types import FrameType
from typing import Any

import numpy as np
import pytest
from each import each
from processes import run_python
from scenes import at

import obb_collision as oc
from obb_collision.shapes import Box, Capsule, Mesh, Sphere

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
    "check": lambda s: s.check(),
    "ask": lambda s: s.any_collision(),
}
#: What is asked, and what a scene has whose effects show none of it.
NO_CHANGE = ("query", "query of a box", "check", "ask", "renew", "twist")
#: Calls that take memory in proportion to what they are given.
ALLOCATING = {
    *("array", "asarray", "empty", "empty_like", "zeros", "ones", "arange", "concatenate", "copy"),
    *("astype", "tolist", "repeat", "nonzero", "take", "sort", "argsort", "lexsort", "where"),
}
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


def calls_of(change: Callable[[], Any], stop: int = -1) -> list[str]:
    """Make a change; return the calls by which it allocates, of which one finds no memory.

    stop: the number of that call, -1 for none.
    """
    calls: list[str] = []

    def profile(frame: FrameType, event: str, function: Any) -> None:
        if event != "c_call" or function.__name__ not in ALLOCATING:
            return
        calls.append(f"{frame.f_code.co_filename}:{frame.f_lineno} {function.__name__}")
        if len(calls) - 1 == stop:
            raise MemoryError

    before = sys.getprofile()
    sys.setprofile(profile)
    try:
        with suppress(MemoryError):
            change()
    finally:
        sys.setprofile(before)
    return calls


@each("prepared", PREPARED)
@each("name", CHANGES)
def test_a_change_that_finds_no_memory_has_not_happened(
    name: str, prepared: str, pairs: int
) -> None:
    warm, report = scene_before(prepared)
    CHANGES[name](warm)  # loads kernels, which take memory, too
    after, kept = scene_before(prepared)  # with a report in use, as later
    calls = calls_of(partial(CHANGES[name], after))
    del kept
    before, seen_after = seen_untouched(prepared), seen_later(after)
    assert (before == seen_after) == (name in NO_CHANGE)
    separations = report.separations.tolist()
    first = {call: stop for stop, call in reversed([*enumerate(calls)])}
    stops, step = sorted(first.values()), max(1, 20000 // pairs)
    assert stops or name not in ("add", "padding", "remove")
    for stop in stops[sum(map(ord, name + prepared)) % step :: step]:
        tried, report = scene_before(prepared)
        where = calls_of(partial(CHANGES[name], tried), stop)[stop]
        assert seen_later(tried) == before, where
        assert report.separations.tolist() == separations, where


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
        lambda: setattr(scene, "accuracy", "aabb"),
        lambda: scene.objects.rename(every[::2] + 1, [f"other {k}" for k in every[::2]]),
        lambda: scene.objects.set_enabled(every[1::2], False),
        lambda: setattr(scene, "region", oc.regions.Region([-1] * 3, [9] * 3, halo=2.0)),
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
