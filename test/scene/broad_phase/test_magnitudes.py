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

"""Scenes of the largest and the smallest coordinates that are accepted: a check never raises."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from each import each

import obb_collision as oc
from obb_collision.geometry.trees.pool import hull_tree, mesh_tree
from obb_collision.shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Hull, Mesh, Shape, Sphere

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
