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

"""The price of accuracy, and the speed of a step, on next to nothing; both tell of defects."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from each import each
from trimesh import creation

import obb_collision as oc
from obb_collision.benchmarks import accuracy, command, contest, contestants, effects, speed
from obb_collision.benchmarks.corpora import Corpus, box_corpus, file_corpus, generated_corpus
from obb_collision.benchmarks.measuring import Times
from obb_collision.benchmarks.steps import Case, StepPlan, StepRow, run_case
from obb_collision.shapes import Mesh
from obb_collision.typing import Rows

GENERATED = generated_corpus(0)
FEW = Corpus("few", {name: GENERATED.shapes[name] for name in ("table", "washer", "bumpy ball")})
LEVELS = [level.label for level in oc.Accuracy]
QUICK = StepPlan(seconds=0.0, steps=1)


def quiet(what: str) -> None:
    """Show nobody what is being done."""


@pytest.fixture(scope="module")
def price() -> contest.Price:
    return contest.measure(FEW, contest.ContestPlan(40, 200, 30, 2.0), 1, quiet)


def test_trimesh_makes_many_kinds_of_meshes_of_one_size() -> None:
    assert len(GENERATED.shapes) >= 20
    solid = 0
    for name, mesh in GENERATED.shapes.items():
        assert isinstance(mesh, Mesh)
        used = mesh.vertices[np.unique(mesh.faces)]
        assert np.linalg.norm(np.ptp(used, axis=0)) == pytest.approx(1.0), name
        solid += bool(oc.MeshTrees.build(mesh.vertices, mesh.faces).solid[0])
    assert 20 <= solid < len(GENERATED.shapes)  # and open ones among them


def test_meshes_of_files_are_those_of_a_folder_that_can_be_measured(tmp_path: Path) -> None:
    for name, faces in {"ball.stl": 320, "few.obj": 12, "in/torus.obj": 2000}.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        mesh = creation.box() if faces < 100 else creation.icosphere(2 if faces < 1000 else 3)
        mesh.export(tmp_path / name)
    (tmp_path / "bad.stl").write_text("no mesh")
    corpus = file_corpus(tmp_path, 60.0)
    assert set(corpus.shapes) == {"ball.stl", "in/torus.obj"}
    assert "4 files" in corpus.note


def test_no_level_misses_and_the_shares_fall_from_level_to_level(price: contest.Price) -> None:
    assert price.missed == 0
    assert price.colliding > 10
    ours = {row.name: row for row in price.rows if not row.peer}
    assert list(ours) == LEVELS
    false = {name: row.false for name, row in ours.items()}
    assert false["aabb"] > false["obb"] > false["hull"] > false["mesh"] == 0
    for row in price.rows:
        assert row.reports == row.false + price.colliding - row.missed
        assert row.peer or row.step_ms is not None
    prepared = list(FEW.shapes.values())[: price.shapes]  # as many as there was time for
    meshes = [shape for shape in prepared if isinstance(shape, Mesh)]
    trees = [oc.MeshTrees.build(mesh.vertices, mesh.faces) for mesh in meshes]
    sizes = [sum(array.nbytes for array in tree.arrays) for tree in trees]
    assert [ours[name].bytes for name in LEVELS[:3]] == [4 * 8, 6 * 8, 15 * 8]
    assert ours["mesh"].bytes == np.mean(sizes)


def test_peers_that_are_installed_agree(price: contest.Price) -> None:
    pytest.importorskip("fcl")
    assert "python-fcl mesh" in price.ratios
    assert price.row("python-fcl mesh").false == 0
    hull, theirs = price.row("hull"), price.row("python-fcl hull")
    assert theirs.false == pytest.approx(hull.false, abs=0.02 * price.pairs)


def test_missed_collisions_are_counted_and_end_in_an_exit_code(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    corpus, plan = box_corpus(50, 0), contest.ContestPlan(50, 50, 20, 0.0)
    price = contest.measure(corpus, plan, 2, quiet)
    assert [row.name for row in price.rows if not row.peer] == LEVELS[:3]
    assert price.missed == price.row("obb").false == 0
    asked = contest.report_pairs
    fewer = lambda s, level: asked(s, level)[: 0 if level == "sphere" else None]  # noqa: E731
    monkeypatch.setattr(contest, "report_pairs", fewer)
    price = contest.measure(corpus, plan, 2, quiet)
    assert price.row("sphere").missed == price.colliding > 0
    monkeypatch.setattr(accuracy, "run", lambda *_: accuracy.AccuracyResult(prices=[price]))
    assert command.accuracy(["--seconds", "0.1"]) == 1
    assert "DEFECT" in capsys.readouterr().err


def test_effects_on_finer_levels_are_nearer_to_the_finest_and_never_unsafe() -> None:
    ours = {(row.effect, row.name): row for row in effects.measure_effects(FEW, 60, 0.0, 4, quiet)}
    assert {effect for effect, _ in ours} == {"clearance", "contacts", "sweep"}
    assert all(row.unsafe == 0 for row in ours.values())
    for effect in ("clearance", "contacts", "sweep"):
        assert ours[effect, "obb"].pairs > 10
        assert ours[effect, "obb"].mean_error >= ours[effect, "hull"].mean_error
        assert ours[effect, "mesh"].worst_error == 0.0


def test_fits_are_compared_with_the_best_and_ratios_are_medians_of_turns() -> None:
    rows = {row.fit: row for row in accuracy.measure_fits([FEW], 5.0, quiet)}
    assert rows["best"].mean_volume == pytest.approx(1.0)
    for row in rows.values():
        assert row.worst_volume >= row.mean_volume >= 1.0
    times = Times({"a": np.array([1.0, 2.0, 9.0]), "b": np.array([3.0, 4.0, 9.0])})
    assert (times.best("a"), times.ratio("b", "a")) == (1.0, 2.0)


def test_the_command_prints_tables_and_writes_its_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(accuracy, "generated_corpus", lambda seed: FEW)
    file, picture = tmp_path / "accuracy.json", tmp_path / "accuracy.svg"
    (tmp_path / "bad.stl").write_text("no mesh")
    sizes = ["--bodies", "40", "--pairs", "60", "--timed", "20", "--seconds", "1", "--meshes"]
    files = [str(tmp_path), "--json", str(file), "--picture", str(picture)]
    assert command.accuracy([*sizes, *files]) == 0
    printed = capsys.readouterr()
    for word in ("hull", "Fits of a box", "clearance mesh", "0 missed"):
        assert word in printed.out
    assert "few: time per step" in printed.err
    written = json.loads(file.read_text())
    assert [price["corpus"] for price in written["corpora"]] == ["boxes", "few", "meshes of files"]
    assert written["missed"] == 0
    assert written["corpora"][1]["rows"][0]["name"] == "sphere"
    drawn = picture.read_text()
    for level in LEVELS:
        assert f"<!-- {level} -->" in drawn


@each("form", contestants.FORMS)
def test_frames_move_only_what_moves_and_by_little(form: str) -> None:
    half_extents, frames = contestants.make_frames(form, 60, 0.1, 1)
    first, second = frames[:2]
    moved = np.flatnonzero((first.poses != second.poses).any(axis=1))
    np.testing.assert_array_equal(moved, first.rows)
    assert len(moved) == 6
    assert np.abs(first.poses[:, :3] - second.poses[:, :3]).max() <= 0.0201
    np.testing.assert_allclose(np.linalg.norm(second.poses[:, 3:], axis=1), 1.0)
    assert frames[-1] is frames[1]  # there and back
    assert len(oc.find_pairs(oc.Boxes.from_poses(frames[4].poses, half_extents))) > 0


@each("moving", [1.0, 0.1])
@each("form", contestants.FORMS)
def test_everybody_finds_our_pairs(form: str, moving: float) -> None:
    everybody = [*contestants.OURS, *contestants.PEERS]
    rows, _ = run_case(Case(form, 80, moving), everybody, [1, 2], QUICK, quiet)
    assert {row.name for row in rows} >= {one.name for one in contestants.OURS}
    assert {row.threads for row in rows if row.name == "find_pairs"} == {1, 2}
    for row in rows:
        assert row.pairs > 0
        assert (row.missed, row.false) == (0, 0), row


def stand_in(name: str, wrong: Callable[[Rows], Rows]) -> contestants.Contestant:
    """Return a peer that reports other pairs than are found."""

    class Peer(contestants.OurPairs):
        """Reports other pairs."""

        def pairs(self, found: Rows) -> Rows:
            return wrong(super().pairs(found))

    return contestants.Contestant(name, "numba", Peer)


def test_pairs_that_differ_are_counted_with_their_distance_from_touching() -> None:
    wrong = [stand_in("MuJoCo", lambda found: found[1:])]
    wrong.append(stand_in("python-fcl", lambda found: np.vstack([found, 0 * found[:1]])))
    rows, _ = run_case(Case(boxes=50), [*contestants.OURS, *wrong], [1], QUICK, quiet)
    by_name = {row.name: row for row in rows}
    assert by_name["MuJoCo"].missed == 1
    assert by_name["MuJoCo"].off_m > 0.0
    assert by_name["python-fcl"].false == 1
    table = speed.tables(rows)["sizes: uniform, all moving"]
    (cell,) = [line[1] for line in table if "MuJ" in line[0]]
    assert "*" in cell


def test_who_would_take_too_long_is_left_out_with_a_note() -> None:
    plan = StepPlan(seconds=0.0, steps=1, limit=1e-9)
    both = [contestants.FIND_PAIRS, stand_in("slow", np.copy)]
    rows, notes = run_case(Case(boxes=50), both, [1], plan, quiet)
    assert [row.name for row in rows] == ["find_pairs"]
    assert notes[0][0] == "slow would take too long for"


def row(name: str, boxes: int, median: float, form: str = "uniform", threads: int = 2) -> StepRow:
    return StepRow(name, threads, form, boxes, 1.0, median, median, 20, 0.0, 1, 0, 0, 0.0)


def test_slopes_are_those_of_the_medians_and_tables_have_a_line_for_coal_at_its_best() -> None:
    rows = [row("find_pairs", n, n / 1000.0) for n in (1000, 10_000)]
    rows += [row("find_pairs", n, 1.0, threads=1) for n in (1000, 10_000)]
    (line,) = speed.slopes(rows)
    assert line == "find_pairs, 2 threads, uniform: 10,000 / 1,000: 10.0; exponent at the end 1.00"
    rows = [row("Scene, separations", 10, 1.0), row("coal tree", 10, 4.0, threads=1)]
    (table,) = speed.tables([*rows, row("coal SSaP", 10, 3.0, threads=1)]).values()
    ours, theirs = ["Scene, separations, 2 threads", "1.00"], "coal, best broad phase"
    assert table == [["ms per step", "10"], ours, [theirs, "3.00 SSaP (3.0)"]]


def test_the_command_writes_its_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    written, picture = tmp_path / "rows.json", tmp_path / "picture.svg"
    given = "--sizes 10 20 --forms uniform line --threads 1 --steps 1 --seconds 0.001 --peers coal"
    end = ["--json", str(written), "--picture", str(picture)]
    assert command.speed([*given.split(), *end]) == 0
    text = capsys.readouterr()
    assert "forms: 20 boxes, all moving" in text.out
    assert "20 boxes, line" in text.err
    names = {row["name"] for row in json.loads(written.read_text())["rows"]}
    assert names >= {one.name for one in contestants.OURS}
    assert not names & {"MuJoCo", "pybullet"}
    assert picture.stat().st_size > 500


def test_by_default_every_size_form_and_share_of_motion_is_measured() -> None:
    assert tuple(contestants.FORMS) == command.FORM_NAMES
    assert tuple(one.name for one in contestants.PEERS) == command.PEER_NAMES
    cases = speed.cases_of(command.speed_parser("speed").parse_args([]))
    assert [c.boxes for c in cases[:6]] == [10, 100, 1_000, 10_000, 100_000, 1_000_000]
    assert {c.form for c in cases} == set(contestants.FORMS)
    assert {c.moving for c in cases} == {1.0, 0.1, 0.01, 0.0}


def test_every_scene_has_its_effects_alone_and_together_printed_and_drawn(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(effects, "SCENE_FRAMES", 30)
    monkeypatch.setattr(speed, "EFFECTS_SECONDS", 0.0)
    file, picture = tmp_path / "costs.json", tmp_path / "effects.svg"
    given = ["--effects", "--seconds", "0.001", "--picture", str(picture), "--json", str(file)]
    assert command.speed(given) == 0
    text = capsys.readouterr().out
    costs = [effects.CostRow(**row) for row in json.loads(file.read_text())["rows"]]
    for name in effects.COST_SCENES:
        own = {row.variant: row for row in costs if row.scene == name}
        assert list(own)[:3] == [effects.PAIRS_ALONE, effects.EFFECTS_OFF, "separations"]
        assert list(own)[-1] == effects.ALL_EFFECTS
        assert own[effects.EFFECTS_OFF].ran_on == own[effects.PAIRS_ALONE].ran_on == 0.0
        assert own[effects.EFFECTS_OFF].ratio == 1.0
        assert f"{name}: effects off / pairs alone" in text
    busy = {(row.scene, row.variant) for row in costs if row.ran_on > 0}
    assert {("tabletop", "clearance"), ("warehouse", "sweep"), ("lidar_zone", "points")} <= busy
    assert picture.stat().st_size > 1000
