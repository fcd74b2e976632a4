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

"""Link poses of trees of all kinds of joints equal those of an oracle that uses 4x4 matrices."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from kinematics_oracle import OracleJoint, link_matrices, value_of
from scipy.spatial.transform import Rotation
from urdfs import LIMIT, joint, link, urdf

import obb_collision as oc

KINDS = ("fixed", "revolute", "continuous", "prismatic", "planar", "floating")
NUMBER = st.floats(-3.0, 3.0, allow_subnormal=False)
TRIPLE = st.tuples(NUMBER, NUMBER, NUMBER)
AXIS = TRIPLE.filter(lambda v: float(np.linalg.norm(v)) > 0.1 and v[2] > -0.99 * np.linalg.norm(v))


@st.composite
def trees(draw: st.DrawFn) -> list[OracleJoint]:
    """Draw joints of a tree of links named by number, whose root is 0."""
    found: list[OracleJoint] = []
    for child in range(1, draw(st.integers(2, 9))):
        kind = draw(st.sampled_from(KINDS))
        single = [j.name for j in found if j.kind in ("revolute", "continuous", "prismatic")]
        mimic = None
        if single and kind in ("revolute", "continuous", "prismatic") and draw(st.booleans()):
            mimic = (draw(st.sampled_from(single)), draw(NUMBER), draw(NUMBER))
        found.append(
            OracleJoint(
                f"j{child}", kind, str(draw(st.integers(0, child - 1))), str(child),
                draw(TRIPLE), draw(TRIPLE), draw(AXIS), mimic,
            )
        )  # fmt: skip
    return found


def written(one: OracleJoint) -> str:
    def words(numbers: tuple[float, ...]) -> str:
        return " ".join(map(repr, numbers))

    inner = (
        f'<origin xyz="{words(one.xyz)}" rpy="{words(one.rpy)}"/><axis xyz="{words(one.axis)}"/>'
    )
    if one.mimic is not None:
        name, multiplier, offset = one.mimic
        inner += f'<mimic joint="{name}" multiplier="{multiplier!r}" offset="{offset!r}"/>'
    return joint(one.name, one.kind, one.parent, one.child, inner + LIMIT)


@given(trees(), st.randoms(use_true_random=False), st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_link_poses_are_the_oracles(joints: list[OracleJoint], order: object, seed: int) -> None:
    lines = [link(str(k)) for k in range(len(joints) + 1)] + [written(one) for one in joints]
    order.shuffle(lines)  # type: ignore[attr-defined]
    robot = oc.Robot.from_urdf(urdf(*lines))
    states = np.random.default_rng(seed).uniform(-2.0, 2.0, (3, len(robot.joint_names)))
    poses = robot.link_poses(states)
    for state, row in zip(states, poses, strict=True):
        values = dict(zip(robot.joint_names, state.tolist(), strict=True))
        for one in joints:
            if one.mimic is not None:
                values[one.name] = value_of(one, values)
        expected = link_matrices("0", joints, values)
        size = 1.0 + max(float(np.abs(matrix).max()) for matrix in expected.values())
        for name, pose in zip(robot.link_names, row, strict=True):
            np.testing.assert_allclose(pose[:3], expected[name][:3, 3], rtol=0, atol=1e-13 * size)
            turn = Rotation.from_quat(pose[3:]).as_matrix()
            np.testing.assert_allclose(turn, expected[name][:3, :3], rtol=0, atol=1e-13 * size)


def test_quaternions_of_long_chains_keep_their_length() -> None:
    count = 999
    links = [link(str(k)) for k in range(count + 1)]
    inner = '<origin xyz="0 0 0.1" rpy="0.1 0.2 0.3"/>' + LIMIT
    joints = [joint(f"j{k}", "revolute", str(k), str(k + 1), inner) for k in range(count)]
    robot = oc.Robot.from_urdf(urdf(*links, *joints))
    pose = robot.link_poses(np.full(count, 0.7))[-1]
    assert abs(np.linalg.norm(pose[3:]) - 1.0) < 1e-15


@each("count", [0, 1, 5, 1000])
def test_states_come_one_or_many(count: int) -> None:
    robot = oc.Robot.from_urdf(urdf(link("a"), link("b"), joint("j", "revolute", "a", "b")))
    states = np.linspace(-1.0, 1.0, count)[:, None]
    many = robot.link_poses(states)
    assert many.shape == (count, 2, 7)
    for state, poses in zip(states, many, strict=True):
        assert np.array_equal(robot.link_poses(state), poses)
    states.setflags(write=False)
    assert np.array_equal(robot.link_poses(states), many)
    assert np.array_equal(robot.link_poses(np.asfortranarray(states.repeat(2, 1))[:, :1]), many)


def test_states_that_mean_nothing_are_refused_by_row() -> None:
    robot = oc.Robot.from_urdf(urdf(link("a"), link("b"), joint("j", "floating", "a", "b")))
    good = [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 2.0]
    assert robot.link_poses(good)[1].tolist() == [1, 2, 3, 0, 0, 0, 1]
    for bad, reason in (
        ([1.0, np.nan, 3.0, 0, 0, 0, 1], "states must be finite"),
        ([1.0, 2.0, 3.0, 0, 0, 0, 0], "states must have no quaternion of zeros"),
    ):
        with pytest.raises(ValueError, match=f"{reason}.* in row 1"):
            robot.link_poses([good, bad])
        with pytest.raises(ValueError, match=reason):
            robot.link_poses(bad)
    with pytest.raises(ValueError, match=r"states must have shape \(n, 7\)"):
        robot.link_poses([good[:3]])


def test_the_virtual_joint_may_be_a_part_of_the_state() -> None:
    text = urdf(link("a"), link("b"), joint("j", "prismatic", "a", "b"))
    srdf = urdf('<virtual_joint name="w" type="planar" parent_frame="world" child_link="a"/>')
    still = oc.Robot.from_urdf(text, srdf)
    assert still.joint_names == ("j",)
    assert still.virtual_joint is not None
    assert still.virtual_joint.parent_frame == "world"
    moving = oc.Robot.from_urdf(text, srdf, move_virtual_joint=True)
    assert moving.joint_names == ("w/x", "w/y", "w/theta", "j")
    poses = moving.link_poses([1.0, 2.0, np.pi / 2, 0.5])
    half = np.sqrt(0.5)
    np.testing.assert_allclose(poses[0], [1, 2, 0, 0, 0, half, half], atol=1e-15)
    np.testing.assert_allclose(poses[1], [1, 2.5, 0, 0, 0, half, half], atol=1e-15)
