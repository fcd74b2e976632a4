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

"""The time in which a node of its own process answers a chunk of states of a robot."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Header, String
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.node.messages.box_markers import MarkerArrayWriter
from obb_collision.node.messages.clouds import cloud_from_ros, cloud_to_ros
from obb_collision.node.messages.conversions import NANOSECONDS, stamp_to_ros
from obb_collision.node.robots.validity import NOT_KNOWN, ROWS
from obb_collision.robots.robot import Robot
from obb_collision.scene_files.description import SceneObject
from obb_collision.shapes import Box
from obb_collision.typing import Floats

ROBOT, FRAME = "robot", "map"
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
CHUNK = 50
"""States of a message."""
WARM_CHUNKS = 20
MOVING = 5
"""The robot moves a little behind as many chunks."""
REACH = 0.1
"""By how much of a joint's range it moves at most, either way."""
PATIENCE = 120.0
"""Seconds until the node knows robot and boxes, and for an answer."""
ASKING = 0.5
"""Seconds after which a node that has just started is asked again."""


class Started:
    """A node with a robot in a process of its own, ended on the way out; and a client of it."""

    def __init__(self, robot: Robot, folder: Path) -> None:
        domain = 1 + os.getpid() % 100  # another node on this machine must not answer
        namespace = f"/chunks_{os.getpid()}"
        self._robot, self._number, self._answer = robot, 0, PointCloud2()
        given = [f"robots:=['{ROBOT}']", f"robot_bases:=['{ROBOT}: 0 0 0 0 0 0 1']"]
        given += [f"mesh_folders:=['{folder.resolve()}']", "joint_timeout:=0.0"]
        words = ["--ros-args", "-r", f"__ns:={namespace}", "--log-level", "error"]
        words += [word for one in given for word in ("-p", one)]
        code = "from obb_collision.commands import node; raise SystemExit(node())"
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
        self._process = subprocess.Popen([sys.executable, "-c", code, *words], env=environment)
        self._context = Context()
        self._context.init(args=[], domain_id=domain)
        self._client = Node("client", context=self._context, namespace=namespace)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._client)
        make: Any = self._client.create_publisher
        self._urdf = make(String, f"{ROBOT}/robot_description", LATCHED)
        self._srdf = make(String, f"{ROBOT}/robot_description_semantic", LATCHED)
        self._joints = make(JointState, f"{ROBOT}/joint_states", 10)
        self._states = make(PointCloud2, f"{ROBOT}/states_to_check", 10)
        self._objects = make(MarkerArray, "objects", 10)
        take = self._take
        self._client.create_subscription(PointCloud2, f"{ROBOT}/state_validity", take, 10)

    def __enter__(self) -> Started:
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self._client.destroy_node()
        self._context.try_shutdown()
        self._process.terminate()
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _take(self, message: PointCloud2) -> None:
        self._answer = message

    def _until(self, reached: Callable[[], object], seconds: float) -> bool:
        """Return whether something is reached in time; TimeoutError for a node that has ended."""
        limit = perf_counter() + seconds
        while not reached():
            if self._process.poll() is not None:
                raise TimeoutError(f"the node ended with {self._process.returncode}")
            if perf_counter() > limit:
                return False
            self._executor.spin_once(timeout_sec=0.05)
        return True

    def begin(
        self, urdf: str, srdf: str | None, boxes: Sequence[SceneObject], middle: Floats
    ) -> None:
        """Send robot and boxes; return when the node knows them. middle: state of the robot."""
        inputs = self._urdf, self._srdf, self._joints, self._states, self._objects
        if not self._until(lambda: all(one.get_subscription_count() for one in inputs), PATIENCE):
            raise TimeoutError("the node did not start")
        if srdf is not None:
            self._srdf.publish(String(data=srdf))
        self._urdf.publish(String(data=urdf))
        writer = MarkerArrayWriter(FRAME, NANOSECONDS, 0.0)
        for number, one in enumerate(boxes):
            assert isinstance(one.shape, Box)
            size = list(one.shape.size)
            writer.add(("box", number), Marker.CUBE, Marker.ADD, list(one.pose), size)
        message = writer.message()
        limit = perf_counter() + PATIENCE
        while True:
            self._objects.publish(message)
            self.move(middle)
            if self.ask(middle[None], ASKING) is not None and self.is_known:
                return
            self._until(lambda: False, ASKING)  # it is reading the description
            if perf_counter() > limit:
                raise TimeoutError("the node did not get to know robot and boxes")

    @property
    def rows(self) -> np.ndarray:
        """The last answer."""
        return cloud_from_ros(self._answer, ROWS.names or ())

    @property
    def is_known(self) -> bool:
        """Whether the last answer says something of its states."""
        return bool((self.rows["reason"] != NOT_KNOWN).all())

    def move(self, state: Floats) -> None:
        """Say where the joints are."""
        message = JointState(name=list(self._robot.joint_names), position=state.tolist())
        self._joints.publish(message)

    def ask(self, states: Floats, seconds: float = PATIENCE) -> float | None:
        """Return how long the answer to states took (s); None where there was none in time."""
        rows = np.zeros(len(states), [(name, "<f8") for name in self._robot.joint_names])
        for column, name in enumerate(self._robot.joint_names):
            rows[name] = states[:, column]
        self._number += 1
        stamp = stamp_to_ros(self._number * NANOSECONDS)
        message = cloud_to_ros(rows, Header(stamp=stamp, frame_id=FRAME))
        start = perf_counter()
        self._states.publish(message)
        answered = self._until(lambda: self._answer.header.stamp == stamp, seconds)
        return perf_counter() - start if answered else None


def measure_chunks(
    robot: Robot,
    texts: tuple[str, str | None],
    folder: Path,
    boxes: Sequence[SceneObject],
    states: Floats,
) -> dict[str, Any]:
    """Ask a node for states (n, CHUNK, joints); TimeoutError where it does not answer.

    Returns milliseconds from the publication of a chunk to its answer.

    texts: URDF and SRDF; folder: in which packages of meshes are.
    """
    rng = np.random.default_rng(0)
    times, valid = [], []
    with Started(robot, folder) as node:
        low, high = (edge(states, axis=(0, 1)) for edge in (np.min, np.max))
        middle, span = 0.5 * (low + high), high - low
        node.begin(*texts, boxes, middle)
        for number, chunk in enumerate(states):
            if number % MOVING == 0:
                node.move(middle + span * rng.uniform(-REACH, REACH, len(span)))
            took = node.ask(chunk)
            if took is None or not node.is_known:
                raise TimeoutError("no answer from the node")
            times.append(took)
            valid.append(float(node.rows["valid"].mean()))
    counted = 1e3 * np.array(times[WARM_CHUNKS:])
    median, p99 = np.percentile(counted, (50, 99)).tolist()
    return {
        "world": f"{len(boxes)} boxes",
        "states": states.shape[1],
        "chunks": len(counted),
        "median": median,
        "p99": p99,
        "longest": float(counted.max()),
        "valid": float(np.mean(valid[WARM_CHUNKS:])),
    }
