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

"""The levels of accuracy: none misses what a more exact one reports; off is free."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from hypothesis import given
from hypothesis import strategies as st
from mesh_zoo import zoo
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import obb_collision as oc
from obb_collision.geometry.trees import pool
from obb_collision.queries.verdict.coarse import bounds_may_collide, spheres_may_collide
from obb_collision.queries.verdict.verdict import SEPARATE
from tools.cases.families import FAMILIES, generate

#: Pairs of each of the 16 families: 104,000 in all.
PAIRS = 6500
COARSE = ("sphere", "aabb")
FINE = ("hull", "mesh")
ZOO = zoo()
MESHES = ("sphere1", "torus1", "star1", "bumpy1", "hull1", "open_sphere1", "sheet1", "hollow1",
          "crumbs1", "annulus2", "cone0", "moebius", "triangle", "capsule1")  # fmt: skip
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
    exact = oc.verdicts(boxes[first], boxes[second], exact=True) != SEPARATE
    assert not (exact & ~bounds_may_collide(boxes, first, second)).any()


def test_coarse_levels_tell_some_pairs_apart() -> None:
    a, b = generate("ordinary scene", PAIRS, seed=11)
    boxes = oc.Boxes(*(np.concatenate(both) for both in zip(a, b, strict=True)))
    found = {name: len(oc.find_pairs(boxes, accuracy=name)) for name in (*COARSE, "obb")}
    assert found["obb"] < found["aabb"] < 3 * found["obb"]
    assert found["obb"] < found["sphere"] < 3 * found["obb"]


@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(0, 60),
    size=st.sampled_from([1e-6, 1.0, 1e5]),
    grid=st.booleans(),
)
def test_find_pairs_keeps_the_order_of_the_levels(
    seed: int, count: int, size: float, grid: bool
) -> None:
    rng = np.random.default_rng(seed)
    centers, extents = rng.uniform(-2.0, 2.0, (count, 3)), rng.uniform(0.0, 1.0, (count, 3))
    rotations = Rotation.random(count, rng).as_matrix() if count else np.empty((0, 3, 3))
    if grid:  # resting contacts
        centers, extents = np.rint(2.0 * centers) / 2.0, np.rint(4.0 * extents) / 4.0
        rotations = np.broadcast_to(np.eye(3), (count, 3, 3))
    boxes = oc.Boxes(centers * size, rotations, extents * size)
    reported = keys(oc.find_pairs(boxes))
    for name in COARSE:
        pairs = oc.find_pairs(boxes, accuracy=name)
        assert pairs.tolist() == sorted(pairs.tolist())
        assert (pairs[:, 0] < pairs[:, 1]).all()
        assert reported <= keys(pairs)
    i, j = np.triu_indices(count, 1)
    meet = spheres_may_collide(boxes, i, j)
    assert keys(oc.find_pairs(boxes, accuracy="sphere")) == set(
        zip(i[meet].tolist(), j[meet].tolist(), strict=True)
    )


def shape(kind: int, rng: np.random.Generator) -> oc.shapes.Shape | oc.OBB:
    """Return one of 14 meshes, their hulls, boxes and primitives."""
    vertices, faces = ZOO[MESHES[kind % len(MESHES)]]
    if kind < 2 * len(MESHES):
        scale = rng.uniform(0.6, 1.4, 3)
        if kind < len(MESHES):
            return oc.shapes.Mesh(vertices, faces, scale=scale)
        return oc.shapes.Hull(vertices, scale=scale)
    rotation = Rotation.random(None, rng).as_matrix()
    others: list[oc.shapes.Shape | oc.OBB] = [
        oc.shapes.Box(rng.uniform(0.1, 1.0, 3)),
        oc.OBB(rng.uniform(-0.2, 0.2, 3), rotation, rng.uniform(0.05, 0.5, 3)),
        oc.shapes.Box([0.5, 0.0, 0.8]),
        oc.shapes.Sphere(0.4),
        oc.shapes.Cylinder(0.3, 0.9),
    ]
    return others[kind % len(others)]


def poses(count: int, rng: np.random.Generator, spread: float) -> NDArray[np.float64]:
    quaternions = Rotation.random(count, rng).as_quat()
    return np.concatenate([rng.uniform(-spread, spread, (count, 3)), quaternions], axis=1)


def mixed_scene(count: int, seed: int, **options: object) -> oc.Scene:
    rng = np.random.default_rng(seed)
    shapes = [shape(kind, rng) for kind in range(2 * len(MESHES) + 5)]
    scene = oc.Scene(**options)  # type: ignore[arg-type]
    for k, pose in enumerate(poses(count, rng, 0.32 * count ** (1 / 3))):
        scene.add(f"{k}", shapes[k % len(shapes)], pose)
    return scene


@each("seed", range(3))
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
    assert reported["mesh"] < reported["hull"] < reported["obb"]
    for name in COARSE:
        assert reported["obb"] < reported[name]


def test_mesh_verdicts_of_a_scene_are_those_of_the_mesh_queries() -> None:
    rng = np.random.default_rng(5)
    names = [name for name in MESHES if len(ZOO[name][1])]
    trees = oc.MeshTrees.join([oc.MeshTrees.build(*ZOO[name]) for name in names])
    shapes = [oc.shapes.Mesh(*ZOO[name]) for name in names]
    where = poses(150, rng, 1.2)
    kinds = np.arange(150) % len(names)
    scene = oc.Scene(accuracy="mesh")
    for k in range(150):
        scene.add(f"{k}", shapes[kinds[k]], where[k])
    bodies = oc.PlacedMeshes.from_poses(trees, kinds, where)
    i, j = np.triu_indices(150, 1)
    expected = oc.verdicts(bodies, bodies, np.stack([i, j], axis=1))
    hit = expected != SEPARATE
    report = scene.check()
    assert report.pairs.tolist() == np.stack([i[hit], j[hit]], axis=1).tolist()
    assert report.verdicts.tolist() == expected[hit].tolist()
    assert len(report) > 50


@each("name", [*COARSE, *FINE])
def test_incremental_checks_find_what_a_check_from_scratch_finds(name: str) -> None:
    rng = np.random.default_rng(8)
    scene = mixed_scene(300, 8, accuracy=name)
    scene.check()
    levels = [None, *oc.Accuracy]
    for step in range(12):
        moved = rng.choice(300, 3, replace=False)
        scene.move_indices(moved, poses(3, rng, 2.0))
        if step % 3 == 0:
            scene.set_accuracy(str(moved[0]), levels[step % len(levels)])
        if step == 5:
            scene.set_enabled(str(moved[1]), False)
        report = scene.check()
        scene.padding, scene.padding = 0.5, 0.0  # all count as changed
        again = scene.check()
        assert report.pairs.tolist() == again.pairs.tolist()
        assert report.accuracies.tolist() == again.accuracies.tolist()
        assert report.verdicts.tolist() == again.verdicts.tolist()


def ring_and_rod(**options: object) -> oc.Scene:
    """Put a rod through the hole of a torus: only their boxes and their hulls collide."""
    scene = oc.Scene(**options)  # type: ignore[arg-type]
    scene.add("ring", oc.shapes.Mesh(*ZOO["torus0"]))
    scene.add("rod", oc.shapes.Box([0.1, 0.1, 2.0]))
    return scene


def test_a_pair_is_decided_on_the_lower_level_of_its_objects() -> None:
    scene = ring_and_rod(accuracy="mesh")
    assert len(scene.check()) == 0
    scene.set_accuracy("rod", "hull")
    report = scene.check()
    assert (len(report), report.accuracies.tolist()) == (1, [oc.Accuracy.HULL])
    for level in (*COARSE, "obb"):
        scene.add("rod", oc.shapes.Box([0.1, 0.1, 2.0]), accuracy=level)
        assert scene.check().accuracies.tolist() == [oc.Accuracy[level.upper()]]
    scene.accuracy = "hull"
    assert scene.check().accuracies.tolist() == [oc.Accuracy.OBB]  # the rod keeps its own
    scene.set_accuracy("rod", None)
    assert scene.check().accuracies.tolist() == [oc.Accuracy.HULL]
    assert scene.accuracy == oc.Accuracy.HULL


def test_points_without_triangles_stay_on_obb() -> None:
    scene = ring_and_rod(accuracy="mesh")
    scene.add("rod", oc.shapes.Mesh([[0, 0, 0]], []))
    assert scene.check().accuracies.tolist() == [oc.Accuracy.OBB]


def test_padded_meshes_are_decided_by_their_distance() -> None:
    scene = ring_and_rod()
    scene.set_effect("clearance", accuracy="mesh", max_distance=1.0)
    gap = float(scene.check("clearance").clearances.distances[0])
    assert 0.25 < gap < 0.3
    for padding, levels in ((0.49 * gap, []), (0.51 * gap, [oc.Accuracy.MESH])):
        scene.accuracy, scene.padding = "mesh", padding
        assert scene.check().accuracies.tolist() == levels
    scene.accuracy = "hull"
    assert scene.check().accuracies.tolist() == [oc.Accuracy.HULL]


def test_spheres_reach_further_than_boxes() -> None:
    scene = oc.Scene()
    scene.add("a", oc.shapes.Box([2.0, 2.0, 0.1]))
    scene.add("b", oc.shapes.Box([2.0, 2.0, 0.1]), [0, 0, 1.0, 0, 0, 0, 1])
    scene.add("c", oc.shapes.Box([2.0, 2.0, 0.1]), [0, 0, 2.0, 0, 0, 0, 1])
    for k in range(100):
        scene.add(f"far {k}", oc.shapes.Box([1, 1, 1]), [10.0 + 3 * k, 0, 0, 0, 0, 0, 1])
    assert len(scene.check()) == 0
    scene.set_accuracy("a", "sphere")
    assert scene.check().names() == [("a", "b"), ("a", "c")]
    scene.set_accuracy("a", None)
    assert len(scene.check()) == 0


def test_trees_are_built_only_when_asked_for_and_once_a_shape(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    built: list[str] = []

    def counted(name: str) -> None:
        build = getattr(pool, name)

        def count(*args: object) -> object:
            built.append(name)
            return build(*args)

        monkeypatch.setattr(pool, name, count)

    for name in ("mesh_tree", "box_tree", "hull_mesh"):
        counted(name)
    scene = oc.Scene()
    ring = oc.shapes.Mesh(*ZOO["torus0"])
    for k in range(40):
        scene.add(f"ring {k}", ring, [0.1 * k, 0, 0, 0, 0, 0, 1])
        scene.add(f"rod {k}", oc.shapes.Box([0.1, 0.1, 2.0]), [0.1 * k, 0, 0, 0, 0, 0, 1])
    for level in (*COARSE, "obb"):
        scene.accuracy = level
        assert len(scene.check()) > 0
    assert built == []
    scene.accuracy = "mesh"
    scene.check()
    scene.move("ring 0", [0.05, 0, 0, 0, 0, 0, 1])
    scene.check()
    assert sorted(built) == ["box_tree", "mesh_tree"]
    scene.accuracy = "hull"
    scene.check()
    assert sorted(built) == ["box_tree", "hull_mesh", "mesh_tree"]


def test_trees_of_shapes_that_are_gone_go_too() -> None:
    scene = ring_and_rod(accuracy="mesh")
    for k in range(5):
        scene.add("ring", oc.shapes.Mesh(*ZOO["torus0"], scale=[1.0 + k, 1, 1]))
        scene.check()
    assert len(scene._cache) == 2


def test_the_default_is_obb() -> None:
    scene = mixed_scene(200, 3)
    report = scene.check()
    assert (report.accuracies == oc.Accuracy.OBB).all()
    assert report.pairs.tolist() == [
        [scene.indices[i], scene.indices[j]] for i, j in oc.find_pairs(scene.boxes)
    ]


@each("wrong", ["box", "OBB", 7, -1, None, True, 2.5, "hull", "mesh", 6])
def test_find_pairs_refuses_other_levels_and_names_the_choices(wrong: object) -> None:
    boxes = oc.Boxes(np.zeros((1, 3)), np.eye(3)[None], np.ones((1, 3)))
    with pytest.raises(ValueError, match="sphere, aabb, obb"):
        oc.find_pairs(boxes, accuracy=wrong)  # type: ignore[arg-type]


def test_a_scene_refuses_what_is_no_level() -> None:
    with pytest.raises(ValueError, match=r"obb, hull, mesh, got 'triangles'$"):
        oc.Scene(accuracy="triangles")
    for former in ("obb_faces", "obb_tree"):
        with pytest.raises(ValueError, match=f"got '{former}': use obb or hull instead"):
            oc.Scene(accuracy=former)
    scene = ring_and_rod()
    with pytest.raises(ValueError, match="accuracy must be one of"):
        scene.add("new", oc.shapes.Box([1, 1, 1]), accuracy="fine")
    assert "new" not in scene
    with pytest.raises(ValueError, match="accuracy must be one of"):
        scene.accuracy = "fine"
    with pytest.raises(KeyError, match="nobody"):
        scene.set_accuracy("nobody", "mesh")
    assert scene.accuracy == oc.Accuracy.OBB


def test_exact_scenes_decide_boxes_and_triangles_by_integers() -> None:
    for level in ("obb", "mesh"):
        scene = mixed_scene(60, 9, accuracy=level, exact=True)
        loose = mixed_scene(60, 9, accuracy=level)
        assert keys(scene.check().pairs) <= keys(loose.check().pairs)
        assert len(scene.check()) > 0
