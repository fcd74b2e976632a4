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

"""The accuracy benchmark on next to nothing: its parts, its files, and that it tells of defects."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from obb_collision.benchmarks import accuracy
from obb_collision.benchmarks.price import corpus as corpus_module
from obb_collision.benchmarks.price import levels, upkeep
from obb_collision.benchmarks.price.corpus import Plan, measure
from obb_collision.benchmarks.price.effects import EffectRow, measure_effects
from obb_collision.benchmarks.price.fits import measure_fits
from obb_collision.benchmarks.price.floats import measure_floats, pair_sets
from obb_collision.benchmarks.price.rows import Price, Row
from obb_collision.benchmarks.price.scenes import Corpus, box_corpus, generated_corpus, real_corpus
from obb_collision.benchmarks.price.turns import Times
from obb_collision.geometry.fitting.fit import FITS
from obb_collision.geometry.representations import memory_table
from obb_collision.geometry.shapes.meshes import Mesh
from obb_collision.geometry.trees.obb_tree import MeshTrees
from obb_collision.scene.effects import LEVELS

GENERATED = generated_corpus(0)
FEW = Corpus("few", {name: GENERATED.shapes[name] for name in ("table", "washer", "bumpy ball")})


def quiet(what: str) -> None:
    """Show nobody."""


@pytest.fixture(scope="module")
def price() -> Price:
    return measure(FEW, Plan(bodies=40, pairs=200, timed=30, seconds=2.0), 1, quiet)


def test_trimesh_makes_many_kinds_of_meshes_of_one_size() -> None:
    assert len(GENERATED.shapes) >= 20
    solid = 0
    for name, mesh in GENERATED.shapes.items():
        assert isinstance(mesh, Mesh)
        used = mesh.vertices[np.unique(mesh.faces)]
        assert np.linalg.norm(np.ptp(used, axis=0)) == pytest.approx(1.0), name
        solid += bool(MeshTrees.build(mesh.vertices, mesh.faces).solid[0])
    assert 20 <= solid < len(GENERATED.shapes)  # and open ones among them


def test_real_meshes_are_the_same_each_time_and_missing_packages_are_named() -> None:
    first, again = real_corpus(0.2, limit=2), real_corpus(0.2, limit=2)
    assert set(first.shapes) >= set(again.shapes) or set(again.shapes) >= set(first.shapes)
    assert "example-robot-data" in first.note
    assert "pybullet" in first.note


def test_no_level_misses_and_the_shares_fall_from_level_to_level(price: Price) -> None:
    assert price.missed == 0
    assert price.colliding > 10
    names = [level.name for level in (*levels.BOX_LEVELS, *levels.MESH_LEVELS)]
    assert [row.name for row in price.rows if not row.peer] == names
    false = {row.name: row.false for row in price.rows}
    for coarse, exact in (("aabb", "obb"), ("obb", "obb_tree 1"), ("obb_tree 1", "obb_tree 6")):
        assert false[coarse] > false[exact]
    assert false["mesh"] == 0
    for row in price.rows:
        assert row.pairs >= price.pairs
        assert row.reports == row.false + price.colliding - row.missed
        assert row.peer or row.step_ms is not None


def test_memory_is_that_of_the_arrays(price: Price) -> None:
    table = memory_table()
    assert price.row("sphere").bytes == 4 * 8
    assert price.row("aabb").bytes == table["axis-aligned box (two corners)"][1]
    assert price.row("obb").bytes == table["oriented box, three axes"][1]
    assert upkeep.compact_numbers() == table["oriented box, two axes (compact)"][0]
    trees = [MeshTrees.build(*vertices_and_faces(mesh)) for mesh in FEW.shapes.values()]
    whole = np.mean([sum(array.nbytes for array in tree.arrays) for tree in trees])
    assert price.row("mesh").bytes == whole
    deep = [upkeep.tree_bytes(tree.arrays, 100) for tree in trees]
    nodes = [sum(getattr(t, name).nbytes for name in upkeep.NODE_ARRAYS) for t in trees]
    assert deep == nodes
    one_node = upkeep.tree_bytes(trees[0].arrays, 0)
    assert upkeep.tree_bytes(trees[0].arrays, 2) == 7 * one_node
    assert price.row("obb_tree 2").bytes == 7 * one_node


def vertices_and_faces(shape: object) -> tuple[np.ndarray, np.ndarray]:
    assert isinstance(shape, Mesh)
    return shape.vertices, shape.faces


def test_peers_that_are_installed_agree_on_the_triangles(price: Price) -> None:
    pytest.importorskip("fcl")
    assert price.surface_pairs == price.pairs
    assert price.surface_differ == 0
    assert "python-fcl mesh" in price.ratios
    hull, theirs = price.row("hull"), price.row("python-fcl hull")
    assert theirs.false == pytest.approx(hull.false, abs=0.02 * price.pairs)


def test_boxes_have_the_levels_of_boxes_and_their_own_peers() -> None:
    corpus = box_corpus(50, 0)
    price = measure(corpus, Plan(bodies=50, pairs=50, timed=20, seconds=0.0), 2, quiet)
    assert [row.name for row in price.rows if not row.peer] == [r.name for r in levels.BOX_LEVELS]
    assert price.missed == 0
    assert price.row("obb").false == 0
    assert set(price.missing) | {row.name for row in price.rows if row.peer} == {
        "python-fcl box",
        "coal box",
    }


def test_missed_collisions_are_counted_and_end_in_an_exit_code(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    blind = levels.Level("obb_faces", lambda t, i, j: np.zeros(len(i), np.bool_), "obb_faces")
    ladder = tuple(blind if level.name == "obb_faces" else level for level in levels.BOX_LEVELS)
    monkeypatch.setattr(corpus_module, "levels_of", lambda corpus: ladder)
    price = measure(box_corpus(50, 0), Plan(50, 50, 20, 0.0), 2, quiet)
    assert price.row("obb_faces").missed == price.colliding > 0
    result = accuracy.Result(prices=[price])
    monkeypatch.setattr(accuracy, "run", lambda *arguments: result)
    assert accuracy.main(["--seconds", "0.1"]) == 1
    assert "DEFECT" in capsys.readouterr().err


def test_fits_are_compared_with_the_best() -> None:
    rows = measure_fits([FEW], 5.0, quiet)
    assert [row.fit for row in rows] == list(FITS)
    by_name = {row.fit: row for row in rows}
    assert by_name["best"].mean_volume == pytest.approx(1.0)
    for row in rows:
        assert row.worst_volume >= row.mean_volume >= 1.0


def test_certified_verdicts_are_never_wrong_and_float32_is() -> None:
    rows = measure_floats(pair_sets(box_corpus(200, 0), 200, 60, 3), 0.0, quiet)
    found = {(row.kernel, row.pairs_of): row for row in rows}
    for pairs in ("a scene", "100 km off", "hard pairs"):
        certified = found["certified float64", pairs]
        assert certified.false == certified.missed == 0
    assert found["plain float64", "hard pairs"].false > 0
    single = found["plain float32", "hard pairs"]
    assert single.missed > found["plain float64", "hard pairs"].missed == 0


def test_effects_on_finer_levels_are_nearer_to_the_finest_and_never_unsafe() -> None:
    rows = measure_effects(FEW, 60, 0.0, 4, quiet)
    ours = {(row.effect, row.name): row for row in rows if not row.peer}
    assert {effect for effect, _ in ours} == {"clearance", "contacts", "sweep"}
    assert all(row.unsafe == 0 for row in ours.values())
    for effect, levels_above in LEVELS.items():
        if (effect, "obb") not in ours:
            continue
        assert {name for one, name in ours if one == effect} == {
            "obb", *(level.name.lower() for level in levels_above)
        }  # fmt: skip
        assert ours[effect, "obb"].pairs > 10
        assert ours[effect, "obb"].mean_error >= ours[effect, "hull"].mean_error
        assert ours[effect, max(levels_above).name.lower()].worst_error == 0.0


#: Shapes of which hulls have few corners: those of many are simplified, which peers do not.
POINTED = Corpus("pointed", {name: GENERATED.shapes[name] for name in ("table", "jack", "chip")})


@pytest.mark.parametrize("peer", ["coal", "python-fcl", "MuJoCo"])
def test_effects_at_hull_and_mesh_are_those_of_peers(peer: str) -> None:
    """Within their tolerances; not depths of python-fcl, which are not least (docs/accuracy.md)."""
    pytest.importorskip({"coal": "coal", "python-fcl": "fcl", "MuJoCo": "mujoco"}[peer])
    rows = measure_effects(POINTED, 150, 0.0, 5, quiet)
    found = {(row.effect, row.name): row.differ for row in rows if row.name.startswith(peer)}
    for (effect, _), differ in found.items():
        if (peer, effect) == ("python-fcl", "contacts"):
            continue
        assert differ is not None
        assert differ < 1e-6
    assert len(found) == {"coal": 3, "python-fcl": 3, "MuJoCo": 2}[peer]


def test_ratios_are_medians_of_turns() -> None:
    times = Times({"a": np.array([1.0, 2.0, 9.0]), "b": np.array([3.0, 4.0, 9.0])})
    assert times.best("a") == 1.0
    assert times.ratio("b", "a") == 2.0


def test_the_command_prints_tables_and_writes_its_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(accuracy, "generated_corpus", lambda seed: FEW)
    file = tmp_path / "accuracy.json"
    sizes = ["--bodies", "40", "--pairs", "60", "--timed", "20", "--seconds", "1"]
    assert accuracy.main([*sizes, "--json", str(file)]) == 0
    printed = capsys.readouterr().out
    for word in ("obb_tree 6", "Fits of a box", "plain float32", "0 missed"):
        assert word in printed
    written = json.loads(file.read_text())
    assert [price["corpus"] for price in written["corpora"]] == ["boxes", "few", "real meshes"]
    assert written["missed"] == written["claims"]["missed"] == 0
    assert written["corpora"][1]["rows"][0]["name"] == "sphere"


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_the_picture_names_every_point(tmp_path: Path, price: Price, suffix: str) -> None:
    pytest.importorskip("matplotlib")
    from obb_collision.benchmarks.price.plot import save_plot

    crowd = [Row(f"coal mesh {k}", peer=True, pair_ns=1e4 + 10.0 * k) for k in range(3)]
    crowded = Price("few", "", 3, 40, pairs=100, rows=[*price.rows, *crowd])
    file = tmp_path / f"picture{suffix}"
    effects = [
        EffectRow("contacts", "obb", False, 9, 1e3, 0.1),
        EffectRow("contacts", "hull", False, 9, 1e4),
    ]
    effects.append(EffectRow("contacts", "MuJoCo hull", True, 9, 5e3, 0.01))
    save_plot([crowded, Price("real meshes", "none", 0, 0)], effects, file)
    assert 10_000 < file.stat().st_size < 200_000
    if suffix == ".svg":
        text = file.read_text()
        for row in crowded.rows:
            assert f"<!-- {row.name}" in text or row.name.startswith("obb_tree")
        assert "<!-- 6 -->" in text
        assert "<!-- MuJoCo hull" in text


def test_labels_of_points_at_one_place_do_not_cover_each_other() -> None:
    pytest.importorskip("matplotlib")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.text import Annotation, Text

    from obb_collision.benchmarks.price.plot import _draw_effects

    measured = {
        "obb": (1.3e3, 0.109), "hull": (3.2e3, 0.012), "mesh": (294e3, 0.0),
        "coal hull": (4.7e3, 0.0076), "coal mesh": (421e3, 0.0), "MuJoCo hull": (4.4e3, 0.0076),
        "python-fcl hull": (6.5e3, 0.02), "python-fcl mesh": (395e3, 0.0),
    }  # fmt: skip
    names = list(measured)
    rows = [EffectRow("clearance", name, " " in name, 9, *measured[name]) for name in names]
    figure = Figure(figsize=(8.4, 5.2), dpi=100)
    figure.subplots_adjust(left=0.085, right=0.965, bottom=0.115, top=0.845, wspace=0.28)
    panels = figure.subplots(1, 3)
    _draw_effects(figure, panels, rows)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    texts = [child for child in panels[0].get_children() if isinstance(child, Annotation)]
    boxes = [Text.get_window_extent(text, canvas.get_renderer()) for text in texts]
    assert set(names) <= {text.get_text() for text in texts}
    for k, box in enumerate(boxes):
        assert not box.count_overlaps(boxes[:k]), texts[k].get_text()


@pytest.mark.parametrize(
    "wrong",
    [["--seconds", "0"], ["--bodies", "0"], ["--plot", "picture.pdf"], ["--seed", "-1"]],
)
def test_wrong_arguments_are_refused(wrong: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        accuracy.main(wrong)
    assert wrong[0] in capsys.readouterr().err
