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

"""Pairs of convex bodies of all kinds, from random ones to those that are hard for floats."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache
from itertools import combinations_with_replacement, product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from obb_collision import Boxes, MeshTrees, PlacedMeshes
from obb_collision.geometry.trees import HullPool, Hulls
from obb_collision.queries.convex import ConvexDistances, convex_distances
from obb_collision.queries.convex.support import (
    BOX_CORE,
    CONE_CORE,
    CYLINDER_CORE,
    HULL_CORE,
    NO_HULLS,
    ROUND_CORE,
    SEGMENT_CORE,
    ConvexBodies,
)
from obb_collision.typing import Floats, Integers

#: Corners per hull, and how many hulls there are.
CORNERS_EACH, HULLS = 10, 16
KINDS = {
    "hull": HULL_CORE, "box": BOX_CORE, "capsule": SEGMENT_CORE, "ellipsoid": ROUND_CORE,
    "cylinder": CYLINDER_CORE, "cone": CONE_CORE,
}  # fmt: skip
#: Those for which meshes have kernels of their own, and their sizes beside these.
ROUND_KINDS = {
    "ellipsoid": [0.1, 0.3, 0.2, 0.1], "cylinder": [0.2, 0.2, 0.0, 0.3],
    "cone": [0.2, 0.3, 0.0, 0.3],
}  # fmt: skip
KIND_PAIRS = list(combinations_with_replacement(KINDS, 2))
POLYTOPES = list(combinations_with_replacement(("hull", "box", "capsule"), 2))
#: Promised: how close bounds of distances are, relative to the size or the distance of a pair.
CLOSE = 1e-9
#: Of the corners of a box.
CORNER_SIGNS = np.array(list(product((-1.0, 1.0), repeat=3)))
Pair = tuple[ConvexBodies, ConvexBodies]


@cache
def hulls(scale: tuple[float, ...], count: int = CORNERS_EACH) -> tuple[Hulls, Floats]:
    """Return hulls of random corners (HULLS, count, 3), these scaled by scale (3,)."""
    corners = np.random.default_rng(0).uniform(-1, 1, (HULLS, count, 3)) * scale
    return pool_of(corners), corners


def pool_of(corners: Iterable[Floats]) -> Hulls:
    """Return the hulls of several sets of points (n, 3)."""
    pool = HullPool()
    for part in corners:
        pool.append(Hulls.of(part))
    return pool.all


def bodies(
    kind: int, count: int, rng: np.random.Generator, scale: Floats, radius: float,
    corners: int = CORNERS_EACH,
) -> ConvexBodies:  # fmt: skip
    """Return bodies about the origin; scale (3,): of their sizes along their axes."""
    sizes, radii = np.zeros((count, 4)), np.zeros(count)
    sizes[:, :3] = rng.uniform(0.2, 1.0, (count, 3)) * scale
    sizes[:, 3] = rng.uniform(0.2, 1.0, count) * scale[2]
    if kind in (HULL_CORE, SEGMENT_CORE):
        sizes[:, :3] = 0.0
    if kind in (HULL_CORE, BOX_CORE, ROUND_CORE):
        sizes[:, 3] = 0.0
    if kind in (CYLINDER_CORE, CONE_CORE):
        sizes[:, 2] = 0.0
    if kind == SEGMENT_CORE:
        radii = rng.uniform(0.2, 1.0, count) * radius
    rotations = np.empty((0, 3, 3))
    if count:  # scipy 1.11 makes no array of none
        rotations = Rotation.random(count, rng).as_matrix()
    return ConvexBodies(
        np.full(count, kind, np.int8), sizes, radii, hulls(tuple(scale.tolist()), corners)[0],
        rng.integers(0, HULLS, count), rng.uniform(-1.5, 1.5, (count, 3)) * scale.max(), rotations,
    )  # fmt: skip


def some(body: ConvexBodies, rows: ArrayLike) -> ConvexBodies:
    """Return some of the bodies, or one several times."""
    picked = np.asarray(rows)
    return ConvexBodies(**{k: x if k == "hulls" else x[picked] for k, x in vars(body).items()})


def around(body: ConvexBodies, reach: float = 0.0) -> Boxes:
    """Return boxes that certainly hold bodies and what is this near to them."""
    half = reach_of(body) + reach
    return Boxes.trusted(body.centers, body.rotations, np.tile(2.0 * half[:, None], (1, 3)))


def reach_of(body: ConvexBodies) -> Floats:
    """Return how far bodies reach at most from their centres (n,)."""
    core = np.where(body.kinds == HULL_CORE, body.hulls.radii[body.rows], 0.0)
    return core + np.abs(body.sizes).sum(axis=1) + body.radii


def round_bodies(
    kind: str, at: PlacedMeshes, radius: float = 0.0, sizes: list[float] | None = None
) -> ConvexBodies:
    """Return bodies of a kind, all of one size, where meshes are."""
    count = len(at)
    return ConvexBodies(
        np.full(count, KINDS[kind], np.int8), np.tile(sizes or ROUND_KINDS[kind], (count, 1)),
        np.full(count, radius), NO_HULLS, np.zeros(count, np.int64), at.centers, at.rotations,
    )  # fmt: skip


def as_meshes(body: ConvexBodies, name: str, faces: list[Any] | None = None) -> PlacedMeshes:
    """Return hulls of a family as meshes of faces (n, 3) of their corners; else triangles."""
    corners = hulls(tuple(FAMILIES[name][0]), CORNERS_EACH if faces else 3)[1]
    sides = zip(corners, faces or [[[0, 1, 2]]] * HULLS, strict=True)
    trees = MeshTrees.join([MeshTrees.build(x, f, solid=len(f) > 1) for x, f in sides])
    return PlacedMeshes(trees, body.rows, body.centers, body.rotations)


def size_with(meshes: PlacedMeshes, body: ConvexBodies) -> Floats:
    """Return the sizes (n,) of pairs of a mesh and a body: radii, and the offset."""
    size: Floats = meshes.trees.radii[meshes.meshes] + np.abs(body.sizes).sum(axis=1)
    return size + np.abs(meshes.centers - body.centers).sum(axis=1)


def world_rounding(pair: Pair) -> Floats:
    """Return what the rounding of world coordinates may add."""
    a, b = pair
    return 1e-15 * (np.abs(a.centers).sum(axis=1) + np.abs(b.centers).sum(axis=1))


def outward_faces(points: Floats) -> Integers:
    """Return the faces (n, 3) of the hull of points."""
    hull = ConvexHull(points)
    p, q, r = (points[hull.simplices[:, k]] for k in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(q - p, r - p), hull.equations[:, :3]) < 0.0
    return np.where(inwards[:, None], hull.simplices[:, ::-1], hull.simplices)


@cache
def _distinct(points: bytes) -> Floats:
    return np.unique(np.frombuffer(points).reshape(-1, 3), axis=0)


def corners_of(body: ConvexBodies, i: int) -> Floats:
    """Return the corners (n, 3) of body i in its own frame: of a hull, a box or a segment."""
    if body.kinds[i] == BOX_CORE:
        return CORNER_SIGNS * body.sizes[i, :3]
    if body.kinds[i] == HULL_CORE:
        row = body.rows[i]
        blocks = body.hulls.blocks[body.hulls.starts[row] : body.hulls.starts[row + 1]]
        return _distinct(blocks.transpose(0, 2, 1).tobytes())
    return np.array([[0.0, 0.0, body.sizes[i, 3]], [0.0, 0.0, -body.sizes[i, 3]]])


def moved(body: ConvexBodies, **changes: NDArray[Any] | Hulls) -> ConvexBodies:
    """Return bodies with other arrays."""
    return ConvexBodies(**(vars(body) | changes))


def distances_of(a: ConvexBodies, b: ConvexBodies) -> ConvexDistances:
    """Return the distances of each body of a from the same row of b."""
    rows = np.arange(len(a))
    return convex_distances(a, b, rows, rows)[0]


def near(pair: Pair, seed: int) -> Pair:
    """Return the pair with b moved towards a, until some 1e-16 to 1e-3 of the size are left."""
    a, b = pair
    rng = np.random.default_rng(seed)
    size = np.abs(a.sizes).sum(axis=1) + np.abs(b.sizes).sum(axis=1)
    size = np.maximum(size, np.abs(hulls((1.0, 1.0, 1.0))[1]).max() * (size == 0.0))
    gaps = size * 10.0 ** rng.uniform(-16, -3, len(a)) * rng.choice([-1.0, 0.0, 1.0, 1.0], len(a))
    for _ in range(2):
        found = distances_of(a, b)
        apart = found.lower > 0.0
        step = np.where(apart, found.upper - gaps, 0.0)
        b = moved(b, centers=b.centers - step[:, None] * found.normals)
    return a, b


def parallel(pair: Pair, seed: int) -> Pair:
    """Return the pair with equal rotations, or nearly so, and offsets along an axis of them."""
    a, b = pair
    rng = np.random.default_rng(seed)
    tilt = Rotation.from_rotvec(
        rng.normal(size=(len(a), 3)) * 10.0 ** rng.uniform(-17, -3, (len(a), 1))
    )
    turned = np.where(
        rng.random(len(a))[:, None, None] < 0.5, a.rotations, a.rotations @ tilt.as_matrix()
    )
    offsets = np.zeros((len(a), 3))
    offsets[np.arange(len(a)), rng.integers(0, 3, len(a))] = 3.0 * np.abs(a.centers).max()
    centers = a.centers + np.einsum("nij,nj->ni", a.rotations, offsets)
    return near((a, moved(b, centers=centers, rotations=turned)), seed)


def far_away(pair: Pair, seed: int) -> Pair:
    """Return the pair moved to 1e6 to 1e9 m from the origin."""
    a, b = near(pair, seed)
    rng = np.random.default_rng(seed)
    offset = rng.normal(size=(len(a), 3)) * 10.0 ** rng.uniform(6, 9, (len(a), 1))
    return moved(a, centers=a.centers + offset), moved(b, centers=b.centers + offset)


def far_apart(pair: Pair, seed: int) -> Pair:
    """Return the pair with b at up to 1e6 times its size."""
    a, b = pair
    rng = np.random.default_rng(seed)
    offset = rng.normal(size=(len(a), 3)) * 10.0 ** rng.uniform(1, 6, (len(a), 1))
    return a, moved(b, centers=b.centers + offset)


#: By name: the scale of bodies along their axes, and what is done to pairs of them.
FAMILIES: dict[str, tuple[list[float], Callable[[Pair, int], Pair]]] = {
    "random": ([1.0, 1.0, 1.0], lambda pair, seed: pair),
    "nearly touching": ([1.0, 1.0, 1.0], near),
    "parallel": ([1.0, 1.0, 1.0], parallel),
    "flat": ([1.0, 1.0, 0.0], near),
    "plates": ([1.0, 1.0, 1e-8], near),
    "needles": ([1e-8, 1e-8, 1.0], near),
    "flat and parallel": ([1.0, 1.0, 0.0], parallel),
    "tiny": ([1e-150, 1e-150, 1e-150], near),
    "huge": ([1e150, 1e150, 1e150], near),
    "far away": ([1.0, 1.0, 1.0], far_away),
    "far apart": ([1.0, 1.0, 1.0], far_apart),
}


def family(name: str, kinds: tuple[str, str], count: int, seed: int) -> Pair:
    """Return pairs of a family; of kinds, or the first of triangles: hulls of three corners."""
    scale, change = FAMILIES[name]
    rng, size = np.random.default_rng(seed), np.array(scale)
    given = rng, size, 0.5 * size.min(), 3 if "triangle" in kinds else CORNERS_EACH
    a, b = (bodies(KINDS.get(kind, HULL_CORE), count, *given) for kind in kinds)
    return change((a, b), seed)
