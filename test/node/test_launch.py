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

"""Launch file, parameter file and RViz configuration agree with the node."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
import yaml

from obb_collision.node.effects import TOPICS
from obb_collision.node.parameters import SPECS

ROOT = Path(__file__).parents[2]


def test_the_parameter_file_holds_every_parameter_at_its_default() -> None:
    content = yaml.safe_load((ROOT / "config" / "obb_collision.yaml").read_text())
    values = content["/**"]["ros__parameters"]
    effects = values.pop("effects")
    values |= {f"effects.{name}": value for name, value in effects.items()}
    assert values == {spec.name: spec.default for spec in SPECS}
    for spec in SPECS:
        assert type(values[spec.name]) is type(spec.default), "ROS refuses an int for a double"


def displays() -> dict[str, Any]:
    content = yaml.safe_load((ROOT / "config" / "obb_collision.rviz").read_text())
    return {display["Name"]: display for display in content["Visualization Manager"]["Displays"]}


def test_the_rviz_configuration_shows_the_boxes_and_the_contacts() -> None:
    shown = displays()
    assert shown["World boxes"]["Class"] == "rviz_default_plugins/MarkerArray"
    assert shown["World boxes"]["Topic"]["Value"] == "obb_collision/markers"
    assert shown["Contacts"]["Class"] == "rviz_default_plugins/PointCloud2"
    assert shown["Contacts"]["Topic"]["Value"] == "collisions"


def test_the_rviz_configuration_has_the_topics_of_the_effects_switched_off() -> None:
    clouds = {
        shown["Topic"]["Value"]: shown["Enabled"]
        for shown in displays().values()
        if shown["Class"] == "rviz_default_plugins/PointCloud2"
    }
    assert clouds.pop("collisions") is True
    effects = ("contacts", "clearance", "sweep", "points")
    assert clouds == {TOPICS[name]: False for name in effects}


def test_the_launch_file_describes_the_node() -> None:
    # by submodule: the folder launch/ of this project also answers to "launch"
    pytest.importorskip("launch.actions", reason="launch is not installed (not on PyPI)")
    pytest.importorskip("launch_ros.actions", reason="launch_ros is not installed (not on PyPI)")
    described = runpy.run_path(str(ROOT / "launch" / "obb_collision.launch.py"))
    entities = described["generate_launch_description"]().entities
    nodes = [entity for entity in entities if hasattr(entity, "node_executable")]
    assert [node.node_executable for node in nodes] == ["obb_collision_node", "rviz2"]
