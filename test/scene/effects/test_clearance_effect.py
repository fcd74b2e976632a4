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

"""The effect ``clearance`` against looking at all pairs of a scene."""

import numpy as np
from each import each
from one_set import clearances
from scenes import filled_scene, random_poses

import obb_collision as oc


def all_clearances(scene: oc.Scene, max_distance: float) -> dict[tuple[int, int], float]:
    boxes, slots = scene.boxes, scene.indices
    pairs = np.array([(i, j) for i in range(len(slots)) for j in range(i + 1, len(slots))])
    distances = clearances(boxes, pairs).distances
    near = distances <= max_distance
    keys = map(tuple, slots[pairs[near]].tolist())
    return dict(zip(keys, distances[near].tolist(), strict=True))


def found(report: oc.Report) -> dict[tuple[int, int], float]:
    near = report.clearances
    keys = map(tuple, near.pairs.tolist())
    return dict(zip(keys, near.distances.tolist(), strict=True))


@each("limit", [0.0, 0.05, 1.0, 100.0])
def test_all_pairs_within_the_limit_are_there_and_no_others(limit: float) -> None:
    scene = filled_scene(40)
    scene.set_effect("clearance", max_distance=limit)
    report = scene.check()
    assert found(report) == all_clearances(scene, limit)
    keys = report.clearances.pairs
    assert keys.tolist() == sorted(keys.tolist())
    assert {tuple(pair) for pair in report.pairs.tolist()} <= set(found(report))


def test_pairs_of_callers_only_and_not_allowed_ones() -> None:
    scene = filled_scene(80)
    scene.set_effect("clearance", max_distance=0.5, objects=["box/7"])
    everything = all_clearances(scene, 0.5)
    assert found(scene.check()) == {k: d for k, d in everything.items() if 7 in k}
    some = [f"box/{k}" for k in range(0, 80, 2)]
    scene.set_effect("clearance", objects=some)
    even = {k: d for k, d in everything.items() if k[0] % 2 == 0 or k[1] % 2 == 0}
    assert found(scene.check()) == even
    scene.allow("box/4", "*")
    assert found(scene.check()) == {k: d for k, d in even.items() if 4 not in k}
    scene.set_enabled("box/6", False)
    assert not any(6 in k or 4 in k for k in found(scene.check()))


def test_a_late_reader_gets_the_clearances_of_the_check() -> None:
    scene = filled_scene(30)
    scene.set_effect("clearance", max_distance=0.3)
    expected = all_clearances(scene, 0.3)
    report = scene.check()
    scene.move_indices(scene.indices, random_poses(30, np.random.default_rng(1), 2.0))
    assert found(report) == expected
