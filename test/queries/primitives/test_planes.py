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

"""Planes, half-spaces and axis-aligned boxes against boxes: held to exact fractions."""

from __future__ import annotations

from fractions import Fraction

import membership
import numpy as np
import pytest
from distances import root
from support import family, row_of

import obb_collision as oc
from obb_collision import Boxes, HalfSpaces
from obb_collision.queries.verdict.verdict import OVERLAP, SEPARATE, TOUCHING

#: What isn't told from touching is this near to it, relative to the size of the pair.
DOUBT = 1e-14


@pytest.mark.parametrize("name", ["ordinary scene", "far away, 1e6 to 1e9 m", "zero extents"])
def test_planes(name: str) -> None:
    boxes, _ = family(name, 100)
    rng = np.random.default_rng(10)
    n = len(boxes)
    normals = rng.normal(size=(n, 3)) * 10.0 ** rng.uniform(-9, 9, (n, 1))
    normals[: n // 2] = boxes.rotations[: n // 2, :, 0]  # a face lies on the plane
    reach = np.abs(np.einsum("nk,nki->ni", normals, boxes.rotations)) * boxes.half_extents
    squares = (normals * normals).sum(axis=1, keepdims=True)
    shift = rng.choice([-1.0, -0.5, 0.0, 1.0, 1.0 + 1e-15, 1.5], (n, 1))
    points = boxes.centers + shift * normals * reach.sum(axis=1, keepdims=True) / squares
    below, above = HalfSpaces(points, normals), HalfSpaces(points, -normals)
    found, turned = oc.separations(boxes, below), oc.separations(boxes, above)
    for k in range(n):
        m = membership.fractions(normals[k])
        at = membership.fractions(points[k])
        ends = [
            sum((a * (x - y) for a, x, y in zip(m, corner, at, strict=True)), Fraction(0))
            for corner in membership.corners(row_of(boxes, k))
        ]
        low, high = min(ends), max(ends)
        norm = root(sum((a * a for a in m), Fraction(0)))
        size = np.abs(points[k] - boxes.centers[k]).sum() + boxes.half_extents[k].sum()
        assert abs(float(low) / norm - found.separations[k]) <= DOUBT * size
        assert abs(float(high) / norm + turned.separations[k]) <= DOUBT * size
        for answer, gap in ((found, low), (turned, -high)):
            truth = SEPARATE if gap > 0 else OVERLAP if gap < 0 else TOUCHING
            near = abs(gap) <= Fraction(DOUBT * size * norm)
            assert answer.verdicts[k] in (truth, TOUCHING if near else truth)
            unit = normals[k] / norm * (-1 if answer is found else 1)
            np.testing.assert_allclose(answer.normals[k], unit, atol=1e-15)
            lowest = answer.positions[k] - 0.5 * answer.separations[k] * answer.normals[k]
            height = np.dot(lowest - points[k], -answer.normals[k])
            rounding = 1e-9 * size + 1e-15 * np.abs(points[k]).max()
            assert abs(height - answer.separations[k]) <= rounding
            assert boxes[k].padded(rounding).contains(lowest)


def test_bad_input() -> None:
    box = Boxes([[0, 0, 0]], [np.eye(3)], [[1, 1, 1]])
    with pytest.raises(ValueError, match="normals must not be zero in row 0"):
        HalfSpaces([[0, 0, 0]], [[0, 0, 0]])
    with pytest.raises(ValueError, match="same length"):
        oc.verdicts(box, HalfSpaces([[0, 0, 0]] * 2, [[1, 0, 0]] * 2))
