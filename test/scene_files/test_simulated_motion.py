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

"""Where moving objects are, against one object at a time by scipy's rotations.

To 1e-12 and not bit for bit: simulated poses are what a demo or a measurement publishes. The
library takes them at their word, so their last places make no verdict wrong.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from obb_collision.geometry.poses import Pose
from obb_collision.scene_files.motion import Follow, Loop, Motion, Steady, states_at

RNG = np.random.default_rng(8)


def random_pose() -> Pose:
    x, y, z = RNG.uniform(-3.0, 3.0, 3).tolist()
    qx, qy, qz, qw = Rotation.random(random_state=RNG.integers(2**31)).as_quat().tolist()
    return x, y, z, qx, qy, qz, qw


def random_loop() -> Loop:
    return Loop((random_pose(), random_pose(), random_pose()), (0.0, 0.5, 2.0), 3.0)


MOTIONS: dict[str, Motion | None] = {
    "post": None,
    "car": Steady((1.0, 2.0, 0.0, 0.1, 0.2, 0.7), period=4.0),
    "train": random_loop(),
    "load": Follow("train"),
    "fly": Follow("load", random_loop()),
    "shadow": Follow("fly"),
    "sign": Follow("post"),
    "slide": Steady((1.0, 0.0, 0.5, 0.0, 0.0, 0.0)),
}
STARTS = {name: random_pose() for name in MOTIONS}

State = tuple[np.ndarray, Rotation, np.ndarray, np.ndarray]


def along(begin: Pose, velocity: np.ndarray, turn: np.ndarray, seconds: float) -> State:
    """Return position, rotation, velocity and angular velocity after a steady twist."""
    rotation = Rotation.from_rotvec(turn * seconds) * Rotation.from_quat(begin[3:])
    return np.array(begin[:3]) + velocity * seconds, rotation, velocity, turn


def looped(loop: Loop, time: float) -> State:
    passed = time % loop.period
    leg = int(np.searchsorted(loop.times, passed, side="right")) - 1
    begin, end = loop.poses[leg], loop.poses[(leg + 1) % len(loop.poses)]
    lasts = (*loop.times, loop.period)[leg + 1] - loop.times[leg]
    turn = (Rotation.from_quat(end[3:]) * Rotation.from_quat(begin[3:]).inv()).as_rotvec()
    velocity = np.array(end[:3]) - np.array(begin[:3])
    return along(begin, velocity / lasts, turn / lasts, passed - loop.times[leg])


def expected(name: str, time: float) -> State:
    motion, start, still = MOTIONS[name], STARTS[name], np.zeros(3)
    if motion is None:
        return along(start, still, still, 0.0)
    if isinstance(motion, Steady):
        twist = np.array(motion.twist)
        return along(start, twist[:3], twist[3:], time % (motion.period or np.inf))
    if isinstance(motion, Loop):
        return looped(motion, time)
    place, rotation, velocity, turn = expected(motion.name, time)
    if motion.loop is None:
        begun, facing, _, _ = expected(motion.name, 0.0)
        inner = facing.inv().apply(np.array(start[:3]) - begun)
        state = inner, facing.inv() * Rotation.from_quat(start[3:]), still, still
    else:
        state = looped(motion.loop, time)
    arm = rotation.apply(state[0])
    moving = velocity + np.cross(turn, arm) + rotation.apply(state[2])
    return place + arm, rotation * state[1], moving, turn + rotation.apply(state[3])


@pytest.mark.parametrize("time", [0.0, 0.3, 0.5, 1.7, 2.9, 100.3])
def test_states_agree_with_one_object_at_a_time(time: float) -> None:
    rows = {name: row for row, name in enumerate(MOTIONS)}
    starts = np.array(list(STARTS.values()))
    poses, twists = states_at(starts, list(MOTIONS.values()), rows, time)
    for row, name in enumerate(MOTIONS):
        place, rotation, velocity, turn = expected(name, time)
        np.testing.assert_allclose(poses[row, :3], place, atol=1e-12)
        matrix = Rotation.from_quat(poses[row, 3:]).as_matrix()
        np.testing.assert_allclose(matrix, rotation.as_matrix(), atol=1e-12)
        np.testing.assert_allclose(twists[row], np.r_[velocity, turn], atol=1e-12)
    assert poses[rows["post"]].tolist() == list(STARTS["post"])
    assert poses[rows["slide"], 3:].tolist() == pytest.approx(STARTS["slide"][3:], abs=1e-15)


def test_a_circle_of_followers_is_refused() -> None:
    with pytest.raises(ValueError, match="follow one another in a circle"):
        states_at(np.zeros((2, 7)), [Follow("b"), Follow("a")], {"a": 0, "b": 1}, 0.0)
