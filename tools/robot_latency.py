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

"""How soon a node of its own process answers states of a robot, and stops it before a hand."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import closing
from functools import partial
from math import isnan, nan
from pathlib import Path
from statistics import median
from struct import pack
from tempfile import TemporaryDirectory
from time import perf_counter, time, time_ns
from typing import Any

import numpy as np
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Float64, Header, String
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.geometry.poses import compose_poses
from obb_collision.node.messages.box_markers import MarkerArrayWriter
from obb_collision.node.messages.clouds import cloud_from_ros, cloud_to_ros
from obb_collision.node.messages.conversions import NANOSECONDS, stamp_to_ros
from obb_collision.node.robots.validity import NOT_KNOWN, ROWS
from obb_collision.robots.robot import Robot
from obb_collision.scene.scene import Scene
from obb_collision.scene_files.description import SceneObject
from obb_collision.shapes import Box, Sphere
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
ALLOCATOR = {"MALLOC_MMAP_THRESHOLD_": str(2**25), "MALLOC_TRIM_THRESHOLD_": str(2**26)}
"""As ``keep_freed_memory`` has it in a node; what ``Child`` sets for attacks would prevent that."""
ASKING = 0.5
"""Seconds after which a node that has just started is asked again."""


class Asked:
    """A node with a robot in a process of its own, and a client of it.

    Raises FoundError where the node ends or does not answer.
    """

    def __init__(self, robot: Robot, packages: Path, folder: Path, *more: str) -> None:
        """Start them; more: parameters of the node."""
        domain = own_domain()
        namespace = f"/chunks_{os.getpid()}"
        self._robot, self._number, self._answer = robot, 0, PointCloud2()
        parameters = [f"robots:=['{ROBOT}']", f"robot_bases:=['{ROBOT}: 0 0 0 0 0 0 1']"]
        parameters += [f"mesh_folders:=['{packages.resolve()}']", "joint_timeout:=0.0", *more]
        words = ["--ros-args", "-r", f"__ns:={namespace}", "--log-level", "error"]
        words += [word for parameter in parameters for word in ("-p", parameter)]
        self._child = Child(words, domain, folder / "node.log", **ALLOCATOR)
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
            self.tell(middle)
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

    def tell(self, state: Floats) -> None:
        """Say all that the node must know."""
        self.move(state)

    def move(self, state: Floats, stamp: int = 0, speeds: Floats | None = None) -> None:
        """Say where the joints are; stamp: ns, 0 for none; speeds: of the joints, if known."""
        message = JointState(name=list(self._robot.joint_names), position=state.tolist())
        message.header.stamp = stamp_to_ros(stamp)
        message.velocity = [] if speeds is None else speeds.tolist()
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


CAMERA, SPEED = "camera", f"{ROBOT}/speed_scale"
WIDTH, HEIGHT, FOCUS = 640, 480, 525.0
"""Pixels of the camera, and its focal length in pixels."""
EYE = np.array([1.3, 0.0, 1.2])
"""Where the camera is (m); it looks at the last link."""
FLOOR, WALL, FARTHEST = -0.4, -1.6, 4.0
"""Planes below and behind the robot, and how far the camera sees (m)."""
UPRIGHT = 0.0, 0.0, 0.0, 1.0
RATE, JOINT_RATE = 15.0, 50.0
"""Frames and states of joints a second."""
HAND, BESIDE = 0.06, 0.2
"""Radius of the ball that stands for a hand, and how far from the last link it is (m)."""
SHOWN, HIDDEN = 0.6, 1.0
"""For how long the hand is seen, and then not (s)."""
SWING = 0.002
"""By how much of a joint's range the robot moves about the middle, either way."""
SETTLING = 3.2
"""Seconds that do not count."""
STAMP = slice(4, 12)
"""Bytes of a serialised message that are its stamp."""
TICKS = os.sysconf("SC_CLK_TCK")
OBJECTS = 30


def frame_of(robot: Robot, state: Floats, hand: Floats | None) -> bytearray:
    """Return a serialised cloud of 4.9 MB of a robot, a floor and a wall, and of a hand at (3,).

    A tenth of its points is not known.
    """
    across, down = np.meshgrid(np.arange(WIDTH) - 0.5 * WIDTH, np.arange(HEIGHT) - 0.5 * HEIGHT)
    places = robot.link_poses(state[None])[0]
    ahead = (places[-1, :3] - EYE) / np.linalg.norm(places[-1, :3] - EYE)
    side = np.cross(ahead, [0.0, 0.0, 1.0])
    rays = FOCUS * ahead + across[..., None] * side - down[..., None] * np.cross(side, ahead)
    rays = rays.reshape(-1, 3) / np.linalg.norm(rays, axis=-1).reshape(-1, 1)
    scene = Scene()
    scene.add("floor", Box([9.0, 9.0, 0.2]), (0.0, 0.0, FLOOR - 0.1, *UPRIGHT))
    scene.add("wall", Box([0.2, 9.0, 9.0]), (WALL - 0.1, 0.0, 0.0, *UPRIGHT))
    for link, pose in enumerate(places):
        for number, (shape, local) in enumerate(robot.shapes[link]):
            scene.add(f"{link} {number}", shape, compose_poses(pose, np.array(local)))
    if hand is not None:
        scene.add("hand", Sphere(HAND), (*hand, *UPRIGHT))
    depth = scene.cast_rays(np.tile(EYE, (len(rays), 1)), rays, FARTHEST, accuracy="hull").distances
    depth[np.random.default_rng(0).random(len(depth)) < 0.1] = np.nan
    rows = np.zeros(len(rays), [(name, "<f4") for name in ("x", "y", "z", "rgb")])
    for column, axis in enumerate("xyz"):
        rows[axis] = EYE[column] + depth * rays[:, column]
    message = cloud_to_ros(rows, Header(frame_id=FRAME))
    message.height, message.width, message.row_step = HEIGHT, WIDTH, 16 * WIDTH
    return bytearray(serialize_message(message))


class Watched(Asked):
    """A node that sees a robot; frame: without a hand; sent, given: reliability of both ends."""

    def __init__(
        self,
        robot: Robot,
        packages: Path,
        folder: Path,
        frame: bytearray,
        sent: str,
        given: str,
        *more: str,
    ) -> None:
        own = f"qos_overrides./chunks_{os.getpid()}/{CAMERA}.subscription.reliability:={given}"
        leaves_out = f"{CAMERA}.leave_out:=['{ROBOT}']"
        distances = "speed_stop_distance:=0.15", "speed_slow_distance:=0.3"
        sensor = f"sources:=['{CAMERA}']", f"{CAMERA}.timeout:=2.0", leaves_out, own, *distances
        super().__init__(robot, packages, folder, *sensor, *more)
        qos = QoSProfile(depth=5, reliability=ReliabilityPolicy[sent.upper()])
        self._camera = self._client.node.create_publisher(PointCloud2, CAMERA, qos)
        self._client.node.create_subscription(Float64, SPEED, self._take_scale, 10)
        self._scale, self._frame, self._shown = nan, frame, 0.0
        self._stops: list[float] = []
        """Seconds from the first cloud with a hand to the stop, of each hand; NaN: no stop."""

    def _take_scale(self, message: Float64) -> None:
        before, self._scale = self._scale, message.data
        if self._scale == 0.0 < before and self._stops and isnan(self._stops[-1]):
            self._stops[-1] = time() - self._shown

    def tell(self, state: Floats) -> None:
        """Say where the joints are, and what the camera sees."""
        self.see(self._frame)
        self.move(state)

    def see(self, frame: bytearray) -> float:
        """Publish a frame of now; return its stamp (s)."""
        now = time_ns()
        frame[STAMP] = pack("<iI", *divmod(now, NANOSECONDS))
        self._camera.publish(bytes(frame))
        return now / NANOSECONDS

    def watch(self, middle: Floats, swing: Floats, seconds: float) -> dict[str, Any]:
        """Let the robot swing about a state while the hand comes and goes; return the figures."""
        place = self._robot.link_poses(middle[None])[0, -1, :3]
        aside = place * (1.0, 1.0, 0.0) / np.linalg.norm(place[:2])
        frames = self._frame, frame_of(self._robot, middle, place + BESIDE * aside)
        self._move_and_see(middle, swing, frames, SETTLING)
        self._stops.clear()
        before, start = self._figures(), perf_counter()
        sent = self._move_and_see(middle, swing, frames, seconds)
        took = perf_counter() - start
        names = "received", "superseded", "lost", "cycles", "late cycles", "cpu"
        spent = dict(zip(names, np.subtract(self._figures(), before).tolist(), strict=True))
        share = spent.pop("cpu") / took
        stops = [1e3 * stop for stop in self._stops if not isnan(stop)]
        if not stops:
            raise FoundError(f"the robot did not stop before a hand: {self._client.status()}")
        return {
            "sent": sent,
            **{name: round(value) for name, value in spent.items()},
            "share of a core": f"{share:.0%}",
            "stops": f"{len(stops)} of {len(self._stops)}",
            "hand to stop (ms)": round(median(stops)),
            "longest": round(max(stops)),
        }

    def _move_and_see(
        self, middle: Floats, swing: Floats, frames: Sequence[bytearray], seconds: float
    ) -> int:
        """Publish joints and frames, without a hand and then with one; return how many frames."""
        due = due_joints = start = perf_counter()
        sent, hand = 0, 0
        while (now := perf_counter()) < start + seconds:
            turn = now - start
            if now >= due_joints:
                due_joints += 1.0 / JOINT_RATE
                self.move(middle + swing * np.sin(turn), time_ns(), swing * np.cos(turn))
            if now >= due:
                due += 1.0 / RATE
                before, hand = hand, int(turn % (HIDDEN + SHOWN) > HIDDEN)
                stamp = self.see(frames[hand])
                sent += 1
                if hand > before:
                    self._shown = stamp
                    self._stops.append(nan)
            self._client.spin(max(0.0, min(due, due_joints) - perf_counter()))
        return sent

    def _figures(self) -> tuple[float, ...]:
        """Return counts of the camera and of cycles so far, and the processor time (s)."""
        self._client.diagnostics = None
        self._client.until(self._child, lambda: self._client.diagnostics, "diagnostics")
        names, topic = ("messages", "superseded", "lost"), f"input {CAMERA}"
        camera = [self._client.count(name, topic) for name in names]
        cycles = [self._client.count(name, "cycle") for name in ("cycles", "overruns")]
        used = Path(f"/proc/{self._child.number}/stat").read_text().rpartition(")")[2].split()
        return *camera, *cycles, (int(used[11]) + int(used[12])) / TICKS


def measure_camera(
    robot: Robot, texts: tuple[str, str | None], folder: Path, seconds: float, *more: str
) -> list[dict[str, Any]]:
    """Return a row per QoS of camera and node; FoundError where the node does not answer."""
    rows = []
    turns = np.arange(OBJECTS) * (2.0 * np.pi / OBJECTS)
    places = np.column_stack([1.5 * np.cos(turns), 1.5 * np.sin(turns), np.full(OBJECTS, 0.5)])
    boxes = [
        SceneObject(str(k), Box([0.1] * 3), (*place, 0.0, 0.0, 0.0, 1.0))
        for k, place in enumerate(places.tolist())
    ]
    low, high = (np.where(np.isfinite(end), end, 0.0) for end in (robot.lower, robot.upper))
    middle, swing = 0.5 * (low + high), SWING * (high - low)
    frame = frame_of(robot, middle, None)
    for sent, given in QOS:
        with (
            TemporaryDirectory() as log,
            closing(Watched(robot, folder, Path(log), frame, sent, given, *more)) as node,
        ):
            node.begin(*texts, boxes, middle)
            rows.append({"camera": sent, "node": given, **node.watch(middle, swing, seconds)})
    return rows


QOS = (("best_effort", "best_effort"), ("reliable", "best_effort"), ("reliable", "reliable"))
"""Reliability of the camera, and of the node."""
