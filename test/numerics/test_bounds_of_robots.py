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

"""Error bounds of robots: observed error over bound."""

from __future__ import annotations

from fractions import Fraction
from typing import NamedTuple

import numpy as np
from error_bounds import (
    Record,
    Rows,
    Vector,
    check_ratios,
    difference,
    dot,
    exact,
    norm,
    root,
    rounded,
    turn,
)

import obb_collision as oc
from obb_collision.numerics.vec3 import vector_at
from obb_collision.robots.checks.arrays import (
    LINK_PLACING,
    new_placed,
    place_state,
    placed_box,
    slack_of,
)
from obb_collision.robots.checks.model import Model
from obb_collision.typing import Floats

BOX = (0.2, 0.1, 0.3)


def product(a: Rows, b: Rows) -> Rows:
    return [[rounded(dot(row, column)) for column in zip(*b, strict=True)] for row in a]


def applied(a: Rows, p: Vector) -> Vector:
    return [rounded(dot(row, p)) for row in a]


class Joint(NamedTuple):
    """A joint as its URDF has it."""

    kind: str
    xyz: Floats
    rpy: Floats
    axis: Floats


def chain(rng: np.random.Generator, count: int, size: float) -> tuple[str, list[Joint]]:
    """Return the URDF of a chain of joints with a box at its end, and the joints as numbers."""
    joints: list[Joint] = []
    parts = ['<robot name="chain"><link name="l0"/>']
    for n in range(count):
        kind = "prismatic" if rng.random() < 0.2 else "continuous"
        joint = Joint(kind, rng.normal(0, size, 3), rng.uniform(-3, 3, 3), rng.normal(size=3))
        joints.append(joint)
        box = '<collision><geometry><box size="{} {} {}"/></geometry></collision>'.format(*BOX)
        xyz, rpy, axis = (" ".join(map(repr, each.tolist())) for each in joint[1:])
        parts.append(
            f'<link name="l{n + 1}">{box if n == count - 1 else ""}</link>'
            f'<joint name="j{n}" type="{kind}"><parent link="l{n}"/><child link="l{n + 1}"/>'
            f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
            f'<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        )
    return "".join([*parts, "</robot>"]), joints


def exact_corners(joints: list[Joint], state: list[float]) -> list[Vector]:
    """Return the corners of the box at the end."""
    units = [[Fraction(int(i == j)) for j in range(3)] for i in range(3)]
    place, rows = [Fraction(0)] * 3, units
    for joint, value in zip(joints, state, strict=True):
        xyz, axis = exact(joint.xyz), exact(joint.axis)
        place = [p + step for p, step in zip(place, applied(rows, xyz), strict=True)]
        for angle, unit in zip(joint.rpy[::-1].tolist(), reversed(units), strict=True):
            rows = product(rows, turn(unit, Fraction(angle)))
        if joint.kind == "prismatic":
            way = [Fraction(value) * each / norm(axis) for each in axis]
            place = [p + step for p, step in zip(place, applied(rows, way), strict=True)]
        else:
            rows = product(rows, turn(axis, Fraction(value)))
    return [
        [p + step for p, step in zip(place, applied(rows, corner), strict=True)]
        for corner in corners_of_box()
    ]


def corners_of_box() -> list[Vector]:
    half = [Fraction(size) / 2 for size in BOX]
    signs = [(a, b, c) for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)]
    return [[s * h for s, h in zip(each, half, strict=True)] for each in signs]


def test_bodies_of_robots(record_property: Record) -> None:
    """Corners of a box at the end of chains of joints of all lengths and sizes."""
    rng = np.random.default_rng(7)
    ratios = []
    for count in (1, 2, 7, 30, 100):
        for size in (0.0, 1e-3, 0.3, 1e3) if count < 30 else (0.3,):
            text, joints = chain(rng, count, size)
            robot = oc.Robot.from_urdf(text)
            model = Model([robot], [None], np.array([[0.0, 0, 0, 0, 0, 0, 1]]))
            arrays = model.prepared(oc.Scene()).checked
            state = np.where([j.kind == "prismatic" for j in joints],
                             rng.uniform(-1, 1, count), rng.uniform(-6, 6, count))  # fmt: skip
            placed = new_placed(arrays)
            place_state(arrays, state[None], 0, placed)
            box = placed_box(arrays.bodies, placed, 0)
            center, axes = exact(box.center), [exact(axis) for axis in box.axes]
            bound = Fraction(slack_of(arrays.bodies, 0, vector_at(placed.centers, 0)))
            assert bound >= Fraction(LINK_PLACING) * root(dot(center, center))
            for corner, true in zip(corners_of_box(), exact_corners(joints, state.tolist()),
                                    strict=True):  # fmt: skip
                found = [c + sum((h * axis[k] for h, axis in zip(corner, axes, strict=True)),
                                 Fraction(0)) for k, c in enumerate(center)]  # fmt: skip
                ratios.append(norm(difference(found, true)) / bound)
    check_ratios(record_property, ratios)
