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
from collections.abc import Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Header, String
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.node.messages.box_markers import MarkerArrayWriter
from obb_collision.node.messages.clouds import cloud_from_ros
from obb_collision.node.messages.conversions import NANOSECONDS, stamp_to_ros
from obb_collision.node.robots.validity import NOT_KNOWN, ROWS
from obb_collision.robots.robot import Robot
from obb_collision.scene_files.description import SceneObject
from obb_collision.shapes import Box
from obb_collision.typing import Floats
from tools.fuzz.client import Client, FoundError
from tools.fuzz.process import Child, own_domain
from tools.fuzz.robot import states_to_ros

ROBOT, FRAME = "robot", "map"
URDF, SRDF = LATCHED = (f"{ROBOT}/robot_description", f"{ROBOT}/robot_description_semantic")
JOINTS, STATES = f"{ROBOT}/joint_states", f"{ROBOT}/states_to_check"
TYPES = {
    URDF: String,
    SRDF: String,
    JOINTS: JointState,
    STATES: PointCloud2,
    "objects": MarkerArray,
}
"""Messages of the inputs."""
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


class Asked:
    """A node with a robot in a process of its own, and a client of it.

    Raises FoundError where the node ends or does not answer.
    """

    def __init__(self, robot: Robot, packages: Path, folder: Path) -> None:
        domain = own_domain()
        namespace = f"/chunks_{os.getpid()}"
        self._robot, self._number, self._answer = robot, 0, PointCloud2()
        parameters = [f"robots:=['{ROBOT}']", f"robot_bases:=['{ROBOT}: 0 0 0 0 0 0 1']"]
        parameters += [f"mesh_folders:=['{packages.resolve()}']", "joint_timeout:=0.0"]
        words = ["--ros-args", "-r", f"__ns:={namespace}", "--log-level", "error"]
        words += [word for parameter in parameters for word in ("-p", parameter)]
        self._child = Child(words, domain, folder / "node.log")
        self._client = Client(domain, namespace, TYPES, LATCHED, ROBOT)

    def close(self) -> None:
        """End the node and its client."""
        self._client.close()
        self._child.end()

    def begin(
        self, urdf: str, srdf: str | None, boxes: Sequence[SceneObject], middle: Floats
    ) -> None:
        """Send robot and boxes; return when the node knows them. middle: state of the robot."""
        client = self._client
        client.until(self._child, client.have_subscribers, "inputs", PATIENCE)
        if srdf is not None:
            client.publishers[SRDF].publish(String(data=srdf))
        client.publishers[URDF].publish(String(data=urdf))
        writer = MarkerArrayWriter(FRAME, NANOSECONDS, 0.0)
        for number, box in enumerate(boxes):
            assert isinstance(box.shape, Box)
            size = list(box.shape.size)
            writer.add(("box", number), Marker.CUBE, Marker.ADD, list(box.pose), size)
        limit, message = perf_counter() + PATIENCE, writer.message()
        while True:
            client.publishers["objects"].publish(message)
            self.move(middle)
            self.ask(middle[None])
            if self.is_known:
                return
            client.spin(ASKING)  # it is reading the description
            if perf_counter() > limit:
                raise FoundError("the node did not get to know robot and boxes")

    @property
    def rows(self) -> np.ndarray:
        """The last answer."""
        return cloud_from_ros(self._answer, ROWS.names or ())

    @property
    def is_known(self) -> bool:
        """Whether the last answer has a result for its states."""
        return bool((self.rows["reason"] != NOT_KNOWN).all())

    def move(self, state: Floats) -> None:
        """Say where the joints are."""
        message = JointState(name=list(self._robot.joint_names), position=state.tolist())
        self._client.publishers[JOINTS].publish(message)

    def ask(self, states: Floats) -> float:
        """Return how long the answer to states took (s)."""
        self._number += 1
        stamp = stamp_to_ros(self._number * NANOSECONDS)
        message = states_to_ros(self._robot, states, Header(stamp=stamp, frame_id=FRAME))
        start = perf_counter()
        self._client.publishers[STATES].publish(message)
        reached = partial(self._client.answer_at, stamp)
        self._answer = self._client.until(self._child, reached, "answer about states", PATIENCE)
        return perf_counter() - start


def measure_chunks(
    robot: Robot,
    texts: tuple[str, str | None],
    folder: Path,
    boxes: Sequence[SceneObject],
    states: Floats,
) -> dict[str, Any]:
    """Ask a node for states (n, CHUNK, joints); FoundError where it does not answer.

    Returns milliseconds from the publication of a chunk to its answer.

    texts: URDF and SRDF; folder: in which packages of meshes are.
    """
    rng = np.random.default_rng(0)
    times, valid = [], []
    with TemporaryDirectory() as log, closing(Asked(robot, folder, Path(log))) as node:
        low, high = (edge(states, axis=(0, 1)) for edge in (np.min, np.max))
        middle, span = 0.5 * (low + high), high - low
        node.begin(*texts, boxes, middle)
        for number, chunk in enumerate(states):
            if number % MOVING == 0:
                node.move(middle + span * rng.uniform(-REACH, REACH, len(span)))
            times.append(node.ask(chunk))
            if not node.is_known:
                raise FoundError("the node does not know the robot any more")
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
