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

"""The algebra of poses, against scipy's rotations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from obb_collision.geometry.poses import (
    IDENTITY_POSE,
    compose_poses,
    inverse_poses,
    multiply_quaternions,
    rotate_vectors,
    unit_poses,
    unit_quaternions,
)

RNG = np.random.default_rng(5)
OUTER, INNER = RNG.normal(size=(20, 7)), RNG.normal(size=(20, 7))


@pytest.mark.parametrize("outer", [OUTER, OUTER[0]], ids=["row by row", "one frame for all"])
def test_composed_poses_agree_with_matrices(outer: np.ndarray) -> None:
    got = compose_poses(outer, INNER)
    turn = Rotation.from_quat(outer[..., 3:])
    expected = outer[..., :3] + turn.apply(INNER[:, :3])
    np.testing.assert_allclose(got[:, :3], expected, atol=1e-14)
    rotations = (turn * Rotation.from_quat(INNER[:, 3:])).as_matrix()
    np.testing.assert_allclose(Rotation.from_quat(got[:, 3:]).as_matrix(), rotations, atol=1e-14)


def test_rotating_and_multiplying_agree_with_matrices() -> None:
    a, b = unit_quaternions(OUTER[:, 3:]), unit_quaternions(INNER[:, 3:])
    turns = Rotation.from_quat(a)
    vectors = INNER[:, :3]
    np.testing.assert_allclose(rotate_vectors(a, vectors), turns.apply(vectors), atol=1e-14)
    both = Rotation.from_quat(multiply_quaternions(a, b)).as_matrix()
    np.testing.assert_allclose(both, (turns * Rotation.from_quat(b)).as_matrix(), atol=1e-14)


def test_a_pose_and_its_inverse_undo_each_other() -> None:
    for product in (
        compose_poses(inverse_poses(OUTER), OUTER),
        compose_poses(OUTER, inverse_poses(OUTER)),
    ):
        np.testing.assert_allclose(product, np.tile(IDENTITY_POSE, (20, 1)), atol=1e-14)


def test_the_identity_changes_no_bit_of_a_position() -> None:
    identity = np.tile(IDENTITY_POSE, (20, 1))
    assert np.array_equal(compose_poses(IDENTITY_POSE, INNER)[:, :3], INNER[:, :3])
    assert np.array_equal(compose_poses(INNER, identity)[:, :3], INNER[:, :3])
    np.testing.assert_allclose(compose_poses(INNER, identity), unit_poses(INNER), atol=1e-15)


@pytest.mark.parametrize("power", [-500, -160, 0, 155, 500])
def test_quaternions_of_any_length_are_taken_as_normalised(power: int) -> None:
    scaled = OUTER * np.array([1.0, 1.0, 1.0, *[2.0**power] * 4])
    assert np.array_equal(unit_poses(scaled), unit_poses(OUTER))
    with pytest.raises(ValueError, match="zero quaternion in row 1"):
        unit_quaternions([[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 0.0]])
