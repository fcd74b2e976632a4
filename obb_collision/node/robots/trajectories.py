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

"""Trajectories that are certainly free are forwarded, and stopped when they are so no longer.

Splines are checked as straight pieces, so short that no point of the robot is farther from where
the piece has it than a margin, with links grown by that.
"""

from __future__ import annotations

from dataclasses import dataclass
from struct import Struct
from time import monotonic
from typing import NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.publisher import Publisher
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from obb_collision.node.diagnostics.answer import make_status
from obb_collision.node.diagnostics.monitors import InputMonitor
from obb_collision.node.messages.cdr import Header, Reader
from obb_collision.node.messages.conversions import (
    LARGEST_COORDINATE,
    NANOSECONDS,
    duration_to_ros,
    stamp_from_ros,
)
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.robots.checked_robot import CheckedRobot, Stopping, portions
from obb_collision.node.robots.joints import Joints
from obb_collision.node.runtime.guard import INTERNAL_ERROR
from obb_collision.robots.kinematics.splines import (
    Pieces,
    Point,
    distances_from,
    interpolation,
    segments_between,
    straight_pieces,
    with_jump,
)
from obb_collision.robots.robot_scene import RobotScene
from obb_collision.typing import Floats

DURATION = Struct("<iI")
SMALLEST_POINT = 24
"""Bytes of a point, at least."""
BAD_POINT, TOO_LONG, ELSEWHERE = "bad point", "too many pieces", "not at its start"
MAX_PIECES = 5000
"""Most pieces of a trajectory: a check at once must not block the cycles."""
SHARE = 500
"""Pieces that are checked in a cycle before a trajectory is forwarded."""
DECISION_TIME = 2 * NANOSECONDS
"""After so long (ns) a trajectory that is not decided yet, for the scene changes, is refused."""
LONGEST_CHECK, QUICK = 0.5, 0.005
"""Seconds for which a cycle may wait for all pieces of a trajectory, and of a quick portion:
one piece of a joint that turns a million times takes up to 30 ms."""
BRAKE_STEP, MOST_STEPS = 0.02, 100
"""Seconds between points of a trajectory that brakes, and most of them."""
WIDER = 5
"""How often the time to brake is made longer, for pieces that are then on the way."""
NOT_FREE = "not free"
MOVED = "a joint outside the trajectory has moved"


class Trajectory(NamedTuple):
    """A trajectory_msgs/JointTrajectory; the points have joints in the order of the names."""

    header: Header
    names: list[str]
    points: list[Point]


def trajectory_from_bytes(data: bytes, is_jog: bool = False) -> Trajectory:
    """Return the trajectory in a serialised JointTrajectory; positions of a jog do not matter.

    Raises RefusedError: "malformed message", "too many pieces" for more points than pieces are
    checked, and "bad point" for one that makes no sense.
    """
    reader = Reader(data, JointTrajectory)
    header, names = reader.header(), reader.texts()
    count = reader.count(SMALLEST_POINT)
    if count > MAX_PIECES:  # at least one per point: reading them all would block the node
        raise RefusedError(TOO_LONG, f"{count} points, {MAX_PIECES} is the limit")
    points = [_point(reader) for _ in range(count)]
    reader.end()
    for number, point in enumerate(points):
        if is_jog:
            point = point._replace(positions=np.zeros(len(names)))
        _check(point, len(names), f"point {number}")
        if number and point.time <= points[number - 1].time:
            raise RefusedError(BAD_POINT, f"point {number}: its time does not increase")
    return Trajectory(header, names, points)


def _point(reader: Reader) -> Point:
    positions, *others, _ = [reader.doubles(reader.count(8), 1)[:, 0] for _ in range(4)]
    seconds, rest = reader.numbers(DURATION)
    time = (seconds * NANOSECONDS + rest) / NANOSECONDS
    return Point(time, positions, *(values if len(values) else None for values in others))


def _check(point: Point, count: int, which: str) -> None:
    """Raise RefusedError for a point without a good value of each joint."""
    if point.time < 0.0:
        raise RefusedError(BAD_POINT, f"{which}: its time is negative")
    if point.accelerations is not None and point.velocities is None:
        raise RefusedError(BAD_POINT, f"{which}: accelerations without velocities")
    for what, values in point._asdict().items():
        if values is None or what == "time":
            continue
        if len(values) != count:
            raise RefusedError(BAD_POINT, f"{which}: {len(values)} {what} of {count} joints")
        if not (np.abs(values) <= LARGEST_COORDINATE).all():
            raise RefusedError(BAD_POINT, f"{which}: {what} are not finite")


@dataclass
class Running:
    """A trajectory that was forwarded: its pieces, and when it began (ns)."""

    pieces: Pieces
    begin: int
    joints: Joints
    columns: list[int]
    """The joints that it moves, in the order of the names."""
    present: Floats
    """All joints when it was planned: the others are to stay there."""
    robot: object
    world: tuple[object, ...]
    """The robot and the scene that it was certified for."""
    passed: float = -np.inf
    """The time of the trajectory at which the robot was, at least."""

    def find_moved(self, tolerance: float) -> str:
        """Return the name of a joint that moved, but not by the trajectory; "" for none."""
        off = np.abs(self.joints.positions - self.present)
        off[self.columns] = 0.0
        return self.joints.names[int(np.argmax(off))] if off.max(initial=0.0) > tolerance else ""

    def advance(self, elapsed: float, tolerance: float) -> None:
        """Note how far the robot is, by its joints: controllers can be slower than planned.

        It is at the first piece near to the joints, searched from where it was before.
        """
        pieces, here = self.pieces, self.joints.positions
        ahead = np.flatnonzero((pieces.finishes > self.passed) & (pieces.begins <= elapsed))
        near = ahead[distances_from(pieces.take(ahead), here) <= tolerance]
        if len(near):
            self.passed = float(pieces.begins[near[0]])
        last = pieces.finishes.max()
        left = np.abs(pieces.ends[np.argmax(pieces.finishes)] - here).max(initial=0.0)
        if elapsed >= last and left <= tolerance:
            self.passed = float(last)

    @property
    def names(self) -> list[str]:
        """Names of the joints that the trajectory moves."""
        return [self.joints.names[column] for column in self.columns]

    def hold(self) -> JointTrajectory:
        """Return a trajectory that stays where the joints are."""
        positions = self.joints.positions[self.columns].tolist()
        return JointTrajectory(
            joint_names=self.names, points=[JointTrajectoryPoint(positions=positions)]
        )

    def brake(self, stopping: Stopping, now: int, tolerance: float) -> JointTrajectory | None:
        """Return a trajectory that comes to rest along the pieces; None where that is not known.

        It begins where the joints are by now: where they were, and on along the pieces since then.
        """
        joints, elapsed = self.joints, (now - self.begin) / NANOSECONDS
        pieces = self.pieces.take(self.pieces.finishes > self.pieces.begins)
        if stopping.lacking or joints.unclear[self.columns].any():
            return None
        ahead = np.flatnonzero((pieces.finishes > self.passed) & (pieces.begins <= elapsed))
        near = ahead[distances_from(pieces.take(ahead), joints.positions) <= tolerance]
        slopes = (pieces.ends - pieces.starts) / (pieces.finishes - pieces.begins)[:, None]
        if len(near) == 0 or not (square := float(slopes[near[0]] @ slopes[near[0]])) > 0.0:
            return None
        first, slope = int(near[0]), slopes[near[0]]
        share = min(1.0, float(joints.velocities @ slope) / square)  # of the planned speed
        if share <= 0.0:
            return None
        since = (joints.positions - pieces.starts[first]) @ slope / square
        heard = float(np.clip(pieces.begins[first] + since, pieces.begins[first], None))
        age = max(0.0, (now - int(joints.since[self.columns].min())) / NANOSECONDS)
        at, braking = min(heard + share * age, max(elapsed, heard)), stopping.time(slope)
        for _ in range(WIDER):  # the faster the pieces on the way, the longer it takes
            on_way = (pieces.finishes > at) & (pieces.begins < at + 0.5 * share * share * braking)
            braking = max(braking, stopping.time(np.abs(slopes[on_way]).max(axis=0, initial=0.0)))
        end = share * braking
        times = np.linspace(0.0, end, 1 + int(np.clip(np.ceil(end / BRAKE_STEP), 1, MOST_STEPS)))
        ways = at + share * times * (1.0 - 0.5 * times / end)
        rows = np.searchsorted(pieces.begins, ways, side="right") - 1
        rates = share * (1.0 - times / end)[:, None] * slopes[rows]
        rates[(times == end) | (ways >= pieces.finishes[-1])] = 0.0
        knots = np.append(pieces.begins, pieces.finishes[-1])
        states = np.vstack([pieces.starts, pieces.ends[-1:]])
        points = [
            JointTrajectoryPoint(
                positions=[float(np.interp(way, knots, states[:, c])) for c in self.columns],
                velocities=rate[self.columns].tolist(),
                time_from_start=duration_to_ros(time),
            )
            for time, way, rate in zip(times[1:].tolist(), ways[1:], rates[1:], strict=True)
        ]
        return JointTrajectory(joint_names=self.names, points=points)


def whole_point(point: Point, columns: list[int], joints: Joints) -> Point:
    """Return a point with all joints: others stay where they are."""

    def spread(moved: Floats | None) -> Floats | None:
        if moved is None:
            return None
        values = np.zeros(len(joints.names))
        values[columns] = moved
        return values

    positions = joints.positions.copy()
    positions[columns] = point.positions
    return Point(point.time, positions, spread(point.velocities), spread(point.accelerations))


def from_here(points: list[Point], joints: Joints, since: float) -> list[Point]:
    """Return the points with the present state before them, from which controllers begin.

    since: the time of the trajectory that it is now (s). Where that of the first point has come,
    the way to it is straight and sudden.
    """
    first, here = points[0], joints.positions.copy()
    if first.time > since:
        if first.accelerations is not None:  # those of now are not known
            raise RefusedError(BAD_POINT, "the first point has accelerations but is not at time 0")
        if first.velocities is not None and joints.unclear.any():
            name = joints.names[int(np.argmax(joints.unclear))]
            raise RefusedError(ELSEWHERE, f"the velocity of joint {name} is not known")
        return [Point(since, here, joints.velocities.copy(), None), *points]
    step = 1e-9  # what may be between two points of time
    return [Point(first.time - step, here, None, None), *points]


@dataclass
class Deciding:
    """A trajectory that is being checked, as it would run, and how far the check is.

    spent: seconds. fresh: whether nothing has happened since it came.
    """

    data: bytes
    trajectory: Trajectory
    running: Running
    received: int
    done: int = 0
    spent: float = 0.0
    fresh: bool = True


class Trajectories:
    """The trajectories of one robot: checks and forwards them, and publishes their status."""

    def __init__(
        self, checked: CheckedRobot, forward: Publisher, status: Publisher, monitor: InputMonitor
    ) -> None:
        self._checked, self._monitor = checked, monitor
        self._forward, self._status = forward, status
        self._clock, self._parameters = checked.clock, checked.parameters
        self.running: Running | None = None
        self.deciding: Deciding | None = None
        self._closed = False
        self.stopped = ""
        """Why the last trajectory was stopped, "" if it was not."""

    def receive(self, data: bytes, now: int) -> None:
        """Forward a trajectory message unchanged, or say why not.

        A message without points is a stop; it is always forwarded. A trajectory with many pieces
        waits: the next cycles decide it.
        """
        before, self.deciding = self.deciding, None
        if before is not None:
            self._refuse(
                RefusedError("superseded", "replaced by a newer trajectory before it was decided")
            )
        try:
            trajectory = trajectory_from_bytes(data)
            if not trajectory.points:
                running, self.running = self.running, None
                if running is not None:
                    self._slow_down(running)
                self._forward.publish(data)
                self._say(DiagnosticStatus.OK, "forwarded: a stop")
                return
            running = self._planned(trajectory, now)
        except RefusedError as error:
            self._refuse(error)
            return
        self.deciding = Deciding(data, trajectory, running, now)
        self._decide()

    def _refuse(self, error: RefusedError) -> None:
        self._monitor.refuse(error.reason, "whole message", error.detail)
        self._say(DiagnosticStatus.ERROR, f"refused: {error}", error)

    def _decide(self) -> None:
        """Check a share of the undecided trajectory; forward it after the last share."""
        deciding, self.deciding = self.deciding, None  # whatever fails, it is not forwarded
        if deciding is None:
            return
        try:
            running = self._checked_share(deciding)
            if self._closed:
                raise RefusedError("not decided", "the node has stopped checking")
        except RefusedError as error:
            self._refuse(error)
            return
        if running is None:
            self.deciding, deciding.fresh = deciding, False
            return
        self._forward.publish(deciding.data)
        self.running, self.stopped = running, ""
        first, last = deciding.trajectory.points[0], deciding.trajectory.points[-1]
        values = {"interpolation": interpolation(first, last), "pieces": len(running.pieces.begins)}
        self._say(DiagnosticStatus.OK, "forwarded", values)

    def _checked_share(self, deciding: Deciding) -> Running | None:
        """Return the trajectory if it is certified now, None if there is more to check.

        A change of the scene makes the check begin again.
        """
        now, running = self._clock(), deciding.running
        scene = self._scene_for(running)
        if not self._checked.is_world(running.world):
            running.world, deciding.done, deciding.spent = self._checked.world(scene), 0, 0.0
        if now - deciding.received > DECISION_TIME:
            raise RefusedError(
                "not decided", "the scene changes too often for the number of pieces"
            )
        numbers = np.arange(len(running.pieces.begins))
        share = (numbers >= deciding.done) & (numbers < deciding.done + SHARE)
        deciding.spent += _check_pieces(scene, running.pieces.take(share), deciding.spent)
        deciding.done += SHARE
        if deciding.done < len(numbers):
            return None
        if deciding.fresh:
            return running
        again = self._planned(deciding.trajectory, now)  # from where the joints are by now
        _check_pieces(scene, again.pieces.take(again.pieces.segments == 0))
        return again

    def _scene_for(self, running: Running) -> RobotScene:
        """Return the scene that checks pieces; RefusedError if robot or joints have changed."""
        scene = self._checked.scene(self._parameters.trajectory_margin)
        if self._checked.robot is not running.robot:
            raise RefusedError("another robot", "its description has changed")
        moved = running.find_moved(self._parameters.trajectory_start_tolerance)
        if moved:
            raise RefusedError(MOVED, moved)
        return scene

    def check_more(self) -> None:
        """Monitor the running trajectory, and check the next share of the pending one."""
        try:
            self._look_after()
        finally:
            self._decide()

    def _look_after(self) -> None:
        """Check the rest of the running trajectory if the scene has changed; stop it if need be."""
        running, now = self.running, self._clock()
        if running is None:
            return
        elapsed = (now - running.begin) / NANOSECONDS
        running.advance(elapsed, self._parameters.trajectory_start_tolerance)
        left = running.pieces.finishes > running.passed
        if not left.any():
            self.running = None
            return
        try:
            scene = self._scene_for(running)
            if not self._checked.is_world(running.world):
                _check_pieces(scene, running.pieces.take(left))
                running.world = self._checked.world(scene)
        except RefusedError as error:
            self._stop(running, error)
        except Exception as error:  # not foreseen, and so not known
            self._stop(running, RefusedError(INTERNAL_ERROR, str(error)))
            raise

    def close(self) -> None:
        """Stop the running trajectory, which nothing monitors any more; safe from any thread."""
        self._closed, self.deciding = True, None
        if self.running is not None:
            self._stop(self.running, RefusedError("the node has stopped checking"))

    def interrupt(self, why: str) -> None:
        """Stop and refuse trajectories: the joints are not known any more."""
        deciding, self.deciding = self.deciding, None
        if deciding is not None:
            self._refuse(RefusedError("not decided", why))
        if self.running is not None:
            self._stop(self.running, RefusedError(why))

    def _stop(self, running: Running, error: RefusedError) -> None:
        """Stop the robot: ``joint_trajectory_controller`` refuses trajectories without points."""
        self.running = None
        if not self._slow_down(running):
            self._forward.publish(JointTrajectory(joint_names=running.names))
        self.stopped = f"trajectory stopped: {error}"
        self._say(DiagnosticStatus.ERROR, f"stopped: {error}", error)

    def _slow_down(self, running: Running) -> bool:
        """Send a trajectory that ends the running one; return whether it brakes along it."""
        tolerance = self._parameters.trajectory_start_tolerance
        braking = None
        try:
            if self._checked.robot is running.robot:
                braking = running.brake(self._checked.stopping, self._clock(), tolerance)
        except RefusedError:
            pass  # there is no robot any more
        finally:  # whatever fails, it is stopped
            self._forward.publish(running.hold() if braking is None else braking)
        return braking is not None

    def clock_jumped(self, shift: int) -> None:
        """Shift times by a jump of the clock (ns)."""
        if self.running is not None:
            self.running.begin += shift
        if self.deciding is not None:
            self.deciding.received += shift

    def _planned(self, trajectory: Trajectory, now: int) -> Running:
        """Return a trajectory as it would run from now on; RefusedError if it cannot be used."""
        checked = self._checked
        scene, joints = checked.scene(self._parameters.trajectory_margin), checked.joints
        begin = stamp_from_ros(trajectory.header.stamp) or now
        tolerance = int(self._parameters.stamp_tolerance * NANOSECONDS)
        if abs(begin - now) > tolerance:
            raise RefusedError("bad stamp", f"{(begin - now) / NANOSECONDS:+.1f} s from now")
        columns = joints.rows_of(trajectory.names)
        points = [whole_point(point, columns, joints) for point in trajectory.points]
        off = np.abs(points[0].positions - joints.positions)
        since = (now - begin) / NANOSECONDS
        is_way = len(points) == 1 and points[0].time > since  # a command to go there from here
        if off.max(initial=0.0) > self._parameters.trajectory_start_tolerance and not is_way:
            name = joints.names[int(np.argmax(off))]
            raise RefusedError(ELSEWHERE, f"joint {name} is off by {off.max():.4g}")
        pieces = self._pieces(scene, from_here(points, joints, since))
        if since > points[0].time:
            pieces = with_jump(pieces, joints.positions, points, since)
        here, robot, world = joints.positions.copy(), checked.robot, checked.world(scene)
        return Running(pieces, begin, joints, columns, here, robot, world)

    def _pieces(self, scene: RobotScene, points: list[Point]) -> Pieces:
        """Return straight pieces that the trajectory stays near to."""
        deviations = segments_between(points).deviations()
        reached = np.array([point.positions for point in points])
        largest = np.abs(reached).max(axis=0) + deviations.max(axis=0)
        try:
            moved = scene.displacements(largest[None], deviations)
        except ValueError as error:
            raise RefusedError("bad robot", str(error)) from error
        counts = np.maximum(1.0, np.ceil(np.sqrt(moved / self._parameters.trajectory_margin)))
        if not counts.sum() <= MAX_PIECES:
            raise RefusedError(TOO_LONG, f"{counts.sum():.0f}, {MAX_PIECES} is the limit")
        return straight_pieces(points, counts.astype(np.int64))

    def _say(self, level: bytes, message: str, about: object = None) -> None:
        """Publish the status; about: values, or an error that has some."""
        values = about if isinstance(about, dict) else getattr(about, "values", {})
        name = f"robot {self._checked.input.name}: trajectory"
        self._status.publish(make_status(name, level, message, values.items()))


class NotFreeError(RefusedError):
    """A trajectory is not certainly free; values: where and why."""

    def __init__(self, detail: str, values: dict[str, object]) -> None:
        super().__init__(NOT_FREE, detail)
        self.values = values


def _check_pieces(scene: RobotScene, pieces: Pieces, spent: float = 0.0) -> float:
    """Raise NotFreeError for the first piece that is not certainly free and within limits.

    spent: seconds spent on others of the trajectory; RefusedError ("not decided") if all take too
    long to be checked in one cycle. Returns the seconds that these took.
    """
    begin, rows = monotonic(), np.arange(len(pieces.begins))
    for part in portions(len(rows), QUICK):
        if part.start and spent + monotonic() - begin > LONGEST_CHECK:
            detail = f"the check takes longer than {LONGEST_CHECK:g} s"
            raise RefusedError("not decided", detail)
        _check_some(scene, pieces.take(rows[part]))
    return monotonic() - begin


def _check_some(scene: RobotScene, pieces: Pieces) -> None:
    report = scene.check_motions(pieces.starts, pieces.ends, first=True)
    bad = report.first_invalid
    if bad is None:
        return
    begin, collides = pieces.begins[bad], report.colliding[bad]
    after = report.fractions[bad] * (pieces.finishes[bad] - begin) if collides else 0.0
    time = f"{max(begin + after, 0.0):.3f}"
    values: dict[str, object] = {"index": int(pieces.segments[bad]), "time (s)": time}
    if collides:
        first, second = report.pairs[bad] or ("", "")
        values |= {"first": first, "second": second}
        raise NotFreeError(f"{first} and {second} at {time} s", values)
    joint = scene.joint_names[int(np.argmax(report.out_of_limits[bad]))]
    raise NotFreeError(f"joint {joint} out of its limits", values | {"joint": joint})
