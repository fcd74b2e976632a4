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

"""``obb_collision status`` beside a node on real topics: its screen, JSON and exit codes."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from each import each
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rig import DOMAIN, NAMESPACE, Rig, cube, sync

from obb_collision import commands
from obb_collision.demo import status as module
from obb_collision.node.runtime import environment

NODE = f"{NAMESPACE}/obb_collision"


@pytest.fixture(autouse=True)
def same_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))


@contextmanager
def spinning(rig: Rig) -> Iterator[None]:
    """Spin a rig in a thread: what spins is not destroyed meanwhile."""
    done = Event()

    def run() -> None:
        while not done.is_set():
            rig.executor.spin_once(timeout_sec=0.05)

    thread = Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def test_levels_are_exit_codes_the_screen_says_why_and_json_has_all_values(
    rig: Rig, capsys: pytest.CaptureFixture[str]
) -> None:
    with spinning(rig):
        assert commands.status(["--node", NODE[1:], "--timeout", "60"]) == 3
    assert capsys.readouterr().out.startswith(f"{NODE}: STALE, no_objects\n")
    sync(rig)
    with spinning(rig):
        code = commands.status(["--json", "--timeout", "60"])
    nodes = json.loads(capsys.readouterr().out)
    found = nodes[NODE]  # without its name
    assert code == 0 or len(nodes) > 1  # others may test on this machine
    assert (found["level"], found["values"]["reason"]) == ("OK", "")
    assert found["parts"]["objects"]["count"] == "1"
    assert "cycle mean (ms)" in found["parts"]["cycle"]
    rig.send(cube(("box", 1)), cube(("box", 2), (0.5, 0.0, 0.0)))
    assert sync(rig)
    with spinning(rig):
        assert commands.status(["--node", NODE, "--timeout", "60"]) == 1
    text = capsys.readouterr().out
    assert text.startswith(f"{NODE}: ERROR\n  1 pair collides")
    for word in ("objects 3", "  objects: 3 objects; count 3; colliding 2", "  cycle: ", "input "):
        assert word in text


def test_nobody_heard_is_four(capsys: pytest.CaptureFixture[str]) -> None:
    assert commands.status(["--node", "/nobody", "--timeout", "0.2"]) == 4
    assert "/nobody was not heard within 0.2 s" in capsys.readouterr().err


def test_a_ros_that_is_not_sourced_is_used_and_without_one_it_is_said_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(module, "INSTALLED", tmp_path)
    for target in (module, environment):
        monkeypatch.setattr(target, "find_spec", lambda name: None)
    assert commands.status([]) == 4
    assert "needs rclpy and common_interfaces: source a ROS 2" in capfd.readouterr().err
    setup = tmp_path / "jazzy" / "setup.bash"
    setup.parent.mkdir()
    setup.write_text("echo sourced")
    assert commands.status(["--node", "/nobody", "--timeout", "0.2"]) == 4
    output, errors = capfd.readouterr()
    assert output == "sourced\n"
    assert f"by {setup.parent}, which is not sourced" in errors
    assert "/nobody was not heard within 0.2 s" in errors


@each("count", [0, 2])
def test_messages_of_strangers_are_unreadable(
    rig: Rig, capsys: pytest.CaptureFixture[str], count: int
) -> None:
    stranger = Node("stranger", context=rig.context)
    try:
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        publisher = stranger.create_publisher(DiagnosticArray, "/alien/collision_status", latched)
        publisher.publish(DiagnosticArray(status=[DiagnosticStatus(level=b"\0")] * count))
        assert commands.status(["--node", "/stranger", "--timeout", "60"]) == 3
    finally:
        stranger.destroy_node()
    assert capsys.readouterr().out.startswith("/stranger: STALE, unreadable\n")
