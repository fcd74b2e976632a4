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

"""The messages of an attack by number, and hostile cases that chance would not make.

A message is a function of the seed and of its number alone, so that a number from a report is
enough to make it again; only stamps are near the time at which it is made. A case is a function of
random numbers and the makers of valid messages; it returns the topic, and a message or the bytes
of one. Each is sent once at first, and now and then later.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import numpy as np
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.node.messages.box_markers import MarkerArrayWriter
from obb_collision.node.messages.cdr import ENCAPSULATION
from obb_collision.node.messages.clouds import boxes_to_ros, poses_to_ros
from obb_collision.node.messages.names import namespace_number
from tools.fuzz.messages import Box, Detection, Messages, serialised
from tools.fuzz.mutations import damaged, mutate, raw
from tools.fuzz.robot import RobotMessages

Made = tuple[str, Any]
Case = Callable[[Random, Messages], Made]
CLOUDS = ("object_poses", "object_boxes", "points")
MANY = 100_000
LONG = "z" * 1_000_000
LARGEST = 2**32 - 1
NUMBERS = (np.nan, np.inf, -np.inf, 1e308, -1e308, 5e-324)
SPACING = 3.0
"""Distance of very many objects (m): they do not collide."""


def _cloud_case(spoil: Callable[[PointCloud2, Random], object]) -> Case:
    def make(random: Random, messages: Messages) -> Made:
        topic = random.choice(CLOUDS)
        rows = {"object_poses": _poses, "object_boxes": _boxes}
        message = rows[topic](messages) if topic in rows else messages.points()
        spoil(message, random)
        return topic, message

    return make


def grid(count: int) -> Any:
    """Poses (n, 7) of objects that do not collide."""
    poses = np.zeros((count, 7))
    poses[:, 6] = 1.0
    numbers = np.arange(count)
    poses[:, :3] = SPACING * np.column_stack((numbers % 50, numbers // 50 % 50, numbers // 2500))
    poses[:, :3] += 20.0
    return poses


def _poses(messages: Messages, count: int = 30) -> PointCloud2:
    header = messages.header()
    return poses_to_ros(np.arange(count), grid(count), [namespace_number("a")] * count, header)


def _boxes(messages: Messages, count: int = 30) -> PointCloud2:
    numbers = [namespace_number("a")] * count
    return boxes_to_ros(
        np.arange(count), grid(count), np.ones((count, 3)), numbers, messages.header()
    )


def _set(of_field: bool = False, /, **values: Any) -> Callable[[PointCloud2, Random], None]:
    """Return a case that sets values of a cloud, or of one of its fields."""

    def spoil(message: PointCloud2, random: Random) -> None:
        for name, value in values.items():
            setattr(random.choice(message.fields) if of_field else message, name, value)

    return spoil


def _wide_offset(message: PointCloud2, random: Random) -> None:
    near = (message.point_step - 1, message.point_step, LARGEST, LARGEST - 7, 2**31, 2**31 - 4)
    random.choice(message.fields).offset = random.choice(near)


def _wrong_rows(message: PointCloud2, random: Random) -> None:
    message.row_step = random.choice(
        (1, max(0, message.row_step - 1), message.row_step + 1, LARGEST)
    )
    message.height = random.choice((1, 2, LARGEST))


def _hostile_values(message: PointCloud2, random: Random) -> None:
    """Set each field of the first rows to each hostile value in turn."""
    data = np.frombuffer(bytes(message.data), np.uint8).reshape(-1, message.point_step).copy()
    wide = [field for field in message.fields if field.datatype == PointField.FLOAT64]
    places = [(field.offset, value) for field in wide for value in NUMBERS]
    for row, (at, value) in zip(data, places, strict=False):
        row[at : at + 8] = np.frombuffer(np.float64(value).tobytes(), np.uint8)
    message.data = data.tobytes()


def _same_keys(message: PointCloud2, random: Random) -> None:
    message.data = bytes(message.data)[: message.point_step] * message.width


def _many_markers(random: Random, messages: Messages) -> Made:
    writer = MarkerArrayWriter("map", time.time_ns(), 0.0)
    for number, pose in enumerate(grid(MANY).tolist()):
        writer.add(("many", number), Marker.CUBE, Marker.ADD, pose, (0.5, 0.5, 0.5))
    return "objects", writer.message()


def _states(texts: bytes, poses: int) -> bytes:
    """States of MANY names, as bytes with their lengths, and another number of poses."""
    head = ENCAPSULATION + bytes(8) + b"\4\0\0\0map\0"
    data = head + MANY.to_bytes(4, "little") + texts + poses.to_bytes(4, "little")
    data += bytes(-(len(data) - len(ENCAPSULATION)) % 8)
    return data + grid(poses).tobytes() + bytes(8)


def _many_states(random: Random, messages: Messages) -> Made:
    return "object_states", _states(b"\7\0\0\0a/1234\0\0" * MANY, MANY)  # 7 with their end


def _many_names(random: Random, messages: Messages) -> Made:
    """States of unknown objects, in a namespace each, or all in a known one."""
    numbers = range(MANY, 2 * MANY)  # of six digits
    texts = random.choice(
        ([b"n%d/%d\0" % (n, n) for n in numbers], [b"a/%d\0" % n for n in numbers])
    )
    rows = np.zeros(MANY, [("length", "u4"), ("text", "S16")])
    rows["length"], rows["text"] = len(texts[0]), texts
    width = 4 + (len(texts[0]) + 3) // 4 * 4  # lengths are aligned
    data = rows.view(np.uint8).reshape(MANY, -1)[:, :width].tobytes()
    return "object_states", _states(data, random.choice((MANY, MANY - 1)))


def _many_detections(random: Random, messages: Messages) -> Made:
    names = ("stamp", "length", "frame", "results", "box", "size", "id")
    kinds = ("u8", "u4", "S4", "u4", "10f8", "u4", "S8")
    # 112 bytes each, the first at byte 20: all numbers aligned
    rows = np.zeros(MANY, list(zip(names, kinds, strict=True)))
    rows["length"], rows["frame"], rows["size"] = 4, b"map", 8
    rows["box"][:, :7], rows["box"][:, 7:] = grid(MANY), 0.5
    rows["id"] = np.arange(5_000_000, 5_000_000 + MANY).astype("S7")
    head = ENCAPSULATION + bytes(8) + b"\4\0\0\0map\0" + MANY.to_bytes(4, "little")
    return "detections", head + rows.tobytes()


def _claimed_detections(random: Random, messages: Messages) -> Made:
    data = bytearray(_many_detections(random, messages)[1][: 1000 * random.randint(1, 9)])
    at, claimed = random.choice(((20, LARGEST), (20, 10**7), (40, LARGEST), (40, 10**6)))
    data[at : at + 4] = claimed.to_bytes(4, "little")  # detections, or results of the first one
    return "detections", bytes(data)


def _detections_in_frames(random: Random, messages: Messages) -> Made:
    message = messages.detections()
    message.detections = [
        Detection(Header(frame_id=frame), [], Box(), frame) for frame in ("map", "odom", "", LONG)
    ]
    return "detections", message


def _every_number(random: Random, messages: Messages) -> Made:
    """Markers with each hostile number in each field of pose and scale."""
    markers = []
    for number, value in enumerate(NUMBERS):
        for place in range(10):
            marker = messages.marker()
            marker.ns, marker.id, marker.type, marker.action = "a", 10 * number + place, 1, 0
            parts = marker.pose.position, marker.pose.orientation, marker.scale
            part, name = [(p, n) for p, names in zip(parts, ("xyz", "xyzw", "xyz"), strict=True)
                          for n in names][place]  # fmt: skip
            setattr(part, name, float(value))
            markers.append(marker)
    return "objects", MarkerArray(markers=markers)


def _long_texts(random: Random, messages: Messages) -> Made:
    marker = messages.marker()
    part, name = random.choice(
        ((marker, "ns"), (marker, "text"), (marker, "mesh_resource"), (marker.header, "frame_id"))
    )
    setattr(part, name, LONG)
    return "objects", MarkerArray(markers=[marker])


def _long_name(random: Random, messages: Messages) -> Made:
    topic = random.choice(("object_transform", "object_states"))
    message = messages.makers[topic][1]()
    if topic == "object_states":
        message.joint_names = [LONG, *message.joint_names]
    else:
        message.child_frame_id = LONG
    return topic, message


def _unknown_deletes(random: Random, messages: Messages) -> Made:
    keys = [("nobody", number) for number in range(50)] + [("a", -(2**31)), ("", 2**31 - 1)]
    gone = [Marker(ns=ns, id=number, action=Marker.DELETE) for ns, number in keys]
    return "objects", MarkerArray(markers=gone)


def _repeated_markers(random: Random, messages: Messages) -> Made:
    marker = messages.marker()
    again = [marker, Marker(ns=marker.ns, id=marker.id), marker] * 20
    return "objects", MarkerArray(markers=again)


CASES: dict[str, Case] = {
    "field missing": _cloud_case(lambda m, r: m.fields.pop(r.randrange(len(m.fields)))),
    "field twice": _cloud_case(lambda m, r: m.fields.append(r.choice(m.fields))),
    "offset beyond the point": _cloud_case(_wide_offset),
    "point_step 0": _cloud_case(_set(point_step=0)),
    "point_step 2^32 - 1": _cloud_case(_set(point_step=LARGEST)),
    "row_step wrong": _cloud_case(_wrong_rows),
    "width x height overflows 32 bits": _cloud_case(_set(width=2**16, height=2**16)),
    "width x height overflows 64 bits": _cloud_case(_set(width=LARGEST, height=LARGEST)),
    "width without rows": _cloud_case(_set(width=LARGEST, height=0)),
    "10^7 points claimed": _cloud_case(_set(width=10**7, row_step=0)),
    "unknown datatype": _cloud_case(_set(True, datatype=9)),
    "datatype 0": _cloud_case(_set(True, datatype=0)),
    "several numbers per field": _cloud_case(_set(True, count=LARGEST)),
    "other order of bytes": _cloud_case(_set(is_bigendian=True)),
    "name of a field of 1 MB": _cloud_case(_set(True, name=LONG)),
    "100,000 fields": _cloud_case(lambda m, r: m.fields.extend([PointField()] * MANY)),
    "hostile numbers in every field of a cloud": _cloud_case(_hostile_values),
    "the same key in all rows": _cloud_case(_same_keys),
    "no data": _cloud_case(_set(data=b"")),
    "hostile numbers in every field of a marker": _every_number,
    "texts of 1 MB": _long_texts,
    "names of 1 MB": _long_name,
    "DELETE of unknown": _unknown_deletes,
    "the same key in all markers": _repeated_markers,
    "100,000 markers": _many_markers,
    "100,000 boxes": lambda random, messages: ("object_boxes", _boxes(messages, MANY)),
    "100,000 poses": lambda random, messages: ("object_poses", _poses(messages, MANY)),
    "100,000 states": _many_states,
    "100,000 different names": _many_names,
    "100,000 detections": _many_detections,
    "detections and results claimed": _claimed_detections,
    "detections in several frames": _detections_in_frames,
}


CASE_SHARE = 0.002
"""Share of the messages that are a named case; the first ones are all cases once."""
DAMAGED = 0.15
"""Share of the others whose bytes are damaged, besides what their fields hold."""
CLOCK_SHARE = 0.02
"""Share of the messages on topics that are not the node's own, each: tf, clock, events."""

FIXED = {"/clock": 12}
"""Bytes of messages without texts and lists: the middleware sends no longer ones."""


class Sent(NamedTuple):
    """A message to send: topic, bytes and description."""

    topic: str
    data: bytes
    kind: str


class Stream:
    """Makes messages by number; ``folder`` gets mesh files.

    robots: share of the messages on the topics of a robot.
    """

    def __init__(self, seed: int, folder: Path, robots: float = 0.0) -> None:
        self._seed, self._share = seed, robots
        self.messages = Messages(Random(seed), folder)
        self.robot = RobotMessages(self.messages, folder) if robots else None
        self._makers = dict(self.messages.makers)
        self.types = {topic: kind for topic, (kind, _) in self._makers.items()}
        """Type by topic."""
        self._own = [topic for topic in self.types if not topic.startswith("/")]
        self._others = [topic for topic in self.types if topic.startswith("/")]
        if self.robot is not None:
            self._makers |= self.robot.makers
            self.types |= {topic: kind for topic, (kind, _) in self.robot.makers.items()}

    def _start(self, what: str, number: int) -> Random:
        random = Random(f"{self._seed} {what} {number}")
        self.messages.random = random
        return random

    def _topic(self, random: Random) -> str:
        """Choose a topic."""
        if self.robot is not None and random.random() < self._share:
            return random.choice(list(self.robot.makers))
        if random.random() < CLOCK_SHARE * len(self._others):
            return random.choice(self._others)
        return random.choice(self._own)

    def message(self, number: int) -> Sent:
        """Return a message with hostile fields, or a case."""
        random = self._start("message", number)
        if number < len(CASES) or random.random() < CASE_SHARE:
            names = list(CASES)
            name = names[number] if number < len(names) else random.choice(names)
            return self._sent(CASES[name](random, self.messages), name)
        topic = self._topic(random)
        message = self._makers[topic][1]()
        for _ in range(random.choice((0, 1, 1, 2, 5))):
            try:
                mutate(message, random)
            except AssertionError:  # rclpy refuses to set it, so it can't be sent
                continue
        data = serialised(message)
        if random.random() < DAMAGED:
            return Sent(topic, _sendable(topic, damaged(data, random)), "damaged")
        return Sent(topic, data, "mutated")

    def raw(self, number: int) -> Sent:
        """Return bytes that may be no message at all."""
        random = self._start("raw", number)
        topic = self._topic(random)
        data, other = (
            serialised(self._makers[one][1]()) for one in (topic, random.choice(self._own))
        )
        return Sent(topic, _sendable(topic, raw(data, other, random)), "raw")

    def _sent(self, made: Made, name: str) -> Sent:
        topic, message = made
        data = message if isinstance(message, bytes) else serialised(message)
        return Sent(topic, data, name)


def _sendable(topic: str, data: bytes) -> bytes:
    return data[: FIXED.get(topic)]
