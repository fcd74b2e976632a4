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

"""Counting and warning: limits by reason and steady time, and rates that are right at once."""

from __future__ import annotations

import pytest
from each import each

pytest.importorskip("rclpy")
from rig import Rig, cube, pose

from obb_collision.node.diagnostics.monitors import InputMonitor, WarningLimit

BROKEN = (0.0, 1.0, 1.0)
"""A scale that is refused."""


class Monitored:
    """A monitor with a clock that a test sets."""

    def __init__(self) -> None:
        self.time = 0.0
        self.said: list[str] = []
        self.monitor = InputMonitor("/objects", self.said.append, WarningLimit(lambda: self.time))


def test_many_faults_of_one_message_are_one_warning() -> None:
    made = Monitored()
    for number in range(200):
        made.monitor.refuse(0, "bad scale", f"a/{number}", "zero")
    assert made.said == ["/objects: refused bad scale: 1; last: a/0 (zero)"]
    made.time = 4.9
    made.monitor.flush()
    assert len(made.said) == 1
    made.time = 5.0
    made.monitor.flush()
    assert made.said[1:] == ["/objects: refused bad scale: 199; last: a/199 (zero)"]
    made.time = 99.0
    made.monitor.flush()
    assert len(made.said) == 2, "nothing is left"


@each("times", [(0, 0, 0), (10**12, 0, 10**15)])
def test_the_nodes_clock_may_pause_or_jump(times: tuple[int, ...]) -> None:
    made = Monitored()
    for now in times:
        made.monitor.refuse(now, "bad scale")
    assert len(made.said) == 1
    made.time = 5.0
    made.monitor.refuse(0, "bad scale")
    assert made.said[1:] == ["/objects: refused bad scale: 3"]


def test_another_reason_soon_after_a_warning_is_told() -> None:
    made = Monitored()
    made.monitor.refuse(0, "bad scale")
    made.monitor.refuse(0, "unknown frame", "a/1")
    made.monitor.doubt(0, "stamp from the future", "a/2")
    assert made.said[1:] == [
        "/objects: refused unknown frame: 1; last: a/1",
        "/objects: doubtful stamp from the future: 1; last: a/2",
    ]


def test_with_no_period_everything_is_told() -> None:
    made = Monitored()
    made.monitor.limit.period = 0.0
    for _ in range(3):
        made.monitor.refuse(0, "bad scale")
    assert len(made.said) == 3


def test_reasons_are_bounded() -> None:
    made = Monitored()
    for number in range(1000):
        made.monitor.refuse(0, f"reason {number}")
    assert len(made.monitor.refused) <= 65
    assert made.monitor.refused.total() == 1000
    assert len(made.said) <= 65


def test_by_topics_a_message_of_bad_markers_is_one_warning(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with Rig() as rig:
        rig.send(*(cube(("a", number), size=BROKEN) for number in range(200)))
        rig.until(lambda: rig.refused("objects") == {"bad scale": 200}, "refusals")
        rig.cycles(1)
    errors = capfd.readouterr().err
    assert errors.count("refused bad scale") == 1, errors


def test_the_first_diagnostics_have_the_rates_of_their_time(rig: Rig) -> None:
    for number in range(50):
        rig.send(cube(("a", 1), (number, 0, 0)), cube(("a", 2), size=BROKEN))
    rig.answer()
    rig.send_transform("a/1", pose(1.0))
    rig.answer()
    node = rig.node
    node._reporting.publish()  # as every second while nobody subscribes
    rig.listen("/diagnostics")
    status = rig.status("input objects")
    assert float(status["rate (Hz)"]) == 0.0
    assert status["messages"] == "50"
    assert (status["message"], status["level"]) == ("0 messages", "00")
