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

"""What a scene says after any history of changes is what exact arithmetic says of its boxes."""

from __future__ import annotations

import numpy as np
import oracle
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from support import stored

import obb_collision as oc
from obb_collision.geometry.validation import orthonormal_defect

ROUNDOFF = 2.0**-53
#: How far from orthonormal the proof of the verdicts allows the axes to be.
ALLOWED_DEFECT = 64.0 * ROUNDOFF


def check_report(scene: oc.Scene, exact: bool) -> None:
    """Compare the report of a scene with the oracle, pair by pair."""
    report, boxes, indices = scene.check(), scene.boxes, scene.indices
    i, j = np.triu_indices(len(boxes), 1)
    truth = oracle.verdicts(stored(boxes[i]), stored(boxes[j]))
    said = {tuple(pair): v for pair, v in zip(report.pairs.tolist(), report.verdicts, strict=True)}
    assert list(said) == sorted(said)
    for a, b, true in zip(indices[i].tolist(), indices[j].tolist(), truth, strict=True):
        verdict = said.pop((a, b), oc.Verdict.SEPARATE)
        assert verdict == true or (verdict == oc.Verdict.TOUCHING and not exact)
    assert not said
    assert np.isfinite(report.normals).all()
    np.testing.assert_allclose(np.linalg.norm(report.normals, axis=1), 1.0, rtol=0, atol=1e-15)


def random_pose(rng: np.random.Generator, spread: float) -> np.ndarray:
    """Return a pose on a dyadic grid or anywhere, square to the axes or turned."""
    position = rng.uniform(-spread, spread, 3)
    if rng.random() < 0.5:
        position = np.round(4.0 * position) / 4.0
    quaternion = rng.normal(size=4) if rng.random() < 0.5 else np.eye(4)[rng.integers(4)]
    return np.concatenate([position, quaternion])


def random_shape(rng: np.random.Generator) -> oc.shapes.Shape | oc.OBB:
    if rng.random() < 0.5:
        return oc.shapes.Box(rng.integers(1, 5, 3) / 4.0)
    center, quaternion = rng.normal(size=3), rng.normal(size=4)
    return oc.OBB.from_quaternion(center, quaternion, rng.integers(0, 4, 3) / 4.0)


@pytest.mark.filterwarnings("ignore:.*far from unit length")
@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_any_history_of_changes(seed: int, exact: bool) -> None:
    """Objects come, go, move and are replaced; checks come in between."""
    rng = np.random.default_rng(seed)
    scene = oc.Scene(exact=exact)
    for step in range(60):
        name = f"object {rng.integers(14)}"
        what = rng.integers(8)
        if what < 4 or name not in scene:
            scene.add(name, random_shape(rng), random_pose(rng, 1.5))
        elif what < 6:
            scene.move(name, random_pose(rng, 1.5))
        elif what == 6:
            scene.remove(name)
        else:
            scene.move_many(scene.names, [random_pose(rng, 1.5) for _ in scene.names])
        if step % 8 == 7:
            check_report(scene, exact)


@pytest.mark.filterwarnings("ignore:.*far from unit length")
@each("exact", [False, True])
def test_a_wall_of_bricks_turned_as_one(exact: bool) -> None:
    """Resting contact everywhere, off by roundings after the turn: nothing may be lost."""
    scene = oc.Scene(exact=exact)
    rng = np.random.default_rng(2)
    turn = oc.OBB.from_quaternion(np.zeros(3), rng.normal(size=4), np.ones(3))
    for k, cell in enumerate(np.ndindex(4, 3, 2)):
        position = turn.rotation @ (np.array(cell) * [1.0, 0.5, 0.25])
        pose = np.concatenate([position, turn.quaternion])
        scene.add(f"brick {k}", oc.shapes.Box([1.0, 0.5, 0.25]), pose)
    check_report(scene, exact)


@pytest.mark.filterwarnings("ignore:.*far from unit length")
def test_axes_of_a_scene_stay_as_orthonormal_as_the_proof_needs() -> None:
    """A turned local box under a turned pose: the product of two roundings."""
    rng = np.random.default_rng(3)
    scene = oc.Scene()
    for k in range(3000):
        scene.add(str(k), random_shape(rng), random_pose(rng, 1.0))
    defect = np.abs(orthonormal_defect(scene.boxes.rotations)).max()
    assert 0.0 < defect <= ALLOWED_DEFECT
