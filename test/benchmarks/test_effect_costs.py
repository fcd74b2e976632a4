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

"""What effects cost: the table has every variant, and what is off runs on nothing."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from obb_collision.benchmarks import effects


@pytest.fixture(scope="module")
def rows() -> Iterator[list[effects.EffectRow]]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(effects, "FRAMES", 30)
        yield effects.run_effects(0.0, lambda _: None)


def test_every_scene_has_its_effects_alone_and_together(rows: list[effects.EffectRow]) -> None:
    for name in effects.SCENES:
        own = {row.variant: row for row in rows if row.scene == name}
        assert list(own)[:3] == [effects.PAIRS, effects.OFF, "separations"]
        assert list(own)[-1] == effects.ALL
        assert own[effects.OFF].count == own[effects.PAIRS].count == 0.0
        assert own[effects.OFF].ratio == 1.0
    table = effects.format_effects(rows)
    assert all(f"{name}: effects off / pairs alone" in table for name in effects.SCENES)


def test_the_effects_of_the_ready_scenes_have_something_to_do(
    rows: list[effects.EffectRow],
) -> None:
    busy = {(row.scene, row.variant) for row in rows if row.count > 0}
    assert {("tabletop", "clearance"), ("warehouse", "sweep"), ("lidar_zone", "points")} <= busy


def test_the_plot_is_written(rows: list[effects.EffectRow], tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    effects.save_effects_plot(rows, tmp_path / "effects.svg")
    assert (tmp_path / "effects.svg").stat().st_size > 1000
