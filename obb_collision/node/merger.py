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

"""The merger as a node: joins the clouds of several collision nodes, each with its region.

The console script ``obb_collision_merge``. Region by region it subscribes to the topics of a node
in the namespace of that name, and publishes what all found together on the same topics.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from copy import copy
from time import monotonic
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node
from rclpy.subscription import Subscription
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from obb_collision.node.diagnostics.answer import (
    CODES,
    COLLIDING,
    FREE,
    RADIUS,
    SELECTED_RADIUS,
    Answer,
    Reason,
    make_status,
)
from obb_collision.node.diagnostics.monitors import make_publisher
from obb_collision.node.messages.clouds import cloud_to_bytes
from obb_collision.node.messages.conversions import stamp_from_ros
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.parameters.entries import bounds_from_text
from obb_collision.node.runtime.guard import Guard
from obb_collision.node.runtime.running import run_node
from obb_collision.node.status.collision_status import CollisionStatus
from obb_collision.node.topics.cloud import Cloud, Topic
from obb_collision.node.topics.topics import COLLISIONS, NAMESPACES, TOPICS
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.store.region import RegionMerger, coverage

NODE_NAME = "obb_collision_merge"
PERIOD = 0.1
"""Seconds between two looks for regions that are missing and for new subscribers."""
COUNT_DIGITS = 18
"""Most digits of a number of objects: Python reads no more than some thousand."""
STATUS, FLAG = TOPICS["collision_status"], TOPICS["in_collision"]
CLOUDS: dict[str, Cloud[Any]] = {
    topic.name: topic
    for name, topic in TOPICS.items()
    if isinstance(topic, Cloud) and (topic is COLLISIONS or name in EFFECTS)
}
"""Published every cycle, so that they can be joined by stamp."""


EMPTY = make_status("", DiagnosticStatus.STALE, "empty status", [("reasons", "incomplete")], "")
"""Stands for a status without content."""


class AlwaysPublished:
    """The topics of the merger's status: neither can be off."""

    def is_off(self, name: str) -> bool:
        """Return whether a topic is never published."""
        return False

    def is_requested(self, name: str) -> bool:
        """Return whether a topic is published though nothing has changed."""
        return True


class MergerNode(Node):
    """Joins what the nodes of several regions publish; options go to ``rclpy.node.Node``."""

    def __init__(self, **node_options: Any) -> None:
        super().__init__(NODE_NAME, **node_options)
        self._ending = ExitStack()
        try:
            self._set_up()
        except BaseException:
            self.destroy_node()
            raise

    def _set_up(self) -> None:
        def read(name: str, default: Any, description: str) -> Any:
            descriptor = ParameterDescriptor(description=description, read_only=True)
            return self.declare_parameter(name, default, descriptor).value

        regions = read("regions", [""], "Namespaces of the nodes to merge.")
        if regions == [""]:
            raise ValueError("regions must name the nodes to join: -p regions:='[west, east]'")
        timeout = read(
            "timeout",
            0.5,
            "Maximum time without a message of a region (s), after which it is missing.",
        )
        unknown = read(
            "unknown_is_collision",
            True,
            "Whether in_collision is true while collisions are unknown.",
        )
        self._merger = RegionMerger(regions, timeout)
        self.guard = Guard(self.get_logger().error, self.context.ok)
        self._statuses: dict[str, DiagnosticStatus] = {}
        self._bounds: dict[str, str] = {}  # the last ones that each region published
        self._covered: tuple[dict[str, str], list[Reason]] = {}, []
        self._names: dict[str, str] = {}
        self._joined_at, self._pairs = monotonic(), 0
        self._regions = list(regions)
        self._publishers_of = {
            topic.name: make_publisher(self, topic.message, topic.name, topic.qos, is_watched=False)
            for topic in (*CLOUDS.values(), STATUS, FLAG, NAMESPACES)
        }
        self.status = CollisionStatus(
            f"{self.get_fully_qualified_name().lstrip('/')}: collision",
            self._publishers_of,
            AlwaysPublished(),
            lambda: unknown,
            lambda: self.get_clock().now().nanoseconds,
            self.guard,
        )
        self._ending.callback(self.status.close)
        self._clouds: dict[str, list[Subscription]] = {}
        self._status_topics: dict[str, str] = {}  # after remapping
        for region in self._regions:
            self._listen(region, NAMESPACES, lambda message, _: self._store_names(message))
            status = self._listen(region, STATUS, self._store_status)
            self._status_topics[region] = status.topic_name
        self.create_timer(PERIOD, self.guard.catching("status")(self._look))
        self._look()

    def _listen(self, region: str, topic: Topic, take: Callable[[Any, str], None]) -> Subscription:
        def taken(message: Any) -> None:
            with self.guard.catching(f"{region}/{topic.name}"):
                take(message, region)

        name, qos = f"{region}/{topic.name}", copy(topic.qos)
        return self.create_subscription(topic.message, name, taken, qos)

    def _look(self) -> None:
        """Subscribe to the clouds that are requested, and publish the status."""
        for name, cloud in CLOUDS.items():
            wanted = cloud is COLLISIONS or self._publishers_of[name].get_subscription_count() > 0
            if wanted and name not in self._clouds:
                self._clouds[name] = [
                    self._listen(region, cloud, self._joiner(cloud)) for region in self._regions
                ]
            elif not wanted and name in self._clouds:
                for subscription in self._clouds.pop(name):
                    self.destroy_subscription(subscription)
        self._publish_status()

    def _store_names(self, message: DiagnosticStatus) -> None:
        new = values_of(message)
        if not new.items() <= self._names.items():
            self._names.update(new)
            content = message.name, DiagnosticStatus.OK, message.message, self._names.items()
            self._publishers_of[NAMESPACES.name].publish(make_status(*content, message.hardware_id))

    def _store_status(self, message: DiagnosticArray, region: str) -> None:
        (self._statuses[region],) = message.status[:1] or [EMPTY]
        values = values_of(self._statuses[region])
        self._bounds[region] = values.get("region") or self._bounds.get(region, "")
        count = values.get("objects", "")
        if count.isdecimal() and len(count) <= COUNT_DIGITS:
            self._merger.mark_alive(region, int(count), monotonic())
        self._publish_status()

    def _joiner(self, cloud: Cloud[Any]) -> Callable[[PointCloud2, str], None]:
        def take(message: PointCloud2, region: str) -> None:
            try:
                rows = cloud.from_ros(message)
                stamp = stamp_from_ros(message.header.stamp)
                joined = self._merger.take(region, stamp, rows, monotonic(), cloud.name)
            except (RefusedError, ValueError) as error:
                self.get_logger().warning(
                    f"{region}/{cloud.name}: {error}", throttle_duration_sec=5.0
                )
                return
            if joined is not None:
                self._publish(cloud, joined, message.header)

        return take

    def _publish(self, cloud: Cloud[Any], rows: Any, header: Header) -> None:
        packed = np.zeros(len(rows), cloud.dtype)  # padding between fields is 0, too
        for name in rows.dtype.names:
            packed[name] = rows[name]
        stamp, frame = stamp_from_ros(header.stamp), header.frame_id
        data = cloud_to_bytes(packed, stamp, frame, cloud.field_bytes)
        self._publishers_of[cloud.name].publish(data)
        if cloud is COLLISIONS:
            self._joined_at, self._pairs = monotonic(), len(rows)
            self._publish_status()

    def _answer(self) -> Answer:
        """Combine the answers of the regions: a reason of one is a reason of all."""
        now = monotonic()
        missing = self._merger.missing(now)
        present = [r for r in self._regions if r in self._statuses and r not in missing]
        values_of_regions = {region: values_of(self._statuses[region]) for region in present}
        whose: dict[str, list[str]] = {}
        for region, values in values_of_regions.items():
            codes = [code for code in values.get("reasons", "").split() if code in CODES]
            if not codes and self._statuses[region].level not in (FREE, COLLIDING):
                codes = ["incomplete"]  # a newer version may have others
            for code in codes:
                whom = values.get("who", "") if code == values.get("reason") else ""
                whose.setdefault(code, []).append(f"{region} ({whom})" if whom else region)
        reasons = [Reason(code, tuple(who), len(who)) for code, who in whose.items()]
        if missing:
            whys = ((r, why.partition(" for ")[0]) for r, why in missing.items())  # no seconds
            silent = tuple(f"{region} ({why})" for region, why in whys)
            reasons.append(Reason("region_silent", silent, len(silent)))
        reasons += [*self._shared(), *self._uncovered()]
        fresh = now - self._joined_at <= self._merger.timeout
        if not fresh and not reasons:
            bare = tuple(
                r for r, values in values_of_regions.items() if values.get("stamped") == str(False)
            )
            detail = "none of their objects has a stamp (stamp 0)" if bare else ""
            reasons.append(Reason("region_unmatched", bare, len(bare), detail))
        # the last status of a region counts while it is missing, too
        colliding = [r for r, status in self._statuses.items() if status.level == COLLIDING]
        pairs = self._pairs if fresh else 0
        counts: dict[str, object] = {
            "regions": len(self._regions),
            "missing regions": len(missing),
            "rows of several regions": self._merger.repeated,
        }
        for key in (RADIUS, SELECTED_RADIUS):
            radii = [values.get(key, "") for values in values_of_regions.values()]
            if radii and all(map(_is_length, radii)):  # else it is not known how far all look
                counts[key] = min(map(float, radii))
        most = max(pairs, len(colliding))
        return Answer((), most, most > pairs, counts=counts, stamp=None).but(*reasons)

    def _shared(self) -> Iterator[Reason]:
        """Yield what several nodes publish: a region's status, or this one."""
        count, name = self.count_publishers, STATUS.name
        twice = tuple(r for r in self._regions if count(self._status_topics[r]) > 1)
        if twice:
            yield Reason("region_twice", twice, len(twice))
        if count(self._publishers_of[name].topic_name) > 1:
            yield Reason("two_publishers", (name,), 1)

    def _uncovered(self) -> list[Reason]:
        """Return how regions fail to fill space once, by the last bounds that they published."""
        if len(self._bounds) < len(self._regions):  # else regions without bounds are silent
            return []
        if self._covered[0] != self._bounds:
            self._covered = dict(self._bounds), _uncovered(self._bounds)
        return self._covered[1]

    def _publish_status(self) -> None:
        answer, before = self._answer(), self.status.answer
        if before.kind[1:] != answer.kind[1:]:
            self.get_logger().info(
                f"not known: {answer.why}" if answer.why else "all regions answer"
            )
        self.status.update(answer, cycle=True)

    def say_farewell(self) -> None:
        """Publish that the merger ends."""
        self.status.close()

    def destroy_node(self) -> None:
        """Publish that the merger ends, and end."""
        self._ending.close()
        super().destroy_node()


def values_of(status: DiagnosticStatus) -> dict[str, str]:
    """Return the values of a status by key."""
    return {pair.key: pair.value for pair in status.values}


def _uncovered(bounds: Mapping[str, str]) -> list[Reason]:
    """Return how regions fail to fill space once, by the bounds in their statuses."""
    regions, unclear = {}, []
    for name, text in bounds.items():
        try:
            regions[name] = bounds_from_text(text)
        except ValueError:
            unclear.append(name)
    if unclear:
        who = tuple(unclear)
        return [Reason("region_gap", who, len(who), "these nodes do not publish their bounds")]
    has_gap, rows = coverage([*regions.values()])
    twice = tuple(name for row, name in enumerate(regions) if row in rows)
    gap = [Reason("region_gap", detail="the space between or beyond their bounds is not checked")]
    return [Reason("region_twice", twice, len(twice))] * bool(twice) + gap * has_gap


def _is_length(text: str) -> bool:
    try:
        return 0.0 <= float(text) < np.inf
    except ValueError:
        return False


def main(args: Sequence[str] | None = None) -> int:
    """Run the console script ``obb_collision_merge``."""
    return run_node(NODE_NAME, lambda context, _: MergerNode(context=context), args)
