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

"""Recordings in memory and as bags of ROS 2 (MCAP), by the package rosbags."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple


class Entry(NamedTuple):
    """One message: topic, type (``std_msgs/msg/Bool``), time of receipt (ns), serialised."""

    topic: str
    kind: str
    time: int
    data: bytes


def write_bag(folder: Path, entries: Iterable[Entry]) -> None:
    """Write a new bag, as ``ros2 bag record`` does."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {}
        for entry in entries:
            if entry.topic not in connections:
                connections[entry.topic] = writer.add_connection(
                    entry.topic, entry.kind, typestore=store
                )
            writer.write(connections[entry.topic], entry.time, entry.data)


def read_bag(folder: Path) -> list[Entry]:
    """Return what is in a bag, in the order of its times."""
    from rosbags.rosbag2 import Reader

    with Reader(folder) as reader:
        return [
            Entry(connection.topic, connection.msgtype, time, bytes(data))
            for connection, time, data in reader.messages()
        ]
