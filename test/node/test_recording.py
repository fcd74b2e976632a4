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

"""A recording replayed into another node gives the same answers, in a loop, too."""

from __future__ import annotations

import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
from bags import Entry, read_bag, write_bag
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rig import INPUTS, NAMESPACE, OUTPUTS, Rig, cube
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2, PointField
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.node import events_from_ros, namespace_number
from obb_collision.node.messages.conversions import stamp_from_ros, stamp_to_ros

RECORDED = ("collisions", "contacts", "events", "obb_collision/markers", "collision_status")


class Recorder:
    """Stores messages of the topics of a node as they are, with the times of their receipt."""

    def __init__(self, rig: Rig, topics: tuple[str, ...]) -> None:
        self.entries: list[Entry] = []
        for topic in topics:
            message = INPUTS.get(topic) or OUTPUTS[topic].message
            kind = f"{message.__module__.split('.')[0]}/msg/{message.__name__}"

            def take(data: bytes, topic: str = topic, kind: str = kind) -> None:
                self.entries.append(Entry(f"{NAMESPACE}/{topic}", kind, time.time_ns(), data))

            rig.client.create_subscription(message, topic, take, QoSProfile(depth=100), raw=True)

    def of(self, topic: str) -> list[Any]:
        """Return the messages of a topic so far."""
        return messages(self.entries, topic)


def messages(entries: list[Entry], topic: str) -> list[Any]:
    message = INPUTS.get(topic) or OUTPUTS[topic].message
    name = f"{NAMESPACE}/{topic}"
    return [deserialize_message(entry.data, message) for entry in entries if entry.topic == name]


def stamp_of(message: Any) -> int:
    header = message.markers[0].header if isinstance(message, MarkerArray) else message.header
    return stamp_from_ros(header.stamp)


def answers(entries: list[Entry]) -> dict[int, bytes]:
    """Return the rows of what collides, bit for bit, by the stamp of the state."""
    return {stamp_of(m): bytes(m.data) for m in messages(entries, "collisions")}


def changes(entries: list[Entry]) -> list[tuple[int, ...]]:
    """Return all begins and ends: stamp, event, reason and the objects."""
    names = ["event", "reason", "ns_a", "id_a", "ns_b", "id_b"]
    return [
        (stamp_of(message), *row)
        for message in messages(entries, "events")
        for row in events_from_ros(message)[names].tolist()
        if row[0] != 2
    ]


@pytest.fixture(scope="module")
def recording() -> list[Entry]:
    """Return a live run of inputs and outputs: boxes that come, move by three topics, and go."""
    with Rig(marker_rate=100.0) as rig:
        recorder = Recorder(rig, (*INPUTS, *RECORDED))
        rig.until(lambda: recorder.of("events") and recorder.of("contacts"), "effects")
        rig.stamp = time.time_ns()
        random = np.random.default_rng(11)
        cubes = [cube(("a", k), random.uniform(-2, 2, 3)) for k in range(12)]
        rig.send(Marker(action=Marker.DELETEALL), *cubes)  # where it loops, it begins anew
        rig.answer()
        for step in range(12):
            places = np.zeros((12, 7))
            places[:, :3], places[:, 6] = random.uniform(-2, 2, (12, 3)), 1.0
            names = [f"a/{k}" for k in range(12)]
            if step % 3 == 0:
                rig.send_states(names, places)
            elif step % 3 == 1:
                rig.send_poses(np.arange(12), places, [namespace_number("a")] * 12)
            else:
                rig.send_transform("a/3", places[0])
            rig.answer()
        rig.send(Marker(ns="a", id=5, action=Marker.DELETE), cube(("b", 1)))
        rig.answer()
        rig.cycles(3)
        rig.until(lambda: recorder.of("obb_collision/markers"), "markers")
        return recorder.entries


def replay(rig: Rig, entries: list[Entry], clock: Any) -> None:
    """Send the inputs with the clock of the recording, each once the one before is answered."""
    for entry in entries:
        clock.publish(Clock(clock=stamp_to_ros(entry.time)))
        rig.until(lambda: rig.now() == entry.time, "/clock")  # noqa: B023
        topic = entry.topic.removeprefix(f"{NAMESPACE}/")
        rig.stamp = stamp_of(deserialize_message(entry.data, INPUTS[topic]))
        rig.pubs[topic].publish(entry.data)
        rig.answer()


def test_a_replay_gives_the_answers_of_the_live_run_and_again_in_a_loop(
    recording: list[Entry], tmp_path: Path
) -> None:
    found = recording
    if find_spec("rosbags"):
        write_bag(tmp_path / "bag", recording)
        found = read_bag(tmp_path / "bag")
        assert sorted(found) == sorted(recording)
    inputs = [e for e in found if e.topic.removeprefix(f"{NAMESPACE}/") in INPUTS]
    expected = {
        stamp: found
        for stamp, found in answers(recording).items()
        if stamp >= min(stamp_of(m) for topic in INPUTS for m in messages(inputs, topic))
    }
    assert len(expected) == len(inputs) == 14
    assert len({len(m.data) for m in messages(recording, "collisions")}) > 3, "pairs vary"
    with Rig(given={"use_sim_time": True}) as rig:
        recorder = Recorder(rig, ("collisions", "events"))
        clock = rig.client.create_publisher(Clock, "/clock", 10)
        rig.until(lambda: recorder.of("events") and clock.get_subscription_count(), "match")
        for turn in range(3):
            recorder.entries.clear()
            replay(rig, inputs, clock)
            rig.until(lambda: expected.keys() <= answers(recorder.entries).keys(), "all answers")
            found_again = answers(recorder.entries)
            assert {stamp: found_again[stamp] for stamp in expected} == expected
            if turn == 0:
                rig.until(
                    lambda: len(changes(recorder.entries)) >= len(changes(recording)), "events"
                )
                assert changes(recorder.entries) == changes(recording)
        assert rig.refused("objects") == rig.refused("object_poses") == {}


def test_clouds_are_as_rviz_and_foxglove_require_them(recording: list[Entry]) -> None:
    """By the checks in both sources: fields x y z, float32 for RViz, and sizes that match."""
    found = [
        m for topic in ("collisions", "contacts", "events") for m in messages(recording, topic)
    ]
    assert any(m.width for m in found)
    for message in found:
        assert isinstance(message, PointCloud2)
        assert message.header.frame_id == "map"
        assert not message.is_bigendian
        fields = {field.name: field for field in message.fields}
        assert len(fields) == len(message.fields)
        for name in "xyz":
            assert fields[name].datatype == PointField.FLOAT32
        size = {PointField.FLOAT32: 4, PointField.FLOAT64: 8, PointField.INT32: 4}
        for field in fields.values():
            assert field.count == 1
            assert field.offset + size.get(field.datatype, 1) <= message.point_step
        assert message.width * message.height * message.point_step == len(message.data)
        assert message.row_step == message.width * message.point_step


def test_markers_are_as_rviz_and_foxglove_require_them(recording: list[Entry]) -> None:
    shown = [marker for m in messages(recording, "obb_collision/markers") for marker in m.markers]
    assert {marker.type for marker in shown} == {Marker.CUBE}
    for marker in shown:
        if marker.action == Marker.DELETE:
            continue
        turn = marker.pose.orientation
        assert np.linalg.norm([turn.x, turn.y, turn.z, turn.w]) == pytest.approx(1.0, abs=1e-9)
        assert min(marker.scale.x, marker.scale.y, marker.scale.z) > 0.0
        assert 0.0 < marker.color.a <= 1.0
        assert marker.header.frame_id == "map"
