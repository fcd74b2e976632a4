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

"""Trajectories: forwarded untouched if they are certainly free, and stopped when no longer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("lxml")
pytest.importorskip("trajectory_msgs")
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from rclpy.serialization import serialize_message
from rig import LATCHED, cube
from robot_rig import URDF, RobotRig
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import Marker

from obb_collision.node.messages.conversions import (
    duration_from_ros,
    duration_to_ros,
    stamp_to_ros,
)
from obb_collision.node.robots import trajectories

CRATE = ("crate", 1)
NONE = [0.0, 0.0]
OK, ERROR = DiagnosticStatus.OK, DiagnosticStatus.ERROR
BOTH = ("lift", "turn")
FAR = (9.0, 9.0, 9.0)
THERE = (0.0, 1.0, 0.5)
"""Where the hand is at a turn of 90 degrees."""
QUARTER = [(0.0, [0.0, 0.0]), (2.0, [0.0, np.pi / 2])]


class TrajectoryRig(RobotRig):
    """A rig that sends trajectories to a robot with a crate, far away unless said."""

    def __init__(self, place: Sequence[float] = FAR, **given: Any) -> None:
        super().__init__(given)
        create, listen = self.client.create_publisher, self.client.create_subscription
        self.wanted = create(JointTrajectory, "arm/trajectory_in", 10)
        self.pubs["wanted"] = self.wanted
        self.forwarded: list[Any] = []
        self.said: list[Any] = []
        listen(JointTrajectory, "arm/trajectory_out", self._take_trajectory, 10)
        listen(DiagnosticStatus, "arm/trajectory_status", self._take_status, 10)
        self.wait_inputs()
        assert self.node.robots is not None
        ends = self.node.robots._publishers
        for name in ("arm/trajectory_out", "arm/trajectory_status"):
            self.until(ends[name].get_subscription_count, name)
        self.start_robot()
        self.put(place)

    def _take_trajectory(self, message: Any) -> None:
        self.forwarded.append(message)

    def _take_status(self, message: Any) -> None:
        self.said.append(message)

    def put(self, place: Sequence[float]) -> None:
        """Put the crate somewhere."""
        self.send(cube(CRATE, place, (0.1, 0.1, 0.1)))
        self.answer()

    def go(
        self, points: Sequence[tuple[Any, ...]], names: Sequence[str] = BOTH, stamp: Any = None
    ) -> tuple[Any, dict[str, str]]:
        """Send points (time, positions, velocities, accelerations); return what is said of them.

        What is forwarded is what was sent, and nothing else is.
        """
        self.said.clear()
        self.forwarded.clear()
        message = self.publish(points, names, stamp)
        self.until(lambda: self.said, "what is said of it")
        status = self.said[0]
        if status.level == OK:
            self.until(lambda: self.forwarded, "the trajectory")
        expected = [message] if status.level == OK else []
        assert self.forwarded == expected
        return status, {pair.key: pair.value for pair in status.values}

    def stopped(self) -> str:
        """Wait for a stop, and return what is said of it."""
        self.until(lambda: self.said, "what is said of the stop")
        self.until(lambda: self.forwarded and not self.forwarded[-1].points, "the stop")
        return str(self.said[0].message)

    def publish(
        self, points: Sequence[tuple[Any, ...]], names: Sequence[str] = BOTH, stamp: Any = None
    ) -> JointTrajectory:
        """Send points, and return the message."""
        message = JointTrajectory(joint_names=list(names))
        if stamp is not None:
            message.header = stamp
        for time, *values in points:
            point = JointTrajectoryPoint(time_from_start=duration_to_ros(time))
            fields = ("positions", "velocities", "accelerations")
            for field, given in zip(fields, values, strict=False):
                setattr(point, field, [float(value) for value in given])
            message.points.append(point)
        self.wanted.publish(message)
        return message


def test_a_free_trajectory_is_forwarded_untouched() -> None:
    with TrajectoryRig() as rig:
        status, values = rig.go(QUARTER)
        assert (status.level, status.message) == (OK, "forwarded")
        assert values["interpolation"] == "linear"


def test_a_trajectory_that_collides_is_refused_with_index_time_and_pair() -> None:
    with TrajectoryRig(THERE) as rig:
        half = [(1.0, [0.0, np.pi / 4])]
        status, values = rig.go([QUARTER[0], *half, *QUARTER[1:]])
        assert status.level == ERROR
        assert status.message.startswith("refused: not free: arm/hand and crate/1")
        assert (values["first"], values["second"]) == ("arm/hand", "crate/1")
        assert values["index"] == "2"
        assert 1.5 < float(values["time (s)"]) < 2.0
        assert rig.refused("arm/trajectory_in") == {"not free": 1}
        assert rig.go([*QUARTER[:1], *half])[0].level == OK


def test_what_lies_between_the_points_counts() -> None:
    with TrajectoryRig(THERE) as rig:
        beyond = [QUARTER[0], (2.0, [0.0, 2.5])]
        assert rig.go(beyond)[0].level == ERROR
        assert rig.go([QUARTER[0], (1.0, [1.0, 0.0]), (2.0, [1.0, 2.5])])[0].level == OK


@pytest.mark.parametrize("order", [1, 2])
def test_splines_swing_where_lines_do_not(order: int) -> None:
    rest, swing = [[0.0, 0.0]] * (order - 1), [0.0, 4.0]
    still = [(0.0, [0.0, 0.0]), (2.0, [0.0, 0.0])]
    swings = [(0.0, [0.0, 0.0], swing, *rest), (2.0, [0.0, 0.0], [0.0, -4.0], *rest)]
    with TrajectoryRig(THERE) as rig:
        assert rig.go(still)[0].level == OK
        status, values = rig.go(swings)
        assert status.message.startswith("refused: not free: arm/hand and crate/1")
        assert 0.0 < float(values["time (s)"]) < 1.0
        rig.put(FAR)
        status, values = rig.go(swings)
        assert (status.level, values["interpolation"]) == (OK, ("cubic", "quintic")[order - 1])
        assert int(values["pieces"]) > 10


def test_one_point_that_lies_ahead_is_gone_to_from_where_the_joints_are() -> None:
    with TrajectoryRig((np.cos(0.8), np.sin(0.8), 0.5)) as rig:
        status, values = rig.go(QUARTER[1:])
        assert status.message.startswith("refused: not free: arm/hand and crate/1")
        assert values["index"] == "0"
        assert 0.5 < float(values["time (s)"]) < 1.5
        rig.put(FAR)
        assert rig.go(QUARTER[1:])[0].level == OK
        last: list[Any] = []
        rig.client.create_subscription(
            DiagnosticStatus, "arm/trajectory_status", last.append, LATCHED
        )
        assert rig.until(lambda: last, "what was said before")[0].message == "forwarded"
        rig.said.clear()
        rig.put((np.cos(0.8), np.sin(0.8), 0.5))
        assert rig.stopped().startswith("stopped: not free: arm/hand and crate/1")
        for late in ([(0.0, QUARTER[1][1])], [(1.0, [0.0, 0.1]), *QUARTER[1:]]):
            assert "not at its start" in rig.go(late)[0].message


def test_joints_that_are_not_named_stay_where_they_are() -> None:
    turn = [(0.0, [0.0]), (2.0, [np.pi / 2])]
    with TrajectoryRig((0.0, 1.0, 0.8)) as rig:
        assert rig.go(turn, ["turn"])[0].level == OK
        rig.said.clear()
        rig.send_joints(lift=0.3, turn=0.0)
        assert rig.stopped() == "stopped: a joint that it does not name has moved: lift"
        assert rig.go(turn, ["turn"])[0].level == ERROR


NAN = float("nan")


@pytest.mark.parametrize(
    ("points", "names", "reason"),
    [
        ([(0.0, [0.1, 0.0]), *QUARTER[1:]], BOTH, "not at its start"),
        ([QUARTER[0], (2.0, [0.0, 3.1])], BOTH, "joint arm/turn out of its limits"),
        ([QUARTER[0], (2.0, [0.0])], BOTH, "bad point"),
        ([QUARTER[0], (0.0, [0.0, 0.0])], BOTH, "its time does not rise"),
        ([QUARTER[0], (2.0, [0.0, NAN])], BOTH, "not finite"),
        (QUARTER, ("lift", "tail"), "unknown joint"),
        (QUARTER, ("lift", "lift"), "repeated joint"),
        ([(0.0, [0.0, 0.0], [0.0, 0.0]), (9.0, [0.0, 0.0], [0.0, 1e9])], BOTH, "too many pieces"),
        ([(1.0, [0.0, 0.0], [0.0, 0.0], [0.0, 0.0])], BOTH, "is not at time 0"),
    ],
)
def test_what_makes_no_sense_is_refused(points: Any, names: Any, reason: str) -> None:
    with TrajectoryRig() as rig:
        status, _ = rig.go(points, names)
        assert status.level == ERROR
        assert reason in status.message


def test_a_stamp_far_from_now_is_refused() -> None:
    with TrajectoryRig() as rig:
        header = Header()
        header.stamp.sec = 5
        assert "bad stamp" in rig.go(QUARTER, stamp=header)[0].message


def stamped(rig: TrajectoryRig, seconds: float) -> Header:
    """Return a header whose stamp is some time ahead of the node's clock."""
    return Header(stamp=stamp_to_ros(rig.now() + int(seconds * 1e9)))


def test_until_a_stamp_ahead_joints_swing_on_from_where_they_are() -> None:
    points = [(0.0, [0.0, 0.0], [0.0, 0.0]), (2.0, [0.0, -1.0], [0.0, 0.0])]
    with TrajectoryRig((np.cos(0.25), np.sin(0.25), 0.5)) as rig:
        rig.set(stamp_tolerance=5.0)
        rig.send_joints({"turn": 2.0}, lift=0.0, turn=0.0)
        rig.answer()
        assert rig.go(points)[0].level == OK  # at once: there is no time for a swing
        status, values = rig.go(points, stamp=stamped(rig, 1.0))
        assert status.message.startswith("refused: not free: arm/hand and crate/1")
        assert values["index"] == "0"


def test_with_a_stamp_that_has_passed_joints_jump_to_where_it_is_by_now() -> None:
    around = [
        *((0.0, [0.0, 0.0]), (1.0, [1.0, 0.0]), (2.0, [1.0, 1.0])),
        *((3.0, [0.0, 1.0]), (30.0, [0.0, 1.1])),
    ]
    with TrajectoryRig((np.cos(0.5), np.sin(0.5), 0.5)) as rig:
        rig.set(stamp_tolerance=20.0)
        assert rig.go(around)[0].level == OK
        status, _ = rig.go(around, stamp=stamped(rig, -10.0))
        assert status.message.startswith("refused: not free: arm/hand and crate/1")
        rig.put(FAR)
        assert rig.go(around, stamp=stamped(rig, -10.0))[0].level == OK


def test_no_swing_begins_with_a_velocity_that_is_not_known() -> None:
    with TrajectoryRig() as rig:
        rig.stamp += 2_000_000_000  # so long ago that no difference says how fast it is
        rig.send_joints({"turn": NAN}, lift=0.0, turn=0.0)
        rig.answer()
        still = [0.0, 0.0]
        status, _ = rig.go([(1.0, still, still)])
        assert "the velocity of joint turn is not known" in status.message
        assert rig.go([(1.0, still)])[0].level == OK
        assert rig.go([(0.0, still, still), (1.0, still, still)])[0].level == OK


def test_what_cannot_be_attached_is_said() -> None:
    with TrajectoryRig() as rig:
        marker = cube(("arm", 5), (0.0, 0.0, 2.0), (0.1, 0.1, 0.1), frame_locked=True)
        marker.header.frame_id = "arm/hand"
        rig.describe(URDF.replace('"base"', '"5"'))
        rig.until(lambda: "5" in str(rig.robot.links and rig.robot.links.rows), "the robot")
        rig.send_joints(lift=0.0, turn=0.0)
        rig.answer()
        assert rig.go(QUARTER)[0].level == OK
        rig.send(marker)
        rig.cycles(2)
        rig.send_joints(lift=0.0, turn=0.0)
        rig.answer()
        text = "refused: scene not known: not attached: name must not be that of a link"
        assert rig.go(QUARTER)[0].message.startswith(text)


def test_without_knowing_everything_none_is_forwarded() -> None:
    with TrajectoryRig() as rig:
        rig.send_joints(lift=NAN)
        rig.until(lambda: rig.robot.fault, "the fault")
        assert "scene not known" in rig.go(QUARTER)[0].message


def test_a_trajectory_is_stopped_when_the_scene_changes_so_that_it_collides() -> None:
    with TrajectoryRig() as rig:
        rig.listen("collision_status")
        rig.until(lambda: "collision_status" in rig.last, "a status")
        assert rig.go([QUARTER[0], (1000.0, QUARTER[1][1])])[0].level == OK
        rig.said.clear()
        rig.forwarded.clear()
        rig.put((5.0, 5.0, 5.0))
        rig.cycles(2)
        assert not rig.said
        rig.put(THERE)
        assert rig.stopped().startswith("stopped: not free: arm/hand and crate/1")
        hold, empty = rig.forwarded
        assert [list(point.positions) for point in hold.points] == [[0.0, 0.0]]
        assert duration_from_ros(hold.points[0].time_from_start) == 0
        assert hold.joint_names == list(BOTH)
        assert empty == JointTrajectory(joint_names=list(BOTH))
        text = "robot arm: trajectory stopped: not free"
        rig.until(lambda: text in rig.last["collision_status"].status[0].message, text)
        rig.cycles(2)
        assert len(rig.said) == 1  # once
        rig.put(FAR)
        assert rig.go(QUARTER)[0].level == OK
        rig.until(lambda: text not in rig.last["collision_status"].status[0].message, "no more")


def test_a_trajectory_is_stopped_when_another_shape_in_the_same_box_is_in_its_way() -> None:
    crate = cube(CRATE, (0.0, 1.35, 0.85), (0.6, 0.6, 0.6))
    with TrajectoryRig() as rig:
        crate.type = Marker.SPHERE
        rig.send(crate)
        rig.answer()
        assert rig.go([QUARTER[0], (1000.0, QUARTER[1][1])])[0].level == OK
        rig.said.clear()
        crate.type = Marker.CUBE
        rig.send(crate)
        assert rig.stopped().startswith("stopped: not free: arm/hand and crate/1")


def test_a_trajectory_is_stopped_when_links_are_padded_so_that_it_collides() -> None:
    with TrajectoryRig((0.0, 1.2, 0.5)) as rig:
        assert rig.go([QUARTER[0], (1000.0, QUARTER[1][1])])[0].level == OK
        rig.said.clear()
        rig.set(padding_overrides=["arm/*: 0.06"])
        assert rig.stopped().startswith("stopped: not free: arm/hand and crate/1")


def test_a_trajectory_is_stopped_when_it_is_not_known_any_more() -> None:
    with TrajectoryRig() as rig:
        assert rig.go([QUARTER[0], (1000.0, QUARTER[1][1])])[0].level == OK
        rig.said.clear()
        rig.send_joints(lift=NAN)
        assert rig.stopped().startswith("stopped: scene not known")


def test_a_trajectory_is_stopped_when_the_robot_or_the_node_goes() -> None:
    long = [QUARTER[0], (1000.0, QUARTER[1][1])]
    with TrajectoryRig() as rig:
        assert rig.go(long)[0].level == OK
        rig.said.clear()
        rig.describe(URDF.replace('name="arm"', 'name="other"'))
        assert rig.stopped().startswith("stopped: ")
        rig.until(lambda: rig.robot.fault.startswith("joints without"), "the other robot")
        rig.send_joints(lift=0.0, turn=0.0)
        rig.answer()
        assert rig.go(long)[0].level == OK
        rig.said.clear()
        assert rig.change(Transition.TRANSITION_DEACTIVATE)
        assert "inactive" in rig.stopped()


def test_clear_stops_a_trajectory_where_the_joints_are() -> None:
    with TrajectoryRig() as rig:
        rig.known()
        assert rig.go([QUARTER[0], (1000.0, QUARTER[1][1])])[0].level == OK
        rig.send_joints(lift=0.0, turn=0.3)
        rig.answer()
        rig.said.clear()
        rig.forwarded.clear()
        rig.call(Trigger, "obb_collision/clear", Trigger.Request())
        rig.send_joints(lift=0.0, turn=1.4)
        assert rig.stopped() == "stopped: all objects were removed"
        assert [list(point.positions) for point in rig.forwarded[0].points] == [[0.0, 0.3]]
        rig.known()
        rig.cycles(2)
        assert len(rig.said) == 1


def test_joints_that_come_between_clear_and_the_next_cycle_keep_nothing_running() -> None:
    def joints(turn: float) -> bytes:
        message = JointState(header=rig.header(), name=list(BOTH), position=[0.0, turn])
        message.velocity = NONE
        return bytes(serialize_message(message))

    with TrajectoryRig() as rig:
        rig.known()
        node = rig.node
        assert node.robots is not None
        trajectory = JointTrajectory(joint_names=list(BOTH))
        point = JointTrajectoryPoint(positions=NONE, velocities=NONE, accelerations=NONE)
        trajectory.points = [point]
        for begin, end in ((0.0, 0.3), (1.4, 1.45)):
            wanted = [(0.0, [0.0, begin]), (1000.0, [0.0, 1.5])]
            assert rig.go(wanted)[0].level == OK
            rig.said.clear()
            rig.forwarded.clear()
            rig.robot.take_joints(joints(end))
            assert node._clear(Trigger.Request(), Trigger.Response()).success
            for step in range(10):  # at 500 Hz, with nothing between them that looks at anything
                rig.robot.take_joints(joints(0.1 * step))
            node._subscribed._callbacks["arm/trajectory_in"](serialize_message(trajectory))
            rig.robot.take_joints(joints(1.4))
            node._run_cycle()
            node.robots.hold("a later stop")
            rig.until(lambda: len(rig.said) == 2, "what is said")
            rig.stopped()
            said = [status.message for status in rig.said]
            assert said[0] == "stopped: all objects were removed"
            assert said[1].startswith("refused: scene not known: without a pose: arm/base/0")
            stops = [[list(point.positions) for point in each.points] for each in rig.forwarded]
            assert stops == [[[0.0, end]], []], "where the joints were, and nothing more"
            rig.known()


def test_a_trajectory_is_stopped_when_a_signal_ends_the_node() -> None:
    with TrajectoryRig() as rig:
        assert rig.go([QUARTER[0], (1000.0, QUARTER[1][1])])[0].level == OK
        rig.said.clear()
        rig.node.say_farewell()
        assert "the node does not check any more" in rig.stopped()
        assert rig.go(QUARTER)[0].message.endswith("the node does not check any more")
        rig.node.say_farewell()  # nothing runs any more


SHORT = [(0.0, [0.0, 0.0]), (0.001, [0.0, np.pi / 2]), (0.002, [0.5, np.pi / 2])]
"""Long past when a test goes on: a robot that is behind goes slower than planned."""


def test_a_trajectory_counts_until_the_robot_is_there_however_slow() -> None:
    with TrajectoryRig() as rig:
        for turn, place in ((0.0, THERE), (np.pi / 2, (0.0, 1.0, 1.0))):
            rig.send_joints(lift=0.0, turn=0.0)
            rig.answer()
            assert rig.go(SHORT)[0].level == OK
            rig.cycles(3)
            rig.said.clear()
            rig.send_joints(lift=0.0, turn=turn / 2.0)
            rig.answer()
            rig.send_joints(lift=0.0, turn=turn)
            rig.answer()
            rig.put(place)
            assert rig.stopped().startswith("stopped: not free: arm/hand and crate/1")
            rig.put(FAR)


def test_what_the_robot_has_behind_it_counts_no_more() -> None:
    with TrajectoryRig() as rig:
        assert rig.go(SHORT)[0].level == OK
        rig.said.clear()
        rig.send_joints(lift=0.25, turn=np.pi / 2)
        rig.answer()
        rig.put((1.0, 0.0, 0.5))
        assert decider(rig)._running.passed == 0.001
        rig.send_joints(lift=0.5, turn=np.pi / 2)
        rig.answer()
        rig.cycles(2)
        assert decider(rig)._running is None
        rig.put((0.0, 1.0, 1.0))
        rig.cycles(2)
        assert not rig.said


def test_an_empty_trajectory_is_a_stop_of_what_runs() -> None:
    with TrajectoryRig() as rig:
        assert rig.go([QUARTER[0], (1000.0, QUARTER[1][1])])[0].level == OK
        rig.send_joints(lift=0.0, turn=0.5)
        rig.answer()
        rig.forwarded.clear()
        sent = rig.publish([], ["turn"])
        rig.until(lambda: len(rig.forwarded) == 2, "the stop")
        hold, empty = rig.forwarded
        assert [list(point.positions) for point in hold.points] == [[0.0, 0.5]]
        assert empty == sent


def test_an_empty_trajectory_is_a_stop_and_always_forwarded() -> None:
    with TrajectoryRig() as rig:
        rig.send_joints(lift=NAN)
        rig.until(lambda: rig.robot.fault, "the fault")
        assert rig.go([])[0].message == "forwarded: a stop"


LONG = [(0.0, [0.0, 0.0], [0.0, 0.0]), (1000.0, [0.0, 2.9], [0.0, 0.0])]
"""With velocities, and a small margin, it has thousands of pieces."""


def decider(rig: TrajectoryRig) -> Any:
    """Return what decides trajectories of the robot."""
    assert rig.node.robots is not None
    return rig.node.robots._trajectories["arm/trajectory_in"]


def shares(rig: TrajectoryRig) -> int:
    """Return how many shares of 500 pieces the trajectory has that runs."""
    running = decider(rig)._running
    return -(-len(running.pieces.begins) // 500)


@pytest.fixture
def unhurried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a check take as long as a loaded machine needs."""
    monkeypatch.setattr(trajectories, "LONGEST_CHECK", 1e9)
    monkeypatch.setattr(trajectories, "DECISION_TIME", 10**18)


@pytest.mark.usefixtures("unhurried")
def test_one_with_many_pieces_is_decided_over_some_cycles() -> None:
    with TrajectoryRig() as rig:
        rig.set(trajectory_margin=1e-6)
        start = rig.node.cycle.monitor.total
        assert rig.go(LONG)[0].message == "forwarded"
        assert shares(rig) >= 3
        assert rig.node.cycle.monitor.total - start >= shares(rig) - 1


@pytest.mark.usefixtures("unhurried")
def test_it_is_refused_where_its_last_share_collides() -> None:
    with TrajectoryRig((-0.97, 0.24, 0.5)) as rig:
        rig.set(trajectory_margin=1e-6)
        status, _ = rig.go(LONG)
        assert status.message.startswith("refused: not free: arm/hand and crate/1")


def test_joints_that_turn_millions_of_times_do_not_block_the_node() -> None:
    spins = [(0.0, [0.0, 0.0]), *((float(n), [0.0, n * 1e12]) for n in range(1, 50))]
    with TrajectoryRig() as rig:
        for points in (spins, [spins[0], (1.0, [0.0, 1e299])]):
            status, values = rig.go(points)
            assert status.message.startswith("refused: not free")
            assert values["index"] == "1"


def test_what_takes_long_to_check_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trajectories, "LONGEST_CHECK", 0.0)
    with TrajectoryRig() as rig:
        rig.set(trajectory_margin=1e-6)
        status, _ = rig.go(LONG)
        assert status.message == "refused: not decided: to check it takes longer than 0 s"
        assert rig.go(QUARTER)[0].level == OK  # one piece


def test_what_happens_while_it_is_decided_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trajectories, "SHARE", 1)
    monkeypatch.setattr(trajectories, "DECISION_TIME", 10**12)
    with TrajectoryRig() as rig:
        rig.set(trajectory_margin=1e-6)
        rig.said.clear()
        rig.forwarded.clear()
        rig.publish(LONG)
        found = decider(rig)
        rig.until(lambda: found._deciding is not None and found._deciding.done > 2, "some shares")
        rig.put((0.0, 1.0, 9.0))  # another scene, in which it is checked from the start
        rig.until(lambda: found._deciding.done > 2, "some shares")
        rig.put((0.99, 0.1, 0.5))
        rig.until(lambda: rig.said, "the refusal")
        assert rig.said[0].message.startswith("refused: not free: arm/hand and crate/1")
        assert not rig.forwarded
        rig.put(FAR)
        rig.said.clear()
        rig.publish(LONG)
        rig.until(lambda: found._deciding is not None, "the next")
        rig.publish([])
        rig.until(lambda: len(rig.said) == 2, "a stop")
        texts = [status.message.partition(":")[0] for status in rig.said]
        assert texts == ["refused", "forwarded"]
        assert found._deciding is None
        assert [len(message.points) for message in rig.forwarded] == [0]
        rig.said.clear()
        rig.publish(LONG)
        rig.until(lambda: found._deciding, "the next").received -= trajectories.DECISION_TIME
        rig.until(lambda: rig.said, "the refusal")
        assert rig.said[0].message.startswith("refused: not decided")
        rig.said.clear()
        rig.publish(LONG)
        waiting = rig.until(lambda: found._deciding, "the next")
        rig.send_joints(lift=0.5)
        rig.until(lambda: 0.5 in rig.robot.joints.positions, "the joints")
        waiting.done = 10_000
        rig.until(lambda: rig.said, "the refusal")
        assert "not at its start" in rig.said[0].message
        assert found._running is None
        rig.send_joints(lift=0.0, turn=0.0)
        rig.answer()
        rig.said.clear()
        rig.publish([(time, q[1:], w[1:]) for time, q, w in LONG], ["turn"])
        rig.until(lambda: found._deciding, "the next")
        rig.send_joints(lift=0.5, turn=0.0)
        rig.until(lambda: rig.said, "the refusal")
        assert rig.said[0].message.startswith("refused: a joint that it does not name has moved")
