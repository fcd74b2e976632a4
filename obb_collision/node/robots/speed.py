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

"""How fast a robot may move: ``speed_scale``, 1 far from everything, 0 near or not known.

Separation monitoring, and not a certified safety function.
"""

from __future__ import annotations

import numpy as np
from rclpy.publisher import Publisher
from std_msgs.msg import Float64

from obb_collision.node.objects.objects import Objects
from obb_collision.node.parameters.parameters import Parameters
from obb_collision.node.robots.checked_robot import CheckedRobot
from obb_collision.node.robots.robot_input import RobotInput


class SpeedScale:
    """Publishes the scale of one robot, while somebody subscribes."""

    def __init__(
        self,
        robot: RobotInput,
        checked: CheckedRobot,
        objects: Objects,
        publisher: Publisher,
        parameters: Parameters,
    ) -> None:
        self._robot, self._checked, self._objects = robot, checked, objects
        self._publisher, self._parameters = publisher, parameters

    def publish(self) -> None:
        """Publish the scale as things are now; 0 also where it cannot be computed."""
        if self._publisher.get_subscription_count() == 0:
            return
        scale = 0.0
        try:
            scale = self._scale()
        except ValueError:  # RefusedError, too: not known, and the status says why
            pass
        finally:
            self._publisher.publish(Float64(data=scale))

    def _scale(self) -> float:
        """Return 1 beyond the slow distance, and 0 within the stop distance.

        Both are more by how far the fastest point of the robot and of an object may have come
        nearer to each other within the reaction time.
        """
        parameters, robot = self._parameters, self._robot
        scene = self._checked.scene()
        assert robot.joints is not None
        assert robot.links is not None
        if robot.joints.unclear.any() or not robot.links.are_speeds_known:
            return 0.0
        stop, slow = parameters.speed_stop_distance, parameters.speed_slow_distance
        come = self._closing_speed() * parameters.speed_reaction_time
        if not np.isfinite(come):
            return 0.0
        state = robot.joints.positions[None]
        if not scene.check(state).valid[0]:  # links against each other, and limits, too
            return 0.0
        found = scene.distances(state, max_distance=slow + come, self_pairs=False)
        room = float(found.distances[0]) - come - stop
        return float(np.clip(room / (slow - stop), 0.0, 1.0))

    def _closing_speed(self) -> float:
        """Return at least how fast any point of the robot and any object near each other (m/s)."""
        assert self._robot.links is not None
        table = self._objects.table
        own = np.concatenate([self._robot.links.slots, self._robot.attached.slots])
        others = table.moving & table.visible
        others[own] = False
        speeds = [
            float(self._objects.scene.speeds_of(slots, table.twist[slots]).max(initial=0.0))
            for slots in (own, np.flatnonzero(others))
        ]
        return sum(speeds)
