"""The comparison of meshes runs, and all sides agree."""

from __future__ import annotations

import pytest

from obb_collision.benchmarks.mesh_peers import compare, installed, meshes


def test_all_sides_agree_and_are_timed() -> None:
    if not installed():
        pytest.skip("neither python-fcl nor coal is installed")
    first, second = meshes()["box 12 / box 12"]
    row = compare(first, second, 50, 0.8)
    for peer in installed():
        assert row[f"{peer}_differ"] == 0
        assert row[f"{peer}_ratio"] > 0.0
    assert 0.0 < row["colliding"] < 1.0
