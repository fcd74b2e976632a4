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

"""The program of the safety stop stops in time, whatever happens, and drives on after it."""

from __future__ import annotations

import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from pages import ROOT, code_blocks

pytest.importorskip("rclpy")
from node_process import environment, running
from processes import PATIENCE, started
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rig import NAMESPACE, Client, client_apart, cube
from visualization_msgs.msg import Marker

from tools.fuzz.process import for_killed_processes

PAGE = ROOT / "docs" / "tutorials" / "mobile_robot_safety_stop.md"
WITHOUT_DEADLINES = """
from rclpy.event_handler import SubscriptionEventCallbacks, UnsupportedEventTypeError

create = SubscriptionEventCallbacks.create_event_handlers

def create_or_refuse(self, *given):
    if self.deadline is not None:
        raise UnsupportedEventTypeError("there are no deadlines")
    return create(self, *given)

SubscriptionEventCallbacks.create_event_handlers = create_or_refuse
"""
"""What stands in for rmw_zenoh."""
SILENCE, LIMIT, STATUS = 0.55, 0.5, 0.1
"""Seconds that the page promises: until silence is noticed, an object is stale, a status comes."""
DRIVING = ": driving"
SLACK = 1.0
"""Seconds more that a busy machine may take."""


class Program:
    """The program of the page in a process of its own, with what it has said and when."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process, self._said = process, [(0.0, "")]
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._said.append((time.monotonic(), line.strip()))

    @property
    def is_driving(self) -> bool:
        """Whether it said so last; AssertionError if it has ended."""
        assert self._process.poll() is None, self._said
        return self._said[-1][1].endswith(DRIVING)

    def stopped(self, since: float, within: float, why: str) -> bool:
        """Return whether it has stopped; AssertionError if not in time, or for another reason."""
        at, said = self._said[-1]
        if said.endswith(DRIVING):
            assert time.monotonic() - since < PATIENCE
            return False
        assert f"stopped: {why}" in said
        assert at - since < within + SLACK
        return True


@contextmanager
def program(folder: Path, name: str, head: str) -> Iterator[Program]:
    """Run the program by a name, with the crate far away and other code at its head."""
    (code,) = (block for block in code_blocks(PAGE, "python") if "rclpy" in block)
    file = folder / f"{name}.py"
    file.write_text(head + code)
    names = ("-r", f"__ns:={NAMESPACE}", "-r", f"__node:={name}")
    arguments = ("--ros-args", *names, "-p", "crate:=1000.0")
    with started(str(file), *arguments, **environment()) as process:
        yield Program(process)


@contextmanager
def collision_node(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Run a node with the parameters of the page."""
    (parameters,) = (block for block in code_blocks(PAGE, "yaml") if block.startswith("/**:"))
    file = folder / "safety.yaml"
    file.write_text(parameters)
    arguments = ("--ros-args", "-r", f"__ns:={NAMESPACE}", "--params-file", str(file))
    with running(*arguments) as process:
        yield process


@pytest.fixture
def client(tmp_path: Path) -> Iterator[Client]:
    with for_killed_processes(tmp_path), client_apart() as found:
        yield found


def test_it_stops_each_time_within_what_the_page_says(tmp_path: Path, client: Client) -> None:
    """Two at once: one that a missed deadline is said to, and one where there is no such thing."""

    def set_radius(radius: float) -> None:
        parameter = Parameter("effects.clearance_max_distance", value=radius).to_parameter_msg()
        request = SetParameters.Request(parameters=[parameter])
        client.call(SetParameters, "obb_collision/set_parameters", request)

    def delete(name: str) -> None:
        client.send(Marker(ns=name, action=Marker.DELETE))

    with program(tmp_path, "deadline", "") as first:
        vehicles = [first]

        def stops(within: float, why: str) -> None:
            since = time.monotonic()
            for vehicle in vehicles:
                client.until(lambda v=vehicle: v.stopped(since, within, why), why)  # type: ignore[misc]

        def drives() -> None:
            client.until(lambda: all(vehicle.is_driving for vehicle in vehicles), "driving")

        with (
            program(tmp_path, "no_deadline", WITHOUT_DEADLINES) as second,
            collision_node(tmp_path) as node,
        ):
            vehicles.append(second)
            client.until(client.pubs["objects"].get_subscription_count, "match")
            drives()
            client.send(cube(("dog", 0), (500.0, 0.9, 0.0), (2000.0, 0.1, 1.0)))
            stops(STATUS, "something is near")
            delete("dog")
            drives()
            client.send(cube(("person", 0), (0.0, 50.0, 0.0)))  # and nothing more of it
            stops(LIMIT + STATUS, "stale")
            delete("person")
            drives()
            set_radius(0.2)
            stops(STATUS, "clearances end at 0.2 m")
            set_radius(1.0)
            drives()
            node.send_signal(signal.SIGSTOP)
            stops(SILENCE, "no c")
            node.send_signal(signal.SIGCONT)
            drives()
            node.kill()
            stops(SILENCE, "no c")
            vehicles.remove(second)
        client.listen("collision_status")
        with collision_node(tmp_path):  # which knows nothing: it is sent the objects again
            drives()
            (status,) = client.next("collision_status").status
    values = {pair.key: pair.value for pair in status.values}
    assert (status.level, values["objects"]) == (status.OK, "2")
