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

"""The way of one triangle out of another, against exact arithmetic."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from each import each
from triangle_distances import squared_distance
from triangle_pairs import FAMILIES, Floats, Maker

from obb_collision.queries.convex.contacts import FlatFrame, frame_of
from obb_collision.queries.mesh_contacts.push import way_out
from obb_collision.queries.meshes.triangles import Triangle

#: Rounding of places, relative to the coordinates.
TOLERANCE = 1e-9


def corners(triangle: Floats) -> Triangle:
    (a, b, c), (d, e, f), (g, h, i) = triangle.tolist()
    return (a, b, c), (d, e, f), (g, h, i)


def any_frame(rng: np.random.Generator) -> FlatFrame:
    n = rng.normal(size=3)
    x, y, z = (n / np.linalg.norm(n)).tolist()
    return frame_of((x, y, z))


def exact_way(p: Floats, q: Floats, n: tuple[float, ...]) -> Fraction | None:
    """Return the largest t for which p and q + t n have a common point: of all features."""
    first, second = ([[Fraction(x) for x in v] for v in t.tolist()] for t in (p, q))
    way = [Fraction(x) for x in n]
    best: Fraction | None = None
    for ends, others in (((0, 1, 2), (0,)), ((0, 1), (0, 1)), ((0,), (0, 1, 2))):
        for s in range(3):
            for t in range(3):
                mine = [first[(s + k) % 3] for k in ends]
                theirs = [second[(t + k) % 3] for k in others]
                length = _solved(mine, theirs, way)
                if length is not None and (best is None or length > best):
                    best = length
    return best


def _solved(p: list[list[Fraction]], q: list[list[Fraction]], n: list[Fraction]) -> Fraction | None:
    """Return t where q + t n reaches p within both, None unless there is just one."""
    columns = [[x - y for x, y in zip(v, p[0], strict=True)] for v in p[1:]]
    columns += [[y - x for x, y in zip(v, q[0], strict=True)] for v in q[1:]]
    columns.append([-x for x in n])
    start = [y - x for x, y in zip(p[0], q[0], strict=True)]
    whole = _det(columns)
    if whole == 0:
        return None
    weights = [
        _det([start if k == i else c for k, c in enumerate(columns)]) / whole for i in (0, 1, 2)
    ]
    of_p, of_q = weights[: len(p) - 1], weights[len(p) - 1 : 2]
    inside = min(weights[:2]) >= 0 and sum(of_p) <= 1 and sum(of_q) <= 1
    return weights[2] if inside else None


def _det(m: list[list[Fraction]]) -> Fraction:
    (a, b, c), (d, e, f), (g, h, i) = m
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)


@each("make", FAMILIES)
def test_never_too_short(make: Maker, pairs: int) -> None:
    """After the way out of all, the triangles are apart or touch, exactly."""
    rng = np.random.default_rng(5)
    seen = 0
    for _ in range(max(pairs // 200, 20)):
        p, q = make(rng)
        size = max(np.abs(p).max(), np.abs(q).max())
        if not 1e-3 < size < 1e9:  # kernels scale triangles to about one
            p, q = p / size, q / size
        size = max(np.abs(p).max(), np.abs(q).max())
        frame = any_frame(rng)
        found = way_out(corners(p), corners(q), frame, -np.inf)
        exact = exact_way(p, q, frame.n)
        if exact is None:
            continue
        seen += 1
        if found < float(exact) - TOLERANCE * size:  # only where what decides is a point wide
            way = [[Fraction(x) + exact * Fraction(y) for x, y in zip(v, frame.n, strict=True)]
                   for v in q.tolist()]  # fmt: skip
            still = [[Fraction(x) for x in v] for v in p.tolist()]
            assert squared_distance(still, way) == 0
            assert make.__name__.strip("_") in (
                "sliver",
                "degenerate",
                "small_grid",
                "different_sizes",
            )
    assert seen > 2 or make.__name__ == "extreme_sizes"


def test_ordinary_triangles_exactly() -> None:
    rng = np.random.default_rng(6)
    seen = 0
    for _ in range(300):
        p, q = rng.normal(size=(2, 3, 3))
        frame = any_frame(rng)
        found = way_out(corners(p), corners(q), frame, -np.inf)
        exact = exact_way(p, q, frame.n)
        if exact is None:
            assert found == -np.inf
        else:
            assert found == pytest.approx(float(exact), abs=1e-10)
            seen += 1
            assert way_out(corners(p), corners(q), frame, 99.0) == -np.inf
    assert seen > 50
