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

"""Levels of accuracy: none misses what a more exact one reports, whatever the shape or its size."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from each import each
from mesh_zoo import zoo
from numpy.typing import NDArray
from scenes import builds, random_poses
from scipy.spatial.transform import Rotation
from support import refused
from trimesh import creation

import obb_collision as oc
from obb_collision.geometry.trees import hull_tree, mesh_tree
from obb_collision.queries.verdict.coarse import bounds_may_collide, spheres_may_collide
from obb_collision.scene.effects import EFFECTS
from obb_collision.shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Hull, Mesh, Shape, Sphere
from tools.cases.families import FAMILIES, generate

PAIRS = 2000
"""Of each of the 16 families."""
LEVELS = ("sphere", "aabb", "obb", "hull", "mesh")
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
    for name in LEVELS:
        scene.accuracy = name
        report = scene.check()
        reported[name] = keys(report.pairs)
        assert report.pairs.tolist() == sorted(report.pairs.tolist())
        assert report.accuracies.max() == oc.Accuracy[name.upper()]
        assert (report.verdicts != SEPARATE).all()
        if name == "hull":
            assert report.verdicts[report.accuracies > oc.Accuracy.OBB].max() == oc.Verdict.TOUCHING
    assert reported["mesh"] < reported["hull"] < reported["obb"]
    assert reported["obb"] < reported["aabb"] & reported["sphere"]
    assert reported["sphere"] - reported["aabb"]
    assert reported["aabb"] - reported["sphere"]
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
    for level in LEVELS[:3]:
        scene.add("rod", Box([0.1, 0.1, 2.0]), accuracy=level)
        assert levels(scene) == [oc.Accuracy[level.upper()]]
    scene.accuracy = "hull"
    assert levels(scene) == [oc.Accuracy.OBB]  # the rod keeps its own
    scene.set_accuracy("rod", None)
    assert levels(scene) == [scene.accuracy] == [oc.Accuracy.HULL]
    scene.accuracy = "mesh"
    scene.add("rod", Mesh([[0, 0, 0]], []))  # points without triangles
    assert levels(scene) == [oc.Accuracy.OBB]
    scene = oc.Scene(accuracy="mesh", padding=0.01)
    scene.add("ball", Sphere(0.5))
    for shape in (Cylinder(0.2, 0.5), Hull(ZOO["hull1"][0])):
        scene.add("other", shape)
        assert levels(scene) == [oc.Accuracy.HULL], "padded, without a mesh"


def test_trees_are_built_only_on_demand_and_once_a_shape(monkeypatch: pytest.MonkeyPatch) -> None:
    built, ring, scene = builds(monkeypatch), Mesh(*ZOO["torus0"]), oc.Scene()
    for k in range(40):
        scene.add(f"ring {k}", ring, [0.1 * k, 0, 0, *UPRIGHT])
        scene.add(f"rod {k}", Box([0.1, 0.1, 2.0]), [0.1 * k, 0, 0, *UPRIGHT])
    for level in LEVELS[:3]:
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


def test_what_is_no_level_is_refused() -> None:
    boxes = oc.Boxes(np.zeros((1, 3)), np.eye(3)[None], np.ones((1, 3)))
    for wrong in ("box", "OBB", 7, -1, None, True, 2.5, "hull", "mesh", 6):
        refused("sphere, aabb, obb", oc.find_pairs, boxes, accuracy=wrong)
    refused(r"obb, hull, mesh, got 'triangles'$", oc.Scene, accuracy="triangles")
    for former in ("obb_faces", "obb_tree"):
        refused(f"got '{former}': use obb or hull instead", oc.Scene, accuracy=former)
    scene = ring_and_rod()
    refused("accuracy must be one of", scene.add, "new", Box([1, 1, 1]), accuracy="fine")
    assert "new" not in scene
    refused("accuracy must be one of", setattr, scene, "accuracy", "fine")
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


TETRAHEDRON = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
#: Shapes that reach just as far as they are given.
SIZED: dict[str, Callable[[float], Shape]] = {
    "mesh": lambda s: Mesh(TETRAHEDRON * s, FACES),
    "mesh scaled": lambda s: Mesh(TETRAHEDRON, FACES, scale=[s, s, s]),
    "mesh in a corner": lambda s: Mesh((1.0 - 1e-3 * TETRAHEDRON) * s, FACES),
    "triangle": lambda s: Mesh(TETRAHEDRON[:3] * s, FACES[:1]),
    "hull": lambda s: Hull((2.0 * TETRAHEDRON - 1.0) * s),
    "flat hull": lambda s: Hull(TETRAHEDRON[:3] * s),
    "cylinder": lambda s: Cylinder(0.5 * s, s),
    "cone": lambda s: Cone(0.5 * s, s),
    "sphere": lambda s: Sphere(s),
    "sphere stretched": lambda s: Sphere(1.0, scale=[s, 0.5 * s, s]),
    "capsule": lambda s: Capsule(0.5 * s, s),
    "ellipsoid": lambda s: Ellipsoid([0.3 * s, s, 0.5 * s]),
    "box": lambda s: Box([s, s, s]),
}
TORUS = Mesh(*ZOO["torus1"])
#: The first of each kind.
SHAPES = {type(shape).__name__: shape for shape in [make(0.5) for make in SIZED.values()][::-1]}


@each("name", oc.shapes.__all__)
@each("accuracy", oc.Accuracy)
def test_a_shape_has_every_effect_at_every_level(name: str, accuracy: oc.Accuracy) -> None:
    if name in ("Shape", "Cloud"):  # the name of them all; and ``test_cloud_pairs`` has clouds
        return
    scene = oc.Scene(accuracy=accuracy)
    scene.obstacle_points = np.zeros((1, 3))
    scene.set_effect("clearance", max_distance=10.0)
    scene.add("one", SHAPES[name])
    for other, shape in (("box", Box([0.5, 0.5, 0.5])), ("same", SHAPES[name]), ("torus", TORUS)):
        scene.add(other, shape, [0.05, 0.1, 0.02, 0.0, 0.0, 0.6, 0.8])
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


@each("shape", [*[f(0.5) for f in SIZED.values()], Hull(TETRAHEDRON[:1]), Hull(np.eye(3)[:2])])
def test_a_shape_is_drawn_as_what_fills_its_box(shape: Shape) -> None:
    pytest.importorskip("rclpy")
    from obb_collision.demo.snapshot import triangles_of

    vertices, faces, scale, closed, *_ = triangles_of(shape)
    corners = (vertices * scale)[faces]
    center, rotation, half_extents = shape.local_box
    local = (corners.reshape(-1, 3) - center) @ rotation
    assert (np.abs(local) <= half_extents + 1e-9).all()
    assert (np.abs(local).max(axis=0) >= 0.97 * half_extents - 1e-9).all()
    if closed:
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        out = np.einsum("nk,nk->n", normals, corners.mean(axis=1) - center)
        assert (out > 0.0).all()


@cache
def all_meshes() -> tuple[list[Mesh], oc.MeshTrees]:
    """Return meshes, large ones and small ones, and their trees."""
    meshes = [Mesh(vertices * s, faces) for s in (1.0, 0.15) for vertices, faces in ZOO.values()]
    trees = [oc.MeshTrees.build(mesh.vertices, mesh.faces) for mesh in meshes]
    return meshes, oc.MeshTrees.join(trees)


@each("spread, seed", [(0.3, 1), (0.6, 2), (1.0, 3)])
def test_no_level_misses_what_an_exacter_one_reports(spread: float, seed: int, pairs: int) -> None:
    """On 66 meshes, solids within solids included; meshes by themselves, too."""
    assert len(ZOO) >= 60
    meshes, trees = all_meshes()
    count, rng = 2 * pairs, np.random.default_rng(seed)
    kinds = rng.integers(0, len(meshes), 2 * count)
    poses = random_poses(2 * count, rng, spread)
    side = int(np.ceil(count ** (1 / 3)))
    cells = np.array(np.unravel_index(np.arange(2 * count) // 2, [side] * 3)).T
    poses[:, :3] += 16.0 * cells  # no pair is near another
    scene = oc.Scene()
    for k, kind in enumerate(kinds):
        scene.add(f"{k}", meshes[kind], poses[k])
    reported = {}
    for level in LEVELS:
        scene.accuracy = level
        report = scene.check()
        assert (report.pairs[:, 0] + 1 == report.pairs[:, 1]).all()
        reported[level] = np.zeros(count, np.bool_)
        reported[level][report.pairs[:, 0] // 2] = True
    placed = oc.PlacedMeshes.from_poses(trees, kinds, poses)
    rows = np.arange(2 * count).reshape(-1, 2)
    quick = oc.verdicts(placed, placed, rows, effort=0) != oc.Verdict.SEPARATE
    assert 0.01 < quick.mean() < reported["hull"].mean() < reported["obb"].mean() < 0.99
    assert not (quick & ~reported["hull"]).any()
    verdicts = oc.verdicts(placed, placed, rows)
    found = np.flatnonzero(verdicts != oc.Verdict.SEPARATE)
    assert np.flatnonzero(reported["mesh"]).tolist() == found.tolist()
    assert report.verdicts.tolist() == verdicts[found].tolist()
    for fine, coarse in (("hull", "obb"), ("obb", "aabb"), ("obb", "sphere")):
        assert not (reported[fine] & ~reported[coarse]).any()


def odd_meshes() -> dict[str, tuple[NDArray[np.float64], NDArray[np.int64]]]:
    """Return what files hold, all of it within a metre of the origin."""
    corners, faces = np.array(creation.box().vertices), np.array(creation.box().faces)
    line = np.array([[0.0, 0, 0], [1, 0, 0], [0.3, 0, 0]])
    rng = np.random.default_rng(2)
    return {
        "one triangle": (corners, faces[:1]),
        "a point thrice": (np.zeros((3, 3)), np.array([[0, 1, 2]])),
        "one vertex": (np.zeros((1, 3)), np.array([[0, 0, 0]])),
        "no area": (line, np.array([[0, 1, 2]] * 5)),
        "every face twice": (corners, np.concatenate([faces, faces])),
        "double-sided": (corners, np.concatenate([faces, faces[:, ::-1]])),
        "a fin": (corners, np.concatenate([faces, [[0, 1, 7]]])),
        "a hole": (corners, faces[1:]),
        "soup": (corners[faces].reshape(-1, 3), np.arange(36).reshape(-1, 3)),
        "flat and not": (corners, np.concatenate([faces, [[0, 0, 1], [2, 2, 2]]])),
        "slivers": (corners + 1e-12 * rng.normal(size=(8, 3)), np.repeat(faces, 20, axis=0)),
        "unused vertices": (np.concatenate([corners, 1e6 + corners]), faces),
        "thin": (corners * [1.0, 1.0, 1e-14], faces),
        "inside out": (corners, faces[:, ::-1]),
    }


@each("name, mesh", odd_meshes().items())
@each("level", LEVELS)
def test_odd_meshes_collide_only_where_they_are(name: str, mesh: Any, level: str) -> None:
    odd, scene = Mesh(*mesh), oc.Scene(accuracy=level)
    scene.add(name, odd)
    scene.add("far", Mesh(*ZOO["torus1"]), [0, 0, 4.0, 0, 0, 0, 1])
    scene.add("ball", Mesh(*ZOO["sphere2"]), [5.0, 0, 0, 0, 0, 0, 1])
    assert scene.check().names() == []
    corner = odd.vertices[odd.faces[0]].mean(axis=0)
    scene.move("ball", [*(corner + 0.2), 0, 0, 0, 1])
    assert scene.check().names() == [(name, "ball")]
    scene.move(name, [3.0, 0, 0, 0, 0, 0, 1])
    assert scene.check().names() == []


def test_huge_meshes_are_decided_on_every_level(pairs: int) -> None:
    """20,480 triangles; with ``--pairs`` of 10,000 or more 1.3 million."""
    part = creation.icosphere(subdivisions=8 if pairs >= 10_000 else 5, radius=0.5)
    ball = Mesh(part.vertices, part.faces, fit="aabb")
    for level in LEVELS:
        scene = oc.Scene(accuracy=level)
        scene.add("a", ball)
        scene.add("b", ball, [0.8, 0.1, 0, 0, 0, 0, 1])
        scene.add("cup", Mesh(*ZOO["open_sphere1"]), [0, 0, 3.0, 0, 0, 0, 1])
        assert scene.check().names() == [("a", "b")]
        scene.move("b", [1.2, 0.9, 0.9, 0, 0, 0, 1])
        assert scene.check().names() == []
        scene.move("b", [0.75, 0.75, 0, 0, 0, 0, 1])  # their boxes meet
        assert len(scene.check()) == (level not in ("hull", "mesh"))


PARTNERS = ("box", "mesh", "hull", "cylinder")


@cache
def shape(name: str, size: float) -> Shape:
    return SIZED[name](size)


@cache
def collisions(name: str, size: float, accuracy: str) -> set[tuple[str, str]]:
    """Return the pairs of a shape, and others where it is and in the farthest corner."""
    scene = oc.Scene(accuracy=accuracy)
    scene.add("one", shape(name, size))
    for partner in PARTNERS:
        scene.add(f"same/{partner}", shape(partner, size))
        scene.add(f"far/{partner}", shape(partner, size), [*[1e300] * 3, 0.5, 0.5, 0.5, 0.5])
    # warnings are errors, those of overflows among them
    report = scene.check(effects=["separations", "contacts", "clearance"])
    assert not any(cost.failures for cost in report.costs.values())
    return set(report.names())


@each("accuracy", ["obb", "hull", "mesh"])
@each("size", [1e300, 2.0**996, 2.0**-960, 3e-308])
def test_the_largest_and_smallest_shapes_get_a_verdict(size: float, accuracy: str) -> None:
    for name in SIZED:
        found = collisions(name, size, accuracy)
        assert ("one", f"same/{name}") in found or name not in PARTNERS
        if size in (2.0**996, 2.0**-960):  # scaled without any rounding: the same pairs
            both = found, collisions(name, 1.0, accuracy)
            same, expected = ({(a, b) for a, b in one if "far" not in a + b} for one in both)
            assert same == expected, name
            assert same, name


def test_vertices_that_no_face_uses_may_be_anywhere() -> None:
    stray = np.concatenate([[[-1e300, 0.0, 1e300]], TETRAHEDRON])
    mesh = Mesh(stray, FACES + 1, scale=[2.0, 2.0, 2.0])  # the stray one ends at 2e300
    scene = oc.Scene(accuracy="mesh")
    scene.add("mesh", mesh)
    scene.add("in it", Box([0.1, 0.1, 0.1]), [0.3, 0.3, 0.3, 0, 0, 0, 1])
    scene.add("beside", Box([0.1, 0.1, 0.1]), [1.5, 1.5, 1.5, 0, 0, 0, 1])
    assert scene.check().names() == [("mesh", "in it")]
    assert (mesh_tree(mesh).triangles == mesh_tree(Mesh(2 * TETRAHEDRON, FACES)).triangles).all()


def test_a_hull_may_stick_out_past_the_largest_coordinate_of_a_shape() -> None:
    tree = hull_tree(SIZED["hull"](1e300))
    assert 1e300 < np.abs(tree.triangles).max() < 1.001e300
    with pytest.raises(ValueError, match="1e\\+300"):
        oc.MeshTrees.build(1.001e300 * TETRAHEDRON, FACES)
