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

"""A scene that changed is the scene built anew, bit for bit, and its steps leak no memory."""

from __future__ import annotations

import dataclasses
import gc
import tracemalloc
from typing import Any
from unittest.mock import Mock

import numba
import numpy as np
import pytest
from each import each
from mesh_zoo import zoo
from scenes import random_poses
from scipy.spatial.transform import Rotation
from support import by_threads

import obb_collision as oc
from obb_collision.scene import checker
from obb_collision.shapes import Box, Capsule, Cylinder, Hull, Mesh, Sphere

SHAPES = (
    *(Box([0.3, 0.5, 0.8]), Box([0.6, 0.6, 0.6]), Sphere(0.3), Capsule(0.2, 0.5)),
    *(Cylinder(0.3, 0.4), Mesh(*zoo()["torus0"])),
    Hull(np.random.default_rng(3).normal(size=(12, 3)) * 0.2),
    Mesh(np.random.default_rng(4).normal(size=(9, 3)) * 0.2, np.empty((0, 3), np.int64)),
)
ALL_LEVELS = [level.label for level in oc.Accuracy]
PATTERNS = ("*", "0/*", "1/*", "2/*", "0/3", "1/1", "?/1*")
EFFECTS = ("separations", "contacts", "clearance")
#: How often each change is made.
SHARES = {
    "add": 0.2, "move": 0.28, "many": 0.05, "remove": 0.1, "enable": 0.08, "accuracy": 0.1,
    "sphere": 0.06, "all": 0.02, "padding": 0.03, "rule": 0.08,
}  # fmt: skip


class Twin:
    """A scene and what it takes to build it anew."""

    def __init__(self, seed: int, settings: Any, count: int, is_plain: bool = False) -> None:
        """Add so many objects; is_plain: none has a level of its own, now or later."""
        self.is_plain = is_plain
        self.rng, self.spread = np.random.default_rng(seed), 0.3 * count ** (1 / 3)
        self.settings = settings
        self.scene = oc.Scene(**settings)
        self.objects: dict[str, dict[str, Any]] = {}
        self.serial = 0
        for _ in range(count):
            self.add()

    def pose(self) -> list[float]:
        places = self.rng.uniform(-self.spread, self.spread, 3)
        if self.rng.random() < 0.3:
            return [*np.round(places, 1), 0.0, 0.0, 0.0, 1.0]  # exact contacts
        turn = Rotation.random(random_state=int(self.rng.integers(1 << 30))).as_quat()
        return [*places, *(turn * self.rng.choice([1.0, 0.95, 1.05]))]

    def level(self, none: float) -> str | None:
        """Return a level at random; none: how likely there is none."""
        if self.is_plain or self.rng.random() < none:
            return None
        return str(self.rng.choice(ALL_LEVELS[1:]))

    def add(self) -> None:
        taken = list(self.objects)
        if taken and self.rng.random() < 0.2:
            name = taken[self.rng.integers(len(taken))]  # in place of another
        else:
            name = f"{self.serial % 3}/{self.serial}"
            self.serial += 1
        padding = None if self.rng.random() < 0.7 else float(self.rng.choice([0.0, 0.01, 0.1]))
        shape, level = SHAPES[self.rng.integers(len(SHAPES))], self.level(0.6)
        made: dict[str, Any] = {"shape": shape, "pose": self.pose()}
        made |= {"padding": padding, "accuracy": level}
        self.scene.add(name, **made)
        self.objects[name] = {**made, "enabled": True}

    def set_level(self, name: str, level: str | None) -> None:
        self.scene.set_accuracy(name, level)
        self.objects[name]["accuracy"] = level

    def set_all(self, setting: str, value: Any) -> None:
        setattr(self.scene, setting, value)
        self.settings[setting] = value

    def change(self) -> None:
        """Do one thing at random."""
        names = list(self.objects)
        name = names[self.rng.integers(len(names))] if names else ""
        what = self.rng.choice(list(SHARES), p=list(SHARES.values()))
        if self.is_plain and what in ("accuracy", "sphere", "all"):
            what = "many"
        if what == "add" or not names:
            self.add()
        elif what in ("move", "many"):
            some = [name] if what == "move" else names[:: self.rng.integers(1, 4)]
            poses = [self.pose() for _ in some]
            self.scene.move(some, poses)
            for one, pose in zip(some, poses, strict=True):
                self.objects[one]["pose"] = pose
        elif what == "remove":
            self.scene.remove(name)
            del self.objects[name]
        elif what == "enable":
            enabled = bool(self.rng.random() < 0.5)
            self.scene.set_enabled(name, enabled)
            self.objects[name]["enabled"] = enabled
        elif what == "accuracy":
            self.set_level(name, self.level(0.4))
        elif what == "sphere":
            spheres = [some for some in names if self.objects[some]["accuracy"] == "sphere"]
            self.set_level(*((spheres[0], None) if spheres else (name, "sphere")))
        elif what == "all":
            self.set_all("accuracy", str(self.rng.choice(ALL_LEVELS)))
        elif what == "padding":
            self.set_all("padding", float(self.rng.choice([0.0, 0.02])))
        elif self.rng.random() < 0.3:
            self.scene.rules.allowed = self.scene.rules.allowed[1:]
        else:
            a, b = self.rng.choice(PATTERNS, 2)
            self.scene.allow(str(a), str(b), bool(self.rng.random() < 0.6))

    def anew(self) -> oc.Scene:
        """Return a scene made of what this one has now, with the same indices."""
        scene = oc.Scene(**self.settings)
        scene.rules.allowed = self.scene.rules.allowed
        where = {self.scene.index(name): name for name in self.objects}
        for slot in range(max(where, default=-1) + 1):
            if slot not in where:
                scene.add(f"gap/{slot}", SHAPES[0])
                continue
            made = dict(self.objects[where[slot]])
            enabled = made.pop("enabled")
            assert scene.add(where[slot], **made) == slot
            scene.set_enabled(where[slot], enabled)
        for name in set(scene.names) - set(self.objects):
            scene.remove(name)
        return scene


def assert_same(report: oc.Report, anew: oc.Report, effects: tuple[str, ...] = EFFECTS) -> None:
    """Compare all that two reports say, bit for bit."""
    assert report.names() == anew.names()
    assert (report.total, report.truncated) == (anew.total, anew.truncated)
    for name in ("pairs", "verdicts", "accuracies"):
        assert getattr(report, name).tobytes() == getattr(anew, name).tobytes(), name
    assert report.colliding.nonzero()[0].tolist() == anew.colliding.nonzero()[0].tolist()
    for effect in effects:
        levels = report.accuracies_of(effect), anew.accuracies_of(effect)
        assert levels[0].tolist() == levels[1].tolist(), effect
        ours, theirs = report.result(effect), anew.result(effect)
        for field in dataclasses.fields(ours):
            a, b = getattr(ours, field.name), getattr(theirs, field.name)
            assert np.asarray(a).tobytes() == np.asarray(b).tobytes(), (effect, field.name)


CASES: list[tuple[dict[str, Any], int]] = [
    ({}, 70), ({"accuracy": "mesh"}, 64), ({"max_pairs": 120}, 65),
    *(({"exact": exact}, count) for exact in (False, True) for count in (2, 63, 64, 65, 250)),
]  # fmt: skip


@each("settings, count", CASES)
@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 6))]
)
def test_a_changed_scene_is_one_built_anew(seed: int, settings: dict[str, Any], count: int) -> None:
    twin = Twin(seed, dict(settings), count, is_plain="exact" in settings)
    pairs = 0
    for _ in range(12):
        for _ in range(twin.rng.integers(1, 3)):
            twin.change()
        report = twin.scene.check(effects=EFFECTS)
        assert_same(report, twin.anew().check(effects=EFFECTS))
        pairs += len(report)
    assert pairs > 3 * count or count == 2


def with_effects(scene: oc.Scene, level: str) -> oc.Scene:
    """Return a scene whose effects are of a level, with points."""
    for name in (*EFFECTS, "points"):
        scene.set_effect(name, accuracy=level)
    scene.obstacle_points = np.random.default_rng(0).uniform(-1.2, 1.2, (50, 3))
    return scene


@each("level", ALL_LEVELS)
def test_a_report_is_of_its_check_whatever_changes_until_it_is_read(level: str, pairs: int) -> None:
    for seed in range(pairs // 150):
        twin = Twin(seed, {"accuracy": level}, 12)
        effects = str(twin.rng.choice(["pairs", "obb", "hull", "mesh"]))
        with_effects(twin.scene, effects)
        report, anew = twin.scene.check(), with_effects(twin.anew(), effects).check()
        read = twin.rng.permutation((*EFFECTS, "points"))[: twin.rng.integers(5)].tolist()
        for effect in read:
            report.result(effect)
            anew.result(effect)
        what = twin.rng.integers(3)
        if what:
            twin.scene.query(SHAPES[5], twin.pose())
        if what == 1:  # the same report, as nothing has changed
            report = twin.scene.check((*EFFECTS, "points"))
        for _ in range(twin.rng.integers(4)):
            twin.change()
        if twin.rng.random() < 0.3:
            twin.scene.clear()
            for shape in (SHAPES[6], SHAPES[5], SHAPES[0]):
                twin.scene.add(f"new/{type(shape)}", shape, twin.pose())
        if twin.rng.random() < 0.5:
            twin.scene.check(("contacts", "clearance"))
        assert_same(report, anew, (*EFFECTS, "points"))


def test_a_box_of_another_size_beside_a_mesh_is_not_what_it_was() -> None:
    scene, unit = oc.Scene(accuracy="mesh"), np.ones((1, 3))
    scene.add("ring", SHAPES[5])
    box = scene.objects.begin_boxes(["box"], 1e-3 * unit, np.array([[0, 0, 0, 0, 0, 0, 1.0]]))
    assert scene.check().names() == []  # in the hole
    half = 2.0 * np.abs(scene.obb("ring").half_extents)
    for size, found in ((half[None] - 1e-3, [("ring", "box")]), (1e-3 * unit, [])):
        scene.objects.resize_boxes(box, size)
        assert scene.check().names() == found


def test_what_leaves_a_region_before_a_query_has_left_it() -> None:
    scene = oc.Scene(region=oc.regions.Region([-5, -5, -5], [5, 5, 5], halo=1.0))
    for name in "ab":
        scene.add(name, SHAPES[0])
    assert scene.check().names() == [("a", "b")]
    scene.move("b", [50, 0, 0, 0, 0, 0, 1])
    scene.query(SHAPES[0])
    assert scene.check().names() == []


#: Steps of which the memory is measured, several times: what grows does so each time, which caches
#: that fill and other threads do not.
STEPS, TIMES = 100, 6


def boxes_at(poses: np.ndarray, exact: bool = False, seed: int = 0) -> oc.Scene:
    """Return boxes of sizes that depend on the seed alone, some of which rest on one another."""
    scene = oc.Scene(exact=exact)
    sizes = np.random.default_rng(seed).choice([0.0, 0.25, 0.5, 0.7, 1.1], (len(poses), 3))
    scene.add_boxes([f"box/{k}" for k in range(len(poses))], sizes, poses)
    return scene


def some_poses(count: int, rng: np.random.Generator, spread: float) -> np.ndarray:
    """Return poses, some on a grid, where boxes touch, and quaternions not quite of length 1."""
    poses = random_poses(count, rng, spread)
    resting = rng.random(count) < 0.4
    poses[resting, :3] = np.round(poses[resting, :3], 1)
    poses[resting, 3:] = 0.0, 0.0, 0.0, 1.0
    poses[:, 3:] *= rng.choice([1.0, 0.95, 1.05], (count, 1))
    return poses


def test_places_and_effects_have_the_same_bits_for_any_number_of_threads() -> None:
    rng = np.random.default_rng(10)
    start, end, far = some_poses(900, rng, 4.0), some_poses(900, rng, 4.0), np.zeros((5000, 7))
    far[:, :3], far[:, 6] = 9.0, 1.0
    many = some_poses(5000, rng, 9.0)
    expected = oc.Boxes.from_poses(many, np.zeros((5000, 3)))

    def seen() -> list[bytes]:
        scene = boxes_at(far)
        scene.move_indices(np.arange(5000), many)
        assert (scene.boxes.centers == expected.centers).all()
        assert (scene.boxes.rotations == expected.rotations).all()
        scene = boxes_at(start)
        scene.objects.set_twists(scene.indices, np.ones((900, 6)))
        scene.check("sweep")
        scene.move_indices(scene.indices, end)
        report = scene.check(("separations", "contacts", "clearance", "sweep"))
        assert len(report) > 500
        swept = (report.swept.passed, report.swept.predicted)
        tables = (report.result("separations"), report.contacts, report.clearances, *swept)
        assert all(len(table) > 100 for table in tables)
        return [column.tobytes() for table in tables for column in vars(table).values()]

    one, two, five = by_threads(seen, 1, 2, 5)
    assert one == two == five


def test_what_nothing_has_changed_about_is_found_once(monkeypatch: pytest.MonkeyPatch) -> None:
    find = Mock(side_effect=checker.Checker.find)
    monkeypatch.setattr(checker.Checker, "find", lambda *given: find(*given))
    scene = boxes_at(some_poses(300, np.random.default_rng(9), 3.0))
    scene.check("contacts")
    for _ in range(5):  # nobody holds the report before
        report = scene.check("contacts")
        assert report.costs["contacts"].count == 0, "nor is the effect computed again"
        assert len(report.contacts) == len(report) > 0
        assert report.names() == boxes_at(scene.objects.poses_of(scene.indices)).check().names()
    assert find.call_count == 6
    scene.set_effect("contacts", max_points=8)
    assert scene.check("contacts").costs["contacts"].count == len(report)


BOTH = "separations", "contacts"


@pytest.mark.skipif(
    numba.version_info.short < (0, 60),
    reason="arguments of kernels settle in free lists after some 10,000 steps only",
)
@each("count, share, effects", [(20, 1.0, BOTH), (20, 0.0, BOTH), (99, 1.0, ()), (99, 0.05, BOTH)])
def test_steps_leak_no_memory(count: int, share: float, effects: tuple[str, ...]) -> None:
    rng = np.random.default_rng(count)
    frames = [random_poses(count, rng, 0.5 * count ** (1 / 3)) for _ in range(4)]
    scene = boxes_at(frames[0])
    moved = np.flatnonzero(rng.random(count) < share)
    reports = [scene.check(effects)]

    def run(steps: int) -> None:
        for step in range(steps):
            scene.move_indices(moved, frames[step % 4][moved])
            if len(moved) == 0:  # the report before is in use only while objects move
                reports.clear()
            reports[:] = [scene.check(effects)]

    run(40)  # what the first steps allocate for good
    gc.collect()
    tracemalloc.start()
    try:
        sizes = []
        run(5 * STEPS)  # replaces what was there before it was traced
        for _ in range(1 + TIMES):
            run(STEPS)
            gc.collect()
            sizes.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    grown = min(np.diff(sizes))
    assert grown < STEPS * 32, f"{grown / STEPS} bytes a step: less than any object takes"
