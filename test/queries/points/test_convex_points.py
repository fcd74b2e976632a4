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

"""Points in convex bodies: none of a body is outside, and those inside are nearly in it."""

from __future__ import annotations

import numpy as np
from beyond_bodies import beyond
from convex_bodies import KINDS, bodies, corners_of, moved
from each import each
from scipy.spatial import ConvexHull

from obb_collision import Boxes
from obb_collision.queries.convex.support import CORNERS, SEGMENT, ConvexBodies
from obb_collision.queries.points.points import points_in_bodies
from obb_collision.typing import Floats, Mask

#: Sizes along the axes, and how thin what is thin may be.
SCALES = {
    "random": [1.0, 1.0, 1.0], "plates": [1.0, 1.0, 1e-8], "needles": [1e-8, 1e-8, 1.0],
    "tiny": [1e-150] * 3, "huge": [1e150] * 3,
}  # fmt: skip
#: What is promised of points beside hulls, and of radii and margins, relative to the size.
CLOSE = 1e-9


def around(body: ConvexBodies, reach: float = 0.0) -> Boxes:
    """Return boxes that certainly hold bodies and what is this near to them."""
    half = np.full((len(body), 3), 8.0 * (np.abs(body.sizes).max() + body.radii.max() + reach))
    if body.kinds[0] == CORNERS:
        half += body.hulls.radii.max()
    return Boxes.trusted(body.centers, body.rotations, half)


def one(body: ConvexBodies, i: int) -> ConvexBodies:
    rows = np.array([i])
    return ConvexBodies(
        *(body.kinds[rows], body.sizes[rows], body.radii[rows], body.hulls),
        *(body.rows[rows], body.centers[rows], body.rotations[rows]),
    )


def held(body: ConvexBodies, points: Floats, margin: float = 0.0) -> Mask:
    """Return (n,) which points are in one body."""
    found = points_in_bodies(around(body, margin), body, points, margin, each_point=True)
    assert found.boxes is not None
    return np.asarray(found.boxes == 0)


def repeated(body: ConvexBodies, count: int) -> ConvexBodies:
    rows = np.zeros(count, np.int64)
    return ConvexBodies(
        *(body.kinds[rows], body.sizes[rows], body.radii[rows], body.hulls),
        *(body.rows[rows], body.centers[rows], body.rotations[rows]),
    )


def points_about(body: ConvexBodies, count: int, rng: np.random.Generator) -> Floats:
    """Return points in and about a body, some within 1e-17 to 1e-3 of its size of the surface."""
    size = np.abs(body.sizes[0]).sum() + body.radii[0]
    local = rng.normal(size=(count, 3)) * np.maximum(body.sizes[0, :3], 1e-3 * size)
    local[:, 2] += rng.uniform(-1, 1, count) * body.sizes[0, 3]
    inside, outside = 0.0 * local, local
    for _ in range(60):  # halved until the surface is between neighbours
        middle = 0.5 * (inside + outside)
        world = middle @ body.rotations[0].T + body.centers[0]
        is_in = beyond(repeated(body, count), world) <= 0.0
        inside = np.where(is_in[:, None], middle, inside)
        outside = np.where(is_in[:, None], outside, middle)
    near = inside * (
        1.0 + rng.choice([-1, 1], (count, 1)) * 10.0 ** rng.uniform(-17, -3, (count, 1))
    )
    local = np.where(rng.random((count, 1)) < 0.7, near, local)
    return np.asarray(local @ body.rotations[0].T + body.centers[0])


@each("name", SCALES)
@each("kind", [kind for kind in KINDS if kind != "hull"])
def test_points_are_in_shapes_by_their_formulas(kind: str, name: str, pairs: int) -> None:
    rng = np.random.default_rng(3)
    several = bodies(KINDS[kind], 8, rng, np.array(SCALES[name]), 0.5 * min(SCALES[name]))
    several = moved(several, centers=several.centers * rng.choice([1.0, 1e3], (8, 1)))
    decided = 0
    for i in range(8):
        body = one(several, i)
        points = points_about(body, max(200, pairs // 40), rng)
        far = beyond(repeated(body, len(points)), points)
        size = np.abs(points - body.centers).sum(axis=1) + np.abs(body.sizes).sum() + body.radii[0]
        rounding = 1e-13 * (size + np.abs(body.centers).max())
        close = CLOSE * size if body.kinds[0] == SEGMENT else 0.0
        found = held(body, points)
        assert found[far <= 0.0].all()
        assert not found[far > rounding + close].any()
        decided += int((far > rounding + close).sum()) + int((far < -rounding).sum())
    assert decided > 300


def test_points_are_in_hulls_by_their_planes(pairs: int) -> None:
    rng = np.random.default_rng(4)
    several = bodies(CORNERS, 8, rng, np.ones(3), 0.0)
    for i in range(8):
        body, corners = one(several, i), corners_of(several, i)
        weights = rng.dirichlet(np.full(len(corners), 0.2), max(200, pairs // 40))
        local = (weights @ corners) * (1.0 + 10.0 ** rng.uniform(-12, 0, (len(weights), 1)))
        planes = ConvexHull(corners).equations
        far = (local @ planes[:, :3].T + planes[:, 3]).max(axis=1)
        found = held(body, local @ body.rotations[0].T + body.centers[0])
        assert found[far <= -1e-14].all()
        assert not found[far > CLOSE * 8.0].any()
        assert 20 < found.sum() < len(found)


@each("kind", KINDS)
def test_a_margin_and_a_radius_are_a_ball_about_the_shape(kind: str) -> None:
    rng = np.random.default_rng(5)
    several = bodies(KINDS[kind], 6, rng, np.ones(3), 0.5)
    for i in range(6):
        body = one(several, i)
        points = rng.uniform(-2, 2, (600, 3)) + body.centers
        narrow, wide = held(body, points), held(body, points, 0.4)
        padded = held(moved(body, radii=body.radii + 0.4), points)
        assert (wide == padded).all()
        assert (wide >= narrow).all()
        assert narrow.sum() < wide.sum()
        inner = points[narrow]
        if len(inner):  # from each of these, a step of the margin stays within it
            steps = rng.normal(size=inner.shape)
            steps *= 0.4 * (1.0 - 1e-12) / np.linalg.norm(steps, axis=1)[:, None]
            assert held(body, inner + steps, 0.4).all()
        assert not wide[np.linalg.norm(points - body.centers, axis=1) > 3.6].any()
