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

"""Poses read in blocks are those read by numpy, to the bit, and what is unusual takes its way."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

import obb_collision as oc
from obb_collision.geometry import poses as module
from obb_collision.geometry.poses import (
    BLOCK,
    as_poses,
    matrices_from_quaternions,
    quaternions_from_matrices,
)
from obb_collision.geometry.validation import as_quaternions
from obb_collision.typing import Floats
from tools.cases.placement import random_rotations


@pytest.fixture(autouse=True)
def _restore() -> Iterator[None]:
    yield
    oc.set_threads(None)


def some_poses(count: int) -> Floats:
    rng = np.random.default_rng(count)
    quaternions = quaternions_from_matrices(random_rotations(rng, count))
    quaternions *= rng.uniform(0.95, 1.05, (count, 1))
    quaternions[::5, :3] *= 1e-9  # nearly no turn
    quaternions[::5, 3] = -1.0
    quaternions[::7] = 0.5
    return np.concatenate([rng.uniform(-1e7, 1e7, (count, 3)), quaternions], axis=1)


@pytest.mark.parametrize("count", [0, 1, BLOCK - 1, BLOCK, BLOCK + 1, 20_000])
def test_blocks_give_what_numpy_does(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    poses = some_poses(count)
    unit = as_quaternions(poses[:, 3:], "quaternions", (None, 4))
    rotations = matrices_from_quaternions(unit)
    monkeypatch.setattr(module, "FEWEST_POSES", 100)
    for threads in (1, 3):
        oc.set_threads(threads)
        positions, found = as_poses(poses)
        assert positions.tobytes() == np.ascontiguousarray(poses[:, :3]).tobytes()
        assert found.tobytes() == rotations.tobytes()


@pytest.mark.parametrize("row", [0, BLOCK, 299])
@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        (0, np.nan, "poses must be finite in row {}"),
        (2, 2e300, "poses must not exceed 1e[+]300 in magnitude in row {}"),
        (6, -np.inf, "poses must be finite in row {}"),
        (slice(3, 7), 0.0, r"poses \(quaternion\) must not be a zero quaternion in row {}"),
    ],
)
def test_the_row_of_a_bad_pose_is_named(
    row: int, column: int | slice, value: float, message: str
) -> None:
    poses = some_poses(300)
    poses[row, column] = value
    with pytest.raises(ValueError, match=message.format(row)):
        as_poses(poses)


def test_a_quaternion_far_from_unit_length_is_warned_about_and_used() -> None:
    poses = some_poses(300)
    expected = as_poses(poses)[1]
    poses[200, 3:] *= 2.0
    with pytest.warns(UserWarning, match="far from unit length in row 200"):
        found = as_poses(poses)[1]
    assert found.tobytes() == expected.tobytes()


def test_poses_that_cannot_be_written_to_are_read() -> None:
    poses = some_poses(10)
    expected = as_poses(poses)[1]
    poses.setflags(write=False)
    assert (as_poses(poses)[1] == expected).all()
