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


"""A rig with a mobile base: commands in, safe commands out, and sensors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PolygonInstanceStamped, Twist, TwistStamped
from rig import LATCHED, NAMESPACE, RELIABILITY, FakeFrames, pose
from sensor_msgs.msg import LaserScan, PointCloud2, Range
from sensor_rig import Sensing
from std_msgs.msg import Header

from obb_collision.node.messages.conversions import stamp_to_ros

KINDS = {
    "scan": LaserScan,
    "pointcloud": PointCloud2,
    "range": Range,
    "polygon": PolygonInstanceStamped,
}
SQUARE = "[[0.5, 0.5], [0.5, -0.5], [-0.5, -0.5], [-0.5, 0.5]]"
SCAN: dict[str, Any] = {"type": "scan", "topic": "scan"}
Group = Mapping[str, Any]


def zone(action: str, points: str = SQUARE, **more: Any) -> dict[str, Any]:
    """Return the parameters of a square zone of one metre, or another polygon."""
    return {"type": "polygon", "action_type": action, "points": points, "min_points": 1, **more}


def gate_parameters(zones: Mapping[str, Group], sources: Mapping[str, Group]) -> dict[str, Any]:
    """Return the parameters of zones and sources; sensors arrive surely."""
    given: dict[str, Any] = {"polygons": list(zones), "observation_sources": list(sources)}
    for name, group in (*zones.items(), *sources.items()):
        given |= {f"{name}.{key}": value for key, value in group.items()}
    for group in sources.values():
        given[f"qos_overrides.{NAMESPACE}/{group.get('topic', 'scan')}.{RELIABILITY}"] = "reliable"
    return given


class BaseRig(Sensing):
    """A node with the gate of a base, whose frame and that of its lidar are those of odometry."""

    def __init__(
        self,
        zones: Mapping[str, Group],
        sources: Mapping[str, Group] | None = None,
        stamped: bool = False,
        given: Group | None = None,
        **parameters: Any,
    ) -> None:
        sources = {"front": SCAN} if sources is None else sources
        self.frames = FakeFrames()
        self.frames.known = {name: pose(0.0) for name in ("odom", "base_footprint", "lidar")}
        own = {"enable_stamped_cmd_vel": stamped, "autostart": True, "command_timeout": 0.0}
        parameters = {**own, **parameters}
        parameters |= gate_parameters(zones, sources) | dict(given or {})
        super().__init__(frames=self.frames, given=parameters, deaf=True)
        self.is_stamped, kind = stamped, TwistStamped if stamped else Twist
        self.commands = self.client.create_publisher(kind, "cmd_vel_smoothed", 10)
        self.safe: list[Any] = []
        self.states: list[Any] = []
        create = self.client.create_subscription
        create(kind, "cmd_vel", self.safe.append, 100)
        create(DiagnosticArray, "obb_collision/base_state", self.states.append, LATCHED)
        self.sensors = {
            name: self.client.create_publisher(
                KINDS[group.get("type", "scan")], group.get("topic", "scan"), 10
            )
            for name, group in sources.items()
        }
        gate = self.node.gate
        assert gate is not None
        self.gate = gate
        self.until(self.commands.get_subscription_count, "the gate")
        self.until(lambda: self.client.count_publishers("cmd_vel"), "its commands")
        if parameters["autostart"]:
            self.wait_sensors()

    def wait_sensors(self) -> None:
        pubs = self.sensors.values()
        self.until(lambda: all(p.get_subscription_count() for p in pubs), "sensors")

    def order(self, x: float = 0.0, y: float = 0.0, turn: float = 0.0, **fields: Any) -> list[Any]:
        """Send a command, and return what was published until it was dealt with: mostly one."""
        before, self.safe[:] = self.gate.commands, []
        twist = Twist()
        twist.linear.x, twist.linear.y, twist.angular.z = float(x), float(y), float(turn)
        for name, value in fields.items():
            side, _, axis = name.partition("_")
            setattr(getattr(twist, side), axis, float(value))
        message: Any = twist
        if self.is_stamped:
            message = TwistStamped(header=self.header("base_footprint"), twist=twist)
        self.commands.publish(message)
        self.until(lambda: self.gate.commands > before, "a command")
        for _ in range(3):
            self.executor.spin_once(timeout_sec=0.0)
        return [*self.safe]

    def answer_to(self, x: float = 0.0, y: float = 0.0, turn: float = 0.0) -> tuple[float, ...]:
        """Send a command, and return the one published."""
        self.order(x, y, turn)
        self.until(lambda: self.safe, "an answer")
        twist = getattr(self.safe[-1], "twist", self.safe[-1])
        return twist.linear.x, twist.linear.y, twist.angular.z

    def says_state(self, **wanted: str) -> dict[str, str]:
        """Wait for a state with values."""

        def reached() -> Any:
            if not self.states:
                return None
            values = {pair.key: pair.value for pair in self.states[-1].status[0].values}
            return wanted.items() <= values.items() and values

        found: dict[str, str] = self.until(reached, f"{wanted}")
        return found

    def see_points(self, *points: Any, age: float = 0.0, name: str = "front") -> None:
        """Publish a scan whose rays end at points (x, y), and wait until it is taken in."""
        topic = self.sensors[name].topic_name.rpartition("/")[2]
        before = self.monitor(topic).messages
        angles = np.array([np.arctan2(y, x) for x, y in points])
        ranges = [float(np.hypot(x, y)) for x, y in points]
        stamp = self.node.get_clock().now().nanoseconds - int(age * 1e9)
        header = Header(stamp=stamp_to_ros(stamp), frame_id="lidar")
        step = 2.0 * np.pi / 720
        rows = np.full(720, np.inf, np.float32)
        for angle, distance in zip(angles, ranges, strict=True):
            rows[round((angle + np.pi) / step) % 720] = distance
        scan = LaserScan(header=header, angle_min=-np.pi, angle_increment=step, ranges=rows)
        scan.range_min, scan.range_max = 0.01, 30.0
        self.sensors[name].publish(scan)
        self.until(lambda: self.monitor(topic).messages > before, "a scan")
