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

Separation monitoring, and not a certified safety function. By distance it falls with the least
distance, whatever moves. By direction it is the largest s at which the robot can still stop: the
joints go on in their direction at s times their limits for the reaction time, and then brake.
"""

from __future__ import annotations

from time import monotonic
from typing import Any, NamedTuple

import numpy as np
from rclpy.publisher import Publisher
from std_msgs.msg import Float64

from obb_collision.node.diagnostics.answer import first_names
from obb_collision.node.messages.conversions import NANOSECONDS
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.optional import optional
from obb_collision.node.objects.states import State
from obb_collision.node.robots.checked_robot import CheckedRobot, NodeRobotScene
from obb_collision.node.robots.joints import Joints
from obb_collision.node.robots.trajectories import BAD_POINT, trajectory_from_bytes
from obb_collision.node.runtime.guard import INTERNAL_ERROR
from obb_collision.robots.robot_scene import RobotScene
from obb_collision.typing import Floats, Mask, Rows

SpeedScalingFactor: Any = optional("control_msgs.msg", "SpeedScalingFactor")
"""None where control_msgs cannot be used."""
SPEED_SCALING_FACTOR = "speed_scaling_factor"
STANDING = 1.0
"""Seconds after which an object that has not moved stands still."""
RESTING = 0.01
"""Share of their limits up to which joints count as resting: encoders give such speeds at rest."""
TOO_FAST = 2.0
"""Multiple of their limits above which velocities of joints are not believed."""
JOG_TIME = 0.2
"""Seconds for which a commanded jog counts."""
NEARER = 1e-6
"""Metres by which distances may be rounded."""


class Standstill:
    """Which objects have stood still, where they came, for a while."""

    def __init__(self) -> None:
        self._serials, self._since = np.zeros(0, np.int64), np.zeros(0)
        self._poses = np.zeros((0, 7))

    def update(self, serials: Rows, poses: Floats, moves: Mask, now: float) -> Mask:
        """Return which objects stand still (n,), by unique numbers (n,) and poses (n, 7)."""
        room = len(serials) - len(self._serials)
        if room > 0:
            self._serials = np.pad(self._serials, (0, room), constant_values=-1)
            self._since = np.pad(self._since, (0, room))
            self._poses = np.pad(self._poses, ((0, room), (0, 0)))
        count = len(serials)
        same = (self._serials[:count] == serials) & (self._poses[:count] == poses).all(axis=1)
        changed = np.flatnonzero(~same | moves)
        self._serials[changed], self._poses[changed] = serials[changed], poses[changed]
        self._since[changed] = now
        return np.asarray(now - self._since[:count] >= STANDING)


class Course(NamedTuple):
    """Velocities (joints,) that a scale multiplies, for a reaction time (s), and then to a stop.

    braking: how long (s) the stop takes at a scale of 1.
    """

    wanted: Floats
    reaction: float
    braking: float

    @property
    def time(self) -> float:
        """How long (s) the way to a stop takes without braking."""
        return self.reaction + 0.5 * self.braking

    def in_time(self, time: float, present: float) -> float:
        """Return the largest scale whose way takes at most ``time`` (s) without braking.

        present: of the velocities, which go on for the reaction time.
        """
        scale = _root(self.braking, self.reaction, time)
        if scale >= present:
            return scale
        return min(scale, _root(self.braking, 0.0, time - present * self.reaction))

    def reach(self, scene: RobotScene, state: Floats) -> float:
        """Return how far (m) a point of the robot comes from a state (1, joints), at most."""
        way = self.time * np.abs(self.wanted)
        ends = state + np.multiply.outer((-1.0, 1.0), way)
        return float(scene.displacements(ends, way[None])[0])

    def stoppable(self, reach: float, room: float, drift: float = 0.0) -> float:
        """Return the largest scale at which a distance ``room`` (m) lasts until a stop.

        The robot comes nearer by its reach at most, the other object at ``drift`` (m/s).
        """
        pace = reach / self.time if self.time > 0.0 else 0.0
        linear = pace * self.reaction + drift * self.braking
        return _root(pace * self.braking, linear, room - drift * self.reaction)


def _root(square: float, linear: float, room: float) -> float:
    """Return the largest s from 0 to 1 for which s^2 square / 2 + s linear <= room."""
    if room <= 0.0:
        return 0.0
    root = linear + float(np.sqrt(linear * linear + 2.0 * square * room))
    return min(1.0, 2.0 * room / root) if root > 0.0 else 1.0


class Jog:
    """The velocities (joints,) that were commanded last, before any scale."""

    def __init__(self, checked: CheckedRobot) -> None:
        self._checked = checked
        self._latest: tuple[int, Joints, Floats] | None = None

    def receive(self, data: bytes, now: int) -> None:
        """Store the velocities of the first point of a JointTrajectory; RefusedError for others."""
        self._latest = None
        trajectory, joints = trajectory_from_bytes(data, is_jog=True), self._checked.joints
        velocities = np.zeros(len(joints.names))
        given = trajectory.points[0].velocities if trajectory.points else None
        if given is None:
            raise RefusedError(BAD_POINT, "a jog needs a point with velocities")
        velocities[joints.rows_of(trajectory.names)] = given
        if (np.abs(velocities) > TOO_FAST * joints.speed_limits).any():
            raise RefusedError(BAD_POINT, "a jog faster than the limits of the joints")
        self._latest = now, joints, velocities

    def velocities(self, now: int) -> Floats | None:
        """Return the velocities, None if they are zero or no longer wanted."""
        if self._latest is None or self._latest[1] is not self._checked.joints:
            return None
        received, _, velocities = self._latest
        is_new = 0 <= now - received <= JOG_TIME * NANOSECONDS
        return velocities if is_new and velocities.any() else None


class SpeedScale:
    """Publishes the speed scale (0 to 1) of one robot, while a topic of it has subscribers.

    factor: publishes it as SpeedScalingFactor, where control_msgs is installed.
    """

    def __init__(
        self, checked: CheckedRobot, publisher: Publisher, factor: Publisher | None = None
    ) -> None:
        self._checked, self._robot = checked, checked.input
        self._publisher, self._factor = publisher, factor
        self._objects, self._base = Standstill(), Standstill()
        self.jog = Jog(checked)

    def _standing(self, scene: RobotScene) -> Mask:
        """Return (slots,) which objects stand still; none of them while the base moves.

        Only objects by markers and of the scene file can: objects of other topics are tracked, and
        may move at any time.
        """
        table, store = self._checked.objects.table, self._checked.objects.scene.objects.store
        count, now = min(len(table.serial), len(store.poses)), monotonic()
        marked = self._checked.objects.placement.topics.index(State("", 0, 0).topic)
        moves = table.moving[:count] | (table.topic[:count] != marked)
        standing = self._objects.update(table.serial[:count], store.poses[:count], moves, now)
        number = np.zeros(1, np.int64)
        stands = self._base.update(number, scene.bases, np.zeros(1, np.bool_), now)[0]
        result = np.zeros(len(store.poses), np.bool_)
        result[:count] = standing & stands
        return result

    def publish(self) -> None:
        """Publish the scale as things are now, and tell the robot why it is 0."""
        self._robot.halt = ""
        ends = [end for end in (self._publisher, self._factor) if end is not None]
        if not any(end.get_subscription_count() for end in ends):
            return
        scale, why = 0.0, INTERNAL_ERROR
        try:
            scale, why = self._scale(), "within the stop distance"
        except ValueError as error:  # RefusedError, too: not known
            why = error.reason if isinstance(error, RefusedError) else str(error)
        finally:
            self._robot.halt = "" if scale > 0.0 else why
            self._publisher.publish(Float64(data=scale))
            if self._factor is not None:
                self._factor.publish(SpeedScalingFactor(factor=scale))

    def _scale(self) -> float:
        """Return the scale; RefusedError where it is 0 for another reason than a distance."""
        scene = self._checked.scene()
        state = self._checked.joints.positions[None]
        report = scene.check(state)  # links against each other, and limits, too
        if not report.valid[0]:
            raise RefusedError(
                "it collides" if report.colliding[0] else "a joint out of its limits"
            )
        scene.standing = self._standing(scene)
        scene.still_pairs = self._checked.parameters.speed_still_pairs
        if self._checked.stopping.lacking or self._checked.joints.unclear.any():
            return self._by_distance(scene, state)
        return self._by_direction(scene, state)

    def _by_distance(self, scene: NodeRobotScene, state: Floats) -> float:
        """Return 1 beyond the slow distance, and 0 within the stop distance.

        Both are more by how far the fastest point of the robot and of an object may have come
        nearer to each other within the reaction time.
        """
        parameters = self._checked.parameters
        stop, slow = parameters.speed_stop_distance, parameters.speed_slow_distance
        with np.errstate(over="ignore"):
            come = self._closing_speed(scene) * parameters.speed_reaction_time
        if not np.isfinite(come):
            raise RefusedError("speeds are too large")
        room = scene.least_distance(state, slow + come) - come - stop
        return float(np.clip(room / (slow - stop), 0.0, 1.0))

    def _by_direction(self, scene: NodeRobotScene, state: Floats) -> float:
        """Return the largest scale at which the robot can stop before the stop distance.

        It scales the jog, if one was commanded. Otherwise what the receiver scales is not known: it
        may be as fast as the limits of the joints, in their direction, or in any while they rest.
        """
        stopping, velocities = self._checked.stopping, self._checked.joints.velocities
        share = float((np.abs(velocities) / stopping.speeds).max(initial=0.0))
        if share > TOO_FAST:
            raise RefusedError("joints are faster than their limits")
        jog = self.jog.velocities(self._checked.clock())
        if jog is None and share < RESTING:
            return self._at_rest(scene, state)
        if jog is None:
            return self._towards(scene, state, velocities / min(share, 1.0), share)
        present = max(0.0, float(velocities @ jog / (jog @ jog)))
        scale = self._towards(scene, state, jog, present)
        if (np.abs(velocities - present * jog) > RESTING * stopping.speeds).any():
            scale = min(scale, self._towards(scene, state, velocities, 1.0))
        return scale

    def _at_rest(self, scene: NodeRobotScene, state: Floats) -> float:
        """Return the scale of a robot that may set off in any direction."""
        stopping, parameters = self._checked.stopping, self._checked.parameters
        stop, reaction = parameters.speed_stop_distance, parameters.speed_reaction_time
        course = Course(stopping.speeds, reaction, stopping.time(stopping.speeds))
        reach = course.reach(scene, state)
        room = scene.least_distance(state, stop + reach + NEARER) - stop
        first = reaction * reaction * stopping.decelerations  # until its direction is known
        known = float(scene.displacements(state, first[None])[0]) <= room
        scale = 1.0 if known else course.stoppable(reach, room)
        return min(scale, self._beside_others(scene, state, course, any_way=True))

    def _towards(
        self, scene: NodeRobotScene, state: Floats, wanted: Floats, present: float
    ) -> float:
        """Return the scale of velocities (joints,) of which the robot has the share ``present``.

        The way to a stop is proved free with links grown by the stop distance. Within that distance
        all pairs must open, and the way be free of collisions.
        """
        parameters = self._checked.parameters
        stop, reaction = parameters.speed_stop_distance, parameters.speed_reaction_time
        course = Course(wanted, reaction, self._checked.stopping.time(wanted))
        padded = self._checked.grown(stop)
        padded.standing, padded.still_pairs = scene.standing, scene.still_pairs
        end = state + course.time * wanted
        share = padded.free_share(state, end)
        if share == 1.0:
            scale = 1.0
        elif padded.is_near(state):
            leaves = (scene.rates(state, wanted, stop + NEARER)[2] > 0.0).all()
            scale = float(leaves and scene.free_share(state, end) == 1.0)
        else:
            scale = course.in_time(share * course.time, present)
        return min(scale, self._beside_others(scene, state, course)) if scale > 0.0 else 0.0

    def _beside_others(
        self, scene: NodeRobotScene, state: Floats, course: Course, any_way: bool = False
    ) -> float:
        """Return the scale beside objects that move, from which a course does not lead away."""
        slots, speeds = self._others()
        if len(slots) == 0:
            return 1.0
        stop = self._checked.parameters.speed_stop_distance
        reach = course.reach(scene, state)
        limit = stop + reach + float(speeds.max()) * (course.reaction + course.braking)
        distances, near, rates = scene.rates(state, course.wanted, limit + NEARER, slots)
        drifts = speeds[np.searchsorted(slots, near)]
        rows = np.flatnonzero(any_way | (rates < drifts)).tolist()
        rooms = ((float(distances[k]) - stop, float(drifts[k])) for k in rows)
        return min((course.stoppable(reach, *room) for room in rooms), default=1.0)

    def _others(self) -> tuple[Rows, Floats]:
        """Return the slots (n,) of objects that move, ascending, and their speeds at most (n,)."""
        links, objects = self._checked.links, self._checked.objects
        table = objects.table
        others = table.moving & table.visible
        others[links.slots] = others[self._robot.attached.slots] = False
        slots = np.flatnonzero(others)
        return slots, objects.scene.objects.speeds_of(slots, table.twist[slots])

    def _own_speed(self, scene: RobotScene) -> float:
        """Return at least how fast a point of the robot is by joints of unknown velocity (m/s)."""
        joints = self._checked.joints
        if not joints.unclear.any():
            return 0.0
        most = np.where(joints.unclear, joints.speed_limits, 0.0)
        if not np.isfinite(most).all():
            names = [joints.names[row] for row in np.flatnonzero(np.isinf(most))]
            who = first_names(names, len(names))
            raise RefusedError(f"joints without a velocity and without a velocity limit: {who}")
        return float(scene.displacements(joints.positions[None], most[None])[0])

    def _closing_speed(self, scene: RobotScene) -> float:
        """Return at least how fast any point of the robot and any object near each other (m/s)."""
        links, objects = self._checked.links, self._checked.objects
        if not links.are_speeds_known:
            raise RefusedError("speeds are too large")
        own = np.concatenate([links.slots, self._robot.attached.slots])
        speeds = objects.scene.objects.speeds_of(own, objects.table.twist[own])
        others = self._others()[1]
        most = float(speeds.max(initial=0.0)) + float(others.max(initial=0.0))
        return most + self._own_speed(scene)
