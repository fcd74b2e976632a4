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
from pathlib import Path

import numpy as np
import pytest
from each import each

import obb_collision as oc
from obb_collision.benchmarks import command, effects, speed
from obb_collision.benchmarks.contestants import (
    FORMS,
    OURS,
    PAIRS,
    PEERS,
    Contestant,
    OurPairs,
    make_frames,
)
from obb_collision.benchmarks.steps import Case, StepPlan, StepRow, run_case
from obb_collision.typing import Floats, Rows

QUICK = StepPlan(seconds=0.0, steps=1)


def silent(what: str) -> None:
    """Take what is being done."""


def test_the_command_names_all_forms_and_peers() -> None:
    assert tuple(FORMS) == command.FORMS
    assert tuple(one.name for one in PEERS) == command.PEERS


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


@each("moving", [1.0, 0.1])
@each("form", FORMS)
def test_everybody_finds_our_pairs(form: str, moving: float) -> None:
    rows, _ = run_case(Case(form, 80, moving), [*OURS, *PEERS], [1, 2], QUICK, silent)
    assert {row.name for row in rows} >= {one.name for one in OURS}
    assert {row.threads for row in rows if row.name == "find_pairs"} == {1, 2}
    for row in rows:
        assert row.pairs > 0
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
    table = speed.tables(rows)["sizes: uniform, all moving"]
    (cell,) = [line[1] for line in table if "MuJ" in line[0]]
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
    (line,) = speed.slopes(rows)
    assert line == "find_pairs, 2 threads, uniform: 10,000 / 1,000: 10.0; exponent at the end 1.00"


def test_tables_have_a_line_for_coal_at_its_best() -> None:
    rows = [row("Scene, separations", 10, 1.0), row("coal tree", 10, 4.0, threads=1)]
    rows.append(row("coal SSaP", 10, 3.0, threads=1))
    (table,) = speed.tables(rows).values()
    assert table[0] == ["ms per step", "10"]
    assert table[1:] == [
        ["Scene, separations, 2 threads", "1.00"],
        ["coal, best broad phase", "3.00 SSaP (3.0)"],
    ]


def test_the_command_writes_what_it_measured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    written, picture = tmp_path / "rows.json", tmp_path / "picture.svg"
    arguments = (
        "--sizes 10 20 --forms uniform line --threads 1 --steps 1 --seconds 0.001 --peers coal"
    )
    end = ["--json", str(written), "--picture", str(picture)]
    assert command.speed([*arguments.split(), *end]) == 0
    text = capsys.readouterr()
    assert "forms: 20 boxes, all moving" in text.out
    assert "20 boxes, line" in text.err
    names = {row["name"] for row in json.loads(written.read_text())["rows"]}
    assert names >= {one.name for one in OURS}
    assert not names & {"MuJoCo", "pybullet"}
    assert picture.stat().st_size > 500


def test_by_default_every_size_form_and_share_of_motion_is_measured() -> None:
    cases = speed.cases_of(command.speed_parser("speed").parse_args([]))
    assert [c.boxes for c in cases[:6]] == [10, 100, 1_000, 10_000, 100_000, 1_000_000]
    assert {c.form for c in cases} == set(FORMS)
    assert {c.moving for c in cases} == {1.0, 0.1, 0.01, 0.0}


def test_every_scene_has_its_effects_alone_and_together_printed_and_drawn(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(effects, "FRAMES", 30)
    monkeypatch.setattr(speed, "EFFECTS_SECONDS", 0.0)
    file, picture = tmp_path / "costs.json", tmp_path / "effects.svg"
    given = ["--effects", "--seconds", "0.001", "--picture", str(picture), "--json", str(file)]
    assert command.speed(given) == 0
    text = capsys.readouterr().out
    costs = [effects.CostRow(**row) for row in json.loads(file.read_text())["rows"]]
    for name in effects.SCENES:
        own = {row.variant: row for row in costs if row.scene == name}
        assert list(own)[:3] == [effects.PAIRS, effects.OFF, "separations"]
        assert list(own)[-1] == effects.ALL
        assert own[effects.OFF].ran_on == own[effects.PAIRS].ran_on == 0.0
        assert own[effects.OFF].ratio == 1.0
        assert f"{name}: effects off / pairs alone" in text
    busy = {(row.scene, row.variant) for row in costs if row.ran_on > 0}
    assert {("tabletop", "clearance"), ("warehouse", "sweep"), ("lidar_zone", "points")} <= busy
    assert picture.stat().st_size > 1000
