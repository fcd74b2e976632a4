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

"""Families of box pairs on which separating axis tests go wrong, each a seeded generator.

``FAMILIES[name](rng, n)`` gives two triples (centers (n, 3), rotations (n, 3, 3), half
extents (n, 3)) of float64; `generate` seeds one by name, so that a family's pairs do not depend
on which other families were asked for. The same families serve the tests, the long run of
a million pairs and the table of wrong answers.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable

import numpy as np

from tools.cases.placement import (
    EPS,
    Array,
    Arrays,
    Pairs,
    log_uniform,
    orthonormal,
    place,
    random_rotations,
    signed_permutations,
    small_gaps,
    turns,
)

Rng = np.random.Generator
Family = Callable[[Rng, int], Pairs]


def ordinary(rng: Rng, n: int) -> Pairs:
    """Boxes of 0.1 to 1 m in a small room, half of them colliding."""
    half_a, half_b = rng.uniform(0.05, 0.5, (2, n, 3))
    rot_a, rot_b = random_rotations(rng, n), random_rotations(rng, n)
    center_a, center_b = rng.uniform(-0.5, 0.5, (2, n, 3)) + rng.uniform(-10, 10, (n, 3))
    return (center_a, rot_a, half_a), (center_b, rot_b, half_b)


def near_parallel(rng: Rng, n: int) -> Pairs:
    """Axes 1e-3 to 1e-17 rad from parallel, some relabelled, small gaps on any axis."""
    rot_a = np.where(rng.random((n, 1, 1)) < 0.5, np.eye(3), random_rotations(rng, n))
    axis = np.where(rng.random((n, 1)) < 0.5, rng.normal(size=(n, 3)), rot_a[:, :, 0])
    rot_b = turns(axis, log_uniform(rng, -17.0, -3.0, n)) @ rot_a
    relabelled = rng.random(n) < 0.3
    rot_b[relabelled] = rot_b[relabelled] @ signed_permutations(rng, int(relabelled.sum()))
    half_a, half_b = log_uniform(rng, -2.0, 1.0, (2, n, 3))
    return place(rng, rot_a, half_a, rot_b, half_b)


def same_rotation(rng: Rng, n: int) -> Pairs:
    """Use the same rotation in both boxes, entries off by up to two units in the last place."""
    rot_a = random_rotations(rng, n)
    steps = rng.integers(-2, 3, (n, 3, 3)) * (rng.random((n, 1, 1)) < 0.8)
    rot_b = rot_a + steps * np.spacing(np.abs(rot_a))
    half_a, half_b = rng.uniform(0.05, 2.0, (2, n, 3))
    return place(rng, rot_a, half_a, rot_b, half_b)


def rounded_rotations(rng: Rng, n: int) -> Pairs:
    """Axes as far from orthonormal as rounding leaves them after a few products."""
    rot_a, rot_b = random_rotations(rng, n), random_rotations(rng, n)
    rot_b = np.where(rng.random((n, 1, 1)) < 0.5, rot_a, rot_b)
    noise_a, noise_b = rng.uniform(-3.0, 3.0, (2, n, 3, 3)) * EPS
    half_a, half_b = log_uniform(rng, -1.0, 1.0, (2, n, 3))
    return place(rng, rot_a + noise_a, half_a, rot_b + noise_b, half_b)


def edge_edge(rng: Rng, n: int) -> Pairs:
    """Edge against edge at any angle, small gaps."""
    half_a, half_b = rng.uniform(0.05, 2.0, (2, n, 3))
    rot_a, rot_b = random_rotations(rng, n), random_rotations(rng, n)
    return place(rng, rot_a, half_a, rot_b, half_b, index=rng.integers(6, 15, n))


def each_axis(rng: Rng, n: int) -> Pairs:
    """Each of the 15 axes in turn the only one to separate, or the one of minimum penetration.

    Row ``k`` is about axis ``k % 15``; even laps have a gap, odd laps an overlap, of a millionth
    to a thousandth of the size.
    """
    half_a, half_b = rng.uniform(0.5, 1.5, (2, n, 3))
    # Turned well away from parallel, so that no other axis comes close to the one wanted.
    angle = rng.uniform(0.5, 0.8, n)
    axis = np.ones((n, 3)) + rng.uniform(-0.3, 0.3, (n, 3))
    base = random_rotations(rng, n)
    rot_b = base @ turns(axis, angle)
    row = np.arange(n)
    sign = np.where((row // 15) % 2 == 0, 1.0, -1.0)
    gaps = sign * log_uniform(rng, -6.0, -3.0, n) * (half_a + half_b).sum(axis=1)
    return place(rng, base, half_a, rot_b, half_b, index=row % 15, gaps=gaps, spread=0.5)


def near_touching(rng: Rng, n: int) -> Pairs:
    """Any orientation, any axis, gaps from a rounding to 1e-12 of the size, either side."""
    half_a, half_b = rng.uniform(0.05, 2.0, (2, n, 3))
    rot_a, rot_b = random_rotations(rng, n), random_rotations(rng, n)
    sizes = (half_a + half_b).sum(axis=1)
    gaps = rng.choice([-1.0, 1.0], n) * log_uniform(rng, -16.5, -12.0, n) * sizes
    return place(rng, rot_a, half_a, rot_b, half_b, gaps=gaps)


def thin(rng: Rng, n: int) -> Pairs:
    """Plates and rods: one or two extents a hundredth to a millionth of the others."""
    half_a, half_b = _thinned(rng, n, -6.0, -2.0), _thinned(rng, n, -6.0, -2.0)
    return place(rng, random_rotations(rng, n), half_a, random_rotations(rng, n), half_b)


def _thinned(rng: Rng, n: int, low: float, high: float) -> Array:
    narrow = rng.random((n, 3)) < 0.5
    half = rng.uniform(0.2, 2.0, (n, 3))
    return np.where(narrow, half * log_uniform(rng, low, high, (n, 3)), half)


def flat(rng: Rng, n: int) -> Pairs:
    """One, two or three extents zero in either or both: plates, segments, points.

    A third turns about a common normal (coplanar plates), a third touches exactly.
    """
    kind = rng.integers(0, 3, n)
    half_a, half_b = rng.uniform(0.1, 2.0, (2, n, 3))
    half_a[np.arange(3) < rng.integers(1, 4, (n, 1))] = 0.0
    half_b[np.arange(3) < rng.integers(0, 4, (n, 1))] = 0.0
    rot_a, rot_b = random_rotations(rng, n), random_rotations(rng, n)
    about_normal = turns(rot_a[:, :, 0], rng.uniform(0.0, 3.0, n)) @ rot_a
    rot_b[kind == 0] = about_normal[kind == 0]
    a, b = place(rng, rot_a, half_a, rot_b, half_b)
    touching = kind == 2
    c, d = flat_contacts(rng, n)
    return _where(touching, c, a), _where(touching, d, b)


def contained(rng: Rng, n: int) -> Pairs:
    """Identical (some relabelled or a rounding apart), concentric, and one inside the other."""
    kind = rng.integers(0, 4, n)
    half_a = log_uniform(rng, -2.0, 1.0, (n, 3))
    rot_a = random_rotations(rng, n)
    center_a = rng.uniform(-5.0, 5.0, (n, 3))
    rot_b = np.where((kind < 2)[:, None, None], rot_a, random_rotations(rng, n))
    half_b = np.where((kind < 2)[:, None], half_a, half_a * rng.uniform(0.1, 1.0, (n, 3)))
    shift = np.where((kind == 3)[:, None], rng.uniform(-0.3, 0.3, (n, 3)) * half_a, 0.0)
    ulps = rng.integers(-3, 4, (n, 3)) * np.spacing(np.abs(center_a))
    center_b = center_a + shift + np.where((kind == 1)[:, None], ulps, 0.0)
    flipped = (kind == 1) & (rng.random(n) < 0.5)
    rot_b[flipped] = -rot_b[flipped][:, :, [1, 0, 2]]
    half_b[flipped] = half_b[flipped][:, [1, 0, 2]]
    return (center_a, rot_a, half_a), (center_b, rot_b, half_b)


def far(rng: Rng, n: int) -> Pairs:
    """Boxes of a metre whose coordinates are 1e6 to 1e9 m, small gaps."""
    half_a, half_b = rng.uniform(0.05, 2.0, (2, n, 3))
    rot_a, rot_b = random_rotations(rng, n), random_rotations(rng, n)
    origin = rng.choice([-1.0, 1.0], (n, 3)) * log_uniform(rng, 6.0, 9.0, (n, 3))
    gaps = small_gaps(rng, (half_a + half_b).sum(axis=1), -9.0)
    return place(rng, rot_a, half_a, rot_b, half_b, gaps=gaps, origin=origin)


def aspect(rng: Rng, n: int) -> Pairs:
    """Extents of 1e-5 to 1e4 in one box: ratios up to 1e9."""
    half_a, half_b = log_uniform(rng, -5.0, 4.0, (2, n, 3))
    return place(rng, random_rotations(rng, n), half_a, random_rotations(rng, n), half_b)


def extreme_sizes(rng: Rng, n: int) -> Pairs:
    """Sizes of 1e-160 to 1e155: half of the pairs of one scale, half with each box its own."""
    scale_a, scale_b = log_uniform(rng, -160.0, 155.0, (2, n, 1))
    scale_b = np.where(rng.random((n, 1)) < 0.5, scale_a, scale_b)
    half_a, half_b = rng.uniform(0.1, 1.0, (2, n, 3)) * [scale_a, scale_b]
    return place(rng, random_rotations(rng, n), half_a, random_rotations(rng, n), half_b)


def permuted(rng: Rng, n: int) -> Pairs:
    """Axes relabelled, flipped and mirrored: b is turned from a by a signed permutation."""
    rot_a = np.where(rng.random((n, 1, 1)) < 0.5, np.eye(3), random_rotations(rng, n))
    rot_a = rot_a @ signed_permutations(rng, n)
    rot_b = rot_a @ signed_permutations(rng, n)
    half_a, half_b = rng.integers(1, 33, (2, n, 3)) / 16.0
    return place(rng, rot_a, half_a, rot_b, half_b)


def slivers(rng: Rng, n: int) -> Pairs:
    """Everything at once: slivers, zeros, near-parallel axes, far away, very large or small."""
    half_a, half_b = _thinned(rng, n, -12.0, 0.0), _thinned(rng, n, -12.0, 0.0)
    half_a[rng.random((n, 3)) < 0.1] = 0.0
    half_b[rng.random((n, 3)) < 0.1] = 0.0
    rot_a = np.where(rng.random((n, 1, 1)) < 0.3, np.eye(3), random_rotations(rng, n))
    near = turns(rng.normal(size=(n, 3)), log_uniform(rng, -17.0, -3.0, n)) @ rot_a
    rot_b = np.where(rng.random((n, 1, 1)) < 0.5, near, random_rotations(rng, n))
    rot_b = np.where(rng.random((n, 1, 1)) < 0.5, orthonormal(rot_b), rot_b)
    scale = log_uniform(rng, -9.0, 9.0, (n, 1)) * (rng.random((n, 1)) < 0.5)
    scale[scale == 0.0] = 1.0
    distance = rng.normal(size=(n, 3)) * log_uniform(rng, 0.0, 9.0, (n, 1))
    origin = np.where(rng.random((n, 1)) < 0.5, distance * scale, 0.0)
    return place(rng, rot_a, half_a * scale, rot_b, half_b * scale, origin=origin)


def _where(mask: np.ndarray, chosen: Arrays, other: Arrays) -> Arrays:
    center, rotation, half = (x.copy() for x in other)
    center[mask], rotation[mask], half[mask] = chosen[0][mask], chosen[1][mask], chosen[2][mask]
    return center, rotation, half


# Pairs that touch exactly: a power of two times a stored axis is a stored number without rounding,
# and a difference of two stored centres needs no rounding in exact arithmetic. So centres made of
# such multiples give contacts that are exact for the doubles as stored, where no floating-point
# test can decide on which side of touching a pair is.

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


FAMILIES: dict[str, Family] = {
    "ordinary scene": ordinary,
    "exact resting contact": exact_contacts,
    "near-parallel axes, 1e-3 to 1e-17 rad": near_parallel,
    "same rotation, last places differ": same_rotation,
    "rotations off by rounding": rounded_rotations,
    "edge against edge": edge_edge,
    "each of the 15 axes alone": each_axis,
    "near touching, to 1e-12 of the size": near_touching,
    "thin plates and rods": thin,
    "zero extents": flat,
    "identical, concentric, contained": contained,
    "far away, 1e6 to 1e9 m": far,
    "aspect ratio to 1e9": aspect,
    "sizes 1e-160 to 1e155": extreme_sizes,
    "axes relabelled and mirrored": permuted,
    "slivers in every combination": slivers,
}


def generate(name: str, n: int, seed: int = 0) -> Pairs:
    """``n`` pairs of the family ``name``: the same for the same seed, whatever else is drawn."""
    rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
    with np.errstate(under="ignore"):
        return FAMILIES[name](rng, n)
