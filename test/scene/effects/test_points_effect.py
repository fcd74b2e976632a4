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

"""The effect ``points``: clouds in boxes and shapes, in order of the levels."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from each import each
from mesh_zoo import zoo
from numpy.typing import NDArray
from scenes import filled_scene
from scipy.spatial.transform import Rotation

import obb_collision as oc
from obb_collision.scene.effects import points
from obb_collision.shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Hull, Mesh, Shape, Sphere

LEVELS = ("obb", "hull", "mesh")


def test_every_object_knows_its_points() -> None:
    scene = filled_scene(20)
    cloud = np.random.default_rng(3).uniform(-2, 2, (3000, 3)).astype(np.float32)
    cloud[7] = np.nan
    scene.obstacle_points = cloud
    found = scene.check().points_inside
    assert found.indices.tolist() == scene.indices.tolist()
    assert found.ignored == 1
    for row, name in enumerate(scene.names):
        held = np.flatnonzero(scene.obb(name).contains(np.nan_to_num(cloud, nan=1e6)))
        assert found.counts[row] == len(held)
        assert found.first[row] == (held[0] if len(held) else -1)
    assert found.counts.sum() > 100


def test_margin_callers_and_disabled_objects() -> None:
    scene = oc.Scene()
    for name, x in (("zone/1", 0.0), ("zone/2", 5.0), ("other/1", 0.0)):
        scene.add(name, Box([1, 1, 1]), [x, 0, 0, 0, 0, 0, 1])
    scene.obstacle_points = [[0.75, 0.0, 0.0], [5.0, 0.0, 0.0]]
    scene.set_effect("points", objects="zone/*", margin=0.25)
    found = scene.check().points_inside
    assert found.indices.tolist() == found.nearest.tolist() == [0, 1]
    assert found.counts.tolist() == [1, 1]
    scene.set_enabled("zone/2", False)
    assert scene.check().points_inside.indices.tolist() == [0]


def test_a_new_cloud_is_looked_at_and_none_costs_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[int] = []
    query = vars(points)["points_in_bodies"]

    def counted(boxes: Any, bodies: Any, cloud: Any, *rest: Any) -> Any:
        calls.append(len(cloud))
        assert bodies is None, "no shape is placed at obb"
        return query(boxes, bodies, cloud, *rest)

    monkeypatch.setattr(points, "points_in_bodies", counted)
    scene = oc.Scene()
    scene.add("zone", Sphere(0.5))
    scene.set_effect("points", "on")
    assert scene.check().points_inside.counts.tolist() == [0]
    for count in (0, 4, 2):
        scene.obstacle_points = np.zeros((count, 3))
        assert scene.check().points_inside.counts.tolist() == [count]
    assert calls == [4, 2]
    wrong: Any
    for wrong in (np.zeros((3, 2)), ["x"]):
        with pytest.raises(ValueError, match="points must"):
            scene.obstacle_points = wrong


def mixed(padding: float = 0.0, accuracy: str = "obb") -> oc.Scene:
    """Return shapes of all kinds, turned."""
    shapes: list[Shape] = [
        *(Box([0.8, 0.6, 1.0]), Sphere(0.5), Capsule(0.3, 0.8), Cylinder(0.4, 1.0)),
        *(Cone(0.5, 1.0), Ellipsoid([0.3, 0.5, 0.6])),
        *(Cylinder(0.4, 0.6, scale=[1.0, 2.0, 0.5]), Sphere(0.4, scale=[1, 1, 2])),
        *(Hull(zoo()["hull1"][0]), Mesh(*zoo()["torus0"]), Mesh(*zoo()["open_sphere1"])),
    ]
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


@each("padding, margin", [(0.0, 0.0), (0.0, 0.2), (0.1, 0.0), (0.1, 0.2)])
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
    cloud, poses = scene.obstacle_points, scene.objects.poses_of(scene.indices)
    assert cloud is not None
    found = counts(scene, "mesh")
    turns = Rotation.from_quat(poses[:, 3:]).as_matrix()
    p = np.einsum("nij,pni->npj", turns, cloud[:, None] - poses[:, :3])
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
    own = report.points_inside.counts
    boxes, hulls, meshes = (counts(scene, level) for level in LEVELS)
    expected = hulls.copy()
    expected[9], expected[3] = meshes[9], boxes[3]
    assert own.tolist() == expected.tolist()
    levels = [oc.Accuracy(k).name for k in report.accuracies_of("points")[[0, 1, 3, 9]]]
    assert levels == ["OBB", "HULL", "OBB", "MESH"]
