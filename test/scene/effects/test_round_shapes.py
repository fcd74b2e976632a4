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

"""Round shapes above obb: they collide, and are as far and as deep, as their formulas say."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from mesh_zoo import zoo
from scipy.spatial.transform import Rotation

import obb_collision as oc
from obb_collision.scene.refinement import placed_shapes
from obb_collision.shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Hull, Mesh, Shape, Sphere

MESHES = [Mesh(*zoo()[n]) for n in ("star1", "bumpy1", "torus1", "open_sphere1", "fine_box0")]
BLOCK = MESHES[-1]
TOP = np.abs(BLOCK.vertices).max(axis=0)[2]
SHAPES: list[Shape] = [Sphere(0.2), Capsule(0.15, 0.4), Box([0.3, 0.4, 0.5]), Cylinder(0.2, 0.4)]
SHAPES += [Cone(0.2, 0.4), Ellipsoid((0.1, 0.2, 0.3))]


def reach_down(shape: Shape, turn: Rotation) -> float:
    """Return how far a turned shape reaches below its origin."""
    up = turn.inv().apply([0.0, 0.0, -1.0])  # as the shape sees what is below
    wide = np.hypot(up[0], up[1])
    reaches = [
        0.2,
        0.15 + 0.2 * abs(up[2]),
        float(np.abs(up) @ [0.15, 0.2, 0.25]),
        0.2 * wide + 0.2 * abs(up[2]),
        max(0.2 * wide - 0.2 * up[2], 0.2 * up[2]),
        float(np.linalg.norm([0.1 * up[0], 0.2 * up[1], 0.3 * up[2]])),
    ]
    return float(reaches[SHAPES.index(shape)])


@each("padding", [0.0, 0.05])
@each("shape", [shape for shape in SHAPES if not isinstance(shape, Box)])
def test_beside_a_mesh_they_collide_at_their_very_radius(shape: Shape, padding: float) -> None:
    """In any direction; a mesh around them would collide before, up to a few percent."""
    scene = oc.Scene(accuracy="mesh", padding=padding)
    scene.set_effect("clearance", max_distance=10.0)
    scene.add("mesh", BLOCK)
    scene.add("round", shape)
    for turn in Rotation.random(6, np.random.default_rng(5)):
        for gap in (0.1, 1e-4, 1e-6, 1e-8, -1e-8, -1e-6, -0.01):
            height = TOP + reach_down(shape, turn) + 2.0 * padding + gap
            scene.move("round", [0.01, 0.02, height, *turn.as_quat()])
            report = scene.check()
            assert len(report) == (gap < 0.0)
            assert report.clearances.distances == pytest.approx([max(gap, 0.0)], abs=2e-9)
            if len(report) and isinstance(shape, (Sphere, Capsule)):
                assert report.verdicts.tolist() == [oc.Verdict.OVERLAP]


@each("accuracy", ["hull", "mesh"])
def test_a_circle_does_not_reach_as_far_as_a_polygon_about_it(accuracy: str) -> None:
    vertices, faces = zoo()["torus0"]
    top = vertices[vertices[:, 2].argmax()]
    for other in (Mesh(vertices, faces), Hull(vertices), Box(2.0 * top)):
        scene = oc.Scene(accuracy=accuracy)
        scene.add("other", other, [*-top, 0, 0, 0, 1])
        for shape in (Cylinder(0.3, 0.5), Ellipsoid([0.3, 0.3, 0.2])):
            for half in np.linspace(0.0, 1.5, 9):
                turn = Rotation.from_euler("xz", [np.pi / 2, half]) * Rotation.from_euler("z", half)
                for gap, met in ((1e-6, False), (-1e-6, True)):
                    scene.add("round", shape, [0, 0, 0.3 + gap, *turn.as_quat()])
                    assert bool(scene.check().names()) == met


def test_a_ball_that_just_fits_into_the_hole_of_a_ring_is_free() -> None:
    vertices, faces = zoo()["torus1"]
    scene = oc.Scene(accuracy="mesh", padding=0.02)
    scene.set_effect("clearance", max_distance=10.0)
    scene.add("ring", Mesh(vertices, faces))
    scene.add("ball", Sphere(0.01))
    free = float(scene.check().clearances.distances[0])
    assert 0.1 < free < np.linalg.norm(vertices[faces].mean(axis=1)[:, :2], axis=1).min()
    for gap, colliding in ((1e-6, 0), (-1e-6, 1)):
        scene.add("ball", Sphere(0.01 + free - gap))
        report = scene.check()
        assert len(report) == colliding
        assert report.clearances.distances[0] == pytest.approx(max(gap, 0.0), abs=1e-9)


@each("padding, order", [(0.0, 1), (0.05, -1)])
@each("shape", SHAPES)
def test_verdicts_say_what_effects_say(
    shape: Shape, padding: float, order: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Near touching, where effects are those of the shapes, not corrected by verdicts."""
    monkeypatch.setattr(
        placed_shapes.PlacedShapes, "parted", lambda shapes, distances, *_: distances
    )
    rng = np.random.default_rng(17)
    outcomes = {True: 0, False: 0}
    for mesh in MESHES:
        scene = oc.Scene(accuracy="mesh", padding=padding)
        scene.set_effect("clearance", max_distance=10.0)
        pose = np.concatenate([rng.uniform(-1.5, 1.5, 3), Rotation.random(1, rng).as_quat()[0]])
        for name, what in (("mesh", mesh), ("other", shape))[::order]:
            scene.add(name, what)
        scene.move("other", pose)
        clear = scene.check().clearances
        away = order * clear.normals[0]
        for step in (-1e-3, -1e-7, 0.0, 1e-7, 1e-3):  # certain in doubles from 1e-9 on
            place = pose.copy()
            place[:3] += (step - clear.distances[0]) * away
            scene.move("other", place)
            outcomes[_consistent(scene)] += 1
    assert min(outcomes.values()) > 5


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
    assert report.accuracies.tolist() == [oc.Accuracy.MESH]
    assert distance < 1e-8
    assert report.separations[0] < 1e-8
    assert report.contacts.depths.min() > -1e-8
    return True


@each("order", [1, -1])
def test_a_ball_in_a_mesh_has_one_contact_and_its_depth(order: int) -> None:
    scene = oc.Scene(accuracy="mesh")
    for name, shape, height in (("ball", Sphere(0.25), TOP + 0.2), ("mesh", BLOCK, 0.0))[::order]:
        scene.add(name, shape, [0.01, 0.02, height, 0, 0, 0, 1])
    report = scene.check(("separations", "contacts"))
    assert report.accuracies.tolist() == [oc.Accuracy.MESH]
    assert report.depths[0] == pytest.approx(0.05, abs=1e-8)
    np.testing.assert_allclose(report.normals[0], [0, 0, -order], atol=1e-8)
    assert report.contacts.counts.tolist() == [1]
    middle = [0.01, 0.02, TOP - 0.025]
    np.testing.assert_allclose(report.contacts.positions[0, 0], middle, atol=1e-8)


def corner_of_walls() -> Mesh:
    """Return a floor and a wall, two boxes: their hull is a wedge."""
    vertices, faces = zoo()["box0"]
    unit = vertices / np.abs(vertices).max(axis=0)
    floor, wall = unit * [1.0, 1.0, 0.1], unit * [0.1, 1.0, 1.0] + [-1.0, 0.0, 1.0]
    return Mesh(np.concatenate([floor, wall]), np.concatenate([faces, faces + len(unit)]))


@each("padding, order", [(0.0, 1), (0.0, -1), (0.03, 1), (0.03, -1)])
@each("gap", [-0.02, 0.02])
def test_a_cylinder_on_the_floor_beside_a_wall_is_exact(
    padding: float, order: int, gap: float
) -> None:
    """However it is turned about its axis; a mesh around it would be up to a few percent deeper."""
    for angle in (0.0, 0.1, 0.123, 1.0):
        lying = Rotation.from_euler("zx", [angle, 0.5 * np.pi]).as_quat()
        can = "can", Cylinder(0.3, 0.8), [0, 0, 0.1 + 0.3 + 2.0 * padding + gap, *lying]
        scene = oc.Scene(accuracy="mesh" if gap < 0.0 else "obb", padding=padding)
        scene.set_effect("clearance", accuracy="mesh")
        scene.set_effect("separations", accuracy="mesh")
        for thing in (can, ("corner", corner_of_walls(), [0, 0, 0, 0, 0, 0, 1]))[::order]:
            scene.add(*thing)
        report = scene.check(("separations", "contacts", "clearance"))
        assert -1e-8 <= gap - report.separations[0] <= 1e-8
        np.testing.assert_allclose(report.normals[0], [0, 0, -order], atol=1e-6)
        if gap > 0.0:
            assert report.separations[0] == report.clearances.distances[0]
        else:
            assert report.contacts.depths[0] == report.depths[0] >= -gap
            assert report.contacts.positions[0, 0, 2] == pytest.approx(0.1, abs=0.05 + padding)
