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


"""Steps of the sensors of a walk: clouds, scans, ranges, and a cloud that is only watched."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import wraps
from math import inf, isnan, nan
from typing import Any

from evidence_faults import FaultMachine
from evidence_machine import Ahead, of_robot
from evidence_things import OFFSET
from evidence_world import (
    EITHER,
    FRAMES,
    FRONT,
    JOINTS,
    LASER,
    PLACES,
    SONAR,
    STAMPS,
    WATCHED,
    rule,
)
from sensor_msgs.msg import LaserScan, PointCloud2, Range
from sensor_rig import cloud_of
from walks import one_of, repeated

FAULTS = one_of(["", "", "", "", "", "nothing", "content", "stamp", "cut"])
"""Of messages: nothing is known, points cannot be read, the stamp cannot, nothing can."""


def of_sensors(step: Callable[..., None]) -> Callable[..., None]:
    """Let a step be none where there are no sensors."""

    @wraps(step)
    def go(machine: Any, *given: Any, **named: Any) -> None:
        if machine.has_sensors:
            step(machine, *given, **named)

    return go


class SensorMachine(FaultMachine):
    """A machine whose node has sensors."""

    def see_all(self) -> None:
        """Let every sensor deliver."""
        if self.has_sensors:
            self.see()
            self.scan()
            self.measure()

    @rule(3.0, points=repeated(PLACES, 0, 2), frame=FRAMES, ahead=STAMPS, fault=FAULTS)
    @of_sensors
    def see(
        self, points: Sequence[float] = (), frame: str = "map", ahead: Ahead = 0.0, fault: str = ""
    ) -> None:
        """Send a cloud; content: without fields, which counts once it is used."""
        header, stamp = self.header(frame, ahead, fault)
        rows = [[nan] * 3] if fault == "nothing" else [[x, 0.0, 0.0] for x in points]
        message = cloud_of(rows, header, "<f8")
        if fault == "content":
            message = PointCloud2(header=header, width=1, height=1)
        self.send_seen(FRONT, message, frame, stamp, points, fault)

    @rule(2.0, points=repeated(PLACES, 0, 2), values=one_of(JOINTS), ahead=STAMPS)
    @of_robot
    @of_sensors
    def see_itself(
        self, points: Sequence[float] = (), values: Any = (1.4, 3.0), ahead: Ahead = 0.0
    ) -> None:
        """Send joints, and a cloud of the same time that sees the base of the robot, too."""
        self.joints(values, ahead)
        assert self.model.robot is not None
        base = self.model.robot.base
        own = [] if isnan(base.x) else [base.x + OFFSET * (base.frame == "odom")]
        self.see([*own, *points], ahead=ahead)

    @rule(2.0, points=repeated(PLACES, 0, 2), frame=FRAMES, ahead=STAMPS, fault=FAULTS)
    @of_sensors
    def scan(
        self,
        points: Sequence[float] = (inf,),
        frame: str = "map",
        ahead: Ahead = 0.0,
        fault: str = "",
    ) -> None:
        """Send a scan whose rays all go along x; without any, it knows nothing."""
        header, stamp = self.header(frame, ahead, fault)
        known = [] if fault == "nothing" else points
        message = LaserScan(header=header, ranges=[nan, *known], range_max=10.0)
        if fault == "content":
            message.angle_min = nan
        seen = [x for x in points if x < inf]
        fault = "nothing" if not points and not fault else fault
        self.send_seen(LASER, message, frame, stamp, seen, fault)

    @rule(x=PLACES, frame=FRAMES, ahead=STAMPS, fault=FAULTS)
    @of_sensors
    def measure(
        self, x: float = inf, frame: str = "map", ahead: Ahead = 0.0, fault: str = ""
    ) -> None:
        """Send a range."""
        header, stamp = self.header(frame, ahead, fault)
        message = Range(header=header, range=nan if fault == "nothing" else x, max_range=10.0)
        if fault == "content":
            message.field_of_view = -1.0
        seen = [x] if x < inf else []
        self.send_seen(SONAR, message, frame, stamp, seen, fault)

    @rule(0.5, cut=EITHER)
    @of_sensors
    def watch(self, cut: bool = False) -> None:
        """Send a cloud that is in no pair: it changes nothing."""
        self.send(WATCHED, cloud_of([[0.0] * 3], self.header("map", 0.0)[0]), cut)

    def send_seen(
        self, topic: str, message: Any, frame: str, stamp: float, points: Sequence[float],
        fault: str,
    ) -> None:  # fmt: skip
        self.send(topic, message, fault == "cut")
        (source,) = (one for one in self.model.sources if one.topic == topic)
        is_read = fault not in ("stamp", "cut") and (fault != "content" or topic == FRONT)
        content = None if fault in ("nothing", "content") else points
        source.take(self.model, frame, stamp, content, is_read)
