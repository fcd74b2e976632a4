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
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Matrix = NDArray[np.float64]


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
    value = value_of(joint, values)
    if joint.kind == "prismatic":
        return rigid(Rotation.identity(), value * axis)
    return rigid(Rotation.from_rotvec(value * axis), np.zeros(3))


def value_of(joint: OracleJoint, values: dict[str, float]) -> float:
    """Return the value of a joint with one variable, its own or that of those it mimics."""
    if joint.mimic is None:
        return values[joint.name]
    other, multiplier, offset = joint.mimic
    return multiplier * values[other] + offset


def link_matrices(
    root: str, joints: list[OracleJoint], values: dict[str, float]
) -> dict[str, Matrix]:
    """Return the pose of each link; joints: those of parents first.

    values: of all joints that move, those that mimic others too.
    """
    found = {root: np.eye(4)}
    for joint in joints:
        origin = rigid(Rotation.from_euler("xyz", joint.rpy), np.array(joint.xyz))
        found[joint.child] = found[joint.parent] @ origin @ motion(joint, values)
    return found
