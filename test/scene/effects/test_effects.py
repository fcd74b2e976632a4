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

"""The machinery of effects: nothing is computed that nobody asked for, and reports stay true."""

import gc
import threading
import tracemalloc
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from each import each

import obb_collision as oc
from obb_collision.queries.verdict.verdict import pair_separations
from obb_collision.scene.effects import EFFECTS, separations
from obb_collision.scene.effects.base import MOST_FAILURES, isolated, pair_rows


@dataclass(frozen=True, eq=False)
class Column:
    """A result with one array."""

    values: Any


LAZY = [name for name, effect in EFFECTS.items() if effect.lazy]


def row_of_cubes(count: int = 5, gap: float = 0.75) -> oc.Scene:
    """Return unit cubes along x, each overlapping the next."""
    scene = oc.Scene()
    for k in range(count):
        scene.add(f"{'even' if k % 2 == 0 else 'odd'}/{k}", oc.shapes.Box([1, 1, 1]), at(gap * k))
    return scene


def at(x: float, y: float = 0.0, z: float = 0.0, w: float = 1.0) -> list[float]:
    return [x, y, z, 0.0, 0.0, 0.0, w]


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Record the pairs of each call of the query of separations."""
    made: list[int] = []

    def counted(boxes: oc.Boxes, pairs: Any) -> Any:
        made.append(len(pairs))
        return pair_separations(boxes, pairs)

    monkeypatch.setattr(separations, "pair_separations", counted)
    return made


def test_what_nobody_reads_is_not_computed(calls: list[int]) -> None:
    scene = row_of_cubes()
    report = scene.check()
    assert (len(report), calls, report.costs) == (4, [], {})
    assert report.depths.tolist() == [0.25] * 4
    assert report.normals.shape == report.positions.shape == (4, 3)
    assert calls == [4]
    assert report.costs["separations"].count == 4


def test_modes(calls: list[int]) -> None:
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


def test_a_report_is_of_its_check_however_late_it_is_read() -> None:
    scene = row_of_cubes()
    first = scene.check()
    scene.move("odd/1", at(0.5))
    scene.padding = 0.125
    second = scene.check()
    scene.remove("even/0")
    scene.add("even/0", oc.shapes.Sphere(3.0))
    assert first.depths.tolist() == [0.25] * 4
    assert second.names()[0] == ("even/0", "odd/1")
    assert second.depths[0] == 0.75


def centers_of(scene: oc.Scene) -> Any:
    """Return the array itself that a scene has, which reports in use may share."""
    return scene.objects.store.centers


def test_boxes_are_copied_only_for_reports_in_use() -> None:
    scene = row_of_cubes()
    everything = scene.indices
    report = scene.check()
    held = centers_of(scene)
    scene.move_indices(everything, scene.objects.poses_of(everything) + at(0.125, w=0.0))
    assert centers_of(scene) is not held
    held = centers_of(scene)
    del report
    scene.check()
    gc.collect()
    scene.move_indices(everything, scene.objects.poses_of(everything) - at(0.125, w=0.0))
    assert centers_of(scene) is held


def test_for_reports_in_use_what_few_objects_were_is_noted() -> None:
    scene = row_of_cubes(100)
    held = centers_of(scene)
    reports, expected = [], []
    for k in range(60):  # more of them than have notes, and more notes than there is room for
        reports.append(scene.check())
        expected.append(row_of_cubes(100))
        for j in range(k):
            for name in (f"odd/{1 + 2 * (j % 7)}", f"even/{50 + 2 * (j % 3)}"):
                expected[-1].move(name, at(0.5 + j, 0.01 * j))
        scene.move(f"odd/{1 + 2 * (k % 7)}", at(0.5 + k, 0.01 * k))
        if k == 0:
            assert centers_of(scene) is held
        scene.move(f"even/{50 + 2 * (k % 3)}", at(0.5 + k, 0.01 * k))
    for report, scene in zip(reports, expected, strict=True):
        wanted = scene.check()
        assert report.pairs.tolist() == wanted.pairs.tolist()
        assert report.positions.tobytes() == wanted.positions.tobytes()
        assert report.contacts.positions.tobytes() == wanted.contacts.positions.tobytes()


def test_a_report_is_read_while_another_thread_moves_objects(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
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
    scene.add("even/4", oc.shapes.Box([1, 1, 1]), at(0.5))
    assert np.isfinite(scene.check().depths).sum() == 3
    scene.set_effect("separations", objects="nobody")
    assert np.isnan(scene.check().depths).all()


def test_a_pair_that_fails_is_named_and_the_others_are_computed() -> None:
    scene = row_of_cubes()
    report = scene.check()

    def compute(boxes: oc.Boxes, pairs: Any) -> Any:
        if 2 in pairs[:, 0]:
            raise ArithmeticError("no answer")
        return Column(pairs[:, 1] * 1.0)

    setting = scene.effects["separations"]
    outcome = pair_rows("x", report.cycle, setting, compute, Column(np.empty(0)))
    assert outcome.count == 4
    assert outcome.failures == ("pair even/2, odd/3: ArithmeticError: no answer",)
    assert outcome.rows is not None
    assert outcome.rows.tolist() == [0, 1, 3]
    assert outcome.result.values.tolist() == [1.0, 2.0, 4.0]


@each("share", [1.0, 0.5, 0.01])
def test_pairs_that_fail_are_looked_for_within_bounds(share: float) -> None:
    count = 10_000
    pairs = np.stack([np.arange(count), np.arange(count) + 1], axis=1)
    bad = np.random.default_rng(1).random(count) < share
    calls = []

    def compute(some: Any) -> Any:
        calls.append(len(some))
        if bad[some[:, 0]].any():
            raise ArithmeticError("no answer")
        return Column(some[:, 1] * 1.0)

    rows, result, failures = isolated(compute, pairs, Column(np.empty(0)))
    assert len(calls) <= 2 * (MOST_FAILURES + 1) * 14 + 14  # 2^14 > count
    assert not bad[rows].any()
    assert (np.diff(rows) > 0).all()
    assert result.values.tolist() == (rows + 1.0).tolist()
    assert failures[0] == f"pair {bad.argmax()}, {bad.argmax() + 1}: ArithmeticError: no answer"
    assert len(failures) <= MOST_FAILURES + 14
    if share == 1.0:
        assert len(calls) <= 2 * (MOST_FAILURES + 14)
        together = [int(text.split(" and ")[1].split()[0]) for text in failures if " and " in text]
        assert sum(together) + len(failures) == count  # none is left unsaid


@each(
    "arguments, message",
    [
        (("nothing",), "effect must be one of"),
        (("separations", "sometimes"), "must be off, auto or on"),
        (("separations", None, [""]), "names or patterns"),
    ],
)
def test_what_cannot_be_set_is_refused(arguments: Any, message: str) -> None:
    scene = row_of_cubes()
    before = scene.effects["separations"]
    with pytest.raises(ValueError, match=message):
        scene.set_effect(*arguments)
    with pytest.raises(ValueError, match="has accuracy"):
        scene.set_effect("separations", "on", limit=3.0)
    with pytest.raises(ValueError, match="effect must be one of"):
        scene.check(effects=["nothing"])
    assert scene.effects["separations"] == before


@each("accuracy", ["sphere", "obb", "mesh"])
def test_allowed_pairs_do_not_count(accuracy: str) -> None:
    scene = row_of_cubes()
    scene.accuracy = oc.Accuracy[accuracy.upper()]
    everything = scene.check().names()
    scene.allow("even/*", "odd/*")
    left = [(a, b) for a, b in everything if a[:3] == b[:3]]
    assert scene.check().names() == left
    scene.allow("odd/1", "*", allowed=False)
    kept = [pair for pair in everything if pair in left or "odd/1" in pair]
    assert scene.check().names() == kept
    scene.move("even/0", at(0.01))  # by what changed alone, too
    assert scene.check().names() == kept
    scene.clear()
    assert scene.rules.allowed == [("even/*", "odd/*", True), ("odd/1", "*", False)]
    with pytest.raises(ValueError, match="names or patterns"):
        scene.allow("", "*")


def test_rules_that_were_taken_back_are_forgotten() -> None:
    scene = row_of_cubes()
    everything = scene.check().names()
    scene.allow("even/0", "odd/1")
    for k in range(2000):
        scene.allow(f"even/{k}", "odd/3")
        scene.allow("odd/3", f"even/{k}", False)
    assert scene.rules.allowed == [("even/0", "odd/1", True)]
    scene.allow("odd/*", "even/*")
    scene.allow("even/0", "odd/1", False)  # overrules the one before: not forgotten
    assert scene.check().names() == [("even/0", "odd/1")]
    with pytest.raises(ValueError, match="names or patterns"):
        scene.rules.allowed = [("*", "*", True), ("", "*", True)]
    assert len(scene.rules.allowed) == 2
    for k in range(2000):
        scene.rules.allowed = [("even/*", f"odd/{k}", True)]
    assert scene.rules.allowed == [("even/*", "odd/1999", True)]
    scene.rules.allowed = []
    assert scene.check().names() == everything


def test_objects_may_come_one_by_one_between_checks() -> None:
    scene = oc.Scene()
    for k in range(70):
        scene.add(str(k), oc.shapes.Box([1, 1, 1]), at(0.75 * k))
        assert len(scene.check()) == k


def test_where_nothing_collides_no_kernel_of_an_effect_is_called(
    monkeypatch: pytest.MonkeyPatch, calls: list[int]
) -> None:
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
    scene = row_of_cubes(400)
    frames = iter(range(99))

    def peak(check: Callable[[], object]) -> int:
        shift = 0.01 * next(frames)
        scene.move_indices(np.arange(400), [at(0.75 * k + shift) for k in range(400)])
        tracemalloc.start()
        check()
        used = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return used

    for mode in ("auto", "off"):
        for name in EFFECTS:
            scene.set_effect(name, mode)
        peak(scene.check), peak(scene._checks.find)  # what the first time allocates for good
        # the report, and which objects were active: no array with a row a pair
        assert peak(scene.check) - peak(scene._checks.find) < 4096

    rows, poses = np.arange(400), np.array([at(0.75 * k + 9.0) for k in range(400)])
    kept = scene.check()  # all are off
    tracemalloc.start()
    scene.move_indices(rows, poses)
    assert tracemalloc.get_traced_memory()[1] < 400 * 12 * 8  # a copy of centres and rotations
    tracemalloc.stop()
    assert len(kept) == 399
