"""The publishers of the node and what one cycle publishes."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Bool, Header
from visualization_msgs.msg import MarkerArray

from obb_collision.node.clouds import collisions_to_ros
from obb_collision.node.conversions import namespaces_to_ros, stamp_to_ros
from obb_collision.node.markers import COLLIDING, DOUBTFUL, FREE, Markers
from obb_collision.node.objects import Objects
from obb_collision.node.parameters import Parameters
from obb_collision.node.results import collision_rows, text_from_rows
from obb_collision.scene.report import Report

RELIABLE = QoSProfile(depth=10)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""The last message reaches late subscribers too, if they ask for transient local."""


class Outputs:
    """Publishes reports: pairs, their text, the latched flag and table, markers."""

    def __init__(
        self,
        node: Node,
        parameters: Parameters,
        on_mismatch: Callable[[str, int], None],
    ) -> None:
        self._node, self._parameters = node, parameters
        self._markers = Markers(parameters.fixed_frame)
        self._next_markers = 0.0
        self._namespaces_sent = -1

        def publisher(kind: type, topic: str, qos: QoSProfile) -> Publisher:
            def mismatch(info: Any) -> None:
                on_mismatch(topic, info.total_count)

            events = PublisherEventCallbacks(incompatible_qos=mismatch)
            return node.create_publisher(kind, topic, qos, event_callbacks=events)

        self.collisions = publisher(PointCloud2, "collisions", RELIABLE)
        self.text = publisher(DiagnosticArray, "collisions_text", RELIABLE)
        self.in_collision = publisher(Bool, "in_collision", LATCHED)
        self.namespaces = publisher(DiagnosticStatus, "namespaces", LATCHED)
        self.markers = publisher(MarkerArray, "~/markers", RELIABLE)
        self.diagnostics = publisher(DiagnosticArray, "/diagnostics", RELIABLE)

    @property
    def topics(self) -> list[str]:
        """Resolved names of the topics."""
        publishers = (self.collisions, self.text, self.in_collision, self.namespaces)
        return [p.topic_name for p in (*publishers, self.markers, self.diagnostics)]

    def publish_namespaces(self, namespaces: list[str]) -> None:
        """Publish the table of namespace indices if it grew."""
        if len(namespaces) != self._namespaces_sent:
            self._namespaces_sent = len(namespaces)
            self.namespaces.publish(namespaces_to_ros(namespaces))

    def publish_report(self, report: Report, objects: Objects, stamp: int) -> None:
        """Publish the pairs, also when there are none."""
        table, fixed_frame = objects.table, self._parameters.fixed_frame
        header = Header(stamp=stamp_to_ros(stamp), frame_id=fixed_frame)
        rows = collision_rows(report, table)
        self.publish_namespaces(table.namespaces)
        self.collisions.publish(collisions_to_ros(rows, header))
        self.in_collision.publish(Bool(data=len(rows) > 0))
        if self.text.get_subscription_count():
            limit = self._parameters.max_text_pairs
            self.text.publish(text_from_rows(rows, table.namespaces, header, limit))

    def publish_markers(self, report: Report, objects: Objects, stamp: int) -> None:
        """Publish the boxes, if it is time to and somebody looks."""
        parameters, now = self._parameters, perf_counter()
        if parameters.marker_rate <= 0.0 or now < self._next_markers:
            return
        if not self.markers.get_subscription_count():
            return
        self._next_markers = now + 1.0 / parameters.marker_rate
        table = objects.table
        slots = objects.scene.indices
        drawn = table.placed[slots]
        slots, boxes = slots[drawn], objects.scene.boxes.take(np.flatnonzero(drawn))
        colors = np.where(objects.doubtful[slots], DOUBTFUL, FREE)
        colors[report.colliding[slots]] = COLLIDING
        form, most = parameters.marker_form, parameters.marker_max_cubes
        lines = form == "lines" or (form == "auto" and len(slots) > most)
        self.markers.publish(
            self._markers.write(
                [] if lines else [table.key(slot) for slot in slots],
                boxes,
                colors,
                stamp,
                parameters.marker_lifetime,
                parameters.marker_line_width if lines else None,
            )
        )
