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

"""Accuracy in the node: levels by parameters, by names, at run time, and where they are told."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy")
from rig import Rig, cube, pose, sync
from rings import RING, crate, levels, ring

from obb_collision.node import collisions_from_ros


def test_triangles_of_markers_are_looked_at_where_the_accuracy_says_so() -> None:
    with Rig(accuracy="mesh") as rig:
        rig.send(ring(), crate())
        rig.built(RING)
        assert sync(rig) == set(), "the crate is in the middle of the ring"
        rig.send_transform("box/1", pose(0.75))
        assert rig.pairs() == {("mesh/1", "box/1")}
        assert levels(rig) == ["mesh"]


def test_the_accuracy_changes_at_run_time_and_is_told() -> None:
    with Rig() as rig:
        rig.listen("collisions_text", "/diagnostics")
        rig.send(ring(), crate())
        rig.built(RING)
        assert sync(rig) == {("mesh/1", "box/1")}
        assert levels(rig) == ["obb"]
        values = {pair.key: pair.value for pair in rig.next("collisions_text").status[1].values}
        assert values["accuracy"] == "obb"
        assert rig.status(": objects")["pairs on obb"] == "1"
        assert all(result.successful for result in rig.set(accuracy="mesh"))
        rig.until(lambda: levels(rig) == [], "kernels ready, pair gone")
        assert "pairs on obb" not in rig.status(": objects")
        rig.set(accuracy="sphere")
        rig.until(lambda: levels(rig) == ["sphere"], "a coarser level")
        assert rig.status(": objects")["pairs on sphere"] == "1"


def test_diagnostics_say_what_effects_are_computed_on_and_that_a_budget_lowers_them() -> None:
    given = {"effects.clearance": "on", "effects.clearance_max_distance": 5.0}
    with Rig(accuracy="mesh", given=given) as rig:
        rig.listen("/diagnostics")
        rig.send(ring(), crate())
        rig.built(RING)
        seen = said(rig, "clearance on mesh")
        assert seen["clearance on mesh"] == "1"
        assert "highest accuracy in the time budget" not in seen
        rig.set(time_budget=1e-9)
        for step in range(20):  # what it has time for is measured first
            rig.send_transform("box/1", pose(1e-4 * step))
            rig.answer()
        seen = said(rig, "clearance on obb")
        assert seen["clearance on obb"] == "1"
        assert "clearance on mesh" not in seen
        assert seen["highest accuracy in the time budget"] == "obb"


def said(rig: Rig, key: str) -> dict[str, str]:
    """Return the status of the objects once it has a key."""
    for _ in range(50):
        status = rig.status(": objects")
        if key in status:
            return status
    raise AssertionError(f"no {key!r} in {status}")


def test_overrides_are_for_names_and_namespaces_also_of_objects_to_come() -> None:
    with Rig(accuracy_overrides=["*: sphere", "box=obb", "mesh/1: obb"]) as rig:
        rig.send(cube(("box", 1)), cube(("box", 2), (0.5, 0, 0)), cube(("a", 1), (9.0, 0.0, 0.0)))
        assert rig.pairs() == {("box/1", "box/2")}
        assert levels(rig) == ["obb"]
        rig.send(cube(("mesh", 1)), cube(("a", 2), (10.2, 0.0, 0.0)))
        assert rig.pairs() == {
            ("box/1", "box/2"),
            ("mesh/1", "box/1"),
            ("mesh/1", "box/2"),
            ("a/1", "a/2"),  # spheres meet where cubes are apart
        }
        assert sorted(levels(rig)) == ["obb", "obb", "obb", "sphere"]
        rig.set(accuracy_overrides=[""])
        rig.until(lambda: levels(rig) == ["obb"] * 3, "no overrides")


def test_an_override_outlives_a_change_of_shape() -> None:
    with Rig(accuracy_overrides=["a/*: aabb"]) as rig:
        rig.send(cube(("a", 1)), cube(("a", 2), (0.5, 0, 0)))
        rig.answer()
        rig.send(cube(("a", 1), size=(2.0, 2.0, 2.0)))
        assert rig.pairs() == {("a/1", "a/2")}
        assert levels(rig) == ["aabb"]


def test_allowed_pairs_may_touch_and_may_change() -> None:
    with Rig(allowed_pairs=["a/* b/1"]) as rig:
        rig.send(cube(("a", 1)), cube(("a", 2), (0.5, 0, 0)), cube(("b", 1), (0.2, 0, 0)))
        assert rig.pairs() == {("a/1", "a/2")}
        rig.set(allowed_pairs=["a/1 a/2", "a/2 b/*"])
        rig.until(lambda: len(collisions_from_ros(rig.next("collisions"))) == 1, "other pairs")
        assert sync(rig) == {("a/1", "b/1")}
        rig.set(allowed_pairs=[""])
        rig.until(lambda: len(collisions_from_ros(rig.next("collisions"))) == 3, "all pairs")
