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

"""Messages like those of vision_msgs, which is not on PyPI, and their bytes.

They have what mutations need of a message. The bytes are plain little-endian CDR; where vision_msgs
is not installed, they are sent as those of another type, and the node takes them so.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from struct import pack
from typing import Any, ClassVar

from geometry_msgs.msg import Pose, PoseWithCovariance, Vector3
from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from obb_collision.node.inputs.detections import MessageType
from obb_collision.node.messages.cdr import ENCAPSULATION

TYPE: Any = PointCloud2 if MessageType is None else MessageType
"""The type by which detections are sent."""
LAYOUTS = {"double": "d", "float": "f", "int32": "i", "uint32": "I"}


class LookAlike:
    """A message by its fields: ``KINDS`` has their types as ROS names them."""

    KINDS: ClassVar[dict[str, str]]

    def get_fields_and_field_types(self) -> dict[str, str]:
        """Return the types of the fields by their names."""
        return self.KINDS


@dataclass
class Hypothesis(LookAlike):
    """What a detection may be."""

    KINDS: ClassVar = {"class_id": "string", "score": "double"}
    class_id: str = ""
    score: float = 0.0


@dataclass
class Result(LookAlike):
    """A hypothesis with a pose."""

    KINDS: ClassVar = {
        "hypothesis": "vision_msgs/ObjectHypothesis",
        "pose": "geometry_msgs/PoseWithCovariance",
    }
    hypothesis: Hypothesis = field(default_factory=Hypothesis)
    pose: PoseWithCovariance = field(default_factory=PoseWithCovariance)


@dataclass
class Box(LookAlike):
    """A box."""

    KINDS: ClassVar = {"center": "geometry_msgs/Pose", "size": "geometry_msgs/Vector3"}
    center: Pose = field(default_factory=Pose)
    size: Vector3 = field(default_factory=Vector3)


@dataclass
class Detection(LookAlike):
    """A detection."""

    KINDS: ClassVar = {
        "header": "std_msgs/Header",
        "results": "sequence<vision_msgs/ObjectHypothesisWithPose>",
        "bbox": "vision_msgs/BoundingBox3D",
        "id": "string",
    }
    header: Header = field(default_factory=Header)
    results: list[Result] = field(default_factory=list)
    bbox: Box = field(default_factory=Box)
    id: str = ""


@dataclass
class Detections(LookAlike):
    """A Detection3DArray."""

    KINDS: ClassVar = {
        "header": "std_msgs/Header",
        "detections": "sequence<vision_msgs/Detection3D>",
    }
    header: Header = field(default_factory=Header)
    detections: list[Detection] = field(default_factory=list)


def serialised(message: Any) -> bytes:
    """Return the bytes of a message, of ROS or of this module."""
    if not isinstance(message, LookAlike):
        return bytes(serialize_message(message))
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
