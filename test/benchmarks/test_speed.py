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
from each import each

import obb_collision as oc
from obb_collision.benchmarks import effects, speed
from obb_collision.benchmarks.contestants import (
    FORMS,
    OURS,
    PAIRS,
    PEERS,
    Contestant,
    OurPairs,
    make_frames,
)
from obb_collision.benchmarks.steps import Case, StepPlan, StepRow, run_case, slopes, tables
from obb_collision.benchmarks.tables import write_into
from obb_collision.typing import Floats, Rows

QUICK = StepPlan(seconds=0.0, steps=1)


def silent(what: str) -> None:
    """Take what is being done."""


@each("form", FORMS)
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


@each("form", FORMS)
def test_everybody_finds_our_pairs(form: str) -> None:
    rows, _ = run_case(Case(form, 80), [*OURS, *PEERS], [1, 2], QUICK, silent)
    assert {row.name for row in rows} >= {one.name for one in OURS}
    assert {row.threads for row in rows if row.name == "find_pairs"} == {1, 2}
    for row in rows:
        assert row.pairs > 0
        assert (row.missed, row.false) == (0, 0), row


def test_everybody_finds_our_pairs_where_few_boxes_move() -> None:
    rows, _ = run_case(Case(boxes=100, moving=0.1), [*OURS, *PEERS], [1], QUICK, silent)
    for row in rows:
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


def test_who_would_take_too_long_is_left_out_with_a_note() -> None:
    plan = StepPlan(seconds=0.0, steps=1, limit=1e-9)
    rows, notes = run_case(Case(boxes=50), [PAIRS, stand_in("slow", OurPairs)], [1], plan, silent)
    assert [row.name for row in rows] == ["find_pairs"]
    assert notes[0][0] == "slow would take too long for"


def row(name: str, boxes: int, median: float, form: str = "uniform", threads: int = 2) -> StepRow:
    return StepRow(name, threads, form, boxes, 1.0, median, median, 20, 0.0, 1, 0, 0, 0.0)


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
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
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


@pytest.fixture(scope="module")
def costs() -> Iterator[list[effects.CostRow]]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(effects, "FRAMES", 30)
        yield effects.run_effects(0.0, silent)


def test_every_scene_has_its_effects_alone_and_together(
    costs: list[effects.CostRow],
) -> None:
    for name in effects.SCENES:
        own = {row.variant: row for row in costs if row.scene == name}
        assert list(own)[:3] == [effects.PAIRS, effects.OFF, "separations"]
        assert list(own)[-1] == effects.ALL
        assert own[effects.OFF].ran_on == own[effects.PAIRS].ran_on == 0.0
        assert own[effects.OFF].ratio == 1.0
    busy = {(row.scene, row.variant) for row in costs if row.ran_on > 0}
    assert {("tabletop", "clearance"), ("warehouse", "sweep"), ("lidar_zone", "points")} <= busy


def test_what_effects_cost_is_printed_and_drawn(
    costs: list[effects.CostRow],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(speed, "run_effects", lambda *_: costs)
    picture = tmp_path / "effects.svg"
    assert speed.main(["--effects", "--plot", str(picture)]) == 0
    text = capsys.readouterr().out
    assert all(f"{name}: effects off / pairs alone" in text for name in effects.SCENES)
    assert picture.stat().st_size > 1000
