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

"""The comparisons of meshes and of convex shapes run, and all sides agree."""

from __future__ import annotations

import pytest

from tools.peers import convex_distances, mesh_distances
from tools.peers.meshes import compare, installed, meshes


def test_all_sides_agree_and_are_timed() -> None:
    if not installed():
        pytest.skip("neither python-fcl nor coal is installed")
    first, second = meshes()["box 12 / box 12"]
    row = compare(first, second, 50, 0.8)
    for peer in installed():
        assert row[f"{peer}_differ"] == 0
        assert f"{peer}_ratio" in row
    assert 0.0 < row["colliding"] < 1.0


def test_all_sides_measure_the_same_distances() -> None:
    peers = mesh_distances.installed()
    if not peers:
        pytest.skip("neither python-fcl nor coal is installed")
    first, second = meshes()["box 12 / box 12"]
    row = mesh_distances.compare(first, second, 50, 1.6)
    assert 0.0 < row["colliding"] < 1.0
    assert row["bounds_m"] < 1e-9
    for peer in peers:
        assert row[f"{peer}_differ_m"] < 1e-6
        assert f"{peer}_ratio" in row


@pytest.mark.parametrize("kinds", convex_distances.PAIRS, ids=" ".join)
def test_coal_measures_the_same_distances_and_depths_of_convex_shapes(
    kinds: tuple[str, str],
) -> None:
    pytest.importorskip("coal")
    rows = convex_distances.compare(kinds, 50)
    assert set(rows) == {"apart", "overlapping"}
    for row in rows.values():
        assert row["bounds_m"] < 1e-8
        assert row["coal_differs_m"] < 1e-5
        assert row["coal_ratio"] > 0.0
