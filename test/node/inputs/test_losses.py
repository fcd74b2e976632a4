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

"""Messages that the middleware dropped, counted by the numbers of their publishers."""

from __future__ import annotations

import random

import pytest

pytest.importorskip("rclpy")
from each import each
from rig import Rig, cube, pose

from obb_collision.node.inputs.subscriptions import NO_NUMBER, Losses


def total(numbers: list[int], publishers: int = 1) -> int:
    losses = Losses(lambda: publishers)
    return sum(losses.count(number) for number in numbers)


def test_gaps_of_one_publisher_are_counted() -> None:
    assert total([1, 2, 3]) == 0
    assert total([1, 2, 5, 9]) == 2 + 3
    assert total([1000, 1001]) == 0, "it had published before the node came"


def test_a_publisher_that_restarts_has_lost_nothing() -> None:
    assert total([1, 2, 3, 1, 2, 4]) == 1


def test_middlewares_without_numbers_count_nothing() -> None:
    losses = Losses(lambda: 1)
    assert [losses.count(number) for number in (None, 0, NO_NUMBER, NO_NUMBER + 5)] == [0] * 4


@each("seed", range(20))
def test_of_several_publishers_all_losses_are_counted(seed: int) -> None:
    rng = random.Random(seed)
    next_numbers = {"a": 1, "b": 1, "c": 700}
    given, lost = [1, 1, 700], 0
    for _ in range(300):
        name = rng.choice(list(next_numbers))
        next_numbers[name] += 1 + (jump := rng.choice((0, 0, 0, 0, 1, 40)))
        lost += jump
        given.append(next_numbers[name])
    assert total(given, 3) == lost


def test_more_messages_than_a_queue_holds_are_counted_as_lost_and_superseded(rig: Rig) -> None:
    rig.listen("/diagnostics")
    rig.send(cube(("a", 1)))
    rig.answer()
    rig.send_states(["a/1"], [pose(-1)])
    rig.answer()
    for step in range(40):  # 10 of them fit into the queue, as nobody reads meanwhile
        rig.send_states(["a/1"], [pose(step)])
    rig.answer()
    assert rig.pose_of(("a", 1))[0] == 39.0, "the latest state wins"
    monitor = rig.monitor("object_states")
    assert monitor.lost + monitor.messages == 41
    assert monitor.lost >= 30 - 1, "but for the first, if that was taken before the others came"
    assert monitor.superseded >= monitor.messages - 3
    status = rig.status("input object_states")
    assert (status["lost"], status["superseded"]) == (str(monitor.lost), str(monitor.superseded))


def test_states_of_markers_that_newer_ones_replace_are_counted(rig: Rig) -> None:
    rig.send(*(cube(("a", 1), (float(x), 0, 0)) for x in range(10)), cube(("a", 2)))
    rig.answer()
    rig.until(lambda: rig.monitor("objects").superseded == 9, "nine replaced")
