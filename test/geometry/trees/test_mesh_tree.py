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

"""Trees: every box certainly contains its triangles, every triangle is in one leaf."""

from __future__ import annotations

import time

import numpy as np
from each import each
from mesh_zoo import Arrays, zoo
from trimesh import creation

from obb_collision.geometry.trees.obb_tree import BOX_CORNERS, BOX_FACES, LEAF, MeshTrees
from obb_collision.numerics.exact import contains_exactly

ZOO = zoo()


def _moved(arrays: Arrays, scale: float, offset: float) -> Arrays:
    return arrays[0] * scale + offset * scale, arrays[1]


@each("place", [(1.0, 0.0), (1.0, 1e9), (1e-160, 0.0), (1e155, 3.0)])
@each("name", ["box1", "torus0", "crumbs1", "sheet1", "hull2", "triangle"])
def test_every_box_contains_its_triangles_exactly(name: str, place: tuple[float, float]) -> None:
    tree = MeshTrees.build(*_moved(ZOO[name], *place))
    for node, (first, last) in enumerate(tree.starts):
        row = tree.nodes[node]
        corners = tree.triangles[first:last].reshape(-1, 3)
        rotation = row[3:12].reshape(3, 3)
        assert contains_exactly(row[:3], rotation, row[12:15], np.unique(corners, axis=0)).all()
        assert np.abs(rotation.T @ rotation - np.eye(3)).max() < 2.0**-49


@each("name", list(ZOO))
def test_each_triangle_is_in_one_leaf(name: str) -> None:
    vertices, faces = ZOO[name]
    tree = MeshTrees.build(vertices, faces)
    assert sorted(tree.faces.tolist()) == list(range(len(faces)))
    assert (tree.triangles == vertices[faces[tree.faces]].reshape(-1, 9)).all()
    leaves = np.flatnonzero(tree.children < 0)
    runs = tree.starts[leaves]
    assert (runs[:, 1] - runs[:, 0] <= LEAF).all()
    assert sorted(np.concatenate([np.arange(*run) for run in runs])) == list(range(len(faces)))
    inner = np.flatnonzero(tree.children >= 0)
    left, right = tree.children[inner], tree.children[inner] + 1
    assert (tree.starts[left, 0] == tree.starts[inner, 0]).all()
    assert (tree.starts[left, 1] == tree.starts[right, 0]).all()
    assert (tree.starts[right, 1] == tree.starts[inner, 1]).all()


def test_a_depth_gives_at_most_two_to_its_power_boxes_that_get_tighter() -> None:
    tree = MeshTrees.build(*ZOO["torus1"])
    volumes = []
    for depth in range(8):
        boxes = tree.boxes(0, depth)
        assert len(boxes) <= 2**depth
        volumes.append(float(np.prod(2.0 * boxes.half_extents, axis=1).sum()))
    assert len(tree.boxes(0, 3)) == 8
    assert volumes[7] < 0.5 * volumes[0]


def test_trees_joined_are_the_trees_one_by_one() -> None:
    single = [MeshTrees.build(*ZOO[name]) for name in ("box0", "crumbs0", "sheet0")]
    joined = MeshTrees.join([MeshTrees.join(single[:2]), single[2]])
    assert len(joined) == 3
    for k, tree in enumerate(single):
        for depth in (0, 2):
            assert (joined.boxes(k, depth).centers == tree.boxes(0, depth).centers).all()
        first, last = joined.starts[joined.roots[k]]
        assert (joined.triangles[first:last] == tree.triangles).all()
        pieces = joined.pieces[joined.piece_starts[k] : joined.piece_starts[k + 1]]
        assert (pieces == tree.pieces).all()
    assert joined.solid.tolist() == [True, True, False]


def test_box_trees_are_closed_boxes() -> None:
    trees = MeshTrees.from_half_extents([[0.5, 0.25, 0.125], [0.0, 1.0, 1.0]])
    assert len(trees) == 2
    assert trees.solid[0]
    normals = np.cross(
        BOX_CORNERS[BOX_FACES[:, 1]] - BOX_CORNERS[BOX_FACES[:, 0]],
        BOX_CORNERS[BOX_FACES[:, 2]] - BOX_CORNERS[BOX_FACES[:, 0]],
    )
    assert (np.einsum("ij,ij->i", normals, BOX_CORNERS[BOX_FACES[:, 0]]) > 0.0).all()


def test_a_hundred_thousand_triangles_take_seconds() -> None:
    """Measured 0.6 s; a quadratic build would take minutes."""
    mesh = creation.icosphere(subdivisions=7).subdivide()
    faces = np.asarray(mesh.faces)[:100_000]
    MeshTrees.build(np.eye(3), [[0, 1, 2]])
    start = time.process_time()
    tree = MeshTrees.build(mesh.vertices, faces)
    assert time.process_time() - start < 20.0
    assert tree.levels.max() < 40
