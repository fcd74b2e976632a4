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

"""Reports: nothing nobody asked for, not more pairs than allowed, and what they say stays true."""

from __future__ import annotations

import itertools
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
import pytest
from each import each
from mesh_zoo import zoo
from scenes import allocated, at, counted
from scipy.spatial.transform import Rotation
from support import refused

import obb_collision as oc
from obb_collision.scene import checker
from obb_collision.scene.broad_phase import find_pairs as pairs
from obb_collision.scene.effects import EFFECTS, separations
from obb_collision.scene.refinement.budget import Budget
from obb_collision.shapes import Box, Cylinder, Mesh, Sphere

pair_separations = vars(separations)["pair_separations"]


def row_of_cubes(count: int = 5, gap: float = 0.75) -> oc.Scene:
    """Return unit cubes along x, each overlapping the next."""
    scene = oc.Scene()
    names = [f"{'odd' if k % 2 else 'even'}/{k}" for k in range(count)]
    scene.add_boxes(names, np.ones((count, 3)), [at(gap * k) for k in range(count)])
    return scene


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Record the pairs of each call of the query of separations."""
    return counted(monkeypatch, separations, "pair_separations", 1)


def test_what_nobody_reads_is_not_computed_and_modes_say_otherwise(calls: list[int]) -> None:
    scene = row_of_cubes()
    report = scene.check()
    assert (len(report), calls, report.costs) == (4, [], {})
    assert report.depths.tolist() == [0.25] * 4
    assert report.normals.shape == report.positions.shape == (4, 3)
    assert calls == [4]
    assert report.costs["separations"].count == 4
    calls.clear()
    scene = row_of_cubes()
    scene.set_effect("separations", "on")
    report = scene.check()
    assert calls == [4]
    scene.set_effect("separations", "off")
    assert scene.check() is not report
    with pytest.raises(ValueError, match="'separations' is off"):
        _ = scene.check().depths
    _ = scene.check(effects=["separations"])
    assert calls == [4]
    scene.set_effect("separations", "auto")
    report = scene.check()
    assert calls == [4]
    assert scene.check(effects=["separations"]) is report
    assert calls == [4, 4]


def test_only_pairs_that_changed_are_computed_again(calls: list[int]) -> None:
    scene = row_of_cubes(200)
    scene.set_effect("separations", "on")
    scene.check()
    scene.move("even/100", at(75.1))
    report = scene.check()
    assert calls == [199, 2]
    assert np.allclose(report.depths[[98, 99, 100, 101]], [0.25, 0.15, 0.35, 0.25], atol=1e-12)
    assert report.costs["separations"].count == 2


def test_boxes_are_copied_only_for_reports_in_use_and_only_where_many_move() -> None:
    scene, rows = row_of_cubes(2000), np.arange(2000)
    copy = 2000 * 12 * 8  # centres and rotations
    frames = [scene.objects.poses_of(rows) + at(0.125 * k, w=0.0) for k in range(6)]
    for _ in range(2):  # the first time something is allocated for good
        scene.move_indices(rows, frames[0])
        report = scene.check()
        one = allocated(lambda: scene.move_indices(rows[:1], frames[1][:1]))
        everything = allocated(lambda: scene.move_indices(rows, frames[2]))
        later = scene.check()
        scene.move_indices(rows[::2], frames[4][::2])
        for k, frame in enumerate((frames[4], frames[2])):
            assert scene.boxes.centers[k::2].tolist() == frame[k::2, :3].tolist()
        assert np.allclose(later.depths, 0.25)
        assert len(report.depths) == len(report) == 1999
        del report, later
        scene.check()
        unused = allocated(lambda: scene.move_indices(rows, frames[3]))
    assert one < copy / 4
    assert everything >= copy > unused


def test_for_reports_in_use_what_few_objects_were_is_noted() -> None:
    scene = row_of_cubes(100)
    reports, expected = [], []
    for k in range(60):  # more of them than have notes, and more notes than there is room for
        reports.append(scene.check())
        expected.append(row_of_cubes(100))
        for j in range(k):
            for name in (f"odd/{1 + 2 * (j % 7)}", f"even/{50 + 2 * (j % 3)}"):
                expected[-1].move(name, at(0.5 + j, 0.01 * j))
        scene.move(f"odd/{1 + 2 * (k % 7)}", at(0.5 + k, 0.01 * k))
        scene.move(f"even/{50 + 2 * (k % 3)}", at(0.5 + k, 0.01 * k))
    for report, scene in zip(reports, expected, strict=True):
        wanted = scene.check()
        assert report.pairs.tolist() == wanted.pairs.tolist()
        assert report.positions.tobytes() == wanted.positions.tobytes()
        assert report.contacts.positions.tobytes() == wanted.contacts.positions.tobytes()


def test_a_report_is_read_while_a_thread_moves_objects(monkeypatch: pytest.MonkeyPatch) -> None:
    reading, moved = threading.Event(), threading.Event()

    def slow(boxes: oc.Boxes, pairs: Any) -> Any:
        reading.set()
        assert moved.wait(60.0)
        return pair_separations(boxes, pairs)

    scene = row_of_cubes(100)
    held = [scene.check(), scene.check()]
    wanted = [row_of_cubes(100).check().positions, row_of_cubes(100).check().positions]
    monkeypatch.setattr(separations, "pair_separations", slow)
    with ThreadPoolExecutor(1) as pool:
        found = pool.submit(lambda: held[0].positions)
        assert reading.wait(60.0)
        for k in range(3):
            scene.move(f"even/{2 * k}", at(0.5 + k))
        moved.set()
        assert found.result(60.0).tobytes() == wanted[0].tobytes()
    scene.move("even/0", at(50.0))
    assert held[1].positions.tobytes() == wanted[1].tobytes()


def test_only_objects_that_call_for_an_effect_get_it(calls: list[int]) -> None:
    scene = row_of_cubes()
    scene.set_effect("separations", objects=["even/4"])
    report = scene.check()
    assert np.isnan(report.depths).tolist() == [True, True, True, False]
    assert calls == [1]
    scene.add("even/4", Box([1, 1, 1]), at(0.5))
    assert np.isfinite(scene.check().depths).sum() == 3
    scene.set_effect("separations", objects="nobody")
    assert np.isnan(scene.check().depths).all()


@each("share", [1.0, 0.5, 0.01, 0.0001])
def test_failures_are_named_and_bounded(share: float, monkeypatch: pytest.MonkeyPatch) -> None:
    count = 10_000
    scene = row_of_cubes(count + 1)
    bad = np.random.default_rng(1).random(count) < share
    bad[7] = True
    calls = []

    def compute(boxes: oc.Boxes, pairs: Any) -> Any:
        calls.append(len(pairs))
        if bad[pairs[:, 0]].any():
            raise ArithmeticError("no answer")
        return pair_separations(boxes, pairs)

    monkeypatch.setattr(separations, "pair_separations", compute)
    report = scene.check("separations")
    assert len(report) == count
    failures, done = report.costs["separations"].failures, ~np.isnan(report.depths)
    most = 16  # failures that are looked for one by one
    assert len(calls) <= 2 * (most + 1) * 14 + 14  # 2^14 > count
    assert not bad[done].any()
    assert (report.depths[done] == 0.25).all()
    assert done.sum() == count - bad.sum() or bad.sum() > most
    first = int(bad.argmax())
    names = f"{scene.name(first)}, {scene.name(first + 1)}"
    assert failures[0] == f"pair {names}: ArithmeticError: no answer"
    assert len(failures) <= most + 14
    if share == 1.0:
        assert len(calls) <= 2 * (most + 14)
        together = [int(text.split(" and ")[1].split()[0]) for text in failures if " and " in text]
        assert sum(together) + len(failures) == count  # none is left unsaid


def test_what_cannot_be_set_is_refused() -> None:
    scene = row_of_cubes()
    before = scene.effects["separations"]
    refused("effect must be one of", scene.set_effect, "nothing")
    refused("must be off, auto or on", scene.set_effect, "separations", "sometimes")
    refused("names or patterns", scene.set_effect, "separations", None, [""])
    refused("has accuracy", scene.set_effect, "separations", "on", limit=3.0)
    refused("effect must be one of", scene.check, effects=["nothing"])
    assert scene.effects["separations"] == before


def test_no_effect_runs_if_all_is_free(monkeypatch: pytest.MonkeyPatch, calls: list[int]) -> None:
    queries = (("contacts", "pair_contacts"), ("clearance", "near_pairs"), ("sweep", "box_sweeps"))
    for module, query in (*queries, ("points", "points_in_bodies")):

        def called(*_: Any, query: str = query, **__: Any) -> None:
            raise AssertionError(query)

        monkeypatch.setattr(f"obb_collision.scene.effects.{module}.{query}", called)
    scene = row_of_cubes(3, gap=5.0)
    for name in EFFECTS:
        scene.set_effect(name, "on")
    scene.check()
    scene.move("odd/1", at(5.25))
    scene.obstacle_points = np.empty((0, 3))
    report = scene.check()
    assert calls == []
    assert all(cost.count == 0 and not cost.failures for cost in report.costs.values())
    assert len(report.depths) == len(report.contacts) == len(report.clearances) == 0
    assert len(report.swept.passed) == len(report.swept.predicted) == 0
    assert report.points_inside.counts.tolist() == [0, 0, 0]


def test_what_is_off_or_not_asked_for_allocates_nothing_of_its_own() -> None:
    scene, rows = row_of_cubes(400), np.arange(400)
    frames = [scene.objects.poses_of(rows) + at(0.01 * k, w=0.0) for k in range(9)]
    peaks = {}
    for k, mode in enumerate(("auto", "off", "on")):
        for name in EFFECTS:
            scene.set_effect(name, mode)
        for frame in frames[2 * k : 2 * k + 2]:  # the first time something is allocated for good
            scene.move_indices(rows, frame)
            peaks[mode] = allocated(scene.check)
    # the report, and which objects were active: no array with a row a pair
    assert abs(peaks["auto"] - peaks["off"]) < 4096 < peaks["on"] - peaks["auto"]
    for name in EFFECTS:
        scene.set_effect(name, "off")
    kept = scene.check()
    copy = 400 * 12 * 8  # centres and rotations
    assert allocated(lambda: scene.move_indices(rows, frames[8])) < copy
    assert len(kept) == 399


def leave_room(monkeypatch: pytest.MonkeyPatch, room: bool) -> None:
    """Let candidates of small scenes be too many to hold, too, unless there is room."""
    for name, value in (("PER_OBJECT", 0), ("PER_PAIR", 1), ("PIECE", 16)):
        monkeypatch.setattr(checker, name, getattr(checker, name) if room else value)


RULES = [("0/*", "1/*", True), ("*/3", "*", True)]


def crowd(seed: int, accuracy: str, **settings: Any) -> oc.Scene:
    """Return piles, a loose heap, a bundle of rods that don't touch, and loners, mixed up."""
    rng = np.random.default_rng(seed)
    scene = oc.Scene(accuracy=accuracy, **settings)
    shapes = [Box([0.5, 0.5, 0.5]), Mesh(*zoo()["torus0"]), Sphere(0.3), Cylinder(0.2, 0.6)]
    turned = [0.0, 0.0, np.sin(np.pi / 8), np.cos(np.pi / 8)]
    for k in rng.permutation(90):
        kind, name = k % 6, f"{k % 3}/{k}"
        pose = [*rng.uniform(-0.1, 0.1, 3), *Rotation.random(random_state=int(k)).as_quat()]
        if kind == 0:
            pose[0] += 10.0
        elif kind == 1:
            pose[0] += 20.0 + 0.3 * k
        elif kind == 3:
            pose[1] += 10.0 + rng.uniform(0.0, 2.0)
        elif kind == 4:
            pose = [30.0 + 0.15 * k, 10.0 - 0.15 * k, 0.0, *turned]
        elif kind == 5:
            pose[2] += 50.0 + 10.0 * k
        shape = Box([20.0, 0.1, 0.1]) if kind == 4 else shapes[k % 4]
        scene.add(name, shape, pose)
    return scene


def assert_some_of(report: oc.Report, everything: oc.Report, most: int) -> None:
    """Compare a report of at most so many pairs with that of all: it has some, and says so."""
    count, rows = len(everything), {pair: row for row, pair in enumerate(everything.names())}
    kept = [rows[pair] for pair in report.names()]
    assert len(kept) == min(count, most)
    assert kept == sorted({*kept})
    for name in ("pairs", "verdicts", "accuracies"):
        assert getattr(report, name).tobytes() == getattr(everything, name)[kept].tobytes(), name
    assert report.truncated == (count > most)
    assert min(count, most + 1) <= report.total <= count
    assert report.colliding.nonzero()[0].tolist() == sorted({*report.pairs.ravel().tolist()})


@each("accuracy", [level.label for level in oc.Accuracy])
@each("room, rules", [(True, RULES), (False, RULES), (False, [])])
def test_a_check_stops_beyond_the_limit_and_says_that_there_are_more(
    room: bool, accuracy: str, rules: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    leave_room(monkeypatch, room)
    scene = crowd(1, accuracy)
    scene.rules.allowed = rules
    everything = scene.check()
    count = len(everything)
    assert count > 100
    for most in (1, 7, 60, count - 1, count, count + 1):
        scene.max_pairs = most
        report = scene.check()
        assert_some_of(report, everything, most)
        scene.move_indices(scene.indices, scene.objects.poses_of(scene.indices))
        assert scene.check().pairs.tolist() == report.pairs.tolist()  # the same again
        assert ("at least" in repr(report)) == report.truncated
        assert len(report.depths) == min(count, most)
    scene.max_pairs = None
    assert len(scene.check()) == count


@each("room", [True, False])
def test_changes_of_a_limited_scene(room: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    leave_room(monkeypatch, room)
    scene, twin = crowd(2, "obb", max_pairs=50), crowd(2, "obb")
    rng = np.random.default_rng(5)
    seen = set()
    for step in range(80):
        name = scene.names[rng.integers(90)]
        where = [10.0, 0.0, 0.0] if step % 40 < 20 else [*rng.uniform(100.0, 200.0, 3)]
        for made in (scene, twin):
            made.move(name, at(*where))
        report, expected = scene.check(), twin.check()
        assert_some_of(report, expected, 50)
        depths = dict(zip(expected.names(), expected.depths.tolist(), strict=True))
        assert report.depths.tolist() == [depths[pair] for pair in report.names()]
        seen.add(report.truncated)
        if step == 60:
            for other in scene.names:
                for made in (scene, twin):
                    made.move(other, [1e3, 0.0, float(scene.index(other)) * 10, 0, 0, 0, 1])
    assert seen == {False, True}


def test_work_and_memory_do_not_grow_with_the_square(monkeypatch: pytest.MonkeyPatch) -> None:
    decided = counted(monkeypatch, pairs, "colliding_keys", 1)
    work, peaks = [], []
    for count in (1500, 3000):
        scene = oc.Scene(max_pairs=1000)
        poses = np.outer(1e-6 * np.arange(count), np.eye(7)[0]) + np.eye(7)[6]
        scene.add_boxes([f"{k}" for k in range(count)], np.ones((count, 3)), poses)
        scene.check()  # whatever is made once
        scene.move_indices([0], [[0.0, 0, 0.1, 0, 0, 0, 1]])
        decided.clear()
        peaks.append(allocated(partial(scene.check, ["separations", "contacts"])))
        work.append(sum(decided))
        report = scene.check()
        assert len(report) == 1000
        assert report.truncated
    assert 0 < max(work) <= 2 * 3000  # of one row of all, and not of 4.5 million
    assert peaks[1] < 8e6  # of 4.5 million pairs 72e6 would be the indices alone


def test_many_candidates_of_which_none_collide_are_looked_at_piece_by_piece() -> None:
    scene = oc.Scene(max_pairs=10)
    turned = [0.0, 0.0, np.sin(np.pi / 8), np.cos(np.pi / 8)]
    poses = np.array([[0.15 * k, -0.15 * k, 0.0, *turned] for k in range(1500)])
    sizes = np.tile([1e4, 0.1, 0.1], (1500, 1))  # bounds of all overlap
    scene.add_boxes([f"{k}" for k in range(1500)], sizes, poses)
    scene.check()
    scene.move_indices(np.arange(1500), poses + np.eye(7)[2])  # 1 m up
    peak = allocated(scene.check)
    report = scene.check()
    assert (len(report), report.truncated, report.total) == (0, False, 0)
    assert peak < 8e6  # all candidates, 1.1 million, would be 18e6


def test_effects_with_pairs_of_their_own_have_a_limit_and_say_so() -> None:
    scene = oc.Scene(max_pairs=10)
    for k in range(200):
        scene.add(f"{k}", Box([0.1, 0.1, 0.1]), at(0.101 * k))
    scene.set_effect("clearance", max_distance=0.05)
    report = scene.check(effects=["clearance"])
    assert len(report.clearances) == 100
    assert report.clearances.pairs[-1].tolist() == [99, 100]
    assert "more than 100 pairs" in report.costs["clearance"].failures[0]
    scene.max_pairs = 20
    report = scene.check(effects=["clearance"])
    assert len(report.clearances) == 199
    assert report.costs["clearance"].failures == ()


def test_a_budget_and_a_limit_together_say_that_there_are_more() -> None:
    clock = itertools.count(0.0, 1e-4)
    scene = crowd(3, "mesh", max_pairs=40, time_budget=Budget(0.01, lambda: next(clock)))
    for _ in range(10):
        scene.padding, scene.padding = 0.5, 0.0  # all count as changed
        report = scene.check()
        assert report.truncated
        assert len(report) == 40
        assert not report.pairs.flags.writeable


@each("wrong", [0, -1, 1.0, True, "1", float("nan"), 2**53 + 1, 2**62, 2**64])
def test_a_limit_is_a_positive_whole_number(wrong: Any) -> None:
    refused("max_pairs must be a whole number", oc.Scene, max_pairs=wrong)
    scene = oc.Scene(max_pairs=5)
    refused("max_pairs", setattr, scene, "max_pairs", wrong)
    assert scene.max_pairs == 5
    for name in ("a", "b"):
        scene.add(name, Box([1.0, 1.0, 1.0]))
    scene.max_pairs = 2**53
    assert scene.check(effects=["clearance"]).names() == [("a", "b")]
