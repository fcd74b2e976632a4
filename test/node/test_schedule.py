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

"""A storm of changes makes few calls, and the last one counts."""

from __future__ import annotations

import pytest
from each import each

pytest.importorskip("rclpy")
from rig import Rig, cube

from obb_collision.node import schedule
from obb_collision.node.schedule import STORM_PERIOD, STORM_SHARE, Calm


class Clock:
    """A clock and a timer that a test moves on."""

    def __init__(self) -> None:
        self.now = 0.0
        self.due: float | None = None

    def start(self, seconds: float) -> None:
        assert self.due is None, "a timer at a time"
        self.due = self.now + seconds


def storm(seconds: float, cost: float) -> tuple[list[int], float]:
    """Return the changes that were taken over in a storm, 1,000 per second, and their time."""
    clock, taken, state = Clock(), list[int](), 0

    def take() -> None:
        taken.append(state)
        clock.now += cost

    calm = Calm(take, clock.start, lambda: clock.now)
    while clock.now < seconds:
        state += 1
        calm()
        clock.now += 0.001
        if clock.due is not None and clock.now >= clock.due:
            clock.due = None
            calm.end()
    if clock.due is not None:
        clock.now, clock.due = clock.due, None
        calm.end()
    assert taken[-1] == state, "the last change counts"
    return taken, len(taken) * cost


@each("cost", [0.0, 0.001, 0.02, 0.3])
def test_a_storm_takes_a_share_of_the_time(cost: float) -> None:
    taken, used = storm(10.0, cost)
    assert len(taken) <= 10.0 / STORM_PERIOD + 2
    assert used <= STORM_SHARE * 10.0 + 2 * cost
    assert len(taken) > 2


def test_a_change_alone_is_taken_over_at_once() -> None:
    clock, taken = Clock(), list[float]()
    calm = Calm(lambda: taken.append(clock.now), clock.start, lambda: clock.now)
    for now in (0.0, 1.0, 5.0):
        clock.now = now
        calm()
    assert taken == [0.0, 1.0, 5.0]
    assert clock.due is None


def test_a_call_that_waits_is_made_when_it_is_needed() -> None:
    clock, taken = Clock(), list[float]()
    calm = Calm(lambda: taken.append(clock.now), clock.start, lambda: clock.now)
    calm.settle()
    assert taken == [], "nothing waits"
    calm()
    clock.now = 0.001
    calm()
    clock.now = 0.002
    calm.settle()
    calm.settle()
    assert taken == [0.0, 0.002]


def test_a_message_after_a_change_of_parameters_is_taken_as_the_change_has_it() -> None:
    with Rig() as rig:
        for n in range(10):
            rig.set(max_objects=1)
            rig.set(max_objects=100)  # within the time in which changes are a storm
            rig.send(*(cube((f"b{n}", k), (0.9 * k, 0.0, 10.0 * n)) for k in range(3)))
            assert len(rig.pairs()) == 2 * (n + 1)


def storm_of_parameters(rig: Rig) -> None:
    """Send objects, and then two hundred changes."""
    rig.send(*(cube(("a", n), (0.9 * n, 0.0, 0.0)) for n in range(5)))
    assert len(rig.pairs()) == 4
    for n in range(100):
        assert rig.set(padding=0.001 * (n + 1))[0].successful
        rig.set(accuracy_overrides=[f"a/{n % 5}: aabb"])


def test_a_storm_of_parameters_leaves_the_node_with_the_last_ones() -> None:
    with Rig() as rig:
        storm_of_parameters(rig)
        rig.until(lambda: rig.node.objects.scene.padding == 0.1, "the last padding")
        rig.until(lambda: rig.node.objects.shapes.overrides.overrides[0][0] == "a/4", "the last")


def test_a_storm_of_parameters_is_taken_over_in_few_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(schedule, "STORM_PERIOD", 3600.0)  # longer than any machine takes for it
    with Rig() as rig:
        applied = 0
        apply = rig.node._settings.apply

        def counted() -> None:
            nonlocal applied
            applied += 1
            apply()

        rig.node._settings.apply = counted  # type: ignore[method-assign]
        storm_of_parameters(rig)
        assert applied <= 1
        rig.send(cube(("a", 5), (0.9 * 5, 0.0, 0.0)))
        assert len(rig.pairs()) == 5
        assert rig.node.objects.scene.padding == 0.1
        assert rig.node.objects.shapes.overrides.overrides[0][0] == "a/4"
        assert 1 <= applied <= 2
