"""The comparison of clouds in boxes runs, and all sides agree."""

from __future__ import annotations

from pathlib import Path

import pytest

from obb_collision.benchmarks.points import SCENES, by_numpy, by_tree, compare, main, scene


@pytest.mark.parametrize("name", SCENES)
def test_all_sides_agree(name: str) -> None:
    row = compare(name, 20, 3000)
    assert row["differ"] == 0
    assert (row["inside"] > 0) == (name != "all points outside")
    for side in ("ours", "float32", "one thread", "numpy", "tree"):
        assert row[f"{side}_ms"] > 0.0
    boxes, cloud = scene(name, 20, 3000)
    for ours, theirs in zip(by_numpy(boxes, cloud), by_tree(boxes, cloud), strict=True):
        assert ours.tolist() == theirs.tolist()


def test_the_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["--points", "500", "--boxes", "5", "--json", str(tmp_path / "points.json")])
    assert "long rods" in capsys.readouterr().out
    assert "ordinary" in (tmp_path / "points.json").read_text()
