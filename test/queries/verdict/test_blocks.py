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

"""Blocks of pairs get the verdict of each pair alone, whatever the number of threads."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from each import each

import obb_collision as oc
from obb_collision._jit import njit
from obb_collision.geometry.boxes import BoxArrays
from obb_collision.queries.verdict import separations as separations_module
from obb_collision.queries.verdict import verdict as verdict_module
from obb_collision.queries.verdict.blocks import BLOCK
from obb_collision.queries.verdict.pair_frame import box_at
from obb_collision.queries.verdict.verdict import box_verdict
from tools.cases.families import FAMILIES


@pytest.fixture(autouse=True)
def _restore() -> Iterator[None]:
    yield
    oc.set_threads(None)


@njit
def one_by_one(a: BoxArrays, b: BoxArrays, out: np.ndarray) -> None:
    for n in range(len(out)):
        out[n] = box_verdict(box_at(a, n), box_at(b, n))


def pairs_of(family: str, count: int) -> tuple[oc.Boxes, oc.Boxes]:
    a, b = FAMILIES[family](np.random.default_rng(5), count)
    return oc.Boxes(*a), oc.Boxes(*b)


@each("family", FAMILIES)
def test_a_block_gives_the_verdicts_of_each_pair_alone(family: str) -> None:
    a, b = pairs_of(family, 20 * BLOCK + 1)
    wanted = np.empty(len(a), np.int8)
    one_by_one(a.arrays, b.arrays, wanted)
    for count in (1, BLOCK - 1, BLOCK, BLOCK + 1, len(a)):
        assert (oc.verdicts(a[:count], b[:count]) == wanted[:count]).all()


def test_answers_are_the_same_for_any_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verdict_module, "FEWEST_PAIRS", 10)
    monkeypatch.setattr(separations_module, "FEWEST_PAIRS", 10)
    a, b = pairs_of("ordinary scene", 500)
    seen = set()
    for threads in (1, 2, 3, 5):
        oc.set_threads(threads)
        found = oc.separations(a, b)
        assert (found.verdicts == oc.verdicts(a, b)).all()
        seen.add(
            b"".join(
                x.tobytes()
                for x in (found.verdicts, found.separations, found.normals, found.positions)
            )
        )
    assert len(seen) == 1
