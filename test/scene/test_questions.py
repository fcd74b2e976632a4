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

"""Questions to a scene: any collision, and what a body hits; the scene stays as it is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import trimesh
from each import each
from mesh_zoo import zoo
from scenes import builds, random_poses

import obb_collision as oc
from obb_collision.scene import questions

ZOO = zoo()


def random_scene(seed: int, count: int, **options: object) -> oc.Scene:
    rng = np.random.default_rng(seed)
    scene = oc.Scene(**options)  # type: ignore[arg-type]
    for k in range(count):
        shape = (
            oc.shapes.Box(rng.uniform(0.2, 1.0, 3)), oc.shapes.Sphere(0.4),
            oc.shapes.Cylinder(0.3, 0.8), oc.shapes.Mesh(*ZOO["torus0"]),
        )[k % 4]  # fmt: skip
        scene.add(f"{k}", shape, random_poses(1, rng, 1.5)[0])
    return scene


@each("accuracy", ["sphere", "aabb", "obb", "hull", "mesh"])
def test_any_collision_is_what_a_check_finds(accuracy: str) -> None:
    free = colliding = 0
    for seed in range(12):
        scene = random_scene(seed, 2 + seed % 6, accuracy=accuracy)
        if seed % 2:
            scene.allow("0", "*")
        before = scene.any_collision()
        pairs = scene.check().names()
        assert before == scene.any_collision() == bool(pairs)
        free, colliding = free + (not before), colliding + before
        scene.allow("*", "*")
        assert not scene.any_collision()
    assert colliding, "no scene that collides was tried"
    assert free, "no scene that is free was tried"


def test_the_first_pair_ends_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    tested: list[int] = []
    decide = questions.decide_pairs

    def counted(store: Any, cache: Any, pairs: Any, *rest: Any) -> Any:
        tested.append(len(pairs))
        return decide(store, cache, pairs, *rest)

    monkeypatch.setattr(questions, "decide_pairs", counted)
    crowd = oc.Scene()
    for k in range(300):
        crowd.add(f"{k}", oc.shapes.Box([1, 1, 1]))
    crowd.allow("0", "1")
    assert crowd.any_collision()
    assert 1 <= sum(tested) <= 16
    assert not oc.Scene().any_collision()


@each("accuracy", ["sphere", "aabb", "obb", "hull", "mesh"])
def test_a_body_hits_what_it_collides_with_as_an_object(accuracy: str) -> None:
    rng = np.random.default_rng(3)
    scene = random_scene(5, 24, accuracy=accuracy)
    shapes: list[oc.shapes.Shape | oc.OBB] = [
        oc.OBB([0.1, 0, 0], np.eye(3), [0.3, 0.2, 0.4]), oc.shapes.Sphere(0.5),
        oc.shapes.Mesh(*ZOO["torus1"]),
    ]  # fmt: skip
    hits = 0
    for k in range(12):
        shape, pose, padding = shapes[k % 3], random_poses(1, rng, 1.5)[0], 0.05 * (k % 2)
        found = scene.query(shape, pose, padding=padding)
        scene.add("body", shape, pose, padding=padding)
        pairs = scene.check().names()
        expected = {a if b == "body" else b for a, b in pairs if "body" in (a, b)}
        scene.remove("body")
        assert set(found) == expected
        assert scene.query(shape, pose, padding=padding, ignore=found[:1]) == found[1:]
        assert scene.query(shape, pose, padding=padding, ignore="*") == []
        hits += len(found)
    assert hits > 10


def test_a_question_leaves_the_scene_as_it_is() -> None:
    scene = random_scene(7, 16, accuracy="mesh")  # as many as there is room for at first
    report = scene.check()
    names, boxes = scene.names, scene.boxes
    assert scene.query(oc.shapes.Box([9, 9, 9])) == names
    assert scene.check() is report
    assert scene.names == names
    assert scene.boxes == boxes
    assert len(scene) == 16
    scene.move("3", [50, 0, 0, 0, 0, 0, 1])
    scene.query(oc.shapes.Box([9, 9, 9]))
    anew = oc.Scene(accuracy="mesh")
    for name in names:
        anew.add(name, scene.objects.shape_of(name), scene.pose(name))
    assert scene.check().pairs.tolist() == anew.check().pairs.tolist()


def test_the_tree_of_a_body_is_built_once(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = oc.Scene(accuracy="mesh")
    scene.add("box", oc.shapes.Box([1, 1, 1]))
    meshes = [oc.shapes.Mesh(trimesh.creation.box((9, 9, 9 + k))) for k in range(17)]
    made = builds(monkeypatch)

    def built(*bodies: oc.shapes.Mesh) -> list[Any]:
        made.clear()
        for body in bodies:
            assert scene.query(body) == scene.query(body) == ["box"]
        return [body for name, body in made if name == "mesh_tree"]

    assert built(*meshes[1:]) == meshes[1:]  # as many as are retained
    assert built(oc.shapes.Mesh(meshes[1].vertices, meshes[1].faces)) == []
    assert built(meshes[0], meshes[2]) == [meshes[0]]  # one too many: the oldest is dropped
    assert built(meshes[1]) == [meshes[1]]
    scene.clear()
    scene.add("box", oc.shapes.Box([1, 1, 1]))
    assert built(meshes[1]) == [meshes[1]]


def test_a_body_is_checked_as_an_object_is() -> None:
    scene = random_scene(8, 3)
    for arguments, match in (
        ({"shape": 3}, "shape"), ({"pose": [1]}, "pose"), ({"padding": -1.0}, "padding"),
        ({"accuracy": "x"}, "accuracy"), ({"ignore": [3]}, "ignore"),
        ({"pose": [0] * 7}, "zero quaternion"),
    ):  # fmt: skip
        with pytest.raises((ValueError, TypeError), match=match):
            scene.query(**{"shape": oc.shapes.Sphere(1.0), **arguments})  # type: ignore[arg-type]
    assert len(scene) == 3
    scene.set_enabled("0", False)
    assert scene.query(oc.shapes.Box([9, 9, 9])) == ["1", "2"]


def test_poses_are_those_given_and_a_scene_shows_itself() -> None:
    scene = oc.Scene(accuracy="mesh")
    assert repr(scene) == "Scene(0 objects, accuracy 'mesh')"
    scene.add("a", oc.shapes.Sphere(1.0), [1, 2, 3, 0, 0, 0.6, 0.8])
    pose = scene.pose("a")
    assert pose.tolist() == [1, 2, 3, 0, 0, 0.6, 0.8]
    pose[:] = 0.0
    assert scene.pose("a")[0] == 1.0
    with pytest.raises(KeyError, match="no object named 'b'"):
        scene.pose("b")
