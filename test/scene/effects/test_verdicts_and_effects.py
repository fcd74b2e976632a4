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

"""Verdicts at mesh and what effects say of the same pairs: they never contradict each other."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from mesh_zoo import zoo
from scipy.spatial.transform import Rotation

import obb_collision as oc
from obb_collision.accuracy import Accuracy
from obb_collision.queries.verdict.verdict import Verdict
from obb_collision.scene.refinement.placed_shapes import PlacedShapes
from obb_collision.shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Mesh, Shape, Sphere
from obb_collision.typing import Floats

MESHES = ["star1", "bumpy1", "torus1", "open_sphere1", "fine_box0"]
SHAPES: list[Shape] = [
    Sphere(0.2),
    Capsule(0.15, 0.4),
    Box([0.3, 0.4, 0.5]),
    Cylinder(0.2, 0.4),
    Cone(0.2, 0.4),
    Ellipsoid((0.1, 0.2, 0.3)),
]
UPRIGHT = [0.0, 0.0, 0.0, 1.0]
#: How near to touching pairs are put, m; certain in doubles at this size from 1e-9 on.
STEPS = [-1e-3, -1e-7, 0.0, 1e-7, 1e-3]


@each("padding", [0.0, 0.05])
@each("shape", SHAPES)
@each("turned", [False, True])
def test_verdicts_say_what_effects_say(
    shape: Shape, padding: float, turned: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Near touching, where effects are those of the shapes, not corrected by verdicts."""
    monkeypatch.setattr(PlacedShapes, "parted", lambda shapes, distances, pairs, level: distances)
    rng = np.random.default_rng(17)
    outcomes = {True: 0, False: 0}
    for name in MESHES:
        mesh = Mesh(*zoo()[name])
        for _ in range(2):
            scene = oc.Scene(accuracy="mesh", padding=padding)
            scene.set_effect("clearance", max_distance=10.0)
            pose = np.concatenate([rng.uniform(-1.5, 1.5, 3), Rotation.random(1, rng).as_quat()[0]])
            for what in (shape, mesh) if turned else (mesh, shape):
                scene.add(type(what).__name__, what)
            moved = type(shape).__name__
            scene.move(moved, pose)
            clear = scene.check().clearances
            way = clear.distances[0] * clear.normals[0] * (1.0 if turned else -1.0)
            away = clear.normals[0] * (-1.0 if turned else 1.0)
            for step in STEPS:
                place = pose.copy()
                place[:3] += way + step * away
                scene.move(moved, place)
                outcomes[_consistent(scene)] += 1
    assert min(outcomes.values()) > 10


def _consistent(scene: oc.Scene) -> bool:
    """Return whether a pair collides, after all that is said of it has been compared."""
    report = scene.check()
    clear = report.clearances
    assert len(clear.distances) == 1
    distance = clear.distances[0]
    apart = float(np.linalg.norm(clear.positions_b[0] - clear.positions_a[0]))
    if len(report) == 0:
        assert distance > 0.0 or apart < 1e-8
        return False
    assert report.accuracies.tolist() == [Accuracy.MESH]
    assert distance < 1e-8
    assert report.separations[0] < 1e-8
    assert report.contacts.depths.min() > -1e-8
    return True


@each("padding", [0.0, 0.05])
@each("length", [0.0, 0.3])
def test_round_shapes_beside_meshes_collide_at_their_very_radius(
    padding: float, length: float
) -> None:
    """In any direction; a mesh around them would collide before, up to a few percent."""
    vertices, faces = zoo()["fine_box0"]
    half: Floats = np.abs(vertices).max(axis=0)
    shape = Capsule(0.25, length) if length else Sphere(0.25)
    for turn in Rotation.random(10, np.random.default_rng(5)):
        for gap, verdicts in ((1e-6, []), (-1e-6, [Verdict.OVERLAP])):
            scene = oc.Scene(accuracy="mesh", padding=padding)
            scene.add("mesh", Mesh(vertices, faces))
            reach = 0.5 * length * abs(turn.as_matrix()[2, 2])
            height = half[2] + 0.25 + 2.0 * padding + reach + gap
            scene.add("round", shape, [0.01, 0.02, height, *turn.as_quat()])
            report = scene.check()
            assert report.verdicts.tolist() == verdicts
            distances = report.clearances.distances
            assert distances == pytest.approx([max(gap, 0.0)], abs=1e-9)


def test_a_ball_that_just_fits_into_the_hole_of_a_ring_is_free() -> None:
    vertices, faces = zoo()["torus1"]
    rings = np.linalg.norm(vertices[faces].mean(axis=1)[:, :2], axis=1)
    scene = oc.Scene(accuracy="mesh", padding=0.02)
    scene.set_effect("clearance", max_distance=10.0)
    scene.add("ring", Mesh(vertices, faces))
    scene.add("ball", Sphere(0.01))
    free = float(scene.check().clearances.distances[0])
    assert 0.1 < free < rings.min()
    for gap, colliding in ((1e-6, 0), (-1e-6, 1)):
        scene.add("ball", Sphere(0.01 + free - gap))
        report = scene.check()
        assert len(report) == colliding
        assert report.clearances.distances[0] == pytest.approx(max(gap, 0.0), abs=1e-9)
