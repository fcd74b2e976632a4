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

"""A scene file as the node's beginning: objects, rules, settings."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from each import each

pytest.importorskip("rclpy")
from rclpy.context import Context
from rig import DOMAIN, NAMESPACE, Rig, cube
from visualization_msgs.msg import Marker

from obb_collision import Accuracy, commands
from obb_collision.node import collisions_from_ros
from obb_collision.node.node import CollisionNode
from obb_collision.node.scene_file import SceneFile, keys_from_names
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
    """Yield a node that has ROS arguments."""
    context = Context()
    context.init(domain_id=DOMAIN)
    given = ["--ros-args", *arguments]
    node = CollisionNode(context=context, namespace=NAMESPACE, cli_args=given)
    try:
        yield node
    finally:
        node.destroy_node()
        context.try_shutdown()


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
        rig.send(cube(("part", 7), (20.0, 0.0, 0.0)), cube(("lid", 0), (20.5, 0.0, 0.0)))
        rig.answer()
        names = {(row["id_a"], row["id_b"]) for row in collisions_from_ros(rig.last["collisions"])}
        assert (7, 0) not in names, "they may still touch"
        assert rig.node.get_parameter("padding").value == 0.5, "what is said to the node counts"
        rig.send(Marker(ns="floor", action=Marker.DELETEALL))
        rig.until(lambda: len(collisions_from_ros(rig.next("collisions"))) == 0, "floor gone")


@each("name", READY)
def test_ready_scenes_start_by_name(name: str) -> None:
    with started("-p", f"scene_file:={name}") as node:
        assert len(node.objects.table) == len(load_scene(name).objects)
        node.cycle.run(1)
        assert node.cycle.report is not None


def test_what_cannot_be_used_ends_the_node_with_the_reason(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
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
    found = SceneFile(load_scene(scene_file))
    values = found.parameters()
    assert values["accuracy_overrides"] == ["part/*: aabb", "lid/0: sphere", "lid/0: aabb"]
    assert values["effects.contacts_objects"] == ["part/*", "lid/0"]


def test_the_parameter_file_of_the_package_starts_a_node_with_the_defaults() -> None:
    with started("--params-file", str(ROOT / "config" / "obb_collision.yaml")) as node:
        assert node.parameters.accuracy_overrides == []
        assert node.parameters.mode("contacts") == "auto"
        defaults = {"objects": ["*"], "horizon": 1.0, "tolerance": 1e-4, "accuracy": "pairs"}
        assert node.parameters.setting("sweep") == defaults


def test_unquoted_words_and_empty_lists_of_yaml_are_understood(tmp_path: Path) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text(
        "/**:\n  ros__parameters:\n    accuracy_overrides: []\n    effects:\n"
        "      contacts: off\n      clearance: on\n      contacts_objects: []\n"
    )
    with started("--params-file", str(file), "-p", "effects.sweep:=off") as node:
        modes = [node.parameters.mode(name) for name in ("contacts", "clearance", "sweep")]
        assert modes == ["off", "on", "off"]
        assert node.parameters.accuracy_overrides == []
        assert node.parameters.setting("contacts")["objects"] == []
