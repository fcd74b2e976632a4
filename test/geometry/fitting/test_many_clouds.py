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

"""Boxes of many clouds at once: each as of its points alone, which it certainly contains."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from membership import assert_proper, holds

import obb_collision as oc
from obb_collision.geometry.fitting.fit import FITS
from obb_collision.typing import Floats

#: Clouds that perception gives: some points in general position, and every degenerate kind.
KINDS = {
    "any": lambda p: p,
    "one point": lambda p: p[:1],
    "duplicates": lambda p: np.repeat(p[:1], len(p), axis=0),
    "collinear": lambda p: p[:, :1] * [1.0, 2.0, 3.0],
    "coplanar": lambda p: p @ [[1.0, 0.0, 1.0], [0.0, 1.0, -0.5], [0.0, 0.0, 0.0]],
    "in a coordinate plane": lambda p: p * [1.0, 0.0, 1.0],
    "thin": lambda p: p * [1.0, 1e-13, 1.0],
    "gridded": lambda p: np.round(p),
    "far away": lambda p: p + 1e7,
}
CLOUDS = st.lists(
    st.tuples(st.sampled_from(sorted(KINDS)), st.integers(1, 40), st.integers(0, 10**6)),
    max_size=5,
)


def cloud(kind: str, count: int, seed: int) -> Floats:
    points: Floats = np.asarray(
        KINDS[kind](3.0 * np.random.default_rng(seed).normal(size=(count, 3)))
    )
    return points


@given(CLOUDS, st.sampled_from(sorted(FITS)))
def test_each_cloud_gets_the_box_of_its_points_alone_and_is_contained(
    drawn: list[tuple[str, int, int]], fit: str
) -> None:
    clouds = [cloud(*one) for one in drawn]
    boxes = oc.Boxes.from_points(clouds, fit=fit)
    together = np.concatenate([np.empty((0, 3)), *clouds])
    offsets = np.cumsum([0, *map(len, clouds)])
    assert oc.Boxes.from_points(together, offsets, fit) == boxes
    assert len(boxes) == len(clouds)
    for k, points in enumerate(clouds):
        assert boxes[k] == oc.OBB.from_points(points, fit)
        box = boxes.centers[k], boxes.rotations[k], boxes.half_extents[k]
        assert_proper(box)
        assert holds(box, points)


def test_clouds_of_equal_size_come_as_one_array() -> None:
    points = np.random.default_rng(1).normal(size=(3, 10, 3))
    assert oc.Boxes.from_points(points) == oc.Boxes.from_points(list(points))
    assert oc.Boxes.from_points(one for one in points) == oc.Boxes.from_points(points)


def test_bad_clouds_are_refused_by_their_number() -> None:
    good = np.eye(3)
    with pytest.raises(ValueError, match="points must not be empty in cloud 1"):
        oc.Boxes.from_points([good, np.empty((0, 3)), good])
    with pytest.raises(ValueError, match="points must not be empty in cloud 1"):
        oc.Boxes.from_points(good, [0, 2, 2, 3])
    with pytest.raises(ValueError, match="points of cloud 2 must be finite in row 1"):
        oc.Boxes.from_points([good, good, np.array([[0, 0, 0], [0, np.nan, 0]])])
    with pytest.raises(ValueError, match=r"points of cloud 0 must have shape \(n, 3\)"):
        oc.Boxes.from_points(good)
    with pytest.raises(ValueError, match="fit must be one of"):
        oc.Boxes.from_points([good], fit="tight")
    for offsets in ([], [0], [0, 2], [1, 3], [0, 2, 1, 3]):
        with pytest.raises(ValueError, match="offsets must rise from 0 to the number of points, 3"):
            oc.Boxes.from_points(good, offsets)
    with pytest.raises(ValueError, match="offsets must be from 0 to 3 in row 1"):
        oc.Boxes.from_points(good, [0, 4])
