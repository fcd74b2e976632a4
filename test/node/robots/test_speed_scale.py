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

pytest.importorskip("rclpy")
pytest.importorskip("lxml")
from rig import cube, pose
from robot_rig import URDF, RobotRig, box
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


@pytest.mark.parametrize("velocity", [1e300, 1e301, float("nan"), float("inf")])
def test_the_scale_is_zero_while_a_velocity_cannot_be_used(velocity: float) -> None:
    with SpeedRig(speed_reaction_time=0.5) as rig:
        rig.start()
        rig.send_joints({"turn": velocity}, lift=0.0, turn=0.0)
        assert rig.scale() == 0.0
        rig.send_joints({"turn": 0.0}, lift=0.0, turn=0.0)
        assert rig.scale() == pytest.approx(0.5, abs=1e-6)


def test_the_scale_is_zero_where_links_collide() -> None:
    with SpeedRig() as rig:
        rig.start_robot(URDF.replace("</link>", f"{box(0.9)}</link>", 1), lift=-0.5)
        assert rig.scale() == 0.0


def test_slow_is_beyond_stop() -> None:
    with SpeedRig() as rig:
        (result,) = rig.set(speed_stop_distance=2.0)
        assert not result.successful
        assert "must exceed" in result.reason
