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

"""Scene: what comes, moves and goes, checked against finding all pairs from scratch."""

import numpy as np
import pytest
from each import each
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from scenes import filled_scene, random_poses
from scipy.spatial.transform import Rotation

import obb_collision as oc
from obb_collision.typing import Floats

IDENTITY = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]


def names_from_scratch(
    scene: oc.Scene, left_out: frozenset[str] = frozenset()
) -> set[frozenset[str]]:
    """Return the colliding pairs of names by testing every pair of boxes."""
    names, boxes = scene.names, scene.boxes
    rows = [(i, j) for i in range(len(names)) for j in range(i)]
    if not rows:
        return set()
    i, j = np.array(rows).T
    hits = oc.verdicts(boxes[i], boxes[j]) != oc.Verdict.SEPARATE
    pairs = {frozenset((names[a], names[b])) for (a, b), hit in zip(rows, hits, strict=True) if hit}
    return {pair for pair in pairs if not pair & left_out}


def names_of(report: oc.Report) -> set[frozenset[str]]:
    return {frozenset(pair) for pair in report.names()}


def test_a_check_finds_what_testing_all_pairs_finds() -> None:
    scene = filled_scene(200)
    report = scene.check()
    assert names_of(report) == names_from_scratch(scene)
    assert len(report) > 50
    keys = report.pairs[:, 0] * 1000 + report.pairs[:, 1]
    assert (np.diff(keys) > 0).all()
    assert (report.pairs[:, 0] < report.pairs[:, 1]).all()


def test_separations_are_those_of_the_pairs_alone() -> None:
    scene = filled_scene(100)
    report = scene.check()
    for k, (a, b) in enumerate(report.names()):
        alone = scene.obb(a).separation(scene.obb(b))
        assert report.separations[k] == alone.gap
        assert (report.normals[k] == alone.axis).all()
        assert report.verdicts[k] == alone.verdict
        assert report.depths[k] == max(-alone.gap, 0.0)


def test_the_point_of_a_pair_is_near_both_boxes() -> None:
    scene = filled_scene(200)
    report = scene.check()
    for point, (a, b) in zip(report.positions, report.names(), strict=True):
        for name in (a, b):
            grown = scene.obb(name).padded(0.05)
            assert grown.contains(point)


def test_resting_contact_counts_and_its_point_lies_between() -> None:
    scene = oc.Scene()
    scene.add("table", oc.shapes.Box([2.0, 2.0, 0.5]), [0, 0, -0.25, 0, 0, 0, 1])
    scene.add("cup", oc.shapes.Cylinder(0.125, 0.25), [0.5, 0.5, 0.125, 0, 0, 0, 1])
    report = scene.check()
    assert report.names() == [("table", "cup")]
    assert report.verdicts.tolist() == [oc.Verdict.TOUCHING]
    assert report.separations.tolist() == [0.0]
    assert report.normals.tolist() == [[0.0, 0.0, 1.0]]
    assert report.positions[0, 2] == 0.0
    assert np.abs(report.positions[0, :2] - 0.5).max() <= 0.125


def test_one_moved_object_gives_the_same_as_a_fresh_scene() -> None:
    scene = filled_scene(400)
    scene.check()
    rng = np.random.default_rng(9)
    for k, pose in enumerate(random_poses(15, rng, 4.0)):
        scene.move(f"box/{k % 7}", pose)
        report = scene.check()
        assert names_of(report) == names_from_scratch(scene)
        fresh = oc.Scene()
        for name in scene.names:
            fresh.add(name, scene.obb(name))
        again = fresh.check()
        assert (report.pairs == again.pairs).all()
        assert (report.separations == again.separations).all()
        assert (report.normals == again.normals).all()


def test_an_unchanged_scene_is_not_computed_again() -> None:
    scene = filled_scene(50)
    report = scene.check()
    assert scene.check() is report
    pose = IDENTITY
    scene.move("box/3", pose)
    moved = scene.check()
    assert moved is not report
    scene.move("box/3", pose)
    assert scene.check() is moved


def test_moves_by_name_and_by_index_agree() -> None:
    one, many, indexed = (filled_scene(30) for _ in range(3))
    poses = random_poses(30, np.random.default_rng(4), 2.0)
    names = one.names
    for name, pose in zip(names, poses, strict=True):
        one.move(name, pose)
    many.move_many(names, poses)
    indexed.move_indices(indexed.indices, poses)
    for scene in (many, indexed):
        assert (scene.boxes.centers == one.boxes.centers).all()
        assert (scene.boxes.rotations == one.boxes.rotations).all()


def test_a_box_follows_the_pose_of_its_object() -> None:
    scene = oc.Scene()
    local = oc.OBB([1, 2, 3], Rotation.from_rotvec([0.2, 0.1, 0.4]).as_matrix(), [1, 2, 3])
    turn = Rotation.from_rotvec([0.5, -1.0, 0.3])
    scene.add("a", local, [4, 5, 6, *turn.as_quat()])
    world = scene.obb("a")
    assert np.allclose(world.center, turn.apply([1, 2, 3]) + np.array([4, 5, 6]), atol=1e-14)
    assert np.allclose(world.rotation, turn.as_matrix() @ local.rotation, atol=1e-14)
    assert (world.half_extents == [1, 2, 3]).all()


def test_padding_of_the_scene_and_of_an_object() -> None:
    scene = oc.Scene(padding=0.25)
    scene.add("a", oc.shapes.Box([1, 1, 1]))
    scene.add("b", oc.shapes.Box([1, 1, 1]), padding=0.0)
    assert scene.obb("a").half_extents.tolist() == [0.75] * 3
    assert scene.obb("b").half_extents.tolist() == [0.5] * 3
    scene.padding = 0.5
    assert scene.obb("a").half_extents.tolist() == [1.0] * 3
    assert scene.obb("b").half_extents.tolist() == [0.5] * 3
    with pytest.raises(ValueError, match="padding must not be negative"):
        scene.padding = -1.0
    assert scene.padding == 0.5


def test_indices_are_stable_and_used_again() -> None:
    scene = oc.Scene()
    indices = [scene.add(f"o{k}", oc.shapes.Sphere(1.0)) for k in range(40)]
    assert indices == list(range(40))
    scene.remove("o7")
    assert "o7" not in scene
    assert len(scene) == 39
    assert scene.index("o8") == 8
    assert scene.add("again", oc.shapes.Sphere(1.0)) == 7
    assert scene.name(7) == "again"
    assert scene.add("o8", oc.shapes.Sphere(2.0)) == 8
    scene.clear()
    assert len(scene) == 0
    assert len(scene.check()) == 0


@each(
    "action, error, message",
    [
        (lambda s: s.move("nobody", IDENTITY), KeyError, "nobody"),
        (lambda s: s.remove("nobody"), KeyError, "nobody"),
        (lambda s: s.set_enabled("nobody", True), KeyError, "nobody"),
        (lambda s: s.move_many(["box/0", "nobody"], [IDENTITY] * 2), KeyError, "nobody"),
        (lambda s: s.move_indices([0, 99], [IDENTITY] * 2), KeyError, "99"),
        (lambda s: s.move_indices([0.5], [IDENTITY]), ValueError, "integers"),
        (lambda s: s.move_indices([0, 1], [IDENTITY]), ValueError, "one row per object"),
        (lambda s: s.move("box/0", [0] * 7), ValueError, "zero quaternion"),
        (lambda s: s.move("box/0", [np.nan] * 7), ValueError, "finite"),
        (lambda s: s.move_many(["box/0", "box/1"], [IDENTITY, [0] * 7]), ValueError, "row 1"),
        (lambda s: s.add("new", oc.shapes.Box([1, 1, 1]), [0] * 7), ValueError, "zero quaternion"),
        (lambda s: s.add("new", oc.shapes.Box([1, 1, 1]), padding=-1.0), ValueError, "padding"),
        (lambda s: s.add(3, oc.shapes.Box([1, 1, 1])), ValueError, "name must be a string"),
    ],
)
def test_what_is_refused_changes_nothing(action, error, message) -> None:  # type: ignore[no-untyped-def]
    scene = filled_scene(5)
    before = scene.check()
    with pytest.raises(error, match=message):
        action(scene)
    assert scene.check() is before
    assert len(scene) == 5


class SceneMachine(RuleBasedStateMachine):
    """Any sequence of calls leaves a scene that checks as if built from scratch."""

    def __init__(self) -> None:
        super().__init__()
        self.scene = oc.Scene()
        self.disabled: set[str] = set()

    poses = st.tuples(*[st.integers(-3, 3)] * 3, st.integers(0, 7))
    names = st.integers(0, 60).map(lambda k: f"n{k}")

    @staticmethod
    def pose(numbers: tuple[int, ...]) -> Floats:
        turn = Rotation.from_rotvec([0.0, 0.3 * numbers[3], 0.1 * numbers[3]])
        return np.array([*numbers[:3], *turn.as_quat()])

    @rule(name=names, pose=poses, size=st.integers(0, 4))
    def add(self, name: str, pose: tuple[int, ...], size: int) -> None:
        self.scene.add(name, oc.OBB(half_extents=[size + 0.5, 1.0, 0.5 * size]), self.pose(pose))
        self.disabled.discard(name)

    @rule(seed=st.integers(0, 9))
    def add_many(self, seed: int) -> None:
        for k, pose in enumerate(random_poses(50, np.random.default_rng(seed), 4.0)):
            self.scene.add(f"n{k}", oc.shapes.Sphere(0.5), pose)
            self.disabled.discard(f"n{k}")

    @precondition(lambda self: len(self.scene) > 0)
    @rule(data=st.data(), pose=poses)
    def move(self, data: st.DataObject, pose: tuple[int, ...]) -> None:
        self.scene.move(data.draw(st.sampled_from(self.scene.names)), self.pose(pose))

    @precondition(lambda self: len(self.scene) > 0)
    @rule(data=st.data())
    def remove(self, data: st.DataObject) -> None:
        name = data.draw(st.sampled_from(self.scene.names))
        self.scene.remove(name)
        self.disabled.discard(name)

    @precondition(lambda self: len(self.scene) > 0)
    @rule(data=st.data(), enabled=st.booleans())
    def enable(self, data: st.DataObject, enabled: bool) -> None:
        name = data.draw(st.sampled_from(self.scene.names))
        self.scene.set_enabled(name, enabled)
        (self.disabled.discard if enabled else self.disabled.add)(name)

    @rule(padding=st.sampled_from([0.0, 0.25, 1.0]))
    def pad(self, padding: float) -> None:
        self.scene.padding = padding

    @invariant()
    def same_as_from_scratch(self) -> None:
        expected = names_from_scratch(self.scene, frozenset(self.disabled))
        assert names_of(self.scene.check()) == expected


TestSceneMachine = SceneMachine.TestCase
TestSceneMachine.settings = settings(max_examples=30, stateful_step_count=20, deadline=None)
