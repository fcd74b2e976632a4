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

"""The comparison of clouds in boxes runs, and all sides agree."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.points import SCENES, by_numpy, by_tree, compare, main, scene


@pytest.mark.parametrize("name", SCENES)
def test_all_sides_agree(name: str) -> None:
    row = compare(name, 20, 3000)
    assert row["differ"] == 0
    assert (row["inside"] > 0) == (name != "all points outside")
    sides = ("ours", "float32", "one thread", "numpy", "tree")
    assert {f"{side}_ms" for side in sides} <= row.keys()
    boxes, cloud = scene(name, 20, 3000)
    for ours, theirs in zip(by_numpy(boxes, cloud), by_tree(boxes, cloud), strict=True):
        assert ours.tolist() == theirs.tolist()


def test_the_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["--points", "500", "--boxes", "5", "--json", str(tmp_path / "points.json")])
    assert "long rods" in capsys.readouterr().out
    assert "ordinary" in (tmp_path / "points.json").read_text()
