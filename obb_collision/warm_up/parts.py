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

"""Parts of the longest steps, for a second process; they call kernels that others call in the end.

A step compiles a kernel and all that it calls in one go, from the first call to the last. What a
part compiles meanwhile, the step finds in the cache when it comes to it.
"""

from __future__ import annotations

import numpy as np

import obb_collision as oc
from obb_collision.accuracy import Accuracy
from obb_collision.geometry.trees.pool import Hulls
from obb_collision.numerics.sorting import FEWEST_NUMBERS
from obb_collision.queries.convex.contacts import (
    convex_contacts,
    flat_room,
    frame_of,
    overlay,
    spread,
)
from obb_collision.queries.convex.depth import deepest, room_for_depth
from obb_collision.queries.convex.distance import Search, search
from obb_collision.queries.convex.distances import convex_distances
from obb_collision.queries.convex.mesh_distances import mesh_body_distances
from obb_collision.queries.convex.simplex import no_simplex
from obb_collision.queries.convex.support import Core, core_at
from obb_collision.queries.mesh_contacts.surfaces import within
from obb_collision.queries.meshes.convex import PlacedHulls, hulls_may_collide
from obb_collision.queries.meshes.meshes import nesting as nesting_kernel
from obb_collision.queries.meshes.placed import MeshAt
from obb_collision.queries.meshes.tree_boxes import Place, Pose
from obb_collision.queries.meshes.tree_descent import STACK
from obb_collision.queries.points.bodies import body_holds, convex_holds
from obb_collision.queries.primitives.capsules import capsule_verdicts
from obb_collision.queries.sweep.convex import convex_sweeps
from obb_collision.queries.sweep.course import BodyMotion
from obb_collision.queries.sweep.linear import sweep_linear
from obb_collision.queries.sweep.motion import sweep_needed, swept_bounds
from obb_collision.queries.sweep.moving import twist_bounds, twist_motion
from obb_collision.queries.sweep.sweep import contact_point, find_contact
from obb_collision.queries.verdict.pair_frame import Box
from obb_collision.queries.verdict.sat import AXES
from obb_collision.queries.verdict.separations import Separations
from obb_collision.scene.broad_phase.broad_phase import UNLIMITED, find_candidates
from obb_collision.scene.broad_phase.kept_tree import KeptTree
from obb_collision.warm_up.samples import (
    OBJECTS,
    TETRAHEDRON,
    TETRAHEDRON_FACES,
    TURNED,
    batch,
    convex_bodies,
    triangle_tree,
)

HERE, AXES_OF_BOX = (0.0, 0.0, 0.0), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
SAME_PLACE = Pose(AXES_OF_BOX, HERE, 1.0, 0.0, 0.0)


def bounds() -> None:
    """Find which bounds overlap, of all boxes and of some that move."""
    low = np.random.default_rng(0).random((OBJECTS, 3))
    find_candidates(low, low + 0.2)
    many = np.arange(2 * FEWEST_NUMBERS)
    line = np.column_stack([many, many, many]).astype(np.float64)
    find_candidates(line, line + 0.5)
    tree = KeptTree(low, low + 0.2)
    row = np.zeros(1, np.int64)
    tree.update(row)
    tree.pairs_of(row, UNLIMITED)


def nesting() -> None:
    """Look for a piece of a mesh in another."""
    trees, body = triangle_tree().arrays, MeshAt(0, Place(HERE, AXES_OF_BOX))
    nesting_kernel(trees, body, trees, body, SAME_PLACE, np.empty((STACK, 2), np.int64))


def surfaces() -> None:
    """Find how far a mesh is from another, and from a round shape."""
    row = np.zeros(1, np.int64)
    bodies = oc.PlacedMeshes.from_poses(triangle_tree(), row, [TURNED])
    oc.mesh_clearances(bodies, bodies)
    mesh_body_distances(bodies, np.zeros(1), convex_bodies(), row, row)


def mesh_depths() -> None:
    """Find how deep two meshes overlap, whatever contains them."""
    body = oc.PlacedMeshes.from_poses(triangle_tree(), np.zeros(1, np.int64), [TURNED])
    pairs, along = np.zeros((1, 2), np.int64), np.array([AXES_OF_BOX[0]])
    outer = Separations(pairs, np.full(1, -1.0), along, along.copy())
    within(outer, body, np.zeros(1), body, np.zeros(1))


def trees() -> None:
    """Build a tree."""
    oc.MeshTrees.build(np.array(TETRAHEDRON), np.array(TETRAHEDRON_FACES))


def hulls() -> None:
    """Decide pairs of capsules, boxes and hulls."""
    zeros = np.zeros((4, 3))
    capsules = oc.Capsules(zeros, zeros + 1.0, np.full(4, 0.1))
    for other in (batch(), capsules):
        capsule_verdicts(capsules, other)
    row = np.zeros(1, np.int64)
    hull = PlacedHulls(Hulls.of(np.array(TETRAHEDRON)), row, zeros[:1], np.eye(3)[None])
    hulls_may_collide(hull, hull, row, row)


def nearest() -> None:
    """Search for the nearest points of two convex bodies."""
    core = _core()
    search(core, core, SAME_PLACE, HERE, 0.0)


def held(level: Accuracy) -> None:
    """Ask whether a point is in a convex body, and on MESH in a mesh."""
    convex_holds(convex_bodies().arrays, 0, HERE, 0.0)
    if level == Accuracy.MESH:
        body = oc.PlacedMeshes.from_poses(triangle_tree(), np.zeros(1, np.int64), [TURNED])
        body_holds(body.arrays, 0, HERE, 0.0, np.empty((STACK, 2), np.int64))


def depths() -> None:
    """Find how deep two convex bodies overlap."""
    core, axis = _core(), AXES_OF_BOX[0]
    found = Search(-0.5, axis, 0.0, HERE, HERE, no_simplex())
    deepest(core, core, SAME_PLACE, found, room_for_depth())


def patches() -> None:
    """Find where two convex bodies touch."""
    core, flat = _core(), flat_room()
    count = overlay(core, core, SAME_PLACE, frame_of(AXES_OF_BOX[0]), 0.5, flat)
    spread(flat.a, count, len(flat.b))


def convex_pairs() -> None:
    """Find how far apart two convex bodies are, or how deep they overlap and where."""
    depths()
    patches()
    bodies, row = convex_bodies(), np.zeros(1, np.int64)
    found, _ = convex_distances(bodies, bodies, row, row)
    convex_contacts(bodies, bodies, np.zeros((1, 2), np.int64), row, row, 4, found)


def _core() -> Core:
    """Return a core whose kind is as bodies have it."""
    bodies = convex_bodies().arrays
    return core_at(bodies, 0)._replace(kind=bodies.kinds[0])


def swept_hulls() -> None:
    """Sweep two convex bodies."""
    bodies, row = convex_bodies(), np.zeros((1, 3))
    motion = BodyMotion(*(row, row, 1.0), np.eye(3)[None], *(row, row), *np.ones((2, 1)))
    convex_sweeps(bodies, motion, np.zeros((1, 2), np.int64), np.zeros(1), 1e-4)


def linear() -> None:
    """Sweep boxes that do not turn, find contacts of all, and bound what keeps its twist."""
    box, other = (Box((x, 0.0, 0.0), AXES_OF_BOX, (0.5, 0.5, 0.5)) for x in (0.0, 3.0))
    _, normal, axis = sweep_linear(box, other, HERE, np.empty((2, AXES)))
    contact_point(box, other, normal, axis)
    boxes, twists = batch(), np.full((4, 6), 0.1)
    sweep_needed(boxes, boxes)
    swept_bounds(boxes, boxes)
    find_contact(twist_motion(boxes, twists, boxes.centers, 1.0), 0, 1, 0.0, HERE)
    twist_bounds(boxes, twists, boxes.centers, 1.0)
