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

"""The levels of accuracy: none misses what a more exact one reports; each object at its own."""

from __future__ import annotations

import gc
import weakref
from typing import Any

import numpy as np
import pytest
from each import each
from mesh_zoo import zoo
from numpy.typing import NDArray
from scenes import builds, random_poses
from scipy.spatial.transform import Rotation

import obb_collision as oc
from obb_collision.queries.verdict.coarse import bounds_may_collide, spheres_may_collide
from obb_collision.shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Hull, Mesh, Shape, Sphere
from tools.cases.families import FAMILIES, generate

#: Pairs of each of the 16 families.
PAIRS = 2000
COARSE = ("sphere", "aabb")
FINE = ("hull", "mesh")
ZOO = zoo()
MESHES = ("sphere1", "torus1", "star1", "bumpy1", "hull1", "open_sphere1", "sheet1", "hollow1",
          "crumbs1", "annulus2", "cone0", "moebius", "triangle", "capsule1")  # fmt: skip
UPRIGHT = [0.0, 0.0, 0.0, 1.0]
SEPARATE = oc.Verdict.SEPARATE
Keys = set[tuple[int, int]]


def keys(pairs: NDArray[np.int64]) -> Keys:
    return set(map(tuple, pairs.tolist()))


@each("name", FAMILIES)
def test_a_coarse_level_never_misses_what_obb_reports(name: str) -> None:
    a, b = generate(name, PAIRS, seed=11)
    boxes = oc.Boxes(*(np.concatenate(both) for both in zip(a, b, strict=True)))
    first, second = np.arange(PAIRS), np.arange(PAIRS, 2 * PAIRS)
    reported = oc.verdicts(boxes[first], boxes[second]) != SEPARATE
    assert reported.any()
    assert not (reported & ~spheres_may_collide(boxes, first, second)).any()
    assert not (reported & ~spheres_may_collide(boxes, second, first)).any()
    assert not (reported & ~bounds_may_collide(boxes, first, second)).any()


def some_shapes(rng: np.random.Generator) -> list[Shape | oc.OBB]:
    """Return 14 meshes, their hulls, boxes and primitives."""
    scales = rng.uniform(0.6, 1.4, (2, len(MESHES), 3))
    turn = Rotation.random(None, rng).as_matrix()
    return [
        *(Mesh(*ZOO[name], scale=s) for name, s in zip(MESHES, scales[0], strict=True)),
        *(Hull(ZOO[name][0], scale=s) for name, s in zip(MESHES, scales[1], strict=True)),
        *(Box(rng.uniform(0.1, 1.0, 3)), Box([0.5, 0.0, 0.8]), Sphere(rng.uniform(0.1, 0.4))),
        oc.OBB(rng.uniform(-0.2, 0.2, 3), turn, rng.uniform(0.05, 0.5, 3)),
        *(Sphere(0.2, scale=[1.0, 0.5, 2.0]), Sphere(0.2, scale=[1.5, 1.5, 1.5])),
        *(Capsule(0.1, 0.5), Capsule(0.2, 0.3, scale=[1.0, 1.0, 2.0]), Cone(0.3, 0.6)),
        *(Cylinder(0.3, 0.9), Ellipsoid(rng.uniform(0.1, 0.4, 3))),
    ]


def mixed_scene(count: int, seed: int, **options: Any) -> oc.Scene:
    rng = np.random.default_rng(seed)
    shapes, scene = some_shapes(rng), oc.Scene(**options)
    for k, pose in enumerate(random_poses(count, rng, 0.32 * count ** (1 / 3))):
        scene.add(f"{k}", shapes[k % len(shapes)], pose)
    return scene


@each("seed", range(2))
def test_every_level_of_a_scene_reports_what_the_exacter_ones_do(seed: int) -> None:
    scene = mixed_scene(500, seed)
    reported: dict[str, Keys] = {}
    for name in (*COARSE, "obb", *FINE):
        scene.accuracy = name
        report = scene.check()
        reported[name] = keys(report.pairs)
        assert report.pairs.tolist() == sorted(report.pairs.tolist())
        assert report.accuracies.max() == oc.Accuracy[name.upper()]
        assert (report.verdicts != SEPARATE).all()
        if name == "hull":
            assert report.verdicts[report.accuracies > oc.Accuracy.OBB].max() == oc.Verdict.TOUCHING
    assert reported["mesh"] < reported["hull"] < reported["obb"]
    assert reported["obb"] < reported["aabb"]
    assert reported["obb"] < reported["sphere"]
    assert len(reported["mesh"]) < 0.8 * len(reported["obb"])
    assert len(reported["sphere"]) < 3 * len(reported["obb"])
    for name in ("obb", "mesh"):
        exact = mixed_scene(500, seed, accuracy=name, exact=True).check()
        assert set() < keys(exact.pairs) <= reported[name]


def ring_and_rod(**options: Any) -> oc.Scene:
    """Put a rod through the hole of a torus: only their boxes and their hulls collide."""
    scene = oc.Scene(**options)
    scene.add("ring", Mesh(*ZOO["torus0"]))
    scene.add("rod", Box([0.1, 0.1, 2.0]))
    return scene


def levels(scene: oc.Scene) -> list[oc.Accuracy]:
    return [oc.Accuracy(level) for level in scene.check().accuracies]


def test_a_pair_is_decided_on_the_lower_level_of_its_objects() -> None:
    scene = ring_and_rod(accuracy="mesh")
    assert levels(scene) == []
    scene.set_accuracy("rod", "hull")
    assert levels(scene) == [oc.Accuracy.HULL]
    for level in (*COARSE, "obb"):
        scene.add("rod", Box([0.1, 0.1, 2.0]), accuracy=level)
        assert levels(scene) == [oc.Accuracy[level.upper()]]
    scene.accuracy = "hull"
    assert levels(scene) == [oc.Accuracy.OBB]  # the rod keeps its own
    scene.set_accuracy("rod", None)
    assert levels(scene) == [scene.accuracy] == [oc.Accuracy.HULL]
    scene.accuracy = "mesh"
    scene.add("rod", Mesh([[0, 0, 0]], []))  # points without triangles
    assert levels(scene) == [oc.Accuracy.OBB]


def test_rods_side_by_side_meet_as_spheres_and_askew_as_boxes_along_the_axes_too() -> None:
    scene = oc.Scene()
    scene.add("a", Box([2.0, 0.2, 0.2]))
    beside, askew = [0.0, 1.0, 0.0, *UPRIGHT], [1.6, 0.3, 0.0, 0.0, 0.0, 0.38, 0.92]
    for pose, reported in ((beside, COARSE[:1]), (askew, COARSE)):
        scene.add("b", Box([2.0, 0.2, 0.2]), pose)
        for level in (*COARSE, "obb"):
            scene.accuracy = level
            assert len(scene.check()) == (level in reported)


def test_padded_meshes_are_decided_by_their_distance_and_others_by_their_hulls() -> None:
    scene = ring_and_rod()
    scene.set_effect("clearance", accuracy="mesh", max_distance=1.0)
    gap = float(scene.check("clearance").clearances.distances[0])
    assert 0.25 < gap < 0.3
    for padding, expected in ((0.49 * gap, []), (0.51 * gap, [oc.Accuracy.MESH])):
        scene.accuracy, scene.padding = "mesh", padding
        assert levels(scene) == expected
    scene.accuracy = "hull"
    assert levels(scene) == [oc.Accuracy.HULL]
    scene = oc.Scene(accuracy="mesh", padding=0.01)
    scene.add("ball", Sphere(0.5))
    for shape in (Cylinder(0.2, 0.5), Hull(ZOO["hull1"][0])):
        scene.add("other", shape)
        assert levels(scene) == [oc.Accuracy.HULL]


def test_trees_are_built_only_when_asked_for_and_once_a_shape(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    built = builds(monkeypatch)
    scene = oc.Scene()
    ring = Mesh(*ZOO["torus0"])
    for k in range(40):
        scene.add(f"ring {k}", ring, [0.1 * k, 0, 0, *UPRIGHT])
        scene.add(f"rod {k}", Box([0.1, 0.1, 2.0]), [0.1 * k, 0, 0, *UPRIGHT])
    for level in (*COARSE, "obb"):
        scene.accuracy = level
        assert len(scene.check()) > 0
    assert built == []
    scene.accuracy = "mesh"
    scene.check()
    scene.move("ring 0", [0.05, 0, 0, *UPRIGHT])
    scene.check()
    assert sorted(name for name, _ in built) == ["box_tree", "mesh_tree"]
    scene.accuracy = "hull"
    scene.check()
    kinds = sorted(name for name, _ in built)
    assert kinds == ["box_corners", "box_tree", "hull_mesh", "mesh_tree"]


def test_trees_of_shapes_that_are_gone_go_too() -> None:
    scene = oc.Scene(accuracy="mesh")
    scene.add("rod", Box([0.1, 0.1, 2.0]))
    rings = []
    for k in range(5):
        ring = Mesh(*ZOO["torus0"], scale=[1.0 + k, 1, 1])
        rings.append(weakref.ref(ring))
        scene.add("ring", ring)
        scene.check()
    del ring
    gc.collect()
    assert [ring() is None for ring in rings] == [True] * 4 + [False]


@each("wrong", ["box", "OBB", 7, -1, None, True, 2.5, "hull", "mesh", 6])
def test_find_pairs_refuses_other_levels_and_names_the_choices(wrong: Any) -> None:
    boxes = oc.Boxes(np.zeros((1, 3)), np.eye(3)[None], np.ones((1, 3)))
    with pytest.raises(ValueError, match="sphere, aabb, obb"):
        oc.find_pairs(boxes, accuracy=wrong)


def test_a_scene_refuses_what_is_no_level() -> None:
    with pytest.raises(ValueError, match=r"obb, hull, mesh, got 'triangles'$"):
        oc.Scene(accuracy="triangles")
    for former in ("obb_faces", "obb_tree"):
        with pytest.raises(ValueError, match=f"got '{former}': use obb or hull instead"):
            oc.Scene(accuracy=former)
    scene = ring_and_rod()
    with pytest.raises(ValueError, match="accuracy must be one of"):
        scene.add("new", Box([1, 1, 1]), accuracy="fine")
    assert "new" not in scene
    with pytest.raises(ValueError, match="accuracy must be one of"):
        scene.accuracy = "fine"
    with pytest.raises(KeyError, match="nobody"):
        scene.set_accuracy("nobody", "mesh")
    assert scene.accuracy == oc.Accuracy.OBB


def test_spheres_and_capsules_are_decided_by_their_distances() -> None:
    rng = np.random.default_rng(3)
    scene = oc.Scene(accuracy="mesh")
    places = random_poses(200, rng, 1.5)
    radii, halves = rng.uniform(0.05, 0.4, 200), np.where(rng.random(200) < 0.5, 0.0, 0.3)
    for k, pose in enumerate(places):
        radius, scale = radii[k] / (1.0 + k % 2), [1.0 + k % 2] * 3
        one = Capsule(radius, 2.0 * halves[k] / scale[0], scale) if halves[k] else None
        scene.add(f"{k}", one or Sphere(radius, scale), pose)
    axes = Rotation.from_quat(places[:, 3:]).as_matrix()[:, :, 2] * halves[:, None]
    capsules = oc.Capsules(places[:, :3] - axes, places[:, :3] + axes, radii)
    i, j = np.triu_indices(200, 1)
    gaps = oc.clearances(capsules[i], capsules[j]).distances
    assert np.abs(gaps).min() > 1e-12
    report = scene.check()
    assert report.pairs.tolist() == np.stack([i, j], axis=1)[gaps < 0.0].tolist()
    assert (report.verdicts == oc.Verdict.OVERLAP).all()
    assert (report.accuracies == oc.Accuracy.MESH).all()


def test_spheres_in_the_corners_of_boxes_are_free_and_padding_counts() -> None:
    scene = oc.Scene(accuracy="mesh")
    scene.add("box", Box([1.0, 1.0, 1.0]))
    near = 0.5 + 0.25 * np.sqrt(1.0 / 3.0)  # of the corner: as far as the radius
    scene.add("ball", Sphere(0.25), [near + 1e-3] * 3 + UPRIGHT)
    assert len(scene.check()) == 0
    scene.set_accuracy("ball", "obb")
    assert scene.check().names() == [("box", "ball")]
    scene.set_accuracy("ball", None)
    scene.move("ball", [near - 1e-3] * 3 + UPRIGHT)
    assert scene.check().verdicts.tolist() == [oc.Verdict.OVERLAP]
    scene.move("ball", [near + 1e-3] * 3 + UPRIGHT)
    scene.padding = 0.002
    assert levels(scene) == [oc.Accuracy.MESH]
    scene.padding = 0.0
    scene.add("ball", Sphere(0.25), [0.75, 0.0, 0.0, *UPRIGHT])
    assert scene.check().verdicts.tolist() == [oc.Verdict.TOUCHING]  # rests on it
