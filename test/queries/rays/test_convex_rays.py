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

"""Rays against convex bodies: never late, none missed, and near the surface where they hit."""

from __future__ import annotations

import numpy as np
import pytest
from beyond_bodies import beyond
from convex_bodies import KINDS, bodies, moved
from each import each

from obb_collision import Boxes, cast_rays
from obb_collision.queries.convex.support import CORNERS, ConvexBodies
from obb_collision.queries.rays.rays import as_rays, cast_at_bodies
from obb_collision.typing import Floats, Rows

COUNT, SAMPLES = 200, 400
SCALES = {"random": [1.0, 1.0, 1.0], "plates": [1.0, 1.0, 1e-6], "needles": [1e-6, 1e-6, 1.0]}


def around(body: ConvexBodies) -> Boxes:
    """Return boxes that certainly hold bodies."""
    half = np.abs(body.sizes[:, :3]) + body.radii[:, None]
    half[:, 2] += body.sizes[:, 3]
    if body.kinds[0] == CORNERS:
        half += body.hulls.radii.max()
    return Boxes.trusted(body.centers, body.rotations, half)


def rays_at(body: ConvexBodies, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return origins and directions towards bodies, many of which pass near their edge."""
    size = np.abs(body.sizes).sum(axis=1) + body.radii + (body.kinds == CORNERS)
    origins = body.centers + rng.normal(size=(COUNT, 3)) * 3.0 * size[:, None]
    aim = rng.normal(size=(COUNT, 3)) * 0.4 * np.maximum(body.sizes[:, :3], body.radii[:, None])
    aim[:, 2] += rng.uniform(-1, 1, COUNT) * body.sizes[:, 3]
    ways = np.einsum("nij,nj->ni", body.rotations, aim) + body.centers - origins
    return origins, ways / np.linalg.norm(ways, axis=1)[:, None]


def some(body: ConvexBodies, rows: Rows) -> ConvexBodies:
    return ConvexBodies(
        *(body.kinds[rows], body.sizes[rows], body.radii[rows], body.hulls),
        *(body.rows[rows], body.centers[rows], body.rotations[rows]),
    )


@each("name", SCALES)
@each("kind", [kind for kind in KINDS if kind != "hull"])
def test_rays_hit_where_the_shape_begins(kind: str, name: str) -> None:
    rng = np.random.default_rng(6)
    body = bodies(KINDS[kind], COUNT, rng, np.array(SCALES[name]), 0.5 * min(SCALES[name]))
    origins, ways = rays_at(body, rng)
    size = np.linalg.norm(origins - body.centers, axis=1)
    size += np.abs(body.sizes).sum(axis=1) + body.radii
    rounding = 1e-12 * size + 1e-14 * (np.abs(body.centers) + np.abs(origins)).sum(axis=1)
    hits = 0
    for n in range(COUNT):  # one by one, so that nothing hides anything
        row = np.array([n])
        found = cast_at_bodies(
            some(body, row), around(some(body, row)), *as_rays(origins[row], ways[row], np.inf)
        )
        end = found.distances[0] if found.hits[0] else 3.0 * size[n]
        times = np.linspace(0.0, max(end - rounding[n], 0.0), SAMPLES)
        before = origins[n] + times[:, None] * ways[n]
        many = some(body, np.full(SAMPLES, n))
        inside = beyond(many, before) < -rounding[n]
        assert not inside.any() or end == 0.0
        if found.hits[0]:
            hits += 1
            assert beyond(some(body, row), found.positions)[0] <= 1e-9 * size[n] + rounding[n]
            if end > 0.0:
                assert np.linalg.norm(found.normals[0]) == pytest.approx(1.0, abs=1e-12)
                assert found.normals[0] @ ways[n] < 1e-6
    assert hits > COUNT // 20


def test_rays_at_boxes_are_those_of_boxes() -> None:
    rng = np.random.default_rng(7)
    body = bodies(KINDS["box"], COUNT, rng, np.ones(3), 0.0)
    boxes = Boxes.trusted(body.centers, body.rotations, body.sizes[:, :3].copy())
    origins, ways = rays_at(body, rng)
    found = cast_at_bodies(body, around(body), *as_rays(origins, ways, np.inf))
    truth = cast_rays(boxes, origins, ways)
    assert (found.hits >= truth.hits).all()
    both = truth.hits
    assert (found.distances[both] <= truth.distances[both] + 1e-12).all()
    steep = both & (np.einsum("ij,ij->i", truth.normals, ways) < -0.01)
    np.testing.assert_allclose(found.distances[steep], truth.distances[steep], atol=1e-7)
    assert steep.sum() > COUNT // 4


def test_a_radius_is_hit_first_and_reach_and_origin_count() -> None:
    rng = np.random.default_rng(8)
    body = bodies(KINDS["cylinder"], COUNT, rng, np.ones(3), 0.0)
    origins, ways = rays_at(body, rng)
    padded = moved(body, radii=body.radii + 0.1)
    thin = cast_at_bodies(body, around(body), *as_rays(origins, ways, np.inf))
    thick = cast_at_bodies(padded, around(padded), *as_rays(origins, ways, np.inf))
    assert (thick.distances <= thin.distances).all()
    hit = np.flatnonzero(np.isfinite(thin.distances) & (thin.distances > 0.0))
    short = thin.distances[hit]
    for factor, count in ((1.0 + 1e-9, len(hit)), (1.0 - 1e-6, 0)):
        again = cast_at_bodies(
            body, around(body), *as_rays(origins[hit], ways[hit], short * factor)
        )
        assert again.hits.sum() == count
    inside = cast_at_bodies(body, around(body), *as_rays(body.centers, ways, np.inf))
    assert (inside.distances == 0.0).all()
    assert (inside.normals == 0.0).all()
