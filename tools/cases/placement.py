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

"""Place two boxes next to each other on purpose, for ``families``.

All arrays are batches: rotations (n, 3, 3) with the axes as columns, half extents (n, 3),
centres (n, 3), float64. Nothing here needs to be exact: whatever comes out is a pair of
boxes like any other, and exact arithmetic gives the right verdict.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Arrays = tuple[Array, Array, Array]
Pairs = tuple[Arrays, Arrays]

# Generators nearly perpendicular to the chosen axis do not matter for the gap along it,
# so their place is random; 1e-9 is far below any angle that a family asks for on purpose
# except in the near-parallel ones, where both readings are worth having.
PERPENDICULAR = 1e-9
EPS = float(np.finfo(np.float64).eps)


def log_uniform(
    rng: np.random.Generator, low: float, high: float, shape: int | tuple[int, ...]
) -> Array:
    """Random numbers between 10**low and 10**high, uniform in the exponent."""
    return np.asarray(10.0 ** rng.uniform(low, high, shape))


def random_rotations(rng: np.random.Generator, n: int) -> Array:
    """(n, 3, 3) uniformly distributed rotations, orthonormal to rounding."""
    return orthonormal(rotations_of(rng.normal(size=(n, 4))))


def rotations_of(quaternions: Array) -> Array:
    """(n, 3, 3) matrices of quaternions x y z w (n, 4) of any length."""
    x, y, z, w = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def orthonormal(rotations: Array) -> Array:
    """One Newton step towards the nearest orthonormal matrix: errors shrink to rounding."""
    gram = np.swapaxes(rotations, 1, 2) @ rotations
    return rotations @ (1.5 * np.eye(3) - 0.5 * gram)


def turns(axes: Array, angles: Array) -> Array:
    """(n, 3, 3) rotations about (n, 3) axes by (n,) angles; accurate for tiny angles."""
    k = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    zero = np.zeros(len(k))
    cross = np.stack(
        [zero, -k[:, 2], k[:, 1], k[:, 2], zero, -k[:, 0], -k[:, 1], k[:, 0], zero], axis=1
    ).reshape(-1, 3, 3)
    versine = 2.0 * np.sin(angles / 2.0) ** 2
    sine = np.sin(angles)[:, None, None]
    return np.eye(3) + sine * cross + versine[:, None, None] * (cross @ cross)


def signed_permutations(rng: np.random.Generator, n: int) -> Array:
    """(n, 3, 3) matrices that relabel and flip axes, of either handedness."""
    order = np.argsort(rng.random((n, 3)), axis=1)
    signs = rng.choice([-1.0, 1.0], (n, 3))
    return np.asarray(np.eye(3)[order] * signs[:, None, :])


def candidate_axes(rot_a: Array, rot_b: Array) -> Array:
    """(n, 15, 3) unit axes: faces of a, faces of b, edges a_i x b_j; zero when parallel."""
    a, b = np.swapaxes(rot_a, 1, 2), np.swapaxes(rot_b, 1, 2)
    edges = np.cross(a[:, :, None, :], b[:, None, :, :]).reshape(-1, 9, 3)
    axes = np.concatenate([a, b, edges], axis=1)
    length = np.linalg.norm(axes, axis=2, keepdims=True)
    return np.asarray(axes / np.where(length == 0.0, 1.0, length))


def small_gaps(rng: np.random.Generator, sizes: Array, smallest: float = -16.0) -> Array:
    """(n,) gaps of either sign: zero, a few roundings, or up to a hundredth of the size."""
    n = len(sizes)
    roundings = rng.integers(-8, 9, n) * EPS
    spread = rng.choice([-1.0, 1.0], n) * log_uniform(rng, smallest, -2.0, n)
    return np.where(rng.random(n) < 0.25, roundings, spread) * sizes


def facet_offsets(
    rng: np.random.Generator,
    rot_a: Array,
    half_a: Array,
    rot_b: Array,
    half_b: Array,
    index: NDArray[np.int64],
    gaps: Array,
    spread: float = 0.98,
) -> Array:
    """(n, 3) centre offsets for which candidate axis ``index`` sees the gap ``gaps`` (n,).

    The difference of two boxes is a zonotope with the six edge vectors as generators. The
    offset is put on its facet (or edge) normal to the axis: generators across the axis go
    to a random place within ``spread`` of their length, the others to their end, and
    a last step along the axis makes up the gap. In the middle of a facet, with a small gap,
    that axis is the only one to separate and the one of minimum penetration.
    """
    rows = np.arange(len(index))
    axis = candidate_axes(rot_a, rot_b)[rows, index]
    lost = ~axis.any(axis=1)
    axis[lost] = rot_a[lost, :, 0]
    directions = np.concatenate([np.swapaxes(rot_a, 1, 2), np.swapaxes(rot_b, 1, 2)], axis=1)
    half = np.concatenate([half_a, half_b], axis=1)
    along = np.einsum("nij,nj->ni", directions, axis)
    free = (np.abs(along) < PERPENDICULAR) | _across(index)
    weight = np.where(free, rng.uniform(-spread, spread, free.shape), np.sign(along)) * half
    offset = np.einsum("ni,nij->nj", weight, directions)
    missing = (np.abs(along) * half).sum(axis=1) + gaps - (offset * axis).sum(axis=1)
    return np.asarray(offset + missing[:, None] * axis)


def _across(index: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(n, 6) mask of the generators that span the facet of each candidate axis."""
    table = np.zeros((15, 6), dtype=bool)
    for k in range(15):
        if k < 6:
            box = 3 * (k // 3)
            table[k, [box + (k + 1) % 3, box + (k + 2) % 3]] = True
        else:
            table[k, [(k - 6) // 3, 3 + (k - 6) % 3]] = True
    return np.asarray(table[index])


def place(
    rng: np.random.Generator,
    rot_a: Array,
    half_a: Array,
    rot_b: Array,
    half_b: Array,
    *,
    index: NDArray[np.int64] | None = None,
    gaps: Array | None = None,
    origin: Array | float = 0.0,
    spread: float = 0.98,
) -> Pairs:
    """Pairs that nearly touch along a candidate axis (any of the 15 unless given).

    ``origin`` (n, 3) is added to both centres in floating point, rounding and all.
    """
    n = len(rot_a)
    if index is None:
        index = rng.integers(0, 15, n)
    if gaps is None:
        gaps = small_gaps(rng, half_a.sum(axis=1) + half_b.sum(axis=1))
    offset = facet_offsets(rng, rot_a, half_a, rot_b, half_b, index, gaps, spread)
    center_a = np.zeros((n, 3)) + origin
    return (center_a, rot_a, half_a), (center_a + offset, rot_b, half_b)
