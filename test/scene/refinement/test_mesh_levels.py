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

"""Every level on every mesh: none misses what a more exact one reports; odd, huge and tiny ones."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from each import each
from mesh_zoo import zoo
from numpy.typing import NDArray
from scenes import random_poses
from trimesh import creation

import obb_collision as oc
from obb_collision.geometry.trees import hull_tree, mesh_tree
from obb_collision.shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Hull, Mesh, Shape, Sphere

ZOO = zoo()
LEVELS = ("sphere", "aabb", "obb", "hull", "mesh")
#: Pairs of meshes for each pair of boxes of ``--pairs``: 1,800 by default.
TIMES = 2


@cache
def all_meshes() -> tuple[list[Mesh], oc.MeshTrees]:
    """Return meshes, large ones and small ones, and their trees."""
    meshes = [Mesh(vertices * s, faces) for s in (1.0, 0.15) for vertices, faces in ZOO.values()]
    trees = [oc.MeshTrees.build(mesh.vertices, mesh.faces) for mesh in meshes]
    return meshes, oc.MeshTrees.join(trees)


@each("spread, seed", [(0.3, 1), (0.6, 2), (1.0, 3)])
def test_no_level_misses_what_a_more_exact_one_reports(
    spread: float, seed: int, pairs: int
) -> None:
    """On 66 meshes, solids within solids included; meshes by themselves, too."""
    assert len(ZOO) >= 60
    meshes, trees = all_meshes()
    count, rng = TIMES * pairs, np.random.default_rng(seed)
    kinds = rng.integers(0, len(meshes), 2 * count)
    poses = random_poses(2 * count, rng, spread)
    side = int(np.ceil(count ** (1 / 3)))
    cells = np.array(np.unravel_index(np.arange(2 * count) // 2, [side] * 3)).T
    poses[:, :3] += 16.0 * cells  # no pair is near another
    scene = oc.Scene()
    for k, kind in enumerate(kinds):
        scene.add(f"{k}", meshes[kind], poses[k])
    reported = {}
    for level in LEVELS:
        scene.accuracy = level
        report = scene.check()
        assert (report.pairs[:, 0] + 1 == report.pairs[:, 1]).all()
        reported[level] = np.zeros(count, np.bool_)
        reported[level][report.pairs[:, 0] // 2] = True
    placed = oc.PlacedMeshes.from_poses(trees, kinds, poses)
    rows = np.arange(2 * count).reshape(-1, 2)
    quick = oc.verdicts(placed, placed, rows, effort=0) != oc.Verdict.SEPARATE
    assert 0.01 < quick.mean() < reported["hull"].mean() < reported["obb"].mean() < 0.99
    assert not (quick & ~reported["hull"]).any()
    verdicts = oc.verdicts(placed, placed, rows)
    found = np.flatnonzero(verdicts != oc.Verdict.SEPARATE)
    assert np.flatnonzero(reported["mesh"]).tolist() == found.tolist()
    assert report.verdicts.tolist() == verdicts[found].tolist()
    for fine, coarse in (("hull", "obb"), ("obb", "aabb"), ("obb", "sphere")):
        assert not (reported[fine] & ~reported[coarse]).any()
    finer = quick
    for depth in (12, 8, 5, 3, 2, 1, 0):
        tree = oc.verdicts(placed, placed, rows, depth=depth) != oc.Verdict.SEPARATE
        assert not (finer & ~tree).any(), depth
        finer = tree
    assert abs(finer.mean() - reported["obb"].mean()) < 0.1  # a tree begins with a box, too


def odd_meshes() -> dict[str, tuple[NDArray[np.float64], NDArray[np.int64]]]:
    """Return what files hold, all of it within a metre of the origin."""
    corners, faces = np.array(creation.box().vertices), np.array(creation.box().faces)
    line = np.array([[0.0, 0, 0], [1, 0, 0], [0.3, 0, 0]])
    rng = np.random.default_rng(2)
    return {
        "one triangle": (corners, faces[:1]),
        "a point thrice": (np.zeros((3, 3)), np.array([[0, 1, 2]])),
        "one vertex": (np.zeros((1, 3)), np.array([[0, 0, 0]])),
        "no area": (line, np.array([[0, 1, 2]] * 5)),
        "every face twice": (corners, np.concatenate([faces, faces])),
        "double-sided": (corners, np.concatenate([faces, faces[:, ::-1]])),
        "a fin": (corners, np.concatenate([faces, [[0, 1, 7]]])),
        "a hole": (corners, faces[1:]),
        "soup": (corners[faces].reshape(-1, 3), np.arange(36).reshape(-1, 3)),
        "flat and not": (corners, np.concatenate([faces, [[0, 0, 1], [2, 2, 2]]])),
        "slivers": (corners + 1e-12 * rng.normal(size=(8, 3)), np.repeat(faces, 20, axis=0)),
        "unused vertices": (np.concatenate([corners, 1e6 + corners]), faces),
        "thin": (corners * [1.0, 1.0, 1e-14], faces),
        "inside out": (corners, faces[:, ::-1]),
    }


@each("name, mesh", odd_meshes().items())
@each("level", LEVELS)
def test_odd_meshes_collide_where_they_are_and_not_where_they_are_not(
    name: str, mesh: tuple[NDArray[np.float64], NDArray[np.int64]], level: str
) -> None:
    odd, scene = Mesh(*mesh), oc.Scene(accuracy=level)
    scene.add(name, odd)
    scene.add("far", Mesh(*ZOO["torus1"]), [0, 0, 4.0, 0, 0, 0, 1])
    scene.add("ball", Mesh(*ZOO["sphere2"]), [5.0, 0, 0, 0, 0, 0, 1])
    assert scene.check().names() == []
    corner = odd.vertices[odd.faces[0]].mean(axis=0)
    scene.move("ball", [*(corner + 0.2), 0, 0, 0, 1])
    assert scene.check().names() == [(name, "ball")]
    scene.move(name, [3.0, 0, 0, 0, 0, 0, 1])
    assert scene.check().names() == []


def test_huge_meshes_are_decided_on_every_level(pairs: int) -> None:
    """20,480 triangles; with ``--pairs`` of 10,000 or more 1.3 million."""
    part = creation.icosphere(subdivisions=8 if pairs >= 10_000 else 5, radius=0.5)
    ball = Mesh(part.vertices, part.faces, fit="aabb")
    for level in LEVELS:
        scene = oc.Scene(accuracy=level)
        scene.add("a", ball)
        scene.add("b", ball, [0.8, 0.1, 0, 0, 0, 0, 1])
        scene.add("cup", Mesh(*ZOO["open_sphere1"]), [0, 0, 3.0, 0, 0, 0, 1])
        assert scene.check().names() == [("a", "b")]
        scene.move("b", [1.2, 0.9, 0.9, 0, 0, 0, 1])
        assert scene.check().names() == []
        scene.move("b", [0.75, 0.75, 0, 0, 0, 0, 1])  # their boxes meet
        assert len(scene.check()) == (level not in ("hull", "mesh"))


TETRAHEDRON = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
#: Shapes that reach just as far as they are given.
SHAPES: dict[str, Callable[[float], Shape]] = {
    "mesh": lambda s: Mesh(TETRAHEDRON * s, FACES),
    "mesh scaled": lambda s: Mesh(TETRAHEDRON, FACES, scale=[s, s, s]),
    "mesh in a corner": lambda s: Mesh((1.0 - 1e-3 * TETRAHEDRON) * s, FACES),
    "triangle": lambda s: Mesh(TETRAHEDRON[:3] * s, FACES[:1]),
    "hull": lambda s: Hull((2.0 * TETRAHEDRON - 1.0) * s),
    "flat hull": lambda s: Hull(TETRAHEDRON[:3] * s),
    "cylinder": lambda s: Cylinder(0.5 * s, s),
    "cone": lambda s: Cone(0.5 * s, s),
    "sphere": lambda s: Sphere(s),
    "sphere stretched": lambda s: Sphere(1.0, scale=[s, 0.5 * s, s]),
    "capsule": lambda s: Capsule(0.5 * s, s),
    "ellipsoid": lambda s: Ellipsoid([0.3 * s, s, 0.5 * s]),
    "box": lambda s: Box([s, s, s]),
}
PARTNERS = ("box", "mesh", "hull", "cylinder")


@cache
def shape(name: str, size: float) -> Shape:
    return SHAPES[name](size)


@cache
def collisions(name: str, size: float, accuracy: str) -> set[tuple[str, str]]:
    """Return the pairs of a shape, and others where it is and in the farthest corner."""
    scene = oc.Scene(accuracy=accuracy)
    scene.add("one", shape(name, size))
    for partner in PARTNERS:
        scene.add(f"same/{partner}", shape(partner, size))
        scene.add(f"far/{partner}", shape(partner, size), [*[1e300] * 3, 0.5, 0.5, 0.5, 0.5])
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # overflows among them
        report = scene.check(effects=["separations", "contacts", "clearance"])
    assert not any(cost.failures for cost in report.costs.values())
    return set(report.names())


@each("accuracy", ["obb", "hull", "mesh"])
@each("size", [1e300, 2.0**996, 2.0**-960, 3e-308])
def test_the_largest_and_smallest_shapes_get_a_verdict(size: float, accuracy: str) -> None:
    for name in SHAPES:
        found = collisions(name, size, accuracy)
        assert ("one", f"same/{name}") in found or name not in PARTNERS
        if size in (2.0**996, 2.0**-960):  # scaled without any rounding: the same pairs
            same, expected = (
                {(a, b) for a, b in pairs if "far" not in a + b}
                for pairs in (found, collisions(name, 1.0, accuracy))
            )
            assert same == expected, name
            assert same, name


def test_vertices_that_no_face_uses_may_be_anywhere() -> None:
    stray = np.concatenate([[[-1e300, 0.0, 1e300]], TETRAHEDRON])
    mesh = Mesh(stray, FACES + 1, scale=[2.0, 2.0, 2.0])  # the stray one ends at 2e300
    scene = oc.Scene(accuracy="mesh")
    scene.add("mesh", mesh)
    scene.add("in it", Box([0.1, 0.1, 0.1]), [0.3, 0.3, 0.3, 0, 0, 0, 1])
    scene.add("beside", Box([0.1, 0.1, 0.1]), [1.5, 1.5, 1.5, 0, 0, 0, 1])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert scene.check().names() == [("mesh", "in it")]
    assert (mesh_tree(mesh).triangles == mesh_tree(Mesh(2 * TETRAHEDRON, FACES)).triangles).all()


def test_a_hull_may_stick_out_past_the_largest_coordinate_of_a_shape() -> None:
    tree = hull_tree(SHAPES["hull"](1e300))
    assert 1e300 < np.abs(tree.triangles).max() < 1.001e300
    with pytest.raises(ValueError, match="1e\\+300"):
        oc.MeshTrees.build(1.001e300 * TETRAHEDRON, FACES)
