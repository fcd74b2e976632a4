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

"""Scene: what comes, moves and goes, and what a check says of it, by exact arithmetic."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import oracle
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import filled_scene
from scipy.spatial.transform import Rotation
from support import stored

import obb_collision as oc
from obb_collision.shapes import Box, Cylinder, Sphere

IDENTITY = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]


def check_report(scene: oc.Scene, exact: bool, disabled: frozenset[str] = frozenset()) -> None:
    """Compare the report of a scene with the oracle, pair by pair."""
    report, boxes, indices = scene.check(), scene.boxes, scene.indices
    i, j = np.triu_indices(len(boxes), 1)
    truth = oracle.verdicts(stored(boxes[i]), stored(boxes[j]))
    said = {tuple(pair): v for pair, v in zip(report.pairs.tolist(), report.verdicts, strict=True)}
    assert list(said) == sorted(said)
    for a, b, true in zip(indices[i].tolist(), indices[j].tolist(), truth, strict=True):
        verdict = said.pop((a, b), oc.Verdict.SEPARATE)
        if disabled & {scene.name(a), scene.name(b)}:
            assert verdict == oc.Verdict.SEPARATE
        else:
            assert verdict == true or (verdict == oc.Verdict.TOUCHING and not exact)
    assert not said
    assert np.isfinite(report.normals).all()
    np.testing.assert_allclose(np.linalg.norm(report.normals, axis=1), 1.0, rtol=0, atol=1e-15)


def random_pose(rng: np.random.Generator, spread: float) -> np.ndarray:
    """Return a pose on a dyadic grid or anywhere, square to the axes or turned."""
    position = rng.uniform(-spread, spread, 3)
    if rng.random() < 0.5:
        position = np.round(4.0 * position) / 4.0
    quaternion = rng.normal(size=4) if rng.random() < 0.5 else np.eye(4)[rng.integers(4)]
    return np.concatenate([position, quaternion])


def random_shape(rng: np.random.Generator) -> oc.shapes.Shape | oc.OBB:
    if rng.random() < 0.5:
        return Box(rng.integers(1, 5, 3) / 4.0)
    center, quaternion = rng.normal(size=3), rng.normal(size=4)
    return oc.OBB.from_quaternion(center, quaternion, rng.integers(0, 4, 3) / 4.0)


@pytest.mark.filterwarnings("ignore:.*far from unit length")
@settings(max_examples=7)
@given(st.integers(0, 2**32 - 1), st.booleans(), st.sampled_from([0, 60]))
def test_any_history_of_changes_is_what_exact_arithmetic_says(
    seed: int, exact: bool, many: int
) -> None:
    """Objects come, go, move, are replaced and left out; checks come in between."""
    rng = np.random.default_rng(seed)
    scene = oc.Scene(exact=exact)
    disabled: set[str] = set()
    for k in range(many):  # so many that one change is looked at by itself
        scene.add(f"far {k}", random_shape(rng), random_pose(rng, 6.0))
    for step in range(60):
        name = f"object {rng.integers(14)}"
        what = rng.integers(10)
        if what < 4 or name not in scene:
            scene.add(name, random_shape(rng), random_pose(rng, 1.5))
            disabled.discard(name)
        elif what < 6:
            scene.move(name, random_pose(rng, 1.5))
        elif what == 6:
            scene.remove(name)
            disabled.discard(name)
        elif what == 7:
            scene.move(scene.names, [random_pose(rng, 1.5) for _ in scene.names])
        elif what == 8:
            scene.set_enabled(name, name in disabled)
            disabled ^= {name}
        else:
            scene.padding = float(rng.choice([0.0, 0.25]))
        if step % 8 == 7 or (not many and step % 3 == 0):
            check_report(scene, exact, frozenset(disabled))


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


def test_separations_are_those_of_the_pairs_alone_and_points_near_both_boxes() -> None:
    scene = filled_scene(200)
    report = scene.check()
    assert len(report) > 50
    for k, (a, b) in enumerate(report.names()):
        alone = scene.obb(a).separation(scene.obb(b))
        assert report.separations[k] == alone.gap
        assert (report.normals[k] == alone.axis).all()
        assert report.verdicts[k] == alone.verdict
        assert report.depths[k] == max(-alone.gap, 0.0)
        for name in (a, b):
            assert scene.obb(name).padded(0.05).contains(report.positions[k])


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


def test_a_box_follows_the_pose_of_its_object() -> None:
    scene = oc.Scene()
    local = oc.OBB([1, 2, 3], Rotation.from_rotvec([0.2, 0.1, 0.4]).as_matrix(), [1, 2, 3])
    turn = Rotation.from_rotvec([0.5, -1.0, 0.3])
    scene.add("a", local, [4, 5, 6, *turn.as_quat()])
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
def test_what_is_refused_changes_nothing(
    action: Callable[[oc.Scene], Any], error: type[Exception], message: str
) -> None:
    scene = filled_scene(5)
    before, poses = scene.check(), scene.objects.poses_of(scene.indices)
    with pytest.raises(error, match=message):
        action(scene)
    assert scene.check() is before
    assert len(scene) == 5
    assert scene.objects.poses_of(scene.indices).tobytes() == poses.tobytes()


def pile() -> oc.Scene:
    scene = oc.Scene(accuracy="hull")
    for k, shape in enumerate((Box([1, 1, 1]), Sphere(0.5), oc.shapes.Cone(0.5, 1.0))):
        scene.add(f"thing/{k}", shape, [0.4 * k, 0, 0, 0, 0, 0, 1])
    return scene


def test_a_name_that_is_taken_is_refused_where_asked() -> None:
    scene = pile()
    scene.add("new", Sphere(0.1), replace=False)
    with pytest.raises(ValueError, match=r"name must be new, as replace is False, got 'new'"):
        scene.add("new", Sphere(0.2), replace=False)
    assert scene.objects.shape_of("new") == Sphere(0.1)
    assert scene.add("new", Sphere(0.2)) == scene.index("new")


def test_a_rule_for_no_object_is_refused_where_asked() -> None:
    scene = pile()
    scene.allow("to come", "thing/*")
    rules = scene.rules.allowed
    for sides in (("thin/0", "thing/*"), ("thing/*", ["thing/0", "thin/0"])):
        with pytest.raises(ValueError, match=r"got 'thin/0'; did you mean thing/0"):
            scene.allow(*sides, known=True)
    assert scene.rules.allowed == rules
    scene.allow("thing/[01]", "thing/2", known=True)
    assert scene.check().names() == [("thing/0", "thing/1")]


@each("copied", [copy.copy, copy.deepcopy, pickle.dumps])
@each("made", [oc.Scene, lambda: oc.RobotScene(oc.Robot.from_urdf(
    '<robot name="arm"><link name="hand"/></robot>'))])  # fmt: skip
def test_a_scene_is_not_copied(made: Callable[[], Any], copied: Callable[[Any], Any]) -> None:
    with pytest.raises(TypeError, match="Scene can be neither copied nor pickled"):
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
