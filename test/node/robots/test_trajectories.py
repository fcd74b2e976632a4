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

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from each import each
from lifecycle_msgs.msg import Transition
from rclpy.serialization import serialize_message
from rig import LATCHED, Patch, cube
from robot_rig import BOTH, CRATE, URDF, AskingRig
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import Marker

from obb_collision.node.messages.conversions import stamp_to_ros
from obb_collision.node.robots import trajectories

NONE = [0.0, 0.0]
FAR = (9.0, 9.0, 9.0)
THERE = (0.0, 1.0, 0.5)
"""Where the hand is at a turn of 90 degrees."""
HIT = "not free: arm/hand and crate/1"
NAN = float("nan")
QUARTER = [(0.0, [0.0, 0.0]), (2.0, [0.0, np.pi / 2])]


@pytest.fixture
def rig(arm: AskingRig) -> AskingRig:
    arm.put(FAR)
    return arm


def test_a_trajectory_is_stopped_when_the_robot_or_the_node_goes() -> None:
    with AskingRig() as rig:
        rig.start_robot()
        rig.run()
        rig.read(URDF.replace('name="arm"', 'name="other"'))
        assert rig.stopped().startswith("stopped: ")
        rig.run()
        assert rig.change(Transition.TRANSITION_DEACTIVATE)
        assert "inactive" in rig.stopped()
        assert rig.change(Transition.TRANSITION_ACTIVATE)
        rig.run()
        rig.node.say_farewell()  # of a signal that ends the node
        assert "the node has stopped checking" in rig.stopped()
        rig.refused_for("the node has stopped checking", QUARTER)
        rig.node.say_farewell()  # nothing runs any more


def test_joints_between_clear_and_the_next_cycle_keep_nothing_running(rig: AskingRig) -> None:
    def joints(turn: float) -> bytes:
        message = JointState(header=rig.header(), name=list(BOTH), position=[0.0, turn])
        message.velocity = NONE
        return bytes(serialize_message(message))

    rig.known()
    node = rig.node
    point = JointTrajectoryPoint(positions=NONE, velocities=NONE, accelerations=NONE)
    trajectory = JointTrajectory(joint_names=list(BOTH), points=[point])
    for begin, end in ((0.0, 0.3), (1.4, 1.45)):
        rig.begin([(0.0, [0.0, begin]), (1000.0, [0.0, 1.5])])
        rig.robot.store_joints(joints(end), rig.now())
        assert node._clear(Trigger.Request(), Trigger.Response()).success
        for step in range(10):  # at 500 Hz, with nothing between them that looks at anything
            rig.robot.store_joints(joints(0.1 * step), rig.now())
        node.robots.callbacks(node.inputs)["arm/trajectory_in"](serialize_message(trajectory))
        rig.robot.store_joints(joints(1.4), rig.now())
        node.run_cycle()
        node.robots.hold("a later stop")
        rig.until(lambda: len(rig.said) == 2, "what is said")
        rig.stopped()
        said = [status.message for status in rig.said]
        assert said[0] == "stopped: all objects were removed"
        why = "scene not known: objects without a usable pose: arm/base/0"
        assert said[1].startswith(f"refused: {why}")
        stops = [[list(point.positions) for point in each.points] for each in rig.forwarded]
        assert stops == [[[0.0, end]], []], "where the joints were, and nothing more"
        rig.known()


def test_free_ones_are_forwarded_untouched_and_others_refused_with_where(rig: AskingRig) -> None:
    assert rig.forwards(QUARTER)["interpolation"] == "linear"
    rig.put(THERE)
    half = [(1.0, [0.0, np.pi / 4])]
    before = rig.refused("arm/trajectory_in").get("not free", 0)
    values = rig.refused_for(f"refused: {HIT}", [QUARTER[0], *half, *QUARTER[1:]])
    assert (values["first"], values["second"]) == ("arm/hand", "crate/1")
    assert values["index"] == "2"
    assert 1.5 < float(values["time (s)"]) < 2.0
    assert rig.refused("arm/trajectory_in") == {"not free": before + 1}
    rig.forwards([*QUARTER[:1], *half])
    rig.refused_for(HIT, [QUARTER[0], (2.0, [0.0, 2.5])])  # between its points
    rig.forwards([QUARTER[0], (1.0, [1.0, 0.0]), (2.0, [1.0, 2.5])])


@each("order", (1, 2))
def test_splines_swing_where_lines_do_not(order: int, rig: AskingRig) -> None:
    rest, swing = [[0.0, 0.0]] * (order - 1), [0.0, 4.0]
    swings = [(0.0, [0.0, 0.0], swing, *rest), (2.0, [0.0, 0.0], [0.0, -4.0], *rest)]
    rig.put(THERE)
    rig.forwards([(0.0, [0.0, 0.0]), (2.0, [0.0, 0.0])])
    assert 0.0 < float(rig.refused_for(HIT, swings)["time (s)"]) < 1.0
    rig.put(FAR)
    values = rig.forwards(swings)
    assert values["interpolation"] == ("cubic", "quintic")[order - 1]
    assert int(values["pieces"]) > 10


def test_one_point_that_lies_ahead_is_gone_to_from_where_the_joints_are(rig: AskingRig) -> None:
    on_the_way = (np.cos(0.8), np.sin(0.8), 0.5)
    rig.put(on_the_way)
    values = rig.refused_for(HIT, QUARTER[1:])
    assert values["index"] == "0"
    assert 0.5 < float(values["time (s)"]) < 1.5
    rig.put(FAR)
    rig.begin(QUARTER[1:])
    last: list[Any] = []
    rig.client.create_subscription(DiagnosticStatus, "arm/trajectory_status", last.append, LATCHED)
    assert rig.until(lambda: last, "what was said before")[0].message == "forwarded"
    rig.put(on_the_way)
    assert rig.stopped().startswith(f"stopped: {HIT}")
    for late in ([(0.0, QUARTER[1][1])], [(1.0, [0.0, 0.1]), *QUARTER[1:]]):
        rig.refused_for("not at its start", late)


def test_joints_that_are_not_named_stay_where_they_are(rig: AskingRig) -> None:
    turn = [(0.0, [0.0]), (2.0, [np.pi / 2])]
    rig.put((0.0, 1.0, 0.8))
    rig.begin(turn, ["turn"])
    rig.send_joints(lift=0.3, turn=0.0)
    assert rig.stopped() == "stopped: a joint outside the trajectory has moved: lift"
    rig.refused_for("refused", turn, ["turn"])


@each(
    "points, names, reason",
    [
        ([(0.0, [0.1, 0.0]), *QUARTER[1:]], BOTH, "not at its start"),
        ([QUARTER[0], (2.0, [0.0, 3.1])], BOTH, "joint arm/turn out of its limits"),
        ([QUARTER[0], (2.0, [0.0])], BOTH, "bad point"),
        ([QUARTER[0], (0.0, [0.0, 0.0])], BOTH, "its time does not increase"),
        ([QUARTER[0], (2.0, [0.0, NAN])], BOTH, "not finite"),
        (QUARTER, ("lift", "tail"), "unknown joint"),
        (QUARTER, ("lift", "lift"), "repeated joint"),
        ([(0.0, [0.0, 0.0], [0.0, 0.0]), (9.0, [0.0, 0.0], [0.0, 1e9])], BOTH, "too many pieces"),
        ([(1.0, [0.0, 0.0], [0.0, 0.0], [0.0, 0.0])], BOTH, "is not at time 0"),
        ([(0.0, NONE)] * 5001, BOTH, "refused: too many pieces: 5001 points, 5000 is the limit"),
        ([(0.0, [])] * 20_000, (), "refused: too many pieces: 20000 points, 5000 is the limit"),
    ],
)
def test_what_makes_no_sense_is_refused(points: Any, names: Any, reason: str, rig: Any) -> None:
    rig.refused_for(reason, points, names)
    assert rig.node.guard.total == 0


def stamped(rig: AskingRig, seconds: float) -> Header:
    """Return a header whose stamp is some time ahead of the node's clock."""
    return Header(stamp=stamp_to_ros(rig.now() + int(seconds * 1e9)))


def test_stamps_say_when_it_begins(rig: AskingRig) -> None:
    far = Header()
    far.stamp.sec = 5
    rig.refused_for("bad stamp", QUARTER, stamp=far)
    rig.set(stamp_tolerance=20.0)
    points = [(0.0, [0.0, 0.0], [0.0, 0.0]), (2.0, [0.0, -1.0], [0.0, 0.0])]
    rig.put((np.cos(0.25), np.sin(0.25), 0.5))
    rig.send_joints({"turn": 2.0}, lift=0.0, turn=0.0).answer()
    rig.forwards(points)  # at once: there is no time for a swing
    values = rig.refused_for(HIT, points, stamp=stamped(rig, 1.0))  # joints swing on until then
    assert values["index"] == "0"
    around = [(0.0, [0.0, 0.0]), (1.0, [1.0, 0.0]), (2.0, [1.0, 1.0])]
    around += [(3.0, [0.0, 1.0]), (30.0, [0.0, 1.1])]
    rig.put((np.cos(0.5), np.sin(0.5), 0.5))
    rig.move()
    rig.forwards(around)
    past = stamped(rig, -10.0)
    rig.refused_for(HIT, around, stamp=past)  # joints jump to where it is by now
    rig.put(FAR)
    rig.forwards(around, stamp=past)


def test_no_swing_begins_with_a_velocity_that_is_not_known() -> None:
    with AskingRig() as rig:
        rig.start_robot()
        rig.stamp += 2_000_000_000  # so long ago that no difference says how fast it is
        rig.send_joints({"turn": NAN}, lift=0.0, turn=0.0).answer()
        rig.refused_for("the velocity of joint turn is not known", [(1.0, NONE, NONE)])
        rig.forwards([(1.0, NONE)])
        rig.forwards([(0.0, NONE, NONE), (1.0, NONE, NONE)])


def test_a_trajectory_is_stopped_when_the_scene_changes_so_that_it_collides(rig: AskingRig) -> None:
    rig.next("collision_status")
    rig.run()
    rig.put((5.0, 5.0, 5.0))
    rig.cycles(2)
    assert not rig.said
    rig.put(THERE)
    assert rig.stopped().startswith(f"stopped: {HIT}")
    hold, empty = rig.forwarded
    assert [list(point.positions) for point in hold.points] == [[0.0, 0.0]]
    start = hold.points[0].time_from_start
    assert (start.sec, start.nanosec) == (0, 0)
    assert hold.joint_names == list(BOTH)
    assert empty == JointTrajectory(joint_names=list(BOTH))
    text = "robot arm: trajectory stopped: not free"
    rig.until(lambda: text in rig.last["collision_status"].status[0].message, text)
    rig.cycles(2)
    assert len(rig.said) == 1  # once
    rig.put(FAR)
    rig.forwards(QUARTER)
    rig.until(lambda: text not in rig.last["collision_status"].status[0].message, "no more")


def test_a_trajectory_is_stopped_for_each_reason_that_can_come(rig: AskingRig) -> None:
    crate = cube(CRATE, (0.0, 1.35, 0.85), (0.6, 0.6, 0.6), type=Marker.SPHERE)
    rig.send(crate).answer()
    rig.run()
    crate.type = Marker.CUBE  # another shape in the same box
    rig.send(crate)
    assert rig.stopped().startswith(f"stopped: {HIT}")
    rig.put((0.0, 1.2, 0.5))
    rig.run()
    rig.set(padding_overrides=["arm/*: 0.06"])
    assert rig.stopped().startswith(f"stopped: {HIT}")
    rig.set(padding_overrides=[""])
    rig.put(FAR)
    rig.run()
    rig.send_joints(lift=NAN)
    assert rig.stopped().startswith("stopped: scene not known")
    rig.refused_for("scene not known", QUARTER)
    assert rig.go([])[0].message == "forwarded: a stop"  # always
    rig.run()
    rig.move(turn=0.5)
    sent = rig.publish([], ["turn"])  # an empty one is a stop of what runs
    rig.until(lambda: len(rig.forwarded) == 2, "the stop")
    hold, empty = rig.forwarded
    assert [list(point.positions) for point in hold.points] == [[0.0, 0.5]]
    assert empty == sent


FAST = URDF.replace('upper="3"', 'upper="3" velocity="2"')
DECELERATION = 2.0


@each("curved", [False, True])
def test_a_stop_brakes_along_the_trajectory(rig: AskingRig, curved: bool) -> None:
    """Within decelerations, as ``joint_trajectory_controller`` moves from point to point."""
    rig.read(FAST)
    rig.set(joint_decelerations=[f"arm/*: {DECELERATION}"], trajectory_start_tolerance=0.02)
    rest = (NONE,) if curved else ()
    speeds = {"lift": 0.3, "turn": 1.0}
    rig.move()
    rig.begin([(0.0, NONE, *rest), (2.0, [0.6, 2.0], *rest)])
    rig.ends.trajectories.running.begin -= 500_000_000  # half a second has passed since
    begin = {"lift": 0.15, "turn": 0.5} if not curved else {"lift": 0.09375, "turn": 0.3125}
    if curved:  # 3/4 t^2 - 1/4 t^3 of 2 rad, at t = 0.5 s
        speeds = {"lift": 0.3 * 1.125, "turn": 1.125}
    rig.send_joints(speeds, **begin)
    rig.until(lambda: rig.robot.joints.velocities.any(), "the joints")
    rig.put((0.0, 1.0, 0.97))
    rig.until(lambda: rig.forwarded, "the stop")
    said = rig.until(lambda: rig.said, "why")[0].message
    assert said.startswith(f"stopped: {HIT}")
    (stop,) = rig.forwarded
    assert stop.joint_names == list(BOTH)
    here = np.array([[begin[name] for name in BOTH], [speeds[name] for name in BOTH]])
    points = [np.array([point.positions, point.velocities]) for point in stop.points]
    times = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in stop.points]
    assert not points[-1][1].any()
    first = points[0][0] - here[0]
    assert 0.0 < first[1] < 0.2, "not back to where it was heard last"
    for (before, start), (after, end) in pairwise(zip(points, times, strict=True)):
        time = end - start
        assert (after[0] >= before[0]).all()
        np.testing.assert_allclose(after[0][0], 0.3 * after[0][1], atol=2e-3)
        mean = (before[1] + after[1]) / 2.0
        np.testing.assert_allclose((after[0] - before[0]) / time, mean, atol=0.02)
        assert (np.abs(after[1] - before[1]) / time <= DECELERATION * 1.1).all()
    way = points[-1][0][1] - points[0][0][1]
    peak = 1.5 if curved else 1.0  # of the turn, which goes faster at first
    assert 0.75 * speeds["turn"] ** 2 < 2.0 * DECELERATION * way < peak**2


def test_where_velocities_are_unknown_a_stop_holds_the_latest_position() -> None:
    with AskingRig({"joint_decelerations": [f"arm/*: {DECELERATION}"]}) as rig:
        rig.start_robot(FAST)
        rig.stamp += 2_000_000_000  # so long ago that no difference says how fast it is
        rig.send_joints({"turn": NAN, "lift": NAN}, lift=0.0, turn=0.0).answer()
        rig.begin([(0.0, NONE), (1000.0, [0.0, 2.0])])
        rig.put(THERE)
        rig.stopped()
        assert [list(point.positions) for point in rig.forwarded[0].points] == [NONE]


SHORT = [(0.0, [0.0, 0.0]), (0.001, [0.0, np.pi / 2]), (0.002, [0.5, np.pi / 2])]
"""Long past when a test goes on: a robot that is behind goes slower than planned."""


@each("turn, place", ((0.0, THERE), (np.pi / 2, (0.0, 1.0, 1.0))))
def test_it_counts_until_a_slow_robot_is_there(turn: float, place: Any, rig: AskingRig) -> None:
    rig.put(FAR)
    for given in (0.0, None, turn / 2.0, turn):
        if given is None:
            rig.begin(SHORT)
            rig.cycles(3)
            continue
        rig.move(turn=given)
    rig.put(place)
    assert rig.stopped().startswith(f"stopped: {HIT}")


def test_what_the_robot_has_behind_it_counts_no_more(rig: AskingRig) -> None:
    rig.begin(SHORT)
    for lift, place in ((0.25, (1.0, 0.0, 0.5)), (0.5, (0.0, 1.0, 1.0))):
        rig.send_joints(lift=lift, turn=np.pi / 2).answer()
        rig.cycles(2)
        rig.put(place)
        rig.cycles(2)
        assert not rig.said


LONG = [(0.0, [0.0, 0.0], [0.0, 0.0]), (1000.0, [0.0, 2.9], [0.0, 0.0])]
"""With velocities, and a small margin, it has thousands of pieces."""


def test_one_of_many_pieces_is_decided_over_cycles(rig: AskingRig, monkeypatch: Patch) -> None:
    monkeypatch.setattr(trajectories, "LONGEST_CHECK", 1e9)  # however loaded the machine is
    monkeypatch.setattr(trajectories, "DECISION_TIME", 10**18)
    rig.set(trajectory_margin=1e-6)
    start = rig.node.cycle.monitor.total
    shares = -(-int(rig.begin(LONG)["pieces"]) // trajectories.SHARE)
    assert shares >= 3
    assert rig.node.cycle.monitor.total - start >= shares - 1
    rig.rest()
    rig.put((-0.97, 0.24, 0.5))  # in the way of the last share
    rig.refused_for(HIT, LONG)


def test_what_takes_long_to_check_is_refused(rig: AskingRig, monkeypatch: Patch) -> None:
    spins = [(0.0, [0.0, 0.0]), *((float(n), [0.0, n * 1e12]) for n in range(1, 50))]
    for points in (spins, [spins[0], (1.0, [0.0, 1e299])]):  # millions of turns
        assert rig.refused_for("refused: not free", points)["index"] == "1"
    monkeypatch.setattr(trajectories, "LONGEST_CHECK", 0.0)
    rig.set(trajectory_margin=1e-6)
    rig.refused_for("refused: not decided: the check takes longer than 0 s", LONG)
    rig.forwards(QUARTER)  # one piece


def test_what_happens_while_it_is_decided_counts(rig: AskingRig, monkeypatch: Patch) -> None:
    monkeypatch.setattr(trajectories, "SHARE", 1)
    monkeypatch.setattr(trajectories, "DECISION_TIME", 10**12)
    rig.set(trajectory_margin=1e-6)
    rig.publish(LONG)
    found = rig.ends.trajectories
    rig.until(lambda: found.deciding is not None and found.deciding.done > 2, "some shares")
    rig.put((0.0, 1.0, 9.0))  # another scene, in which it is checked from the start
    rig.until(lambda: found.deciding.done > 2, "some shares")
    rig.put((0.99, 0.1, 0.5))
    rig.until(lambda: rig.said, "the refusal")
    assert rig.said[0].message.startswith("refused: not free: arm/hand and crate/1")
    assert not rig.forwarded
    rig.put(FAR)
    rig.publish(LONG)
    rig.until(lambda: found.deciding is not None, "the next")
    rig.publish([])
    rig.until(lambda: len(rig.said) == 2, "a stop")
    texts = [status.message.partition(":")[0] for status in rig.said]
    assert texts == ["refused", "forwarded"]
    assert found.deciding is None
    assert [len(message.points) for message in rig.forwarded] == [0]
    rig.publish(LONG)
    rig.until(lambda: found.deciding, "the next").received -= trajectories.DECISION_TIME
    rig.until(lambda: rig.said, "the refusal")
    assert rig.said[0].message.startswith("refused: not decided")
    rig.publish(LONG)
    waiting = rig.until(lambda: found.deciding, "the next")
    rig.send_joints(lift=0.5)
    rig.until(lambda: 0.5 in rig.robot.joints.positions, "the joints")
    waiting.done = 10_000
    rig.until(lambda: rig.said, "the refusal")
    assert "not at its start" in rig.said[0].message
    assert found.running is None
    rig.move()
    rig.publish([(time, q[1:], w[1:]) for time, q, w in LONG], ["turn"])
    rig.until(lambda: found.deciding, "the next")
    rig.send_joints(lift=0.5, turn=0.0)
    rig.until(lambda: rig.said, "the refusal")
    assert rig.said[0].message.startswith("refused: a joint outside the trajectory has moved")
