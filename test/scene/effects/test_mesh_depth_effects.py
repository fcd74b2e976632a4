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

"""Depths, contacts and distances at mesh of a scene: of triangles, padded ones too, in order."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from mesh_zoo import zoo
from scipy.spatial.transform import Rotation

import obb_collision as oc
from obb_collision.accuracy import Accuracy
from obb_collision.shapes import Box, Capsule, Cone, Cylinder, Hull, Mesh, Shape, Sphere

EFFECTS = ("separations", "contacts", "clearance")
NAMES = ["star1", "bumpy1", "torus1", "open_sphere1", "sheet1", "crumbs0"]


def shapes_of() -> list[Shape]:
    """Return meshes, boxes, round shapes and hulls."""
    others: list[Shape] = [Box([0.3, 0.4, 0.5]), Sphere(0.2), Capsule(0.15, 0.4), Cone(0.2, 0.4)]
    others += [Hull(zoo()["hull1"][0]), Sphere(0.1)]
    return [*(Mesh(*zoo()[name]) for name in NAMES), *others]


def crowded_scene(accuracy: str, padding: float = 0.0) -> oc.Scene:
    rng = np.random.default_rng(1)
    scene = oc.Scene(accuracy=accuracy, padding=padding)
    scene.set_effect("clearance", max_distance=10.0)
    for number, shape in enumerate(shapes_of()):
        turn = Rotation.random(1, rng).as_quat()[0]
        scene.add(str(number), shape, [*rng.uniform(-0.55, 0.55, 3), *turn])
    return scene


@each("padding", [0.0, 0.02])
def test_a_coarser_level_is_never_less_deep(padding: float) -> None:
    reports = [crowded_scene(level, padding).check(EFFECTS) for level in ("obb", "hull", "mesh")]
    depths = [dict(zip(map(tuple, r.pairs.tolist()), r.depths, strict=True)) for r in reports]
    for coarse, fine in (depths[:2], depths[1:]):
        assert set(fine) < set(coarse)
        assert all(fine[pair] <= coarse[pair] + 1e-8 for pair in fine)
    assert sum(depths[2][pair] < depths[1][pair] - 0.01 for pair in depths[2]) > 3
    high = reports[2].accuracies == Accuracy.MESH
    assert high.sum() > 10
    contacts = reports[2].contacts
    assert contacts.pairs.tolist() == reports[2].pairs.tolist()
    assert contacts.depths[high].tolist() == reports[2].depths[high].tolist()
    assert (contacts.counts[high] >= 1).all()
    assert (contacts.axes[high] == -1).all()


@each("padding", [0.0, 0.02])
def test_a_depth_parts_the_shapes(padding: float) -> None:
    scene, shapes = crowded_scene("mesh", padding), shapes_of()
    report = scene.check(EFFECTS)
    assert len(report) > 10
    for row, (i, j) in enumerate(report.pairs.tolist()):
        pose = scene.pose(str(j))
        pose[:3] += report.depths[row] * report.normals[row]
        pair = oc.Scene(accuracy="mesh", padding=padding)
        for slot, where in ((i, scene.pose(str(i))), (j, pose)):
            pair.add(str(slot), shapes[slot], where)
        pair.set_effect("clearance", max_distance=1.0)
        report_of_pair = pair.check("clearance")
        assert report_of_pair.clearances.distances[0] >= -1e-9
        if report.accuracies[row] == Accuracy.MESH and max(i, j) < len(NAMES):
            assert len(report_of_pair) == 0


def test_padding_is_a_ball_about_meshes() -> None:
    bare, padded = crowded_scene("mesh"), crowded_scene("mesh", 0.01)
    found, grown = (
        dict(zip(map(tuple, c.pairs.tolist()), c.distances, strict=True))
        for c in (scene.check("clearance").clearances for scene in (bare, padded))
    )
    meshes = [pair for pair in found if max(pair) < len(NAMES) and grown[pair] > 0.0]
    assert len(meshes) > 4
    for pair in meshes:
        assert grown[pair] == pytest.approx(found[pair] - 0.02, abs=1e-9)
    report = padded.check()
    colliding = {tuple(pair) for pair in report.pairs.tolist()}
    assert Accuracy.MESH in report.accuracies
    for pair in found:
        if max(pair) < len(NAMES):
            assert (pair in colliding) == (found[pair] <= 0.02)


def test_round_shapes_are_exact_and_either_may_be_the_first() -> None:
    half = np.abs(zoo()["fine_box0"][0]).max(axis=0)
    for order in (1, -1):
        scene = oc.Scene(accuracy="mesh")
        ball, mesh = Sphere(0.25), Mesh(*zoo()["fine_box0"])
        things = [("ball", ball, half[2] + 0.2), ("mesh", mesh, 0.0)][::order]
        for name, shape, height in things:
            scene.add(name, shape, [0.01, 0.02, height, 0, 0, 0, 1])
        report = scene.check(EFFECTS)
        assert report.accuracies.tolist() == [Accuracy.MESH]
        assert report.depths[0] == pytest.approx(0.05, abs=1e-8)
        np.testing.assert_allclose(report.normals[0], [0, 0, -order], atol=1e-8)
        contacts = report.contacts
        assert contacts.counts.tolist() == [1]
        np.testing.assert_allclose(
            contacts.positions[0, 0], [0.01, 0.02, half[2] - 0.025], atol=1e-8
        )


def corner_of_walls() -> Mesh:
    """Return a floor and a wall, two boxes: their hull is a wedge."""
    vertices, faces = zoo()["box0"]
    unit = vertices / np.abs(vertices).max(axis=0)
    floor, wall = unit * [1.0, 1.0, 0.1], unit * [0.1, 1.0, 1.0] + [-1.0, 0.0, 1.0]
    return Mesh(np.concatenate([floor, wall]), np.concatenate([faces, faces + len(unit)]))


@each("padding", [0.0, 0.03])
@each("order", [1, -1])
@each("gap", [-0.02, 0.02])
def test_a_cylinder_on_the_floor_beside_a_wall_is_exact(
    padding: float, order: int, gap: float
) -> None:
    """However it is turned about its axis; a mesh around it would be up to a few percent deeper."""
    for angle in (0.0, 0.1, 0.123, 1.0):
        lying = Rotation.from_euler("zx", [angle, 0.5 * np.pi]).as_quat()
        height = 0.1 + 0.3 + 2.0 * padding + gap
        things: list[tuple[str, Shape, list[float]]] = [
            ("can", Cylinder(0.3, 0.8), [0, 0, height, *lying]),
            ("corner", corner_of_walls(), [0, 0, 0, 0, 0, 0, 1]),
        ]
        scene = oc.Scene(accuracy="mesh" if gap < 0.0 else "obb", padding=padding)
        scene.set_effect("clearance", accuracy="mesh")
        scene.set_effect("separations", accuracy="mesh")
        for name, shape, pose in things[::order]:
            scene.add(name, shape, pose)
        report = scene.check(EFFECTS)
        assert -1e-8 <= gap - report.separations[0] <= 1e-8
        np.testing.assert_allclose(report.normals[0], [0, 0, -order], atol=1e-6)
        if gap > 0.0:
            assert report.separations[0] == report.clearances.distances[0]
        else:
            assert report.contacts.depths[0] == report.depths[0] >= -gap
            assert report.contacts.positions[0, 0, 2] == pytest.approx(0.1, abs=0.05 + padding)


def test_effects_of_pairs_that_stay_are_those_of_a_new_scene() -> None:
    scene, other = crowded_scene("mesh"), crowded_scene("mesh")
    scene.check(EFFECTS)
    for moving in (scene, other):
        moving.move("3", [0.1, 0, 0, 0, 0, 0, 1])
    again, anew = scene.check(EFFECTS), other.check(EFFECTS)
    assert again.names() == anew.names()
    assert again.separations.tolist() == anew.separations.tolist()
    np.testing.assert_array_equal(again.contacts.positions, anew.contacts.positions)


def test_its_own_accuracy_whatever_decides_the_pairs() -> None:
    scene = crowded_scene("obb")
    for name in ("separations", "contacts"):
        scene.set_effect(name, accuracy="mesh")
    report, fine = scene.check(EFFECTS), crowded_scene("mesh").check(EFFECTS)
    depth_of = dict(zip(map(tuple, report.pairs.tolist()), report.separations, strict=True))
    for pair, separation in zip(fine.pairs.tolist(), fine.separations.tolist(), strict=True):
        assert depth_of[tuple(pair)] == separation
    apart = [s for pair, s in depth_of.items() if list(pair) not in fine.pairs.tolist()]
    assert len(apart) > 3
    assert min(apart) >= 0.0
