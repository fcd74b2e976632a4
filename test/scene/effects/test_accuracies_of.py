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

"""``Report.accuracies_of``: what each row of an effect was computed on."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from mesh_zoo import zoo

import obb_collision as oc
from obb_collision.accuracy import Accuracy
from obb_collision.shapes import Box, Mesh, Sphere

OBB, HULL, MESH = Accuracy.OBB, Accuracy.HULL, Accuracy.MESH


def scene_of(accuracy: str = "mesh") -> oc.Scene:
    """Return a ring that overlaps a ball, a box beside them, and a ball that comes near."""
    scene = oc.Scene(accuracy=accuracy)
    scene.set_effect("clearance", max_distance=100.0)
    scene.set_effect("sweep", horizon=10.0)
    vertices, faces = zoo()["torus1"]
    scene.add("ring", Mesh(vertices, faces))
    scene.add("ball", Sphere(0.1), [*vertices[0], 0, 0, 0, 1])
    scene.add("crate", Box([1.0, 1.0, 1.0]), [20.0, 0, 0, 0, 0, 0, 1])
    scene.add("bullet", Sphere(0.3), [-5.0, 0, 0, 0, 0, 0, 1])
    scene.set_twist("bullet", [2.0, 0, 0, 0, 0, 0])
    scene.obstacle_points = np.zeros((1, 3))
    return scene


def test_each_row_has_its_own() -> None:
    scene = scene_of()
    scene.set_accuracy("crate", "obb")
    report = scene.check("sweep")
    found = report.accuracies_of("clearance")
    levels = dict(zip(map(tuple, report.clearances.pairs.tolist()), found.tolist(), strict=True))
    assert levels == {
        (0, 1): MESH, (0, 2): OBB, (0, 3): MESH, (1, 2): OBB, (1, 3): HULL, (2, 3): OBB
    }  # fmt: skip
    for effect in ("separations", "contacts"):
        assert report.accuracies_of(effect).tolist() == report.accuracies.tolist() == [MESH]
    predicted = report.swept.predicted.pairs.tolist()
    assert report.accuracies_of("sweep").tolist() == [
        {(0, 3): MESH, (1, 3): HULL, (2, 3): OBB}[i, j] for i, j in predicted
    ]
    assert [0, 3] in predicted
    assert report.accuracies_of("points").tolist() == [MESH, HULL, OBB, HULL]
    assert not found.flags.writeable


@each("accuracy", ["aabb", "obb"])
def test_boxes_are_obb(accuracy: str) -> None:
    report = scene_of(accuracy).check("sweep")
    for effect in ("separations", "contacts", "clearance", "points"):
        rows = len(next(iter(vars(report.result(effect)).values())))
        assert report.accuracies_of(effect).tolist() == [OBB] * rows
        assert rows
    swept = report.swept
    rows = len(swept.passed.pairs) + len(swept.predicted.pairs)
    assert report.accuracies_of("sweep").tolist() == [OBB] * rows


def test_unknown_effects_and_those_that_are_off_are_refused() -> None:
    scene = scene_of()
    scene.set_effect("contacts", "off")
    report = scene.check()
    for effect in ("nothing", "contacts", "sweep"):
        with pytest.raises(ValueError, match="effect"):
            report.accuracies_of(effect)
