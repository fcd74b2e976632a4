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

"""Pairs that touch *exactly*, in exact arithmetic, also with rotations full of roundings.

A power of two times a stored axis is a stored number without rounding, and a difference of
two stored centres needs no rounding in exact arithmetic. So centres made of such multiples
give contacts that are exact for the doubles as stored, where no floating-point test can
decide on which side of touching a pair is.
"""

from __future__ import annotations

import numpy as np

from obb_collision.benchmarks.cases.placement import (
    Array,
    Arrays,
    Pairs,
    random_rotations,
    signed_permutations,
)

Rng = np.random.Generator
_KINDS = 5


def exact_contacts(rng: Rng, n: int) -> Pairs:
    """Stacks and resting contacts: on a dyadic grid, turned together, decimal, end on face."""
    kind = rng.integers(0, _KINDS, n)
    makers = (_grid, _turned_together, _turned_stack, _decimal_stack, _end_on_face)
    made = [maker(rng, n) for maker in makers]
    return _mixed(kind, [m[0] for m in made]), _mixed(kind, [m[1] for m in made])


def flat_contacts(rng: Rng, n: int) -> Pairs:
    """Make the same with zero extents: plates edge to edge, crossing segments, points on plates."""
    kind = rng.integers(0, 3, n)
    made = [_flat_grid(rng, n), _end_on_face(rng, n), _flat_turned(rng, n)]
    return _mixed(kind, [m[0] for m in made]), _mixed(kind, [m[1] for m in made])


def _mixed(kind: np.ndarray, made: list[Arrays]) -> Arrays:
    rows = np.arange(len(kind))
    centers, rotations, halves = (np.stack([m[k] for m in made]) for k in range(3))
    return centers[kind, rows], rotations[kind, rows], halves[kind, rows]


def _grid(rng: Rng, n: int) -> Pairs:
    """Dyadic boxes with axes along the grid, face to face, edge to edge or corner to corner."""
    half_a, half_b = rng.integers(1, 17, (2, n, 3)) / 16.0
    reach = half_a + half_b
    side = rng.choice([-1.0, 1.0], (n, 3))
    touching = rng.random((n, 3)) < 0.4
    inside = rng.integers(-16, 17, (n, 3)) / 16.0
    offset = np.where(touching, side * reach, inside)
    center_a = rng.integers(-64, 65, (n, 3)) / 16.0
    center_a += rng.integers(-(2**30), 2**30, (n, 3)) * rng.integers(0, 2, (n, 1))  # up to 1e9 m
    permute_a, permute_b = signed_permutations(rng, n), signed_permutations(rng, n)
    a = (center_a, permute_a, _own_order(permute_a, half_a))
    return a, (center_a + offset, permute_b, _own_order(permute_b, half_b))


def _own_order(permutation: Array, half: Array) -> Array:
    """Half extents along x y z, given in the order of the box's own axes."""
    return np.asarray(np.einsum("nij,ni->nj", np.abs(permutation), half))


def _flat_grid(rng: Rng, n: int) -> Pairs:
    """`_grid` with any extents zero, the offsets then random on the grid or in contact."""
    half_a, half_b = rng.integers(0, 3, (2, n, 3)) / 4.0
    offset = rng.integers(-4, 5, (n, 3)) / 4.0
    permute = signed_permutations(rng, n)
    center_a = rng.integers(-64, 65, (n, 3)) / 16.0
    identity = np.broadcast_to(np.eye(3), (n, 3, 3))
    return (center_a, identity, half_a), (center_a + offset, permute, half_b)


def _powers(rng: Rng, n: int) -> Array:
    """(n, 1) powers of two."""
    return np.asarray(2.0 ** rng.integers(-3, 4, (n, 1)))


def _turned_together(rng: Rng, n: int) -> Pairs:
    """One rotation for both; centres on multiples of its axes: faces meet exactly, everywhere."""
    rotation = random_rotations(rng, n)
    rows, i = np.arange(n), rng.integers(0, 3, n)
    j = (i + 1) % 3
    distance, sideways = _powers(rng, n), _powers(rng, n)
    share = rng.integers(1, 16, n) / 16.0
    half_a, half_b = rng.uniform(0.5, 8.0, (2, n, 3))
    half_a[rows, i] = distance[:, 0] * share
    half_b[rows, i] = distance[:, 0] * (1.0 - share)
    center_a = sideways * rotation[rows, :, j] * rng.choice([0.0, 1.0], (n, 1))
    center_b = distance * rotation[rows, :, i]
    return (center_a, rotation, half_a), (center_b, rotation.copy(), half_b)


def _flat_turned(rng: Rng, n: int) -> Pairs:
    """`_turned_together` with the third extent zero: coplanar plates, edge to edge."""
    (center_a, rotation, half_a), (center_b, same, half_b) = _turned_together(rng, n)
    flat = rng.integers(0, 3, n)
    half_a[np.arange(n), flat] = 0.0
    half_b[np.arange(n), flat] = 0.0
    return (center_a, rotation, half_a), (center_b, same, half_b)


def _turned_stack(rng: Rng, n: int) -> Pairs:
    """Turn a dyadic stack as one: exact on paper, off by roundings as stored."""
    rotation = random_rotations(rng, n)
    half_a, half_b = rng.integers(1, 17, (2, n, 3)) / 16.0
    side = rng.choice([-1.0, 1.0], (n, 3))
    inside = rng.integers(-8, 9, (n, 3)) / 16.0
    offset = np.where(rng.random((n, 3)) < 0.4, side * (half_a + half_b), inside)
    base = rng.integers(-64, 65, (n, 3)) / 16.0
    center_a = np.einsum("nij,nj->ni", rotation, base)
    center_b = np.einsum("nij,nj->ni", rotation, base + offset)
    return (center_a, rotation, half_a), (center_b, rotation.copy(), half_b)


def _decimal_stack(rng: Rng, n: int) -> Pairs:
    """Sizes in whole millimetres, typed as decimals: a tray on a table, rounding decides."""
    half_a, half_b = rng.integers(1, 1000, (2, n, 3)) / 1000.0
    base = rng.integers(-5000, 5000, (n, 3)) / 1000.0
    offset = rng.integers(-500, 501, (n, 3)) / 1000.0
    offset[:, 2] = half_a[:, 2] + half_b[:, 2]
    identity = np.broadcast_to(np.eye(3), (n, 3, 3))
    return (base, identity, half_a), (np.round(base + offset, 3), identity, half_b)


def _end_on_face(rng: Rng, n: int) -> Pairs:
    """Let a segment (b) of any direction end at the origin, on a face of a."""
    rot_a, rot_b = random_rotations(rng, n), random_rotations(rng, n)
    rows = np.arange(n)
    i, j = rng.integers(0, 3, (2, n))
    thickness, length = _powers(rng, n), _powers(rng, n)
    half_a = rng.uniform(0.1, 2.0, (n, 3))
    half_a[rows, i] = thickness[:, 0]
    half_b = np.zeros((n, 3))
    half_b[rows, j] = length[:, 0]
    outward, along = rot_a[rows, :, i], rot_b[rows, :, j]
    away = np.where((outward * along).sum(axis=1, keepdims=True) < 0.0, -1.0, 1.0)
    return (-thickness * outward, rot_a, half_a), (away * length * along, rot_b, half_b)
