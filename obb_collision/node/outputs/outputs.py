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

"""The publishers of the node, what is requested of them, and what one cycle publishes."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
import numpy.typing as npt
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from std_msgs.msg import Header

from obb_collision.accuracy import Accuracy
from obb_collision.node.diagnostics.answer import make_status
from obb_collision.node.diagnostics.monitors import make_publisher
from obb_collision.node.messages.box_markers import COLLIDING, DOUBTFUL, FREE, Markers
from obb_collision.node.messages.cdr import namespace_bytes
from obb_collision.node.messages.clouds import cloud_to_bytes
from obb_collision.node.messages.conversions import name_from_key, stamp_to_ros
from obb_collision.node.messages.names import NamespaceTable
from obb_collision.node.objects.objects import Objects
from obb_collision.node.outputs.events import Events
from obb_collision.node.parameters.parameters import Parameters
from obb_collision.node.runtime.guard import Guard
from obb_collision.node.topics.cloud import Cloud, Topic
from obb_collision.node.topics.rows import CheckedState, StructuredRows
from obb_collision.node.topics.topics import COLLISIONS, EVENTS, NAMESPACES, TOPICS, mode_names
from obb_collision.queries.verdict.verdict import Verdict
from obb_collision.scene.effects.settings import AUTO, OFF, ON

NAMESPACES_RATE = 5e6
"""Maximum bytes per second of the table of namespaces, sent as a whole: 100 kB at 50 Hz."""
NAMESPACES_PERIOD = 2.0
"""Seconds after which the table is sent again though it is the same."""


@dataclass(frozen=True)
class Published(CheckedState):
    """One check to publish, with the objects and the requested effects."""

    objects: Objects
    effects: frozenset[str]


class Effects:
    """Effects that are requested: those that are on, and those whose topics have subscribers.

    An effect of the scene is computed, and a message built, only if it is requested. publishers:
    of those with a topic.
    """

    def __init__(self, parameters: Parameters, publishers: Mapping[str, Publisher]) -> None:
        self._parameters, self._publishers = parameters, publishers
        self._names = mode_names()

    def is_requested(self, name: str) -> bool:
        """Return whether an effect is on, or there are subscribers of a topic that needs it."""
        mode = self._parameters.mode(name)
        if mode != AUTO:
            return mode == ON
        if name not in TOPICS:
            return any(name in topic.needs and self.is_requested(n) for n, topic in TOPICS.items())
        return self._publishers[name].get_subscription_count() > 0

    def is_off(self, name: str) -> bool:
        """Return whether an effect is never computed, or a topic never published."""
        return bool(self._parameters.mode(name) == OFF)

    def of_cycle(self) -> frozenset[str]:
        """Return the effects to compute in this cycle."""
        return frozenset(filter(self.is_requested, self._names))

    def states(self) -> dict[str, str]:
        """Return the state of each effect in words, for /diagnostics."""
        return {name: self._state(name) for name in self._names}

    def _state(self, name: str) -> str:
        mode = self._parameters.mode(name)
        if mode == OFF:
            return mode
        return f"{mode}, {'computed' if self.is_requested(name) else 'not requested'}"


class Outputs:
    """Publishes reports: clouds, text, the latched table, markers; has all publishers."""

    def __init__(self, node: Node, parameters: Parameters, guard: Guard) -> None:
        self.parameters, self.guard = parameters, guard
        self._markers = Markers(parameters.fixed_frame)
        self._next_markers = 0.0
        self._namespaces_sent = -1  # version of the table
        self._next_namespaces = 0.0

        def publisher(topic: Topic) -> Publisher:
            qos = copy(topic.qos)
            if topic is TOPICS["collision_status"]:
                qos.deadline = Duration(seconds=parameters.status_deadline)
            return make_publisher(node, topic.message, topic.name, qos)

        self.publishers = {name: publisher(topic) for name, topic in TOPICS.items()}
        self.namespaces = publisher(NAMESPACES)
        self.effects = Effects(parameters, self.publishers)
        self.events = Events(parameters, self.publishers["events"].get_subscription_count)

    @property
    def ends(self) -> dict[str, Publisher]:
        """All publishers, by the node's names of their topics."""
        named = {TOPICS[name].name: publisher for name, publisher in self.publishers.items()}
        return {**named, NAMESPACES.name: self.namespaces}

    def withdraw(self, now: int) -> None:
        """Delete the boxes shown, and send the table of namespaces anew next time."""
        self._namespaces_sent, self._next_namespaces = -1, 0.0
        if self._markers.shown:
            self.publishers["markers"].publish(self._markers.clear(now))

    def publish_namespaces(self, namespaces: NamespaceTable) -> None:
        """Publish the table of namespace numbers if it changed: a large one not at every cycle.

        Every NAMESPACES_PERIOD also unchanged: subscribers that come late without asking for
        latched messages, or that lost one, need it to name anything.
        """
        now = perf_counter()
        changed = namespaces.version != self._namespaces_sent
        if now < self._next_namespaces + (0.0 if changed else NAMESPACES_PERIOD):
            return
        data = namespace_bytes(namespaces.names)
        self._namespaces_sent = namespaces.version
        self._next_namespaces = now + len(data) / NAMESPACES_RATE
        self.namespaces.publish(data)

    def publish_report(self, state: Published) -> None:
        """Publish the requested outputs, also empty ones; one that fails does not stop others.

        The table of namespaces goes first, so that the rest can be read.
        """
        with self.guard.catching("output namespaces"):
            self.publish_namespaces(state.table.namespaces)
        if not state.effects.isdisjoint(("collisions", "text", "events")):
            with self.guard.catching("output collisions"):
                self._publish_pairs(state)
        if "events" not in state.effects:
            self.events.forget()
        results = state.report.results
        for name in results.keys() & state.effects:
            topic = TOPICS.get(name)
            if isinstance(topic, Cloud):
                with self.guard.catching(f"output {name}"):
                    self._publish_cloud(name, topic, results[name], state)

    def _publish_cloud(self, name: str, cloud: Cloud[Any], result: Any, state: Published) -> None:
        rows = cloud.make_rows(result, state, cloud.dtype)
        stamp = state.cloud_stamp if cloud.of_points else state.stamp
        self._publish_rows(name, cloud, rows, stamp)

    def _publish_rows(self, name: str, cloud: Cloud[Any], rows: StructuredRows, stamp: int) -> None:
        data = cloud_to_bytes(rows, stamp, self.parameters.fixed_frame, cloud.field_bytes)
        self.publishers[name].publish(data)

    def _publish_pairs(self, state: Published) -> None:
        rows = COLLISIONS.make_rows(state.report, state, COLLISIONS.dtype)
        if "collisions" in state.effects:
            self._publish_rows("collisions", COLLISIONS, rows, state.stamp)
        if "events" in state.effects:
            with self.guard.catching("output events"):
                events = self.events.rows(rows, state, "separations" in state.effects)
                if events is not None:
                    self._publish_cloud("events", EVENTS, events, state)
        if "text" in state.effects:
            names, limit = state.table.namespaces.names, self.parameters.max_text_pairs
            header = Header(stamp=stamp_to_ros(state.stamp), frame_id=self.parameters.fixed_frame)
            total = (state.report.total, state.report.truncated)
            text = text_from_rows(rows, names, header, limit, *total)
            self.publishers["text"].publish(text)

    def publish_markers(self, state: Published) -> None:
        """Publish the boxes, if it is time to and there are subscribers."""
        parameters, now = self.parameters, perf_counter()
        if parameters.marker_rate <= 0.0 or now < self._next_markers:
            return
        if "markers" not in state.effects:
            return
        self._next_markers = now + 1.0 / parameters.marker_rate
        objects, table = state.objects, state.table
        slots = objects.scene.indices
        drawn = table.visible[slots] & np.isin(slots, objects.scene.objects.near)
        slots, boxes = slots[drawn], objects.scene.boxes[drawn]
        unclear = table.doubtful[slots] | state.report.truncated  # others may collide, too
        colors = np.where(unclear, DOUBTFUL, FREE)
        colors[state.report.colliding[slots]] = COLLIDING
        form, most = parameters.marker_form, parameters.marker_max_cubes
        lines = form == "lines" or (form == "auto" and len(slots) > most)
        keys = [] if lines else table.keys(slots)
        width = parameters.marker_line_width if lines else None
        drawing = keys, boxes, colors, state.stamp, parameters.marker_lifetime, width
        self.publishers["markers"].publish(self._markers.write(*drawing))


def text_from_rows(
    rows: npt.NDArray[Any],
    namespaces: Mapping[int, str],
    header: Header,
    limit: int,
    total: int,
    truncated: bool,
) -> DiagnosticArray:
    """Return a status with the total, then one per pair, at most ``limit``.

    total: how many pairs collide, a lower bound if ``truncated``.
    """
    message_total = f"{'at least ' if truncated else ''}{total} pairs in collision"
    if total > limit:
        message_total += f", the first {min(limit, len(rows))} named"
    counts = {"pairs": len(rows)} | ({"pairs at least": total} if truncated else {})
    ok, warn = DiagnosticStatus.OK, DiagnosticStatus.WARN
    status = [make_status("collisions", ok, message_total, counts.items(), "")]
    for row in rows[:limit]:
        a = name_from_key((namespaces[int(row["ns_a"])], int(row["id_a"])))
        b = name_from_key((namespaces[int(row["ns_b"])], int(row["id_b"])))
        values = {
            "a": a,
            "b": b,
            "depth": repr(float(row["depth"])),
            "normal": " ".join(f"{row['normal_' + axis]:.4f}" for axis in "xyz"),
            "verdict": Verdict(row["verdict"]).name.lower(),
            "accuracy": Accuracy(row["accuracy"]).label,
        }
        depth = "overlapping" if np.isnan(row["depth"]) else f"{row['depth']:.6f} m deep"
        text = "touching" if row["verdict"] == Verdict.TOUCHING else depth
        status.append(make_status(f"{a} - {b}", warn, text, values.items(), ""))
    return DiagnosticArray(header=header, status=status)
