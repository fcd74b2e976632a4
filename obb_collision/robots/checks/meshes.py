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

"""Pairs of bodies as meshes: whether they collide, how far they are apart, how deep they overlap.

As in ``scene.refinement.mesh_pairs``: only pairs with a mesh; other pairs are convex, and decided
by their hulls. At "mesh" a body is everything within a radius of its triangles, its padding; a
sphere or capsule is a segment with one. The roundings of kinematics are allowed for.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from obb_collision._threads import run
from obb_collision.accuracy import Accuracy
from obb_collision.geometry.poses import as_poses
from obb_collision.geometry.trees.pool import segment_trees
from obb_collision.queries.mesh_contacts.surfaces import within
from obb_collision.queries.meshes.mesh_clearance import clearances_of
from obb_collision.queries.meshes.meshes import mesh_collisions, mesh_verdicts
from obb_collision.queries.meshes.placed import PlacedMeshes
from obb_collision.queries.verdict.separations import Separations
from obb_collision.queries.verdict.verdict import SEPARATE
from obb_collision.robots.bodies.state_arrays import LINK_PLACING
from obb_collision.robots.checks.distances import pair_distances_kernel
from obb_collision.robots.checks.model import Arrays, Model
from obb_collision.scene.scene import Scene
from obb_collision.scene.store.kinds import BOX, ROUND, TRIANGLES
from obb_collision.typing import Floats, Integers, Mask, Rows

#: Pairs with distances below which a second thread does not pay.
FEWEST_PAIRS = 32


class Sides(NamedTuple):
    """Some pairs as meshes: row k of a against row k of b, each with a radius about it."""

    rows: Rows  #: (k,) of the pairs
    a: PlacedMeshes
    radii_a: Floats
    b: PlacedMeshes
    radii_b: Floats
    slack: Floats  #: (k,) how far they may be from where they are, both together (metres)


class PairDistances(NamedTuple):
    """How far apart pairs (m,) are, with bounds: of the triangles if they have any."""

    lower: Floats  #: (m,) negative by at least the depth where they overlap, infinite past a limit
    upper: Floats  #: (m,) 0 where they overlap
    vectors: Floats  #: (m, 3, 3) the closest points of both, and the direction


def has_mesh(model: Model, scene: Scene, arrays: Arrays, pairs: Integers) -> Mask:
    """Return which pairs (m, 2) of bodies have a mesh."""
    own = model.mesh_bodies().meshes
    world = scene._store.kinds[arrays.world.slots] == TRIANGLES
    meshes = np.concatenate([own, world])
    return np.asarray(meshes[pairs].any(axis=1))


def collide_as_meshes(
    model: Model, scene: Scene, accuracy: Accuracy, states: Floats, pairs: Integers
) -> Mask:
    """Return (m,) which pairs (m, 2) that may collide at "hull" do in the state (m, joints).

    accuracy: "mesh", or "obb_tree", where what is padded is decided at "hull".
    """
    arrays = model.arrays(scene)
    result = np.ones(len(pairs), np.bool_)
    decided = has_mesh(model, scene, arrays, pairs)
    if accuracy == Accuracy.OBB_TREE:
        world = scene._store.paddings[arrays.world.slots]
        paddings = np.concatenate([model.mesh_bodies().paddings, world])
        decided &= (paddings[pairs] == 0.0).all(axis=1)
    for each in _sides(model, scene, states, pairs, decided, accuracy == Accuracy.MESH):
        if accuracy == Accuracy.OBB_TREE:
            result[each.rows] = mesh_collisions(each.a, each.b, depth=scene.tree_depth)
        else:
            result[each.rows] = _touch(each)
    return result


def _touch(sides: Sides) -> Mask:
    """Return (k,) which rows of sides are not certainly apart, wherever rounding puts them."""
    result = np.ones(len(sides.rows), np.bool_)
    bare = np.flatnonzero((sides.radii_a == 0.0) & (sides.radii_b == 0.0))
    result[bare] = mesh_verdicts(sides.a, sides.b, np.column_stack([bare, bare])) == SEPARATE
    apart = np.flatnonzero(result)
    grown = sides.radii_a + sides.slack
    _, near = clearances_of(sides.a, grown, sides.b, sides.radii_b, apart, apart, 0.0)
    result[apart] = ~near
    return ~result


def hull_distances(arrays: Arrays, states: Floats, pairs: Integers, limit: float) -> PairDistances:
    """Return the distances of pairs (m, 2) of bodies in the state (m, joints) of their row."""
    count = len(pairs)
    bounds, vectors = np.empty((2, count)), np.empty((count, 3, 3))
    run(
        *(pair_distances_kernel, count, FEWEST_PAIRS, arrays.tree, arrays.bodies, arrays.tests),
        *(states, pairs, limit, bounds, vectors),
    )
    return PairDistances(bounds[0], bounds[1], vectors)


def set_mesh_distances(
    model: Model, scene: Scene, states: Floats, pairs: Integers, found: PairDistances,
    limit: float, depths: bool,
) -> None:  # fmt: skip
    """Write the distances of pairs (m, 2) with a mesh, given those of their hulls.

    depths: whether to look for the depth of those that overlap; it is at least that otherwise.
    """
    decided = has_mesh(model, scene, model.arrays(scene), pairs)
    for each in _sides(model, scene, states, pairs, decided, thin=True):
        k = np.arange(len(each.rows))
        near, is_near = clearances_of(each.a, each.radii_a, each.b, each.radii_b, k, k, limit)
        apart = is_near & (near.upper > each.slack)
        some, rows = k[apart], each.rows[apart]
        lower = np.maximum(near.distances[some] - each.slack[some], found.lower[rows])
        found.upper[rows] = near.upper[some] + each.slack[some]
        found.lower[rows] = np.minimum(np.maximum(lower, 0.0), found.upper[rows])
        found.vectors[rows, 0] = near.positions_a[some]
        found.vectors[rows, 1] = near.positions_b[some]
        found.vectors[rows, 2] = near.normals[some]
        found.lower[each.rows[~is_near]] = found.upper[each.rows[~is_near]] = np.inf
        overlap = k[is_near & ~apart]
        found.upper[each.rows[overlap]] = 0.0
        if depths and len(overlap):
            _set_depths(each, overlap, found)
        found.lower[each.rows[overlap]] = np.minimum(found.lower[each.rows[overlap]], 0.0)


def _set_depths(sides: Sides, k: Rows, found: PairDistances) -> None:
    """Write the depths of meshes in rows k of sides that overlap, and where they are."""
    rows = sides.rows[k]
    vectors = found.vectors[rows]
    outer = Separations(
        np.column_stack([k, k]), np.minimum(found.lower[rows], 0.0), vectors[:, 2].copy(),
        0.5 * (vectors[:, 0] + vectors[:, 1]),
    )  # fmt: skip
    deep = within(outer, sides.a, sides.radii_a, sides.b, sides.radii_b)
    half = 0.5 * deep.separations[:, None] * deep.normals
    found.lower[rows] = deep.separations - sides.slack[k]
    found.vectors[rows, 0], found.vectors[rows, 1] = deep.positions - half, deep.positions + half
    found.vectors[rows, 2] = deep.normals


def _sides(
    model: Model, scene: Scene, states: Floats, pairs: Integers, decided: Mask, thin: bool
) -> Iterator[Sides]:
    """Yield the meshes of those pairs (m, 2) that are decided by them, in their states.

    thin: whether spheres and capsules are segments with radii.
    """
    arrays, own, store = model.arrays(scene), model.mesh_bodies(), scene._store
    first, reaches = arrays.tests.first, arrays.bodies.reaches
    i, j = np.ascontiguousarray(pairs.T)
    outside = j >= first
    kinds = np.append(np.full(first, -1), store.kinds[arrays.world.slots])
    segments = outside & (kinds[j] == ROUND) if thin else np.zeros(len(j), np.bool_)
    for part in (~outside, outside & ~segments, segments):
        rows = np.flatnonzero(part & decided)
        if len(rows) == 0:
            continue
        a = own.placed(model.tree, states[rows], i[rows], thin)
        if not outside[rows[0]]:
            b = own.placed(model.tree, states[rows], j[rows], thin)
            radii = own.radii[j[rows]]
        else:
            slots = arrays.world.slots[j[rows] - first]
            b, radii = _objects(scene, slots, model.origin, bool(segments[rows[0]]))
        slack = reaches[i[rows]] + reaches[j[rows]]
        slack += np.abs(a.centers).sum(axis=1) + np.abs(b.centers).sum(axis=1)
        yield Sides(rows, a, own.radii[i[rows]], b, radii, LINK_PLACING * slack)


def _objects(
    scene: Scene, slots: Rows, origin: Floats, segments: bool
) -> tuple[PlacedMeshes, Floats]:
    """Return objects (k,) of a scene as meshes, and their radii; segments: all of them are."""
    store, cache = scene._store, scene._cache
    centers, rotations = as_poses(store.poses[slots], warn=False)
    boxes = store.kinds[slots] == BOX
    centers[boxes], rotations[boxes] = store.centers[slots[boxes]], store.rotations[slots[boxes]]
    radii = store.paddings[slots].copy()
    if segments:
        sizes = cache.rounds(slots)
        trees, rows = segment_trees(sizes[:, 1])
        radii += sizes[:, 0]
    else:
        outside, cache.outside = cache.outside, None  # what is needed is built now
        try:
            cache.build(store, np.unique(slots), False, None)
        finally:
            cache.outside = outside
        trees, rows = cache.trees(slots)
    return PlacedMeshes.trusted(trees, rows, centers - origin, rotations), radii
