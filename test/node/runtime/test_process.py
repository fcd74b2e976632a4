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

"""The executable as a process, and the launch, parameter and RViz files that go with it."""

from __future__ import annotations

import json
import os
import platform
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import cycle
from pathlib import Path
from typing import Any

import pytest
import yaml
from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from diagnostic_msgs.msg import DiagnosticArray
from each import each
from lifecycle_msgs.msg import Transition
from node_process import environment, running
from processes import PATIENCE, Process, output_until, run_python, started
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import QoSProfile
from rig import DOMAIN, NAMESPACE, STATUS, client_apart, cube

from obb_collision.demo.command import SCENES
from obb_collision.node.diagnostics.answer import COLLIDING, UNKNOWN
from obb_collision.node.inputs import DETECTIONS
from obb_collision.node.inputs.subscriptions import INPUTS
from obb_collision.node.parameters.entries import region_parameters, shared_inputs
from obb_collision.node.runtime.running import initial_parameters
from obb_collision.node.topics.topics import DEADLINE, TOPICS
from obb_collision.scene_files import READY

IN_NAMESPACE = ("--ros-args", "-r", f"__ns:={NAMESPACE}")


def test_another_process_manages_it_and_is_told_by_the_deadline_that_it_hangs() -> None:
    missed: list[Any] = []
    managed = (*IN_NAMESPACE, "-p", "autostart:=false")
    with running(*managed) as process, client_apart() as other:
        other.says(UNKNOWN, "unconfigured")
        assert other.change(Transition.TRANSITION_CONFIGURE)
        other.wait_inputs()
        other.send(cube(("a", 1)), cube(("a", 2), (0.5, 0, 0)))
        other.says(UNKNOWN, "inactive")
        for _ in range(2):
            assert other.change(Transition.TRANSITION_ACTIVATE)
            other.says(COLLIDING, "1 pair collides")
            assert not other.change(Transition.TRANSITION_ACTIVATE)
            assert other.change(Transition.TRANSITION_DEACTIVATE)
            other.says(UNKNOWN, "inactive")
        other.client.create_subscription(
            DiagnosticArray,
            STATUS,
            lambda _: None,
            QoSProfile(depth=1, deadline=Duration(seconds=DEADLINE)),
            event_callbacks=SubscriptionEventCallbacks(deadline=missed.append),
        )
        other.next(STATUS)
        process.send_signal(signal.SIGSTOP)
        missed.clear()
        other.until(lambda: len(missed) > 1, "deadline")
        process.send_signal(signal.SIGCONT)
        assert other.change(Transition.TRANSITION_CLEANUP)
        other.says(UNKNOWN, "unconfigured")
        assert other.change(Transition.TRANSITION_UNCONFIGURED_SHUTDOWN)
        other.says(UNKNOWN, "shutting_down")
        assert other.state() == "finalized"
        process.send_signal(signal.SIGTERM)
        output, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, output
    assert "Traceback" not in output, output
    assert "ready:" in output


SCRIPT = ("-c", "from obb_collision.commands import node; raise SystemExit(node())")
STARTS = {
    "numpy": SCRIPT,
    "numba": SCRIPT,
    "rclpy.context": SCRIPT,
    "argparse": ("-m", "obb_collision.commands"),
    "rclpy": SCRIPT,
}
"""How a node is started, by a module that is imported on the way."""


@each("module, number", zip(STARTS, cycle((signal.SIGINT, signal.SIGTERM)), strict=False))
def test_a_signal_amid_imports_ends_it_without_a_word(module: str, number: signal.Signals) -> None:
    arguments = ("-X", "importtime", *STARTS[module], *IN_NAMESPACE)
    with started(*arguments, ROS_DOMAIN_ID=str(DOMAIN)) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if line.split("|")[-1].strip() == module:
                break
        process.send_signal(number)
        rest, _ = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, rest
        assert "Traceback" not in rest
        assert "ready:" not in rest


def test_a_second_signal_ends_a_node_that_takes_long_to_be_made() -> None:
    code = """
import signal, sys, threading
from obb_collision.node.runtime.running import run_node
def make(context, ending):
    never = threading.Lock()
    never.acquire()
    signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))  # others take them
    sys.stdout.write("making\\n")
    sys.stdout.flush()
    never.acquire()  # as compiled code: no handler of Python's runs
run_node("slow", make, [])
"""
    with started("-c", code) as process:
        assert output_until(process, "making") == "making\n"
        process.send_signal(signal.SIGINT)
        process.send_signal(signal.SIGTERM)  # another one, for two of a kind may arrive as one
        assert process.wait(PATIENCE) == 0


def test_a_program_has_its_signals_back_after_a_node() -> None:
    code = """
import os, signal
from threading import Thread
import rclpy
from obb_collision.node.runtime.guard import Guard
from obb_collision.node.runtime.running import run_node

calls, codes = [], []
handler = lambda *_: calls.append("Python's")
signal.signal(signal.SIGINT, handler)
rclpy.init()  # its handlers are of C: they end its context, and call those from before

def make(context, _):
    node = rclpy.create_node("short", context=context)
    node.create_timer(0.0, lambda: end(context))
    node.guard, node.say_farewell = Guard(print, context.ok), lambda: None
    return node

end = lambda context: os.kill(os.getpid(), signal.SIGINT)
codes.append(run_node("short", make, []))
assert signal.getsignal(signal.SIGINT) is handler
end = lambda context: context.try_shutdown()
# signals are not those of a thread
thread = Thread(target=lambda: codes.append(run_node("short", make, [])))
thread.start()
thread.join()
assert rclpy.ok() and (codes, calls) == ([0, 0], []), (codes, calls)
os.kill(os.getpid(), signal.SIGINT)
while rclpy.ok() or not calls:
    pass
"""
    run_python("-c", code)


UNSUPPORTED = """
class Meta(type):
    _TYPE_SUPPORT = None

    @classmethod
    def __import_type_support__(cls):
        {fault}

class {name}(metaclass=Meta):
    pass
"""
NOT_BUILT = "from rosidl_generator_py import import_type_support; import_type_support('nothing')"
BROKEN = {
    "vision_msgs.msg": UNSUPPORTED.format(name="Detection3DArray", fault="pass"),
    "moveit_msgs.msg": "class ContactInformation: pass",
    "moveit_msgs.srv": "raise OSError('libmoveit_msgs.so: cannot open')",
    "tf2_msgs.msg": UNSUPPORTED.format(name="TFMessage", fault=NOT_BUILT),
}
"""Modules of packages that are installed and cannot be used."""


def test_broken_packages_are_said_and_signals_may_go_on_until_the_last_word(tmp_path: Path) -> None:
    for name, text in BROKEN.items():
        package, _, part = name.partition(".")
        folder = tmp_path / package / part
        folder.mkdir(parents=True)
        (folder.parent / "__init__.py").touch()  # without, one that is installed comes first
        (folder / "__init__.py").write_text(text)
    path = os.pathsep.join([str(tmp_path), environment()["PYTHONPATH"]])
    more = "-r objects:=scene -p rate:=20.0 -p fixed_frame:=odom -p robots:=['arm']"
    arguments = (*IN_NAMESPACE, *more.split(), "-p", "expect_empty:=true")
    with running(*arguments, PYTHONPATH=path) as process, client_apart() as other:
        said = output_until(process, "ready:")
        other.known("robot_unknown")
        limit = time.monotonic() + PATIENCE
        while process.poll() is None:
            assert time.monotonic() < limit
            process.send_signal(signal.SIGINT)
            with suppress(subprocess.TimeoutExpired):
                process.wait(0.002)  # as fast as no one can type, slow enough to let it end
        assert process.stdout is not None
        output = process.stdout.read()
        other.says(UNKNOWN, "shutting_down", True)
    assert process.returncode == 0, output
    assert "Traceback" not in said + output
    for word in (f"{NAMESPACE}/scene", "/collisions", "'odom'", "at 20 Hz", "/markers"):
        assert word in said
    for package in ("vision_msgs", "moveit_msgs", "tf2_msgs"):
        assert f"{package} is installed but cannot be used" in said


def test_what_is_there_at_ready_is_out_of_the_collectors_sight() -> None:
    code = """
import gc
from obb_collision.node.runtime.running import Garbage
given = gc.get_freeze_count()
Garbage.settle_more()
assert gc.get_freeze_count() == given  # not where the process is somebody else's
Garbage.settle()
before = gc.get_freeze_count()
more = [[] for _ in range(10000)]
Garbage.settle_more()
assert gc.get_freeze_count() >= before + 10000
assert len(gc.get_objects()) < 10000
"""
    run_python("-c", code)


#: Steps of 20,000 boxes, some 10 MB each: prints the page faults of three, without and with it.
STEPS = """
import resource
import numpy as np
import obb_collision as oc
from obb_collision.node.runtime.running import keep_freed_memory

oc.set_threads(1)
rng = np.random.default_rng(0)
poses = np.concatenate([30 * rng.random((20_000, 3)), rng.normal(size=(20_000, 4))], axis=1)
poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1)[:, None]
sizes = rng.uniform(0.05, 0.5, (20_000, 3))
for prepare in (lambda: None, keep_freed_memory):
    prepare()
    for step in range(6):
        if step == 3:
            before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        oc.find_pairs(oc.Boxes.from_poses(poses, sizes))
    print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="glibc's memory")
def test_a_node_keeps_what_it_frees_and_the_library_leaves_the_process_as_it_is() -> None:
    all_of_them = 3 * 10e6 / resource.getpagesize()
    without, kept = map(int, run_python("-c", STEPS).stdout.split())
    assert kept < all_of_them / 20 < without


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
