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

"""Other verdicts on whether two boxes collide: a textbook test and the installed peers.

A judge takes two triples (centers (n, 3), rotations (n, 3, 3), half extents (n, 3)) and
gives (n,) int8: COLLIDING, FREE, or FAILED where it raised an exception. Every peer runs at its
defaults and gets the doubles as they are stored. A peer that is not installed is no error.
"""

from __future__ import annotations

import importlib
import importlib.metadata
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tools.cases.placement import Arrays

FREE, COLLIDING, FAILED = 0, 1, -1

Answers = NDArray[np.int8]
Judge = Callable[[Arrays, Arrays], Answers]

#: What textbooks add to abs(R) against null cross products of parallel edges (Ericson 2005, 4.4.1
#: says "an epsilon"; 1e-6 is what implementations use most).
TEXTBOOK_EPSILON = 1e-6


@dataclass(frozen=True)
class Peer:
    """A library to compare with: its name for people, its distribution, and how it is called."""

    name: str
    distribution: str
    module: str
    make: Callable[[ModuleType], Judge]
    how: str

    def version(self) -> str | None:
        """Return the installed version, or None."""
        try:
            return importlib.metadata.version(self.distribution)
        except importlib.metadata.PackageNotFoundError:
            return None

    def judge(self) -> Judge | None:
        """Return the judge, or None where the peer can't be imported."""
        try:
            return self.make(importlib.import_module(self.module))
        except ImportError:
            return None


def textbook(a: Arrays, b: Arrays, epsilon: float = TEXTBOOK_EPSILON) -> Answers:
    """Run the 15-axis test with projected radii as printed in textbooks, in float64.

    Gottschalk, Lin, Manocha 1996; Ericson 2005, 4.4.1, ``epsilon`` added to abs(R).
    """
    (center_a, rot_a, h), (center_b, rot_b, f) = a, b
    t = np.einsum("nki,nk->ni", rot_a, center_b - center_a)
    r = np.einsum("nki,nkj->nij", rot_a, rot_b)
    q = np.abs(r) + epsilon
    apart = (np.abs(t) > h + np.einsum("nij,nj->ni", q, f)).any(axis=1)
    along_b = np.abs(np.einsum("ni,nij->nj", t, r))
    apart |= (along_b > np.einsum("ni,nij->nj", h, q) + f).any(axis=1)
    for i in range(3):
        i1, i2 = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            j1, j2 = (j + 1) % 3, (j + 2) % 3
            radius = h[:, i1] * q[:, i2, j] + h[:, i2] * q[:, i1, j]
            radius += f[:, j1] * q[:, i, j2] + f[:, j2] * q[:, i, j1]
            apart |= np.abs(t[:, i2] * r[:, i1, j] - t[:, i1] * r[:, i2, j]) > radius
    return np.where(apart, FREE, COLLIDING).astype(np.int8)


def _rows(a: Arrays, b: Arrays) -> Iterator[tuple[Any, ...]]:
    return zip(*a, *b, strict=True)


def _one_by_one(ask: Callable[..., bool]) -> Judge:
    """Make a judge from a function of one pair; an exception is an answer too."""

    def judge(a: Arrays, b: Arrays) -> Answers:
        answers = np.empty(len(a[0]), np.int8)
        for n, row in enumerate(_rows(a, b)):
            try:
                answers[n] = COLLIDING if ask(*row) else FREE
            except Exception:  # peers raise any exception; the table counts it
                answers[n] = FAILED
        return answers

    return judge


def _fcl(fcl: ModuleType) -> Judge:
    def collides(ca: Any, ra: Any, ha: Any, cb: Any, rb: Any, hb: Any) -> bool:
        one = fcl.CollisionObject(fcl.Box(*(2.0 * ha)), fcl.Transform(ra, ca))
        two = fcl.CollisionObject(fcl.Box(*(2.0 * hb)), fcl.Transform(rb, cb))
        return bool(fcl.collide(one, two, fcl.CollisionRequest(), fcl.CollisionResult()))

    return _one_by_one(collides)


def _coal(coal: ModuleType) -> Judge:
    def collides(ca: Any, ra: Any, ha: Any, cb: Any, rb: Any, hb: Any) -> bool:
        one, two = coal.Box(*(2.0 * ha)), coal.Box(*(2.0 * hb))
        poses = coal.Transform3s(ra, ca), coal.Transform3s(rb, cb)
        result = coal.CollisionResult()
        coal.collide(one, poses[0], two, poses[1], coal.CollisionRequest(), result)
        return bool(result.isCollision())

    return _one_by_one(collides)


#: One explicit pair: mj_collision then goes to the two boxes without a broad phase in between.
_MUJOCO_MODEL = """
<mujoco>
  <worldbody>
    <body><freejoint/><geom name="a" type="box" size="1 1 1" contype="0" conaffinity="0"/></body>
    <body><freejoint/><geom name="b" type="box" size="1 1 1" contype="0" conaffinity="0"/></body>
  </worldbody>
  <contact><pair geom1="a" geom2="b"/></contact>
</mujoco>
"""


def _mujoco(mujoco: ModuleType) -> Judge:
    model = mujoco.MjModel.from_xml_string(_MUJOCO_MODEL)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)

    def collides(ca: Any, ra: Any, ha: Any, cb: Any, rb: Any, hb: Any) -> bool:
        # Written straight into the world poses, so that no conversion rounds anything.
        for k, (center, rotation, half) in enumerate(((ca, ra, ha), (cb, rb, hb))):
            data.geom_xpos[k], data.geom_xmat[k] = center, rotation.ravel()
            model.geom_size[k], model.geom_rbound[k] = half, np.sqrt((half * half).sum())
        mujoco.mj_collision(model, data)
        return bool(data.ncon > 0)

    return _one_by_one(collides)


PEERS = (
    Peer("python-fcl", "python-fcl", "fcl", _fcl, "fcl.collide"),
    Peer("coal", "coal", "coal", _coal, "coal.collide"),
    Peer("MuJoCo", "mujoco", "mujoco", _mujoco, "mj_collision, margin 0, contacts > 0"),
)
