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


"""Effects above obb: computed on what decided the pair, or on what their own accuracy says."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from each import each
from hull_distances import placed, squared_distance
from scipy.spatial.transform import Rotation

import obb_collision as oc
from obb_collision.accuracy import Accuracy
from obb_collision.geometry.poses import as_poses
from obb_collision.queries.convex.distances import convex_distances
from obb_collision.scene.refinement import placed_shapes

EFFECTS = ("separations", "contacts", "clearance")
COUNT = 24


def shapes_of(rng: np.random.Generator) -> list[oc.shapes.Shape]:
    """Return boxes, round shapes and hulls."""
    shapes: list[oc.shapes.Shape] = []
    for size in rng.uniform(0.05, 0.2, (COUNT // 8, 3)):
        shapes += [
            oc.shapes.Box(2.0 * size),
            oc.shapes.Sphere(size[0]),
            oc.shapes.Capsule(size[0], size[1]),
            oc.shapes.Cylinder(size[0], 2.0 * size[1]),
            oc.shapes.Cone(size[0], 2.0 * size[1]),
            oc.shapes.Ellipsoid(size),
            oc.shapes.Cylinder(size[0], size[1], scale=[1.0, 2.0, 0.5]),
            oc.shapes.Hull(rng.normal(size=(12, 3)) * 0.5 * size),
        ]
    return shapes


def mixed_scene(accuracy: str, seed: int = 0, padding: float = 0.0) -> oc.Scene:
    """Return these, crowded enough to collide."""
    rng = np.random.default_rng(seed)
    scene = oc.Scene(accuracy=accuracy, padding=padding)
    scene.set_effect("clearance", max_distance=10.0)
    for number, shape in enumerate(shapes_of(rng)):
        turn = Rotation.random(1, rng).as_quat()[0]
        scene.add(str(number), shape, [*rng.uniform(-0.35, 0.35, 3), *turn])
    return scene


def distances(report: oc.Report) -> dict[tuple[int, int], float]:
    found = report.clearances
    return {(i, j): d for (i, j), d in zip(found.pairs.tolist(), found.distances, strict=True)}


@each("seed", range(3))
def test_distances_of_boxes_are_never_larger_than_those_of_shapes(seed: int) -> None:
    boxes = distances(mixed_scene("obb", seed).check("clearance"))
    hulls = distances(mixed_scene("hull", seed).check("clearance"))
    assert set(hulls) == set(boxes)
    differences = np.array([hulls[pair] - boxes[pair] for pair in boxes])
    assert (differences >= -1e-10).all()
    assert differences.max() > 0.05


def test_a_depth_at_hull_is_at_most_that_of_boxes_and_parts_the_shapes() -> None:
    scene, shapes = mixed_scene("hull"), shapes_of(np.random.default_rng(0))
    report = scene.check(EFFECTS)
    boxes = mixed_scene("obb").check("separations")
    depth_of = {tuple(pair): d for pair, d in zip(boxes.pairs.tolist(), boxes.depths, strict=True)}
    assert (report.accuracies == Accuracy.HULL).sum() > 10
    for row, (i, j) in enumerate(report.pairs.tolist()):
        assert report.depths[row] <= depth_of[i, j] + 1e-10
        pose = scene.pose(str(j))
        pose[:3] += (report.depths[row] + 1e-9) * report.normals[row]
        pair = oc.Scene(accuracy="hull")
        pair.set_effect("clearance", max_distance=1.0)
        for slot, where in ((i, scene.pose(str(i))), (j, pose)):
            pair.add(str(slot), shapes[slot], where)
        assert pair.check("clearance").clearances.distances[0] >= -1e-9


def test_contacts_agree_with_separations_and_lie_between_the_shapes() -> None:
    report = mixed_scene("hull").check(EFFECTS)
    contacts = report.contacts
    high = report.accuracies == Accuracy.HULL
    assert contacts.depths[high].tolist() == report.depths[high].tolist()
    assert (contacts.counts[high & (report.depths > 0.0)] >= 1).all()
    assert (contacts.axes[high] == -1).all()
    apart = np.nan_to_num(contacts.position_depths, nan=0.0)
    assert (apart <= contacts.depths[:, None])[high].all()


@each("level", ["hull", "mesh"])
@each("exact", [False, True])
def test_pairs_that_hardly_touch_have_a_point_or_a_distance(level: str, exact: bool) -> None:
    # Moved until they touch but for rounding: verdicts and effects decide with other bounds.
    rng = np.random.default_rng(7)
    scene = oc.Scene(accuracy=level, exact=exact)
    for number in range(150):
        corners = rng.integers(-1, 2, (2, 12, 3)) * rng.choice([1.0, 1e-3], (2, 1, 3))
        one = oc.shapes.Hull(corners[0])
        other: oc.shapes.Shape = oc.shapes.Box(np.ptp(corners[1], axis=0) + 0.1)
        if number % 2:
            other = oc.shapes.Mesh(rng.normal(size=(4, 3)), [[0, 1, 2], [0, 2, 3]])
        pair, way = oc.Scene(accuracy="hull"), np.eye(3)[number % 3] * 8.0
        pair.set_effect("clearance", max_distance=100.0)
        pair.add("a", one)
        pair.add("b", other, [*way, 0, 0, 0, 1])
        near = pair.check("clearance").clearances
        way -= near.normals[0] * near.distances[0] * (1.0 + rng.choice([0.0, 1e-16, 1e-12, -1e-12]))
        here = np.array([50.0 * number, 0.0, 0.0])
        scene.add(f"{number}a", one, [*here, 0, 0, 0, 1])
        scene.add(f"{number}b", other, [*(here + way), 0, 0, 0, 1])
    report = scene.check(("contacts", "clearance"))
    assert 10 < len(report.pairs) < 140
    assert (report.contacts.counts[report.accuracies >= Accuracy.HULL] > 0).all()
    collide = set(map(tuple, report.pairs.tolist()))
    for pair_of, distance in distances(report).items():
        assert (distance <= 0.0) == (pair_of in collide)


def test_flat_hulls_are_as_far_apart_as_fractions_say() -> None:
    # Points, segments, triangles and polygons, turned: they were their boxes.
    rng = np.random.default_rng(1)
    for count in (1, 2, 3, 8) * 10:
        points = rng.normal(size=(2, count, 3)) * [0.5, 0.5, 0.0]
        points[0] = points[0] @ Rotation.random(None, rng).as_matrix()
        pose = [*rng.normal(size=3) * 0.3, *Rotation.random(None, rng).as_quat()]
        scene = oc.Scene(accuracy="hull")
        scene.set_effect("clearance", max_distance=10.0)
        scene.add("a", oc.shapes.Hull(points[0]))
        scene.add("b", oc.shapes.Hull(points[1]), pose)
        report = scene.check("clearance")
        centers, rotations = as_poses(np.array([scene.pose("b")]))
        exactly = (
            placed(points[0], np.zeros(3), np.eye(3)),
            placed(points[1], centers[0], rotations[0]),
        )
        far = float(squared_distance(*exactly)) ** 0.5
        assert (len(report.pairs) > 0) == (far == 0.0)
        assert far == 0.0 or -1e-9 <= report.clearances.distances[0] - far <= 0.0


def test_separations_and_contacts_of_the_same_pairs_compute_their_distances_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[int] = []

    def counting(*args: Any) -> Any:
        calls.append(len(args[2]))
        return convex_distances(*args)

    monkeypatch.setattr(placed_shapes, "convex_distances", counting)
    together = mixed_scene("hull").check(("separations", "contacts"))
    assert together.depths.tolist() == mixed_scene("hull").check("separations").depths.tolist()
    assert len(calls) == 2
    alone = mixed_scene("hull").check("contacts").contacts
    assert len(calls) == 3
    for name, column in vars(together.contacts).items():
        assert np.array_equal(column, vars(alone)[name], equal_nan=True), name


def test_an_effect_of_its_own_accuracy() -> None:
    pairs = mixed_scene("obb")
    pairs.set_effect("clearance", accuracy="hull")
    hulls = mixed_scene("hull")
    assert distances(pairs.check("clearance")) == distances(hulls.check("clearance"))
    hulls.set_effect("clearance", accuracy="obb")
    boxes = distances(mixed_scene("obb").check("clearance"))
    assert distances(hulls.check("clearance")) == boxes


def test_effects_read_later_are_of_where_the_objects_were() -> None:
    scene, other = mixed_scene("hull"), mixed_scene("hull")
    report = scene.check()
    for number in range(COUNT):
        scene.move(str(number), [9.0 * number, 0, 0, 0, 0, 0, 1])
    now = other.check(EFFECTS)
    assert report.separations.tolist() == now.separations.tolist()
    assert report.clearances.distances.tolist() == now.clearances.distances.tolist()


def test_effects_read_later_are_of_the_shapes_that_have_gone_since() -> None:
    """Nearly all hulls go, so that those that stay move up to other rows of a new pool."""
    scene, other = mixed_scene("hull"), mixed_scene("hull")
    report = scene.check()
    for number in range(1, COUNT):
        scene.remove(str(number))
    points = np.random.default_rng(4).normal(size=(20, 3))
    for number in range(2):
        scene.add(f"new {number}", oc.shapes.Hull(points + number), [0, 0, 0, 0, 0, 0, 1])
    scene.check(EFFECTS)
    now = other.check(EFFECTS)
    assert report.separations.tolist() == now.separations.tolist()
    assert report.clearances.distances.tolist() == now.clearances.distances.tolist()


def test_effects_of_pairs_that_stay_are_those_of_a_new_scene() -> None:
    scene, other = mixed_scene("hull"), mixed_scene("hull")
    scene.set_effect("separations", "on")
    scene.check(EFFECTS)
    for moving in (scene, other):
        moving.move("3", [0.1, 0, 0, 0, 0, 0, 1])
    again, anew = scene.check(EFFECTS), other.check(EFFECTS)
    assert again.names() == anew.names()
    assert again.separations.tolist() == anew.separations.tolist()
    assert again.contacts.depths.tolist() == anew.contacts.depths.tolist()


def test_a_budget_lowers_effects_with_their_pairs() -> None:
    scene = mixed_scene("hull")
    scene.time_budget = 1e-9  # too little for anything above boxes
    report = scene.check(EFFECTS)
    assert report.cap == Accuracy.OBB
    boxes = mixed_scene("obb").check(EFFECTS)
    assert report.separations.tolist() == boxes.separations.tolist()
    assert report.clearances.distances.tolist() == boxes.clearances.distances.tolist()


def test_padding_is_a_ball_about_shapes() -> None:
    bare, padded = mixed_scene("hull", 1), mixed_scene("hull", 1, padding=0.01)
    found, grown = (distances(scene.check("clearance")) for scene in (bare, padded))
    shaped = [pair for pair in found if all(slot % 8 for slot in pair) and grown[pair] > 0.0]
    assert len(shaped) > 50
    for pair in shaped:
        assert grown[pair] == pytest.approx(found[pair] - 0.02, abs=1e-9)
    levels = padded.check().accuracies
    assert set(levels.tolist()) <= {Accuracy.OBB, Accuracy.HULL}
    assert (levels == Accuracy.HULL).any()
