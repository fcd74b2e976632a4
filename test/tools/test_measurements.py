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

"""Measurements on next to nothing: weight, goals, regions, effects of peers, robots; the soak."""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import oracle
import pytest
from each import each

from tools import goals

pytest.importorskip("rclpy")
import rig  # noqa: F401 - of this machine only

import obb_collision as oc
from obb_collision.benchmarks.corpora import Corpus, generated_corpus
from obb_collision.benchmarks.effects import measure_effects
from obb_collision.node.topics.topics import COLLISIONS
from obb_collision.scene_files import find_scene
from tools import latency, robots
from tools.cases.placement import rotations_of
from tools.clouds import __main__ as clouds
from tools.fuzz.process import Usage
from tools.peers import effects
from tools.peers.robots import PEERS, Case
from tools.regions import far_costs, measure
from tools.soak import __main__ as command
from tools.soak import world as worlds
from tools.soak.checker import Checker, Found, Result, pair_of, truth_of
from tools.weight import LIMITS, Project, figures, table


def test_goals_are_measured_and_one_that_fails_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    small: dict[str, object] = {"SIZES": (10, 20), "LARGE": (20, 30, 40)}
    small |= {"FORMS": ["uniform", "line"], "SHORT_TURNS": 3, "BOXES_TURNS": 3, "FORM_BOXES": 30}
    for name, value in small.items():
        monkeypatch.setattr(goals, name, value)

    def failing(self: object) -> Iterator[goals.Goal]:
        raise RuntimeError("no such thing")

    for part in ("node", "starts", "per_pair"):
        monkeypatch.setattr(goals.Goals, part, failing)
    page = tmp_path / "page.md"
    assert goals.main(["--seconds", "0.001", "--markdown", str(page)]) == 0
    text = page.read_text()
    found = [line for line in text.splitlines() if line.startswith("| ")][2:]
    assert len(found) == 6 + 2 + 4 + 1 + 3 + 3
    for goal in found:
        failed, absent = "no such thing" in goal, "not installed" in goal
        assert goal.endswith("| ? |") == (failed or absent), goal
    assert sum("no such thing" in goal for goal in found) == 3
    assert "10 boxes: move_indices, check, pairs read" in capsys.readouterr().out
    assert "| find_pairs, 20 boxes |" in text


def test_a_goal_of_the_node_is_measured_and_needs_an_answer_to_every_frame() -> None:
    rows = [
        {"way": way, "objects": objects, "median": 0.5, "95 %": 0.6, "99 %": 5.0, "longest": 9.0}
        for way, objects, *_ in goals.NODE
    ]
    assert [goal.met for goal in goals.node_goals(rows)] == [False, *[True] * 5]
    rows[0]["99 %"] = 2.0
    del rows[3]["median"]
    assert [goal.met for goal in goals.node_goals(rows)] == [True] * 3 + [False] + [True] * 2
    assert {way for way, *_ in goals.NODE} <= {*latency.WAYS}
    assert {objects for _, objects, *_ in goals.NODE} <= {*latency.SIZES, latency.OTHERS}
    table = goals.node_table(rows)
    assert table[1] == ["object_poses", "1,000", "0.500", "0.600", "2.00", "9.00"]
    assert table[4][2] == "no answer"


def test_what_is_near_is_a_part_and_nothing_is_near_to_what_is_far() -> None:
    costs = far_costs(400, seed=1, repeats=2)
    near = [costs[name]["near"] for name in ("1 of 1", "1 of 2", "1 of 4", "far")]
    assert near[0] == 400
    assert near == sorted(near, reverse=True)
    assert 200 < near[1] < 400
    assert near[3] == 0


@pytest.mark.slow  # test_regions_node.py shows that two regions find what one does
def test_two_processes_answer_for_what_one_does() -> None:
    rows = [measure(200, count, seconds=0.1, seed=1) for count in (1, 2)]
    assert [row["processes"] for row in rows] == [1, 2]
    for row in rows:
        assert row["pairs"] > 20
        assert row["samples"] >= 1
        assert row["CPU per state, all (ms)"] >= row["CPU per state, busiest process (ms)"]


#: Shapes of which hulls have few corners: those of many are simplified, which peers do not.
POINTED = {name: generated_corpus(0).shapes[name] for name in ("table", "jack", "chip")}


@pytest.mark.parametrize("peer", ["coal", "python-fcl", "MuJoCo"])
def test_effects_at_hull_and_mesh_are_those_of_peers(peer: str) -> None:
    """Within their tolerances; not depths of python-fcl, which are not least (docs/accuracy.md)."""
    pytest.importorskip({"coal": "coal", "python-fcl": "fcl", "MuJoCo": "mujoco"}[peer])
    corpus = Corpus("pointed", POINTED)
    rows = measure_effects(corpus, 150, 0.0, 5, lambda what: None, effects.installed)
    found = {(row.effect, row.name): row.differ for row in rows if row.name.startswith(peer)}
    for (effect, _), differ in found.items():
        if (peer, effect) != ("python-fcl", "contacts"):
            assert differ is not None
            assert differ < 1e-6
    assert len(found) == {"coal": 3, "python-fcl": 3, "MuJoCo": 2}[peer]


CONFIG = find_scene("tabletop").parent
SMALL = ["--boxes", "5", "--states", "50", "--compared", "100", "--motions", "5"]
ARM = ["--robot", str(CONFIG / "arm.urdf"), "--srdf", str(CONFIG / "arm.srdf")]


def test_it_writes_what_it_prints(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, page = tmp_path / "robots.json", tmp_path / "page.md"
    options = ["--packages", str(CONFIG), "--json", str(file), "--markdown", str(page)]
    oc.set_threads(3)
    try:
        assert robots.main([*SMALL, *ARM, *options]) == 0
        assert oc.threads() == 3
    finally:
        oc.set_threads(None)
    printed = capsys.readouterr().out
    assert "| us per state | 5 boxes | missed | false alarms |\n" in printed
    report = json.loads(file.read_text())
    rows = {row["checker"]: row for row in report["states"]}
    assert rows["this library"]["states_per_second"] > 0
    assert 0 <= rows["this library"]["colliding"] <= 1
    assert report["motions"][0]["missed"] == 0
    kinematics = {row["checker"]: row["states_per_second"] for row in report["kinematics"]}
    assert kinematics["this library"] > 0
    assert ("pinocchio" in kinematics) == (find_spec("pinocchio") is not None)
    assert all(line in page.read_text() for line in printed.splitlines())


def test_clouds_are_measured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tools.clouds.figures.FRAME", ((24, 32), 26.0))
    monkeypatch.setattr("shutil.which", lambda name: None)  # no peer is compiled
    page = tmp_path / "page.md"
    assert clouds.main(["--points", "3000", "--states", "20", "--markdown", str(page)]) == 0
    printed = capsys.readouterr().out
    assert printed.strip() in page.read_text()
    assert "| 3,000 points to a cloud in a scene |" in printed
    assert "| frame of 768 points, " in printed


@pytest.mark.parametrize("name", PEERS)
def test_peers_agree_where_they_are_there(name: str) -> None:
    pytest.importorskip({"pin": "pinocchio"}.get(PEERS[name][1], PEERS[name][1]))
    robot = oc.Robot.from_urdf(CONFIG / "arm.urdf", CONFIG / "arm.srdf", [CONFIG])
    rng = np.random.default_rng(3)
    objects = robots.random_boxes(8, rng)
    scene = oc.Scene()
    for one in objects:
        scene.add(one.name, one.shape, one.pose)
    checker = oc.RobotScene([robot], scene)
    case: Case = robots.case_of(robot, str(CONFIG / "arm.urdf"), objects, checker)
    states = robots.random_states(robot, 300, rng)
    ours, theirs = checker.check(states).colliding, PEERS[name][0](case)(states)
    assert not (theirs & ~ours).any()
    assert (ours != theirs).mean() < 0.02  # cylinders are prisms of many sides here
    assert 0.02 < ours.mean() < 0.98


@pytest.mark.slow  # each of three nodes is watched for seconds
def test_a_node_stops_a_robot_before_a_hand_that_a_camera_sees(tmp_path: Path) -> None:
    file = tmp_path / "camera.json"
    options = ["--packages", str(CONFIG), "--camera", "2", "--json", str(file)]
    assert robots.main([*ARM, *options]) == 0
    for row in json.loads(file.read_text())["camera"]:
        assert 0 < row["received"] <= row["sent"]
        assert 0 < row["hand to stop (ms)"] <= row["longest"]


@pytest.mark.slow  # test_state_validity.py shows that a node answers, this that it is measured
def test_a_node_answers_many_states(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "latency.json"
    options = ["--packages", str(CONFIG), "--latency", "10", "--json", str(file)]
    assert robots.main([*ARM, *options]) == 0
    row = json.loads(file.read_text())["latency"][0]
    assert (row["world"], row["states"], row["chunks"]) == ("30 boxes", 50, 10)
    assert 0.0 < row["median"] <= row["p99"] <= row["longest"]
    assert 0.0 < row["valid"] < 1.0
    assert "| 30 boxes | 50 | 10 |" in capsys.readouterr().out


PROJECT = {
    "obb_collision/api.py": '__all__ = ["a", "b", "c"]\n',
    "obb_collision/base.py": "class Base:\n    size: int\n\n    def grow(self):\n        pass\n",
    "obb_collision/scene.py": '''"""How scenes are."""
# a comment, and a blank line

import numpy as np


class Scene(Base):
    """Text,
    on two lines."""

    def __init__(self):
        self.padding, self._hidden = 0, """code
        on two lines"""

    def check(self):
        return np.hypot(
            1,

            2,
        )
''',
}


def counted(folder: Path, **more: str) -> dict[str, int | None]:
    """Return the figures of the small project, with more files: a module by its name."""
    parts = {"in_": "obb_collision/", "test_": "test/test_", "tool_": "tools/"}
    files = dict(PROJECT)
    for name, text in more.items():
        start = next(start for start in parts if name.startswith(start))
        files[f"{parts[start]}{name.removeprefix(start)}.py"] = text
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return figures(Project(folder, files))


def test_a_small_project_is_counted(tmp_path: Path) -> None:
    found = counted(tmp_path, tool_a="1\n2\n", test_a="1\n2\n3\n")
    assert found["lines of the package"] == 1 + 5 + 20
    assert found["its files"] == 3
    # of the scene: class, def, three of code, def, and five with a blank one inside brackets
    assert found["its lines of code"] == 1 + 4 + (1 + 1 + 2 + 1 + 4)
    assert (found["lines of tools/"], found["lines of tests"]) == (2, 3)
    assert found["public names"] == 3
    assert set(found) <= set(LIMITS)


LINES = "".join(f"    {number}\n" for number in range(100, 140))
NUMBA, RCLPY = (f"modules on inner parts of {name}" for name in ("numba", "rclpy"))


@each("row, text, more", [
    ("names with several definitions", "class Base: ...\nclass New: ...\n", 1),
    ("names with several definitions", "A, Base = 1, 2\ndef Scene(): ...\n", 2),
    ("names with several definitions", "_a = 1\nclass New:\n    Scene = 1\n", 0),
    ("functions above 40 lines", f"def f():\n{LINES}", 1),
    ("functions above 40 lines", f"def f():\n    \"\"\"Text,\n    more.\"\"\"\n{LINES[8:]}", 0),
    ("duplicates of ten lines", f"def f():\n{LINES[:80]}def g():\n{LINES[:80]}", 1),
    ("duplicates of ten lines", f"def f():\n{LINES[:80]}def g():\n{LINES[:72]}", 0),
    ("functions of ten or more arguments", "def f(a, b, c, d, e, f, g, h, *, i, j): ...\n", 1),
    ("functions of ten or more arguments", "def f(a, b, c, d, e, f, g, h, *, i): ...\n", 0),
    (NUMBA, "from numba.core import types, config\n", 0),
    (NUMBA, "import numba\nnumba.core.types.f8\n", 0),
    (NUMBA, "from numba.core import caching, types\n", 1),
    (NUMBA, "import numba\nnumba.core.caching\n", 1),
    (NUMBA, "from numba.extending import _Intrinsic\n", 1),
    (NUMBA, "import numba\ndef f(a): a._inner\n", 1),
    (NUMBA, "import numba\n_own = 1\ndef f(a): a._own\n", 0),
    (RCLPY, "import rclpy\ndef f(a): a._inner\n", 1),
    (RCLPY, "import rclpy\ngetattr(a, '_inner')\n", 1),
    (RCLPY, "def f(a): a._inner, a._replace()\n", 0),
])  # fmt: skip
def test_what_a_module_adds(tmp_path: Path, row: str, text: str, more: int) -> None:
    before = counted(tmp_path)[row]
    assert before is not None
    assert counted(tmp_path, in_new=text)[row] == before + more


ROOMS = ("arrows among the rooms of node", "circles of imports at run time")
TYPES = "circles by names of types only"


@each("inner, outer, found", [
    ("", "", (0, 0, 0)),
    ("from obb_collision.node.hall import a\n", "", (1, 0, 0)),
    ("from obb_collision.node import hall\n", "", (1, 0, 0)),
    ("from obb_collision.node.rooms.other import a\n", "", (0, 0, 0)),
    ("def f():\n    from obb_collision.node.hall import a\n", "{}", (2, 1, 0)),
    ("if TYPE_CHECKING:\n    from obb_collision.node.hall import a\n", "{}", (2, 0, 1)),
])  # fmt: skip
def test_arrows_and_circles(
    tmp_path: Path, inner: str, outer: str, found: tuple[int, int, int]
) -> None:
    outer = outer.format("from obb_collision.node.rooms.one import b\n")
    rooms = {"in_node/rooms/one": inner, "in_node/rooms/other": "a = 1\n"}
    values = counted(tmp_path, **rooms, **{"in_node/hall": outer})
    assert tuple(values[row] for row in (*ROOMS, TYPES)) == found


def test_what_tests_reach_into(tmp_path: Path) -> None:
    text = """
import obb_collision as oc
from obb_collision.scene import _private, Scene
from obb_collision.scene import check
class A:
    def test(self):
        self._own = Scene()._padding
"""
    found = counted(tmp_path, test_a=text, test_b="from obb_collision.scene import Scene\n")
    assert found["private names used in tests"] == 2
    assert found["modules that tests import from"] == 2


def test_figures_above_their_limits_are_marked() -> None:
    values: dict[str, int | None] = {"its files": 331, "public names": 35}
    plain = table(values)
    assert f"its files{331:>39}      310 *" in plain
    assert f"public names{35:>36}       35\n" in plain
    assert f"tests collected{'not counted':>33}    4,000\n" in plain


def rows(found: Found) -> np.ndarray:
    """Return rows as a node publishes them."""
    table = np.zeros(len(found), COLLISIONS.dtype)
    for row, (((ns_a, a), (ns_b, b)), depth) in enumerate(found.items()):
        table[row]["ns_a"], table[row]["id_a"] = ns_a, a
        table[row]["ns_b"], table[row]["id_b"] = ns_b, b
        table[row]["depth"] = depth
    return table


def right(bodies: worlds.Bodies) -> Found:
    keys, truth = list(bodies), truth_of(*worlds.rows_of(bodies))
    pairs = [pair_of(keys[i], keys[j]) for i, j in truth.pairs]
    return dict(zip(pairs, truth.depths.tolist(), strict=True))


@pytest.fixture
def checker() -> Checker:
    """Return a checker of 30 bodies, before the first step."""
    world = worlds.World(5, 30)
    world.apply(world.first())
    return Checker(world, Result(growth=1.0))


def test_answers_with_any_changes_of_a_step_are_right_if_they_are(checker: Checker) -> None:
    assert checker.judge(rows(right(checker.world.bodies)))
    for number in range(20):
        changes = checker.world.step()
        checker.begin(changes)
        bodies = dict(checker.world.bodies)
        for change in changes.values():
            assert not checker.judge(rows(right(bodies))), number
            change.apply(bodies)
        assert checker.judge(rows(right(bodies))), number
        checker.end()
        assert checker.judge(rows(right(checker.world.bodies)))
    assert checker.result.wrong == 0
    assert checker.result.checked > 60
    assert set(checker.result.bodies) == {"came", "went", "moved"}


def test_wrong_answers_are_found(checker: Checker) -> None:
    found = right(checker.world.bodies)
    first, depth = next(iter(found.items()))
    less = {pair: found[pair] for pair in found if pair != first}
    spoiled = [("missing", rows(less)), ("too many", rows(found | {((1, 1), (2, 2)): 0.1}))]
    for off in (1e-6, np.nan):
        spoiled.append(("wrong depth", rows(found | {first: depth + off})))
    spoiled.append(("twice", np.concatenate([rows(found), rows(found)[:1]])))
    for what, answer in spoiled:
        result = checker.result = Result(growth=1.0)
        checker.judge(answer)
        assert result.wrong == 1
        assert "1 wrong answers" in result.faults()
        assert what in result.failure
        assert len(result.failure["bodies"]) == len(checker.world.bodies)
    result = checker.result = Result(growth=1.0)
    checker.begin(checker.world.step())
    checker.end()
    checker.judge(rows(found))  # right before the step
    assert result.wrong == 1


def test_single_poses_may_come_one_by_one_in_order(checker: Checker) -> None:
    here = [key for key in checker.world.bodies if key[0].startswith("crate")]
    first, second, target = here[:3]
    there = checker.world.bodies[target]
    moved = {key: worlds.Body(there.kind, there.pose, there.size) for key in (first, second)}
    bodies, lamp = checker.world.bodies, worlds.beacon(worlds.TRANSFORM)
    lit = bodies[lamp]._replace(pose=bodies[worlds.anchor(worlds.TRANSFORM)].pose)
    checker.begin({worlds.TRANSFORM: worlds.Change({**moved, lamp: lit})})
    some = dict(checker.world.bodies) | {first: moved[first]}
    assert not checker.judge(rows(right(some)))
    assert checker.result.wrong == 0
    some = dict(checker.world.bodies) | {second: moved[second]}
    checker.judge(rows(right(some)))
    assert checker.result.wrong == 1


def test_the_same_seed_is_the_same_steps() -> None:
    def steps(seed: int) -> list[str]:
        world, made = worlds.World(seed, 20), []
        for number in range(51):
            changes = world.step() if number else world.first()
            made.append(repr([(t, c.bodies, sorted(c.gone)) for t, c in changes.items()]))
            world.apply(changes)
        return made

    assert steps(1) == steps(1)
    assert steps(1) != steps(2)


def test_every_input_changes_bodies_and_no_body_is_changed_twice_in_a_step() -> None:
    world = worlds.World(3, 60)
    world.apply(world.first())
    counts = dict.fromkeys(worlds.TOPICS, 0)
    for _ in range(300):
        changes = world.step()
        keys = [key for change in changes.values() for key in {*change.bodies, *change.gone}]
        assert len(keys) == len(set(keys))
        for topic, change in changes.items():
            assert list(change.bodies)[-1] == worlds.beacon(topic)
            counts[topic] += len(change.bodies) - 1 + len(change.gone)
        world.apply(changes)
        assert 40 < len(world.bodies) < 100
    assert min(counts.values()) > 100
    assert {key[0] == "boxes" for key in world.bodies} == {True, False}
    assert worlds.MARKERS in counts
    assert worlds.BOXES in counts


def test_growth_is_found() -> None:
    result = Result(growth=1.0, checked=1)
    result.usages.samples = [Usage(1e8 + 1e4 * k, 20, 10, 5e7) for k in range(100)]
    assert result.faults() == []
    result.usages.samples = [Usage(1e8 + 2e4 * k, 20 + k, 10, 5e7) for k in range(100)]
    assert result.faults() == ["memory grew by 1.8 MB", "descriptors grew by 90"]
    assert "memory of the node (MB): 100.09 after the warm-up, 101.89 at the end" in result.lines()


def test_brute_force_is_right() -> None:
    seen = set()
    for seed in range(5):
        world = worlds.World(seed, 40)
        world.apply(world.first())
        world.apply(world.step())
        poses, sizes = worlds.rows_of(world.bodies)
        boxes = list(zip(poses[:, :3], rotations_of(poses[:, 3:]), 0.5 * sizes, strict=True))
        i, j = np.triu_indices(len(boxes), 1)
        pairs = [oracle.ExactPair(boxes[a], boxes[b]) for a, b in zip(i, j, strict=True)]
        verdicts = np.array([pair.verdict() for pair in pairs])
        truth = truth_of(poses, sizes)
        assert truth.sure.all()
        colliding = np.flatnonzero(verdicts != oracle.SEPARATE)
        assert truth.pairs.tolist() == np.stack([i, j], axis=1)[colliding].tolist()
        depths = [-pairs[k].separation() for k in colliding]
        np.testing.assert_allclose(truth.depths, depths, atol=1e-12)
        seen |= set(verdicts.tolist())
    assert seen == {oracle.SEPARATE, oracle.TOUCHING, oracle.OVERLAP}, "some rest on others"


def test_what_doubles_do_not_decide_is_said() -> None:
    turned = np.array([0.0, 0.0, np.sin(0.3), np.cos(0.3)])
    # edge to edge along the rotated x axis, apart by less than is sure
    offset = 1.0 * rotations_of(turned[None])[0, :, 0]
    poses = np.array([[0.0, 0.0, 0.0, *turned], [*(offset * (1.0 + 1e-11)), *turned]])
    truth = truth_of(poses, np.ones((2, 3)))
    assert truth.pairs.tolist() == [[0, 1]]
    assert not truth.sure[0]
    poses[:, 3:] = 0.0, 0.0, 0.0, 1.0
    poses[1, :3] = 1.0, 1.0, 1.0
    truth = truth_of(poses, np.ones((2, 3)))
    assert truth.sure.all()
    assert truth.depths.tolist() == [0.0]


@pytest.mark.slow  # test_wrong_answers_are_found finds them without a node
def test_objects_that_are_missing_are_found(capfd: pytest.CaptureFixture[str]) -> None:
    # whatever has moved is in no pair by the next check, however soon that is
    wrong = ["-p", "object_timeout:=0.000001", "-p", "stale_policy:=ignore"]
    code = command.main(["--seconds", "60", "--objects", "30", "--", *wrong])
    output = capfd.readouterr().out
    assert code == 1
    assert '"missing"' in output
    assert "python -m tools.soak --seed 1 --steps" in output
    assert "\nNOT held: " in output
    assert "wrong answers" in output


def test_a_node_that_ends_is_written(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "result.json"
    assert command.main(["--json", str(file), "--", "--no-such-argument"]) == 1
    assert "NOT held: the node ended with" in capfd.readouterr().out
    result = json.loads(file.read_text())
    assert result["wrong"] == result["checked"] == 0
    assert "the node ended with" in result["not held"][0]
