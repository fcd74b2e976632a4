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

"""Effects on round shapes, points within objects, and contacts and clearances of a scene."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from each import each
from mesh_zoo import zoo
from numpy.typing import NDArray
from scenes import filled_scene, random_poses
from scipy.spatial.transform import Rotation
from support import clearances, contacts, refused

import obb_collision as oc
from obb_collision.scene.effects import points
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
    reaches = [0.2, 0.15 + 0.2 * abs(up[2]), np.abs(up) @ [0.15, 0.2, 0.25]]
    reaches += [0.2 * wide + 0.2 * abs(up[2]), max(0.2 * wide - 0.2 * up[2], 0.2 * up[2])]
    reaches.append(np.linalg.norm([0.1 * up[0], 0.2 * up[1], 0.3 * up[2]]))
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
    monkeypatch.setattr(placed_shapes.PlacedShapes, "parted", lambda _, distances, *__: distances)
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


@each("padding, order", [(0.0, 1), (0.0, -1), (0.03, 1), (0.03, -1)])
@each("gap", [-0.02, 0.02])
def test_a_cylinder_on_a_floor_by_a_wall_is_exact(padding: float, order: int, gap: float) -> None:
    """However it is turned about its axis; a mesh around it would be up to a few percent deeper."""
    vertices, faces = zoo()["box0"]
    unit = vertices / np.abs(vertices).max(axis=0)
    floor, wall = unit * [1.0, 1.0, 0.1], unit * [0.1, 1.0, 1.0] + [-1.0, 0.0, 1.0]
    both = Mesh(np.concatenate([floor, wall]), np.concatenate([faces, faces + len(unit)]))
    for angle in (0.0, 0.1, 0.123, 1.0):
        lying = Rotation.from_euler("zx", [angle, 0.5 * np.pi]).as_quat()
        can = "can", Cylinder(0.3, 0.8), [0, 0, 0.1 + 0.3 + 2.0 * padding + gap, *lying]
        scene = oc.Scene(accuracy="mesh" if gap < 0.0 else "obb", padding=padding)
        scene.set_effect("clearance", accuracy="mesh")
        scene.set_effect("separations", accuracy="mesh")
        for thing in (can, ("both", both, [0, 0, 0, 0, 0, 0, 1]))[::order]:
            scene.add(*thing)
        report = scene.check(("separations", "contacts", "clearance"))
        assert -1e-8 <= gap - report.separations[0] <= 1e-8
        np.testing.assert_allclose(report.normals[0], [0, 0, -order], atol=1e-6)
        if gap > 0.0:
            assert report.separations[0] == report.clearances.distances[0]
        else:
            assert report.contacts.depths[0] == report.depths[0] >= -gap
            assert report.contacts.positions[0, 0, 2] == pytest.approx(0.1, abs=0.05 + padding)


LEVELS = ("obb", "hull", "mesh")


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
    assert len(scene.check().points_inside) == 0
    for count in (0, 4, 2):
        scene.obstacle_points = np.zeros((count, 3))
        assert scene.check().points_inside.counts.tolist() == [count]
    assert calls == [4, 2]
    refused("points must", setattr, scene, "obstacle_points", np.zeros((3, 2)))


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
    scene = mixed(accuracy="hull")
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


Distances = dict[tuple[int, ...], float]


def all_clearances(scene: oc.Scene, max_distance: float) -> Distances:
    boxes, slots = scene.boxes, scene.indices
    pairs = np.stack(np.triu_indices(len(slots), 1), axis=1)
    distances = clearances(boxes, pairs).distances
    near = distances <= max_distance
    return dict(zip(map(tuple, slots[pairs[near]].tolist()), distances[near].tolist(), strict=True))


def found(report: oc.Report) -> Distances:
    near = report.clearances
    assert near.pairs.tolist() == sorted(near.pairs.tolist())
    return dict(zip(map(tuple, near.pairs.tolist()), near.distances.tolist(), strict=True))


@each("limit, most", [(0.0, 4), (0.0625, 8), (1.0, 4), (100.0, 8)])
def test_effects_of_boxes_are_what_the_boxes_alone_give(limit: float, most: int) -> None:
    scene, cloud = filled_scene(200), np.random.default_rng(3).uniform(-2, 2, (3000, 3))
    cloud[7] = np.nan
    scene.obstacle_points = cloud.astype(np.float32)
    scene.set_effect("clearance", max_distance=limit)
    scene.set_effect("contacts", max_points=most)
    report, near, inside = scene.check(), all_clearances(scene, limit), scene.check().points_inside
    assert {tuple(pair) for pair in report.pairs.tolist()} <= set(near)
    for k, (a, b) in enumerate(report.names()):
        alone = scene.obb(a).separation(scene.obb(b))
        assert (report.separations[k], report.verdicts[k]) == (alone.gap, alone.verdict)
        assert report.depths[k] == max(-alone.gap, 0.0)
        assert (report.normals[k] == alone.axis).all()
        for name in (a, b):
            assert scene.obb(name).padded(0.05).contains(report.positions[k])
    assert (report.contacts.depths == report.depths).all()
    assert (report.contacts.counts >= 1).all()
    for name, expected in vars(contacts(scene.boxes, report.pairs, most)).items():
        np.testing.assert_array_equal(getattr(report.contacts, name), expected)
    assert (inside.indices.tolist(), inside.ignored) == (scene.indices.tolist(), 1)
    points = np.nan_to_num(cloud.astype(np.float32), nan=1e6)
    held = [np.flatnonzero(scene.obb(name).contains(points)) for name in scene.names]
    assert inside.counts.tolist() == [len(rows) for rows in held]
    assert inside.first.tolist() == [rows[0] if len(rows) else -1 for rows in held]
    assert min(len(report), inside.counts.sum()) > 50
    scene.move_indices(scene.indices, random_poses(200, np.random.default_rng(1), 2.0))
    assert found(report) == near  # of the check, though read later
    scene.clear()
    for k in range(3):
        scene.add(f"{k}", Box([1, 1, 1]), [(1.0 + limit) * k, 0, 0, 0, 0, 0, 1])
    last = scene.check().clearances
    assert last.pairs[last.distances == limit].tolist() == [[0, 1], [1, 2]], "just within"


def test_pairs_of_callers_only_and_not_allowed_ones() -> None:
    scene = filled_scene(80)
    scene.set_effect("clearance", max_distance=0.5, objects=["box/7"])
    everything = all_clearances(scene, 0.5)
    assert found(scene.check()) == {k: d for k, d in everything.items() if 7 in k}
    scene.set_effect("clearance", objects=[f"box/{k}" for k in range(0, 80, 2)])
    even = {k: d for k, d in everything.items() if k[0] % 2 == 0 or k[1] % 2 == 0}
    assert found(scene.check()) == even
    scene.allow("box/4", "*")
    assert found(scene.check()) == {k: d for k, d in even.items() if 4 not in k}
    scene.set_enabled("box/6", False)
    assert not any(6 in k or 4 in k for k in found(scene.check()))


def test_a_patch_option_that_cannot_be_used_is_refused() -> None:
    for value in (5, 0, np.nan):
        refused("contacts max_points must be", oc.Scene().set_effect, "contacts", max_points=value)
