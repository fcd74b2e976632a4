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

"""Meshes collide where python-fcl and coal say so."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mesh_zoo import zoo
from numpy.typing import NDArray
from placed_meshes import NAMES, PAIRS, bodies_of, collisions

from obb_collision import MeshTrees, PlacedMeshes
from obb_collision.geometry.trees.obb_tree import BOX_CORNERS

ZOO = zoo()


@pytest.mark.parametrize("peer", ["fcl", "coal"])
def test_surfaces_agree_with_peers(peer: str) -> None:
    """On every pair but those where a nudge of 1e-9 m changes our own verdict."""
    module = pytest.importorskip(peer)
    surfaces = MeshTrees.join([MeshTrees.build(*ZOO[name], solid=False) for name in NAMES])
    a, b = bodies_of(surfaces, PAIRS, 0.5, 4)
    ours = collisions(a, b)
    theirs = (fcl_hits if peer == "fcl" else coal_hits)(module, a, b)
    for row in np.flatnonzero(ours != theirs).tolist():
        assert near_touching(a, b, row, 1e-9), f"pair {row}: ours {ours[row]}"
    assert 0.1 < ours.mean() < 0.9


def fcl_hits(fcl: Any, a: PlacedMeshes, b: PlacedMeshes) -> NDArray[np.bool_]:
    models = []
    for name in NAMES:
        model = fcl.BVHModel()
        model.beginModel(len(ZOO[name][0]), len(ZOO[name][1]))
        model.addSubModel(*ZOO[name])
        model.endModel()
        models.append(model)
    hits = np.empty(len(a), np.bool_)
    for n in range(len(a)):
        objects = [
            fcl.CollisionObject(
                models[side.meshes[n]], fcl.Transform(side.rotations[n], side.centers[n])
            )
            for side in (a, b)
        ]
        hits[n] = fcl.collide(*objects, fcl.CollisionRequest(), fcl.CollisionResult()) > 0
    return hits


def coal_hits(coal: Any, a: PlacedMeshes, b: PlacedMeshes) -> NDArray[np.bool_]:
    models = []
    for name in NAMES:
        model = coal.BVHModelOBBRSS()
        model.beginModel(len(ZOO[name][1]), len(ZOO[name][0]))
        model.addVertices(ZOO[name][0])
        model.addTriangles(ZOO[name][1])
        model.endModel()
        models.append(model)
    hits = np.empty(len(a), np.bool_)
    for n in range(len(a)):
        sides = [
            part
            for side in (a, b)
            for part in (
                models[side.meshes[n]], coal.Transform3s(side.rotations[n], side.centers[n])
            )
        ]  # fmt: skip
        hits[n] = coal.collide(*sides, coal.CollisionRequest(), coal.CollisionResult()) > 0
    return hits


def near_touching(a: PlacedMeshes, b: PlacedMeshes, n: int, distance: float) -> bool:
    nudges = distance * np.concatenate([np.eye(3), -np.eye(3), BOX_CORNERS])
    rows = np.full(len(nudges), n)
    moved = PlacedMeshes(b.trees, b.meshes[rows], b.centers[rows] + nudges, b.rotations[rows])
    return (
        len(set(collisions(a, moved, np.stack([rows, np.arange(len(nudges))], axis=1)).tolist()))
        == 2
    )
