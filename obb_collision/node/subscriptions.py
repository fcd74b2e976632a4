"""The subscriptions of the node: types, depths, QoS that a parameter can change."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from geometry_msgs.msg import TransformStamped
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSPolicyKind, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import MultiDOFJointState, PointCloud2
from visualization_msgs.msg import MarkerArray

from obb_collision.node.monitors import InputMonitor


class Input(NamedTuple):
    """An input topic: its messages, and how many of them may wait."""

    kind: type
    depth: int


INPUTS = {
    # Markers and single poses are for different objects, so more of them wait; the bulk messages
    # overtake themselves.
    "objects": Input(MarkerArray, 100),
    "object_transform": Input(TransformStamped, 1000),
    "object_states": Input(MultiDOFJointState, 10),
    "object_poses": Input(PointCloud2, 10),
}


def subscribe(
    node: Node,
    takers: Mapping[str, Callable[[Any], None]],
    monitors: Mapping[str, InputMonitor],
    on_mismatch: Callable[[str, int], None],
) -> list[str]:
    """Subscribe to the topics of ``takers``; returns the resolved topics."""
    topics = []
    for topic, take in takers.items():

        def mismatch(info: Any, topic: str = topic) -> None:
            monitors[topic].mismatches = info.total_count
            on_mismatch(topic, info.total_count)

        subscription = node.create_subscription(
            INPUTS[topic].kind,
            topic,
            take,
            QoSProfile(depth=INPUTS[topic].depth),
            event_callbacks=SubscriptionEventCallbacks(incompatible_qos=mismatch),
            qos_overriding_options=QoSOverridingOptions(
                [QoSPolicyKind.DEPTH, QoSPolicyKind.DURABILITY, QoSPolicyKind.RELIABILITY]
            ),
        )
        monitors[topic].topic = subscription.topic_name
        topics.append(subscription.topic_name)
    return topics
