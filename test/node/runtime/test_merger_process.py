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

from obb_collision.node.diagnostics.answer import COLLIDING, FREE, UNKNOWN
from obb_collision.node.merger import values_of
from obb_collision.node.messages.clouds import cloud_to_ros
from obb_collision.node.topics.topics import COLLISIONS, TOPICS

STATUS = TOPICS["collision_status"]
COMMAND = ("-m", "obb_collision.node.merger", "--ros-args", "-r", f"__ns:={NAMESPACE}/merged")
REGIONS = ("-p", f"regions:=['{NAMESPACE}/west']", "-p", "timeout:=0.5")


def status(objects: str, level: bytes = FREE, **more: str) -> DiagnosticArray:
    """Return what the node of a region says; more: further values."""
    pairs = {"objects": objects, "clearance radius (m)": "0.1"} | more
    values = [KeyValue(key=key, value=value) for key, value in pairs.items()]
    return DiagnosticArray(status=[DiagnosticStatus(level=level, values=values)])


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
    rows_sent = True
    process = subprocess.Popen(
        [sys.executable, *COMMAND, *REGIONS],
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )

    def heard(level: bytes, reason: str, who: str, sent: DiagnosticArray | None) -> bool:
        assert process.poll() is None, process.communicate()[0]
        if sent is not None:
            told.publish(sent)
        if rows_sent:
            rows.publish(cloud_to_ros(np.zeros(0, COLLISIONS.dtype), client.header()))
        if not said:
            return False
        values = values_of(said[-1])
        return (said[-1].level, values["reason"], values["who"]) == (level, reason, who)

    try:
        with limited(process):
            west, silent = f"{NAMESPACE}/west", f"{NAMESPACE}/west (silent)"
            for bad in (status("9" * 10_000), DiagnosticArray()):
                client.until(partial(heard, FREE, "", "", status("3")), "free")
                client.until(partial(heard, UNKNOWN, "region_silent", silent, bad), "silence")
            given = {"reason": "refused", "reasons": "refused stale", "who": "a/1"}
            sent = status("3", UNKNOWN, **given)
            client.until(partial(heard, UNKNOWN, "refused", f"{west} (a/1)", sent), "its reason")
            assert values_of(said[-1])["reasons"] == "refused stale"
            sent = status("3", COLLIDING, **given)
            client.until(partial(heard, COLLIDING, "refused", f"{west} (a/1)", sent), "both")
            assert values_of(said[-1])["clearance radius (m)"] == "0.1"
            client.until(partial(heard, COLLIDING, "region_silent", silent, None), "its collision")
            back = f"{west} (back)"  # it says that it is free, and is not believed at once
            client.until(partial(heard, UNKNOWN, "region_silent", back, status("3")), "an end")
            client.until(partial(heard, FREE, "", "", status("3")), "free again")
            rows_sent = False  # and so there is no stamp that all have evaluated
            client.until(partial(heard, UNKNOWN, "region_unmatched", "", status("3")), "no rows")
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
