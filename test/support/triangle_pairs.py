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

"""Families of triangle pairs, ordinary to tiny and huge."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from obb_collision.typing import Floats

Pair = tuple[Floats, Floats]
#: Of all ``--pairs`` one in so many, per family: as many in all, and exact arithmetic takes time.
SHARE = 12
Maker = Callable[[np.random.Generator], Pair]


def _any(rng: np.random.Generator) -> Pair:
    return rng.normal(size=(3, 3)), rng.normal(size=(3, 3))


def _small_grid(rng: np.random.Generator) -> Pair:
    """Small integers: every kind of touching, coplanar and degenerate pair comes up."""
    return rng.integers(-1, 2, (3, 3)).astype(float), rng.integers(-1, 2, (3, 3)).astype(float)


def coplanar(rng: np.random.Generator) -> Pair:
    a, b = rng.normal(size=(3, 3)), rng.normal(size=(3, 3))
    a[:, 2] = b[:, 2] = 0.25
    return a, b


def _nearly_coplanar(rng: np.random.Generator) -> Pair:
    a, b = coplanar(rng)
    b[:, 2] += 2.0 ** -float(rng.integers(30, 53)) * rng.integers(-2, 3, 3)
    return a, b


def _tilted_coplanar(rng: np.random.Generator) -> Pair:
    """In one plane but for the rounding of the coordinates."""
    u, v, o = rng.normal(size=(3, 3))
    plane = np.array([u, v])
    return o + rng.normal(size=(3, 2)) @ plane, o + rng.normal(size=(3, 2)) @ plane


def _vertex_on_face(rng: np.random.Generator) -> Pair:
    a, b = rng.normal(size=(3, 3)), rng.normal(size=(3, 3))
    weights = rng.dirichlet([1.0, 1.0, 1.0])
    b[0] = weights @ a + rng.integers(-1, 2) * 1e-16 * rng.normal(size=3)
    return a, b


def _edge_on_edge(rng: np.random.Generator) -> Pair:
    a, b = rng.normal(size=(3, 3)), rng.normal(size=(3, 3))
    b += 0.5 * (a[0] + a[1]) - 0.5 * (b[0] + b[1])
    return a, b


def _shared(rng: np.random.Generator) -> Pair:
    """Share a corner, an edge or all three, as neighbours in a mesh do."""
    a, b = rng.normal(size=(3, 3)), rng.normal(size=(3, 3))
    count = rng.integers(1, 4)
    b[rng.permutation(3)[:count]] = a[rng.permutation(3)[:count]]
    return a, b


def _sliver(rng: np.random.Generator) -> Pair:
    a, b = rng.normal(size=(3, 3)), rng.normal(size=(3, 3))
    a[2] = 0.5 * (a[0] + a[1]) + 10.0 ** -float(rng.integers(5, 18)) * rng.normal(size=3)
    return a, b


def _parallel(rng: np.random.Generator) -> Pair:
    """Face to face, near or not, with parallel edges in half of the pairs."""
    a, b = coplanar(rng)
    if rng.random() < 0.5:
        b[1] = b[0] + rng.choice([-2.0, 0.5, 1.0]) * (a[1] - a[0])
    b[:, 2] += rng.choice([1e-12, 1e-8, 1e-4, 1.0])
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return a @ axes, b @ axes


def _needle(rng: np.random.Generator) -> Pair:
    """Long and thin, up to 1e-12 of their length, and crossing in half of the pairs."""
    sides = [
        np.outer(rng.normal(size=3), rng.normal(size=3))
        + 10.0 ** -float(rng.integers(3, 13)) * rng.normal(size=(3, 3))
        for _ in range(2)
    ]
    a, b = sides
    if rng.random() < 0.5:
        b += rng.dirichlet([1.0, 1.0, 1.0]) @ a - rng.dirichlet([1.0, 1.0, 1.0]) @ b
    return a, b


def _degenerate(rng: np.random.Generator) -> Pair:
    a, b = _small_grid(rng) if rng.random() < 0.7 else _any(rng)
    a[1 + rng.integers(2)] = a[0]
    if rng.random() < 0.5:
        b[:] = b[0] if rng.random() < 0.5 else np.array([b[0], 0.5 * (b[0] + b[1]), b[1]])
    return a, b


def _far(rng: np.random.Generator) -> Pair:
    a, b = _small_grid(rng) if rng.random() < 0.5 else _any(rng)
    offset = rng.choice([1e6, -1e9, 1e12]) * rng.normal(size=3)
    return a + offset, b + offset


def _different_sizes(rng: np.random.Generator) -> Pair:
    a, b = rng.normal(size=(3, 3)), rng.normal(size=(3, 3))
    b *= 10.0 ** -float(rng.integers(2, 12))
    return a, b + rng.dirichlet([1.0, 1.0, 1.0]) @ a


def extreme_sizes(rng: np.random.Generator) -> Pair:
    a, b = _small_grid(rng) if rng.random() < 0.5 else _any(rng)
    scale = rng.choice([1e-160, 1e-100, 1e100, 1e155])
    return a * scale, b * scale


FAMILIES: list[Maker] = [
    _any, _small_grid, coplanar, _nearly_coplanar, _tilted_coplanar, _vertex_on_face,
    _edge_on_edge, _shared, _parallel, _sliver, _needle, _degenerate, _far, _different_sizes,
    extreme_sizes,
]  # fmt: skip
