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

"""Triangle against triangle in exact integers, for the pairs that certified kernels leave open."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from obb_collision.numerics.exact import Vector, cross, dot, exact_axes, exact_integers
from obb_collision.typing import Floats

Placement = tuple[Floats, Floats]
UNIT = ((1, 0, 0), (0, 1, 0), (0, 0, 1))


def exact_triangle_verdict(
    a: Floats, placement_a: Placement, b: Floats, placement_b: Placement
) -> int:
    """Return 0 separate, 1 touching or 2 overlap of two closed triangles, decided exactly.

    a, b: corners (9,) in their own frames; placements: centre (3,), rotation (3, 3).
    """
    corners = exact_corners((a, b), (placement_a, placement_b))
    first, second = corners[:3], corners[3:]
    touching = False
    for axis in _candidate_axes(first, second):
        p, q = [dot(axis, v) for v in first], [dot(axis, v) for v in second]
        gap = max(min(q) - max(p), min(p) - max(q))
        if gap > 0:
            return 0
        touching = touching or gap == 0
    return 1 if touching else 2


def exact_corners(rows: Sequence[Floats], placements: Sequence[Placement]) -> list[Vector]:
    """Return all points of rows (3 k,), each placed, as integers of one common unit."""
    axes = [exact_axes(rotation) for _, rotation in placements]
    power = max(k for _, k in axes)
    lengths = [row.tolist() for row in rows] + [center.tolist() for center, _ in placements]
    numbers, _ = exact_integers([x for row in lengths for x in row])
    offsets = numbers[-3 * len(placements) :]
    result = []
    start = 0
    for n, row in enumerate(rows):
        columns, own = axes[n]
        for k in range(start, start + len(row), 3):
            x, y, z = (
                (sum(columns[i][c] * numbers[k + i] for i in range(3)) << (power - own))
                + (offsets[3 * n + c] << power)
                for c in range(3)
            )
            result.append((x, y, z))
        start += len(row)
    return result


def _minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _candidate_axes(p: list[Vector], q: list[Vector]) -> Iterator[Vector]:
    """Yield axes of which one separates if any does; null ones left out.

    The Minkowski difference is the hull of nine points, its faces are normal to products of two
    edges. Where it is flat (coplanar triangles), a plane normal to it and an edge bounds it within
    its plane; where it is a segment or a point, axes along and across it do.
    """
    edges = [_minus(t[(i + 1) % 3], t[i]) for t in (p, q) for i in range(3)]
    edges = [edge for edge in edges if any(edge)]
    normals = [cross(u, v) for i, u in enumerate(edges) for v in edges[i + 1 :]]
    normals = [normal for normal in normals if any(normal)]
    yield from normals
    if any(dot(normals[0], edge) for edge in edges) if normals else False:
        return  # the difference is not flat
    if normals:
        yield from (cross(normals[0], edge) for edge in edges)
    elif edges:
        yield edges[0]
        yield from (axis for axis in (cross(edges[0], unit) for unit in UNIT) if any(axis))
    else:
        yield from UNIT
