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

"""Generated meshes of every kind: convex or not, with holes, open, odd; bodies placed of them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import trimesh
from exact_vectors import Point
from hull_distances import placed
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation
from trimesh import creation

import obb_collision as oc
from obb_collision import MeshTrees, PlacedMeshes, Verdict
from obb_collision.typing import Floats

Arrays = tuple[NDArray[np.float64], NDArray[np.int64]]


def _arrays(mesh: Any) -> Arrays:
    return np.array(mesh.vertices, float), np.array(mesh.faces, np.int64)


def _prism(outline: NDArray[np.floating], height: float) -> Arrays:
    """Extrude a star-shaped outline (n, 2) about the origin; no polygon library needed."""
    n = len(outline)
    low = np.column_stack([outline, np.zeros(n)])
    up = np.array([[0.0, 0.0, height]])
    vertices = np.concatenate([low, low + up, 0.0 * up, up])
    k, nxt = np.arange(n), (np.arange(n) + 1) % n
    faces = [
        np.column_stack([k, nxt, k + n]), np.column_stack([nxt, nxt + n, k + n]),
        np.column_stack([nxt, k, np.full(n, 2 * n)]),
        np.column_stack([k + n, nxt + n, np.full(n, 2 * n + 1)]),
    ]  # fmt: skip
    return vertices - 0.5 * up, np.concatenate(faces)


def _star(rng: np.random.Generator, points: int) -> Arrays:
    radii = np.where(np.arange(2 * points) % 2, rng.uniform(0.15, 0.35), rng.uniform(0.4, 0.6))
    angles = np.linspace(0.0, 2.0 * np.pi, 2 * points, endpoint=False)
    outline = radii[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    return _prism(outline, rng.uniform(0.1, 0.6))


def _bumpy(rng: np.random.Generator, subdivisions: int) -> Arrays:
    vertices, faces = _arrays(creation.icosphere(subdivisions=subdivisions, radius=0.4))
    waves = np.sin(vertices @ rng.normal(0.0, 8.0, (3, 4))).sum(axis=1)
    return vertices * (1.0 + 0.12 * waves)[:, None], faces


def _hull(rng: np.random.Generator, count: int) -> Arrays:
    points = rng.normal(size=(count, 3)) * rng.uniform(0.05, 0.4, 3)
    return _arrays(trimesh.convex.convex_hull(points))


def _opened(arrays: Arrays, rng: np.random.Generator, share: float) -> Arrays:
    vertices, faces = arrays
    return vertices, faces[rng.random(len(faces)) < share]


def _sheet(rng: np.random.Generator, n: int) -> Arrays:
    grid = np.linspace(-0.5, 0.5, n)
    x, y = (g.ravel() for g in np.meshgrid(grid, grid))
    vertices = np.column_stack([x, y, 0.15 * np.sin(5.0 * x + rng.random()) * np.cos(4.0 * y)])
    k = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate(
        [np.column_stack([k, k + 1, k + n]), np.column_stack([k + 1, k + n + 1, k + n])]
    )
    return vertices, faces


def _joined(parts: list[Arrays], offsets: NDArray[np.floating]) -> Arrays:
    counts = np.cumsum([0, *(len(v) for v, _ in parts)])
    vertices = [v + o for (v, _), o in zip(parts, offsets, strict=True)]
    faces = [f + n for (_, f), n in zip(parts, counts[:-1], strict=True)]
    return np.concatenate(vertices), np.concatenate(faces)


def _hollow(outer: Arrays, shrink: float) -> Arrays:
    """Make a shell with a cavity: what lies in the cavity doesn't collide."""
    inner = (outer[0] * shrink, outer[1][:, ::-1])
    return _joined([outer, inner], np.zeros((2, 3)))


@cache
def zoo() -> dict[str, Arrays]:
    """Meshes by name, of size about 1 m; 66 of them."""
    rng = np.random.default_rng(4)
    meshes: dict[str, Arrays] = {}
    for n in range(4):
        size = rng.uniform(0.2, 1.0, 3)
        meshes[f"box{n}"] = _arrays(creation.box(size))
        meshes[f"fine_box{n}"] = _arrays(creation.box(size).subdivide().subdivide())
        meshes[f"sphere{n}"] = _arrays(creation.icosphere(subdivisions=n, radius=0.45))
        meshes[f"uv_sphere{n}"] = _arrays(creation.uv_sphere(radius=0.4, count=[4 + 4 * n] * 2))
        meshes[f"cylinder{n}"] = _arrays(creation.cylinder(rng.uniform(0.1, 0.8), 0.5, sections=16))
        meshes[f"cone{n}"] = _arrays(creation.cone(rng.uniform(0.2, 0.8), 0.6, sections=12 + n))
        meshes[f"capsule{n}"] = _arrays(creation.capsule(0.6, rng.uniform(0.1, 0.4), count=[8, 8]))
        inner = rng.uniform(0.1, 0.4)
        meshes[f"annulus{n}"] = _arrays(creation.annulus(inner, 0.45, rng.uniform(0.1, 0.6)))
        meshes[f"torus{n}"] = _arrays(creation.torus(0.4, 0.05 + 0.05 * n, 24, 12))
        meshes[f"star{n}"] = _star(rng, 3 + 2 * n)
        meshes[f"bumpy{n}"] = _bumpy(rng, 1 + n % 3)
        meshes[f"hull{n}"] = _hull(rng, 8 * 4**n)
        meshes[f"open_sphere{n}"] = _opened(_bumpy(rng, 1 + n % 3), rng, 0.7)
        meshes[f"sheet{n}"] = _sheet(rng, 3 + 4 * n)
        meshes[f"hollow{n}"] = _hollow(_bumpy(rng, 2), 0.5 + 0.1 * n)
        crumbs = [_hull(rng, 10) for _ in range(5)]
        crumbs = [(0.3 * v, f) for v, f in crumbs]
        meshes[f"crumbs{n}"] = _joined(crumbs, rng.uniform(-0.4, 0.4, (5, 3)))
    meshes["triangle"] = (np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    meshes["moebius"] = _moebius()
    return meshes


def _moebius(n: int = 48) -> Arrays:
    t = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    rows = []
    for s in (-0.15, 0.15):
        r = 0.4 + s * np.cos(0.5 * t)
        rows.append(np.column_stack([r * np.cos(t), r * np.sin(t), s * np.sin(0.5 * t)]))
    k = np.arange(n)
    nxt, up, up_nxt = (k + 1) % n, k + n, (k + 1) % n + n
    nxt[-1], up_nxt[-1] = n, 0  # half a turn
    faces = [np.column_stack([k, nxt, up]), np.column_stack([nxt, up_nxt, up])]
    return np.concatenate(rows), np.concatenate(faces)


ZOO = zoo()
NAMES = list(ZOO)
#: Pairs of bodies in the tests over all meshes.
PAIRS = 20_000
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


def exact_corners(bodies: PlacedMeshes, row: int) -> list[list[Point]]:
    """Return the placed corners of the triangles of a body."""
    trees = bodies.trees
    first, last = trees.starts[trees.roots[bodies.meshes[row]]]
    triangles = trees.triangles[first:last].reshape(-1, 3, 3)
    return [placed(corners, bodies.centers[row], bodies.rotations[row]) for corners in triangles]


@cache
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
