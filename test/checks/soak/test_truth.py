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

"""The brute force of the soak, against exact arithmetic on the same boxes."""

from __future__ import annotations

import numpy as np
import oracle
import pytest

pytest.importorskip("rclpy")
from tools.soak.encoding import rows_of
from tools.soak.truth import rotations_of, truth_of
from tools.soak.world import World


def test_brute_force_is_right() -> None:
    seen = set()
    for seed in range(5):
        world = World(seed, 40)
        world.apply(world.first())
        world.apply(world.step())
        poses, sizes = rows_of(world.bodies)
        boxes = list(zip(poses[:, :3], rotations_of(poses[:, 3:]), 0.5 * sizes, strict=True))
        i, j = np.triu_indices(len(boxes), 1)
        pairs = [oracle.ExactPair(boxes[a], boxes[b]) for a, b in zip(i, j, strict=True)]
        verdicts = np.array([pair.verdict() for pair in pairs])
        truth = truth_of(poses, sizes)
        assert truth.sure.all()
        colliding = np.flatnonzero(verdicts != oracle.SEPARATE)
        assert truth.pairs.tolist() == np.stack([i, j], axis=1)[colliding].tolist()
        depths = [-pairs[k].separation() for k in colliding]
        np.testing.assert_allclose(truth.depths, depths, atol=1e-12)
        seen |= set(verdicts.tolist())
    assert seen == {oracle.SEPARATE, oracle.TOUCHING, oracle.OVERLAP}, "some rest on others"


def test_what_doubles_do_not_decide_is_said() -> None:
    turned = np.array([0.0, 0.0, np.sin(0.3), np.cos(0.3)])
    # edge to edge along the rotated x axis, apart by less than is sure
    offset = 1.0 * rotations_of(turned[None])[0, :, 0]
    poses = np.array([[0.0, 0.0, 0.0, *turned], [*(offset * (1.0 + 1e-11)), *turned]])
    truth = truth_of(poses, np.ones((2, 3)))
    assert truth.pairs.tolist() == [[0, 1]]
    assert not truth.sure[0]
    poses[:, 3:] = 0.0, 0.0, 0.0, 1.0
    poses[1, :3] = 1.0, 1.0, 1.0
    truth = truth_of(poses, np.ones((2, 3)))
    assert truth.sure.all()
    assert truth.depths.tolist() == [0.0]
