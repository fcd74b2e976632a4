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

"""Effects on every level: in order, without contradictions, of the level that each says."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from each import each
from hull_distances import placed, squared_distance
from hypothesis import given, settings
from hypothesis import strategies as st
from mesh_zoo import zoo
from scenes import counted
from scipy.spatial.transform import Rotation

import obb_collision as oc
from obb_collision import Accuracy
from obb_collision.scene.refinement import placed_shapes
from obb_collision.shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Hull, Mesh, Shape, Sphere

OBB, HULL, MESH = Accuracy.OBB, Accuracy.HULL, Accuracy.MESH
EFFECTS = ("separations", "contacts", "clearance")
#: By how much a distance or a depth of a coarser level may be out of order, of the size of a pair;
ORDER = 1e-9
#: and by how much planes of hulls are moved outwards, from which corners move the more the sharper.
OUTWARDS = 2e-11
LEVELS = ("obb", "hull", "mesh")
MESHES = ("star1", "bumpy1", "torus1", "open_sphere1", "sheet1", "crumbs0")

Numbers = dict[tuple[int, ...], float]


def by_pair(pairs: np.ndarray, values: np.ndarray) -> Numbers:
    return dict(zip(map(tuple, pairs.tolist()), values.tolist(), strict=True))


def distances(report: oc.Report) -> Numbers:
    return by_pair(report.clearances.pairs, report.clearances.distances)


def depths(report: oc.Report) -> Numbers:
    return by_pair(report.pairs, report.depths)


def shape_of(kind: int, size: np.ndarray) -> Shape:
    """Return a shape of one of ten kinds; size (3,)."""
    x, y, _ = size.tolist()
    if kind >= 8:
        vertices, faces = zoo()[("torus0", "hull1", "open_sphere1", "star0")[int(1e3 * x) % 4]]
        return Mesh(vertices * size, faces)
    round_ones = Sphere(x), Capsule(x, y), Cylinder(x, y), Cone(x, y), Ellipsoid(size)
    others = Box(2.0 * size), Cylinder(x, y, scale=[1.0, 2.0, 0.5]), Hull(zoo()["star0"][0] * size)
    return (*round_ones, *others)[kind]


def crowd(seed: int, accuracy: str, padding: float, thin: float) -> oc.Scene:
    """Return shapes of all kinds, crowded enough to collide; thin: their least size by the rest."""
    rng = np.random.default_rng(seed)
    scene = oc.Scene(accuracy=accuracy)
    scene.set_effect("clearance", max_distance=10.0)
    for number in range(14):
        kind, size = int(rng.integers(0, 10)), rng.uniform(0.1, 0.3, 3)
        size[rng.integers(0, 3)] *= thin
        turn = rng.normal(size=4) if rng.random() < 0.7 else np.array([0.0, 0.0, 0.0, 1.0])
        place = rng.uniform(-0.35, 0.35, 3)
        place = np.round(place, 1) if rng.random() < 0.3 else place  # touching, coplanar
        pose = [*place, *(turn / np.linalg.norm(turn))]
        padded = padding if number % 2 else 0.0
        scene.add(str(number), shape_of(kind, size), pose, padding=padded)
    scene.obstacle_points = rng.uniform(-1, 1, (300, 3))
    return scene


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.05]), st.sampled_from([1.0, 0.03, 1e-3]))
def test_levels_are_in_order_and_effects_agree(seed: int, padding: float, thin: float) -> None:
    """A coarser level is never farther, less deep or without a point."""
    order = ORDER + OUTWARDS / thin
    made = [crowd(seed, level, padding, thin) for level in LEVELS]
    reports = [scene.check([*EFFECTS, "points"]) for scene in made]
    for coarse, fine in itertools.pairwise(reports):
        deep, known = depths(coarse), distances(coarse)
        assert all(deep[pair] >= depth - order for pair, depth in depths(fine).items())
        assert (coarse.points_inside.counts >= fine.points_inside.counts).all()
        assert (fine.separations[fine.accuracies >= HULL] <= 0.0).all()
        for pair, distance in distances(fine).items():
            assert known[pair] <= max(distance, 0.0) + order
            assert (distance <= 0.0) == (pair in depths(fine))


def some_shapes() -> list[Shape]:
    """Return meshes, then other shapes, then a box."""
    rng = np.random.default_rng(3)
    others: list[Shape] = [Sphere(0.2), Capsule(0.15, 0.4), Cone(0.2, 0.4), Sphere(0.1)]
    others += [Hull(zoo()["hull1"][0]), Cylinder(0.1, 0.2, scale=[1.0, 2.0, 0.5])]
    others += [Ellipsoid([0.1, 0.2, 0.3]), Hull(rng.normal(size=(12, 3)) * 0.1)]
    return [*(Mesh(*zoo()[name]) for name in MESHES), *others, Box([0.3, 0.4, 0.5])]


SHAPES = some_shapes()


def mixed(accuracy: str, padding: float = 0.0, spread: float = 0.6, order: int = 1) -> oc.Scene:
    rng = np.random.default_rng(1)
    scene = oc.Scene(accuracy=accuracy, padding=padding)
    scene.set_effect("clearance", max_distance=10.0)
    for number, shape in enumerate(SHAPES[::order]):
        turn = Rotation.random(1, rng).as_quat()[0]
        scene.add(str(number), shape, [*rng.uniform(-spread, spread, 3), *turn])
    return scene


@each("padding", [0.0, 0.02])
def test_finer_levels_say_more_and_contacts_are_as_deep_as_separations(padding: float) -> None:
    reports = [mixed(level, padding).check(EFFECTS) for level in LEVELS]
    for coarse, fine in itertools.pairwise(reports):
        before, after = distances(coarse), distances(fine)
        assert sum(after[pair] > before[pair] + 0.01 for pair in before) > 10
        deep = depths(coarse)
        assert sum(depth < deep[pair] - 0.01 for pair, depth in depths(fine).items()) > 3
        high = fine.accuracies >= HULL
        contacts = fine.contacts
        assert high.sum() > 10
        assert contacts.pairs.tolist() == fine.pairs.tolist()
        assert contacts.depths[high].tolist() == fine.depths[high].tolist()
        assert (contacts.counts[high & (fine.depths > 0.0)] >= 1).all()
        assert (contacts.axes[high] == -1).all()
        inner = np.nan_to_num(contacts.position_depths, nan=0.0)
        assert (inner <= contacts.depths[:, None] + 1e-9)[high].all()


@each("level, padding", [("hull", 0.0), ("mesh", 0.0), ("mesh", 0.02)])
def test_a_depth_parts_the_shapes(level: str, padding: float) -> None:
    scene = mixed(level, padding)
    report = scene.check(EFFECTS)
    assert len(report) > 10
    for row, (i, j) in enumerate(report.pairs.tolist()):
        pose = scene.pose(str(j))
        pose[:3] += (report.depths[row] + 1e-9 * (level == "hull")) * report.normals[row]
        pair = oc.Scene(accuracy=level, padding=padding)
        pair.set_effect("clearance", max_distance=1.0)
        pair.add(str(i), SHAPES[i], scene.pose(str(i)))
        pair.add(str(j), SHAPES[j], pose)
        parted = pair.check("clearance")
        assert parted.clearances.distances[0] >= -1e-9
        if report.accuracies[row] == MESH and max(i, j) < len(MESHES):
            assert len(parted) == 0


@each("level", ["hull", "mesh"])
def test_padding_is_a_ball_about_shapes(level: str) -> None:
    bare, padded = mixed(level, spread=1.0), mixed(level, 0.01, 1.0)
    found, report = distances(bare.check("clearance")), padded.check("clearance")
    grown, colliding = distances(report), depths(report)
    shaped = [pair for pair in found if max(pair) < len(SHAPES) - 1]
    if level == "mesh":
        shaped = [pair for pair in shaped if max(pair) < len(MESHES)]
    apart = [pair for pair in shaped if grown[pair] > 0.0]
    assert len(apart) > 4
    for pair in apart:
        assert grown[pair] == pytest.approx(found[pair] - 0.02, abs=1e-9)
    for pair in shaped:
        assert (pair in colliding) == (found[pair] <= 0.02)
    assert Accuracy[level.upper()] in report.accuracies


@each("order", [1, -1])
def test_points_of_a_distance_at_mesh_are_that_far_apart(order: int) -> None:
    report = mixed("mesh", spread=1.0, order=order).check("clearance")
    found, whole = report.clearances, [isinstance(shape, Mesh) for shape in SHAPES[::order]]
    apart = np.array(whole)[found.pairs].any(axis=1) & (found.distances > 0.0)
    assert 30 < apart.sum() < len(found.pairs)
    ways = (found.positions_b - found.positions_a)[apart]
    np.testing.assert_allclose(np.linalg.norm(ways, axis=1), found.distances[apart], atol=1e-9)
    # for curved shapes one that is off by the root of 1e-10 proves as much
    normals = ways / found.distances[apart, None]
    np.testing.assert_allclose(found.normals[apart], normals, atol=1e-4)


@each("level", ["hull", "mesh"])
@each("exact", [False, True])
def test_pairs_that_hardly_touch_have_a_point_or_a_distance(level: str, exact: bool) -> None:
    # Moved until they touch but for rounding: verdicts and effects decide with other bounds.
    rng = np.random.default_rng(7)
    scene = oc.Scene(accuracy=level, exact=exact)
    for number in range(60):
        corners = rng.integers(-1, 2, (2, 12, 3)) * rng.choice([1.0, 1e-3], (2, 1, 3))
        one = Hull(corners[0])
        other: Shape = Box(np.ptp(corners[1], axis=0) + 0.1)
        if number % 2:
            other = Mesh(rng.normal(size=(4, 3)), [[0, 1, 2], [0, 2, 3]])
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
    assert 4 < len(report.pairs) < 84
    assert (report.contacts.counts[report.accuracies >= HULL] > 0).all()
    collide = set(map(tuple, report.pairs.tolist()))
    for found, distance in distances(report).items():
        assert (distance <= 0.0) == (found in collide)


def test_flat_hulls_are_as_far_apart_as_fractions_say() -> None:
    """Points, segments, triangles and polygons, turned."""
    rng = np.random.default_rng(1)
    for count in (1, 2, 3, 8) * 10:
        points = rng.normal(size=(2, count, 3)) * [0.5, 0.5, 0.0]
        points[0] = points[0] @ Rotation.random(None, rng).as_matrix()
        pose = [*rng.normal(size=3) * 0.3, *Rotation.random(None, rng).as_quat()]
        scene = oc.Scene(accuracy="hull")
        scene.set_effect("clearance", max_distance=10.0)
        scene.add("a", Hull(points[0]))
        scene.add("b", Hull(points[1]), pose)
        report = scene.check("clearance")
        where = oc.Boxes.from_poses([scene.pose("b")], np.zeros((1, 3)))
        other = placed(points[1], where.centers[0], where.rotations[0])
        far = float(squared_distance(placed(points[0], np.zeros(3), np.eye(3)), other)) ** 0.5
        assert (len(report.pairs) > 0) == (far == 0.0)
        assert far == 0.0 or -1e-9 <= report.clearances.distances[0] - far <= 0.0


def test_separations_and_contacts_compute_distances_once(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = counted(monkeypatch, placed_shapes, "convex_distances", 2)
    together = mixed("hull").check(("separations", "contacts"))
    assert together.depths.tolist() == mixed("hull").check("separations").depths.tolist()
    assert len(calls) == 2
    alone = mixed("hull").check("contacts").contacts
    assert len(calls) == 3
    for name, column in vars(together.contacts).items():
        assert np.array_equal(column, vars(alone)[name], equal_nan=True), name


@each("own, pairs", [("hull", "obb"), ("mesh", "obb"), ("obb", "hull")])
def test_an_effect_of_its_own_accuracy(own: str, pairs: str) -> None:
    scene, whole = mixed(pairs), mixed(own).check(EFFECTS)
    for name in EFFECTS:
        scene.set_effect(name, accuracy=own)
    report = scene.check(EFFECTS)
    assert distances(report) == distances(whole)
    found, known = (by_pair(one.pairs, one.separations) for one in (report, whole))
    assert all(found[pair] == known[pair] for pair in set(found) & set(known))
    assert own == "obb" or all(s >= 0.0 for pair, s in found.items() if pair not in known)


def test_a_budget_lowers_effects_with_their_pairs() -> None:
    scene = mixed("hull")
    scene.time_budget = 1e-9  # too little for anything above boxes
    report, boxes = scene.check(EFFECTS), mixed("obb").check(EFFECTS)
    assert report.behind
    assert report.separations.tolist() == boxes.separations.tolist()
    assert report.clearances.distances.tolist() == boxes.clearances.distances.tolist()


def ring_and_others(accuracy: str = "mesh") -> oc.Scene:
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


def test_each_row_says_its_level() -> None:
    scene = ring_and_others()
    scene.set_accuracy("crate", "obb")
    report = scene.check("sweep")
    found = report.accuracies_of("clearance")
    assert by_pair(report.clearances.pairs, found) == {
        (0, 1): MESH, (0, 2): OBB, (0, 3): MESH, (1, 2): OBB, (1, 3): HULL, (2, 3): OBB
    }  # fmt: skip
    for effect in ("separations", "contacts"):
        assert report.accuracies_of(effect).tolist() == report.accuracies.tolist() == [MESH]
    predicted = report.swept.predicted.pairs.tolist()
    assert [0, 3] in predicted
    levels = {(0, 3): MESH, (1, 3): HULL, (2, 3): OBB}
    assert report.accuracies_of("sweep").tolist() == [levels[i, j] for i, j in predicted]
    assert report.accuracies_of("points").tolist() == [MESH, HULL, OBB, HULL]
    assert not found.flags.writeable
    scene.set_effect("contacts", "off")
    for effect in ("nothing", "contacts", "sweep"):
        with pytest.raises(ValueError, match="effect"):
            scene.check().accuracies_of(effect)
    for accuracy in ("aabb", "obb"):
        report = ring_and_others(accuracy).check("sweep")
        for effect in ("separations", "contacts", "clearance", "points"):
            rows = len(next(iter(vars(report.result(effect)).values())))
            assert report.accuracies_of(effect).tolist() == [OBB] * rows != []
        rows = len(report.swept.passed) + len(report.swept.predicted)
        assert report.accuracies_of("sweep").tolist() == [OBB] * rows
