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

"""The effects ``contacts`` and ``clearance`` on boxes, against asking about all pairs."""

import numpy as np
import pytest
from each import each
from one_set import clearances, contacts
from scenes import filled_scene, random_poses

import obb_collision as oc

Distances = dict[tuple[int, ...], float]


def all_clearances(scene: oc.Scene, max_distance: float) -> Distances:
    boxes, slots = scene.boxes, scene.indices
    pairs = np.stack(np.triu_indices(len(slots), 1), axis=1)
    distances = clearances(boxes, pairs).distances
    near = distances <= max_distance
    return dict(zip(map(tuple, slots[pairs[near]].tolist()), distances[near].tolist(), strict=True))


def found(report: oc.Report) -> Distances:
    near = report.clearances
    assert near.pairs.tolist() == sorted(near.pairs.tolist())
    return dict(zip(map(tuple, near.pairs.tolist()), near.distances.tolist(), strict=True))


@each("limit", [0.0, 0.0625, 1.0, 100.0])
def test_all_pairs_within_the_limit_are_there_and_no_others(limit: float) -> None:
    scene = filled_scene(40)
    scene.set_effect("clearance", max_distance=limit)
    report, expected = scene.check(), all_clearances(scene, limit)
    assert {tuple(pair) for pair in report.pairs.tolist()} <= set(expected)
    scene.move_indices(scene.indices, random_poses(40, np.random.default_rng(1), 2.0))
    assert found(report) == expected  # of the check, though read later
    scene = oc.Scene()
    for k in range(3):
        scene.add(f"{k}", oc.shapes.Box([1, 1, 1]), [(1.0 + limit) * k, 0, 0, 0, 0, 0, 1])
    scene.set_effect("clearance", max_distance=limit)
    near = scene.check().clearances
    assert near.pairs[near.distances == limit].tolist() == [[0, 1], [1, 2]]


def test_pairs_of_callers_only_and_not_allowed_ones() -> None:
    scene = filled_scene(80)
    scene.set_effect("clearance", max_distance=0.5, objects=["box/7"])
    everything = all_clearances(scene, 0.5)
    assert found(scene.check()) == {k: d for k, d in everything.items() if 7 in k}
    scene.set_effect("clearance", objects=[f"box/{k}" for k in range(0, 80, 2)])
    even = {k: d for k, d in everything.items() if k[0] % 2 == 0 or k[1] % 2 == 0}
    assert found(scene.check()) == even
    scene.allow("box/4", "*")
    assert found(scene.check()) == {k: d for k, d in even.items() if 4 not in k}
    scene.set_enabled("box/6", False)
    assert not any(6 in k or 4 in k for k in found(scene.check()))


def check_patches(scene: oc.Scene, report: oc.Report, max_points: int = 4) -> None:
    found = report.contacts
    for name, expected in vars(contacts(scene.boxes, found.pairs, max_points)).items():
        np.testing.assert_array_equal(getattr(found, name), expected)


@each("max_points", [4, 8])
def test_all_colliding_pairs_have_the_patch_of_their_boxes(max_points: int) -> None:
    scene = filled_scene(60)
    scene.set_effect("contacts", max_points=max_points)
    report = scene.check()
    assert report.contacts.pairs.tolist() == report.pairs.tolist()
    assert (report.contacts.counts >= 1).all()
    assert (report.contacts.depths == report.depths).all()
    check_patches(scene, report, max_points)


def test_a_patch_option_that_cannot_be_used_is_refused() -> None:
    for value in (5, 0, np.nan):
        with pytest.raises(ValueError, match="contacts max_points must be"):
            oc.Scene().set_effect("contacts", max_points=value)
