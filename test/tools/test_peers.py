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

"""The comparison of effects runs, and all sides agree."""

from __future__ import annotations

import pytest

from obb_collision.benchmarks.corpora import Corpus, generated_corpus
from obb_collision.benchmarks.effects import measure_effects
from tools.peers import effects

#: Shapes of which hulls have few corners: those of many are simplified, which peers do not.
POINTED = {name: generated_corpus(0).shapes[name] for name in ("table", "jack", "chip")}


@pytest.mark.parametrize("peer", ["coal", "python-fcl", "MuJoCo"])
def test_effects_at_hull_and_mesh_are_those_of_peers(peer: str) -> None:
    """Within their tolerances; not depths of python-fcl, which are not least (docs/accuracy.md)."""
    pytest.importorskip({"coal": "coal", "python-fcl": "fcl", "MuJoCo": "mujoco"}[peer])
    rows = measure_effects(
        Corpus("pointed", POINTED), 150, 0.0, 5, lambda what: None, effects.installed
    )
    found = {(row.effect, row.name): row.differ for row in rows if row.name.startswith(peer)}
    for (effect, _), differ in found.items():
        if (peer, effect) != ("python-fcl", "contacts"):
            assert differ is not None
            assert differ < 1e-6
    assert len(found) == {"coal": 3, "python-fcl": 3, "MuJoCo": 2}[peer]
