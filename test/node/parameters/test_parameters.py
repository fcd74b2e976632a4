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

"""Every parameter set to every type by another node: taken or refused with a reason, no more."""

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
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rig import Rig, cube

from obb_collision import Accuracy
from obb_collision.node.parameters.entries import MAX_PATTERNS, Spec
from obb_collision.node.parameters.parameters import SPECS
from obb_collision.scene.store import Overrides, limited, override_from_text, padding_from_text

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
            with pytest.raises(ValueError, match=f"of at most {spec.most}, got"):
                spec.read(["a/1 b/1"] * (spec.most + 1))
            with pytest.raises(ValueError, match=f"at most {MAX_PATTERNS} patterns, got 1001"):
                Spec(spec.name, [], entry=spec.entry, most=2000).read(["a/*: mesh"] * 1001)


def test_overrides_by_name_and_by_pattern_count_in_their_order_and_may_be_limited() -> None:
    texts = ["a/1: mesh", "a/*: hull", "a/2: obb", "a/3: obb", "a/3: aabb"]
    texts += ["*: sphere", "a/4: hull"]
    names = [f"a/{number}" for number in range(6)] + ["b"]
    for count in range(len(texts) + 1):
        entries = [override_from_text(text) for text in texts[:count]]
        for name in names:
            fitting = [level for where, level in entries if fnmatchcase(name, where)]
            expected = fitting[-1] if fitting else None
            assert Overrides(entries).value(name) == expected
            for low, high in ((Accuracy.SPHERE, Accuracy.OBB), (Accuracy.OBB, Accuracy.MESH)):
                value = limited(Overrides(entries).overrides, low, high).value(name)
                assert value == (None if expected is None else min(max(expected, low), high))


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
        ("groups", ["a/b: c/1"], "a group cannot be called 'a/b'"),
        ("groups", ["one: two"], "'two' is no group"),
        ("groups", ["one: 'a/1"], "no closing quotation"),
        ("check_only_pairs", ["a/* b/* c/*"], "two names or patterns"),
        ("check_only_pairs", ["a/* gripper"], "check_only_pairs: 'gripper' is no group"),
        ("object_timeout_overrides", ["a/*: -0.1"], "seconds must be between 0 and 1e+06"),
        ("padding_overrides", ["a/*: -0.1"], "between 0 and 1000 m"),
        ("padding_overrides", ["a/*: nan"], "between 0 and 1000 m"),
        ("padding_overrides", ["a/*: wide"], "padding must be a number"),
        ("padding_overrides", ["arm: 0.1"], "all of a namespace are 'arm/*'"),
        *(("region", [text], "region: ") for text in ("w: 0 to 1", "x: 1 to 1", "x: 0")),
        *(("region", [text], "region: ") for text in ("x: nan to 1", "x: inf to inf")),
        ("effects.contacts", 3, "one of off, auto, on"),
        ("effects.contacts_max_points", 5, "one of 4, 8"),
        ("effects.contacts_objects", ["arm"], "effects.contacts_objects: 'arm' is no group"),
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
        ({"allowed_pairs": ["gripper table/1"]}, "allowed_pairs: 'gripper' is no group"),
        ({"region": ["z: 0 to inf"], "region_halo": 0.0}, "region_halo must be at least"),
        ({"mesh_folders": ["arm: /a", "arm: /b"]}, "one entry for each package"),
        *(
            ({"mesh_folders": [folder]}, "is no absolute path")
            for folder in ("meshes", "./meshes", "~", "file:///tmp", "..: /a", "arm: b")
        ),
        ({"robots": ["arm", "arm"]}, "twice"),
        ({"robots": ["an arm"]}, "letters"),
        ({"robots": ["arm"], "robot_bases": ["leg: base"]}, "none of robots"),
        ({"robots": ["arm"], "robot_bases": ["arm: 0 0 0 0 0 0 0"]}, "no pose"),
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
