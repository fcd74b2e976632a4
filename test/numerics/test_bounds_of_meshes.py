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

"""Error bounds of meshes, hulls and fits: observed error over bound."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from convex_bodies import CORNER_SIGNS, corners_of, distances_of, family, pool_of
from each import each
from error_bounds import Moved, check_flips, check_ratios, edge_lengths, exact_gaps, solved
from exact_vectors import cross, dot, exact, minus, norm, taxicab
from hull_distances import placed
from mesh_zoo import TRIANGLE, ZOO
from scipy.spatial.transform import Rotation
from support import row_of

import obb_collision as oc
from obb_collision import Boxes, MeshTrees, PlacedMeshes
from obb_collision.geometry.fitting import COORDINATE_BOUND, enclose_points
from obb_collision.geometry.trees import WIDENING
from obb_collision.numerics.vec3 import vector
from obb_collision.queries.convex import CONVEX_ROUNDING
from obb_collision.queries.meshes import (
    DISTANCE_BOUND,
    GAP_BOUND,
    SLAB_SLACK,
    PlacedHulls,
    hulls_may_collide,
    outside_box,
)
from obb_collision.queries.meshes.placed import (
    POINT_BOUND,
    back_of,
    faces_gap,
    moved,
    moved_node,
    node_gap,
    place_at,
    relative_pose,
)
from obb_collision.queries.meshes.triangles import (
    DETERMINANT_ROUNDING,
    WIDTH,
    classify_by_axes,
    determinant_bound,
    sign,
    triangle_at,
)
from obb_collision.typing import Floats

RNG = np.random.default_rng(10)
COUNT = 60


def test_corners_in_the_frame_of_the_other_mesh() -> None:
    """By the transposed rotation instead of the inverse: that is most of the error."""
    boxes = Moved(4, loose=True).a
    rotations = boxes.rotations
    ratios = []
    for i in range(0, len(rotations) - 1, 2):
        centers, corner = RNG.normal(size=(2, 3)), RNG.normal(size=3)
        first, second = (place_at(centers, rotations[i : i + 2], k) for k in (0, 1))
        pose = relative_pose(first, second, float(np.linalg.norm(corner)))
        found = moved(pose, vector(corner))
        columns = [exact(column) for column in rotations[i].T]
        (place,) = placed(corner[None], centers[1], rotations[i + 1])
        place = minus(place, exact(centers[0]))
        error = max(map(abs, minus(exact(found), solved(columns, place))))
        ratios.append(error / (Fraction(POINT_BOUND) * Fraction(pose.size)))
    check_ratios(ratios)


def test_distances_of_meshes() -> None:
    """Of points: their distance has no error but that of the pose and its own rounding."""
    rotations = Moved(4, loose=True).a.rotations
    ratios = []
    for i in range(0, len(rotations) - 1, 2):
        centers, corners = RNG.normal(size=(2, 3)), RNG.normal(size=(2, 3))
        trees = MeshTrees.join([MeshTrees.build([c] * 3, TRIANGLE) for c in corners])
        # as stored: rotations that are loose are made orthonormal on the way in
        bodies = [
            PlacedMeshes.trusted(trees, np.array([k]), centers[[k]], rotations[[i + k]])
            for k in (0, 1)
        ]
        found = oc.clearances(bodies[0], bodies[1])
        places = [placed(corners[[k]], centers[k], rotations[i + k])[0] for k in (0, 1)]
        true = norm(minus(*places))
        size = Fraction(taxicab(minus(*map(exact, centers)))) + sum(map(Fraction, trees.radii))
        bound = Fraction(DISTANCE_BOUND) * size
        error = abs(Fraction(found.distances[0]) + bound - true)
        ratios.append(max(error, abs(Fraction(found.upper[0]) - bound - true)) / bound)
    check_ratios(ratios)


def test_determinants() -> None:
    """Three vectors: one leaves the plane of the others until the sign is certain."""
    vectors = RNG.normal(size=(COUNT, 3, 3))
    weights = RNG.normal(size=(COUNT, 2, 1))
    vectors[:, 0] = (weights * vectors[:, 1:]).sum(axis=1)
    normals = np.cross(vectors[:, 1], vectors[:, 2])

    def first(n: int, distance: float) -> Floats:
        return np.asarray(vectors[n, 0] + distance * normals[n])

    def certain(distances: Floats) -> np.ndarray:
        signs = []
        for n, distance in enumerate(distances.tolist()):
            a, b, c = first(n, distance), vectors[n, 1], vectors[n, 2]
            signs.append(sign(tuple(a.tolist()), tuple(b.tolist()), tuple(c.tolist()), 0.0))
        return np.array(signs) > 0

    def quantity(n: int, distance: float) -> Fraction:
        a, b, c = exact(first(n, distance)), exact(vectors[n, 1]), exact(vectors[n, 2])
        sizes = [max(map(abs, v)) for v in (a, b, c)]
        return dot(a, cross(b, c)) / (
            Fraction(DETERMINANT_ROUNDING) * sizes[0] * sizes[1] * sizes[2]
        )

    check_flips(certain, quantity, np.ones(COUNT), np.full(COUNT, -1.0))
    assert determinant_bound(1.0, 1.0, 1.0, 0.0) >= DETERMINANT_ROUNDING


def test_triangles_with_twice_the_digits() -> None:
    """Two triangles of parallel planes, as far apart as the second digits go."""
    triangles = RNG.uniform(-1.0, 1.0, (COUNT, 9))
    triangles[:, 2::3] = 0.0
    rotations = np.concatenate([np.eye(3)[None], Rotation.random(COUNT - 1, RNG).as_matrix()])

    def place(n: int, distance: float) -> Floats:
        return np.asarray(distance * rotations[n, :, 2])

    def apart(distances: Floats) -> np.ndarray:
        centers = np.zeros((2, 3))
        answers = []
        for n, distance in enumerate(distances.tolist()):
            centers[1] = place(n, distance)
            turn = np.stack([rotations[n]] * 2)
            first, second = (place_at(centers, turn, k) for k in (0, 1))
            triangle = triangle_at(triangles, n)
            answers.append(classify_by_axes(triangle, first, triangle, second))
        return np.array(answers) == oc.Verdict.SEPARATE

    def quantity(n: int, distance: float) -> Fraction:
        rows = [exact(row) for row in rotations[n]]
        p = [[dot(row, exact(corner)) for row in rows] for corner in triangles[n].reshape(3, 3)]
        u, v = minus(p[1], p[0]), minus(p[2], p[0])
        axis = cross(u, v)
        gap = abs(dot(axis, exact(place(n, distance)))) / max(map(abs, axis))
        largest = max(np.abs(triangles[n]).max(), 1e-300)
        scale = Fraction(2) ** -int(np.frexp(largest)[1])
        return gap * scale / (16 * Fraction(WIDTH))

    check_flips(apart, quantity, np.full(COUNT, 1e-10))


def nodes_of(boxes: Boxes) -> Floats:
    """Return boxes as nodes of a tree."""
    filler = np.zeros((len(boxes), 1))
    return np.hstack([boxes.centers, boxes.rotations.reshape(-1, 9), boxes.half_extents, filler])


@each("which", ["all axes", "faces, b moved", "faces, a moved"])
def test_boxes_of_trees(which: str) -> None:
    boxes = Moved(6, ("ordinary scene", "edge against edge", "thin plates and rods"), loose=True)
    here = place_at(np.zeros((1, 3)), np.eye(3)[None], 0)
    pose = relative_pose(here, here, 4.0 * float(boxes.farthest.max()))

    def rows(distances: Floats) -> list[Floats]:
        return [nodes_of(side) for side in boxes.at(distances)]

    def apart(distances: Floats) -> np.ndarray:
        a, b = rows(distances)
        if which == "all axes":
            return np.array([node_gap(a, n, b, n, pose) == np.inf for n in range(len(a))])
        if which == "faces, a moved":
            a, b = b, a
        to = pose if which == "faces, b moved" else back_of(pose)
        bound = pose.gap_bound
        gaps = [faces_gap(a, n, moved_node(to, b, n), bound) for n in range(len(a))]
        return np.array(gaps) == np.inf

    def quantity(n: int, distance: float) -> Fraction:
        a, b = (row_of(side, n) for side in boxes.at(np.full(len(boxes.a), distance)))
        gaps = exact_gaps(a, b)
        edges = [g * Fraction(x) for g, x in zip(gaps[6:], edge_lengths(a, b), strict=True)]
        counted = [*gaps[:6], *edges] if which == "all axes" else gaps[:6]
        return max(counted) / Fraction(pose.gap_bound)

    check_flips(apart, quantity, boxes.farthest)


def test_points_outside_boxes_of_trees() -> None:
    moved = Moved(6)
    boxes = moved.a
    nodes = nodes_of(boxes)

    def outside(distances: Floats) -> np.ndarray:
        points = enumerate(map(vector, moved.points(distances)))
        return np.array([outside_box(nodes, n, p, 0.0) for n, p in points])

    def quantity(n: int, distance: float) -> Fraction:
        point = boxes.centers[n] + distance * moved.directions[n]
        offset = minus(exact(point), exact(boxes.centers[n]))
        along = solved([exact(column) for column in boxes.rotations[n].T], offset)
        excess = max(abs(x) - h for x, h in zip(along, exact(boxes.half_extents[n]), strict=True))
        return excess / (Fraction(SLAB_SLACK) * taxicab(offset)) if any(offset) else Fraction(0)

    check_flips(outside, quantity, moved.farthest)


def test_hulls() -> None:
    """Two cubes of one rotation, one beyond a face of the other: the distance is the gap."""
    pool = pool_of([CORNER_SIGNS])
    rotations = Rotation.random(COUNT, RNG).as_matrix()
    first, rows = np.zeros((COUNT, 3)), np.arange(COUNT)
    kind = np.zeros(COUNT, np.int64)
    radius = float(pool.radii[0])

    def centers(distances: Floats) -> Floats:
        return np.stack([d * rotations[n, :, n % 3] for n, d in enumerate(distances.tolist())])

    def apart(distances: Floats) -> np.ndarray:
        a = PlacedHulls(pool, kind, first, rotations)
        b = PlacedHulls(pool, kind, centers(distances), rotations)
        return ~hulls_may_collide(a, b, rows, rows)

    def quantity(n: int, distance: float) -> Fraction:
        place = exact(centers(np.full(COUNT, distance))[n])
        axes = [exact(c) for c in rotations[n].T]
        gap = solved(axes, place)[n % 3] - 2
        return gap / (Fraction(GAP_BOUND) * (taxicab(place) + 2 * Fraction(radius)))

    check_flips(apart, quantity, np.full(COUNT, 4.0))


def test_convex_distances() -> None:
    """The gap along the normal returned, exactly, and the lower bound on the distance."""
    a, b = family("far apart", ("hull", "box"), COUNT, 0)
    found = distances_of(a, b)
    ratios = []
    for n in range(COUNT):
        sides = [placed(corners_of(x, n), x.centers[n], x.rotations[n]) for x in (a, b)]
        normal = exact(found.normals[n])
        length = norm(normal)
        ends = [[dot(normal, list(corner)) for corner in side] for side in sides]
        gap = (min(ends[1]) - max(ends[0])) / length
        size = taxicab(minus(exact(b.centers[n]), exact(a.centers[n])))
        size += Fraction(float(a.hulls.radii[a.rows[n]] + b.sizes[n].sum()))
        slack = Fraction(CONVEX_ROUNDING) * size
        ratios.append(abs(gap - slack - Fraction(float(found.lower[n]))) / slack)
    check_ratios(ratios)


def test_boxes_of_leaves() -> None:
    ratios = []
    for name in ("torus0", "box1", "crumbs1"):
        vertices, faces = ZOO[name]
        tree = MeshTrees.build(vertices + 100.0, faces)
        for node in np.flatnonzero(tree.children < 0)[:20]:
            row, corners = tree.nodes[node], tree.triangles[tree.starts[node, 0]].reshape(3, 3)
            columns = [exact(column) for column in row[3:12].reshape(3, 3).T]
            along = [solved(columns, minus(exact(c), exact(row[:3]))) for c in corners]
            steps = [taxicab(minus(exact(c), exact(corners[0]))) for c in corners]
            slack = Fraction(WIDENING) * (max(steps) + max(map(abs, exact(row[:3]))))
            for k in range(3):
                reach = max(abs(place[k]) for place in along)
                ratios.append(abs(Fraction(row[12 + k]) - reach - slack) / slack)
    check_ratios(ratios)


def test_boxes_of_points() -> None:
    """Faces with too many points to settle each exactly: moved out by the rounding bound."""
    ratios = []
    for rotation in Rotation.random(8, RNG).as_matrix():
        sides = np.where(RNG.random((2000, 3)) < 0.3, 1.0, RNG.uniform(-1.0, 1.0, (2000, 3)))
        sides = np.concatenate([sides, -sides]) * [0.5, 0.8, 1.1]
        points = sides @ rotation.T
        center, half = enclose_points(points, rotation)
        columns, middle = [exact(column) for column in rotation.T], exact(center)
        near = np.abs((points - center) @ rotation)
        size = np.abs(rotation).T @ np.abs(points - center).max(axis=0)
        skew = [[abs(dot(u, v) - (u is v)) for v in columns] for u in columns]
        for k in range(3):
            doubtful = points[near[:, k] >= near[:, k].max() - 1e-14][:60]
            reach = max(abs(solved(columns, minus(exact(p), middle))[k]) for p in doubtful)
            bound = Fraction(COORDINATE_BOUND) * Fraction(size[k])
            bound += dot(skew[k], exact(near.max(axis=0)))
            ratios.append(abs(Fraction(half[k]) - reach - bound) / bound)
    check_ratios(ratios)
    assert norm(exact(half)) > 1
