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

# ruff: noqa: RUF009  # `of` makes fields
"""Valid messages for every input of the node, of random content: what mutations start from.

Those of vision_msgs, which is not on PyPI, are look-alikes. They have what mutations need of a
message; their bytes are plain little-endian CDR. Where vision_msgs is not installed, they are sent
as those of another type, and the node takes them so.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from pathlib import Path
from random import Random
from struct import pack
from typing import Any, cast

import numpy as np
from geometry_msgs.msg import Point, Pose, PoseWithCovariance, TransformStamped, Twist, Vector3
from rcl_interfaces.msg import Parameter, ParameterEvent
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan, MultiDOFJointState, PointCloud2, Range
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.node.inputs.detections import MessageType
from obb_collision.node.messages.cdr import ENCAPSULATION
from obb_collision.node.messages.clouds import boxes_to_ros, cloud_to_ros, poses_to_ros
from obb_collision.node.messages.conversions import (
    NANOSECONDS,
    duration_to_ros,
    pose_to_ros,
    stamp_to_ros,
    transform_to_ros,
)
from obb_collision.node.messages.names import namespace_number
from tools.fuzz.files import OBJ, STL, Meshes

TYPE: Any = PointCloud2 if MessageType is None else MessageType
"""The type by which detections are sent."""
OBSTACLE = "wall"
"""A sensor whose points collide; they are what they are, so that it is known with what."""
SOURCES = (
    *(f"sources:=[camera, laser, sonar, {OBSTACLE}]", "laser.type:=scan", "sonar.type:=range"),
    *(f"{OBSTACLE}.radius:=0.0", f"{OBSTACLE}.timeout:=0.0", f"{OBSTACLE}.max_range:=1000.0"),
    *("camera.leave_out:=['*/1']", "camera.shadows:=true", "camera.voxel:=0.2"),
    *("laser.leave_out:=['*/2']", "laser.max_height:=1.0"),
    *(f"{name}.use:=watch" for name in ("camera", "laser", "sonar")),
)
"""Parameters of a node with sensors; the others are watched: what is right stays so."""
LAYOUTS = {"double": "d", "float": "f", "int32": "i", "uint32": "I"}


class LookAlike:
    """A message as fields, each made by ``of``."""

    def get_fields_and_field_types(self) -> dict[str, str]:
        """Return the types of the fields by their names."""
        return {one.name: one.metadata["kind"] for one in fields(cast(Any, self))}


def of(kind: str, make: Callable[[], Any]) -> Any:
    """Return a field of a type as ROS names it."""
    return field(default_factory=make, metadata={"kind": kind})


@dataclass
class Hypothesis(LookAlike):
    """A hypothesis of a detection."""

    class_id: str = of("string", str)
    score: float = of("double", float)


@dataclass
class Result(LookAlike):
    """A hypothesis with a pose."""

    hypothesis: Hypothesis = of("vision_msgs/ObjectHypothesis", Hypothesis)
    pose: PoseWithCovariance = of("geometry_msgs/PoseWithCovariance", PoseWithCovariance)


@dataclass
class Box(LookAlike):
    """A box."""

    center: Pose = of("geometry_msgs/Pose", Pose)
    size: Vector3 = of("geometry_msgs/Vector3", Vector3)


@dataclass
class Detection(LookAlike):
    """A detection."""

    header: Header = of("std_msgs/Header", Header)
    results: list[Result] = of("sequence<vision_msgs/ObjectHypothesisWithPose>", list)
    bbox: Box = of("vision_msgs/BoundingBox3D", Box)
    id: str = of("string", str)


@dataclass
class Detections(LookAlike):
    """A Detection3DArray."""

    header: Header = of("std_msgs/Header", Header)
    detections: list[Detection] = of("sequence<vision_msgs/Detection3D>", list)


def serialised(message: Any) -> bytes:
    """Return the bytes of a message, of ROS or of this module."""
    if isinstance(message, LookAlike):
        return written(message)
    return bytes(serialize_message(message))


def written(message: Any) -> bytes:
    """Return the bytes of a message by its fields, zeros between them."""
    data = bytearray()
    _write(data, "", message)
    return ENCAPSULATION + bytes(data)


def _write(data: bytearray, kind: str, value: Any) -> None:
    """Append a value of a type as ROS names it."""
    several = re.fullmatch(r"sequence<(.+)>|(.+)\[\d+\]", kind)
    if several is not None:
        if several[1]:
            _put(data, "I", len(value))
        for one in value:
            _write(data, several[1] or several[2], one)
    elif kind == "string":
        text = value.encode() + b"\0"
        _put(data, "I", len(text))
        data += text
    elif kind in LAYOUTS:
        _put(data, LAYOUTS[kind], value)
    else:
        for name, of_field in value.get_fields_and_field_types().items():
            _write(data, of_field, getattr(value, name))


def _put(data: bytearray, layout: str, value: Any) -> None:
    """Append a number at a multiple of its size."""
    number = pack("<" + layout, value)
    data += bytes(-len(data) % len(number)) + number


try:
    from tf2_msgs.msg import TFMessage
except ImportError:  # where tf2 is not installed
    TFMessage = None

NAMESPACES = ("a", "b", "crate", "arm", "", "a/b")
FRAMES = ("map", "map", "map", "", "odom", "lidar")
MOST_ID = 40
"""Ids of hostile objects lie below; those of probes above."""
ROOM = 4.0
"""Edge of the room in which objects are (m): many of them collide."""
LOCKED, ATTACHED = 0.1, 0.7
"""Shares of the markers that are locked to their frame: any, and that of a link."""
BODIES = (1, 1, 1, 2, 3, 0, 4, 5, 6, 7, 8, 10, 11)
"""Marker types, cubes most often; 9, a text, is no body."""


def box_marker(
    key: tuple[str, int], pose: Any, size: Any, header: Header, kind: int = Marker.CUBE
) -> Marker:
    """Return a marker of a box, or of another shape of the same size."""
    marker = Marker(header=header, ns=key[0], id=key[1], type=kind, pose=pose_to_ros(pose))
    marker.scale.x, marker.scale.y, marker.scale.z = (float(edge) for edge in size)
    return marker


def tf_maker(frame: Callable[[], TransformStamped]) -> tuple[type, Callable[[], Any]]:
    """Return type and maker of messages of tf; of single transforms where tf2 is not installed."""
    if TFMessage is None:
        return TransformStamped, frame
    return TFMessage, lambda: TFMessage(transforms=[frame(), frame()])


class Messages:
    """Makes messages; ``folder`` gets mesh files, good, bad and blocking ones.

    makers: type and maker per topic; random: what the next message is made from.
    """

    def __init__(self, random: Random, folder: Path) -> None:
        self.random = random
        self._meshes = Meshes(folder)
        self.links: tuple[str, ...] = ()
        """Frames of the links of robots."""
        self.makers: dict[str, tuple[type, Callable[[], Any]]] = {
            "objects": (MarkerArray, self.markers),
            "object_transform": (TransformStamped, self.transform),
            "object_states": (MultiDOFJointState, self.states),
            "object_poses": (PointCloud2, self.poses),
            "object_boxes": (PointCloud2, self.boxes),
            "detections": (TYPE, self.detections),
            "points": (PointCloud2, self.points),
            "camera": (PointCloud2, self.points),
            OBSTACLE: (PointCloud2, self.points),
            "laser": (LaserScan, self.scan),
            "sonar": (Range, self.sonar),
            "/tf": tf_maker(self.frame),
            "/tf_static": tf_maker(self.frame),
            "/clock": (Clock, self.clock),
            "/parameter_events": (ParameterEvent, self.event),
        }

    def header(self) -> Header:
        """Return a header of any time and frame."""
        shift = self.random.choice((0, 0, 0, 0, None, -NANOSECONDS, 3600 * NANOSECONDS))
        stamp = 0 if shift is None else time.time_ns() + shift
        frame = self.random.choice((*FRAMES, *self.links))
        return Header(stamp=stamp_to_ros(stamp), frame_id=frame)

    def _pose(self) -> list[float]:
        place = [self.random.uniform(0.0, ROOM) for _ in range(3)]
        turn = [self.random.gauss(0.0, 1.0) for _ in range(4)]
        length = sum(part * part for part in turn) ** 0.5
        return place + [part / length for part in turn]

    def _key(self) -> tuple[str, int]:
        return self.random.choice(NAMESPACES), self.random.randrange(MOST_ID)

    def _corners(self, count: int) -> list[Point]:
        corner = self.random.uniform
        return [Point(x=corner(0, 1), y=corner(0, 1), z=corner(0, 1)) for _ in range(count)]

    def marker(self) -> Marker:
        """Return a marker of any type and action."""
        random, key = self.random, self._key()
        marker = Marker(header=self.header(), ns=key[0], id=key[1], type=random.choice(BODIES))
        marker.action = random.choices((Marker.ADD, Marker.DELETE, Marker.DELETEALL), (30, 4, 1))[0]
        marker.pose = pose_to_ros(self._pose())
        edges = [random.uniform(0.05, 1.0) for _ in range(3)]
        marker.scale.x, marker.scale.y, marker.scale.z = edges
        marker.lifetime = duration_to_ros(random.choice((0.0, 0.0, 0.05, 10.0)))
        marker.frame_locked = random.random() < (
            ATTACHED if marker.header.frame_id in self.links else LOCKED
        )
        large = random.random() < 0.02
        if marker.type in (4, 5, 11):
            marker.points = self._corners(3 * random.choice((1, 4, 20)) * (50 if large else 1))
        elif marker.type in (6, 7, 8):  # each point is an object
            marker.points = self._corners(random.randint(0, 4) * (50 if large else 1))
        if marker.type == Marker.MESH_RESOURCE:
            marker.mesh_resource = self._meshes.uri(random)
            if random.random() < 0.3:
                marker.mesh_file.filename = random.choice(("a.stl", "b.obj", "c.glb", "d"))
                marker.mesh_file.data = random.choice((STL, OBJ, b"\0" * 100))
        return marker

    def markers(self) -> MarkerArray:
        """Return a few markers, or rarely very many."""
        count = 500 if self.random.random() < 0.005 else self.random.randint(0, 8)
        return MarkerArray(markers=[self.marker() for _ in range(count)])

    def transform(self) -> TransformStamped:
        """Return the pose of one object."""
        namespace, number = self._key()
        message = TransformStamped(header=self.header(), child_frame_id=f"{namespace}/{number}")
        message.transform = transform_to_ros(self._pose())
        return message

    def states(self) -> MultiDOFJointState:
        """Return poses of objects by name, or poses with twists."""
        count = self.random.randint(0, 6)
        message = MultiDOFJointState(header=self.header())
        message.joint_names = ["{}/{}".format(*self._key()) for _ in range(count)]
        message.transforms = [transform_to_ros(self._pose()) for _ in range(count)]
        if self.random.random() < 0.5:
            message.twist = [Twist() for _ in range(count)]
            for twist in message.twist:
                twist.linear.x = self.random.gauss(0.0, 1.0)
                twist.angular.z = self.random.gauss(0.0, 3.0)
        return message

    def poses(self) -> PointCloud2:
        """Return bulk poses."""
        return poses_to_ros(*self._bulk(), header=self.header(), single=self.random.random() < 0.5)

    def boxes(self) -> PointCloud2:
        """Return a complete set of boxes."""
        ids, poses, namespaces = self._bulk()
        sizes = np.array([[self.random.uniform(0.05, 1.0) for _ in "xyz"] for _ in ids])
        single = self.random.random() < 0.5
        return boxes_to_ros(ids, poses, sizes, namespaces, self.header(), single)

    def detections(self) -> Detections:
        """Return a complete set of detections."""
        header, some = self.header(), []
        for _ in range(self.random.choice((0, 1, 5, 50))):
            ident = self.random.choice(("", "track-a", str(self.random.randrange(MOST_ID))))
            box = Box(center=pose_to_ros(self._pose()))
            edges = [self.random.uniform(0.05, 1.0) for _ in range(3)]
            box.size.x, box.size.y, box.size.z = edges
            results = [Result(Hypothesis("cup", 0.5)) for _ in range(self.random.choice((0, 2)))]
            some.append(Detection(header, results, box, ident))
        return Detections(header, some)

    def _bulk(self) -> tuple[Any, Any, Any]:
        """Return ids, poses, and numbers of namespaces or None."""
        keys = [self._key() for _ in range(self.random.choice((0, 1, 5, 200)))]
        numbers = np.array([namespace_number(key[0]) for key in keys], np.int64)
        poses = np.array([self._pose() for _ in keys]).reshape(-1, 7)
        ids = np.array([key[1] for key in keys], np.int64)
        return ids, poses, numbers if self.random.random() < 0.8 else None

    def frame(self) -> TransformStamped:
        """Return where a frame is."""
        message = TransformStamped(header=self.header())
        message.header.frame_id = self.random.choice(("map", "map", "map", *FRAMES))
        message.child_frame_id = self.random.choice(FRAMES)
        message.transform = transform_to_ros(self._pose())
        return message

    def clock(self) -> Clock:
        """Return a time near the present one, and rarely far from it."""
        shift = self.random.choice((0, 0, -1, 1, -3600, 3600, 10**8)) * NANOSECONDS
        return Clock(clock=stamp_to_ros(time.time_ns() + shift))

    def event(self) -> ParameterEvent:
        """Return the event of changed parameters."""
        parameters = [Parameter(name=name) for name in ("use_sim_time", "rate", "nothing")]
        return ParameterEvent(node="/a", new_parameters=parameters, changed_parameters=parameters)

    def points(self) -> PointCloud2:
        """Return obstacle points."""
        count = self.random.choice((0, 1, 100, 5000))
        rows = np.zeros(count, [(name, self.random.choice(("<f4", "<f8"))) for name in "xyz"])
        for name in "xyz":
            rows[name] = np.random.default_rng(count).uniform(0.0, ROOM, count)
        return cloud_to_ros(rows, self.header())

    def scan(self) -> LaserScan:
        """Return a scan with rays that hit nothing, or are not known."""
        random = self.random
        count = random.choice((0, 1, 100, 5000))
        hits = (random.uniform(0.0, ROOM), np.inf, -np.inf, np.nan)
        message = LaserScan(
            header=self.header(), ranges=random.choices(hits, (9, 1, 1, 1), k=count)
        )
        message.range_max, message.angle_increment = ROOM, 0.01
        message.time_increment = random.choice((0.0, 1e-5, -1e-5, 1.0))
        return message

    def sonar(self) -> Range:
        """Return a range of a cone."""
        distance = self.random.choice((0.0, 1.0, ROOM, np.inf, np.nan))
        limits = {"min_range": 0.1, "max_range": 0.5 * ROOM}
        return Range(header=self.header(), range=distance, field_of_view=0.3, **limits)
