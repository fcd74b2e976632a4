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

"""The merger in a process of its own: it outlives bad messages, and says that it ends."""

from __future__ import annotations

import signal
import subprocess
import sys
from functools import partial

import numpy as np
import pytest

pytest.importorskip("rclpy")
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from node_process import environment
from processes import PATIENCE, limited
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rig import DOMAIN, LATCHED, NAMESPACE, Client
from sensor_msgs.msg import PointCloud2

from obb_collision.node.diagnostics.answer import FREE, UNKNOWN
from obb_collision.node.messages.clouds import cloud_to_ros
from obb_collision.node.topics.topics import COLLISIONS, TOPICS

STATUS = TOPICS["collision_status"]
COMMAND = ("-m", "obb_collision.node.merger", "--ros-args", "-r", f"__ns:={NAMESPACE}/merged")
REGIONS = ("-p", f"regions:=['{NAMESPACE}/west']", "-p", "timeout:=0.5")


def status(objects: str, message: str = "free") -> DiagnosticArray:
    """Return what the node of a region says."""
    values = [KeyValue(key="objects", value=objects)]
    return DiagnosticArray(status=[DiagnosticStatus(message=message, values=values)])


def test_bad_messages_do_not_end_the_merger_and_its_last_word_is_that_nothing_is_known() -> None:
    context = Context()
    context.init(domain_id=DOMAIN)
    executor = SingleThreadedExecutor(context=context)
    client = Client(context, executor)
    client.patience = PATIENCE
    told = client.client.create_publisher(DiagnosticArray, "west/collision_status", STATUS.qos)
    rows = client.client.create_publisher(PointCloud2, "west/collisions", 10)
    said: list[DiagnosticStatus] = []

    def take(message: DiagnosticArray) -> None:
        said.append(message.status[0])

    client.client.create_subscription(DiagnosticArray, "merged/collision_status", take, LATCHED)
    process = subprocess.Popen(
        [sys.executable, *COMMAND, *REGIONS],
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )

    def heard(level: bytes, text: str, sent: DiagnosticArray) -> bool:
        assert process.poll() is None, process.communicate()[0]
        told.publish(sent)
        rows.publish(cloud_to_ros(np.zeros(0, COLLISIONS.dtype), client.header()))
        return bool(said) and said[-1].level == level and text in said[-1].message

    try:
        with limited(process):
            for bad in (status("9" * 10_000), DiagnosticArray()):
                client.until(partial(heard, FREE, "free", status("3")), "free")
                client.until(partial(heard, UNKNOWN, "silent for", bad), "no sign of life")
            process.send_signal(signal.SIGTERM)
            output, _ = process.communicate(timeout=PATIENCE)
            assert process.returncode == 0, output
            client.until(lambda: said[-1].message == "shutting down", "the last word")
            assert said[-1].level == UNKNOWN
            assert "internal error" in output
    finally:
        executor.shutdown()
        client.client.destroy_node()
        context.try_shutdown()
