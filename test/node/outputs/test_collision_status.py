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

"""What is known of collisions: free, colliding, or not known and why."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

pytest.importorskip("rclpy")
from objects_rig import SECOND
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rig import OUTPUTS, Rig, cube, pose
from std_msgs.msg import Bool
from std_srvs.srv import SetBool

from obb_collision.node.diagnostics.answer import COLLIDING, FREE, UNKNOWN
from obb_collision.node.messages.conversions import stamp_from_ros
from obb_collision.node.node import CollisionNode
from obb_collision.node.runtime.warm_up import WarmUp

A1, A2, B1 = ("a", 1), ("a", 2), ("b", 1)
PAIR = (cube(A1), cube(A2, (0.5, 0, 0)))
STATUS = "collision_status"


@contextmanager
def listening(**options: Any) -> Iterator[Rig]:
    """Yield a rig that listens to the status, and runs slowly enough for a loaded machine."""
    with Rig(given={"cycle_timeout": 30.0} | options.pop("given", {}), **options) as rig:
        rig.listen(STATUS)
        yield rig


def said(rig: Rig) -> tuple[bytes, str]:
    """Level and codes of the last status."""
    if STATUS not in rig.last:
        return b"", ""
    (status,) = rig.last[STATUS].status
    return status.level, " ".join(p.value for p in status.values if p.key == "reasons")


def wait(rig: Rig, level: bytes, code: str = "", flag: bool | None = None) -> dict[str, str]:
    """Wait for a level, the code of a reason and a flag; returns the values by key."""
    rig.until(lambda: said(rig)[0] == level and code in said(rig)[1], f"{level!r} {code}")
    if flag is not None:
        rig.until(lambda: rig.last["in_collision"].data is flag, f"flag {flag}")
    (status,) = rig.last[STATUS].status
    return {pair.key: pair.value for pair in status.values}


def test_free_and_colliding_are_told_with_stamp_and_age() -> None:
    with listening() as rig:
        rig.send(cube(A1), cube(A2, (3, 0, 0)))
        rig.answer()
        before = rig.now()
        rig.until(lambda: wait(rig, FREE, flag=False)["objects"] == "2", "both")
        values = wait(rig, FREE, flag=False)
        assert stamp_from_ros(rig.last[STATUS].header.stamp) >= before - SECOND
        assert values["objects"] == "2"
        assert values["colliding pairs"] == "0"
        age = (rig.now() - rig.stamp) / SECOND
        assert float(values["age of the newest state (s)"]) == pytest.approx(age, abs=60.0)
        rig.send_transform("a/2", pose(0.5))
        values = wait(rig, COLLIDING, flag=True)
        assert values["colliding pairs"] == "1"


def test_the_radius_of_clearances_holds_for_all_pairs_or_is_said_of_selected_objects_only() -> None:
    radii = "clearance radius (m)", "clearance radius of selected objects (m)"
    with listening(given={"effects.clearance_max_distance": 0.7}) as rig:
        rig.send(cube(A1), cube(A2, (1.5, 0, 0)), cube(B1, (3, 0, 0)))
        rig.answer()
        for objects, radius in ((["*"], "0.7"), (["b/*"], "0.0"), (["b/*", "*"], "0.7")):
            rig.set(**{"effects.clearance_objects": objects})

            def is_said(radius: str = radius) -> bool:
                return [wait(rig, FREE)[key] for key in radii] == [radius, "0.7"]

            rig.until(is_said, f"{objects}")
        rig.set(**{"effects.clearance": "off"})
        rig.until(lambda: not wait(rig, FREE).keys() & set(radii), "no radius")


def test_diagnostics_never_count_collisions_of_objects_that_are_gone(rig: Rig) -> None:
    rig.listen("/diagnostics")
    rig.send(*PAIR)
    rig.answer()
    cycle = rig.node.cycle
    rig.until(lambda: rig.status(": objects")["colliding"] == "2", "colliding")
    report = cycle.report
    cycle.enabled = False
    rig.node.objects.clear()
    cycle.report = report
    status = rig.status(": objects")
    assert (status["count"], status["colliding"]) == ("0", "0")


def test_with_unknown_is_collision_off_the_flag_tells_of_collisions_only() -> None:
    with listening(unknown_is_collision=False) as rig:
        rig.send(*PAIR)
        rig.answer()
        wait(rig, COLLIDING, flag=True)
        rig.call(SetBool, "obb_collision/enable", SetBool.Request(data=False))
        wait(rig, UNKNOWN, "disabled", False)
        rig.set(unknown_is_collision=True)
        wait(rig, UNKNOWN, "disabled", True)


def test_a_cycle_that_does_not_end_is_told_by_another_thread(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with Rig(cycle_timeout=0.1) as rig:
        rig.listen(STATUS)
        rig.send(cube(A1))
        rig.answer()
        wait(rig, FREE, flag=False)
        publisher = rig.publisher(STATUS)
        publish, told = publisher.publish, threading.Event()

        def noted(message: Any) -> None:
            publish(message)
            if "blocked" in message.status[0].message:
                told.set()

        monkeypatch.setattr(publisher, "publish", noted)
        update = rig.node.objects.update
        blocked: list[bool] = []

        def block(now: int) -> None:
            update(now)
            if not blocked:
                blocked.append(told.wait(30.0))

        monkeypatch.setattr(rig.node.objects, "update", block)
        rig.until(lambda: blocked, "a blocked cycle")
        assert blocked == [True], "told while it was blocked"
        wait(rig, FREE, flag=False)


def test_before_the_first_check_nothing_is_known() -> None:
    with Rig() as rig:
        status: list[Any] = []
        flags: list[Any] = []
        qos = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        rig.client.create_subscription(
            OUTPUTS[STATUS].message, f"/cell/{STATUS}", status.append, qos
        )
        rig.client.create_subscription(Bool, "/cell/in_collision", flags.append, qos)
        empty = [Parameter("expect_empty", value=True)]
        other = CollisionNode(context=rig.context, namespace="cell", parameter_overrides=empty)
        try:
            rig.until(lambda: status and flags, "status of a node that nobody spins")
            assert (status[0].status[0].level, flags[0].data) == (UNKNOWN, True)
            assert {message.status[0].message for message in status} == {"starting"}
            rig.executor.add_node(other)
            rig.until(lambda: status[-1].status[0].level == FREE, "first check")
        finally:
            rig.executor.remove_node(other)
            other.destroy_node()


def test_a_start_that_compiles_says_so_in_the_status(monkeypatch: pytest.MonkeyPatch) -> None:
    with Rig() as rig:
        status: list[Any] = []
        qos = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        topic, kind = f"/cell/{STATUS}", OUTPUTS[STATUS].message
        rig.client.create_subscription(kind, topic, status.append, qos)
        start = WarmUp.start

        def compiling(warm: WarmUp, things: Any, report: Callable[[str], None]) -> None:
            report("compiling: 3 kernels")
            reason = "starting, compiling: 3 kernels"
            rig.until(lambda: status and status[-1].status[0].message == reason, "the reason")
            assert {message.status[0].level for message in status} == {UNKNOWN}
            start(warm, things, report)

        monkeypatch.setattr(WarmUp, "start", compiling)
        CollisionNode(context=rig.context, namespace="cell").destroy_node()
        assert status


def test_a_stop_of_input_is_stale_while_the_clock_of_the_simulation_stands_still() -> None:
    with listening(given={"input_timeout": 0.4, "use_sim_time": True}) as rig:
        rig.send(cube(A1), cube(A2, (3, 0, 0)), stamped=False)
        wait(rig, UNKNOWN, "input_silent", True)
        assert rig.now() == 0, "no message of /clock"

        def heard() -> bool:
            rig.send_transform("a/1", pose(0))
            return said(rig)[0] == FREE

        rig.until(heard, "free")
        wait(rig, UNKNOWN, "input_silent", True)
