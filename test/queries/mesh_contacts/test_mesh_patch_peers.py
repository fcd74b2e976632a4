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

"""Contacts of meshes are where python-fcl and coal see them.

Both peers give a contact for every pair of triangles that touch, with a depth of these two alone;
``contacts`` has up to eight points for the pair of meshes, with a depth that parts them. So
what can agree is whether they collide, which triangles touch, and that the points lie in these.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any, TypeAlias

import numpy as np
import pytest
from mesh_zoo import zoo
from placed_meshes import bodies_of, exact_corners
from triangle_distances import squared_distance_of_point

import obb_collision as oc
from obb_collision import MeshTrees, PlacedMeshes
from obb_collision.queries.verdict.verdict import OVERLAP

NAMES = ["torus1", "star1", "bumpy1", "open_sphere1", "sheet2", "cone1"]
TREES = MeshTrees.join([MeshTrees.build(*zoo()[name], solid=False) for name in NAMES])
#: How far a point may be from either triangle, metres: sizes are about one.
ON_SURFACE = Fraction(1, 10**12)
MOST = 100_000
FacePairs: TypeAlias = "set[tuple[int, int]]"


def faces_of_fcl(fcl: Any, a: PlacedMeshes, b: PlacedMeshes, n: int) -> FacePairs:
    """Return which faces fcl finds in contact."""
    sides = []
    for bodies in (a, b):
        vertices, faces = zoo()[NAMES[bodies.meshes[n]]]
        model = fcl.BVHModel()
        model.beginModel(len(vertices), len(faces))
        model.addSubModel(vertices, faces)
        model.endModel()
        place = fcl.Transform(bodies.rotations[n], bodies.centers[n])
        sides.append(fcl.CollisionObject(model, place))
    result = fcl.CollisionResult()
    fcl.collide(*sides, fcl.CollisionRequest(num_max_contacts=MOST, enable_contact=True), result)
    return {(contact.b1, contact.b2) for contact in result.contacts}


def faces_of_coal(coal: Any, a: PlacedMeshes, b: PlacedMeshes, n: int) -> FacePairs:
    """Return which faces coal finds in contact."""
    sides = []
    for bodies in (a, b):
        vertices, faces = zoo()[NAMES[bodies.meshes[n]]]
        model = coal.BVHModelOBBRSS()
        model.beginModel(len(faces), len(vertices))
        model.addVertices(vertices)
        model.addTriangles(faces)
        model.endModel()
        sides += [model, coal.Transform3s(bodies.rotations[n], bodies.centers[n])]
    request, result = coal.CollisionRequest(), coal.CollisionResult()
    request.num_max_contacts, request.enable_contact = MOST, True
    coal.collide(*sides, request, result)
    return {(contact.b1, contact.b2) for contact in result.getContacts()}


@pytest.mark.parametrize(("peer", "faces_of"), [("fcl", faces_of_fcl), ("coal", faces_of_coal)])
def test_contacts_are_those_of_peers(peer: str, faces_of: Any) -> None:
    """Each pair of triangles that certainly pierce each other, and none that are apart."""
    module = pytest.importorskip(peer)
    a, b = bodies_of(TREES, 60, 0.3, 17)
    met, found = oc.triangle_pairs(a, b), oc.contacts(a, b, max_points=8)
    seen = 0
    for n in range(len(a)):
        own = met.pairs == n
        every = set(map(tuple, met.faces[own].tolist()))
        certain = set(map(tuple, met.faces[own & (met.verdicts == OVERLAP)].tolist()))
        theirs = faces_of(module, a, b, n)
        assert certain <= theirs <= every
        assert (found.counts[n] > 0) == bool(theirs)
        seen += len(theirs)
        if n < 12:
            for point in found.positions[n, : found.counts[n]]:
                assert in_a_pair(point.tolist(), theirs, a, b, n)
    assert seen > 1000


def in_a_pair(
    point: list[float], faces: FacePairs, a: PlacedMeshes, b: PlacedMeshes, n: int
) -> bool:
    """Return whether a point is in both triangles of a pair of faces: where these cross."""
    first, second = (faces_at(point, bodies, n) for bodies in (a, b))
    return any(s in first and t in second for s, t in faces)


def faces_at(point: list[float], bodies: PlacedMeshes, n: int) -> set[int]:
    """Return the faces that a point is in; those whose bounds it is in are looked at exactly."""
    trees, turn, center = bodies.trees, bodies.rotations[n], bodies.centers[n]
    first, last = trees.starts[trees.roots[bodies.meshes[n]]].tolist()
    corners = trees.triangles[first:last].reshape(-1, 3, 3) @ turn.T + center
    near = (corners.min(axis=1) <= np.array(point) + 1e-9).all(axis=1)
    near &= (corners.max(axis=1) >= np.array(point) - 1e-9).all(axis=1)
    rows = np.flatnonzero(near)
    some = MeshTrees.join(
        [MeshTrees.build(t.reshape(3, 3), [[0, 1, 2]]) for t in trees.triangles[first + rows]]
    )
    count = len(rows)
    placed = PlacedMeshes(
        some, range(count), np.tile(center, (count, 1)), np.tile(turn, (count, 1, 1))
    )
    p = [Fraction(x) for x in point]
    return {
        int(trees.faces[first + row])
        for k, row in enumerate(rows)
        if squared_distance_of_point(p, exact_corners(placed, k)[0]) <= ON_SURFACE**2
    }
