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

"""The effect ``contacts``: patches of the colliding pairs, computed where they changed."""

import numpy as np
import pytest
from each import each
from one_set import contacts
from scenes import filled_scene

import obb_collision as oc
from obb_collision.queries.contacts.contacts import Contacts


def assert_equal(found: Contacts, expected: Contacts) -> None:
    for field in vars(expected):
        np.testing.assert_array_equal(getattr(found, field), getattr(expected, field))


@each("max_points", [4, 8])
def test_all_colliding_pairs_have_the_patch_of_their_boxes(max_points: int) -> None:
    scene = filled_scene(60)
    scene.set_effect("contacts", max_points=max_points)
    report = scene.check()
    found = report.contacts
    assert found.pairs.tolist() == report.pairs.tolist()
    assert (found.counts >= 1).all()
    assert (found.depths == report.depths).all()
    assert_equal(found, contacts(scene.boxes, report.pairs, max_points))


def test_patches_of_callers_only_and_what_rests_is_copied() -> None:
    scene = filled_scene(400)
    some = [f"box/{k}" for k in range(100)]
    scene.set_effect("contacts", "on", objects=some)
    scene.check()
    scene.move("box/3", [*scene.obb("box/5").center.tolist(), 0, 0, 0, 1])
    report = scene.check()
    found = report.contacts
    assert found.pairs.tolist() == [pair for pair in report.pairs.tolist() if min(pair) < 100]
    assert 0 < report.costs["contacts"].count < 20 < len(found.pairs)
    assert_equal(found, contacts(scene.boxes, found.pairs))
    scene.set_effect("contacts", max_points=8)  # other options: nothing can be copied
    assert scene.check().costs["contacts"].count == len(found.pairs)


def test_a_patch_option_that_cannot_be_used_is_refused() -> None:
    for value in (5, 0, np.nan):
        with pytest.raises(ValueError, match="contacts max_points must be"):
            oc.Scene().set_effect("contacts", max_points=value)
