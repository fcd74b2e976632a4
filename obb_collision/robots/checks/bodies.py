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

"""Bodies of shapes in the frames of links, and of the objects of a scene, which do not move.

They are convex bodies for kernels, and meshes. Only this module of robots uses the inside of a
scene.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from obb_collision.geometry.poses import as_poses, compose_poses
from obb_collision.geometry.trees.bounds_tree import BoundsTree
from obb_collision.geometry.trees.convex_proxy import HULL_MARGIN, box_corners, excess, hull_mesh
from obb_collision.geometry.trees.obb_tree import BOX_CORNERS, MeshTrees
from obb_collision.geometry.trees.pool import TreePool, segment_trees
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.numerics.intrinsics import LANES, in_blocks
from obb_collision.obb import OBB
from obb_collision.queries.convex.support import core_of
from obb_collision.queries.meshes.placed import PlacedMeshes
from obb_collision.queries.verdict.coarse import meeting_bounds
from obb_collision.robots.checks.arrays import Clouds, LinkBodies
from obb_collision.robots.checks.balls import centers_at, clouds_of
from obb_collision.robots.kinematics.kinematics import Tree, link_poses
from obb_collision.scene.building.shape_cache import BOX, BOXED, CLOUD, ROUND, kind_of
from obb_collision.scene.objects import local_box
from obb_collision.scene.refinement.bodies import PLACING, places_of, trees_of
from obb_collision.scene.scene import Scene
from obb_collision.scene.store.store import ObjectStore
from obb_collision.shapes import Box, Capsule, Cloud, Cone, Cylinder, Shape, Sphere
from obb_collision.typing import Floats, Integers, Rows

#: Relative growth of radii: more than their roundings.
RADIUS_GROWTH = 1.0 + 64 * ROUNDOFF
#: Relative shrinkage of balls within bodies: the planes of thin faces have larger errors.
NARROWER = 1.0 - 2.0**-10


ROUND_ABOUT_Z = Sphere, Cylinder, Capsule, Cone


class Part(NamedTuple):
    """A shape at a pose in the frame of a link; owner: the row of names of link or object."""

    shape: Shape | OBB
    pose: ArrayLike
    link: int
    padding: float
    owner: int


def body_of(
    shape: Shape | OBB, pose: ArrayLike, frame: int = 0, padding: float = 0.0, chain: float = 0.0
) -> LinkBodies:
    """Return the body of a shape at a pose (7,) in a frame, padded as in a scene.

    chain: length of the chain up to the frame, m.
    """
    positions, rotations = as_poses(np.array(pose, np.float64)[None], "pose")
    center, rotation, half_extents = local_box(shape)
    corners, radius, inner = _core(shape, padding)
    box = rotations[0] @ center + positions[0], rotations[0] @ rotation, half_extents + padding
    placed = corners @ rotations[0].T + positions[0]
    body = placed_body(placed, radius, frame, box, excess(shape, corners), chain)
    return body._replace(inner=np.array([inner]))


def placed_body(
    corners: Floats,
    radius: float,
    frame: int,
    box: tuple[Floats, Floats, Floats],
    beyond: float,
    chain: float = 0.0,
) -> LinkBodies:
    """Return the body of corners (k, 3), a radius around them and a box, all in a frame.

    beyond: how far the corners reach beyond a curved shape, m.
    """
    sphere = (float(np.linalg.norm(corners - box[0], axis=1).max()) + radius) * RADIUS_GROWTH
    farthest = float(np.abs(corners).sum(axis=1).max())
    reach, blocks = chain + farthest + radius, in_blocks(corners)
    values = frame, *box, sphere, 0.0, False, radius, farthest, reach, beyond
    arrays = (np.array([value]) for value in values)
    return LinkBodies._make([*arrays, blocks, np.array([0, len(blocks)])])


def box_bodies(centers: Floats, rotations: Floats, half_extents: Floats, frame: int) -> LinkBodies:
    """Return boxes (n,) as bodies in a frame."""
    count = len(centers)
    grown = half_extents + HULL_MARGIN * half_extents.max(axis=1, keepdims=True, initial=0.0)
    corners = centers[:, None] + np.einsum("nij,nkj->nki", rotations, BOX_CORNERS * grown[:, None])
    radii = np.abs(corners).sum(axis=2).max(axis=1, initial=0.0)
    spheres = np.linalg.norm(grown, axis=1) * RADIUS_GROWTH
    inner, none = half_extents.min(axis=1, initial=np.inf), np.zeros(count)
    boxes = np.full(count, frame), centers, rotations, half_extents, spheres, inner
    rest = np.ones(count, np.bool_), none, radii, radii, none
    blocks = np.ascontiguousarray(corners.transpose(0, 2, 1))
    return LinkBodies(*boxes, *rest, blocks, np.arange(count + 1))


def ball_bodies(radii: Floats, sizes: Floats, frame: int) -> LinkBodies:
    """Return bodies (c,) of clouds in a frame: balls that kernels move.

    sizes (c,): the largest sums of the magnitudes of the coordinates of their points.
    """
    count = len(radii)
    nothing, blocks = np.zeros(count), np.zeros((count, 3, LANES))
    return LinkBodies(
        frames=np.full(count, frame),
        centers=np.zeros((count, 3)),
        rotations=np.tile(np.eye(3), (count, 1, 1)),
        half_extents=np.repeat(radii[:, None], 3, axis=1),
        spheres=radii * RADIUS_GROWTH,
        inner=radii * NARROWER,
        boxes=np.zeros(count, np.bool_),
        rounds=radii,
        radii=sizes,
        reaches=sizes + radii,
        excess=nothing,
        blocks=blocks,
        starts=np.arange(count + 1),
    )


NO_BODIES = box_bodies(np.empty((0, 3)), np.empty((0, 3, 3)), np.empty((0, 3)), 0)


def joined(bodies: Sequence[LinkBodies]) -> LinkBodies:
    """Return the bodies of several sets as one set."""
    parts = [NO_BODIES, *bodies]
    arrays = LinkBodies._make(np.concatenate(values) for values in zip(*parts, strict=True))
    lengths = np.concatenate([np.diff(part.starts) for part in parts])
    return arrays._replace(starts=np.append(0, np.cumsum(lengths)))


def enclosing_spheres(bodies: LinkBodies, starts: Integers) -> tuple[Floats, Floats]:
    """Return centres (l, 3) and radii (l,) of spheres around bodies ``starts[k]:starts[k + 1]``."""
    centers, radii = np.zeros((len(starts) - 1, 3)), np.zeros(len(starts) - 1)
    for k, (first, last) in enumerate(pairwise(starts.tolist())):
        places = bodies.centers[first:last]
        centers[k] = places.mean(axis=0)
        reaches = np.linalg.norm(places - centers[k], axis=1) + bodies.spheres[first:last]
        radii[k] = reaches.max() * RADIUS_GROWTH
    return centers, radii


def is_about_z(shape: Shape | OBB) -> bool:
    """Return whether a shape is round about its z axis."""
    return isinstance(shape, ROUND_ABOUT_Z) and shape.scale[0] == shape.scale[1]


def _core(shape: Shape | OBB, padding: float) -> tuple[Floats, float, float]:
    """Return the corners (k, 3) of a shape, the radius around each point, and an inner radius.

    Padding makes boxes larger, and is a radius around other shapes. The inner radius is that of a
    ball within the hull, around the centre of its box.
    """
    kind = kind_of(shape)
    center, rotation, half_extents = local_box(shape)
    if kind == ROUND and isinstance(shape, Shape):
        half, radius = core_of(shape)[4:]
        ends = (-half, half) if isinstance(shape, Capsule) else (0.0,)
        return np.array([(0.0, 0.0, z) for z in ends]), radius + padding, radius * NARROWER
    if kind in (BOX, BOXED):
        half_extents = half_extents + padding
        corners = box_corners(half_extents) @ rotation.T + center
        return corners, 0.0, float(half_extents.min()) * NARROWER
    assert isinstance(shape, Shape)
    corners, faces = hull_mesh(shape)
    a, b, c = (corners - center)[faces].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    heights = np.einsum("ij,ij->i", normals, a) / np.linalg.norm(normals, axis=1)
    return corners, padding, max(float(heights.min()), 0.0) * NARROWER


class LinkMeshes:
    """The bodies of robots (b,) as meshes in frames (b,), with radii (b,) around them."""

    def __init__(self, parts: Sequence[Part]) -> None:
        self._frames = np.array([part.link for part in parts], np.int64)
        self._poses = np.array([part.pose for part in parts], np.float64)
        self.radii = np.array([part.padding for part in parts], np.float64)
        self._rows = np.zeros(len(parts), np.int64)
        built: dict[object, tuple[int, MeshTrees]] = {}
        for n, (shape, *_) in enumerate(parts):
            if kind_of(shape) == BOXED:
                shape = OBB(*local_box(shape))
            if isinstance(shape, OBB):  # its tree is that of a box at the origin
                place = np.append(shape.center, shape.quaternion)
                self._poses[n] = compose_poses(self._poses[n], place)
            elif kind_of(shape) == ROUND:
                self.radii[n] += core_of(shape)[5]
            key = shape if isinstance(shape, Shape) else n
            if key not in built:
                built[key] = len(built), _tree(shape)
            self._rows[n] = built[key][0]
        self._trees = MeshTrees.join([tree for _, tree in built.values()])

    def placed(self, tree: Tree, states: Floats, bodies: Rows) -> PlacedMeshes:
        """Return bodies (m,) placed in states (m, joints)."""
        links = link_poses(tree, np.ascontiguousarray(states))
        frames = links[np.arange(len(bodies)), self._frames[bodies]]
        poses = compose_poses(frames, self._poses[bodies])
        return PlacedMeshes.trusted(self._trees, self._rows[bodies], *as_poses(poses))


def _tree(shape: Shape | OBB) -> MeshTrees:
    """Return the tree of a shape; that of a sphere or capsule is a segment."""
    if isinstance(shape, (Box, OBB)):
        return TreePool.built(local_box(shape)[2])
    if kind_of(shape) != ROUND:
        return TreePool.built(shape)
    return segment_trees(np.array([core_of(shape)[4]]))[0]


class WorldState:
    """A snapshot of a scene, to tell whether it has changed since.

    left_out: names of objects that do not count.
    """

    def __init__(self, scene: Scene, left_out: Collection[str] = ()) -> None:
        self._left_out = left_out
        self._note(scene)
        self._world = self._others(scene)

    def _note(self, scene: Scene) -> None:
        self._key, self._snapshot = _key(scene), scene.objects.store.snapshot()
        self._active = scene.objects.store.active.tobytes()  # compared faster than arrays are

    def _others(self, scene: Scene) -> tuple[Floats | Rows, ...]:
        """Return the slots of objects that count, and their boxes."""
        slots = _counted(scene.objects.store, self._left_out)
        boxes = scene.objects.store.boxes(slots)
        return slots, *boxes.arrays

    def is_current(self, scene: Scene) -> bool:
        """Return whether bodies are still those of the snapshot."""
        if _key(scene) != self._key:
            return False
        if self._snapshot.is_current and scene.objects.store.active.tobytes() == self._active:
            return True
        others = self._others(scene)
        if not all(np.array_equal(a, b) for a, b in zip(others, self._world, strict=True)):
            return False
        self._note(scene)  # an object that does not count has moved
        return True


def _key(scene: Scene) -> tuple[object, ...]:
    """Return a key that changes with the names, shapes and rules of a scene."""
    store = scene.objects.store
    return store, store.version, store.revision


def _counted(store: ObjectStore, left_out: Collection[str]) -> Rows:
    """Return the slots that count, ascending."""
    counted = store.active.copy()
    counted[[store.slots[name] for name in left_out if name in store.slots]] = False
    return np.flatnonzero(counted)


def padding_of(scene: Scene, name: str) -> float:
    """Return the padding of an object; KeyError for an unknown name."""
    return float(scene.objects.store.paddings[scene.objects.store.slot(name)])


def largest_padding(scene: Scene, names: Iterable[str]) -> float:
    """Return the largest own padding of objects; unknown names are skipped."""
    slots = [scene.objects.store.slots[name] for name in names if name in scene.objects.store.slots]
    return float(scene.objects.store.own_paddings[slots].max(initial=0.0))


Kept = dict[int, tuple[object, LinkBodies]]
"""By slot: a key of all that a body depends on, and the body."""


class World(NamedTuple):
    """The objects of a scene as bodies (w,), relative to an origin (3,), and their tree.

    A cloud is one body, see ``balls``; clouds come last.
    """

    scene: Scene
    origin: Floats
    slots: Rows  #: (w,) those of clouds last
    kinds: Rows  #: (w,) as in ``scene.building.shape_cache``; the balls of clouds are round
    names: list[str]
    bodies: LinkBodies
    tree: BoundsTree  #: without clouds
    clouds: Clouds

    def placed(self, rows: Rows, balls: Rows) -> tuple[PlacedMeshes, Floats]:
        """Return objects (k,), all of them round or none, as meshes, and their radii.

        balls (k,): those of objects that are clouds.
        """
        store, slots = self.scene.objects.store, self.slots[rows]
        if (self.kinds[rows] == ROUND).any():
            return self._round(rows, balls)
        cache = self.scene.objects.cache.at_once()
        cache.build(store, np.unique(slots), False, None)
        trees, numbers, radii = trees_of(store, cache, slots)
        centers, rotations = places_of(store, store.all_boxes(), slots)
        return PlacedMeshes.trusted(trees, numbers, centers - self.origin, rotations), radii

    def _round(self, rows: Rows, balls: Rows) -> tuple[PlacedMeshes, Floats]:
        """Return spheres, capsules and balls (k,) as segments, and their radii."""
        store, slots, count = self.scene.objects.store, self.slots[rows], len(rows)
        halves, radii = np.zeros(count), self.bodies.rounds[rows]
        centers, rotations = np.empty((count, 3)), np.tile(np.eye(3), (count, 1, 1))
        solid = store.kinds[slots] == ROUND
        centers[~solid] = centers_at(self.clouds, balls[~solid])
        if solid.any():
            slots = slots[solid]
            halves[solid] = self.scene.objects.cache.cores(slots)[:, 4]
            places, rotations[solid] = places_of(store, store.all_boxes(), slots)
            centers[solid] = places - self.origin
        trees, numbers = segment_trees(halves)
        return PlacedMeshes.trusted(trees, numbers, centers, rotations), radii


def world_of(
    scene: Scene, frame: int, origin: Floats, left_out: Collection[str], kept: Kept
) -> World:
    """Return the bodies of a scene; frame: the number of the world's frame.

    left_out: names of objects that do not count; kept: bodies of the last call, to be updated.
    """
    store = scene.objects.store
    active = _counted(store, left_out)
    boxed = np.isin(store.kinds[active], (BOX, BOXED))
    are_clouds = store.kinds[active] == CLOUD
    plain, others = active[boxed], active[~boxed & ~are_clouds]
    place, shape = (store, frame, origin.tobytes()), scene.objects.cache.shape
    keys = {
        slot: (place, shape(slot), float(store.paddings[slot]), store.poses[slot].tobytes())
        for slot in others.tolist()
    }
    new = [slot for slot, key in keys.items() if slot not in kept or kept[slot][0] != key]
    made = dict(zip(new, _made(scene, np.array(new, np.int64), frame, origin), strict=True))
    bodies = {slot: made[slot] if slot in made else kept[slot][1] for slot in keys}
    kept.clear()
    kept.update({slot: (keys[slot], body) for slot, body in bodies.items()})
    boxes = store.centers[plain] - origin, store.rotations[plain], store.half_extents[plain]
    solid = np.concatenate([plain, others])
    minimum, maximum = meeting_bounds(store.boxes(solid))
    tree = BoundsTree.build(minimum - origin, maximum - origin)
    balls, clouds, slots = _clouds(scene, active[are_clouds], frame, origin)
    clouds = clouds._replace(bodies=len(solid) + np.arange(len(slots)))
    slots = np.concatenate([solid, slots])
    names, kinds = [str(store.names[slot]) for slot in slots], store.kinds[slots].astype(np.int64)
    kinds[len(solid) :] = ROUND
    parts = joined([box_bodies(*boxes, frame), *bodies.values(), balls])
    return World(scene, origin, slots, kinds, names, parts, tree, clouds)


def _clouds(
    scene: Scene, slots: Rows, frame: int, origin: Floats
) -> tuple[LinkBodies, Clouds, Rows]:
    """Return the bodies of clouds that have points, their trees, and their slots."""
    store, shape = scene.objects.store, scene.objects.cache.shape
    shapes = {slot: cloud for slot in slots.tolist() if isinstance(cloud := shape(slot), Cloud)}
    clouds = [cloud for cloud in shapes.values() if len(cloud.points)]
    slots = np.array([slot for slot, cloud in shapes.items() if len(cloud.points)], np.int64)
    centers, rotations = as_poses(store.poses[slots], warn=False)
    offsets = centers - origin
    radii = np.array([cloud.radius for cloud in clouds]) + store.paddings[slots]
    sizes = np.abs(offsets).sum(axis=1) + 3.0 * radii
    sizes += [sum(np.abs(part).sum() for part in cloud.local_box[::2]) for cloud in clouds]
    trees = clouds_of(clouds, np.arange(len(slots)), offsets, np.ascontiguousarray(rotations))
    return ball_bodies(radii + PLACING * sizes, 2.0 * sizes, frame), trees, slots


def _made(scene: Scene, slots: Rows, frame: int, origin: Floats) -> list[LinkBodies]:
    """Return the bodies of objects that are not boxes."""
    if len(slots) == 0:
        return []
    store, cache = scene.objects.store, scene.objects.cache
    centers, rotations = as_poses(store.poses[slots], warn=False)
    boxes, radii = store.boxes(slots), store.paddings[slots].copy()
    solid = store.kinds[slots] != ROUND
    if solid.any():
        cache = cache.at_once()
        cache.build(store, slots[solid], True, None)
        hulls, rows = cache.hulls(slots)
    result = []
    for n, slot in enumerate(slots.tolist()):
        if solid[n]:
            blocks = hulls.blocks[hulls.starts[rows[n]] : hulls.starts[rows[n] + 1]]
            corners = blocks.transpose(0, 2, 1).reshape(len(blocks) * LANES, 3)
        else:
            half, own = cache.cores(slots[n : n + 1])[0, 4:]
            corners, radii[n] = np.array([(0.0, 0.0, -half), (0.0, 0.0, half)]), radii[n] + own
        beyond = excess(cache.shape(slot), corners)
        corners = corners @ rotations[n].T + (centers[n] - origin)
        center, turn, half_extents = (array[n] for array in boxes.arrays)
        box = center - origin, turn, half_extents
        result.append(placed_body(corners, float(radii[n]), frame, box, beyond))
    return result
