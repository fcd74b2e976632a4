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

"""Motions of the demo: by one object at a time, by differences, and the errors of their files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from each import each
from scipy.spatial.transform import Rotation

import obb_collision as oc
from obb_collision.demo.motion import Motions, Track, object_track, read_motions
from obb_collision.demo.sensors import World
from obb_collision.geometry.poses import Pose
from obb_collision.scene_files import (
    READY,
    SceneDescription,
    SceneFileError,
    SceneObject,
    find_scene,
    load_scene,
)
from obb_collision.shapes import Sphere

#: Seconds between two poses of which the difference is compared with the twist.
STEP = 1e-6
TIMES = np.arange(0.013, 20.0, 0.37)


def motions_of(name: str) -> Motions:
    return read_motions(load_scene(name), find_scene(name))


@pytest.fixture(params=READY)
def ready(request: pytest.FixtureRequest) -> Motions:
    """Return the motions of one of the scenes of the package."""
    return motions_of(request.param)


def test_ready_scenes_collide_only_later(ready: Motions) -> None:
    names, scene = ready.description.names, ready.description.build()
    seen: set[tuple[str, str]] = set()
    for time in TIMES:
        scene.move(names, ready.states(float(time))[0])
        seen.update(scene.check().names())
    assert seen or ready.sensors or ready.robots


def test_the_stop_zone_is_free_at_first_and_then_is_not() -> None:
    motions = motions_of("lidar_zone")
    zone, counts = motions.description.build().obb("zone/0"), []
    (lidar,), world = motions.sensors, World(motions)
    for time in (0.0, 10.0):
        world.place(time)
        counts.append(np.count_nonzero(zone.contains(world.see(lidar, time).points)))
    assert counts[0] == 0
    assert counts[1] > 20


def test_twists_are_how_poses_change(ready: Motions) -> None:
    for time in TIMES.tolist():
        (before, twists), (after, _) = ready.states(time), ready.states(time + STEP)
        moved = (after[:, :3] - before[:, :3]) / STEP
        turns = Rotation.from_quat(after[:, 3:]) * Rotation.from_quat(before[:, 3:]).inv()
        np.testing.assert_allclose(moved, twists[:, :3], atol=1e-5)
        np.testing.assert_allclose(turns.as_rotvec() / STEP, twists[:, 3:], atol=1e-5)


def test_what_rests_has_its_pose_bit_for_bit_and_no_twist(ready: Motions) -> None:
    poses, twists = ready.states(7.0)
    starts = [obj.pose for obj in ready.description.objects]
    for row in set(range(len(starts))) - set(ready.moving):
        assert (*poses[row].tolist(),) == starts[row]
        assert not twists[row].any()
    np.testing.assert_allclose(ready.states(0.0)[0], starts, atol=1e-12)


RNG = np.random.default_rng(8)


def random_pose() -> Pose:
    x, y, z = RNG.uniform(-3.0, 3.0, 3).tolist()
    qx, qy, qz, qw = Rotation.random(random_state=RNG.integers(2**31)).as_quat().tolist()
    return x, y, z, qx, qy, qz, qw


def random_track(leader: str | None = None) -> Track:
    poses = np.array([random_pose(), random_pose(), random_pose()])
    return object_track(poses, [0.0, 0.5, 2.0], 3.0, leader)


STARTS = {
    name: random_pose() for name in ("post", "train", "load", "fly", "shadow", "sign", "belt")
}
TRACKS = {
    "train": random_track(),
    "load": object_track(np.array([random_pose()]), [0.0], leader="train"),
    "fly": random_track("load"),
    "shadow": object_track(np.array([random_pose()]), [0.0], leader="fly"),
    "sign": object_track(np.array([random_pose()]), [0.0], leader="post"),
    "belt": object_track(np.array([random_pose(), random_pose()]), [0.0, 1.25], 1.25),
}

State = tuple[np.ndarray, Rotation, np.ndarray, np.ndarray]


def expected(name: str, time: float) -> State:
    """Return position, rotation, velocity and angular velocity of an object."""
    still = np.zeros(3)
    if name not in TRACKS:
        return np.array(STARTS[name][:3]), Rotation.from_quat(STARTS[name][3:]), still, still
    track = TRACKS[name]
    passed = time % track.period
    leg = int(np.searchsorted(track.times, passed, side="right")) - 1
    velocity, turn = track.velocities[leg, :3], track.velocities[leg, 3:]
    seconds, begin = passed - track.times[leg], track.waypoints[leg]
    state = (
        begin[:3] + velocity * seconds,
        Rotation.from_rotvec(turn * seconds) * Rotation.from_quat(begin[3:]),
        velocity,
        turn,
    )
    if track.leader is None:
        return state
    place, rotation, velocity, turn = expected(track.leader, time)
    arm = rotation.apply(state[0])
    moving = velocity + np.cross(turn, arm) + rotation.apply(state[2])
    return place + arm, rotation * state[1], moving, turn + rotation.apply(state[3])


@each("time", [0.0, 0.3, 0.5, 1.7, 2.9, 100.3])
def test_states_agree_with_one_object_at_a_time(time: float) -> None:
    objects = tuple(SceneObject(name, Sphere(1.0), pose) for name, pose in STARTS.items())
    poses, twists = Motions(SceneDescription("all", objects), TRACKS).states(time)
    for row, name in enumerate(STARTS):
        place, rotation, velocity, turn = expected(name, time)
        np.testing.assert_allclose(poses[row, :3], place, atol=1e-12)
        matrix = Rotation.from_quat(poses[row, 3:]).as_matrix()
        np.testing.assert_allclose(matrix, rotation.as_matrix(), atol=1e-12)
        np.testing.assert_allclose(twists[row], np.r_[velocity, turn], atol=1e-12)


SCENE = """\
objects:
- {name: a, shape: sphere, radius: 1, position: [1, 2, 3], rpy: [0, 0, 0.5]}
- {name: b, shape: sphere, radius: 1}
robots: [{name: arm, urdf: arm.urdf}]
"""


def read(folder: Path, text: str) -> Motions:
    """Return the motions in a text, of a scene with an arm."""
    for name in ("arm.urdf", "arm_finger.obj"):
        (folder / name).write_bytes((find_scene("arm_cell").parent / name).read_bytes())
    file = folder / "cell.yaml"
    file.write_text(SCENE)
    file.with_name("cell.motion.yaml").write_text(text)
    return read_motions(load_scene(file), file)


def test_a_round_begins_in_the_scene_and_leads_back_or_jumps(tmp_path: Path) -> None:
    way = "waypoints: [[1, 3, 2, 3, 0, 0, 0.5], [2, 3, 4, 3]]"
    back, jump = (read(tmp_path, f"objects: {{a: {{period: {t}, {way}}}}}") for t in (4, 2))
    places = [back.states(time)[0][0, :2].tolist() for time in (0.0, 0.5, 1.5, 3.0, 4.0)]
    np.testing.assert_allclose(places, [[1, 2], [2, 2], [3, 3], [2, 3], [1, 2]], atol=1e-12)
    assert back.states(3.0)[1][0].tolist() == pytest.approx([-1, -1, 0, 0, 0, 0.25])
    assert jump.states(2.0)[0][0].tolist() == list(jump.description.objects[0].pose)


def test_joints_pass_waypoints_in_time_and_keep_what_is_not_named() -> None:
    motions = motions_of("arm_cell")
    (arm,) = motions.description.robots
    elbow, grip = (arm.robot.joint_names.index(name) for name in ("elbow", "grip"))
    found = [motions.joints(arm, time)[0][elbow] for time in (0.0, 1.5, 14.0 + 1.5)]
    assert found == [1.56, 1.62, 1.62]
    values, velocities = motions.joints(arm, 0.75)
    assert (values[elbow], velocities[elbow]) == (pytest.approx(1.59), pytest.approx(0.04))
    assert motions.joints(arm, 5.0)[0][grip] == 0.01
    np.testing.assert_allclose(motions.joints(arm, 14.0 - 1e-9)[0], arm.state, atol=1e-8)
    for time in np.arange(0.013, 14.0, 0.37):
        (before, velocities), (after, _) = (motions.joints(arm, t) for t in (time, time + STEP))
        np.testing.assert_allclose((after - before) / STEP, velocities, atol=1e-6)
        assert ((arm.robot.lower <= before) & (before <= arm.robot.upper)).all()
        assert (np.abs(velocities) <= arm.robot.velocity_limits).all()
    resting = Motions(motions.description)
    assert (*resting.joints(arm, 7.0)[0],) == arm.state
    assert not resting.joints(arm, 7.0)[1].any()


def test_the_arm_of_the_cell_collides_with_a_board_alone() -> None:
    motions = motions_of("arm_cell")
    (arm,) = motions.description.robots
    scene = oc.RobotScene({arm.name: arm.robot}, motions.description.build(), bases=[arm.pose])
    times = np.arange(0.0, 14.0, 0.1)
    report = scene.check(np.array([motions.joints(arm, time)[0] for time in times]))
    assert {pair for pair in report.pairs if pair} == {
        ("arm/hand", "shelf/3"), ("arm/right_finger", "shelf/3")
    }  # fmt: skip
    assert not report.out_of_limits.any()
    assert set(times[~report.valid].round(1)) <= set(np.arange(9.0, 11.0, 0.1).round(1))


def a(fields: str) -> str:
    return f"objects:\n  a: {{{fields}}}"


def arm(fields: str) -> str:
    return f"robots:\n  arm: {{{fields}}}"


def sensor(kind: str, changed: str) -> str:
    """Return a sensor with one field changed or added."""
    key = changed.partition(":")[0]
    fields = {"width": 4, "angle": 1, "range": 9, "rate": 10, "position": "[0, 0, 1]"}
    fields |= {"target": "[1, 0, 1]"}
    rest = [f"{name}: {value}" for name, value in fields.items() if name != key]
    return f"sensors: {{eye: {{{', '.join([f'type: {kind}', *rest, changed])}}}}}"


@each("text, reason", [
    ("things: {}", ":1: things: unknown key"),
    ("objects: {c: {follow: a}}", "objects.c: the scene file has no object of this name; there"),
    ("robots: {amr: {}}", "robots.amr: the scene file has no robot of this name; did you mean arm"),
    (a(""), ":2: objects.a: must be follow: NAME, or period and waypoints, or all three, got {}"),
    (a("follow: b, waypoints: []"), "objects.a: must be follow: NAME"),
    (a("follow: c"), "objects.a.follow: the scene file has no object of this name"),
    (a("follow: a"), "objects.a.follow: a must stand above what follows it"),
    (a("follow: b}\n  b: {follow: a"), "objects.a.follow: b must stand above what follows it"),
    (a("period: 0, waypoints: []"), "objects.a.period: must be seconds from 0.001 on, got 0"),
    (a("period: 9, waypoints: [[1, 2, 3]]"), "waypoints[0]: must be [time, x, y, z] or"),
    (a("period: 9, waypoints: [[1, 0, 0, 0, 0, 0, 90]]"), "waypoints[0]: angles are in radians"),
    (a("period: 9, waypoints: [[0, 0, 0, 0]]"), "times must ascend from above 0 up to the period"),
    (a("period: 9, waypoints: [[2, 0, 0, 0], [1, 0, 0, 0]]"), "period 9, got [2.0, 1.0]"),
    (a("period: 9, waypoints: [[10, 0, 0, 0]]"), "up to the period 9, got [10.0]"),
    (a("period: 9, waypoints: [[1, 1e300, 0, 0]]"), "it moves at more than 1e+09 m/s or rad/s"),
    ("strangers: [{name: b, shape: sphere, radius: 1}]", "the scene file has an object b, too"),
    ("strangers: [{name: c, shape: sphere}]", "strangers[0]: needs radius"),
    ("strangers: [{name: c, shape: sphere, radius: 1}]\nobjects: {c: {follow: a}}",
     "objects.c.follow: the scene file has no object of this name; there are c"),
    (sensor("laser", "width: 0"), "sensors.eye.width: must be a whole number from 1 to 4096"),
    (sensor("camera", "angle: 3"), "sensors.eye: the angle of a camera is at most 2.8 rad"),
    (sensor("camera", "target: [0, 0, 0]"), "must not stand above each other"),
    (sensor("laser", "follow: c"), "eye.follow: "), ("sensors: {eye: {}}", "sensors.eye: needs "),
    (arm("period: 2"), "robots.arm: needs waypoints"),
    (arm("period: 2, waypoints: [{time: 3, joints: {}}]"), "up to the period 2, got [3.0]"),
    (arm("period: 2, waypoints: [{time: 1, joints: {turn: 9}}]"), "within the joint's limits"),
])  # fmt: skip
def test_what_is_wrong_is_said_by_line_and_key(tmp_path: Path, text: str, reason: str) -> None:
    with pytest.raises(SceneFileError, match=r"cell\.motion\.yaml:\d+: ") as error:
        read(tmp_path, text)
    assert reason in str(error.value)


def test_all_that_is_wrong_is_said_at_once_and_a_scene_may_rest(tmp_path: Path, write: Any) -> None:
    with pytest.raises(SceneFileError) as error:
        read(tmp_path, "objects: {a: 3, c: {}}\nrobots: {arm: {}}")
    assert len(error.value.problems) == 3
    file = write("objects: [{name: a, shape: sphere, radius: 1}]")
    assert read_motions(load_scene(file), file).moving == []
