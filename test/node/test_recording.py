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

"""What a node begins with from a scene file, and the same answers from a recording."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from each import each
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rig import INPUTS, NAMESPACE, OUTPUTS, Printed, Rig, cube, own_context
from rosgraph_msgs.msg import Clock
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision import Accuracy, commands
from obb_collision.node import collisions_from_ros, events_from_ros, namespace_number
from obb_collision.node.inputs.scene_file import SceneFile, keys_from_names
from obb_collision.node.messages.conversions import stamp_from_ros, stamp_to_ros
from obb_collision.node.node import CollisionNode
from obb_collision.scene_files import READY, load_scene

ROOT = Path(__file__).parents[2]
SCENE = """
accuracy: {default: obb, parts: aabb, lid: sphere}
padding: 0.25
groups: {parts: ["part/*"]}
allowed: [[parts, lid]]
effects:
  contacts: {mode: "on", objects: [lid, parts], max_points: 8}
  clearance: off
  markers: off
objects:
  - {name: part/7, shape: box, size: [1, 1, 1], position: [0, 0, 0]}
  - {name: part/8, shape: box, size: [1, 1, 1], position: [1.25, 0, 0]}
  - {name: lid, shape: box, size: [1, 1, 1], position: [0, 0, 0.5], accuracy: aabb}
  - {name: floor, shape: box, size: [9, 9, 1], position: [0, 0, -1.25], padding: 0.0}
"""


@contextmanager
def started(*arguments: str) -> Iterator[CollisionNode]:
    given = ["--ros-args", *arguments]
    with own_context() as context:
        node = CollisionNode(context=context, namespace=NAMESPACE, cli_args=given)
        try:
            yield node
        finally:
            node.destroy_node()


@pytest.fixture
def scene_file(tmp_path: Path) -> Path:
    file = tmp_path / "scene.yaml"
    file.write_text(SCENE)
    return file


def test_objects_rules_and_settings_of_a_scene_file_are_those_of_the_node(scene_file: Path) -> None:
    with Rig(scene_file=str(scene_file)) as rig:
        rig.until(lambda: len(rig.node.cycle.report or ()) > 0, "pairs")
        report = rig.node.cycle.report
        assert report is not None
        assert set(report.names()) == {
            ("part/7", "part/8"),  # 0.25 apart, both padded by as much
            ("part/7", "floor/0"),
            ("part/8", "floor/0"),
        }
        scene = rig.node.objects.scene
        assert scene.accuracy == Accuracy.OBB
        assert scene.objects.store.accuracies[scene.index("part/7")] == Accuracy.AABB
        assert scene.objects.store.accuracies[scene.index("lid/0")] == Accuracy.AABB
        value = {name: rig.node.get_parameter(name).value for name in rig.node._parameters}
        assert value["padding"] == 0.25
        assert value["effects.contacts"] == "on"
        assert value["effects.contacts_max_points"] == 8
        assert value["effects.contacts_objects"] == ["part/*", "lid/0"]
        assert (value["effects.clearance"], value["effects.markers"]) == ("off", "off")
        assert value["effects.sweep"] == "auto"
        assert scene.effects["contacts"].values["max_points"] == 8


def test_objects_of_a_file_move_change_and_go_like_all_others(scene_file: Path) -> None:
    with Rig(scene_file=str(scene_file), padding=0.5) as rig:
        rig.send(cube(("part", 7), (20.0, 0.0, 0.0)), cube(("lid", 0), (20.5, 0.0, 0.0))).answer()
        names = {(row["id_a"], row["id_b"]) for row in collisions_from_ros(rig.last["collisions"])}
        assert (7, 0) not in names, "they may still touch"
        assert rig.node.get_parameter("padding").value == 0.5, "what is said to the node counts"
        rig.send(Marker(ns="floor", action=Marker.DELETEALL))
        rig.until(lambda: rig.next("collisions").width == 0, "floor gone")


@each("name", READY)
def test_ready_scenes_start_by_name(name: str) -> None:
    with started("-p", f"scene_file:={name}") as node:
        assert len(node.objects.table) == len(load_scene(name).objects)
        node.cycle.run(1)
        assert node.cycle.report is not None


def test_what_cannot_be_used_ends_the_node_with_its_reason(tmp_path: Path, capfd: Printed) -> None:
    file = tmp_path / "wrong.yaml"
    file.write_text("objects:\n  - {name: a/1, shape: box, size: [1, -1, 1]}\n")
    for given, reason in (
        (f"scene_file:={file}", f"{file}:2: "),
        ("stale_policy:=forget", "stale_policy must be one of unknown, collide, keep, ignore"),
    ):
        assert commands.node(["--ros-args", "-p", given]) == 1
        assert reason in capfd.readouterr().err


@each(
    "names, keys",
    [
        (["cup/1", "a/b/2", "/3"], [("cup", 1), ("a/b", 2), ("", 3)]),
        (["cup", "cup/0", "cup/x"], [("cup", 1), ("cup", 0), ("cup/x", 0)]),
        (["a/01", "a/-1", "a/9999999999"], [("a/01", 0), ("a/-1", 0), ("a/9999999999", 0)]),
    ],
)
def test_names_of_a_file_become_keys(names: list[str], keys: list[Any]) -> None:
    assert keys_from_names(names) == keys


def test_patterns_reach_objects_whose_names_changed(scene_file: Path) -> None:
    values = SceneFile(load_scene(scene_file)).parameters()
    assert values["accuracy_overrides"] == ["part/*: aabb", "lid/0: sphere", "lid/0: aabb"]
    assert values["effects.contacts_objects"] == ["part/*", "lid/0"]


def test_unquoted_words_and_empty_lists_of_yaml_count_after_our_file(tmp_path: Path) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text(
        "/**:\n  ros__parameters:\n    accuracy_overrides: []\n    effects:\n"
        "      contacts: off\n      clearance: on\n      contacts_objects: []\n"
    )
    files = [str(ROOT / "config" / "obb_collision.yaml"), str(file)]
    given = [word for one in files for word in ("--params-file", one)]
    with started(*given, "-p", "effects.sweep:=off") as node:
        defaults = {"objects": ["*"], "horizon": 1.0, "tolerance": 1e-4, "accuracy": "pairs"}
        assert node.parameters.setting("sweep") == defaults
        modes = [node.parameters.mode(name) for name in ("contacts", "clearance", "sweep")]
        assert modes == ["off", "on", "off"]
        assert node.parameters.accuracy_overrides == []
        assert node.parameters.setting("contacts")["objects"] == []


RECORDED = ("collisions", "contacts", "events", "obb_collision/markers", "collision_status")


class Entry(NamedTuple):
    """One message: topic, type (``std_msgs/msg/Bool``), time of receipt (ns), serialised."""

    topic: str
    kind: str
    time: int
    data: bytes


def write_bag(folder: Path, entries: Iterable[Entry]) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {}
        for topic, kind, stamp, data in entries:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], stamp, data)


def read_bag(folder: Path) -> list[Entry]:
    from rosbags.rosbag2 import Reader

    with Reader(folder) as reader:
        return [Entry(c.topic, c.msgtype, time, bytes(data)) for c, time, data in reader.messages()]


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
        rig.send(Marker(ns="a", id=5, action=Marker.DELETE), cube(("b", 1))).answer()
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


def test_a_replay_gives_the_answers_of_the_live_run(recording: list[Entry], tmp_path: Path) -> None:
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
        wanted = changes(recording)
        for turn in range(3):
            recorder.entries.clear()
            replay(rig, inputs, clock)
            rig.until(lambda: expected.keys() <= answers(recorder.entries).keys(), "all answers")
            found_again = answers(recorder.entries)
            assert {stamp: found_again[stamp] for stamp in expected} == expected
            if turn == 0:
                rig.until(lambda: len(changes(recorder.entries)) >= len(wanted), "events")
                assert changes(recorder.entries) == wanted
        assert rig.refused("objects") == rig.refused("object_poses") == {}
