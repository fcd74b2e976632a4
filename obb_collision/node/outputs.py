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

"""The publishers of the node and what one cycle publishes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
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

from obb_collision.node.clouds import cloud_to_ros
from obb_collision.node.conversions import namespaces_to_ros, stamp_to_ros
from obb_collision.node.effects import TOPICS
from obb_collision.node.layouts import Rows
from obb_collision.node.markers import COLLIDING, DOUBTFUL, FREE, Markers
from obb_collision.node.objects import Objects
from obb_collision.node.parameters import Parameters
from obb_collision.node.rows import (
    clearance_rows,
    collision_rows,
    contact_rows,
    inside_rows,
    prediction_rows,
)
from obb_collision.node.text import text_from_rows
from obb_collision.scene.effects.settings import OFF
from obb_collision.scene.report import Report

RELIABLE = QoSProfile(depth=10)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""The last message reaches late subscribers too, if they ask for transient local."""
KINDS = {
    "text": DiagnosticArray,
    "in_collision": Bool,
    "markers": MarkerArray,
    "diagnostics": DiagnosticArray,
}
"""Messages of the topics that are no clouds."""


@dataclass(frozen=True)
class Published:
    """One check to publish: its report, the effects called for, its stamp (ns).

    step: seconds between this state and that of the check before. cloud_stamp: of the obstacle
    points.
    """

    report: Report
    objects: Objects
    effects: frozenset[str]
    stamp: int
    step: float
    cloud_stamp: int


class Outputs:
    """Publishes reports: clouds, text, the latched flag and table, markers."""

    def __init__(
        self,
        node: Node,
        parameters: Parameters,
    ) -> None:
        self._parameters = parameters
        self._markers = Markers(parameters.fixed_frame)
        self._next_markers = 0.0
        self._namespaces_sent = -1
        self._flag: bool | None = None

        def publisher(kind: type, topic: str, qos: QoSProfile) -> Publisher:
            events = PublisherEventCallbacks(use_default_callbacks=False)  # see qos.py
            return node.create_publisher(kind, topic, qos, event_callbacks=events)

        self.publishers = {
            effect: publisher(
                KINDS.get(effect, PointCloud2),
                topic,
                LATCHED if effect == "in_collision" else RELIABLE,
            )
            for effect, topic in TOPICS.items()
        }
        self.namespaces = publisher(DiagnosticStatus, "namespaces", LATCHED)

    @property
    def ends(self) -> dict[str, Publisher]:
        """All publishers, by topic as the node names it."""
        named = {TOPICS[effect]: publisher for effect, publisher in self.publishers.items()}
        return {**named, "namespaces": self.namespaces}

    def publish_namespaces(self, namespaces: list[str]) -> None:
        """Publish the table of namespace indices if it grew."""
        if len(namespaces) != self._namespaces_sent:
            self._namespaces_sent = len(namespaces)
            self.namespaces.publish(namespaces_to_ros(namespaces))

    def publish_report(self, given: Published) -> None:
        """Publish what is called for, also when it is empty."""
        table, report = given.objects.table, given.report
        self.publish_namespaces(table.namespaces)
        header = Header(stamp=stamp_to_ros(given.stamp), frame_id=self._parameters.fixed_frame)
        if not given.effects.isdisjoint(("collisions", "text")):
            self._publish_pairs(given, header)
        self._publish_flag(len(report) > 0, "in_collision" in given.effects)
        for effect, rows in self._clouds(given):
            stamp = given.cloud_stamp if effect == "points" else given.stamp
            header = Header(stamp=stamp_to_ros(stamp), frame_id=self._parameters.fixed_frame)
            self.publishers[effect].publish(cloud_to_ros(rows, header))

    def _clouds(self, given: Published) -> Iterator[tuple[str, Rows]]:
        """Yield the effects that were called for and did not fail, with their rows."""
        table, results = given.objects.table, given.report.results
        makers: dict[str, Callable[[Any], Rows]] = {
            "contacts": lambda result: contact_rows(result, table),
            "clearance": lambda result: clearance_rows(result, table),
            "sweep": lambda result: prediction_rows(result, given.step, table),
            "points": lambda result: inside_rows(result, given.report.cycle.points, table),
        }
        for effect, make in makers.items():
            if effect in given.effects and effect in results:
                yield effect, make(results[effect])

    def _publish_pairs(self, given: Published, header: Header) -> None:
        table = given.objects.table
        rows = collision_rows(given.report, table)
        if "collisions" in given.effects:
            self.publishers["collisions"].publish(cloud_to_ros(rows, header))
        if "text" in given.effects:
            limit = self._parameters.max_text_pairs
            text = text_from_rows(rows, table.namespaces, header, limit)
            self.publishers["text"].publish(text)

    def _publish_flag(self, flag: bool, called: bool) -> None:
        """Publish the latched flag, also unheard where it changed: late subscribers get the last.

        Not where the effect is off.
        """
        if called or (self._parameters.mode("in_collision") != OFF and flag != self._flag):
            self._flag = flag
            self.publishers["in_collision"].publish(Bool(data=flag))

    def publish_markers(self, given: Published) -> None:
        """Publish the boxes, if it is time to and somebody looks."""
        parameters, now = self._parameters, perf_counter()
        if parameters.marker_rate <= 0.0 or now < self._next_markers:
            return
        if "markers" not in given.effects:
            return
        self._next_markers = now + 1.0 / parameters.marker_rate
        objects, table = given.objects, given.objects.table
        slots = objects.scene.indices
        drawn = table.placed[slots]
        slots, boxes = slots[drawn], objects.scene.boxes.take(np.flatnonzero(drawn))
        colors = np.where(objects.doubtful[slots], DOUBTFUL, FREE)
        colors[given.report.colliding[slots]] = COLLIDING
        form, most = parameters.marker_form, parameters.marker_max_cubes
        lines = form == "lines" or (form == "auto" and len(slots) > most)
        self.publishers["markers"].publish(
            self._markers.write(
                [] if lines else [table.key(slot) for slot in slots],
                boxes,
                colors,
                given.stamp,
                parameters.marker_lifetime,
                parameters.marker_line_width if lines else None,
            )
        )
