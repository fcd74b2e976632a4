"""The comparison of meshes runs, and both sides agree."""

from __future__ import annotations

import pytest

from obb_collision.benchmarks.mesh_peers import compare, meshes


def test_both_sides_agree_and_are_timed() -> None:
    pytest.importorskip("fcl")
    first, second = meshes()["box 12 / box 12"]
    row = compare(first, second, 50, 0.8)
    assert row["disagree"] == 0
    assert row["ratio"] > 0.0
    assert 0.0 < row["colliding"] < 1.0
