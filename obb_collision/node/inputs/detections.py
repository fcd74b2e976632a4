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

"""The topic ``detections``, where vision_msgs is installed: boxes of a detector.

Each vision_msgs/Detection3DArray is the complete set of boxes that are detected: ``boxes`` applies
it. Every detection is an object, whatever its id, class and score.
"""

from __future__ import annotations

from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
from rclpy.qos import ReliabilityPolicy

from obb_collision.node.inputs.boxes import BoxRows, SetInput
from obb_collision.node.inputs.clouds import QueuedCloud
from obb_collision.node.inputs.subscriptions import Input
from obb_collision.node.messages.cdr import PAIRS, STRING, TIME, Header, Layout, Reader
from obb_collision.node.messages.conversions import stamp_from_ros
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.names import whole_from_text
from obb_collision.node.messages.optional import optional
from obb_collision.node.objects.table import ID_OFFSET
from obb_collision.typing import Floats, Rows

DETECTION = Layout(
    stamp=TIME,
    frame=STRING,
    results=(PAIRS, 4 + 352, 1),
    result_class=STRING,
    result=(1, 352, 8),  # a score, and a pose with its covariance
    box=np.dtype([("pose", "<f8", (7,)), ("size", "<f8", (3,))]),
    id=STRING,
)
"""Of a vision_msgs/Detection3D."""
MessageType: Any = optional("vision_msgs.msg", "Detection3DArray")
"""None where vision_msgs cannot be used."""

DETECTIONS = SetInput("detections", "detections", 2)
QUEUE = 10, ReliabilityPolicy.BEST_EFFORT
"""Depth and reliability: as detectors send that follow sensors."""
MEANING = "Complete set of boxes of a detector, where vision_msgs is installed."
INPUTS = (
    {} if MessageType is None else {DETECTIONS.topic: Input(MessageType, *QUEUE, meaning=MEANING)}
)
"""The topic, where there is the type of its messages."""


class Detections(NamedTuple):
    """Detections: ids as texts, poses (n, 7) and sizes (n, 3) of their boxes; all their frames."""

    header: Header
    ids: list[str]
    poses: Floats
    sizes: Floats
    frames: set[str]


def detections_from_bytes(data: bytes, most: int) -> Detections:
    """Return the detections in a serialised Detection3DArray.

    RefusedError ("malformed message", "too many points" for more than ``most``).
    """
    reader = Reader(data, MessageType)
    header = reader.header()
    items = reader.items(DETECTION, most)
    reader.end()
    box, changes = items.numbers["box"], items.of("frame")[:, 2] == 0
    poses, sizes = box["pose"].astype(np.float64), box["size"].astype(np.float64)
    return Detections(header, items.texts("id"), poses, sizes, set(items.texts("frame", changes)))


def read_detections(data: bytes, most: int) -> QueuedCloud:
    """Return the ``BoxRows`` of a message of ``detections``; RefusedError."""
    message = detections_from_bytes(data, most)
    frame, stamp = message.header.frame_id, stamp_from_ros(message.header.stamp)
    others = message.frames - {frame, ""}
    if not frame and len(others) == 1:
        frame = others.pop()
    if others:
        raise RefusedError("several frames", f"{sorted({frame, *others})[:2]}")
    boxes = BoxRows(
        None, numbers_of(message.ids), message.poses, message.sizes, DETECTIONS.namespace
    )
    return QueuedCloud(boxes, frame, stamp, len(data))


def numbers_of(texts: list[str]) -> Rows:
    """Return distinct numbers (n,), the ids of objects, for the ids of detections.

    An id that is a whole number stays, another text becomes its CRC-32. A detection without an id,
    with one beyond int32, or with that of one before it gets the lowest free number.
    """
    numbers = np.full(len(texts), -1, np.int64)
    taken: set[int] = set()
    waiting = []
    for row, ident in enumerate(texts):
        number = whole_from_text(ident)
        if number is None and ident:
            number = crc32(ident.encode("utf-8", "replace")) - ID_OFFSET
        if number is None or number in taken or not -ID_OFFSET <= number < ID_OFFSET:
            waiting.append(row)
        else:
            numbers[row] = number
            taken.add(number)
    free = 0
    for row in waiting:
        while free in taken:
            free += 1
        numbers[row] = free
        taken.add(free)
    return numbers
