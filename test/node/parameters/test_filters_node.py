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

"""Filters, groups, regions and accuracy as parameters that change while the node runs."""

from __future__ import annotations

import math
from typing import Any

import pytest
from each import each
from objects_rig import RING, crate, levels, ring
from rig import Rig, cube, pose, sync
from test_parameters import ask_for_all, message
from visualization_msgs.msg import Marker

from obb_collision.node import collisions_from_ros
from obb_collision.node.parameters import entries
from obb_collision.regions import Region


def fill(rig: Rig) -> set[tuple[str, str]]:
    """Send two cubes of each of two namespaces and one that nobody names, all in one place."""
    rig.send(*(cube((ns, k), (0.1 * k, 0, 0)) for ns in ("arm", "cup") for k in (1, 2)))
    rig.send(cube(("tray", 1)))
    return rig.pairs()


def until_pairs(rig: Rig, count: int) -> set[tuple[str, str]]:
    """Wait until so many pairs collide; returns them."""
    rig.until(lambda: len(collisions_from_ros(rig.next("collisions"))) == count, f"{count} pairs")
    return sync(rig)


def set_atomically(rig: Rig, **values: list[str]) -> Any:
    """Set lists of texts as another node does, all or none; returns the result."""
    given = [message(name, "string_array", value) for name, value in values.items()]
    return ask_for_all(rig, *given)


def test_filters_change_while_the_node_runs(rig: Rig) -> None:
    assert len(fill(rig)) == 10
    rig.set(allowed_within=["*"])
    pairs = until_pairs(rig, 8)
    assert not {("arm/1", "arm/2"), ("cup/1", "cup/2")} & pairs
    rig.set(check_only_pairs=["arm/* tray/1", "cup/1 *"])
    assert until_pairs(rig, 5) == {
        *(("arm/1", "tray/1"), ("arm/2", "tray/1"), ("cup/1", "tray/1")),
        *(("arm/1", "cup/1"), ("arm/2", "cup/1")),
    }
    rig.set(allowed_pairs=["arm/1 tray/1"])
    assert ("arm/1", "tray/1") not in until_pairs(rig, 4)
    rig.set(allowed_within=["cup"], check_only_pairs=[""], allowed_pairs=[""])
    assert ("cup/1", "cup/2") not in until_pairs(rig, 9)
    rig.set(allowed_within=[""])
    until_pairs(rig, 10)


def test_groups_stand_for_their_members_in_every_list() -> None:
    lists = {
        "groups": ["moved: cup/2 tray/*", "all: moved arm/*", "moved: cup/1"],
        "allowed_pairs": ["moved moved"],
        "padding_overrides": ["moved: 0.25"],
        "accuracy_overrides": ["moved: aabb"],
        "effects.separations_objects": ["all"],
    }
    with Rig(given=lists) as rig:
        pairs = fill(rig)
        assert {("arm/1", "arm/2"), ("arm/1", "tray/1")} <= pairs
        assert not {("cup/1", "cup/2"), ("cup/1", "tray/1"), ("cup/2", "tray/1")} & pairs
        assert len(pairs) == 7
        scene = rig.node.objects.scene
        extents = {name: float(scene.obb(name).half_extents[0]) for name in scene.names}
        assert extents == {"arm/1": 0.5, "arm/2": 0.5} | dict.fromkeys(
            ("cup/1", "cup/2", "tray/1"), 0.75
        )
        levels = {"arm/1": 3, "cup/1": 1, "cup/2": 1, "tray/1": 1}
        assert levels == {n: int(scene.objects.store.accuracies[scene.index(n)]) for n in levels}
        # the second entry was made of what the group had until then
        assert scene.effects["separations"].objects == ("cup/2", "tray/*", "arm/*")
        rig.set(groups=["moved: cup/*", "all: moved"])
        until_pairs(rig, 9)
        assert float(scene.obb("tray/1").half_extents[0]) == 0.5


def test_lists_that_do_not_fit_each_other_are_refused_together_or_taken_together(rig: Rig) -> None:
    assert len(fill(rig)) == 10
    refused = set_atomically(rig, groups=["moved: cup/*"], allowed_pairs=["moved tary"])
    assert not refused.successful
    assert refused.reason.startswith("allowed_pairs: 'tary' is no group")
    assert rig.node.get_parameter("groups").value == [""]
    taken = set_atomically(rig, allowed_pairs=["moved tray/*"], groups=["moved: cup/*"])
    assert taken.successful, taken.reason
    until_pairs(rig, 8)
    (result,) = rig.set(groups=["movde: cup/*"])
    assert not result.successful
    assert "'moved' is no group" in result.reason
    assert "did you mean movde?" in result.reason
    until_pairs(rig, 8)
    assert set_atomically(rig, allowed_pairs=[""], groups=[""]).successful
    until_pairs(rig, 10)


def test_groups_are_limited_with_all_they_stand_for_and_words_with_spaces_are_in_quotes() -> None:
    many = [entries.group_from_text("many: " + " ".join(f"a/{k}" for k in range(50)))]
    assert len(entries.Groups(many).meant("many")) == 50
    names = [("many", tuple(f"a/{k}" for k in range(20001)))]
    with pytest.raises(ValueError, match="more than 20000 members"):
        entries.Groups(names)
    assert entries.pair_from_text("'my arm/*' table/1") == ("my arm/*", "table/1")
    assert entries.group_from_text("my group: 'my arm/*' b/1") == ("my group", ("my arm/*", "b/1"))


@each("form", ["cubes", "lines"])
def test_padding_shows_in_the_markers(form: str) -> None:
    with Rig(padding=0.125, marker_form=form, marker_rate=100.0) as rig:
        rig.send(cube(("arm", 1)), cube(("cup", 1), (9.0, 0, 0))).answer()

        def edges() -> dict[float, float]:
            """Extent along x of each box drawn, by where its centre is."""
            found: dict[float, float] = {}
            for marker in rig.next("obb_collision/markers").markers:
                if marker.type == Marker.CUBE and marker.action == Marker.ADD:
                    found[marker.pose.position.x] = marker.scale.x
                for low, high in ((-5.0, 4.5), (4.5, 15.0)):
                    inside = [p.x for p in marker.points if low < p.x < high]
                    if inside:
                        found[0.5 * (min(inside) + max(inside))] = max(inside) - min(inside)
            return found

        rig.until(lambda: edges() == {0.0: 1.25, 9.0: 1.25}, "the padding of all")
        rig.set(padding_overrides=["arm=0.5"])
        rig.until(lambda: edges() == {0.0: 2.0, 9.0: 1.25}, "the padding of a namespace")
        rig.send(cube(("arm", 1), size=(2.0, 1.0, 1.0)))
        rig.until(lambda: edges() == {0.0: 3.0, 9.0: 1.25}, "with another size")
        rig.set(padding_overrides=[""], padding=0.0)
        rig.until(lambda: edges() == {0.0: 2.0, 9.0: 1.0}, "no padding")


def test_only_pairs_of_the_region_are_published_and_only_what_is_near_is_drawn() -> None:
    with Rig(region=["x: -inf to 5.0"]) as rig:
        rig.send(*(cube(("a", n), (x, 0, 0)) for n, x in enumerate((0.0, 0.5, 5.75, 6.0, 50.0))))
        assert rig.pairs() == {("a/0", "a/1")}
        assert rig.status(": objects")["near the region"] == "4"
        assert rig.status(": objects")["region"] == "x: -inf to 5.0"
        drawn = rig.next("obb_collision/markers").markers
        assert {marker.id for marker in drawn if marker.ns == "a"} == {0, 1, 2, 3}
        assert rig.set(region=["x: 5.0 to inf"])[0].successful
        assert sync(rig) == {("a/2", "a/3")}
        rig.send(cube(("a", 2), (5.25, 0, 0)), cube(("a", 3), (5.0, 0, 0)))
        assert rig.pairs() == set()  # their common part begins at 4.75
        assert rig.set(region=[""])[0].successful
        assert sync(rig) == {("a/0", "a/1"), ("a/2", "a/3")}


def test_a_halo_smaller_than_what_effects_look_beyond_is_refused(rig: Rig) -> None:
    assert rig.set(region=["y: 0 to 1"])[0].successful
    (result,) = rig.set(**{"effects.clearance_max_distance": 1.5})
    assert not result.successful
    assert "region_halo must be at least effects.clearance_max_distance, 1.5 m" in result.reason
    for wrong in ({"region_halo": 0.05}, {"region": ["x: 0 to 1", "x: 2 to 3"]}):
        (result,) = rig.set(**wrong)
        assert not result.successful
    assert "at most one entry" in result.reason
    many = {"effects.clearance": "off", "region_halo": 0.05}
    assert all(one.successful for one in rig.set(**many))
    (result,) = rig.set(**{"effects.points_margin": 0.06})
    assert not result.successful
    region = Region([-math.inf, 0, -math.inf], [math.inf, 1, math.inf], 0.05)
    rig.until(lambda: rig.node.objects.scene.region == region, "the region")
    assert rig.node.guard.total == 0


def test_a_region_is_the_same_after_it_was_a_parameter() -> None:
    region = Region([-math.inf, 0.1, 1 / 3], [0.1 + 0.2, math.inf, 1e300])
    found = [entries.range_from_text(text) for text in entries.text_from_region(region)]
    assert found == [("x", -math.inf, 0.1 + 0.2), ("y", 0.1, math.inf), ("z", 1 / 3, 1e300)]
    assert entries.text_from_region(Region([-math.inf] * 3, [math.inf] * 3)) == [""]


def test_the_accuracy_changes_at_run_time_and_is_told(rig: Rig) -> None:
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
        rig.send(ring(), crate())
        rig.built(RING)
        seen = said(rig, "clearance on mesh")
        assert "highest accuracy in the time budget" not in seen
        rig.set(time_budget=1e-9)
        for step in range(20):  # what it has time for is measured first
            rig.send_transform("box/1", pose(1e-4 * step)).answer()
        seen = said(rig, "clearance on obb")
        assert "clearance on mesh" not in seen
        assert seen["highest accuracy in the time budget"] == "obb"


def said(rig: Rig, key: str) -> Any:
    """Return the status of the objects once it says 1 of something."""
    return rig.until(lambda: (s := rig.status(": objects")).get(key) == "1" and s, key)


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


def test_an_override_outlives_a_change_of_shape(rig: Rig) -> None:
    rig.set(accuracy_overrides=["a/*: aabb"])
    rig.send(cube(("a", 1)), cube(("a", 2), (0.5, 0, 0))).answer()
    rig.send(cube(("a", 1), size=(2.0, 2.0, 2.0)))
    assert rig.pairs() == {("a/1", "a/2")}
    assert levels(rig) == ["aabb"]
