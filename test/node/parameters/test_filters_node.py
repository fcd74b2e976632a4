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

"""Filters and paddings by name while the node runs: which pairs count, and boxes drawn larger."""

from __future__ import annotations

from typing import Any

import pytest
from each import each

pytest.importorskip("rclpy")
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParametersAtomically
from rig import Rig, cube, sync
from visualization_msgs.msg import Marker

from obb_collision.node import collisions_from_ros
from obb_collision.node.parameters.groups import Groups, group_from_text, pair_from_text


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
    kind = ParameterType.PARAMETER_STRING_ARRAY
    parameters = [
        Parameter(name=name, value=ParameterValue(type=kind, string_array_value=value))
        for name, value in values.items()
    ]
    name = f"{rig.node.get_fully_qualified_name()}/set_parameters_atomically"
    request = SetParametersAtomically.Request(parameters=parameters)
    return rig.call(SetParametersAtomically, name, request).result


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
        assert levels == {n: int(scene._store.accuracies[scene.index(n)]) for n in levels}
        # the second entry was made of what the group had until then
        assert scene.effect_setting("separations").objects == ("cup/2", "tray/*", "arm/*")
        rig.set(groups=["moved: cup/*", "all: moved"])
        until_pairs(rig, 9)
        assert float(scene.obb("tray/1").half_extents[0]) == 0.5


def test_lists_that_do_not_fit_each_other_are_refused_together_or_taken_together(
    rig: Rig,
) -> None:
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


def test_a_node_whose_lists_do_not_fit_does_not_start() -> None:
    with pytest.raises(ValueError, match="allowed_pairs: 'gripper' is no group"):
        Rig(allowed_pairs=["gripper table/1"])


def test_groups_are_limited_with_all_that_they_stand_for() -> None:
    many = [group_from_text("many: " + " ".join(f"a/{k}" for k in range(50)))]
    assert len(Groups(many).meant("many")) == 50
    names = [("many", tuple(f"a/{k}" for k in range(20001)))]
    with pytest.raises(ValueError, match="more than 20000 members"):
        Groups(names)


def test_words_with_spaces_are_in_quotes() -> None:
    assert pair_from_text("'my arm/*' table/1") == ("my arm/*", "table/1")
    assert group_from_text("my group: 'my arm/*' b/1") == ("my group", ("my arm/*", "b/1"))


@each("form", ["cubes", "lines"])
def test_padding_shows_in_the_markers(form: str) -> None:
    with Rig(padding=0.125, marker_form=form, marker_rate=100.0) as rig:
        rig.listen("obb_collision/markers")
        rig.send(cube(("arm", 1)), cube(("cup", 1), (9.0, 0, 0)))
        rig.answer()

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
