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

"""The effect ``points`` on shapes: in them, in order of the levels, and nothing where it is off."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from mesh_zoo import zoo
from numpy.typing import NDArray

import obb_collision as oc
from obb_collision.accuracy import Accuracy
from obb_collision.geometry.poses import as_poses
from obb_collision.scene.refinement.placed_shapes import PlacedShapes

LEVELS = ("obb", "hull", "mesh")


def mixed(padding: float = 0.0, accuracy: str = "obb") -> oc.Scene:
    """Return shapes of all kinds, turned."""
    vertices, faces = zoo()["torus0"]
    hull, open_one = zoo()["hull1"], zoo()["open_sphere1"]
    shapes: list[oc.shapes.Shape] = [
        oc.shapes.Box([0.8, 0.6, 1.0]), oc.shapes.Sphere(0.5), oc.shapes.Capsule(0.3, 0.8),
        oc.shapes.Cylinder(0.4, 1.0), oc.shapes.Cone(0.5, 1.0),
        oc.shapes.Ellipsoid([0.3, 0.5, 0.6]),
        oc.shapes.Cylinder(0.4, 0.6, scale=[1.0, 2.0, 0.5]), oc.shapes.Sphere(0.4, scale=[1, 1, 2]),
        oc.shapes.Hull(hull[0]), oc.shapes.Mesh(vertices, faces), oc.shapes.Mesh(*open_one),
    ]  # fmt: skip
    rng = np.random.default_rng(11)
    scene = oc.Scene(accuracy=accuracy, padding=padding)
    for number, shape in enumerate(shapes):
        turn = rng.normal(size=4)
        scene.add(str(number), shape, [*rng.uniform(-1, 1, 3), *(turn / np.linalg.norm(turn))])
    scene.obstacle_points = rng.uniform(-2, 2, (20_000, 3))
    return scene


def counts(scene: oc.Scene, accuracy: str, margin: float = 0.0) -> NDArray[np.int64]:
    scene.set_effect("points", accuracy=accuracy, margin=margin)
    found = scene.check(effects=["points"]).points_inside
    assert found.indices.tolist() == scene.indices.tolist()
    return found.counts


@each("padding", [0.0, 0.1])
@each("margin", [0.0, 0.2])
def test_a_finer_level_never_has_more_points(padding: float, margin: float) -> None:
    scene = mixed(padding)
    boxes, hulls, meshes = (counts(scene, level, margin) for level in LEVELS)
    assert (boxes >= hulls).all()
    assert (hulls >= meshes).all()
    assert boxes[0] == hulls[0] == meshes[0] > 0
    assert (boxes > hulls)[1:8].all()
    assert (hulls[:9] == meshes[:9]).all()
    assert (hulls > meshes)[9:].all()
    assert (meshes[:10] > 0).all()


def test_points_are_in_round_shapes_by_their_formulas() -> None:
    scene = mixed()
    cloud = scene.obstacle_points
    assert cloud is not None
    found = counts(scene, "mesh")
    centers, rotations = as_poses(scene.poses_of(scene.indices))
    p = np.einsum("nij,pni->npj", rotations, cloud[:, None] - centers)
    x, y, z = np.moveaxis(p, 2, 0)
    width, along = np.hypot(x, y), np.abs(z)
    truth = {
        1: np.linalg.norm(p[1], axis=1) <= 0.5,
        2: np.hypot(width[2], (along[2] - 0.4).clip(0.0)) <= 0.3,
        3: (width[3] <= 0.4) & (along[3] <= 0.5),
        4: (along[4] <= 0.5) & (width[4] <= 0.5 * (0.5 - z[4])),
        5: np.linalg.norm(p[5] / [0.3, 0.5, 0.6], axis=1) <= 1.0,
        6: (np.hypot(x[6], 0.5 * y[6]) <= 0.4) & (along[6] <= 0.15),
        7: np.linalg.norm(p[7] / [0.4, 0.4, 0.8], axis=1) <= 1.0,
    }
    for row, inside in truth.items():
        assert found[row] == inside.sum() > 0


def test_each_object_has_its_own_accuracy_and_the_report_says_which() -> None:
    scene = mixed()
    scene.accuracy = "hull"
    scene.set_accuracy("9", "mesh")
    scene.set_accuracy("3", "obb")
    report = scene.check(effects=["points"])
    own = report.points_inside.counts.tolist()
    boxes, hulls, meshes = (counts(scene, level) for level in LEVELS)
    expected = hulls.tolist()
    expected[9], expected[3] = meshes[9], boxes[3]
    assert own == expected
    levels = report.accuracies_of("points")
    assert levels[[0, 1, 3, 9]].tolist() == [
        Accuracy.OBB,
        Accuracy.HULL,
        Accuracy.OBB,
        Accuracy.MESH,
    ]


def test_shapes_are_those_of_the_check_also_later() -> None:
    scene, other = mixed(accuracy="mesh"), mixed(accuracy="mesh")
    report = scene.check()
    for name in scene.names:
        scene.move(name, [50, 0, 0, 0, 0, 0, 1])
    assert report.points_inside.counts.tolist() == counts(other, "pairs").tolist()


def test_at_obb_no_shape_is_placed(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = mixed()

    def refuse(*args: object) -> None:
        raise AssertionError

    monkeypatch.setattr(PlacedShapes, "__init__", refuse)
    scene.set_effect("points", "on")
    assert scene.check().points_inside.counts.sum() > 0
