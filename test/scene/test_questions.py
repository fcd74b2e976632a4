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

"""Questions to a scene: any collision, what a body hits, and what rays hit first."""

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
from obb_collision.shapes import Box, Cone, Cylinder, Hull, Mesh, Shape, Sphere

ZOO = zoo()


def random_scene(seed: int, count: int, **options: object) -> oc.Scene:
    rng = np.random.default_rng(seed)
    scene = oc.Scene(**options)  # type: ignore[arg-type]
    for k in range(count):
        shape = (
            Box(rng.uniform(0.2, 1.0, 3)), Sphere(0.4),
            Cylinder(0.3, 0.8), Mesh(*ZOO["torus0"]),
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
    given: Any = questions
    decide = given.colliding_pairs

    def counted(boxes: Any, pairs: Any, exact: bool) -> Any:
        tested.append(len(pairs))
        return decide(boxes, pairs, exact)

    monkeypatch.setattr(questions, "colliding_pairs", counted)
    crowd = oc.Scene()
    for k in range(300):
        crowd.add(f"{k}", Box([1, 1, 1]))
    crowd.allow("0", "1")
    assert crowd.any_collision()
    assert 1 <= sum(tested) <= 16
    assert not oc.Scene().any_collision()


@each("accuracy", ["sphere", "aabb", "obb", "hull", "mesh"])
def test_a_body_hits_what_it_collides_with_as_an_object(accuracy: str) -> None:
    rng = np.random.default_rng(3)
    scene = random_scene(5, 24, accuracy=accuracy)
    shapes: list[Shape | oc.OBB] = [
        oc.OBB([0.1, 0, 0], np.eye(3), [0.3, 0.2, 0.4]), Sphere(0.5),
        Mesh(*ZOO["torus1"]),
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
    assert scene.query(Box([9, 9, 9])) == names
    assert scene.check() is report
    assert scene.names == names
    assert scene.boxes == boxes
    assert len(scene) == 16
    scene.move("3", [50, 0, 0, 0, 0, 0, 1])
    scene.query(Box([9, 9, 9]))
    anew = oc.Scene(accuracy="mesh")
    for name in names:
        anew.add(name, scene.objects.shape_of(name), scene.pose(name))
    assert scene.check().pairs.tolist() == anew.check().pairs.tolist()


def test_the_tree_of_a_body_is_built_once(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = oc.Scene(accuracy="mesh")
    scene.add("box", Box([1, 1, 1]))
    meshes = [Mesh(trimesh.creation.box((9, 9, 9 + k))) for k in range(17)]
    made = builds(monkeypatch)

    def built(*bodies: Mesh) -> list[Any]:
        made.clear()
        for body in bodies:
            assert scene.query(body) == scene.query(body) == ["box"]
        return [body for name, body in made if name == "mesh_tree"]

    assert built(*meshes[1:]) == meshes[1:]  # as many as are retained
    assert built(Mesh(meshes[1].vertices, meshes[1].faces)) == []
    assert built(meshes[0], meshes[2]) == [meshes[0]]  # one too many: the oldest is dropped
    assert built(meshes[1]) == [meshes[1]]
    scene.clear()
    scene.add("box", Box([1, 1, 1]))
    assert built(meshes[1]) == [meshes[1]]


def test_a_body_is_checked_as_an_object_is() -> None:
    scene = random_scene(8, 3)
    for arguments, match in (
        ({"shape": 3}, "shape"), ({"pose": [1]}, "pose"), ({"padding": -1.0}, "padding"),
        ({"accuracy": "x"}, "accuracy"), ({"ignore": [3]}, "ignore"),
        ({"pose": [0] * 7}, "zero quaternion"),
    ):  # fmt: skip
        with pytest.raises((ValueError, TypeError), match=match):
            scene.query(**{"shape": Sphere(1.0), **arguments})  # type: ignore[arg-type]
    assert len(scene) == 3
    scene.set_enabled("0", False)
    assert scene.query(Box([9, 9, 9])) == ["1", "2"]


def test_poses_are_those_given_and_a_scene_shows_itself() -> None:
    scene = oc.Scene(accuracy="mesh")
    assert repr(scene) == "Scene(0 objects, accuracy 'mesh')"
    scene.add("a", Sphere(1.0), [1, 2, 3, 0, 0, 0.6, 0.8])
    pose = scene.pose("a")
    assert pose.tolist() == [1, 2, 3, 0, 0, 0.6, 0.8]
    pose[:] = 0.0
    assert scene.pose("a")[0] == 1.0
    with pytest.raises(KeyError, match="no object named 'b'"):
        scene.pose("b")


AHEAD = [[1.0, 0.0, 0.0]]


def ring_and_wall(**options: Any) -> oc.Scene:
    """Return a ring across the x axis, and a wall behind it."""
    scene = oc.Scene(**options)
    scene.add("ring", Mesh(*ZOO["torus0"]), [2, 0, 0, 0, 0.5**0.5, 0, 0.5**0.5])
    scene.add("wall", Box([1.0, 4.0, 4.0]), [5, 0, 0, 0, 0, 0, 1])
    return scene


def test_a_ray_goes_through_a_ring_and_hits_what_is_behind() -> None:
    """At obb the ring is a box; its hull has no hole either."""
    scene = ring_and_wall()
    for accuracy, name in (("obb", "ring"), ("hull", "ring"), ("mesh", "wall")):
        found = scene.cast_rays([[0, 0, 0]], AHEAD, accuracy=accuracy)
        assert scene.name(found.boxes[0]) == name
    assert found.distances[0] == pytest.approx(4.5)
    scene.accuracy = "mesh"
    np.testing.assert_array_equal(scene.cast_rays([[0, 0, 0]], AHEAD).boxes, found.boxes)
    assert scene.cast_rays([[0, 0, 0]], AHEAD, 4.0).boxes.tolist() == [-1]
    hit = scene.cast_rays([[0, 0, 0.4]], AHEAD)
    assert scene.name(hit.boxes[0]) == "ring"
    assert hit.distances[0] == pytest.approx(1.95, abs=0.01)


def test_a_padded_ring_has_a_hole_yet() -> None:
    scene = ring_and_wall(accuracy="mesh", padding=0.1)
    origins = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.4], [2.0, 0.0, 0.4], [2.0, 0.0, 0.3]]
    found = scene.cast_rays(origins, AHEAD * 4)
    assert [scene.name(row) for row in found.boxes] == ["wall", "ring", "ring", "ring"]
    truth = [4.4, 2.0 - 0.05 - 0.1, 0.0, 0.0]
    np.testing.assert_allclose(found.distances, truth, atol=0.005)
    np.testing.assert_allclose(found.normals[1], [-1, 0, 0], atol=0.3)
    assert scene.name(scene.cast_rays(origins[:1], AHEAD, accuracy="hull").boxes[0]) == "ring"


@each("padding", [0.0, 0.07])
def test_coarser_is_never_later(padding: float) -> None:
    rng = np.random.default_rng(51)
    scene = oc.Scene(padding=padding)
    names = ["star0", "bumpy1", "hull1", "open_sphere1"]
    for n in range(24):
        vertices, faces = ZOO[names[n % 4]]
        shape = (Mesh(vertices, faces), Hull(vertices), Sphere(0.3), Box([0.3, 0.4, 0.5]))[n % 3]
        turn = rng.normal(size=4)
        scene.add(f"a/{n}", shape, [*rng.uniform(-3, 3, 3), *(turn / np.linalg.norm(turn))])
    origins, ways = rng.uniform(-5, 5, (2, 400, 3))
    found = [scene.cast_rays(origins, ways, accuracy=level) for level in ("obb", "hull", "mesh")]
    for coarse, fine in (found[:2], found[1:]):
        assert (coarse.distances <= fine.distances + 1e-9).all()
        assert (coarse.hits >= fine.hits).all()
    assert 0 < found[2].hits.sum() < found[0].hits.sum() < 400


def test_objects_that_move_or_go_are_hit_where_they_are() -> None:
    vertices, faces = ZOO["sphere2"]
    scene = oc.Scene(accuracy="mesh")
    scene.add("ball", Mesh(vertices, faces, fit="aabb"), [2, 0, 0, 0, 0, 0, 1])
    assert scene.cast_rays([[0, 0, 0]], AHEAD).distances[0] == pytest.approx(1.55, abs=0.01)
    scene.move("ball", [3, 0, 0, 0, 0, 0, 1])
    assert scene.cast_rays([[0, 0, 0]], AHEAD).distances[0] == pytest.approx(2.55, abs=0.01)
    scene.padding = 0.1
    assert scene.cast_rays([[0, 0, 0]], AHEAD).distances[0] == pytest.approx(2.45, abs=0.02)
    scene.padding = 0.0
    scene.remove("ball")
    assert not scene.cast_rays([[0, 0, 0]], AHEAD).hits.any()


def test_round_shapes_and_padding_are_exact_and_objects_can_be_chosen() -> None:
    scene = oc.Scene(accuracy="hull")
    scene.add("ball", Sphere(0.5), [3, 0, 0, 0, 0, 0, 1])
    scene.add("cone", Cone(1.0, 2.0), [6, 0, 0, 0, 0, 0, 1])
    scene.add("can", Cylinder(1.0, 2.0), [9, 0, 0, 0, 0, 0, 1], padding=0.25)
    at = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.75], [0.0, 0.6, 1.2], [0.0, 0.3, 0.0]]
    found = scene.cast_rays(at, AHEAD * 4)
    assert [scene.name(row) for row in found.boxes] == ["ball", "cone", "can", "ball"]
    edge = 9.0 - np.sqrt((1.0 + np.sqrt(0.25**2 - 0.2**2)) ** 2 - 0.6**2)
    truth = [2.5, 6.0 - 0.125, edge, 2.6]
    np.testing.assert_allclose(found.distances, truth, atol=1e-8)
    assert (found.distances <= truth).all()
    np.testing.assert_allclose(found.normals[0], [-1, 0, 0], atol=1e-9)
    chosen = scene.cast_rays(at, AHEAD * 4, objects=["c*"])
    assert [scene.name(row) for row in chosen.boxes] == ["cone", "cone", "can", "cone"]
    assert not scene.cast_rays(at, AHEAD * 4, objects=[]).hits.any()
    with pytest.raises(ValueError, match="objects must be names"):
        scene.cast_rays(at, AHEAD * 4, objects=[3])  # type: ignore[list-item]
