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

"""Meshes of the zoo in places, and verdicts about them."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np
from mesh_zoo import zoo
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

import obb_collision as oc
from obb_collision import MeshTrees, PlacedMeshes, Verdict
from obb_collision.typing import Floats

Faces = NDArray[np.int64]

ZOO = zoo()
NAMES = list(ZOO)
#: Pairs of bodies in the tests over all meshes.
PAIRS = 40_000
TRIANGLE = np.array([[0, 1, 2]])


def bodies_of(
    trees: MeshTrees, count: int, spread: float, seed: int
) -> tuple[PlacedMeshes, PlacedMeshes]:
    """Return random meshes at random poses."""
    rng = np.random.default_rng(seed)
    sides = []
    for _ in range(2):
        meshes = rng.integers(0, len(trees), count)
        rotations = Rotation.random(count, random_state=rng).as_matrix()
        sides.append(
            PlacedMeshes(trees, meshes, rng.uniform(-spread, spread, (count, 3)), rotations)
        )
    return sides[0], sides[1]


def exact_corners(bodies: PlacedMeshes, row: int) -> list[list[list[Fraction]]]:
    """Return the placed corners of the triangles of a body."""
    trees, mesh = bodies.trees, bodies.meshes[row]
    root = trees.roots[mesh]
    first, last = trees.starts[root]
    axes = [[Fraction(x) for x in r] for r in bodies.rotations[row].tolist()]
    center = [Fraction(x) for x in bodies.centers[row].tolist()]
    return [
        [
            [c + sum(x * y for x, y in zip(r, map(Fraction, v), strict=True))
             for c, r in zip(center, axes, strict=True)]
            for v in corners
        ]
        for corners in trees.triangles[first:last].reshape(-1, 3, 3).tolist()
    ]  # fmt: skip


def trees_of(*names: str, solid: bool | None = None) -> MeshTrees:
    """Return trees of meshes of the zoo, of all of them without names."""
    return MeshTrees.join([MeshTrees.build(*ZOO[name], solid=solid) for name in names or NAMES])


def standing(trees: MeshTrees, *centers: ArrayLike, mesh: int = 0) -> PlacedMeshes:
    """Return a mesh at centres, or at the origin, that is not turned."""
    places = np.array(centers or [[0.0, 0.0, 0.0]], np.float64)
    count = len(places)
    return PlacedMeshes(trees, np.full(count, mesh), places, np.tile(np.eye(3), (count, 1, 1)))


def as_drawn(pairs: Sequence[tuple[ArrayLike, ArrayLike]]) -> list[PlacedMeshes]:
    """Return pairs of triangles as two sets of meshes, where they are."""
    count = len(pairs)
    still = np.zeros((count, 3)), np.tile(np.eye(3), (count, 1, 1))
    trees = [MeshTrees.join([MeshTrees.build(p[k], TRIANGLE) for p in pairs]) for k in (0, 1)]
    return [PlacedMeshes(side, np.arange(count), *still) for side in trees]


def place(vertices: ArrayLike, faces: ArrayLike, offset: ArrayLike = (0, 0, 0)) -> PlacedMeshes:
    return standing(MeshTrees.build(vertices, faces), offset)


def moved_on(bodies: PlacedMeshes, twists: Floats, times: Floats) -> PlacedMeshes:
    """Return bodies after times (n,) with twists (n, 6)."""
    turns = Rotation.from_rotvec(twists[:, 3:] * times[:, None]).as_matrix()
    centers = bodies.centers + twists[:, :3] * times[:, None]
    return PlacedMeshes(bodies.trees, bodies.meshes, centers, turns @ bodies.rotations)


def verdict_of(a: PlacedMeshes, b: PlacedMeshes, exact: bool = False) -> Verdict:
    forward, backward = oc.verdicts(a, b, exact=exact)[0], oc.verdicts(b, a, exact=exact)[0]
    assert forward == backward
    return Verdict(forward)


def collisions(
    a: PlacedMeshes, b: PlacedMeshes, pairs: ArrayLike | None = None, depth: int | None = None
) -> NDArray[np.bool_]:
    """Return which meshes collide, or boxes of a depth: the quickest question."""
    return np.asarray(oc.verdicts(a, b, pairs, effort=0, depth=depth) != Verdict.SEPARATE)


def placed_corners(bodies: PlacedMeshes, row: int) -> Floats:
    """Return the corners (m, 3, 3) of a body in the world, rounded."""
    trees, mesh = bodies.trees, bodies.meshes[row]
    first, last = trees.starts[trees.roots[mesh]]
    corners = trees.triangles[first:last].reshape(-1, 3, 3)
    placed: Floats = corners @ bodies.rotations[row].T + bodies.centers[row]
    return placed


def windings(triangles: Floats, points: Floats) -> Floats:
    """Return how often a surface winds about points: by solid angles (Van Oosterom, Strackee)."""
    a, b, c = (triangles[None, :, k] - points[:, None] for k in range(3))
    x, y, z = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    top = np.einsum("npk,npk->np", a, np.cross(b, c))
    low = x * y * z
    for u, v, w in ((a, b, z), (b, c, x), (c, a, y)):
        low += np.einsum("npk,npk->np", u, v) * w
    total: Floats = np.arctan2(top, low).sum(axis=1) / (2.0 * np.pi)
    return total
