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

"""Where the links of a robot are, by 4x4 matrices and scipy's rotations, one joint at a time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from small_robots import LIMIT
from small_robots import joint as urdf_joint

Matrix = NDArray[np.float64]
#: Kinds of joints with one variable.
SINGLE = ("revolute", "continuous", "prismatic")


@dataclass(frozen=True)
class OracleJoint:
    """A joint as a URDF writes it; mimic: (joint, multiplier, offset)."""

    name: str
    kind: str
    parent: str
    child: str
    xyz: tuple[float, ...]
    rpy: tuple[float, ...]
    axis: tuple[float, ...]
    mimic: tuple[str, float, float] | None = None


@st.composite
def joint_trees(
    draw: st.DrawFn, kinds: tuple[str, ...], count: int = 9, back: int = 9, most: float = 3.0
) -> list[OracleJoint]:
    """Draw joints of a tree of up to so many links named by number, whose root is 0.

    back: how many links before it a parent may be; most: of its numbers.
    """
    number = st.floats(-most, most, allow_subnormal=False)
    triple = st.tuples(number, number, number)
    axis = triple.filter(lambda v: np.linalg.norm(v) > 0.1 and v[2] > -0.99 * np.linalg.norm(v))
    found: list[OracleJoint] = []
    for child in range(1, draw(st.integers(2, count))):
        kind, mimic = draw(st.sampled_from(kinds)), None
        single = [one.name for one in found if one.kind in SINGLE]
        if single and kind in SINGLE and draw(st.booleans()):
            mimic = (draw(st.sampled_from(single)), draw(number), draw(number))
        parent = str(draw(st.integers(max(0, child - back), child - 1)))
        numbers = draw(triple), draw(triple), draw(axis)
        found.append(OracleJoint(f"j{child}", kind, parent, str(child), *numbers, mimic))
    return found


def written(one: OracleJoint, limit: str = LIMIT) -> str:
    """Return a joint as its URDF."""
    xyz, rpy, axis = (" ".join(map(repr, numbers)) for numbers in (one.xyz, one.rpy, one.axis))
    inner = f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>{limit}'
    if one.mimic is not None:
        inner += '<mimic joint="{}" multiplier="{!r}" offset="{!r}"/>'.format(*one.mimic)
    return urdf_joint(one.name, one.kind, one.parent, one.child, inner)


def rigid(rotation: Rotation, place: NDArray[np.float64]) -> Matrix:
    """Return a rotation and a translation as one matrix."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation.as_matrix(), place
    return matrix


def shortest_turn(axis: Matrix) -> Rotation:
    """Return the shortest rotation of z to an axis; of opposite ones that about x."""
    across = np.cross([0.0, 0.0, 1.0], axis)
    sine = np.linalg.norm(across)
    if sine == 0.0:
        return Rotation.from_rotvec([np.pi if axis[2] < 0.0 else 0.0, 0.0, 0.0])
    return Rotation.from_rotvec(across / sine * np.arctan2(sine, axis[2]))


def motion(joint: OracleJoint, values: dict[str, float]) -> Matrix:
    """Return what a joint does for the values of the variables."""
    axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
    if joint.kind == "fixed":
        return np.eye(4)
    if joint.kind == "planar":
        x, y, theta = (values[f"{joint.name}/{part}"] for part in ("x", "y", "theta"))
        frame = shortest_turn(axis)
        return rigid(Rotation.from_rotvec(theta * axis), frame.apply([x, y, 0.0]))
    if joint.kind == "floating":
        parts = [values[f"{joint.name}/trans_{part}"] for part in "xyz"]
        turn = [values[f"{joint.name}/rot_{part}"] for part in "xyzw"]
        return rigid(Rotation.from_quat(turn), np.array(parts))
    value = values[joint.name]
    if joint.kind == "prismatic":
        return rigid(Rotation.identity(), value * axis)
    return rigid(Rotation.from_rotvec(value * axis), np.zeros(3))


def link_matrices(joints: list[OracleJoint], state: dict[str, float]) -> dict[str, Matrix]:
    """Return the pose of each link, of which 0 is the root; joints: those of parents first."""
    values, found = dict(state), {"0": np.eye(4)}
    for joint in joints:
        if joint.mimic is not None:
            other, multiplier, offset = joint.mimic
            values[joint.name] = multiplier * values[other] + offset
        origin = rigid(Rotation.from_euler("xyz", joint.rpy), np.array(joint.xyz))
        found[joint.child] = found[joint.parent] @ origin @ motion(joint, values)
    return found
