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

"""Parameters, set to every type by another node: taken or refused with a reason, no more.

Filters, groups, regions and accuracy change while the node runs.
"""

from __future__ import annotations

from collections.abc import Iterator
from fnmatch import fnmatchcase
from math import inf, nan, nextafter
from pathlib import Path
from typing import Any
from unittest.mock import Mock, patch

import pytest
import yaml
from each import each
from objects_rig import RING, crate, levels, ring
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rig import Rig, cube, pose, sync
from visualization_msgs.msg import Marker

from obb_collision import Accuracy
from obb_collision.node.parameters import entries
from obb_collision.node.parameters.entries import MAX_PATTERNS, Spec
from obb_collision.node.parameters.parameters import SPECS
from obb_collision.regions import Region
from obb_collision.scene.store.patterns import Overrides, override_from_text, padding_from_text

ROOT = Path(__file__).parents[3]
FIELDS: dict[str, list[Any]] = {
    "not_set": [None],
    "bool": [False],
    "integer": [0, 5, -(2**63), 2**63 - 1],
    "double": [5.0, -1.0, nan, inf, 1e308],
    "string": ["", "a", "timer", "a b", "a: b", "\x00", "x" * 5000, "%s{0}\n"],
    "byte_array": [[], [b"\x00", b"\xff"]],
    "bool_array": [[], [True, False]],
    "integer_array": [[], [1, 2]],
    "double_array": [[], [1.0, float("nan")]],
    "string_array": [[], ["", " "], ["a b"], ["a/*: mush"], ["\x1b"], ["x" * 5000], ["a"] * 10**4],
}
"""Values by the type of ROS."""
KIND = {bool: "bool", int: "integer", float: "double", str: "string", list: "string_array"}


def message(name: str, kind: str, value: Any) -> Parameter:
    given = ParameterValue(type=getattr(ParameterType, f"PARAMETER_{kind.upper()}"))
    if value is not None:
        setattr(given, f"{kind}_value", value)
    return Parameter(name=name, value=given)


def ask(rig: Rig, *parameters: Parameter) -> list[Any]:
    """Set parameters as another node does; return the results."""
    name = f"{rig.node.get_fully_qualified_name()}/set_parameters"
    request = SetParameters.Request(parameters=list(parameters))
    return list(rig.call(SetParameters, name, request).results)


def ask_for_all(rig: Rig, *parameters: Parameter) -> Any:
    """Set all parameters or none of them as another node does; return the result."""
    name = f"{rig.node.get_fully_qualified_name()}/set_parameters_atomically"
    request = SetParametersAtomically.Request(parameters=list(parameters))
    return rig.call(SetParametersAtomically, name, request).result


def may_be(spec: Spec, kind: str, value: Any) -> bool:
    """Return whether a value of this type may ever be taken."""
    if spec.fixed:
        return False
    if isinstance(spec.default, list):
        return kind in ("string", "string_array") or (kind.endswith("_array") and value == [])
    if spec.choices and kind == "bool":
        return isinstance(spec.default, str) and "off" in spec.choices
    return kind == KIND[type(spec.default)]


def check_usable(rig: Rig) -> None:
    for spec in SPECS:
        spec.read(rig.node.get_parameter(spec.name).value)
    rig.set(**{"rate": 50.0, "max_objects": 20000, "effects.collisions": "auto"})
    rig.send(cube(("a", 1)), cube(("a", 2), (0.5, 0.0, 0.0))).answer()


def test_every_type_for_every_parameter_is_taken_or_refused_with_a_reason(rig: Rig) -> None:
    given = [(kind, value) for kind, values in FIELDS.items() for value in values]
    for spec in SPECS:
        results = ask(rig, *(message(spec.name, *one) for one in given))
        for (kind, value), result in zip(given, results, strict=True):
            assert result.successful or result.reason, (spec.name, kind, value)
            assert may_be(spec, kind, value) or not result.successful, (spec.name, kind, value)
            assert len(result.reason) < 500
            assert not result.successful or spec.name != "fixed_frame"
    check_usable(rig)


def test_a_set_with_one_wrong_value_changes_nothing(rig: Rig) -> None:
    good = message("padding", "double", 0.125)
    for spec in SPECS:
        for kind in ("not_set", "integer_array", "byte_array", "double"):
            result = ask_for_all(rig, good, message(spec.name, kind, FIELDS[kind][-1]))
            assert not result.successful
            assert result.reason
    assert rig.node.parameters.padding == 0.0
    assert ask_for_all(rig, good, good).successful
    assert rig.node.parameters.padding == 0.125
    check_usable(rig)


def test_types_and_names_that_are_none_end_nothing(rig: Rig) -> None:
    wrong = [
        Parameter(name="padding", value=ParameterValue(type=200)),
        message("padding", "double", 0.25),
        message("paddign", "double", 0.5),
        message("", "double", 0.5),
        message("x" * 10**5, "string", "y"),
    ]
    results = ask(rig, *wrong)
    assert [result.successful for result in results] == [False, True, False, False, False]
    assert all(result.reason for result in results if not result.successful)
    for one in (wrong[0], wrong[2]):
        result = ask_for_all(rig, one)
        assert not result.successful
        assert result.reason
    assert rig.node.parameters.padding == 0.25
    check_usable(rig)


def test_a_change_that_cannot_be_applied_is_told_and_ends_nothing(rig: Rig) -> None:
    fails = Mock(side_effect=RuntimeError("not today"))
    with patch.object(rig.node.parameters, "on_change", fails):
        (result,) = ask(rig, message("padding", "double", 0.25))
    assert not result.successful
    assert "not today" in result.reason
    check_usable(rig)


def test_lists_have_a_limit() -> None:
    for spec in SPECS:
        if isinstance(spec.default, list):
            with pytest.raises(ValueError, match=f"with at most {spec.most} entries, got"):
                spec.read(["a/1 b/1"] * (spec.most + 1))
            with pytest.raises(ValueError, match=f"at most {MAX_PATTERNS} patterns, got 1001"):
                Spec(spec.name, [], entry=spec.entry, most=2000).read(["a/*: mesh"] * 1001)


def test_overrides_by_name_and_by_pattern_count_in_their_order() -> None:
    texts = ["a/1: mesh", "a/*: hull", "a/2: obb", "a/3: obb", "a/3: aabb"]
    texts += ["*: sphere", "a/4: hull"]
    names = [f"a/{number}" for number in range(6)] + ["b"]
    for count in range(len(texts) + 1):
        given = [override_from_text(text) for text in texts[:count]]
        for name in names:
            fitting = [level for where, level in given if fnmatchcase(name, where)]
            expected = fitting[-1] if fitting else None
            assert Overrides(given).value(name) == expected


@each(
    "text, read, expected",
    [
        ("a/b=hull", override_from_text, ("a/b/*", Accuracy.HULL)),
        ("=aabb", override_from_text, ("/*", Accuracy.AABB)),
        ("a:b/1 :obb", override_from_text, ("a:b/1", Accuracy.OBB)),
        ("*:sphere", override_from_text, ("*", Accuracy.SPHERE)),
        ("gripper=1e-3", padding_from_text, ("gripper/*", 0.001)),
        ("a:b/1 : 0", padding_from_text, ("a:b/1", 0.0)),
    ],
)
def test_overrides_are_read(text: str, read: Any, expected: Any) -> None:
    assert read(text) == expected


def wrong_values(spec: Spec) -> Iterator[tuple[Any, str]]:
    """Yield values beyond the limits and choices of a parameter, each with the reason."""
    if spec.fixed:
        yield spec.default, "read-only"
    elif isinstance(spec.default, list):
        yield [3], "a list of texts"
    elif isinstance(spec.default, str) and spec.choices:
        yield "maybe", f"one of {spec.choices[0]}, "
    elif spec.limits is not None:
        kind, wrong = type(spec.default), [spec.limits[0] - 1, 2 * spec.limits[1] + 1]
        for value in [*map(kind, wrong), *([nan, inf] if kind is float else [])]:
            yield value, "range"
        if kind is float:
            yield nextafter(spec.limits[1], inf), "between"
        yield (10 if kind is float else 10.5), "type"


@each(
    "name, value, reason",
    [
        *((spec.name, *wrong) for spec in SPECS for wrong in wrong_values(spec)),
        ("accuracy_overrides", ["a/*: exact"], "accuracy must be one of"),
        ("accuracy_overrides", ["a/*"], "is not like 'gripper/*: mesh'"),
        ("accuracy_overrides", ["arm: mesh"], "all of a namespace are 'arm/*'"),
        ("accuracy", "obb_faces", "not 'obb_faces': use obb or hull instead"),
        ("allowed_pairs", ["a/*"], "two names or patterns"),
        ("groups", ["gripper"], "is not like 'gripper: hand/* finger/1'"),
        ("groups", ["a/b: c/1"], "a group cannot have the name 'a/b'"),
        ("groups", ["one: two"], "'two' is not a group"),
        ("groups", ["one: 'a/1"], "no closing quotation"),
        ("check_only_pairs", ["a/* b/* c/*"], "two names or patterns"),
        ("check_only_pairs", ["a/* gripper"], "check_only_pairs: 'gripper' is not a group"),
        ("object_timeout_overrides", ["a/*: -0.1"], "seconds must be between 0 and 1e+06"),
        ("padding_overrides", ["a/*: -0.1"], "between 0 and 1000 m"),
        ("padding_overrides", ["a/*: nan"], "between 0 and 1000 m"),
        ("padding_overrides", ["a/*: wide"], "padding must be a number"),
        ("padding_overrides", ["arm: 0.1"], "all of a namespace are 'arm/*'"),
        *(("region", [text], "region: ") for text in ("w: 0 to 1", "x: 1 to 1", "x: 0")),
        *(("region", [text], "region: ") for text in ("x: nan to 1", "x: inf to inf")),
        ("effects.contacts", 3, "one of off, auto, on"),
        ("effects.contacts_max_points", 5, "one of 4, 8"),
        ("effects.contacts_objects", ["arm"], "effects.contacts_objects: 'arm' is not a group"),
    ],
)
def test_a_wrong_value_is_refused_and_why(rig: Rig, name: str, value: Any, reason: str) -> None:
    before = rig.node.get_parameter(name).value
    (result,) = rig.set(**{name: value})
    assert not result.successful
    assert reason in result.reason
    assert result.reason.startswith(name) or reason == "read-only" or not isinstance(value, list)
    assert rig.node.get_parameter(name).value == before


HERE = "arm: 0 0 0 0 0 0 1"


@each(
    "given, reason",
    [
        ({"allowed_pairs": ["gripper table/1"]}, "allowed_pairs: 'gripper' is not a group"),
        ({"region": ["z: 0 to inf"], "region_halo": 0.0}, "region_halo must be at least"),
        ({"mesh_folders": ["arm: /a", "arm: /b"]}, "one entry per package"),
        *(
            ({"mesh_folders": [folder]}, "is neither an absolute path")
            for folder in ("meshes", "./meshes", "~", "file:///tmp", "..: /a", "arm: b")
        ),
        ({"robots": ["arm", "arm"]}, "twice"),
        ({"robots": ["an arm"]}, "letters"),
        ({"robots": ["arm"], "robot_bases": ["leg: base"]}, "is not in the parameter robots"),
        ({"robots": ["arm"], "robot_bases": ["arm: 0 0 0 0 0 0 0"]}, "not a pose"),
        ({"robots": ["arm"], "robot_bases": [HERE, HERE]}, "twice"),
    ],
)
def test_parameters_that_make_no_sense_end_the_start(given: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        Rig(given=given)


def test_the_file_of_the_package_has_every_parameter_at_its_default() -> None:
    content = yaml.safe_load((ROOT / "config" / "obb_collision.yaml").read_text())
    given = content["/**"]["ros__parameters"]
    flat = {key: value for key, value in given.items() if not isinstance(value, dict)}
    flat |= {f"effects.{key}": value for key, value in given["effects"].items()}
    assert set(flat) == {spec.name for spec in SPECS}
    for spec in SPECS:
        assert flat[spec.name] == spec.default, spec.name
        assert type(flat[spec.name]) is type(spec.default), spec.name


def fill(rig: Rig) -> set[tuple[str, str]]:
    """Send two cubes of each of two namespaces and one that nobody names, all in one place."""
    rig.send(*(cube((ns, k), (0.1 * k, 0, 0)) for ns in ("arm", "cup") for k in (1, 2)))
    rig.send(cube(("tray", 1)))
    return rig.pairs()


def until_pairs(rig: Rig, count: int) -> set[tuple[str, str]]:
    """Wait until so many pairs collide; returns them."""
    rig.until(lambda: rig.next("collisions").width == count, f"{count} pairs")
    return sync(rig)


def set_lists(rig: Rig, **values: list[str]) -> Any:
    """Set lists of texts as another node does, all or none; return the result."""
    return ask_for_all(rig, *(message(n, "string_array", value) for n, value in values.items()))


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
        assert extents == {"arm/1": 0.5, "arm/2": 0.5, "cup/1": 0.75, "cup/2": 0.75, "tray/1": 0.75}
        accuracies = {"arm/1": 3, "cup/1": 1, "cup/2": 1, "tray/1": 1}
        store = scene.objects.store
        assert accuracies == {n: int(store.accuracies[scene.index(n)]) for n in accuracies}
        # the second entry was made of what the group had until then
        assert scene.effects["separations"].objects == ("cup/2", "tray/*", "arm/*")
        rig.set(groups=["moved: cup/*", "all: moved"])
        until_pairs(rig, 9)
        assert float(scene.obb("tray/1").half_extents[0]) == 0.5


def test_lists_that_do_not_fit_each_other_are_refused_together_or_taken_together(rig: Rig) -> None:
    assert len(fill(rig)) == 10
    refused = set_lists(rig, groups=["moved: cup/*"], allowed_pairs=["moved tary"])
    assert not refused.successful
    assert refused.reason.startswith("allowed_pairs: 'tary' is not a group")
    assert rig.node.get_parameter("groups").value == [""]
    taken = set_lists(rig, allowed_pairs=["moved tray/*"], groups=["moved: cup/*"])
    assert taken.successful, taken.reason
    until_pairs(rig, 8)
    (result,) = rig.set(groups=["movde: cup/*"])
    assert not result.successful
    assert "'moved' is not a group" in result.reason
    assert "did you mean movde?" in result.reason
    until_pairs(rig, 8)
    assert set_lists(rig, allowed_pairs=[""], groups=[""]).successful
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
    region = Region([-inf, 0, -inf], [inf, 1, inf], 0.05)
    rig.until(lambda: rig.node.objects.scene.region == region, "the region")
    assert rig.node.guard.total == 0


def test_a_region_is_the_same_after_it_was_a_parameter() -> None:
    region = Region([-inf, 0.1, 1 / 3], [0.1 + 0.2, inf, 1e300])
    found = [entries.range_from_text(text) for text in entries.text_from_region(region)]
    assert found == [("x", -inf, 0.1 + 0.2), ("y", 0.1, inf), ("z", 1 / 3, 1e300)]
    assert entries.text_from_region(Region([-inf] * 3, [inf] * 3)) == [""]


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
        key = "left on obb by the time budget"
        assert key not in said(rig, "clearance on mesh")
        rig.set(time_budget=1e-9)
        rig.send_transform("box/1", pose(1e-4)).answer()  # else what is there is kept
        seen = rig.until(lambda: (s := said(rig, "clearance on obb")).get(key) == "some" and s, key)
        assert "clearance on mesh" not in seen


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
