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

"""The self-test: right kernels pass, a wrong one is found, and cycles go on meanwhile."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from each import each

pytest.importorskip("rclpy")
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_msgs.srv import SelfTest
from lifecycle_msgs.msg import Transition
from rig import Rig, cube, pose

from obb_collision import _kernel_cache
from obb_collision._kernel_cache import KernelMissingError
from obb_collision.node.self_test import comparisons, service
from obb_collision.node.self_test.comparisons import COMPARISONS, Comparison
from obb_collision.node.self_test.service import LATE, SEED, STOPPED, compare, compare_all
from obb_collision.queries.verdict.verdict import exact_verdict
from obb_collision.scene.scene import Scene
from obb_collision.warm_up import steps

NAMES = {comparison.name for comparison in COMPARISONS}


@pytest.fixture(autouse=True)
def loaded() -> None:
    """Load all kernels, as a node does."""
    for step in steps.NODE_STEPS:
        steps.run(step)


def test_right_kernels_differ_nowhere_and_nothing_is_compiled() -> None:
    before = len(_kernel_cache.compiled.names)
    for result in compare_all(seconds=1e9):
        assert (result.different, result.reason, result.failed) == (0, "", False), result
        assert result.compared > 30, result.comparison.name
    assert len(_kernel_cache.compiled.names) == before


WRONG: dict[str, tuple[str, str, Callable[[Any], Any]]] = {
    "pairs of few boxes": ("pairs", "", lambda found: found[1:]),
    "pairs of many boxes": ("pairs", "", lambda found: found[1:]),
    "depths": ("separations", "separations", lambda found: found + 2e-9),
    "contacts": ("contacts", "positions", lambda found: found + 0.01),
    "clearances": ("clearance", "distances", lambda found: found + 2e-9),
    "points": ("points", "counts", lambda found: found + 1),
}
"""What is wrong by comparison: attribute or effect of a report, its array, and how."""


@pytest.mark.parametrize("name", [*WRONG])
def test_a_wrong_answer_is_found(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    effect, part, spoil = WRONG[name]
    check = Scene.check

    def wrong(self: Scene, effects: Any = ()) -> Any:
        report = check(self, effects)
        if part:
            result = report.result(effect)
            object.__setattr__(result, part, spoil(getattr(result, part)))
        else:
            report.pairs, report.verdicts = spoil(report.pairs), spoil(report.verdicts)
        return report

    monkeypatch.setattr(Scene, "check", wrong)
    (comparison,) = [one for one in COMPARISONS if one.name == name]
    result = compare(comparison, lambda: False, lambda: 0.0, 1.0)
    assert result.different > 0
    assert result.failed
    assert 1 <= len(result.examples) <= service.SHOWN


@each("name", ["poses", "predictions", "hulls and meshes"])
def test_wrong_truths_are_found_as_well_so_that_these_comparisons_are_not_empty(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    rotation, collide, verdict = comparisons.rotation_of, comparisons.bodies_collide, exact_verdict
    monkeypatch.setattr(
        comparisons, "rotation_of", lambda q: [entry * 1.000000000000002 for entry in rotation(q)]
    )
    monkeypatch.setattr(comparisons, "bodies_collide", lambda a, b: not collide(a, b))
    monkeypatch.setattr(
        comparisons, "exact_verdict", lambda a, i, b, j: 2 * (verdict(a, i, b, j) == 0)
    )
    (comparison,) = [one for one in COMPARISONS if one.name == name]
    assert any(comparison.run(np.random.default_rng(SEED)))


def endless(_: Any) -> Iterator[str]:
    while True:
        yield ""


def test_it_ends_in_time_and_says_what_it_could_not_compare() -> None:
    times = iter(np.arange(0.0, 1e3, 0.25).tolist())
    late = compare(Comparison("x", "things", endless), lambda: False, lambda: next(times), 2.0)
    assert (late.reason, late.failed) == (LATE, False)
    assert 1 <= late.compared <= 8
    stopped = compare(Comparison("x", "things", endless), lambda: True, lambda: 0.0, 2.0)
    assert (stopped.reason, stopped.compared) == (STOPPED, 1)


@each("error", [KernelMissingError("k"), ValueError("broken")])
def test_what_was_not_compared_at_all_has_not_passed(error: BaseException) -> None:
    def fails(_: Any) -> Iterator[str]:
        raise error
        yield ""

    result = compare(Comparison("x", "things", fails), lambda: False, lambda: 0.0, 1.0)
    assert result.failed
    assert "compiled" in result.reason or "broken" in result.examples[0]


def call(rig: Rig) -> Any:
    return rig.call(SelfTest, "obb_collision/self_test", SelfTest.Request())


def test_the_service_says_what_was_compared(rig: Rig) -> None:
    answer = call(rig)
    assert answer.passed == b"\x01", answer
    assert "numba" in answer.id
    assert {status.name.rpartition("self-test of ")[2] for status in answer.status} == NAMES
    for status in answer.status:
        assert status.level != DiagnosticStatus.ERROR
        values = {pair.key: pair.value for pair in status.values}
        assert int(values["compared"]) > 0
        assert f"{values['compared']} " in status.message
        assert "exact arithmetic" in status.message


def test_cycles_go_on_while_it_runs_in_a_thread_of_its_own(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened, threads = threading.Event(), []

    def waits(*_: Any) -> Iterator[Any]:
        threads.append(threading.current_thread().name)
        assert opened.wait(rig.patience)
        yield service.Compared(COMPARISONS[0], compared=1)

    monkeypatch.setattr(service, "compare_all", waits)
    client = rig.client.create_client(SelfTest, "obb_collision/self_test")
    rig.until(client.service_is_ready, "service")
    first, second = (client.call_async(SelfTest.Request()) for _ in range(2))
    rig.until(lambda: threads, "the test")
    rig.send(cube(("a", 1)), cube(("a", 2), (0.5, 0, 0)))
    assert rig.pairs() == {("a/1", "a/2")}
    rig.send_transform("a/2", pose(3.0))
    assert rig.pairs() == set()
    assert all(result.successful for result in rig.set(rate=40.0))
    assert not first.done()
    assert threads == ["self_test"], "one at a time"
    opened.set()
    rig.until(lambda: first.done() and second.done(), "answers")
    assert first.result().passed == b"\x01"


@each("way", [(), (Transition.TRANSITION_CONFIGURE,)])
def test_it_works_in_every_state(way: tuple[int, ...]) -> None:
    with Rig(deaf=True, autostart=False) as rig:
        for transition in way:
            assert rig.change(transition)
        assert call(rig).passed == b"\x01"


def test_a_wrong_kernel_fails_the_self_test(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(comparisons, "exact_verdict", lambda *_: 2)
    answer = call(rig)
    assert answer.passed == b"\x00"
    levels = {status.name.rpartition("self-test of ")[2]: status.level for status in answer.status}
    assert levels["pairs of few boxes"] == DiagnosticStatus.ERROR


def test_a_node_that_ends_does_not_wait_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(service, "COMPARISONS", (Comparison("x", "things", endless),))
    monkeypatch.setattr(service, "TIME", 1e9)
    with Rig(deaf=True) as rig:
        client = rig.client.create_client(SelfTest, "obb_collision/self_test")
        rig.until(client.service_is_ready, "service")
        client.call_async(SelfTest.Request())
        rig.until(lambda: "self_test" in {t.name for t in threading.enumerate()}, "the test")
    assert "self_test" not in {thread.name for thread in threading.enumerate()}
