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

import json
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import yaml
from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from node_process import environment
from processes import Process, started
from rig import NAMESPACE, client_apart

from obb_collision.demo.command import SCENES
from obb_collision.node.inputs import DETECTIONS
from obb_collision.node.inputs.subscriptions import INPUTS
from obb_collision.node.parameters.entries import region_parameters, shared_inputs
from obb_collision.node.runtime.running import initial_parameters
from obb_collision.node.topics.topics import TOPICS
from obb_collision.scene_files import READY

ROOT = Path(__file__).parents[3]


def test_the_rviz_configuration_shows_the_boxes_the_contacts_and_effects_switched_off() -> None:
    content = yaml.safe_load((ROOT / "config" / "obb_collision.rviz").read_text())
    shown = {
        (display["Class"].removeprefix("rviz_default_plugins/"), display["Topic"]["Value"]): display
        for display in content["Visualization Manager"]["Displays"]
        if "Topic" in display
    }
    assert ("MarkerArray", "obb_collision/markers") in shown
    clouds = {topic: found["Enabled"] for (kind, topic), found in shown.items() if "Cloud" in kind}
    assert clouds.pop("collisions") is True
    effects = ("contacts", "clearance", "sweep", "points")
    assert clouds == {TOPICS[name].name: False for name in effects}


def test_the_help_of_launch_lists_the_scenes_of_the_package() -> None:
    launch = (ROOT / "launch" / "obb_collision.launch.py").read_text(encoding="utf-8")
    assert all(f"{name}, " in launch or f"{name}. " in launch for name in READY)
    assert ", ".join(READY) == SCENES


def test_parameters_before_the_start_are_those_that_ros_finds_for_the_node(tmp_path: Path) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text(PARAMETERS)
    names = ("fixed_frame", "rate", "use_sim_time", "scene_file")
    for namespace, *expected in (
        ("cell", "odom", 30.0, True, "tabletop"),
        ("", "odom", 20.0, False, None),
    ):
        found = initial_parameters("obb_collision", namespace, str(file))
        assert [found.get(name) for name in names] == expected


PARAMETERS = """
/**:
  ros__parameters:
    fixed_frame: odom
    rate: 20.0
/cell/*:
  ros__parameters:
    rate: 30.0
cell:
  obb_collision:
    ros__parameters:
      use_sim_time: true
      scene_file: tabletop
other:
  ros__parameters:
    fixed_frame: wrong
"""
LAUNCH = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

source = PythonLaunchDescriptionSource(sys.argv[1])
given = [argument.split(":=") for argument in sys.argv[2:]]
service = LaunchService(noninteractive=True)
service.include_launch_description(
    LaunchDescription([IncludeLaunchDescription(source, launch_arguments=given)])
)
sys.exit(service.run())
"""
STAND_IN = """#!{python}
import json, pathlib, sys
words = sys.argv[1:]
files = [after for word, after in zip(words, words[1:]) if word == "--params-file"]
contents = [pathlib.Path(file).read_text() for file in files]
pathlib.Path({record!r}).write_text(json.dumps([words, contents]))
"""


class Launched:
    """The launch file run by the real launch, with stand-ins for what it starts."""

    def __init__(self, folder: Path) -> None:
        # by submodule: the folder launch/ of this project also answers to "launch"
        for name in ("launch.actions", "launch_ros.actions"):
            pytest.importorskip(name, reason="launch is not installed (not on PyPI)")
        self.folder, self.file = folder, folder / "mine.yaml"
        self.file.write_text(PARAMETERS)
        self.install("obb_collision", "obb_collision_node")

    def install(self, package: str, executable: str) -> None:
        """Install a stand-in that writes its arguments and parameter files down."""
        prefix = self.folder / "prefix"
        for place in ("share/ament_index/resource_index/packages", f"share/{package}"):
            (prefix / place).mkdir(parents=True, exist_ok=True)
        (prefix / "share/ament_index/resource_index/packages" / package).touch()
        file = prefix / "lib" / package / executable
        file.parent.mkdir(parents=True, exist_ok=True)
        record = str(self.folder / executable)
        file.write_text(STAND_IN.format(python=sys.executable, record=record))
        file.chmod(0o755)
        config = prefix / "share" / package / "config"
        if package == "obb_collision" and not config.exists():
            config.symlink_to(ROOT / "config")

    @contextmanager
    def running(self, *given: str, file: str = "obb_collision.launch.py") -> Iterator[Process]:
        """Launch; killed at the end if it still runs."""
        before = os.environ.get("AMENT_PREFIX_PATH", "")
        path = environment(AMENT_PREFIX_PATH=f"{self.folder / 'prefix'}:{before}")
        launch = str(ROOT / "launch" / file)
        with started("-c", LAUNCH, launch, *given, cwd=ROOT, **path) as process:
            yield process

    def run(self, *arguments: str, code: int = 0, **which: str) -> str:
        """Launch, to the end with an exit code; returns the output."""
        with self.running(*arguments, **which) as process:
            output, _ = process.communicate(timeout=60)
        assert process.returncode == code, output
        return str(output)

    def started(self, executable: str) -> tuple[list[str], list[str]] | None:
        """Return arguments and contents of the parameter files of a stand-in, if it was run."""
        record = self.folder / executable
        return tuple(json.loads(record.read_text())) if record.exists() else None

    def parameters(self, namespace: str) -> dict[str, Any]:
        """Return the parameters that the node gets from all its files together."""
        started = self.started("obb_collision_node")
        assert started is not None
        files = [self.folder / f"given_{number}.yaml" for number, _ in enumerate(started[1])]
        for file, content in zip(files, started[1], strict=True):
            file.write_text(content)
        return initial_parameters("obb_collision", namespace, *map(str, files))


REAL = """#!/bin/sh
exec {python} -c "from obb_collision.commands import node; raise SystemExit(node())" "$@"
"""


@pytest.mark.parametrize("who", ["", "true", "launch", "false"])
def test_the_node_is_configured_and_activated_as_launch_says(launched: Launched, who: str) -> None:
    state = "unconfigured" if who == "false" else "active"
    node = launched.folder / "prefix/lib/obb_collision/obb_collision_node"
    node.write_text(REAL.format(python=sys.executable))
    arguments = (f"namespace:={NAMESPACE}", *([f"autostart:={who}"] if who else ()))
    with launched.running(*arguments) as process, client_apart() as other:
        other.until(lambda: other.state() == state, state)
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=60)
    assert process.returncode == 0, output
    assert "Traceback" not in output
    waited = "unconfigured: nothing is stored" in output
    assert waited == (who in ("launch", "false")), output


@pytest.fixture
def launched(tmp_path: Path) -> Launched:
    """Return the launch file with a stand-in for the node."""
    return Launched(tmp_path)


def test_launch_starts_the_node_with_the_parameters_of_its_file(launched: Launched) -> None:
    launched.run()
    started = launched.started("obb_collision_node")
    assert started is not None
    assert started[1] == [(ROOT / "config/obb_collision.yaml").read_text()]
    assert launched.started("rviz2") is None


@pytest.mark.parametrize("given", [True, False])
def test_what_is_given_to_launch_wins_over_the_users_file(launched: Launched, given: bool) -> None:
    launched.install("rviz2", "rviz2")
    more = ["scene_file:=warehouse", "use_sim_time:=false", "fixed_frame:=world", "robots:=a b"]
    always = (f"params_file:={launched.file}", "namespace:=cell", "rviz:=true")
    launched.run(*always, *(more if given else ()))
    found = launched.parameters("cell")
    names = ("scene_file", "use_sim_time", "fixed_frame", "rate")
    expected = ("warehouse", False, "world", 30.0) if given else ("tabletop", True, "odom", 30.0)
    assert tuple(found[name] for name in names) == expected
    assert found.get("robots") == (["a", "b"] if given else None)
    started = launched.started("rviz2")
    assert started is not None
    options, (parameters,) = started
    assert options[options.index("-f") + 1] == ("world" if given else "odom")
    assert Path(options[options.index("-d") + 1]).name == "obb_collision.rviz"
    assert f"use_sim_time: {str(not given).lower()}" in parameters
    assert "__ns:=/cell" in options


def test_regions_have_the_parameters_of_a_split_and_read_the_same_inputs() -> None:
    regions = region_parameters("0 0 0", "3 2 1", "3 1 1", "0.5")
    assert list(regions) == ["region_0", "region_1", "region_2"]
    assert regions["region_1"] == {"region": ["x: 1.0 to 2.0"], "region_halo": 0.5}
    assert region_parameters("0 0 0", "1 1 1", "1 1 1", "1")["region_0"]["region"] == [""]
    names = {name for name, _ in shared_inputs("cell")}
    assert names == {*INPUTS, DETECTIONS.topic}  # the latter where vision_msgs is installed
    assert dict(shared_inputs("cell"))["points"] == "/cell/points"
    assert dict(shared_inputs(""))["points"] == "/points"
    with pytest.raises(ValueError, match="parts"):
        region_parameters("0 0 0", "1 1 1", "0 1 1", "1")


def test_launch_of_regions_starts_a_node_per_region_and_the_merger(launched: Launched) -> None:
    launched.install("obb_collision", "obb_collision_merge")
    file = f"params_file:={launched.file}"
    launched.run("parts:=2 1 1", "only:=1", file, file="regions.launch.py")
    assert launched.parameters("region_1")["region"] == ["x: 5.0 to inf"]
    merger = launched.started("obb_collision_merge")
    assert merger is not None
    assert PARAMETERS in merger[1]


def test_without_rviz2_nothing_is_started_and_the_reason_is_said(launched: Launched) -> None:
    try:
        get_package_prefix("rviz2")
    except (PackageNotFoundError, OSError):  # OSError: not even a folder of packages is named
        pass
    else:
        pytest.skip("rviz2 is installed")
    output = launched.run("rviz:=true", code=1)
    assert "rviz2 is not installed: nothing was started" in output
    assert "Traceback" not in output
    assert launched.started("obb_collision_node") is None
