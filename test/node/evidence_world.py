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


"""The real node of the walks, with its clocks in our hand, and what steps of walks draw from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from importlib.util import find_spec
from itertools import product
from math import nan
from typing import Any, ClassVar
from unittest.mock import Mock

import numpy as np
from evidence_sources import RADIUS
from evidence_things import ARM, CHANGES, OFFSET, PADDING, REACH, SPEED, WAIT
from objects_rig import SECOND
from rclpy.clock_type import ClockType
from rclpy.context import Context
from rclpy.impl.logging_severity import LoggingSeverity
from rclpy.parameter import Parameter
from rclpy.time import Time
from rig import DOMAIN, NAMESPACE, FakeFrames, pose
from walks import Rules, one_of, repeated

from obb_collision.node.node import CollisionNode
from obb_collision.scene.building.builder import Outcome
from obb_collision.scene.building.jobs import BuildError
from obb_collision.shapes import Box

FAIL = Mock(side_effect=ZeroDivisionError)
START = 1000.0


class Builder:
    """Builds boxes in place of meshes, when told so: ``delivers`` is "built" or "failed"."""

    limits: Any = None

    def __init__(self) -> None:
        self.delivers = ""
        self.wanted: dict[Any, tuple[Any, Any]] = {}

    def request(self, name: Any, signature: Any, job: Any) -> None:
        self.wanted[name] = signature, job

    def cancel(self, name: Any) -> None:
        self.wanted.pop(name, None)

    def wants(self, name: Any) -> bool:
        return name in self.wanted

    def poll(self) -> Iterator[Outcome]:
        what, self.delivers = self.delivers, ""
        for name in list(self.wanted) if what else ():
            signature, job = self.wanted.pop(name)
            if what == "built":
                yield Outcome(job, signature, {name}, Box([np.ptp(job.points)] * 3))
            else:
                yield Outcome(job, signature, {name}, error=BuildError("bad shape"))

    def close(self) -> None:
        pass


class World:
    """The one node of all examples with a robot and sensors, or without, and its clocks."""

    made: ClassVar[dict[tuple[bool, bool], World]] = {}
    lived: ClassVar[float] = 0.0
    """Seconds of the node's clock that went by."""
    reached: ClassVar[Counter[str]] = Counter()
    """How often something was known, or not for a reason."""

    def __init__(self, has_robot: bool, has_sensors: bool) -> None:
        self.now, self.steady, self.frames, self.context = START, START, FakeFrames(), Context()
        self.frames.known["odom"] = pose(OFFSET)
        self.context.init(domain_id=DOMAIN)
        options: dict[str, Any] = {"use_sim_time": True, "autostart": False, "marker_rate": 0.0}
        options |= {"stale_speed": SPEED, "stale_reach": REACH, "transform_timeout": WAIT}
        if has_robot:
            options |= {"robots": [ARM], "robot_bases": [f"{ARM}: object_transform"]}
        if has_sensors:
            options |= {"sources": [*SENSORS, WATCHED], f"{WATCHED}.use": "watch"}
            for name, kind in SENSORS.items():
                options |= {f"{name}.type": kind, f"{name}.radius": RADIUS}
            if has_robot:
                leaves_out = {"leave_out": [ARM], "leave_out_padding": PADDING}
                options |= {f"{FRONT}.{key}": value for key, value in leaves_out.items()}
        self.node = CollisionNode(
            context=self.context,
            # with a logger of its own, which is mute
            namespace=f"{NAMESPACE}/model_{has_robot}_{has_sensors}",
            frames=self.frames,
            steady=lambda: self.steady,
            parameter_overrides=[
                Parameter(name, value=one) for name, one in (options | {"accuracy": "obb"}).items()
            ],
        )
        self.node.status._steady = lambda: self.steady
        self.node.get_logger().set_level(LoggingSeverity.FATAL)

    @classmethod
    def get(cls, *has: bool) -> World:
        """Return the node that has a robot, and sensors."""
        if has not in cls.made:
            cls.made[has] = World(*has)  # type: ignore[index]
        return cls.made[has]  # type: ignore[index]

    def begin(self) -> None:
        """Let all walks begin at one time: how they go depends on nothing before."""
        self.advance(START - self.now, START - self.steady)

    def advance(self, seconds: float, steady: float | None = None) -> None:
        self.now += seconds
        World.lived += seconds if 0.0 < seconds < 10.0 else 0.0  # no jumps
        self.steady += seconds if steady is None else steady
        time = Time(nanoseconds=round(self.now * SECOND), clock_type=ClockType.ROS_TIME)
        clock: Any = self.node.get_clock()
        clock.set_ros_time_override(time)

    def set(self, given: dict[str, Any]) -> None:
        values = {name: one if one != [] else [""] for name, one in given.items()}
        values = {name: one for name, one in values.items() if self.node.has_parameter(name)}
        results = self.node.set_parameters([Parameter(n, value=v) for n, v in values.items()])
        assert all(result.successful for result in results), results

    @classmethod
    def end_all(cls) -> None:
        for world in cls.made.values():
            world.node.destroy_node()
            world.context.try_shutdown()
        cls.made.clear()


FRONT, LASER, SONAR, WATCHED = "front", "laser", "sonar", "seen"
SENSORS = {FRONT: "cloud", LASER: "scan", SONAR: "range"}
ROBOT_TOPICS = f"{ARM}/joint_states", f"{ARM}/robot_description"
TOPICS = *CHANGES, "object_states", "object_poses", "object_boxes"
NAMES = "a/0", "a/1", "b/0", "boxes/0"
ANY = *NAMES, "boxes/1", "a/7"
UNKNOWN = "z/0"
PLACES = one_of([0.7 * k for k in range(6)])
SIZES = one_of([1.0, 2.0])
FRAMES = one_of(["map", "map", "map", "odom", "odom", "lost"])
STAMPS = one_of([0.0, 0.0, 0.0, -0.3, -30.0, 5.0, None])
"""Seconds from now on; None: no stamp."""
POSE_FAULTS = one_of(["", "", "", "pose", "zero", "stamp"])
USUALLY = one_of([True, True, False])
EITHER = one_of([True, False])
RARELY = one_of([*[False] * 9, True])
SHORTEST_LIFE = 1.0
"""Seconds: of a marker."""
CYCLE_LIMIT = 0.52
"""Seconds that the node's parameters give a cycle by default."""
STEPS = one_of([0.0503, 0.1103, 0.2311, 0.4703, 0.7117, 1.3017])
PLAIN: dict[str, Any] = {
    "object_timeout": 0.0,
    "object_timeout_overrides": [],
    "joint_timeout": 0.0,
    "judge_ages": "stamp_and_receipt",
    "stale_policy": "unknown",
    "stale_policy_overrides": [],
    "required_objects": [],
    "required_inputs": [],
    "ignored_objects": [],
    "expect_empty": False,
    **{f"{name}.timeout": 0.0 for name in (*SENSORS, WATCHED)},
    **{f"{name}.stale_policy": "unknown" for name in SENSORS},
}
GIVEN = {
    "object_timeout": one_of([0.0, 0.5]),
    "object_timeout_overrides": one_of(
        [[], ["a/1: 0.3"], ["a/*: 0.8", "a/0: 0"], ["arm*: 0.9"], ["arm/*: 0.5"]]
    ),
    "joint_timeout": one_of([0.0, 0.6]),
    "judge_ages": one_of(["stamp_and_receipt", "stamp_and_receipt", "receipt"]),
    "stale_policy": one_of(["unknown", "unknown", "collide", "keep", "ignore"]),
    "stale_policy_overrides": one_of([[], ["b/*: keep", "arm/*: collide"], ["a/0: ignore"]]),
    "required_objects": one_of([[], [], [], ["b/*"]]),
    "required_inputs": one_of([[], [], [], ["object_states: 0.7"]]),
    "ignored_objects": one_of([[], [], ["z/*"]]),
    "expect_empty": EITHER,
    **{f"{name}.timeout": one_of([0.0, 0.6]) for name in (FRONT, LASER)},
    f"{WATCHED}.timeout": one_of([0.0, 0.1]),
    f"{FRONT}.stale_policy": one_of(["unknown", "unknown", "collide", "keep", "ignore"]),
}
BEGIN = GIVEN | {
    "has_robot": EITHER if find_spec("lxml") else one_of([False]),
    "has_sensors": EITHER,
    "scene": repeated(PLACES, 0, 3),
}
JOINTS = [pair for pair in product([0.0, 1.4, 3.0, nan, None], repeat=2) if any(pair)]
rule = Rules()
