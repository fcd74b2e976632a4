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

"""QoS of the node's endpoints: what fits whom, and what parameters change."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from each import each

pytest.importorskip("rclpy")
from lifecycle_msgs.msg import Transition
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import InvalidQosOverridesError
from rig import DOMAIN, INPUTS, NAMESPACE, Rig, cube
from sensor_msgs.msg import JointState, PointCloud2
from visualization_msgs.msg import MarkerArray

from obb_collision.node.inputs import detections
from obb_collision.node.inputs.subscriptions import Input
from obb_collision.node.node import CollisionNode
from obb_collision.node.topics.cloud import LATCHED, RELIABLE

A1 = ("a", 1)
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
        rig.listen("points_inside")
        rig.send(cube(A1))
        rig.answer()

        def inside() -> Any:  # best effort: sent again until it arrives
            rig.send_points(np.zeros((3, 3)))
            rig.executor.spin_once(timeout_sec=0.05)
            message = rig.last.get("points_inside")
            return message is not None and message.width == 1

        rig.until(inside, "points in the box")


def test_joints_and_detections_match_what_sends_best_effort(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given = {"detections": Input(PointCloud2, *detections.QUEUE)}  # vision_msgs need not be there
    monkeypatch.setattr(detections, "INPUTS", given)
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
    context = Context()
    context.init(domain_id=DOMAIN)
    node = Node("sender", context=context, namespace=NAMESPACE)
    try:
        yield node.create_publisher(MarkerArray, "objects", QoSProfile(**policies))
    finally:
        node.destroy_node()
        context.try_shutdown()


def test_all_that_was_latched_before_the_node_started_is_received() -> None:
    with sender(depth=300, durability=LATCHING) as latched:
        for number in range(300):  # more than wait where senders do not latch
            latched.publish(MarkerArray(markers=[cube(("a", number), (2.0 * number, 0, 0))]))
        latched.publish(MarkerArray(markers=[cube(("a", 299), (2.5, 0, 0))]))
        with Rig(deaf=True, latched_objects=True, unmatched={"objects"}) as rig:
            rig.until(lambda: len(rig.node.objects.table) == 299, "all but the oldest")
            rig.until(lambda: len(rig.node.cycle.report or ()) == 1, "a pair")
            monitor = rig.monitor("objects")
            assert (monitor.messages, monitor.lost, monitor.refused.total()) == (300, 0, 0)


def test_senders_that_do_not_latch_are_named_where_objects_are_latched() -> None:
    with sender(depth=1, durability=LATCHING) as latched:
        latched.publish(MarkerArray(markers=[cube(A1)]))
        with Rig(deaf=True, latched_objects=True, unmatched={"objects"}) as rig:
            rig.listen("/diagnostics")
            rig.until(lambda: rig.status(": qos").get("objects") == "1", "the volatile one")
            status = rig.status(": qos")
            assert status["level"] == "01"
            assert "incompatible QoS on objects" in status["message"]
            assert "Volatile publisher" in status["objects: 1"]
            assert "client" in status["objects: 1"], "the node whose publisher does not latch"
            assert rig.status("input objects")["qos mismatches"] == "1"
            rig.until(lambda: len(rig.node.objects.table) == 1, "the latched one")


def test_objects_latched_before_a_node_was_configured_are_received() -> None:
    with (
        sender(depth=1, durability=LATCHING) as latched,
        Rig(deaf=True, latched_objects=True, autostart=False) as rig,
    ):
        latched.publish(MarkerArray(markers=[cube(A1), cube(("a", 2), (0.5, 0, 0))]))
        for transition in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
            assert rig.change(transition)
        rig.until(lambda: len(rig.node.cycle.report or ()) == 1, "a pair")
        for transition in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP):
            assert rig.change(transition)
        for transition in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
            assert rig.change(transition)
        rig.until(lambda: len(rig.node.cycle.report or ()) == 1, "a pair again")


def test_every_input_and_output_takes_overrides(rig: Rig) -> None:
    declared = set(rig.node._parameters)
    ends = [
        *((end.topic_name, "subscription") for end in rig.node.subscribed.open.values()),
        *((end.topic_name, "publisher") for end in rig.node.outputs.ends.values()),
    ]
    assert {name for name, kind in ends if kind == "subscription"} == {
        f"{NAMESPACE}/{topic}" for topic in INPUTS
    }
    assert rig.node.robots is None, "without robots none of theirs"
    for name, kind in ends:
        for policy in ("depth", "durability", "reliability"):
            assert f"qos_overrides.{name}.{kind}.{policy}" in declared


@each(
    "policies, reason",
    [
        ({"depth": -3}, "depth must be 1 to 100000, not -3"),
        ({"depth": 100_001}, "depth must be 1 to 100000, not 100001"),
        ({"depth": 10**12}, "depth must be 1 to 100000, not 1000000000000"),
        ({"durability": "unknown"}, "unknown is no"),
    ],
)
def test_overrides_out_of_range_are_refused_with_the_reason(
    policies: dict[str, Any], reason: str
) -> None:
    for end in ("objects.subscription", "collisions.publisher"):
        context = Context()
        context.init(domain_id=DOMAIN)
        given = [
            Parameter(name, value=value)
            for name, value in overrides(f"{NAMESPACE}/{end}", **policies).items()
        ]
        with pytest.raises(InvalidQosOverridesError, match=reason):
            CollisionNode(context=context, namespace=NAMESPACE, parameter_overrides=given)
        observer = Node("observer", context=context, namespace=NAMESPACE)
        left = [observer.count_subscribers(topic) for topic in ("objects", "points")]
        assert left == [0, 0], "a node that can't start receives nothing any more"
        observer.destroy_node()
        context.shutdown()
