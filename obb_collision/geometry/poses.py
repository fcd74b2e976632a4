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

"""Poses: their algebra, quaternions (x y z w) and rotation matrices, and how a pose moves a box.

A pose is seven numbers, ``x y z qx qy qz qw``: the position in metres and a unit quaternion.
Poses come as arrays (..., 7) and quaternions as (..., 4); leading dimensions broadcast. Many are
turned into matrices a block at a time: each kind of number stands in one run of memory, so that the
processor divides several at once, 7 ns a pose where one at a time takes 24. The bits are the same.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.geometry.validation import (
    UNIT_TOLERANCE,
    as_array,
    as_quaternions,
    as_shaped,
    defect_of,
    orthonormal_defect,
    orthonormal_of,
    orthonormalize,
)
from obb_collision.numerics.constants import MAX_MAGNITUDE, ORTHONORMAL_ROUNDING
from obb_collision.numerics.vec3 import axes_of, rows_at, vector_at
from obb_collision.typing import Axes, Floats, Vector

#: Poses in a block: their numbers (7 kB) stay in the fastest memory.
BLOCK = 64
#: Rows of a block: the quaternion, the rows of its matrix, how far its length is from 1, and the
#: matrix from orthonormal.
MATRIX, OFF_UNIT, DEFECT, ROWS = 4, 13, 14, 15


@njit
def turn_block(block: Floats, count: int) -> None:
    """Write matrices and defects of the quaternions of a block (ROWS, BLOCK)."""
    for n in range(count):  # without a branch
        x, y, z, w = block[0, n], block[1, n], block[2, n], block[3, n]
        largest = max(max(abs(x), abs(y)), max(abs(z), abs(w)))
        x, y, z, w = x / largest, y / largest, z / largest, w / largest
        norm = math.sqrt(x * x + y * y + z * z + w * w)
        a, b, c = rotation_of((x / norm, y / norm, z / norm, w / norm))
        block[OFF_UNIT, n], block[DEFECT, n] = abs(largest * norm - 1.0), abs(defect_of((a, b, c)))
        block[MATRIX, n], block[MATRIX + 1, n], block[MATRIX + 2, n] = a
        block[MATRIX + 3, n], block[MATRIX + 4, n], block[MATRIX + 5, n] = b
        block[MATRIX + 6, n], block[MATRIX + 7, n], block[MATRIX + 8, n] = c


@njit
def matrix_in(block: Floats, n: int) -> Axes:
    """Return the rows of matrix n of a block, made orthonormal where rounding left it too far off.

    Its quaternion must not be zero.
    """
    matrix = (
        (block[MATRIX, n], block[MATRIX + 1, n], block[MATRIX + 2, n]),
        (block[MATRIX + 3, n], block[MATRIX + 4, n], block[MATRIX + 5, n]),
        (block[MATRIX + 6, n], block[MATRIX + 7, n], block[MATRIX + 8, n]),
    )
    return orthonormal_of(matrix) if block[DEFECT, n] > ORTHONORMAL_ROUNDING else matrix


@njit
def rotation_of(quaternion: tuple[float, float, float, float]) -> Axes:
    """Return the rows of the rotation matrix of a unit quaternion."""
    x, y, z, w = quaternion
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)),
        (2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)),
        (2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)),
    )


#: Poses below which a second thread does not pay: 40 us.
FEWEST_POSES = 4096
#: One pose, or quaternion, as plain numbers.
Pose = tuple[float, float, float, float, float, float, float]
Quaternion = tuple[float, float, float, float]

#: The pose that changes nothing.
IDENTITY: Pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
IDENTITY_POSE: Floats = np.array(IDENTITY)
IDENTITY_POSE.setflags(write=False)


def as_poses(
    value: ArrayLike,
    name: str = "poses",
    numbers: NDArray[np.int64] | None = None,
    warn: bool = True,
) -> tuple[Floats, Floats]:
    """Check poses (n, 7) and return positions (n, 3) and rotation matrices (n, 3, 3).

    Quaternions are normalised; warn: whether to warn of one far from unit length.
    numbers (n,): row numbers for errors and warnings.
    """
    poses = as_shaped(value, name, (None, 7))
    if len(poses):
        positions, matrices = np.empty((len(poses), 3)), np.empty((len(poses), 3, 3))
        if all(run(_read_kernel, len(poses), FEWEST_POSES, poses, positions, matrices)):
            return positions, matrices
    poses = as_array(poses, name, (None, 7))  # which raises or warns
    quaternions = as_quaternions(poses[:, 3:], f"{name} (quaternion)", (None, 4), numbers, warn)
    return np.ascontiguousarray(poses[:, :3]), matrices_from_quaternions(quaternions)


def unit_quaternions(quaternions: ArrayLike, name: str = "quaternions") -> Floats:
    """Return quaternions (..., 4) scaled to unit length; ValueError for one of length 0."""
    array = np.asarray(quaternions, np.float64)
    flat = as_quaternions(array.reshape(-1, 4), name, (None, 4), warn=False)
    return flat.reshape(array.shape)


def unit_poses(poses: ArrayLike, name: str = "poses") -> Floats:
    """Return poses (..., 7), quaternions scaled to unit length; ValueError for one of length 0."""
    array = np.asarray(poses, np.float64)
    turns = unit_quaternions(array[..., 3:], f"{name} (quaternion)")
    return np.concatenate([array[..., :3], turns], axis=-1)


def compose_poses(outer: ArrayLike, inner: ArrayLike) -> Floats:
    """Return poses ``inner``, relative to ``outer``, in the frame that ``outer`` is relative to.

    Poses are (..., 7); quaternions are normalised. Positions that overflow are infinite or NaN.
    """
    a, b = unit_poses(outer), unit_poses(inner)
    places = _placed(a[..., :3], a[..., 3:], b[..., :3])
    return np.concatenate([places, multiply_quaternions(a[..., 3:], b[..., 3:])], axis=-1)


def inverse_poses(poses: ArrayLike) -> Floats:
    """Return the inverses of poses (..., 7), x y z (metres) qx qy qz qw."""
    back = unit_poses(poses) * (1.0, 1.0, 1.0, -1.0, -1.0, -1.0, 1.0)
    return np.concatenate([rotate_vectors(back[..., 3:], -back[..., :3]), back[..., 3:]], axis=-1)


def rotate_vectors(quaternions: Floats, vectors: Floats) -> Floats:
    """Return vectors (..., 3) turned by unit quaternions."""
    return _placed(np.zeros(3), quaternions, vectors)


def _placed(positions: Floats, quaternions: Floats, vectors: Floats) -> Floats:
    """Return positions + rotated vectors: v + 2 w (u x v) + 2 u x (u x v) for (u, w)."""
    axes, w = quaternions[..., :3], quaternions[..., 3:]
    with np.errstate(over="ignore", invalid="ignore"):  # see ``compose_poses``
        turned = 2.0 * np.cross(axes, vectors)
        result: Floats = positions + vectors + w * turned + np.cross(axes, turned)
    return result


def multiply_quaternions(a: Floats, b: Floats) -> Floats:
    """Return the products a b of quaternions: the rotation b followed by the rotation a."""
    ax, ay, az, aw = (a[..., k] for k in range(4))
    bx, by, bz, bw = (b[..., k] for k in range(4))
    return np.stack(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ],
        axis=-1,
    )


def quaternion_from_rpy(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Return x y z w of the turn by roll about x, then pitch about y, then yaw about z; fixed axes.

    As in ROS REP 103; angles in radians.
    """
    (sr, cr), (sp, cp), (sy, cy) = (
        (math.sin(angle / 2.0), math.cos(angle / 2.0)) for angle in (roll, pitch, yaw)
    )
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def matrices_from_quaternions(quaternions: Floats) -> Floats:
    """Return (n, 3, 3) rotation matrices of unit quaternions (n, 4).

    Those that rounding leaves off by more than ORTHONORMAL_ROUNDING are made orthonormal.
    """
    matrices = np.empty((len(quaternions), 3, 3))
    _fill_matrices(np.ascontiguousarray(quaternions), matrices)
    loose = np.abs(orthonormal_defect(matrices)) > ORTHONORMAL_ROUNDING
    if loose.any():
        matrices[loose] = orthonormalize(matrices[loose])
    return matrices


def quaternions_from_matrices(matrices: Floats) -> Floats:
    """Return unit quaternions (n, 4), w >= 0, of rotation matrices (n, 3, 3).

    Shepperd's method: the largest of the four components comes from a square root, the others
    by division, so none loses accuracy.
    """
    quaternions = np.empty((len(matrices), 4))
    fill_quaternions(np.ascontiguousarray(matrices), quaternions)
    return quaternions


@njit
def _read_kernel(poses: Floats, positions: Floats, matrices: Floats, start: int, stop: int) -> bool:
    """Write positions and rotations of poses ``start`` to ``stop``; False where one is unusual."""
    block = np.empty((ROWS, BLOCK))
    usual = True
    for first in range(start, stop, BLOCK):
        count = min(BLOCK, stop - first)
        for n in range(count):
            for k in range(3):
                positions[first + n, k] = poses[first + n, k]
                usual &= abs(poses[first + n, k]) <= MAX_MAGNITUDE  # False for NaN, too
            for k in range(4):
                block[k, n] = poses[first + n, 3 + k]
                usual &= abs(block[k, n]) <= MAX_MAGNITUDE
        turn_block(block, count)
        for n in range(count):
            usual &= block[OFF_UNIT, n] <= UNIT_TOLERANCE  # False for a zero quaternion, too
        if not usual:
            return False
        for n in range(count):
            a, b, c = matrix_in(block, n)
            for k in range(3):
                matrices[first + n, 0, k] = a[k]
                matrices[first + n, 1, k] = b[k]
                matrices[first + n, 2, k] = c[k]
    return True


@njit
def _fill_matrices(quaternions: Floats, out: Floats) -> None:
    for n in range(len(quaternions)):
        x, y, z, w = quaternions[n]
        u, v, t = rotation_of((x, y, z, w))
        for k in range(3):
            out[n, 0, k], out[n, 1, k], out[n, 2, k] = u[k], v[k], t[k]


@njit
def fill_quaternions(matrices: Floats, out: Floats) -> None:
    """Write the quaternions (n, 4) of ``quaternions_from_matrices``."""
    for n in range(len(matrices)):
        m = matrices[n]
        trace = m[0, 0] + m[1, 1] + m[2, 2]
        best = 3
        largest = trace
        for k in range(3):
            if m[k, k] > largest:
                largest = m[k, k]
                best = k
        if best == 3:
            out[n, 0] = m[2, 1] - m[1, 2]
            out[n, 1] = m[0, 2] - m[2, 0]
            out[n, 2] = m[1, 0] - m[0, 1]
            out[n, 3] = 1.0 + trace
        else:
            i = best
            j = (i + 1) % 3
            k = (i + 2) % 3
            out[n, i] = 1.0 + 2.0 * m[i, i] - trace
            out[n, j] = m[j, i] + m[i, j]
            out[n, k] = m[k, i] + m[i, k]
            out[n, 3] = m[k, j] - m[j, k]
        x, y, z, w = out[n]
        norm = np.sqrt(x * x + y * y + z * z + w * w)
        norm = -norm if w < 0.0 else norm
        out[n, 0], out[n, 1], out[n, 2], out[n, 3] = x / norm, y / norm, z / norm, w / norm


class FrameArrays(NamedTuple):
    """Frames for kernels: centers (n, 3) and rotations (n, 3, 3)."""

    centers: Floats
    rotations: Floats


@njit
def place_boxes(poses: FrameArrays, local: FrameArrays, rows: np.ndarray, out: FrameArrays) -> None:
    """Move local boxes to the world: row ``rows[n]`` of ``out`` gets pose n applied to its own."""
    for n in range(len(rows)):
        place_box(vector_at(poses.centers, n), rows_at(poses.rotations, n), local, rows[n], out)


@njit
def place_box(
    position: Vector, rotation: Axes, local: FrameArrays, row: int, out: FrameArrays
) -> None:
    """Move the local box of a row to the world; rotation: the rows of the pose's matrix."""
    center = vector_at(local.centers, row)
    x, y, z = axes_of(local.rotations, row)
    for i in range(3):
        across = rotation[i]
        out.centers[row, i] = position[i] + _sum_of_products(across, center)
        out.rotations[row, i, 0] = _sum_of_products(across, x)
        out.rotations[row, i, 1] = _sum_of_products(across, y)
        out.rotations[row, i, 2] = _sum_of_products(across, z)


@njit
def _sum_of_products(u: Vector, v: Vector) -> float:
    """Return the scalar product, never -0.0."""
    return 0.0 + u[0] * v[0] + u[1] * v[1] + u[2] * v[2]
