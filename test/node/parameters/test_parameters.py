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

from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import pytest
import yaml
from each import each

pytest.importorskip("rclpy")
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rig import Rig, cube

from obb_collision.node.parameters.parameters import SPECS
from obb_collision.node.parameters.specs import MAX_PATTERNS, Spec
from obb_collision.scene.store.overrides import Overrides, override_from_text

ROOT = Path(__file__).parents[3]
FIELDS: dict[str, list[Any]] = {
    "not_set": [None],
    "bool": [False],
    "integer": [0, 5, -(2**63), 2**63 - 1],
    "double": [5.0, -1.0, float("nan"), float("inf"), 1e308],
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
    """Return a parameter as another node sends it."""
    given = ParameterValue(type=getattr(ParameterType, f"PARAMETER_{kind.upper()}"))
    if value is not None:
        setattr(given, f"{kind}_value", value)
    return Parameter(name=name, value=given)


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
    """Check that the node goes on and that all it has are values that can be used."""
    for spec in SPECS:
        spec.read(rig.node.get_parameter(spec.name).value)
    rig.set(**{"rate": 50.0, "max_objects": 20000, "effects.collisions": "auto"})
    rig.send(cube(("a", 1)), cube(("a", 2), (0.5, 0.0, 0.0)))
    rig.answer()


def test_every_type_for_every_parameter_is_taken_or_refused_with_a_reason(rig: Rig) -> None:
    name = f"{rig.node.get_fully_qualified_name()}/set_parameters"
    for spec in SPECS:
        given = [(kind, value) for kind, values in FIELDS.items() for value in values]
        request = SetParameters.Request(parameters=[message(spec.name, *one) for one in given])
        results = rig.call(SetParameters, name, request).results
        assert len(results) == len(given)
        for (kind, value), result in zip(given, results, strict=True):
            assert result.successful or result.reason, (spec.name, kind, value)
            assert may_be(spec, kind, value) or not result.successful, (spec.name, kind, value)
            assert len(result.reason) < 500
            assert not result.successful or spec.name != "fixed_frame"
    check_usable(rig)


def test_a_set_with_one_wrong_value_changes_nothing(rig: Rig) -> None:
    name = f"{rig.node.get_fully_qualified_name()}/set_parameters_atomically"
    good = message("padding", "double", 0.125)
    for spec in SPECS:
        for kind in ("not_set", "integer_array", "byte_array", "double"):
            value = FIELDS[kind][-1]
            request = SetParametersAtomically.Request()
            request.parameters = [good, message(spec.name, kind, value)]
            result = rig.call(SetParametersAtomically, name, request).result
            assert not result.successful
            assert result.reason
    assert rig.node.parameters.padding == 0.0
    request = SetParametersAtomically.Request(parameters=[good, good])
    assert rig.call(SetParametersAtomically, name, request).result.successful
    assert rig.node.parameters.padding == 0.125
    check_usable(rig)


def test_types_and_names_that_are_none_end_nothing(rig: Rig) -> None:
    node = rig.node.get_fully_qualified_name()
    wrong = [
        Parameter(name="padding", value=ParameterValue(type=200)),
        message("padding", "double", 0.25),
        message("paddign", "double", 0.5),
        message("", "double", 0.5),
        message("x" * 10**5, "string", "y"),
    ]
    request = SetParameters.Request(parameters=wrong)
    results = rig.call(SetParameters, f"{node}/set_parameters", request).results
    assert [result.successful for result in results] == [False, True, False, False, False]
    assert all(result.reason for result in results if not result.successful)
    for one in (wrong[:1], wrong[2:3]):
        atomic = SetParametersAtomically.Request(parameters=one)
        response = rig.call(SetParametersAtomically, f"{node}/set_parameters_atomically", atomic)
        assert not response.result.successful
        assert response.result.reason
    assert rig.node.parameters.padding == 0.25
    check_usable(rig)


def test_a_change_that_cannot_be_applied_is_told_and_ends_nothing(rig: Rig) -> None:
    def fail() -> None:
        raise RuntimeError("not today")

    applying, rig.node.parameters.on_change = rig.node.parameters.on_change, fail
    request = SetParameters.Request(parameters=[message("padding", "double", 0.25)])
    name = f"{rig.node.get_fully_qualified_name()}/set_parameters"
    (result,) = rig.call(SetParameters, name, request).results
    assert not result.successful
    assert "not today" in result.reason
    rig.node.parameters.on_change = applying
    check_usable(rig)


def test_a_parameter_without_a_value_is_refused_with_the_reason() -> None:
    for spec in SPECS:
        if not isinstance(spec.default, list):
            with pytest.raises(ValueError, match=f"^{spec.name} must be "):
                spec.read(None)


@each("value", [3, 0, True, False, 0.0, b"a", {"a": 1}, [b"a"], [["a"]], object])
def test_lists_are_lists_of_texts_or_refused(value: Any) -> None:
    for spec in SPECS:
        if isinstance(spec.default, list):
            with pytest.raises(
                ValueError, match=f"^{spec.name} must be a list of texts(, got | of at most)"
            ):
                spec.read(value)


@each("entry", ["\ud800", "a\x00 b", "x" * 5000, "a\nb: mesh"])
def test_texts_that_cannot_be_printed_or_are_too_long_are_refused(entry: str) -> None:
    for spec in SPECS:
        if isinstance(spec.default, (str, list)):
            with pytest.raises(ValueError, match=rf"^(an entry of )?{spec.name} must") as error:
                spec.read([entry] if isinstance(spec.default, list) else entry)
            assert str(error.value).isprintable()
            assert len(str(error.value)) < 800


def test_lists_have_a_limit() -> None:
    for spec in SPECS:
        if isinstance(spec.default, list):
            with pytest.raises(ValueError, match=f"of at most {spec.most}, got"):
                spec.read(["a/1 b/1"] * (spec.most + 1))
            with pytest.raises(ValueError, match=f"at most {MAX_PATTERNS} patterns, got 1001"):
                Spec(spec.name, [], entry=spec.entry, most=2000).read(["a/*: mesh"] * 1001)


def test_overrides_by_name_and_by_pattern_count_in_their_order() -> None:
    texts = [
        "a/1: mesh",
        "a/*: hull",
        "a/2: obb",
        "a/3: obb",
        "a/3: aabb",
        "*: sphere",
        "a/4: hull",
    ]
    names = [f"a/{number}" for number in range(6)] + ["b"]
    for count in range(len(texts) + 1):
        entries = [override_from_text(text) for text in texts[:count]]
        for name in names:
            fitting = [level for where, level in entries if fnmatchcase(name, where)]
            assert Overrides(entries).value(name) == (fitting[-1] if fitting else None)


def test_the_file_of_the_package_describes_every_parameter() -> None:
    comments: dict[str, str] = {}
    text, inside = "", False
    for line in (ROOT / "config" / "obb_collision.yaml").read_text().splitlines():
        name, is_comment = line.partition(":")[0].strip(), line.strip().startswith("#")
        if not is_comment:
            comments[f"effects.{name}" if inside else name], text = text.strip(), ""
            inside |= name == "effects"
        else:
            text += " " + line.strip("# ")
    for spec in SPECS:
        assert comments[spec.name].startswith(spec.description), spec.name


def test_the_file_of_the_package_has_every_parameter_at_its_default() -> None:
    content = yaml.safe_load((ROOT / "config" / "obb_collision.yaml").read_text())
    given = content["/**"]["ros__parameters"]
    flat = {key: value for key, value in given.items() if not isinstance(value, dict)}
    flat |= {f"effects.{key}": value for key, value in given["effects"].items()}
    assert set(flat) == {spec.name for spec in SPECS}
    for spec in SPECS:
        assert flat[spec.name] == spec.default, spec.name
        assert type(flat[spec.name]) is type(spec.default), spec.name
