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

"""The effect ``clearance`` at mesh: distances of triangles, and what stands beside them."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from mesh_zoo import zoo
from scipy.spatial.transform import Rotation

import obb_collision as oc
from obb_collision.accuracy import Accuracy
from obb_collision.shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Hull, Mesh, Sphere

NAMES = ["star1", "bumpy1", "torus1", "open_sphere1", "sheet1", "crumbs0"]


def mixed_scene(accuracy: str) -> oc.Scene:
    """Return meshes among boxes, round shapes and hulls."""
    rng = np.random.default_rng(61)
    scene = oc.Scene(accuracy=accuracy)
    scene.set_effect("clearance", max_distance=10.0)
    others: list[oc.shapes.Shape] = [
        Box([0.3, 0.4, 0.5]),
        Sphere(0.2),
        Capsule(0.15, 0.4),
        Cone(0.2, 0.4),
    ]
    others += [Hull(zoo()["hull1"][0]), Sphere(0.1)]
    for number, (name, other) in enumerate(zip(NAMES, others, strict=True)):
        for shape in (Mesh(*zoo()[name]), other):
            turn = Rotation.random(1, rng).as_quat()[0]
            kind = type(shape).__name__
            scene.add(f"{number}/{kind}", shape, [*rng.uniform(-1.0, 1.0, 3), *turn])
    return scene


def distances(report: oc.Report) -> dict[tuple[int, int], float]:
    found = report.clearances
    return {(i, j): d for (i, j), d in zip(found.pairs.tolist(), found.distances, strict=True)}


def test_a_coarser_level_is_never_farther() -> None:
    found = [distances(mixed_scene(level).check("clearance")) for level in ("obb", "hull", "mesh")]
    assert len(found[0]) == 66
    for coarse, fine in (found[:2], found[1:]):
        assert set(coarse) == set(fine)
        assert all(coarse[pair] <= fine[pair] + 1e-9 for pair in coarse)
    assert sum(found[2][pair] > found[1][pair] + 0.01 for pair in found[2]) > 10


def test_positive_exactly_where_nothing_collides_and_points_as_far_apart() -> None:
    scene = mixed_scene("mesh")
    report = scene.check("clearance")
    found = report.clearances
    colliding = {tuple(pair) for pair in report.pairs.tolist()}
    assert 3 < len(colliding) < 60
    kinds = [scene.name(n).partition("/")[2] for n in range(12)]
    for (i, j), distance, a, b, normal in zip(
        *(found.pairs.tolist(), found.distances, found.positions_a, found.positions_b),
        found.normals,
        strict=True,
    ):
        if "Mesh" not in (kinds[i], kinds[j]):
            continue
        assert (distance > 0.0) == ((i, j) not in colliding)
        assert np.linalg.norm(b - a) == pytest.approx(distance, abs=1e-9)
        if distance > 0.0:
            # for curved shapes one that is off by the root of 1e-10 proves as much
            angle = 1e-4 if "Cone" in (kinds[i], kinds[j]) else 1e-6
            np.testing.assert_allclose(normal, (b - a) / np.linalg.norm(b - a), atol=angle)


def test_spheres_and_capsules_are_exact() -> None:
    vertices, faces = zoo()["fine_box0"]
    half = np.abs(vertices).max(axis=0)
    scene = oc.Scene(accuracy="mesh")
    scene.set_effect("clearance", max_distance=10.0)
    scene.add("ball", Sphere(0.25), [0, 0, 2, 0, 0, 0, 1])
    scene.add("mesh", Mesh(vertices, faces))
    scene.add("rod", Capsule(0.5, 1.0), [3, 0, 0, 0, 0, 0, 1])
    found = distances(scene.check("clearance"))
    assert found[0, 1] == pytest.approx(1.75 - half[2], abs=1e-10)
    assert found[1, 2] == pytest.approx(2.5 - half[0], abs=1e-10)


@each("padding", [0.0, 0.02])
def test_cylinders_cones_and_ellipsoids_are_exact(padding: float) -> None:
    """Tilted, above a face by what each reaches; the meshes around them reach farther."""
    vertices, faces = zoo()["fine_box0"]
    top = np.abs(vertices).max(axis=0)[2]
    turn = Rotation.from_euler("y", 0.5)
    up = turn.inv().apply([0.0, 0.0, -1.0])  # as each sees what is below
    wide = np.hypot(up[0], up[1])
    reaches = {
        Cylinder(0.2, 0.4): 0.2 * wide + 0.2 * abs(up[2]),
        Cone(0.2, 0.4): 0.2 * wide - 0.2 * up[2],
        Ellipsoid((0.1, 0.2, 0.3)): np.linalg.norm([0.1 * up[0], 0.2 * up[1], 0.3 * up[2]]),
    }
    for shape, reach in reaches.items():
        for gap in (0.1, 1e-4, 1e-8, -1e-8, -0.01):
            scene = oc.Scene(accuracy="mesh", padding=padding)
            scene.set_effect("clearance", max_distance=10.0)
            scene.add("mesh", Mesh(vertices, faces))
            height = top + reach + 2.0 * padding + gap
            scene.add("round", shape, [0.01, 0.02, height, *turn.as_quat()])
            report = scene.check()
            assert len(report) == (gap < 0.0)
            assert report.clearances.distances == pytest.approx([max(gap, 0.0)], abs=2e-9)


def test_its_own_accuracy_whatever_decides_the_pairs() -> None:
    scene = mixed_scene("obb")
    scene.set_effect("clearance", max_distance=10.0, accuracy="mesh")
    assert distances(scene.check("clearance")) == distances(mixed_scene("mesh").check("clearance"))


def test_read_later_they_are_those_of_the_check() -> None:
    scene = mixed_scene("mesh")
    report = scene.check()
    asked = distances(mixed_scene("mesh").check("clearance"))
    scene.move("0/Mesh", [5, 5, 5, 0, 0, 0, 1])
    read = distances(report)
    assert set(read) == set(asked)
    assert all(read[pair] <= asked[pair] + 1e-9 for pair in asked)
    assert report.clearances is not None
    assert Accuracy.MESH in report.accuracies
