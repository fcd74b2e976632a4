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

from obb_collision.node.diagnostics.answer import some
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.objects.objects import Objects
from obb_collision.node.parameters.parameters import Parameters
from obb_collision.node.robots.checked_robot import CheckedRobot
from obb_collision.node.robots.robot_input import RobotInput
from obb_collision.node.runtime.guard import INTERNAL_ERROR
from obb_collision.robots.checks.robot_scene import RobotScene


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
        """Publish the scale as things are now, and tell the robot why it is 0."""
        self._robot.halt = ""
        if self._publisher.get_subscription_count() == 0:
            return
        scale, why = 0.0, INTERNAL_ERROR
        try:
            scale, why = self._scale(), "within the stop distance"
        except ValueError as error:  # RefusedError, too: not known
            why = error.reason if isinstance(error, RefusedError) else str(error)
        finally:
            self._robot.halt = "" if scale > 0.0 else why
            self._publisher.publish(Float64(data=scale))

    def _scale(self) -> float:
        """Return 1 beyond the slow distance, and 0 within the stop distance.

        Both are more by how far the fastest point of the robot and of an object may have come
        nearer to each other within the reaction time. RefusedError where it is 0 for another
        reason.
        """
        parameters, robot = self._parameters, self._robot
        scene = self._checked.scene()
        assert robot.joints is not None
        stop, slow = parameters.speed_stop_distance, parameters.speed_slow_distance
        with np.errstate(over="ignore"):
            come = self._closing_speed(scene) * parameters.speed_reaction_time
        if not np.isfinite(come):
            raise RefusedError("speeds are too large")
        state = robot.joints.positions[None]
        report = scene.check(state)  # links against each other, and limits, too
        if not report.valid[0]:
            raise RefusedError(
                "it collides" if report.colliding[0] else "a joint out of its limits"
            )
        found = scene.distances(state, max_distance=slow + come, self_pairs=False)
        room = float(found.distances[0]) - come - stop
        return float(np.clip(room / (slow - stop), 0.0, 1.0))

    def _own_speed(self, scene: RobotScene) -> float:
        """Return at least how fast a point of the robot is by joints of unknown velocity (m/s)."""
        joints = self._robot.joints
        assert joints is not None
        if not joints.unclear.any():
            return 0.0
        most = np.where(joints.unclear, joints.speed_limits, 0.0)
        if not np.isfinite(most).all():
            names = [joints.names[row] for row in np.flatnonzero(np.isinf(most))]
            who = some(names, len(names))
            raise RefusedError(f"no velocity, and no limit of it, is known of joints: {who}")
        return float(scene.displacements(joints.positions[None], most[None])[0])

    def _closing_speed(self, scene: RobotScene) -> float:
        """Return at least how fast any point of the robot and any object near each other (m/s)."""
        assert self._robot.links is not None
        if not self._robot.links.are_speeds_known:
            raise RefusedError("speeds are too large")
        table = self._objects.table
        own = np.concatenate([self._robot.links.slots, self._robot.attached.slots])
        others = table.moving & table.visible
        others[own] = False
        speeds = [
            float(self._objects.scene.speeds_of(slots, table.twist[slots]).max(initial=0.0))
            for slots in (own, np.flatnonzero(others))
        ]
        return sum(speeds) + self._own_speed(scene)
