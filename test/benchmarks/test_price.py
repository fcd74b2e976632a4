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

"""The price of accuracy on next to nothing: its parts, its files, and that it tells of defects."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from trimesh import creation

import obb_collision as oc
from obb_collision.benchmarks import accuracy, command, contest, effects
from obb_collision.benchmarks.corpora import Corpus, box_corpus, file_corpus, generated_corpus
from obb_collision.benchmarks.measuring import Times
from obb_collision.shapes import Mesh

GENERATED = generated_corpus(0)
FEW = Corpus("few", {name: GENERATED.shapes[name] for name in ("table", "washer", "bumpy ball")})
LEVELS = [level.label for level in oc.Accuracy]


def quiet(what: str) -> None:
    """Show nobody."""


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
    meshes = [shape for shape in FEW.shapes.values() if isinstance(shape, Mesh)]
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
    monkeypatch.setattr(
        contest,
        "report_pairs",
        lambda s, level: asked(s, level)[: 0 if level == "sphere" else None],
    )
    price = contest.measure(corpus, plan, 2, quiet)
    assert price.row("sphere").missed == price.colliding > 0
    monkeypatch.setattr(accuracy, "run", lambda *_: accuracy.AccuracyResult(prices=[price]))
    assert command.accuracy(["--seconds", "0.1"]) == 1
    assert "DEFECT" in capsys.readouterr().err


def test_fits_are_compared_with_the_best() -> None:
    rows = {row.fit: row for row in accuracy.measure_fits([FEW], 5.0, quiet)}
    assert rows["best"].mean_volume == pytest.approx(1.0)
    for row in rows.values():
        assert row.worst_volume >= row.mean_volume >= 1.0


def test_effects_on_finer_levels_are_nearer_to_the_finest_and_never_unsafe() -> None:
    ours = {(row.effect, row.name): row for row in effects.measure_effects(FEW, 60, 0.0, 4, quiet)}
    assert {effect for effect, _ in ours} == {"clearance", "contacts", "sweep"}
    assert all(row.unsafe == 0 for row in ours.values())
    for effect in ("clearance", "contacts", "sweep"):
        assert ours[effect, "obb"].pairs > 10
        assert ours[effect, "obb"].mean_error >= ours[effect, "hull"].mean_error
        assert ours[effect, "mesh"].worst_error == 0.0


def test_ratios_are_medians_of_turns() -> None:
    times = Times({"a": np.array([1.0, 2.0, 9.0]), "b": np.array([3.0, 4.0, 9.0])})
    assert times.best("a") == 1.0
    assert times.ratio("b", "a") == 2.0


def test_the_command_prints_tables_and_writes_its_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(accuracy, "generated_corpus", lambda seed: FEW)
    file, picture = tmp_path / "accuracy.json", tmp_path / "accuracy.svg"
    sizes = ["--bodies", "40", "--pairs", "60", "--timed", "20", "--seconds", "1"]
    (tmp_path / "bad.stl").write_text("no mesh")
    sizes += ["--meshes", str(tmp_path)]
    assert command.accuracy([*sizes, "--json", str(file), "--picture", str(picture)]) == 0
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
