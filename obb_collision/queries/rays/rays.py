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

"""Rays and segments against boxes and meshes: the nearest hit of each, by a tree of bounds.

A box is the common part of three slabs (Kay, Kajiya 1986; Ericson 2005, 5.3.3). No hit is missed:
for the decision, each half extent of a box is enlarged by HIT_BOUND times the distance of the
origin from its centre plus its half extents. This is more than rounding and axes orthonormal to 64
unit roundoffs can shift a point of the ray that lies in the box (as in ``containment``, once for
the origin and once for the direction). So a ray may hit a box that it passes at less than twice
that distance. Distances are to the box itself, right to 2^-40 of its size and the origin's
distance; if the ray grazes a face, to the enlarged box: earlier, not later.

Meshes, and hulls as meshes, are hit at their surface, or at once if they are solids and the
origin is inside (``bodies``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.geometry.boxes import BoxArrays, Boxes
from obb_collision.geometry.validation import as_array, check_kind, check_lengths, refuse_where
from obb_collision.numerics.vec3 import axis_of, dot, lengths, plus, scaled, vector_at
from obb_collision.queries.convex.support import ConvexBodies, Solids, solids_of
from obb_collision.queries.meshes.placed import BOX_BOUND, PlacedMeshes, body_at, root_boxes
from obb_collision.queries.meshes.trees import NodeStack, node_stack
from obb_collision.queries.rays.bodies import hit_convex, hit_mesh, triangle_normal
from obb_collision.queries.rays.boxes import (
    MISSED,
    NODE_CHILD,
    NODE_COUNT,
    NODE_START,
    RAY_STACK,
    Hit,
    HitArrays,
    Ray,
    Rays,
    RayTree,
    TreeNodes,
    build_ray_tree,
    enters_bounds,
    hit_box,
)
from obb_collision.queries.verdict.pair_rows import as_each
from obb_collision.queries.verdict.sat import box_at
from obb_collision.typing import Floats, Integers, Vector

NO_RADII = np.empty(0)
#: Rays below which a second thread does not pay: 0.1 ms.
FEWEST_RAYS = 64


@dataclass(frozen=True, eq=False)
class RayHits:
    """The nearest box or mesh on each ray.

    boxes (m,): its row, the lowest of equally near ones; -1 where nothing is hit. distances (m,)
    metres from the origin, 0 for an origin in the box, infinite where nothing is hit. positions
    (m, 3) of the hits, and normals (m, 3) of the faces entered, outwards, unit; a ray that starts
    in a box or solid enters no face, its normal is zero. Both are NaN where nothing is hit. Of
    meshes, normals are those of triangles, against the ray, and faces (m,) their numbers, -1 where
    none is hit; of boxes, faces is None.
    """

    boxes: Integers
    distances: Floats
    positions: Floats
    normals: Floats
    faces: Integers | None = None

    @property
    def hits(self) -> NDArray[np.bool_]:
        """(m,) whether each ray hits a box or mesh."""
        return np.asarray(self.boxes >= 0)


def cast_rays(
    boxes: Boxes | PlacedMeshes,
    origins: ArrayLike,
    directions: ArrayLike,
    max_distance: ArrayLike = np.inf,
) -> RayHits:
    """Return the first hit of each ray.

    Parameters
    ----------
    boxes : Boxes or PlacedMeshes
    origins : (m, 3) array_like
        Metres.
    directions : (m, 3) array_like
        Of any length but zero.
    max_distance : float or (m,) array_like
        Metres, infinity allowed.

    Returns
    -------
    RayHits
        hits (m,) bool; boxes (m,) rows, -1 for none; distances (m,) metres; positions and normals
        (m, 3); faces (m,) of meshes.

    References
    ----------
    Kay, Kajiya, Ray Tracing Complex Scenes (SIGGRAPH 1986); Ericson 2005, 5.3.3.

    Examples
    --------
    >>> boxes = oc.Boxes([[5, 0, 0], [9, 0, 0]], [np.eye(3)] * 2, [[1, 1, 1]] * 2)
    >>> found = oc.cast_rays(boxes, [[0, 0, 0]], [[1, 0, 0]])
    >>> found.boxes.tolist(), found.distances.tolist(), found.positions.tolist()
    ([0], [4.0], [[4.0, 0.0, 0.0]])
    """
    _check_targets(boxes)
    return cast_at(boxes, as_rays(origins, directions, max_distance))


def as_rays(origins: ArrayLike, directions: ArrayLike, max_distance: ArrayLike) -> Rays:
    """Return validated rays."""
    o = as_array(origins, "origins", (None, 3))
    d = as_array(directions, "directions", (None, 3))
    check_lengths(origins=o, directions=d)
    units, norms = _units(d)
    refuse_where(norms == 0.0, "directions must not be zero")
    reaches = as_each(max_distance, "max_distance", "a number, or a number per ray", (len(o),))
    refuse_where(~(reaches >= 0.0), "max_distance must not be negative or NaN")
    return Rays(o, units, reaches)


def cast_at(targets: Boxes | PlacedMeshes, rays: Rays) -> RayHits:
    """Return the first hits of rays on boxes or meshes; not checked."""
    return _hits(rays, targets, targets if isinstance(targets, Boxes) else root_boxes(targets))


def cast_at_bodies(bodies: ConvexBodies, boxes: Boxes, rays: Rays) -> RayHits:
    """Return the first hits of rays on convex bodies that are in boxes; not checked.

    Never late, and at most 1e-9 of the size of a body early, along its normal (``bodies``).
    """
    return _hits(rays, bodies, boxes)


def cast_at_padded(meshes: PlacedMeshes, radii: Floats, rays: Rays) -> RayHits:
    """Return the first hits of rays on points within ``radii`` (n,) of meshes; not checked.

    Never late, and at most 1e-9 of the size of a body early, along its normal (``bodies``).
    """
    boxes = root_boxes(meshes)
    grown = boxes.half_extents + (radii * (1.0 + BOX_BOUND))[:, None]
    boxes = Boxes.trusted(*boxes.arrays._replace(half_extents=grown))
    return _hits(rays, meshes, boxes, radii)


def cast_segments(boxes: Boxes | PlacedMeshes, starts: ArrayLike, ends: ArrayLike) -> RayHits:
    """Return the first hit of each segment, from its start.

    Parameters
    ----------
    boxes : Boxes or PlacedMeshes
    starts, ends : (m, 3) array_like
        Metres; equal ones make a point.

    Returns
    -------
    RayHits
        hits (m,) bool; boxes (m,) rows, -1 for none; distances (m,) metres; positions and normals
        (m, 3); faces (m,) of meshes.

    Examples
    --------
    >>> boxes = oc.Boxes([[5, 0, 0]], [np.eye(3)], [[1, 1, 1]])
    >>> oc.cast_segments(boxes, [[0, 0, 0], [0, 0, 0]], [[4.5, 0, 0], [3, 0, 0]]).hits.tolist()
    [True, False]
    """
    _check_targets(boxes)
    p = as_array(starts, "starts", (None, 3))
    q = as_array(ends, "ends", (None, 3))
    check_lengths(starts=p, ends=q)
    units, norms = _units(q - p)
    units[norms == 0.0] = 1.0, 0.0, 0.0
    return cast_at(boxes, Rays(p, units, norms))


def _check_targets(boxes: Boxes | PlacedMeshes) -> None:
    if not isinstance(boxes, PlacedMeshes):
        check_kind(boxes, Boxes, "boxes")


def _units(directions: Floats) -> tuple[Floats, Floats]:
    """Return unit vectors (m, 3) and lengths (m,); zero stays zero."""
    norms = lengths(directions)
    return directions / np.where(norms > 0.0, norms, 1.0)[:, None], norms


class Targets(NamedTuple):
    """Bodies of one kind; no code is compiled for a kind that is None."""

    boxes: BoxArrays | None
    solids: Solids | None  #: radii of length 0: meshes without radii, which have normals


def _hits(
    rays: Rays, bodies: Boxes | PlacedMeshes | ConvexBodies, boxes: Boxes, radii: Floats = NO_RADII
) -> RayHits:
    """Return the first hits of rays on bodies, which are in boxes; radii: about meshes."""
    if isinstance(bodies, Boxes):
        targets = Targets(bodies.arrays, None)
    else:
        targets = Targets(None, solids_of(bodies, radii))
    nodes, count = build_ray_tree(np.concatenate(boxes.world_bounds(), axis=1)), len(rays.origins)
    rows, numbers = np.empty((2, count), np.int64)
    points, normals = np.empty((2, count, 3))
    out = HitArrays(rows, np.empty(count), points, normals, numbers)
    run(rays_kernel, count, FEWEST_RAYS, rays, targets, nodes, out)
    return RayHits(*out[:4], numbers if isinstance(bodies, PlacedMeshes) else None)


@njit
def rays_kernel(
    rays: Rays, targets: Targets, nodes: TreeNodes, out: HitArrays, start: int, stop: int
) -> None:
    """Write the hits of rays ``start`` to ``stop``; point and normal are NaN without a hit."""
    boxes, solids = targets
    tree = RayTree(nodes[0], nodes[1], nodes[2], np.empty(RAY_STACK, np.int64), np.empty(RAY_STACK))
    waiting = node_stack()
    for n in range(start, stop):
        ray = Ray(vector_at(rays.origins, n), vector_at(rays.units, n), rays.reaches[n])
        row, hit = _nearest(ray, boxes, solids, tree, waiting)
        out.bodies[n], out.distances[n] = row, hit[0]
        out.faces[n], normal = _face(ray, boxes, solids, row, hit)
        point = plus(ray.origin, scaled(ray.unit, hit[0]))
        for k in range(3):
            out.points[n, k] = point[k] if row >= 0 else np.nan
            out.normals[n, k] = normal[k] if row >= 0 else np.nan


@njit(refcount=False)
def _nearest(
    ray: Ray, boxes: BoxArrays | None, solids: Solids | None, tree: RayTree, waiting: NodeStack
) -> tuple[int, Hit]:
    """Return the nearest body, the first of equally near ones, and the hit; -1 if none."""
    limits, nodes, order, stack, entries = tree
    row, best, depth = -1, MISSED, 1
    stack[0], entries[0] = 0, enters_bounds(limits, 0, ray, ray.reach)
    while depth > 0:
        depth -= 1
        node = stack[depth]
        if entries[depth] > best[0] or entries[depth] == np.inf:
            continue
        child = nodes[node, NODE_CHILD]
        if child < 0:
            for m in range(
                nodes[node, NODE_START], nodes[node, NODE_START] + nodes[node, NODE_COUNT]
            ):
                b = order[m]
                hit = MISSED
                if boxes is not None:
                    hit = hit_box(ray, box_at(boxes, b))
                if solids is not None:
                    if len(solids.meshes.meshes) > 0:
                        radius = solids.radii[b] if len(solids.radii) > 0 else -1.0
                        hit = hit_mesh(ray, solids.meshes, b, radius, best[0], waiting)
                    else:
                        hit = hit_convex(ray, solids.cores, b, best[0])
                if hit[0] < best[0] or (hit[0] == best[0] < np.inf and b < row):
                    row, best = b, hit
            continue
        other, reach = child + 1, min(ray.reach, best[0])
        first = enters_bounds(limits, child, ray, reach)
        second = enters_bounds(limits, other, ray, reach)
        if first < second:  # the nearer one is on top
            child, other, first, second = other, child, second, first
        stack[depth], entries[depth] = child, first
        stack[depth + 1], entries[depth + 1] = other, second
        depth += 2
    return row, best


@njit(refcount=False)
def _face(
    ray: Ray, boxes: BoxArrays | None, solids: Solids | None, row: int, hit: Hit
) -> tuple[int, Vector]:
    """Return the number of the triangle hit, -1 if none, and the normal of the face entered."""
    _, number, normal = hit
    if boxes is not None and number >= 0:
        across = axis_of(boxes.rotations, row, number)
        side = -1.0 if dot(ray.unit, across) > 0.0 else 1.0
        normal = side * across[0] + 0.0, side * across[1] + 0.0, side * across[2] + 0.0
    if solids is not None and number >= 0:
        meshes = solids.meshes
        if len(solids.radii) == 0:
            normal = triangle_normal(ray, meshes.trees, number, body_at(meshes, row))
        return meshes.trees.faces[number], normal
    return -1, normal
