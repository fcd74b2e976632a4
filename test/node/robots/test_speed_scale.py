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

"""The scale of speed: 1 far, 0 near and while anything is not known."""

from __future__ import annotations

from typing import Any

import pytest
from each import each
from rig import cube, pose
from robot_rig import URDF, RobotRig, box
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

CRATE = ("crate", 1)


class SpeedRig(RobotRig):
    """A rig that listens to the scale."""

    def __init__(self, **given: Any) -> None:
        limits = {"speed_stop_distance": 0.1, "speed_slow_distance": 1.1}
        super().__init__(limits | {"speed_reaction_time": 0.0} | given)
        self.scales: list[float] = []
        self.client.create_subscription(Float64, "arm/speed_scale", self._take, 10)

    def _take(self, message: Float64) -> None:
        self.scales.append(message.data)

    def scale(self) -> float:
        """Return the scale after the answer to all that was sent."""
        self.answer()
        self.scales.clear()
        self.until(lambda: len(self.scales) > 1, "a scale")
        return self.scales[-1]

    def start(self) -> None:
        """Start the robot, with a crate 0.6 m above the hand."""
        self.start_robot()
        self.send(cube(CRATE, (1.0, 0.0, 1.25), (0.1, 0.1, 0.1)))


def test_the_scale_falls_with_the_distance() -> None:
    with SpeedRig() as rig:
        rig.start()
        assert rig.scale() == pytest.approx(0.5, abs=1e-6)
        rig.send_joints(lift=0.25, turn=0.0)
        assert rig.scale() == pytest.approx(0.25, abs=1e-6)
        rig.send_joints(lift=0.52, turn=0.0)
        assert rig.scale() == 0.0
        rig.send_joints(lift=0.0, turn=3.0)
        assert rig.scale() == 1.0


def test_the_scale_falls_with_speeds() -> None:
    with SpeedRig(speed_reaction_time=0.5) as rig:
        rig.start()
        rig.send_joints({"lift": 0.4}, lift=0.0, turn=0.0)
        assert rig.scale() == pytest.approx(0.3, abs=1e-4)
        rig.send_states(["crate/1"], [pose(1.0, 0.0, 1.25)], twists=[[0.2, 0, 0, 0, 0, 0]])
        assert rig.scale() == pytest.approx(0.2, abs=1e-4)


def test_the_scale_is_zero_while_anything_is_not_known() -> None:
    with SpeedRig() as rig:
        rig.until(lambda: len(rig.scales) > 1, "a scale")
        assert set(rig.scales) == {0.0}
        rig.start()
        assert rig.scale() > 0.0
        rig.send_joints(lift=float("nan"))
        rig.until(lambda: rig.scales[-1] == 0.0, "a stop")


NAN, INF = float("nan"), float("inf")


def send(rig: SpeedRig, lift: float, velocity: tuple[float, ...] = ()) -> None:
    """Send joint states, with the velocities or without any."""
    message = JointState(header=rig.header(), name=["lift", "turn"], position=[lift, 0.0])
    message.velocity = list(velocity)
    rig.joint_states.publish(message)


@each("velocity", [(), (NAN, NAN), (NAN, 0.0), (1e301, 0.0), (INF, 0.0)])
def test_where_no_velocity_can_be_used_it_is_that_between_the_last_two_states(
    velocity: tuple[float, ...],
) -> None:
    with SpeedRig(speed_reaction_time=0.5) as rig:
        rig.start()
        send(rig, -4e-4, velocity)
        send(rig, 0.0, velocity)  # a millisecond later
        assert rig.scale() == pytest.approx(0.3, abs=1e-4)
        rig.stamp -= 1_000_000
        send(rig, 0.0, velocity)  # with the same stamp
        assert rig.scale() == pytest.approx(0.3, abs=1e-4)
        send(rig, 0.0, velocity)
        assert rig.scale() == pytest.approx(0.5, abs=1e-4)


def test_the_scale_is_zero_where_speeds_are_too_large() -> None:
    with SpeedRig(speed_reaction_time=0.5) as rig:
        rig.start()
        send(rig, 0.0, (1e300, 0.0))
        assert rig.scale() == 0.0
        assert rig.node.guard.total == 0
        send(rig, 0.0)
        assert rig.scale() == pytest.approx(0.5, abs=1e-6)


@each("limit, scale", [("0.4", 0.3), ("0", 0.0)])
def test_with_one_state_alone_a_joint_is_as_fast_as_it_can_be(limit: str, scale: float) -> None:
    urdf = URDF.replace('upper="3"', f'upper="3" velocity="{limit}"', 1)
    with SpeedRig(speed_reaction_time=0.5) as rig:
        rig.send(cube(CRATE, (1.0, 0.0, 1.25), (0.1, 0.1, 0.1)))
        rig.describe(urdf)
        rig.until(lambda: rig.robot.fault[:5] == "joint", "the robot")
        send(rig, 0.0, (NAN, 0.0))
        assert rig.scale() == pytest.approx(scale, abs=1e-6)
        why = "no velocity, and no limit of it, is known of joints: lift"
        rig.listen("/diagnostics")
        text = "" if scale else f"robot arm: speed_scale is 0: {why}"
        rig.until(lambda: rig.known()["message"] == f"free{text and '; '}{text}", "the reason")
        rig.until(lambda: rig.status("robot arm").get("speed_scale is 0", "") == why * (not scale))


def test_of_some_joints_of_unknown_velocity_no_two_cancel_out() -> None:
    """Two joints about opposite axes, at most 1 rad/s each: the hand is as fast as both."""
    urdf = URDF.replace('upper="3"', 'upper="3" velocity="1"').replace("prismatic", "revolute")
    with SpeedRig(speed_reaction_time=0.1, speed_slow_distance=2.1) as rig:
        rig.send(cube(CRATE, (1.0, 0.0, 1.25), (0.1, 0.1, 0.1)))
        for axis in ("0 0 1", "0 0 -1"):
            rig.describe(urdf.replace('xyz="0 0 1"', f'xyz="{axis}"', 1))
            rig.until(lambda: rig.robot.fault[:5] == "joint", "the robot")
            send(rig, 0.0, (NAN, NAN))
            assert 0.0 < rig.scale() <= (0.6 - 0.1 - 0.1 * 2 * 1.1) / 2.0


def test_the_scale_is_zero_where_links_collide() -> None:
    with SpeedRig() as rig:
        rig.start_robot(URDF.replace("</link>", f"{box(0.9)}</link>", 1), lift=-0.5)
        assert rig.scale() == 0.0


def test_slow_is_beyond_stop() -> None:
    with SpeedRig() as rig:
        (result,) = rig.set(speed_stop_distance=2.0)
        assert not result.successful
        assert "must exceed" in result.reason
