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

"""How fast a robot may move: not at all where anything is unknown, and freely where it leaves."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from time import monotonic
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from each import each
from rclpy.serialization import serialize_message
from rig import Patch, cube, pose
from robot_rig import CRATE, EDGES, URDF, AskingRig, box
from sensor_msgs.msg import JointState
from sensor_rig import Sensing, parameters_of
from std_msgs.msg import Float64
from test_attached_and_hostile import held, put
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from obb_collision.node.robots import speed as speeds
from obb_collision.node.robots.checked_robot import MOST_SCENES, NodeRobotScene
from obb_collision.typing import Floats

ABOVE = (1.0, 0.0, 1.25)
"""Where the crate is 0.6 m above the hand."""
NAN, INF = float("nan"), float("inf")


class Speed:
    """The scales of a robot, with a crate above its hand."""

    def __init__(self, rig: AskingRig, **given: Any) -> None:
        limits = {"speed_stop_distance": 0.1, "speed_slow_distance": 1.1}
        rig.set(**(limits | {"speed_reaction_time": 0.0} | given))
        self.rig, self.scales = rig, list[float]()
        self.end = rig.client.create_subscription(Float64, "arm/speed_scale", self._take, 10)
        rig.until(lambda: len(self.scales) > 1, "a scale")

    def _take(self, message: Float64) -> None:
        self.scales.append(message.data)

    def scale(self) -> float:
        """Return the scale after the answer to all that was sent."""
        self.rig.answer()
        self.scales.clear()
        self.rig.until(lambda: len(self.scales) > 1, "a scale")
        return self.scales[-1]

    def of(self, lift: float, *velocity: float) -> float:
        """Return the scale after joint states, with the velocities or without any."""
        message = JointState(header=self.rig.header(), name=["lift", "turn"], position=[lift, 0.0])
        message.velocity = list(velocity)
        self.rig.joint_states.publish(message)
        return self.scale()


@pytest.fixture
def speed(arm: AskingRig) -> Iterator[Speed]:
    """Return the scales of a robot whose speed counts for half a second."""
    made = Speed(arm, speed_reaction_time=0.5)
    arm.put(ABOVE)
    yield made
    arm.client.destroy_subscription(made.end)


def test_the_scale_falls_with_the_distance(speed: Speed) -> None:
    speed.rig.set(speed_reaction_time=0.0)
    for lift, turn, expected in ((0.0, 0.0, 0.5), (0.25, 0.0, 0.25), (0.52, 0.0, 0.0), (0, 3, 1)):
        speed.rig.send_joints(lift=lift, turn=turn)
        assert speed.scale() == pytest.approx(expected, abs=1e-6 * (0.0 < expected < 1.0))
    (result,) = speed.rig.set(speed_stop_distance=2.0)
    assert not result.successful
    assert "must exceed" in result.reason, "slow is beyond stop"
    speed.rig.start_robot(URDF.replace("</link>", f"{box(0.9)}</link>", 1), lift=-0.5)
    assert speed.scale() == 0.0, "links collide"


def test_what_stands_beside_a_link_that_no_joint_moves_is_no_reason_to_slow_down(
    speed: Speed, monkeypatch: Patch
) -> None:
    now = [monotonic()]
    monkeypatch.setattr(speeds, "monotonic", lambda: now[0])
    rig = speed.rig
    rig.set(speed_reaction_time=0.0)
    table = ("table", 1)
    rig.put((9.0, 9.0, 9.0))
    rig.send(cube(table, (0.0, 0.0, -0.65))).answer()  # 5 cm below the base
    assert speed.scale() == 0.0, "it has just come"
    now[0] += 2.0
    assert speed.scale() > 0.0
    rig.set(speed_still_pairs=True)
    assert speed.scale() == 0.0
    rig.set(speed_still_pairs=False)
    assert speed.scale() > 0.0
    rig.send(cube(table, (0.01, 0.0, -0.65))).answer()
    assert speed.scale() == 0.0, "it moves"
    now[0] += 2.0
    assert speed.scale() > 0.0
    rig.send_states(["table/1"], [pose(0.01, 0.0, -0.65)])
    now[0] += 2.0
    assert speed.scale() == 0.0, "it is tracked"


def test_the_scale_falls_with_speeds(speed: Speed) -> None:
    speed.rig.send_joints({"lift": 0.4}, lift=0.0, turn=0.0)
    assert speed.scale() == pytest.approx(0.3, abs=1e-4)
    speed.rig.send_states(["crate/1"], [pose(*ABOVE)], twists=[[0.2, 0, 0, 0, 0, 0]])
    assert speed.scale() == pytest.approx(0.2, abs=1e-4)


def test_the_scale_is_zero_while_anything_is_not_known() -> None:
    with AskingRig() as rig:
        speed = Speed(rig)
        assert set(speed.scales) == {0.0}
        rig.start_robot()
        rig.put(ABOVE)
        assert speed.scale() > 0.0
        rig.send_joints(lift=NAN)
        rig.until(lambda: speed.scales[-1] == 0.0, "a stop")


@each("velocity", [(), (NAN, NAN), (NAN, 0.0), (1e301, 0.0), (INF, 0.0)])
def test_without_velocities_they_are_differences(speed: Speed, velocity: tuple[float, ...]) -> None:
    speed.of(-4e-4, *velocity)
    assert speed.of(0.0, *velocity) == pytest.approx(0.3, abs=1e-4)  # a millisecond later
    speed.rig.stamp -= 1_000_000
    assert speed.of(0.0, *velocity) == pytest.approx(0.3, abs=1e-4)  # with the same stamp
    assert speed.of(0.0, *velocity) == pytest.approx(0.5, abs=1e-4)


def test_the_scale_is_zero_where_speeds_are_too_large(speed: Speed) -> None:
    assert speed.of(0.0, 1e300, 0.0) == 0.0
    assert speed.rig.node.guard.total == 0
    assert speed.of(0.0) == pytest.approx(0.5, abs=1e-6)


@each("limit, scale", [("0.4", 0.3), ("0", 0.0)])
def test_with_one_state_a_joint_goes_at_its_limit(speed: Speed, limit: str, scale: float) -> None:
    rig = speed.rig
    rig.read(URDF.replace('upper="3"', f'upper="3" velocity="{limit}"', 1))
    assert speed.of(0.0, NAN, 0.0) == pytest.approx(scale, abs=1e-6)
    why = "joints without a velocity and without a velocity limit: lift"
    text = "" if scale else f"robot arm: speed_scale is 0: {why}"
    rig.until(lambda: rig.known()["message"] == f"free{text and '; '}{text}", "the reason")
    rig.until(lambda: rig.status("robot arm").get("speed_scale is 0", "") == why * (not scale))


def test_of_some_joints_of_unknown_velocity_no_two_cancel_out(speed: Speed) -> None:
    """Two joints about opposite axes, at most 1 rad/s each: the hand is as fast as both."""
    urdf = URDF.replace('upper="3"', 'upper="3" velocity="1"').replace("prismatic", "revolute")
    speed.rig.set(speed_reaction_time=0.1, speed_slow_distance=2.1)
    for axis in ("0 0 1", "0 0 -1"):
        speed.rig.read(urdf.replace('xyz="0 0 1"', f'xyz="{axis}"', 1))
        assert 0.0 < speed.of(0.0, NAN, NAN) <= (0.6 - 0.1 - 0.1 * 2 * 1.1) / 2.0


FAST = URDF.replace('upper="3"', 'upper="3" velocity="1"')
DOWN, UP = (-1.0, 0.0), (1.0, 0.0)


@pytest.fixture
def directed(speed: Speed) -> Speed:
    """Return the scales, by direction, of a robot with a crate above its hand."""
    speed.rig.read(FAST)
    speed.rig.set(joint_decelerations=["arm/*: 2.0"], speed_stop_distance=0.05)
    speed.rig.set(speed_reaction_time=0.1)
    return speed


def test_by_direction_only_what_closes_is_slowed(directed: Speed) -> None:
    """The crate is 0.6 m above the hand at a lift of zero."""
    assert directed.of(0.0, *UP) == 1.0
    assert directed.of(0.45, *UP) == 0.0, "too fast to stop"
    slower = directed.of(0.45, 0.1, 0.0)  # 0.1 m = s 0.1 m + s^2 / 2 0.5 m
    assert slower == pytest.approx((-0.1 + 0.11**0.5) / 0.5, abs=1e-3)
    assert directed.of(0.45, *DOWN) == 1.0
    assert directed.of(0.45, 0.0, 0.5) == 1.0, "along"
    assert directed.of(0.45, 0.0, 0.0) == 1.0 > directed.of(0.53, 0.0, 0.0) > 0.0, "it may set off"
    assert directed.of(0.57, *DOWN) == 1.0, "from within the stop distance"
    assert directed.of(0.57, 0.02, 0.0) == directed.of(0.57, 0.0, 0.0) == 0.0
    assert directed.of(0.65, *DOWN) == 0.0, "it collides"
    directed.rig.set(joint_decelerations=["arm/lift: 2.0"])
    assert directed.of(0.45, *DOWN) == pytest.approx(0.0, abs=0.1), "by distance"


def test_a_jog_says_where_a_robot_at_rest_will_go(directed: Speed) -> None:
    rig, names = directed.rig, ["lift"]
    jogs = rig.client.create_publisher(JointTrajectory, "arm/jog_in", 1)
    rig.until(jogs.get_subscription_count, "the node")

    def scale(lift: float, *velocity: float) -> float:
        """Return the scale beside a jog that goes on."""
        directed.of(lift, 0.0, 0.0)
        directed.scales.clear()
        point = JointTrajectoryPoint(velocities=list(velocity))
        jog = JointTrajectory(joint_names=names, points=[point] if velocity else [])

        def goes_on() -> bool:
            jogs.publish(jog)
            return len(directed.scales) > 5

        rig.until(goes_on, "scales")
        return directed.scales[-1]

    rests = directed.of(0.57, 0.0, 0.0), directed.of(0.53, 0.0, 0.0)
    assert scale(0.57, -0.3) == 1.0
    assert scale(0.57, 0.3) == rests[0] == 0.0
    assert scale(0.53, 0.1) == 1.0 > scale(0.53, 1.0) > 0.0, "a slow one stops soon"
    rig.until(lambda: directed.scales[-1] == rests[1], "the end of the jog")
    assert scale(0.57) == scale(0.57, 5.0) == scale(0.57, NAN) == 0.0
    assert set(rig.refused("arm/jog_in")) == {"bad point"}


def test_scenes_of_margins_that_are_no_longer_set_are_dropped(directed: Speed) -> None:
    for number in range(8):
        directed.rig.set(speed_stop_distance=0.05 + 0.001 * number)
        directed.of(0.45, 0.1, 0.0)
    gc.collect()
    assert sum(isinstance(thing, NodeRobotScene) for thing in gc.get_objects()) <= MOST_SCENES


def test_by_direction_objects_come_nearer_too(directed: Speed) -> None:
    """A robot that goes away from an object that is faster is slowed."""
    for speed, leaving, coming in ((0.3, 1.0, 0.354), (3.0, 0.0, 0.0)):
        twist = [0.0, 0.0, -speed, 0.0, 0.0, 0.0]
        directed.rig.send_states(["crate/1"], [pose(*ABOVE)], twists=[twist])
        assert directed.of(0.4, -0.9, 0.0) == leaving
        assert directed.of(0.4, 0.9, 0.0) == pytest.approx(coming, abs=1e-3)


def test_the_scale_is_a_factor_of_ros2_control_too(directed: Speed, monkeypatch: Patch) -> None:
    """As SpeedScalingFactor of control_msgs, which has no wheel."""
    sent: list[Any] = []
    end: Any = SimpleNamespace(publish=sent.append, get_subscription_count=lambda: 1)
    monkeypatch.setattr(speeds, "SpeedScalingFactor", SimpleNamespace)
    scale = directed.of(0.53, 0.0, 0.0)
    speeds.SpeedScale(directed.rig.ends.checked, end, end).publish()
    assert [*vars(sent[1])] == ["factor"]
    assert sent[1].factor == sent[0].data == scale > 0.0


def test_what_is_attached_has_directions_too(directed: Speed) -> None:
    rig = directed.rig
    put(rig, held((1.0, 0.0, 0.3)), cube(CRATE, ABOVE, EDGES))
    assert directed.of(0.31, *DOWN) == 1.0
    assert directed.of(0.31, 0.1, 0.0) == 0.0, "the tool is within the stop distance"


LINK = '<link name="{}"><collision><geometry><sphere radius="0.06"/></geometry></collision></link>'
JOINT = (
    '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/>'
    '<origin xyz="{3} 0 0"/><axis xyz="{4}"/>'
    '<limit lower="-9" upper="9" effort="1" velocity="{5}"/></joint>'
)
BONES = (0.0, 0.4, 0.35, 0.2)
"""Metres from each joint to the next: a shoulder that turns and lifts, an elbow and a wrist."""
AXES = ("0 0 1", "0 1 0", "0 1 0", "0 0 1")
NAMES = ["j0", "j1", "j2", "j3"]
SPEEDS, DECELERATIONS = np.array([1.5, 1.5, 2.0, 3.0]), np.array([5.0, 5.0, 8.0, 12.0])
RADIUS, EDGE, POINT, STOP = 0.06, 0.1, 0.01, 0.03
"""Metres: of balls, half of cubes, of points, and the stop distance."""
FAR = 0.45
"""Metres: beyond, nothing slows."""
STEP, STEPS, LATENCY = 0.01, 60, 4
"""Seconds of a step, steps of a jog, and until a scale acts."""


def arm_of_balls() -> str:
    """Return the URDF of an arm whose links are balls, at each joint and at the tip."""
    links = ["root", "a", "b", "c", "d", "tip"]
    text = '<link name="root"/>' + "".join(LINK.format(name) for name in links[1:])
    for row, (bone, axis) in enumerate(zip(BONES, AXES, strict=True)):
        text += JOINT.format(f"j{row}", links[row], links[row + 1], bone, axis, SPEEDS[row])
    tip = '<joint name="t" type="fixed"><parent link="d"/><child link="tip"/>'
    return f'<robot name="arm">{text}{tip}<origin xyz="0.15 0 0"/></joint></robot>'


def ball_centers(joints: Floats) -> Floats:
    """Return the centers (5, 3) of the balls, by rotation matrices."""
    place, turn, centers = np.zeros(3), np.eye(3), []
    for bone, axis, angle in zip(BONES, AXES, joints, strict=True):
        place = place + turn @ (bone, 0.0, 0.0)
        c, s = np.cos(angle), np.sin(angle)
        yaw = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        turn = turn @ (yaw if axis == "0 0 1" else np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]))
        centers.append(place)
    return np.array([*centers, place + turn @ (0.15, 0.0, 0.0)])


def ball_gaps(joints: Floats, cubes: Floats, points: Floats) -> Floats:
    """Return the distances (4, n) of the balls that joints move from cubes and points (., 3)."""
    centers = ball_centers(joints)[1:, None]
    outside = np.maximum(np.abs(centers - cubes) - EDGE, 0.0)
    gaps = np.linalg.norm(outside, axis=2), np.linalg.norm(centers - points, axis=2) - POINT
    return np.hstack(gaps) - RADIUS


class Jogged:
    """An arm in a simulation, which the node knows by joint states and slows by its scale.

    is_told: whether the node gets the jog, too.
    """

    def __init__(self, rig: SeeingRig, rng: np.random.Generator, is_told: bool) -> None:
        self.rig, self.is_told = rig, is_told
        rig.ends.speed.jog._latest = None
        while True:
            cubes, points = rng.uniform(-0.9, 0.9, (4, 3)), rng.uniform(-0.9, 0.9, (1, 3))
            points = points + rng.normal(0.0, 0.05, (40, 3))
            self.joints = rng.uniform(-1.2, 1.2, 4)
            self.around = cubes, points
            near = min(np.abs(cubes).max(axis=1).min() - EDGE, np.abs(points).max(axis=1).min())
            centers = ball_centers(self.joints)
            own = np.linalg.norm(centers[:, None] - centers, axis=2)[np.triu_indices(5, 2)].min()
            if near > RADIUS + STOP + POINT and own > 0.2 and 1e-3 < self.gaps.min() < 0.2:
                break
        markers = [cube(("cube", n), at, (2 * EDGE,) * 3) for n, at in enumerate(cubes)]
        self.tell(np.zeros(4))
        rig.send(*markers).answer()
        rig.see(points)
        rig.answer()

    @property
    def gaps(self) -> Floats:
        """Distances of balls from everything."""
        return ball_gaps(self.joints, *self.around)

    def leaves(self, wanted: Floats) -> bool:
        """Return whether a jog leads away from all that is near."""
        way = [self.joints + k * STEP * wanted for k in range(STEPS + 20)]
        gaps = np.array([ball_gaps(joints, *self.around) for joints in way])
        opens = (np.diff(gaps, axis=0) > 0.0).all(axis=0)
        return bool((opens | (gaps.min(axis=0) > FAR)).all())

    def tell(self, velocities: Floats) -> None:
        """Give the node a state of the joints."""
        message = JointState(header=self.rig.header(), name=NAMES)
        message.position, message.velocity = self.joints.tolist(), velocities.tolist()
        self.rig.robot.store_joints(bytes(serialize_message(message)), self.rig.now())

    def command(self, wanted: Floats) -> None:
        """Give the node the jog, if it is told."""
        if self.is_told:
            rest = [0.0] * 4
            values = {"positions": rest, "velocities": wanted.tolist(), "accelerations": rest}
            message = JointTrajectory(joint_names=NAMES, points=[JointTrajectoryPoint(**values)])
            self.rig.ends.speed.jog.receive(bytes(serialize_message(message)), self.rig.now())

    def jog(self, wanted: Floats) -> tuple[Floats, Floats, Floats]:
        """Jog from rest at velocities that scales multiply.

        Returns the scales (STEPS,), the distances (STEPS, ...) and the share of the velocities.
        """
        change = STEP / float((np.abs(wanted) / DECELERATIONS).max())
        share, waiting, scales, gaps, shares = 0.0, [0.0] * LATENCY, [], [], []
        for _ in range(STEPS):
            self.command(wanted)
            waiting.append(self.rig.ends.speed._scale())
            scales.append(waiting[-1])
            shares.append(share)
            before, target = share, waiting.pop(0)
            share = min(max(target, share - change), share + change)
            self.joints = self.joints + 0.5 * (before + share) * STEP * wanted
            gaps.append(self.gaps)
            self.tell(share * wanted)
        self.tell(np.zeros(4))
        return np.array(scales), np.array(gaps), np.array(shares)


def some_jog(rng: np.random.Generator, share: float) -> Floats:
    """Return velocities of some joints, at a share of their limits."""
    jog = rng.normal(size=4) * (rng.random(4) < 0.7) + (0.0, 0.0, 1e-3, 0.0)
    return jog * share / (np.abs(jog) / SPEEDS).max()


def ways_of(arm: Jogged, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return a jog and its reverse; one of them leads away from everything, often."""
    for _ in range(10):
        jog = some_jog(rng, rng.uniform(0.1, 1.0))
        if arm.leaves(jog):
            break
    return jog, -jog


class SeeingRig(Sensing, AskingRig):
    """A rig with the arm of balls and a sensor."""

    def __init__(self) -> None:
        given = parameters_of({"front": {}}) | {
            "joint_decelerations": [f"arm/j{k}: {a}" for k, a in enumerate(DECELERATIONS)],
            "speed_stop_distance": STOP,
            "speed_reaction_time": (LATENCY + 1) * STEP,
        }
        super().__init__(given)
        self.start_sensors({"front": {}})
        self.read(arm_of_balls())


@pytest.fixture(scope="module")
def seeing() -> Iterator[SeeingRig]:
    with SeeingRig() as made:
        yield made


def test_distances_grow_at_the_rates_that_differences_have(seeing: SeeingRig) -> None:
    rng, step = np.random.default_rng(2), 1e-6
    for _ in range(20):
        arm = Jogged(seeing, rng, is_told=False)
        wanted, scene = some_jog(rng, 1.0), seeing.ends.checked.scene()
        ways = [ball_gaps(arm.joints + k * step * wanted, *arm.around) for k in (-1, 0, 1)]
        distances, slots, rates = scene.rates(arm.joints[None], wanted, 0.5)
        cubes = np.isin(
            slots, seeing.node.objects.table.find_named([f"cube/{k}" for k in range(4)])
        )
        for mine, columns in ((cubes, slice(0, 4)), (~cubes, slice(4, None))):
            before, here, after = (way[:, columns].ravel() for way in ways)
            near = here < 0.5
            expected = np.column_stack([here, (after - before) / (2.0 * step)])[near]
            found = np.column_stack([distances[mine], rates[mine]])
            order, wanted_order = np.argsort(found[:, 0]), np.argsort(expected[:, 0])
            np.testing.assert_allclose(found[order], expected[wanted_order], atol=1e-4)


@pytest.mark.parametrize("is_told", [True, False])
def test_the_scale_is_as_late_as_stopping_allows(seeing: SeeingRig, is_told: bool) -> None:
    """Beside ways of a jog, or of the joints, sampled by brute force."""
    rng, partly = np.random.default_rng(1), 0
    reaction = (LATENCY + 1) * STEP
    for _ in range(150):
        arm = Jogged(seeing, rng, is_told)
        wanted = some_jog(rng, rng.uniform(0.1, 1.0) if is_told else 1.0)
        braking = float((np.abs(wanted) / DECELERATIONS).max())
        present = rng.uniform(0.05, 0.2)
        arm.tell(present * wanted)
        arm.command(wanted)
        scale = seeing.ends.speed._scale()
        times = np.linspace(0.0, reaction + 0.5 * braking, 301)
        ways = [ball_gaps(arm.joints + t * wanted, *arm.around) for t in times]
        least = np.array([way.min() for way in ways])
        if least[0] < STOP:
            near = ways[0] < STOP + 1e-6
            if np.abs(ways[1] - ways[0])[near].min() > 1e-7 and abs(least.min()) > 1e-3:
                assert scale == float((ways[1] > ways[0])[near].all() and least.min() > 0.0)
            continue
        inside = np.flatnonzero(least < STOP)
        left = times[inside[0]] if len(inside) else times[-1]
        grid = np.linspace(0.0, 1.0, 2001)
        spent = grid * reaction + 0.5 * grid**2 * braking
        slower = present * reaction + 0.5 * grid**2 * braking
        in_time = np.where(grid < present, slower, spent) <= left + 1e-9
        assert scale == pytest.approx(grid[in_time].max(initial=0.0), abs=0.03)
        partly += 0.0 < scale < 1.0
    assert partly > 10


@pytest.mark.parametrize("count", [12, pytest.param(500, marks=pytest.mark.slow)])
@pytest.mark.parametrize("is_told", [True, False])
def test_jogs_never_touch_and_what_opens_does_not_slow(
    seeing: SeeingRig, count: int, is_told: bool
) -> None:
    """Jogs, and back again: with the jog told, or only the velocities that joints have."""
    rng, slowed, left = np.random.default_rng(count), 0, 0
    for _ in range(count):
        arm = Jogged(seeing, rng, is_told)
        for wanted in ways_of(arm, rng):
            before, leads_away = arm.gaps.min(), arm.leaves(wanted)
            scales, gaps, shares = arm.jog(wanted)
            assert gaps.min() >= min(before, STOP - 2e-3) > 0.0, (
                "a scale that falls is followed late"
            )
            slowed += scales[-1] < 0.5
            if leads_away:
                knows = is_told | (shares * (np.abs(wanted) / SPEEDS).max() > 0.02)
                assert (scales[knows] == 1.0).all(), "it leads away from all that is near"
                left += knows.any()
    assert min(slowed, left) > count / 10
