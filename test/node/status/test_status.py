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

"""Statistics, diagnostics and services; QoS of endpoints: what fits whom, and its parameters."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from each import each
from lifecycle_msgs.msg import Transition
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import InvalidQosOverridesError
from rig import A1, A2, B1, INPUTS, NAMESPACE, PATIENCE, Patch, Printed, Rig, cube, node_apart, pose
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import MarkerArray

from obb_collision.node.diagnostics.monitors import InputMonitor
from obb_collision.node.inputs import detections
from obb_collision.node.inputs.subscriptions import Input
from obb_collision.node.node import CollisionNode
from obb_collision.node.topics.cloud import LATCHED, RELIABLE


def test_diagnostics_say_what_came_in_what_was_refused_and_how_long_it_took(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2), cube(B1, (9, 0, 0), (0, 0, 0))).answer()
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
    message = rig.last["/diagnostics"]
    assert message.status[0].hardware_id == "obb_collision"
    assert message.header.stamp.sec > 0


def test_a_listener_with_incompatible_qos_or_type_is_reported(rig: Rig, capfd: Printed) -> None:
    rig.client.create_subscription(PointCloud2, "contacts", lambda message: None, LATCHED)
    with node_apart("other") as other:  # as of another process: of another type
        other.create_subscription(Bool, "clearances", lambda message: None, 1)
        wrong = {"contacts", "clearances"}
        rig.until(lambda: wrong <= set(rig.status(": qos")), "mismatches")
    assert rig.node.effects.of_cycle().isdisjoint({"contacts", "clearance"})
    errors = capfd.readouterr().err
    assert "DURABILITY" in errors
    # the name of a node may become known later than its topics
    assert re.search("type std_msgs/msg/Bool of (other|_NODE_NAME_UNKNOWN_)", errors)


def test_clear_removes_everything(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2)).answer()
    response = rig.call(Trigger, "obb_collision/clear", Trigger.Request())
    assert (response.success, response.message) == (True, "2 objects removed")
    assert rig.next("collisions").width == 0
    rig.send(cube(A1, (0.2, 0, 0)))
    assert rig.pairs() == set()


def test_enable_stops_and_resumes_the_checks_while_states_are_taken(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2, (3, 0, 0))).answer()
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
    for name in rig.node.list_parameters([], 0).names:
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


def test_refusals_are_told_at_once_by_reason_then_together_and_in_bounds() -> None:
    said, time = list[str](), [0.0]
    monitor = InputMonitor("/objects", said.append, steady=lambda: time[0])
    for number in range(200):
        monitor.refuse("bad scale", f"a/{number}", "zero")
    monitor.refuse("unknown frame", "a/1")
    monitor.doubt("stamp from the future", "a/2")
    assert said == [
        "/objects: refused bad scale: 1; last: a/0 (zero)",
        "/objects: refused unknown frame: 1; last: a/1",
        "/objects: doubtful stamp from the future: 1; last: a/2",
    ]
    together = ["/objects: refused bad scale: 199; last: a/199 (zero)"]
    for now, told in ((4.9, []), (5.0, together), (99.0, [])):
        said.clear()
        time[0] = now
        monitor.flush()
        assert said == told
    monitor.refuse("bad scale")
    assert said == ["/objects: refused bad scale: 1"], "told at once, too, after so long"
    monitor.period = 0.0
    for number in range(1000):
        monitor.refuse("bad scale")
        assert len(said) == 2 + number, "with no period everything is told"
    monitor.period = 5.0
    for number in range(1000):
        monitor.refuse(f"reason {number}")
    assert len(monitor.refused) <= 65
    assert monitor.refused.total() == 200 + 1 + 1 + 1000 + 1000
    assert len(said) <= 1001 + 65


def test_the_first_diagnostics_have_the_rates_of_their_time(rig: Rig) -> None:
    for number in range(50):
        rig.send(cube(("a", 1), (number, 0, 0)), cube(("a", 2), size=(0, 1, 1)))
    rig.answer()
    rig.send_transform("a/1", pose(1.0)).answer()
    node = rig.node
    node.reporting.publish()  # as every second while nobody subscribes
    status = rig.status("input objects")
    assert float(status["rate (Hz)"]) == 0.0
    assert status["messages"] == "50"
    assert (status["message"], status["level"]) == ("0 messages", "00")


BEST_EFFORT, RELIABLY = ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE
LATCHING = DurabilityPolicy.TRANSIENT_LOCAL


def overrides(topic: str, **policies: Any) -> dict[str, Any]:
    """Return parameters that override the QoS of an endpoint, "TOPIC.KIND"."""
    name, _, kind = topic.rpartition(".")
    return {f"qos_overrides.{name}.{kind}.{policy}": value for policy, value in policies.items()}


def test_points_arrive_from_a_driver_that_sends_best_effort() -> None:
    with Rig(sure_points=False) as rig:
        rig.client.destroy_publisher(rig.pubs["points"])
        qos = QoSProfile(depth=5, reliability=BEST_EFFORT)
        driver = rig.pubs["points"] = rig.client.create_publisher(PointCloud2, "points", qos)
        rig.until(driver.get_subscription_count, "match")
        rig.send(cube(A1)).answer()

        def inside() -> Any:  # best effort: sent again until it arrives
            rig.send_points(np.zeros((3, 3)))
            return rig.next("points_inside").width == 1

        rig.until(inside, "points in the box")


@pytest.fixture
def detecting(monkeypatch: Patch) -> None:
    """Let nodes have the topic of detections, whether vision_msgs is there or not."""
    given = {"detections": Input(PointCloud2, *detections.QUEUE)}
    monkeypatch.setattr(detections, "INPUTS", given)


def test_joints_and_detections_match_what_sends_best_effort(detecting: None) -> None:
    with Rig(robots=["arm"]) as rig:
        for kind, topic in ((JointState, "arm/joint_states"), (PointCloud2, "detections")):
            qos = QoSProfile(depth=5, reliability=BEST_EFFORT)
            sensor = rig.client.create_publisher(kind, topic, qos)
            rig.until(sensor.get_subscription_count, topic)


def test_overrides_are_named_by_the_full_topic_of_a_node_in_a_namespace() -> None:
    given = overrides(f"{NAMESPACE}/objects.subscription", depth=7, reliability="best_effort")
    given |= overrides(f"{NAMESPACE}/collisions.publisher", depth=3, reliability="best_effort")
    given |= overrides(f"{NAMESPACE}/contacts.publisher", durability="transient_local")
    given |= overrides("/diagnostics.publisher", depth=2)
    with Rig(given=given, deaf=True) as rig:
        objects = rig.node.subscribed.open["objects"].qos_profile
        ends = {topic: end.qos_profile for topic, end in rig.node.outputs.ends.items()}
        assert (objects.depth, objects.reliability) == (7, BEST_EFFORT)
        assert (ends["collisions"].depth, ends["collisions"].reliability) == (3, BEST_EFFORT)
        assert ends["contacts"].durability == LATCHING
        assert ends["/diagnostics"].depth == 2
        # the others are as they were: profiles are not shared
        assert (ends["clearances"].depth, ends["clearances"].reliability) == (10, RELIABLY)
        assert ends["clearances"].durability == DurabilityPolicy.VOLATILE
    assert (RELIABLE.depth, RELIABLE.reliability) == (10, RELIABLY)
    assert (LATCHED.depth, LATCHED.durability) == (1, LATCHING)


@contextmanager
def sender(**policies: Any) -> Iterator[Any]:
    """Yield a publisher of ``objects`` as of another process, in a context of its own."""
    with node_apart("sender") as node:
        yield node.create_publisher(MarkerArray, "objects", QoSProfile(**policies))


def test_all_that_was_latched_before_the_start_is_received_and_who_does_not_latch_named() -> None:
    with sender(depth=300, durability=LATCHING) as latched:
        for number in range(300):  # more than wait where senders do not latch
            latched.publish(MarkerArray(markers=[cube(("a", number), (2.0 * number, 0, 0))]))
        latched.publish(MarkerArray(markers=[cube(("a", 299), (2.5, 0, 0))]))
        with Rig(deaf=True, latched_objects=True, unmatched={"objects"}) as rig:
            rig.until(lambda: len(rig.node.objects.table) == 299, "all but the oldest")
            rig.until(lambda: len(rig.node.cycle.report or ()) == 1, "a pair")
            monitor = rig.monitor("objects")
            assert (monitor.messages, monitor.lost, monitor.refused.total()) == (300, 0, 0)
            rig.until(lambda: rig.status(": qos").get("objects") == "1", "the volatile one")
            status = rig.status(": qos")
            assert status["level"] == "01"
            assert "incompatible QoS on objects" in status["message"]
            assert "Volatile publisher" in status["objects: 1"]
            assert "client" in status["objects: 1"], "the node whose publisher does not latch"
            assert rig.status("input objects")["qos mismatches"] == "1"


def test_objects_latched_before_a_node_was_configured_are_received() -> None:
    with (
        sender(depth=1, durability=LATCHING) as latched,
        Rig(deaf=True, latched_objects=True, autostart=False, unmatched={"objects"}) as rig,
    ):
        latched.publish(MarkerArray(markers=[cube(A1), cube(("a", 2), (0.5, 0, 0))]))
        start = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE
        rig.go_through(*start)
        rig.until(lambda: len(rig.node.cycle.report or ()) == 1, "a pair")
        rig.go_through(Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP, *start)
        rig.until(lambda: len(rig.node.cycle.report or ()) == 1, "a pair again")


def test_every_input_and_output_takes_overrides(detecting: None, rig: Rig) -> None:
    declared = set(rig.node.list_parameters([], 0).names)
    subscribed = [end.topic_name for end in rig.node.subscribed.open.values()]
    published = [end.topic_name for end in rig.node.outputs.ends.values()]
    assert {*subscribed} == {f"{NAMESPACE}/{topic}" for topic in (*INPUTS, "detections")}
    assert not rig.node.robots.robots, "without robots none of theirs"
    for policy in ("depth", "durability", "reliability"):
        assert {f"qos_overrides.{name}.subscription.{policy}" for name in subscribed} <= declared
        assert {f"qos_overrides.{name}.publisher.{policy}" for name in published} <= declared


@each(
    "policies, reason",
    [
        *(({"depth": n}, f"depth must be 1 to 100000, not {n}") for n in (-3, 100_001, 10**12)),
        ({"durability": "unknown"}, "unknown is no"),
    ],
)
def test_overrides_out_of_range_are_refused_and_why(policies: dict[str, Any], reason: str) -> None:
    for end in ("objects.subscription", "collisions.publisher"):
        named = overrides(f"{NAMESPACE}/{end}", **policies)
        given = [Parameter(name, value=value) for name, value in named.items()]
        with node_apart("observer") as observer:
            options: dict[str, Any] = {"context": observer.context, "namespace": NAMESPACE}
            with pytest.raises(InvalidQosOverridesError, match=reason):
                CollisionNode(parameter_overrides=given, **options)
            left = [observer.count_subscribers(topic) for topic in ("objects", "points")]
            assert left == [0, 0], "a node that can't start receives nothing any more"
