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

"""Scene: what comes, moves and goes, what a check says of it, and questions: bodies and rays."""

from __future__ import annotations

import copy
import pickle
import warnings
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

import numpy as np
import oracle
import pytest
import trimesh
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from mesh_zoo import zoo
from scenes import builds, counted, filled_scene, random_poses
from scipy.spatial.transform import Rotation
from support import refused, stored

import obb_collision as oc
from obb_collision.scene import checks
from obb_collision.shapes import Box, Cone, Cylinder, Hull, Mesh, Shape, Sphere

IDENTITY = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]


def random_pose(rng: np.random.Generator, spread: float) -> np.ndarray:
    """Return a pose on a dyadic grid or anywhere, square to the axes or turned."""
    position = rng.uniform(-spread, spread, 3)
    if rng.random() < 0.5:
        position = np.round(4.0 * position) / 4.0
    quaternion = rng.normal(size=4) if rng.random() < 0.5 else np.eye(4)[rng.integers(4)]
    return np.concatenate([position, quaternion])


def random_shape(rng: np.random.Generator) -> Shape | oc.OBB:
    if rng.random() < 0.5:
        return Box(rng.integers(1, 5, 3) / 4.0)
    center, quaternion = rng.normal(size=3), rng.normal(size=4)
    return oc.OBB.from_quaternion(center, quaternion, rng.integers(0, 4, 3) / 4.0)


@pytest.mark.filterwarnings("ignore:.*far from unit length")
@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.booleans(), st.sampled_from([14, 70]))
def test_pairs_are_those_of_exact_arithmetic(seed: int, exact: bool, count: int) -> None:
    """It holds after changes, too: test_changes.py shows that they leave a scene as built anew."""
    rng = np.random.default_rng(seed)
    scene = oc.Scene(exact=exact, padding=float(rng.choice([0.0, 0.25])))
    for k in range(count):
        scene.add(str(k), random_shape(rng), random_pose(rng, 0.6 * count ** (1 / 3)))
    out = rng.random(count) < 0.1
    for k in np.flatnonzero(out).tolist():
        scene.set_enabled(str(k), False)
    report, boxes, (i, j) = scene.check(), scene.boxes, np.triu_indices(count, 1)
    truth = oracle.verdicts(stored(boxes[i]), stored(boxes[j]))
    truth[out[i] | out[j]] = oc.Verdict.SEPARATE
    said = np.full((count, count), oc.Verdict.SEPARATE, np.int8)
    said[tuple(report.pairs.T)] = report.verdicts
    undecided = (said[i, j] == oc.Verdict.TOUCHING) & ~out[i] & ~out[j] & (not exact)
    assert ((said[i, j] == truth) | undecided).all()
    assert report.pairs.tolist() == sorted(report.pairs.tolist())
    assert len(report) == np.count_nonzero(said[i, j])
    np.testing.assert_allclose(np.linalg.norm(report.normals, axis=1), 1.0, rtol=0, atol=1e-15)


@pytest.mark.filterwarnings("ignore:.*far from unit length")
def test_axes_of_a_scene_stay_as_orthonormal_as_the_proof_needs() -> None:
    """A turned local box under a turned pose: boxes so made pass for those of a user."""
    rng = np.random.default_rng(3)
    scene = oc.Scene()
    for k in range(1000):
        scene.add(str(k), random_shape(rng), random_pose(rng, 1.0))
    turns = scene.boxes.rotations.astype(np.longdouble)
    defects = np.abs(np.einsum("nji,njk->nik", turns, turns) - np.eye(3))
    assert 0.0 < defects.max() <= 64.0 * 2.0**-53  # what the proof of the verdicts allows


def test_resting_contact_counts_and_its_point_lies_between() -> None:
    scene = oc.Scene()
    scene.add("table", Box([2.0, 2.0, 0.5]), [0, 0, -0.25, 0, 0, 0, 1])
    scene.add("cup", Cylinder(0.125, 0.25), [0.5, 0.5, 0.125, 0, 0, 0, 1])
    report = scene.check()
    assert report.names() == [("table", "cup")]
    assert report.verdicts.tolist() == [oc.Verdict.TOUCHING]
    assert report.separations.tolist() == [0.0]
    assert report.normals.tolist() == [[0.0, 0.0, 1.0]]
    assert report.positions[0, 2] == 0.0
    assert np.abs(report.positions[0, :2] - 0.5).max() <= 0.125


def test_an_unchanged_scene_is_not_computed_again() -> None:
    scene = filled_scene(50)
    report = scene.check()
    assert scene.check() is report
    scene.move("box/3", IDENTITY)
    moved = scene.check()
    assert moved is not report
    scene.move("box/3", IDENTITY)
    assert scene.check() is moved


def test_a_box_follows_the_pose_of_its_object_which_is_that_given() -> None:
    scene = oc.Scene(accuracy="mesh")
    assert repr(scene) == "Scene(0 objects, accuracy 'mesh')"
    local = oc.OBB([1, 2, 3], Rotation.from_rotvec([0.2, 0.1, 0.4]).as_matrix(), [1, 2, 3])
    turn = Rotation.from_rotvec([0.5, -1.0, 0.3])
    scene.add("a", local, [4, 5, 6, *turn.as_quat()])
    pose = scene.pose("a")
    assert pose.tolist() == [4, 5, 6, *turn.as_quat()]
    pose[:] = 0.0
    assert scene.pose("a")[0] == 4.0
    with pytest.raises(KeyError, match="no object named 'b'"):
        scene.pose("b")
    world = scene.obb("a")
    assert np.allclose(world.center, turn.apply([1, 2, 3]) + np.array([4, 5, 6]), atol=1e-14)
    assert np.allclose(world.rotation, turn.as_matrix() @ local.rotation, atol=1e-14)
    assert (world.half_extents == [1, 2, 3]).all()


def test_indices_are_stable_and_used_again() -> None:
    scene = oc.Scene()
    indices = [scene.add(f"o{k}", Sphere(1.0)) for k in range(40)]
    assert indices == list(range(40))
    scene.remove("o7")
    assert "o7" not in scene
    assert len(scene) == 39
    assert scene.index("o8") == 8
    assert scene.add("again", Sphere(1.0)) == 7
    assert scene.name(7) == "again"
    assert scene.add("o8", Sphere(2.0)) == 8
    scene.clear()
    assert len(scene) == 0
    assert len(scene.check()) == 0


BOX = Box([1, 1, 1])
REFUSED: list[tuple[Callable[[oc.Scene], Any], type[Exception], str]] = [
    (lambda s: s.move("nobody", IDENTITY), KeyError, "nobody"),
    (lambda s: s.remove("nobody"), KeyError, "nobody"),
    (lambda s: s.set_enabled("nobody", True), KeyError, "nobody"),
    (lambda s: s.move(["box/0", "nobody"], [IDENTITY] * 2), KeyError, "nobody"),
    (lambda s: s.move_indices([0, 99], [IDENTITY] * 2), KeyError, "99"),
    (lambda s: s.objects.set_enabled([0], [[True, False]]), ValueError, "enabled must have the"),
    (lambda s: s.move_indices([0.5], [IDENTITY]), ValueError, "integers"),
    (lambda s: s.move_indices([0, 1], [IDENTITY]), ValueError, "one row per object"),
    (lambda s: s.move("box/0", [0] * 7), ValueError, "zero quaternion"),
    (lambda s: s.move("box/0", [np.nan] * 7), ValueError, "finite"),
    (lambda s: s.move(["box/0", "box/1"], [IDENTITY, [0.0] * 7]), ValueError, "quaternion.*1"),
    (lambda s: s.move(["box/0", "box/1"], [IDENTITY, [1e301] * 7]), ValueError, "1e.300.*1"),
    (lambda s: s.add("new", BOX, [0] * 7), ValueError, "zero quaternion"),
    (lambda s: s.add("new", BOX, padding=-1.0), ValueError, "padding"),
    (lambda s: s.add(3, BOX), ValueError, "name must be a string"),  # type: ignore[arg-type]
    (lambda s: setattr(s, "padding", -1.0), ValueError, "padding must not be negative"),
]


@each("action, error, message", REFUSED)
def test_what_is_refused_changes_nothing(action: Any, error: Any, message: str) -> None:
    scene = filled_scene(5)
    before, poses = scene.check(), scene.objects.poses_of(scene.indices)
    with pytest.raises(error, match=message):
        action(scene)
    assert scene.check() is before
    assert len(scene) == 5
    assert scene.objects.poses_of(scene.indices).tobytes() == poses.tobytes()


def pile() -> oc.Scene:
    scene = oc.Scene(accuracy="hull")
    for k, shape in enumerate((Box([1, 1, 1]), Sphere(0.5), Cone(0.5, 1.0))):
        scene.add(f"thing/{k}", shape, [0.4 * k, 0, 0, 0, 0, 0, 1])
    return scene


def test_a_name_that_is_taken_and_a_rule_for_no_object_are_refused_where_asked() -> None:
    scene = pile()
    scene.add("new", Sphere(0.1), replace=False)
    reason = r"name must be new, as replace is False, got 'new'"
    refused(reason, scene.add, "new", Sphere(0.2), replace=False)
    assert scene.objects.shape_of("new") == Sphere(0.1)
    assert scene.add("new", Sphere(0.2)) == scene.index("new")
    scene.remove("new")
    scene.allow("to come", "thing/*")
    rules = scene.rules.allowed
    for sides in (("thin/0", "thing/*"), ("thing/*", ["thing/0", "thin/0"])):
        refused(r"got 'thin/0'; did you mean thing/0", scene.allow, *sides, known=True)
    assert scene.rules.allowed == rules
    scene.allow("thing/[01]", "thing/2", known=True)
    assert scene.check().names() == [("thing/0", "thing/1")]


def pickled_scene() -> oc.Scene:
    """Return a scene with a bit of everything."""
    scene = oc.Scene(padding=0.01, accuracy="hull", max_pairs=50)
    rng = np.random.default_rng(3)
    for k in range(30):
        shape = [Sphere(0.2), oc.shapes.Cylinder(0.1, 0.4), oc.shapes.Hull(rng.normal(size=(8, 3)))]
        place = [*rng.uniform(-1, 1, 3), *rng.normal(size=4)]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            scene.add(f"thing/{k}", shape[k % 3], place, padding=0.02 if k % 4 == 0 else None)
    scene.remove("thing/7")
    scene.allow("thing/1*", "thing/2*")
    scene.check_only([("thing/*", "thing/*")])
    scene.rules.allowed_within = ["other"]
    scene.set_effect("clearance", max_distance=0.3, objects="thing/1*")
    scene.objects.padding_overrides = [("thing/3", 0.1)]
    scene.region = oc.regions.Region([-9, -9, -9], [0.5, 9, 9], halo=1.0)
    scene.check(["contacts"])
    return scene


def answers(scene: oc.Scene) -> list[Any]:
    report = scene.check(["contacts", "clearance"])
    values = [report.pairs, report.depths, report.clearances.distances]
    return [report.names(), scene.names, *(value.tobytes() for value in values)]


def test_a_pickled_scene_gives_the_same_bit_for_bit_in_another_process() -> None:
    scene = pickled_scene()
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        there = pool.submit(answers, scene).result()
    assert there == answers(scene)
    again = pickle.loads(pickle.dumps(scene))
    assert answers(again) == there
    assert again.rules.allowed == scene.rules.allowed
    assert again.effects["clearance"] == scene.effects["clearance"]
    assert pickle.loads(pickle.dumps(oc.Scene(time_budget=0.5))).time_budget == 0.5
    again.move("thing/0", [9, 9, 9, 0, 0, 0, 1])
    assert answers(scene) == there
    again.add("thing/7", Sphere(0.1))
    assert again.index("thing/7") == 7


@each("copied", [copy.copy, copy.deepcopy])
@each("made", [oc.Scene, lambda: oc.RobotScene(oc.Robot.from_urdf(
    '<robot name="arm"><link name="hand"/></robot>'))])  # fmt: skip
def test_a_scene_is_not_copied(made: Callable[[], Any], copied: Callable[[Any], Any]) -> None:
    with pytest.raises(TypeError, match="Scene cannot be copied: create another, or pickle it"):
        copied(made())


def test_effects_are_read_only_and_the_next_check_has_them_as_they_were() -> None:
    scene = pile()
    scene.obstacle_points = np.zeros((3, 3))
    effects = ["separations", "contacts", "clearance", "sweep", "points"]
    scene.check(effects)
    report = scene.check(effects)
    tables = [report.result(effect) for effect in effects]
    tables += [report.swept.passed, report.swept.predicted]
    arrays = [value for each in tables for value in vars(each).values() if hasattr(value, "flags")]
    full = [array for array in arrays if array.size]
    assert len(full) > 15
    assert not any(array.flags.writeable for array in full)


ZOO = zoo()
RING = Mesh(*ZOO["torus0"])
LEVELS = [level.label for level in oc.Accuracy]


def random_scene(seed: int, count: int, **options: object) -> oc.Scene:
    rng = np.random.default_rng(seed)
    scene = oc.Scene(**options)  # type: ignore[arg-type]
    for k in range(count):
        shapes = Box(rng.uniform(0.2, 1.0, 3)), Sphere(0.4), Cylinder(0.3, 0.8), RING
        scene.add(f"{k}", shapes[k % 4], random_poses(1, rng, 1.5)[0])
    return scene


@each("accuracy", LEVELS)
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
    tested = counted(monkeypatch, checks, "colliding_pairs", 1)
    crowd = oc.Scene()
    for k in range(300):
        crowd.add(f"{k}", Box([1, 1, 1]))
    crowd.allow("0", "1")
    assert crowd.any_collision()
    assert 1 <= sum(tested) <= 16
    assert not oc.Scene().any_collision()


@each("accuracy", LEVELS)
def test_a_body_hits_what_it_collides_with_as_an_object(accuracy: str) -> None:
    rng = np.random.default_rng(3)
    scene = random_scene(5, 24, accuracy=accuracy)
    box = oc.OBB([0.1, 0, 0], np.eye(3), [0.3, 0.2, 0.4])
    shapes: list[Shape | oc.OBB] = [box, Sphere(0.5), Mesh(*ZOO["torus1"])]
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
    assert (scene.names, len(scene), scene.boxes == boxes) == (names, 16, True)
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


AHEAD = [[1.0, 0.0, 0.0]]


def ring_and_wall(**options: Any) -> oc.Scene:
    """Return a ring across the x axis, and a wall behind it."""
    scene = oc.Scene(**options)
    scene.add("ring", RING, [2, 0, 0, 0, 0.5**0.5, 0, 0.5**0.5])
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
    refused("objects must be names", scene.cast_rays, at, AHEAD * 4, objects=[3])
