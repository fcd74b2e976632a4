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

"""Where boxes in simple places touch."""

from __future__ import annotations

import numpy as np
import pytest
from contact_pairs import CUBE, assert_same_places, one, turned

from tools.cases.placement import turns


def test_a_box_on_a_table_stands_on_its_four_corners() -> None:
    points, normal, depth = one(CUBE, ([0.5, 0.0, 1.4], turned([0, 0, 1], 90), [0.2, 0.4, 0.5]))
    np.testing.assert_allclose(normal, [0, 0, 1], atol=1e-15)
    assert depth == pytest.approx(0.1, abs=1e-15)
    assert_same_places(points, [[x, y, 0.95] for x in (0.1, 0.9) for y in (-0.2, 0.2)])


def test_a_box_over_the_edge_stands_on_the_edge_too() -> None:
    points, _, _ = one(CUBE, ([1.0, 0.0, 1.25], np.eye(3), [0.5, 0.5, 0.25]))
    assert_same_places(points, [[x, y, 1.0] for x in (0.5, 1.0) for y in (-0.5, 0.5)])


def test_a_turned_cube_on_a_cube_has_eight_points_or_every_other() -> None:
    above = ([0.0, 0.0, 1.99], turned([0, 0, 1], 45), [1.0, 1.0, 1.0])
    reach = np.sqrt(2.0) - 1.0
    octagon = [[s, t * reach] for s in (-1, 1) for t in (-1, 1)]
    octagon += [[t * reach, s] for s in (-1, 1) for t in (-1, 1)]
    wanted = np.array([[x, y, 0.995] for x, y in octagon])
    assert_same_places(one(CUBE, above, 8)[0], wanted)
    four, _, _ = one(CUBE, above, 4)
    assert len(four) == 4
    distances = np.linalg.norm(four[:, None] - wanted[None], axis=2).min(axis=1)
    assert (distances < 1e-12).all()
    sides = np.linalg.norm(four - np.roll(four, 1, axis=0), axis=1)
    np.testing.assert_allclose(sides, sides[0])  # a square, not four in a corner


def test_an_edge_on_a_face_has_two_points_and_a_vertex_one() -> None:
    diagonal = np.sqrt(0.5)
    points, normal, _ = one(CUBE, ([0, 0, 1 + diagonal - 0.01], turned([1, 0, 0], 45), [0.5] * 3))
    np.testing.assert_allclose(normal, [0, 0, 1], atol=1e-15)
    assert_same_places(points, [[-0.5, 0, 0.995], [0.5, 0, 0.995]])
    standing = turns(np.array([[1.0, -1.0, 0.0]]), np.array([np.arctan(np.sqrt(2.0))]))[0]
    points, _, _ = one(CUBE, ([0, 0, 1 + np.sqrt(0.75) - 0.01], standing, [0.5] * 3))
    assert_same_places(points, [[0, 0, 0.995]])


def test_two_edges_that_cross_meet_halfway() -> None:
    half = [0.5] * 3
    a = ([0, 0, 0], turned([1, 0, 0], 45), half)
    b = ([0.1, 0.2, 2 * np.sqrt(0.5) - 0.02], turned([0, 1, 0], 45), half)
    points, normal, depth = one(a, b)
    np.testing.assert_allclose(normal, [0, 0, 1], atol=1e-15)
    assert depth == pytest.approx(0.02, abs=1e-15)
    assert_same_places(points, [[0.1, 0, np.sqrt(0.5) - 0.01]])


def test_touching_at_a_face_an_edge_and_a_vertex() -> None:
    for offset, count in (([2, 0, 0], 4), ([2, 2, 0], 2), ([2, 2, 2], 1)):
        points, _, depth = one(CUBE, (offset, np.eye(3), [1.0] * 3))
        assert depth == 0.0
        assert len(points) == count
        assert (np.abs(points).max(axis=1) == 1.0).all()


def test_identical_and_nested_boxes() -> None:
    points, _, depth = one(CUBE, CUBE)
    assert depth == 2.0
    assert len(points) == 4
    points, _, depth = one(CUBE, ([0.1, 0, 0], np.eye(3), [0.1] * 3))
    assert depth == pytest.approx(1.0, abs=1e-15)
    assert len(points) >= 1
