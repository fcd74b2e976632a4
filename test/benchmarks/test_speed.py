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


"""The benchmark of the step: all see the same poses and find the same pairs, and it says so."""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import obb_collision as oc
from obb_collision.benchmarks import speed
from obb_collision.benchmarks.cases.forms import FORMS, make_frames
from obb_collision.benchmarks.peers.steps import COAL, OURS, PAIRS, PEERS, Contestant, OurPairs
from obb_collision.benchmarks.step import goals, measure, wanted
from obb_collision.benchmarks.step.measure import Case, Plan, Row, run_case
from obb_collision.benchmarks.step.plot import save_plot
from obb_collision.benchmarks.step.tables import slopes, tables, write_into
from obb_collision.typing import Floats, Rows

QUICK = Plan(seconds=0.0, steps=1)
SINGLE_PRECISION = {"rapier3d", "pybullet"}


def silent(what: str) -> None:
    """Take what is being done."""


@pytest.mark.parametrize("form", FORMS)
def test_frames_move_only_what_moves_and_by_little(form: str) -> None:
    half_extents, frames = make_frames(form, 60, 0.1, 1)
    first, second = frames[:2]
    moved = np.flatnonzero((first.poses != second.poses).any(axis=1))
    np.testing.assert_array_equal(moved, first.rows)
    assert len(moved) == 6
    assert np.abs(first.poses[:, :3] - second.poses[:, :3]).max() <= 0.0201
    np.testing.assert_allclose(np.linalg.norm(second.poses[:, 3:], axis=1), 1.0)
    assert frames[-1] is frames[1]  # there and back
    assert len(oc.find_pairs(oc.Boxes.from_poses(frames[4].poses, half_extents))) > 0


@pytest.mark.parametrize("form", FORMS)
def test_everybody_finds_our_pairs(form: str) -> None:
    rows, _ = run_case(Case(form, 80), [*OURS, *PEERS], [1, 2], QUICK, silent)
    assert {row.name for row in rows} >= {one.name for one in OURS}
    assert {row.threads for row in rows if row.name == "find_pairs"} == {1, 2}
    for row in rows:
        assert row.pairs > 0
        surfaces = row.name == "trimesh"  # of a box in another one they are apart
        if not surfaces and row.name not in SINGLE_PRECISION:
            assert (row.missed, row.false) == (0, 0), row


@pytest.mark.parametrize("moving", [0.0, 0.1])
def test_everybody_finds_our_pairs_where_few_boxes_move(moving: float) -> None:
    rows, _ = run_case(Case(boxes=100, moving=moving), [*OURS, *PEERS], [1], QUICK, silent)
    for row in rows:
        if row.name != "trimesh":
            assert (row.missed, row.false) == (0, 0), row


class Forgetful(OurPairs):
    """A peer that misses a pair."""

    def pairs(self, found: Rows) -> Rows:
        return super().pairs(found)[1:]


class Inventive(OurPairs):
    """A peer that reports a pair that is apart."""

    def pairs(self, found: Rows) -> Rows:
        return np.concatenate([found, [[0, 0]]]) if len(found) else found


def stand_in(name: str, kind: type[OurPairs]) -> Contestant:
    def make(half_extents: Floats, poses: Floats) -> OurPairs:
        return kind(half_extents, poses)

    return Contestant(name, "numba", make)


def test_pairs_that_differ_are_counted_with_their_distance_from_touching() -> None:
    wrong = [stand_in("MuJoCo", Forgetful), stand_in("python-fcl", Inventive)]
    rows, _ = run_case(Case(boxes=50), [*OURS, *wrong], [1], QUICK, silent)
    by_name = {row.name: row for row in rows}
    assert by_name["MuJoCo"].missed == 1
    assert by_name["MuJoCo"].off_m > 0.0
    assert by_name["python-fcl"].false == 1
    (cell,) = [line[1] for line in tables(rows)["sizes: uniform, all moving"] if "MuJ" in line[0]]
    assert "*" in cell


def test_a_broad_phase_of_coal_that_misses_pairs_takes_no_part(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    good, bad = stand_in("coal tree", OurPairs), stand_in("coal SaP", Forgetful)
    monkeypatch.setattr(measure, "COAL", (good, bad))
    rows, notes = run_case(Case(boxes=50), [PAIRS, good, bad], [1], QUICK, silent)
    assert [row.name for row in rows] == ["find_pairs", "coal tree"]
    assert notes[0][0] == "coal SaP is left out where it misses pairs in a trial:"


def test_who_would_take_too_long_is_left_out_with_a_note() -> None:
    plan = Plan(seconds=0.0, steps=1, limit=1e-9)
    rows, notes = run_case(Case(boxes=50), [PAIRS, stand_in("slow", OurPairs)], [1], plan, silent)
    assert [row.name for row in rows] == ["find_pairs"]
    assert notes[0][0] == "slow would take too long for"


def row(name: str, boxes: int, median: float, form: str = "uniform", threads: int = 2) -> Row:
    return Row(name, threads, form, boxes, 1.0, median, median, 20, 0.0, 1, 0, 0, 0.0)


def test_slopes_are_those_of_the_medians() -> None:
    rows = [row("find_pairs", n, n / 1000.0) for n in (1000, 10_000)]
    rows += [row("find_pairs", n, 1.0, threads=1) for n in (1000, 10_000)]
    (line,) = slopes(rows)
    assert line == "find_pairs, 2 threads, uniform: 10,000 / 1,000: 10.0; exponent at the end 1.00"


def test_tables_have_a_line_for_coal_at_its_best() -> None:
    rows = [row("Scene, separations", 10, 1.0), row("coal tree", 10, 4.0, threads=1)]
    rows.append(row("coal SSaP", 10, 3.0, threads=1))
    (table,) = tables(rows).values()
    assert table[0] == ["ms per step", "10"]
    assert table[1:] == [
        ["Scene, separations, 2 threads", "1.00"],
        ["coal, best broad phase", "3.00 SSaP (3.0)"],
    ]


def test_a_page_gets_its_tables_between_the_marks(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("a\n<!-- speed: x -->\nold\n<!-- end -->\nb\n<!-- speed: y -->\n<!-- end -->\n")
    for _ in range(2):
        write_into(page, {"x": "new", "z": "nowhere"})
        text = "a\n<!-- speed: x -->\nnew\n<!-- end -->\nb\n<!-- speed: y -->\n<!-- end -->\n"
        assert page.read_text() == text


def test_the_command_writes_what_it_measured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(speed, "CERTIFIED", 100)
    files = [tmp_path / name for name in ("rows.json", "page.md")]
    arguments = (
        "--sizes 10 20 --forms uniform line --threads 1 --steps 1 --seconds 0.001 --peers coal"
    )
    end = ["--json", str(files[0]), "--markdown", str(files[1])]
    if find_spec("matplotlib"):
        files.append(tmp_path / "plot.svg")
        end += ["--plot", str(files[-1])]
    assert speed.main([*arguments.split(), *end]) == 0
    text = capsys.readouterr()
    assert "forms: 20 boxes, all moving" in text.out
    assert "20 boxes, line" in text.err
    found = json.loads(files[0].read_text())
    names = {row["name"] for row in found["rows"]}
    assert names >= {one.name for one in OURS}
    assert not names & {"MuJoCo", "pybullet"}
    assert "| find_pairs, 1 thread |" in files[1].read_text()
    assert all(file.stat().st_size > 500 for file in files)


def test_by_default_every_size_form_and_share_of_motion_is_measured() -> None:
    cases = speed.cases_of(speed.parse([]))
    assert [c.boxes for c in cases[:6]] == [10, 100, 1_000, 10_000, 100_000, 1_000_000]
    assert {c.form for c in cases} == set(FORMS)
    assert {c.moving for c in cases} == {1.0, 0.1, 0.01, 0.0}
    assert len(COAL) == 7


def test_goals_are_measured_and_one_that_fails_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(goals, "SIZES", (10, 20))
    monkeypatch.setattr(goals, "LARGE", (20, 30, 40))
    monkeypatch.setattr(goals, "FORMS", ["uniform", "line"])
    monkeypatch.setattr(goals, "SHORT_TURNS", 3)
    monkeypatch.setattr(goals, "BOXES_TURNS", 3)
    monkeypatch.setattr(goals, "FORM_BOXES", 30)
    for part in ("node", "starts", "per_pair"):
        monkeypatch.setattr(goals.Goals, part, failing)
    files = [tmp_path / "goals.json", tmp_path / "page.md"]
    arguments = ["--goals", "--seconds", "0.001", "--json", str(files[0])]
    assert speed.main([*arguments, "--markdown", str(files[1])]) == 0
    text = capsys.readouterr()
    found = json.loads(files[0].read_text())["goals"]
    assert len(found) == 6 + 2 + 4 + 1 + 3 + 3
    for goal in found:
        failed = "no such thing" in goal["measured"]
        absent = "not installed" in goal["measured"]
        assert (goal["met"] is None) == (failed or absent), goal
    assert sum("no such thing" in goal["measured"] for goal in found) == 3
    assert "10 boxes: move_indices, check, pairs read" in text.out
    assert "| find_pairs, 20 boxes |" in files[1].read_text()


def failing(self: object) -> Iterator[wanted.Goal]:
    raise RuntimeError("no such thing")


def test_a_goal_is_met_by_what_was_measured() -> None:
    assert wanted.ratio("x", "y", 4.0, 1.0, 4.0, "ms").met is True
    assert wanted.ratio("x", "y", 4.0, 1.0, 3.9, "ms").met is False
    assert wanted.below("x", 20.0, 19.9, "µs").met is True
    assert wanted.below("x", 20.0, 20.0, "µs").met is False


def test_a_goal_of_the_node_needs_an_answer_to_every_frame() -> None:
    rows = [
        {"way": way, "objects": objects, "median": 0.5, "95 %": 0.6, "99 %": 5.0, "longest": 9.0}
        for way, objects, *_ in wanted.NODE
    ]
    assert [goal.met for goal in wanted.node_goals(rows)] == [False, *[True] * 5]
    rows[0]["99 %"] = 2.0
    del rows[3]["median"]
    assert [goal.met for goal in wanted.node_goals(rows)] == [True] * 3 + [False] + [True] * 2
    table = wanted.node_table(rows)
    assert table[1] == ["object_poses", "1,000", "0.500", "0.600", "2.00", "9.00"]
    assert table[4][2] == "no answer"


def test_the_node_is_measured_in_all_ways_that_have_a_goal() -> None:
    pytest.importorskip("rclpy")
    from obb_collision.benchmarks import latency, node_goals

    for way, objects, *_ in wanted.NODE:
        assert way in latency.WAYS
        assert objects in (*node_goals.SIZES, node_goals.OTHERS)


def test_the_plot_shows_sizes_and_forms(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    rows = [row(one.name, n, n / 10) for one in OURS for n in (10, 100)]
    rows += [row(one.name, 100, 20.0, "line") for one in (*OURS, *PEERS)]
    save_plot(rows, tmp_path / "plot.svg")
    text = (tmp_path / "plot.svg").read_text()
    assert text.count("<path") > 50
