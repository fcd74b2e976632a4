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

"""Feet: points of bodies, and the nearest ones but for ellipses."""

from __future__ import annotations

import numpy as np
import pytest
from beyond_bodies import beyond
from each import each

from obb_collision.queries.convex.directions import across, feet
from obb_collision.queries.convex.distance import search
from obb_collision.queries.convex.support import (
    BOX,
    CONE,
    CYLINDER,
    NO_HULLS,
    SEGMENT,
    ConvexBodies,
    Core,
    support,
)
from obb_collision.queries.meshes.tree_boxes import Pose
from obb_collision.typing import Floats, Vector

KINDS = [BOX, SEGMENT, CYLINDER, CONE]
STRAIGHT = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def core(kind: int, sizes: Floats) -> Core:
    x, y, z, half = sizes.tolist()
    size = (0.0, 0.0, 0.0) if kind == SEGMENT else (x, y, z if kind == BOX else 0.0)
    code: int = np.int8(kind)  # type: ignore[assignment]
    return Core(code, size, 0.0 if kind == BOX else half, NO_HULLS.blocks, 0, 0, 2.0, 0.0)


def is_in(body: Core, point: Vector) -> bool:
    sizes = np.array([[*body.size, body.half]])
    bodies = ConvexBodies(
        *(np.array([body.kind]), sizes, np.zeros(1), NO_HULLS, np.zeros(1, np.int64)),
        *(np.zeros((1, 3)), np.eye(3)[None]),
    )
    return bool(beyond(bodies, np.array([point]))[0] <= 1e-14)


@each("round_ends", [True, False])
@each("kind", KINDS)
def test_feet_are_the_nearest_points(kind: int, round_ends: bool) -> None:
    rng = np.random.default_rng(kind)
    nearest = np.zeros(2, int)
    for _ in range(500):
        sizes, offset = rng.uniform(0.2, 1.0, 4), rng.normal(size=3)
        sizes[1] = sizes[0] if round_ends or kind == BOX else sizes[1]
        body, point = core(kind, sizes), core(SEGMENT, np.zeros(4))
        away = tuple((-offset / np.linalg.norm(offset)).tolist())
        pose = Pose(STRAIGHT, tuple(offset.tolist()), 5.0, 0.0, 0.0)
        p, q = (0.0, 0.0, 0.0), support(body, away)
        found = feet(point, body, pose, p, q)
        assert is_in(body, found.q)
        assert np.allclose(np.add(found.v, found.p), np.add(found.q, offset), rtol=0.0, atol=1e-15)
        assert found.square == pytest.approx(np.dot(found.v, found.v), rel=1e-14)
        assert found.square <= np.sum((np.array(q) + offset) ** 2)  # no farther than the foremost
        assert is_in(body, across(body.kind, body.size, body.half, q, found.q))
        truth = search(point, body, pose, (0.0, 0.0, 0.0), np.inf)
        if truth.gap > 1e-9:
            is_nearest = abs(np.sqrt(found.square) - truth.gap) <= 1e-12
            nearest += is_nearest, 1
            assert is_nearest or not round_ends
            # a plane between both, whoever says so
            flat = support(body, tuple((np.array(found.v) * -1.0).tolist()))
            reach = np.dot(found.v, np.add(flat, offset))
            assert not is_nearest or reach >= found.square - 1e-12
    assert nearest[1] > 200
    if not round_ends and kind in (CYLINDER, CONE):
        assert nearest[0] < nearest[1]


def test_the_ends_of_a_side_are_on_both_sides_of_the_foot() -> None:
    cylinder, cone = core(CYLINDER, np.ones(4)), core(CONE, np.ones(4))
    for body, p, foot, other in (
        (cylinder, (1.0, 0.0, 1.0), (1.0, 0.0, 0.3), (1.0, 0.0, -1.0)),
        (cylinder, (1.0, 0.0, 1.0), (0.2, 0.1, 1.0), (1.0, 0.0, 1.0)),
        (cone, (1.0, 0.0, -1.0), (0.5, 0.0, 0.0), (0.0, 0.0, 1.0)),
        (cone, (0.0, 0.0, 1.0), (0.5, 0.0, 0.0), (1.0, 0.0, -1.0)),
        (core(BOX, np.ones(4)), (1.0, 1.0, 1.0), (1.0, 0.5, 1.0), (1.0, -1.0, 1.0)),
    ):
        assert across(body.kind, body.size, body.half, p, foot) == other
