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

"""Generated meshes of every kind, bodies placed of them, and families of pairs of triangles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
import trimesh
from exact_vectors import Point
from hull_distances import placed, squared_distance
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


@cache
def zoo() -> dict[str, Arrays]:
    """Meshes by name, of size about 1 m; 66 of them: convex or not, with holes, open, odd."""
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
        vertices, faces = _bumpy(rng, 1 + n % 3)
        meshes[f"open_sphere{n}"] = vertices, faces[rng.random(len(faces)) < 0.7]
        meshes[f"sheet{n}"] = _sheet(rng, 3 + 4 * n)
        outer = _bumpy(rng, 2)  # what lies in its cavity doesn't collide
        cavity = (0.5 + 0.1 * n) * outer[0], outer[1][:, ::-1]
        meshes[f"hollow{n}"] = _joined([outer, cavity], np.zeros((2, 3)))
        crumbs = [(0.3 * v, f) for v, f in (_hull(rng, 10) for _ in range(5))]
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
        centers = rng.uniform(-spread, spread, (count, 3))
        sides.append(PlacedMeshes(trees, meshes, centers, rotations))
    return sides[0], sides[1]


def exact_corners(bodies: PlacedMeshes, row: int) -> list[list[Point]]:
    """Return the placed corners of the triangles of a body."""
    trees = bodies.trees
    first, last = trees.starts[trees.roots[bodies.meshes[row]]]
    triangles = trees.triangles[first:last].reshape(-1, 3, 3)
    return [placed(corners, bodies.centers[row], bodies.rotations[row]) for corners in triangles]


def surface_distance(first: list[list[Point]], second: list[list[Point]], near: float) -> Fraction:
    """Return the least squared distance of the triangles of two surfaces that are so near."""
    bounds = [(x.min(axis=1), x.max(axis=1)) for x in (np.array(s, float) for s in (first, second))]
    (low, high), (start, end) = bounds
    apart = np.maximum(np.maximum(low[:, None] - end, start - high[:, None]), 0.0)
    rows = np.argwhere(np.linalg.norm(apart, axis=2) <= near * (1.0 + 1e-9) + 1e-9)
    squares = (squared_distance(first[s], second[t]) for s, t in rows)
    return min(squares, default=Fraction(10**9))


def thrown(corners: Floats, faces: ArrayLike, n: int, rng: np.random.Generator) -> PlacedMeshes:
    """Return a mesh, every other one turned, half of them moved."""
    turn = Rotation.random(random_state=rng).as_matrix() if n % 2 else np.eye(3)
    center = rng.normal(size=3) * np.abs(corners).max() if n % 4 > 1 else np.zeros(3)
    return PlacedMeshes(MeshTrees.build(corners, faces), [0], center[None], turn[None])


@cache
def trees_of(*names: str, solid: bool | None = None) -> MeshTrees:
    """Return trees of meshes of the zoo, of all of them without names."""
    return MeshTrees.join([MeshTrees.build(*ZOO[name], solid=solid) for name in names or NAMES])


def standing(trees: MeshTrees, *centers: ArrayLike, mesh: int = 0) -> PlacedMeshes:
    """Return a mesh at centres, or at the origin, that is not turned."""
    places = np.array(centers or [[0.0, 0.0, 0.0]], np.float64)
    count = len(places)
    return PlacedMeshes(trees, np.full(count, mesh), places, np.tile(np.eye(3), (count, 1, 1)))


def triangles(corners: Any, rows: ArrayLike | None = None) -> PlacedMeshes:
    """Return triangles (n, 3, 3), or rows of them, each a mesh by itself, where they are."""
    trees = MeshTrees.join([MeshTrees.build(x, TRIANGLE) for x in np.asarray(corners)])
    meshes = np.arange(len(trees)) if rows is None else np.asarray(rows)
    still = np.zeros((len(meshes), 3)), np.tile(np.eye(3), (len(meshes), 1, 1))
    return PlacedMeshes(trees, meshes, *still)


def as_drawn(pairs: Sequence[tuple[ArrayLike, ArrayLike]]) -> list[PlacedMeshes]:
    """Return pairs of triangles as two sets of meshes, where they are."""
    return [triangles([pair[k] for pair in pairs]) for k in (0, 1)]


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
    a: PlacedMeshes, b: PlacedMeshes, pairs: ArrayLike | None = None
) -> NDArray[np.bool_]:
    """Return which meshes collide: the quickest question."""
    return np.asarray(oc.verdicts(a, b, pairs, effort=0) != Verdict.SEPARATE)


def placed_corners(bodies: PlacedMeshes, row: int) -> Floats:
    """Return the corners (m, 3, 3) of a body in the world, rounded."""
    trees, mesh = bodies.trees, bodies.meshes[row]
    first, last = trees.starts[trees.roots[mesh]]
    corners = trees.triangles[first:last].reshape(-1, 3, 3)
    return np.asarray(corners @ bodies.rotations[row].T + bodies.centers[row])


def windings(triangles: Floats, points: Floats) -> Floats:
    """Return how often a surface winds about points: by solid angles (Van Oosterom, Strackee)."""
    a, b, c = (triangles[None, :, k] - points[:, None] for k in range(3))
    x, y, z = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    top = np.einsum("npk,npk->np", a, np.cross(b, c))
    low = x * y * z
    for u, v, w in ((a, b, z), (b, c, x), (c, a, y)):
        low += np.einsum("npk,npk->np", u, v) * w
    return np.asarray(np.arctan2(top, low).sum(axis=1) / (2.0 * np.pi))


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


TRIANGLES: list[Maker] = [
    _any, _small_grid, coplanar, _nearly_coplanar, _tilted_coplanar, _vertex_on_face,
    _edge_on_edge, _shared, _parallel, _sliver, _needle, _degenerate, _far, _different_sizes,
    extreme_sizes,
]  # fmt: skip
