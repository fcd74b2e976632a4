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

"""Depth and normal of contacts, as coal and MuJoCo find them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from contact_pairs import between, colliding
from support import row_of, sizes

from obb_collision.typing import Floats

#: Promised accuracy of depth and normal, relative to the sum of half extents.
DEPTH_ACCURACY = 1e-12


def compared(pairs: int, ask: Callable[[Any, Any], tuple[float, Floats]]) -> Any:
    """Ask a peer about ordinary pairs: same axis (n,), its depth and ours, sizes, our axes."""
    a, b = colliding("ordinary scene", pairs)
    found = between(a, b)
    theirs = [ask(row_of(a, row), row_of(b, row)) for row in range(len(a))]
    depths = np.array([depth for depth, _ in theirs])
    normals = np.array([normal for _, normal in theirs])
    same = np.linalg.norm(normals - found.normals, axis=1) <= 1e-5
    return same, depths, found.depths, sizes(a, b), found.axes


def test_coal_finds_the_same_depth_and_normal(pairs: int) -> None:
    coal = pytest.importorskip("coal")

    def ask(a: Any, b: Any) -> tuple[float, Floats]:
        result = coal.CollisionResult()
        request = coal.CollisionRequest(coal.CollisionRequestFlag.CONTACT, 1)
        shapes = [(coal.Box(*(2.0 * h)), coal.Transform3s(r, c)) for c, r, h in (a, b)]
        coal.collide(*shapes[0], *shapes[1], request, result)
        contact = result.getContact(0)
        return -contact.penetration_depth, np.array(contact.normal)

    same, theirs, ours, size, _ = compared(pairs, ask)
    assert same.all()
    assert (np.abs(theirs - ours) <= 1e-6 * size).all()  # its tolerance


MUJOCO_MODEL = """
<mujoco><worldbody>
<body><freejoint/><geom name="a" type="box" size="1 1 1" contype="0" conaffinity="0"/></body>
<body><freejoint/><geom name="b" type="box" size="1 1 1" contype="0" conaffinity="0"/></body>
</worldbody><contact><pair geom1="a" geom2="b"/></contact></mujoco>
"""


def test_mujoco_finds_the_same_or_prefers_a_face_that_is_deeper(pairs: int) -> None:
    """Where MuJoCo takes another axis, ours is an edge axis and less deep: it favours faces."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(MUJOCO_MODEL)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)

    def ask(a: Any, b: Any) -> tuple[float, Floats]:
        for k, (center, rotation, half) in enumerate((a, b)):
            data.geom_xpos[k], data.geom_xmat[k] = center, rotation.ravel()
            model.geom_size[k], model.geom_rbound[k] = half, np.linalg.norm(half)
        mujoco.mj_collision(model, data)
        deepest = np.argmin(data.contact.dist[: data.ncon])
        return -data.contact.dist[deepest], data.contact.frame[deepest, :3].copy()

    same, theirs, ours, size, axes = compared(pairs, ask)
    assert same.mean() > 0.85
    assert (np.abs(theirs - ours)[same] <= DEPTH_ACCURACY * size[same]).all()
    assert (axes[~same] >= 6).all()
    assert (ours[~same] < theirs[~same]).all()
