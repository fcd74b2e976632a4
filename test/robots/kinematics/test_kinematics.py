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

"""Poses of links against an oracle, and how far splines are from their chords."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from kinematics_oracle import OracleJoint, joint_trees, link_matrices, written
from scipy.interpolate import BPoly
from scipy.spatial.transform import Rotation
from small_robots import LIMIT, joint, link, urdf
from support import refused

import obb_collision as oc
from obb_collision.robots.kinematics.splines import (
    CUBIC,
    LINEAR,
    QUINTIC,
    Point,
    distances_from,
    interpolation,
    segments_between,
    state_at,
    straight_pieces,
    with_jump,
)

KINDS = ("fixed", "revolute", "continuous", "prismatic", "planar", "floating")


@given(joint_trees(KINDS), st.randoms(use_true_random=False), st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_link_poses_are_the_oracles(joints: list[OracleJoint], order: object, seed: int) -> None:
    lines = [link(str(k)) for k in range(len(joints) + 1)] + [written(one) for one in joints]
    order.shuffle(lines)  # type: ignore[attr-defined]
    robot = oc.Robot.from_urdf(urdf(*lines))
    states = np.random.default_rng(seed).uniform(-2.0, 2.0, (3, len(robot.joint_names)))
    poses = robot.link_poses(states)
    for state, row in zip(states, poses, strict=True):
        expected = link_matrices(joints, dict(zip(robot.joint_names, state.tolist(), strict=True)))
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
    for reason, *bad in (
        ("states must be finite", 1.0, np.nan, 3.0, 0, 0, 0, 1),
        ("states must not have a zero quaternion", 1.0, 2.0, 3.0, 0, 0, 0, 0),
    ):
        refused(f"{reason}.* in row 1", robot.link_poses, [good, bad])
        refused(reason, robot.link_poses, bad)
    refused(r"states must have shape \(n, 7\)", robot.link_poses, [good[:3]])


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


RNG = np.random.default_rng(7)


def points(order: int, count: int = 2) -> list[Point]:
    """Return points with so many derivatives, at rising times."""
    times = np.cumsum(RNG.uniform(0.1, 2.0, count)).tolist()
    rest = [None] * (2 - order)
    return [Point(time, *RNG.uniform(-2.0, 2.0, (order + 1, 3)), *rest) for time in times]


def curve(some: list[Point], number: int, times: np.ndarray) -> np.ndarray:
    """Return the joints on a segment between points, at times since its start."""
    return segments_between(some).at(np.full(len(times), number), times)


@each("order, name", [(0, LINEAR), (1, CUBIC), (2, QUINTIC)])
def test_polynomials_are_those_of_scipy_through_the_derivatives(order: int, name: str) -> None:
    for _ in range(50):
        first, last = points(order)
        assert interpolation(first, last) == name
        given = [list(point[1 : order + 2]) for point in (first, last)]
        exact = BPoly.from_derivatives([0.0, last.time - first.time], given)
        times = np.linspace(0.0, last.time - first.time, 21)
        ours = curve([first, last], 0, times)
        np.testing.assert_allclose(ours, exact(times), rtol=1e-9, atol=1e-9)


@each("order", [0, 1, 2])
def test_no_spline_is_farther_from_its_chords_than_is_said(order: int) -> None:
    for _ in range(50):
        some = points(order, 4)
        deviations = segments_between(some).deviations()
        counts = RNG.integers(1, 6, 3)
        pieces = straight_pieces(some, counts)
        assert pieces.segments.tolist() == np.repeat(range(3), counts).tolist()
        np.testing.assert_array_equal(pieces.starts[1:], pieces.ends[:-1])
        for n, number in enumerate(pieces.segments.tolist()):
            parts = np.linspace(0.0, 1.0, 30)[:, None]
            times = pieces.begins[n] + parts[:, 0] * (pieces.finishes[n] - pieces.begins[n])
            chord = pieces.starts[n] + parts * (pieces.ends[n] - pieces.starts[n])
            off = np.abs(curve(some, number, times - some[number].time) - chord).max(axis=0)
            allowed = deviations[number] / counts[number] ** 2
            assert (off <= allowed + 1e-9).all()


def test_no_point_moves_farther_than_is_said() -> None:
    inner = '<origin xyz="0.1 0.2 0.3"/><axis xyz="0 1 1"/>' + LIMIT
    kinds = zip(("revolute", "prismatic", "revolute"), pairwise("abcd"), strict=True)
    joints = [joint(a + b, kind, a, b, inner) for kind, (a, b) in kinds]
    robot = oc.Robot.from_urdf(urdf(*(link(n, '<sphere radius="0.3"/>') for n in "abcd"), *joints))
    checker = oc.RobotScene([robot])
    points = 0.3 * np.vstack([np.eye(3), -np.eye(3)])
    for _ in range(200):
        states = RNG.uniform(-2.0, 2.0, (1, 3))
        moved = states + RNG.uniform(-0.2, 0.2, (1, 3))
        largest = np.maximum(np.abs(states), np.abs(moved))
        (most,) = checker.displacements(largest, np.abs(moved - states))
        found = []
        for state in (states, moved):
            poses = robot.link_poses(state)[0]
            rotations = Rotation.from_quat(poses[:, 3:]).as_matrix()
            found.append(poses[:, None, :3] + np.einsum("lij,pj->lpi", rotations, points))
        assert np.linalg.norm(found[1] - found[0], axis=2).max() <= most
    free = oc.Robot.from_urdf(urdf(*map(link, "ab"), joint("j", "planar", "a", "b")))
    refused("planar or floating", oc.RobotScene([free]).displacements, states, states)


def test_the_state_at_a_time_is_on_the_splines_and_at_their_ends() -> None:
    some = points(2, 4)
    for first, last in pairwise(some):
        middle = (first.time + last.time) / 2.0
        expected = curve([first, last], 0, np.array([middle - first.time]))[0]
        np.testing.assert_array_equal(state_at(some, middle), expected)
        np.testing.assert_allclose(state_at(some, first.time), first.positions, atol=1e-12)
    np.testing.assert_array_equal(state_at(some, 1e9), some[-1].positions)


def test_segments_between_points_of_any_kinds_are_those_of_each_pair() -> None:
    kinds = RNG.integers(0, 3, 200)
    some = [points(kind, 1)[0]._replace(time=float(n)) for n, kind in enumerate(kinds.tolist())]
    together = segments_between(some)
    for found, pair in zip(together.coefficients, pairwise(some), strict=True):
        np.testing.assert_array_equal(found, segments_between(pair).coefficients[0])


def test_a_jump_is_a_piece_of_its_own_of_the_first_segment() -> None:
    some = points(1, 3)
    pieces = straight_pieces(some, np.array([2, 3]))
    here = some[0].positions + 1.0
    jumping = with_jump(pieces, here, some, some[1].time)
    assert len(jumping.begins) == len(pieces.begins) + 1
    jump = jumping.take(np.array([len(pieces.begins)]))
    np.testing.assert_array_equal(jump.starts[0], here)
    np.testing.assert_array_equal(jump.ends[0], some[1].positions)
    assert (jump.begins[0], jump.finishes[0], jump.segments[0]) == (some[1].time, some[1].time, 0)


def test_distances_from_pieces_are_those_of_the_nearest_point() -> None:
    rng = np.random.default_rng(0)
    some = [Point(float(t), rng.normal(size=3)) for t in range(5)]
    pieces = straight_pieces(some, np.array([1, 1, 1, 4]))
    pieces.ends[0] = pieces.starts[0]  # one that stays
    state = rng.normal(size=3)
    shares = np.linspace(0.0, 1.0, 20001)[:, None, None]
    off = pieces.starts + shares * (pieces.ends - pieces.starts) - state
    nearest = np.square(off).sum(axis=2).argmin(axis=0)
    expected = np.abs(off[nearest, np.arange(len(nearest))]).max(axis=1)
    np.testing.assert_allclose(distances_from(pieces, state), expected, atol=1e-3)
