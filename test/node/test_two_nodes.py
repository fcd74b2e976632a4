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

"""Two nodes in a process, one of which changes its state."""

from __future__ import annotations

import threading
from typing import Any

import pytest

pytest.importorskip("rclpy")
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from lifecycle_rig import (
    A2,
    ACTIVATE,
    CLEANUP,
    CONFIGURE,
    DEACTIVATE,
    NAMED,
    PAIR,
    STATUS,
    managed,
    said,
)
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rig import NAMESPACE, Rig, cube
from std_msgs.msg import Bool

from obb_collision.node.diagnostics.answer import FREE, UNKNOWN
from obb_collision.node.node import CollisionNode


def test_of_two_nodes_in_a_process_one_is_deactivated_and_the_other_goes_on(rig: Rig) -> None:
    other = CollisionNode(
        context=rig.context,
        namespace=f"{NAMESPACE}/cell",
        cli_args=["--ros-args", "-r", f"{NAMESPACE}/cell/objects:={NAMESPACE}/objects"],
        parameter_overrides=[Parameter("expect_empty", value=True)],
    )
    flags: list[Any] = []
    latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    rig.client.create_subscription(Bool, "cell/in_collision", flags.append, latched)
    rig.listen(STATUS)
    try:
        rig.executor.add_node(other)
        rig.until(lambda: rig.pubs["objects"].get_subscription_count() == 2, "both")
        rig.send(*PAIR)
        assert rig.pairs() == NAMED
        rig.until(lambda: flags and flags[-1].data is True, "the other collides")
        assert rig.change(DEACTIVATE)
        said(rig, UNKNOWN, "inactive", True)
        assert other.cycle.active
        rig.send(cube(A2, (3, 0, 0)))
        rig.until(lambda: flags[-1].data is False, "the other is free again")
        request = ChangeState.Request(transition=Transition(id=DEACTIVATE))
        name = "cell/obb_collision/change_state"
        assert rig.call(ChangeState, name, request).success
        rig.until(lambda: flags[-1].data is True, "the other is not known")
        assert rig.change(ACTIVATE)
        said(rig, FREE, "free", False)
        assert flags[-1].data is True
    finally:
        rig.executor.remove_node(other)
        other.destroy_node()


def test_two_nodes_on_threads_of_a_process_check_while_one_of_them_changes_its_state() -> None:
    """They share the caches of kernels and the threads that check, and nothing else."""
    with managed(CONFIGURE, ACTIVATE) as rig:
        rig.wait_inputs()
        other = CollisionNode(
            context=rig.context,
            namespace=f"{NAMESPACE}/cell",
            cli_args=["--ros-args", "-r", f"{NAMESPACE}/cell/objects:={NAMESPACE}/objects"],
        )
        executor = SingleThreadedExecutor(context=rig.context)
        executor.add_node(other)
        thread = threading.Thread(target=executor.spin)
        thread.start()
        try:
            rig.until(lambda: rig.pubs["objects"].get_subscription_count() == 2, "both")
            boxes = [cube(("b", number), (0.75 * number, 0, 0)) for number in range(300)]
            for turn in range(3):
                boxes[0].pose.position.y = float(5 * (turn % 2))
                expected = 299 - turn % 2
                rig.send(*boxes)
                assert len(rig.pairs()) == expected
                for transition in (DEACTIVATE, CLEANUP, CONFIGURE, ACTIVATE):
                    assert rig.change(transition)

                def has_them(expected: int = expected) -> bool:
                    return len(other.cycle.report or ()) == expected

                rig.until(has_them, "the other's pairs")
                assert not other.status.answer.reasons
                rig.wait_inputs()
            assert other.guard.total == rig.node.guard.total == 0
        finally:
            executor.shutdown()
            thread.join()
            other.destroy_node()
