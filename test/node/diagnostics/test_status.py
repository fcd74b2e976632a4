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

"""Statistics and diagnostics of inputs and cycles, services, and how the node is run."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from each import each

pytest.importorskip("rclpy")
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rig import DOMAIN, NAMESPACE, PATIENCE, Rig, cube, pose
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger

from obb_collision.node import collisions_from_ros
from obb_collision.node.diagnostics.monitors import InputMonitor

A1, A2, B1 = ("a", 1), ("a", 2), ("b", 1)


def test_diagnostics_say_what_came_in_what_was_refused_and_how_long_it_took(rig: Rig) -> None:
    rig.listen("/diagnostics")
    rig.send(cube(A1), cube(A2), cube(B1, (9, 0, 0), (0, 0, 0)))
    rig.answer()
    rig.next("/diagnostics")
    status = rig.status("input objects")
    assert status["topic"] == NAMESPACE + "/objects"
    assert status["messages"] == "1"
    assert status["rejected: bad scale"] == "1"
    assert 0.0 <= float(status["age (s)"]) < 2.0 * PATIENCE, "since it came, not since 1970"
    assert rig.status("input object_poses")["age (s)"] == "never"
    objects = rig.status(": objects")
    assert (objects["count"], objects["colliding"], objects["unplaceable"]) == ("2", "2", "1")
    cycle = rig.status(": cycle")
    assert {"rate (Hz)", "overruns", "cycle mean (ms)", "cycle max (ms)"} <= set(cycle)
    assert {"update mean (ms)", "check mean (ms)", "publish max (ms)"} <= set(cycle)
    assert rig.last["/diagnostics"].status[0].hardware_id == "obb_collision"


@contextmanager
def other_participant() -> Iterator[Node]:
    """Yield a node that may use a topic with another type, as that of another process may."""
    context = Context()
    context.init(domain_id=DOMAIN)
    node = Node("other", context=context, namespace=NAMESPACE)
    try:
        yield node
    finally:
        node.destroy_node()
        context.try_shutdown()


def test_a_listener_with_incompatible_qos_or_type_is_reported(
    rig: Rig, capfd: pytest.CaptureFixture[str]
) -> None:
    rig.listen("/diagnostics")
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    rig.client.create_subscription(PointCloud2, "contacts", lambda message: None, latched)
    with other_participant() as other:
        other.create_subscription(Bool, "clearances", lambda message: None, 1)
        wrong = {"contacts", "clearances"}
        rig.until(lambda: wrong <= set(rig.status(": qos")), "mismatches")
    assert rig.node.effects.of_cycle().isdisjoint({"contacts", "clearance"})
    errors = capfd.readouterr().err
    assert "DURABILITY" in errors
    # the name of a node may become known later than its topics
    assert re.search("type std_msgs/msg/Bool of (other|_NODE_NAME_UNKNOWN_)", errors)


def test_clear_removes_everything(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2))
    rig.answer()
    response = rig.call(Trigger, "obb_collision/clear", Trigger.Request())
    assert (response.success, response.message) == (True, "2 objects removed")
    assert len(collisions_from_ros(rig.next("collisions"))) == 0
    rig.send(cube(A1, (0.2, 0, 0)))
    assert rig.pairs() == set()


def test_enable_stops_and_resumes_the_checks_while_states_are_taken(rig: Rig) -> None:
    rig.listen("/diagnostics")
    rig.send(cube(A1), cube(A2, (3, 0, 0)))
    rig.answer()
    assert rig.call(SetBool, "obb_collision/enable", SetBool.Request(data=False)).success
    status = rig.status(": cycle")
    assert (status["enabled"], status["level"]) == ("False", "01")
    rig.last.pop("collisions", None)
    rig.send_transform("a/2", pose(0.5))
    rig.until(lambda: rig.pose_of(A2)[0] == 0.5, "state taken")
    assert "collisions" not in rig.last
    assert rig.call(SetBool, "obb_collision/enable", SetBool.Request(data=True)).success
    assert rig.pairs() == {("a/1", "a/2")}


def test_every_parameter_has_a_description_and_numbers_a_range(rig: Rig) -> None:
    for name in rig.node._parameters:
        if name in ("use_sim_time", "start_type_description_service") or "qos_" in name:
            continue
        descriptor = rig.node.describe_parameter(name)
        assert len(descriptor.description) > 20, name
        value = rig.node.get_parameter(name).value
        if isinstance(value, float):
            assert descriptor.floating_point_range, name
        elif isinstance(value, int) and not isinstance(value, bool):
            assert descriptor.integer_range, name


def test_the_rate_changes_at_run_time(rig: Rig) -> None:
    rig.listen("/diagnostics")
    assert all(result.successful for result in rig.set(rate=5.0))
    rig.next("/diagnostics")
    rig.until(lambda: 2.0 < float(rig.status(": cycle")["rate (Hz)"]) < 9.0, "slower")


def test_arrival_answers_without_waiting_for_the_timer() -> None:
    with Rig(trigger="arrival", min_period=0.0) as rig:
        rig.set(rate=0.1)
        rig.send(cube(A1), cube(A2, (3, 0, 0)))
        assert rig.pairs() == set()
        for x in (0.5, 3.0, 0.25):
            rig.send_poses([2], [pose(x)])
            assert rig.pairs() == ({("a/1", "a/2")} if x < 1 else set())


def test_a_burst_of_arrivals_ends_with_the_newest_state_evaluated() -> None:
    with Rig(trigger="arrival", min_period=0.05) as rig:
        rig.set(rate=0.1)
        rig.send(cube(A1), cube(A2, (3, 0, 0)))
        for x in np.linspace(3.0, 0.5, 40):
            rig.send_transform("a/2", pose(x))
        assert rig.pairs() == {("a/1", "a/2")}


BROKEN = (0.0, 1.0, 1.0)
"""A scale that is refused."""


class Monitored:
    """A monitor with a clock that a test sets."""

    def __init__(self) -> None:
        self.time = 0.0
        self.said: list[str] = []
        self.monitor = InputMonitor("/objects", self.said.append, steady=lambda: self.time)


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


def test_each_reason_is_told_at_once_everything_with_no_period_and_reasons_are_bounded() -> None:
    made = Monitored()
    made.monitor.refuse(0, "bad scale")
    made.monitor.refuse(0, "unknown frame", "a/1")
    made.monitor.doubt(0, "stamp from the future", "a/2")
    assert made.said[1:] == [
        "/objects: refused unknown frame: 1; last: a/1",
        "/objects: doubtful stamp from the future: 1; last: a/2",
    ]
    made.monitor.period = 0.0
    for number in range(3):
        made.monitor.refuse(0, "bad scale")
        assert len(made.said) == 4 + number
    bounded = Monitored()
    for number in range(1000):
        bounded.monitor.refuse(0, f"reason {number}")
    assert len(bounded.monitor.refused) <= 65
    assert bounded.monitor.refused.total() == 1000
    assert len(bounded.said) <= 65


def test_the_first_diagnostics_have_the_rates_of_their_time(rig: Rig) -> None:
    for number in range(50):
        rig.send(cube(("a", 1), (number, 0, 0)), cube(("a", 2), size=BROKEN))
    rig.answer()
    rig.send_transform("a/1", pose(1.0))
    rig.answer()
    node = rig.node
    node.reporting.publish()  # as every second while nobody subscribes
    rig.listen("/diagnostics")
    status = rig.status("input objects")
    assert float(status["rate (Hz)"]) == 0.0
    assert status["messages"] == "50"
    assert (status["message"], status["level"]) == ("0 messages", "00")
