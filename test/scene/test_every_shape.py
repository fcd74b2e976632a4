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

"""Every shape through every level and every effect, and drawn: a new one is tried by its name."""

from __future__ import annotations

import warnings

import numpy as np
from each import each
from mesh_zoo import zoo

import obb_collision as oc
from obb_collision.demo.snapshot import triangles_of
from obb_collision.scene.effects import EFFECTS
from obb_collision.shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Hull, Mesh, Shape, Sphere

TORUS = Mesh(*zoo()["torus1"])
SHAPES: dict[str, Shape] = {
    "Box": Box([0.4, 0.6, 0.8]),
    "Sphere": Sphere(0.4),
    "Ellipsoid": Ellipsoid([0.3, 0.4, 0.5], [1.0, 1.0, 0.5]),
    "Cylinder": Cylinder(0.3, 0.8),
    "Cone": Cone(0.4, 0.8),
    "Capsule": Capsule(0.2, 0.6),
    "Hull": Hull(zoo()["hull1"][0], [0.5, 0.5, 0.5]),
    "Mesh": Mesh(*zoo()["sphere1"], scale=[0.5, 0.5, 0.5]),
}


def test_no_shape_is_left_out() -> None:
    assert set(SHAPES) == set(oc.shapes.__all__) - {"Shape"}


@each("name", SHAPES)
@each("accuracy", oc.Accuracy)
def test_a_shape_has_every_effect_at_every_level(name: str, accuracy: oc.Accuracy) -> None:
    scene = oc.Scene(accuracy=accuracy)
    scene.obstacle_points = np.zeros((1, 3))
    scene.set_effect("clearance", max_distance=10.0)
    scene.add("one", SHAPES[name])
    for other, shape in (("box", Box([0.5, 0.5, 0.5])), ("same", SHAPES[name]), ("torus", TORUS)):
        scene.add(other, shape, [0.05, 0.1, 0.02, 0.0, 0.0, 0.6, 0.8])
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            near = scene.check(EFFECTS)
            assert ("one", other) in near.names() or other == "torus"
            scene.move(other, [5.0, 0.0, 0.0, 0.0, 0.0, 0.6, 0.8])
            scene.set_twist(other, [-10.0, 0.0, 0.0, 0.0, 0.0, 0.0])
            far = scene.check(EFFECTS)
        assert far.names() == []
        for report in (near, far):
            assert set(report.costs) >= set(EFFECTS)
            assert not any(cost.failures for cost in report.costs.values())
        assert len(far.clearances.pairs) == 1
        assert 3.0 < far.clearances.distances[0] < 5.0
        scene.remove(other)


@each("name", SHAPES)
def test_a_shape_is_drawn_within_its_box(name: str) -> None:
    drawn = triangles_of(SHAPES[name])
    center, rotation, half_extents = SHAPES[name].local_box
    corners = (drawn.vertices * drawn.scale - center) @ rotation
    assert (np.abs(corners) <= half_extents * (1.0 + 1e-9)).all()
    assert (np.abs(corners).max(axis=0) > 0.9 * half_extents).all()
