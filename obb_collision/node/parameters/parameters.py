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

"""The parameters of the node, declared, validated and updated."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from copy import copy
from difflib import get_close_matches
from traceback import format_exc
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.exceptions import InvalidParameterTypeException, ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter

from obb_collision.geometry.shapes.files import MeshFolders
from obb_collision.node.parameters.base import (
    NODE,
    GateParameters,
    group_names,
    has_gate,
    node_specs,
)
from obb_collision.node.parameters.entries import (
    Base,
    Spec,
    bases_of,
    check_words,
    folders_from,
    option_name,
    region_from,
)
from obb_collision.node.parameters.sources import (
    SourceSettings,
    check_names,
    check_sources,
    source_specs,
    sources_of,
)
from obb_collision.node.parameters.table import SPECS
from obb_collision.node.runtime.inner import parameter_overrides
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.store.region import Region
from obb_collision.words import shown

__all__ = ["SPECS", "Parameters"]

SPEC_OF = {spec.name: spec for spec in SPECS}
RESERVED = ("qos_overrides", "use_sim_time", "start_type_description_service")
"""Names of parameters that rclpy declares."""
ALIKE = 0.8
"""Minimum likeness of a misspelt name: files for several nodes have names of others."""


class Parameters:
    """Declared parameters of a node, as attributes: ``parameters.rate``; those of effects apart."""

    def __init__(self, node: Node) -> None:
        """Declare all; an invalid override ends the node with the reason."""
        self.on_change: Callable[[], object] = lambda: None
        self.on_check: Callable[[Parameters], object] = lambda parameters: None
        """Takes parameters as they would be, and raises ValueError where they are refused."""
        self._node = node
        self._values: dict[str, Any] = {}
        self._overridden: dict[str, Any] = {}
        self._specs: dict[str, Spec] = {}
        """Of all parameters, those of sources, too."""
        given = {name: given.value for name, given in parameter_overrides(node).items()}
        self._add(node_specs(SPECS, given))
        self.gate = GateParameters(self._add, self._values, given) if has_gate(given) else None
        """Those of a mobile base, if there is one."""
        self._unusable: dict[str, str] = {}
        """Why parameters of the gate can't be used: the node can't be configured, as nav2's."""
        for spec in NODE if self.gate is not None else ():
            try:
                self._add([spec])
            except (ValueError, ParameterException) as error:
                self._unusable[spec.name] = str(error)
                self._values[spec.name] = spec.read(spec.default)
                if not node.has_parameter(spec.name):
                    _declare(node, spec, ignore_override=True)
        names = self._values["sources"]
        check_names(names, {name.partition(".")[0] for name in (*SPEC_OF, *RESERVED)})
        for name in names:
            self._add(source_specs(name))
        _check_together(self._values)
        groups = group_names(self._values)
        named = [name for name in given if name.partition(".")[0] not in groups]
        for hint in misspelt(named, self._specs):
            node.get_logger().warning(hint)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._update)
        guard_parameter_services(node)

    def _add(self, specs: Iterable[Spec]) -> None:
        for spec in specs:
            self._specs[spec.name] = spec
            self._values[spec.name] = spec.read(_declare(self._node, spec))

    def declare_gate(self) -> list[str]:
        """Declare the parameters of zones; ValueError. Returns those given that are not used."""
        assert self.gate is not None
        for reason in self._unusable.values():
            raise ValueError(reason)
        names = {name.partition(".")[0] for name in (*SPEC_OF, *RESERVED)}
        return self.gate.declare(names.union(self._values["sources"]))

    def __getattr__(self, name: str) -> Any:
        try:
            return self.__dict__["_values"][name]
        except KeyError:
            raise AttributeError(f"no parameter {name!r}") from None

    @property
    def folders(self) -> MeshFolders:
        """The folders from which mesh files are read."""
        return folders_from(self._values)

    @property
    def bases(self) -> dict[str, Base]:
        """Where each robot stands, by its name."""
        return bases_of(self._values)

    @property
    def source_settings(self) -> list[SourceSettings]:
        """The settings of all sources."""
        return sources_of(self._values)

    @property
    def touch_links(self) -> list[tuple[str, str]]:
        """Patterns of links to which something is attached, and of links that it may touch."""
        return [pair for pairs in self._values["robot_touch_links"] for pair in pairs]

    @property
    def share(self) -> Region | None:
        """The region, None for everything."""
        return region_from(self._values)

    @property
    def allowed_delay(self) -> float:
        """How long (s) a cycle may take to end, and a state to be answered."""
        return 1.0 / float(self.rate) + float(self.cycle_timeout)

    def mode(self, effect: str) -> str:
        """Return off, auto or on."""
        return str(self._values[f"effects.{effect}"])

    def setting(self, effect: str) -> dict[str, Any]:
        """Return objects and options of one of ``EFFECTS``, as ``Scene.set_effect`` takes them."""
        keys = ("objects", *EFFECTS[effect].options)
        return {key: self._values[option_name(effect, key)] for key in keys}

    def option(self, topic: str, key: str) -> Any:
        """Return an option of a topic without effect."""
        return self._values[option_name(topic, key)]

    def override_defaults(self, values: Mapping[str, Any]) -> None:
        """Set the parameters that are at their defaults; ValueError for an invalid value."""
        new = [
            Parameter(name, value=value)
            for name, value in values.items()
            if self._values[name] == SPEC_OF[name].read(SPEC_OF[name].default)
        ]
        for result in self._node.set_parameters(new):
            if not result.successful:
                raise ValueError(result.reason)
        self._overridden = {parameter.name: self._values[parameter.name] for parameter in new}

    def restore_defaults(self) -> None:
        """Undo ``override_defaults``, but for what was changed since."""
        overridden, self._overridden = self._overridden, {}
        self._node.set_parameters(
            [
                Parameter(name, value=SPEC_OF[name].default)
                for name, value in overridden.items()
                if self._values[name] == value
            ]
        )

    def _check(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        """Refuse values that are invalid, or that do not fit each other; all of a set or none."""
        try:
            for parameter in parameters:
                if not parameter.name:  # rclpy takes it for declared
                    raise ValueError("a parameter needs a name")
                if parameter.value is None and self._is_declared(parameter.name):
                    raise ValueError(f"{parameter.name} cannot be removed")
            changed = copy(self)
            changed._values = {**self._values, **self._read(parameters)}
            if self.gate is not None:
                changed.gate = self.gate.with_values(changed._values)
            _check_together(changed._values)
            self.on_check(changed)
        except Exception as error:  # whatever the reader raises: the value is refused
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _is_declared(self, name: str) -> bool:
        return name in self._specs and self._node.has_parameter(name)

    def _update(self, parameters: Sequence[Parameter]) -> None:
        ours = self._read(parameters)
        self._values.update(ours)
        for name in ours:
            self._unusable.pop(name, None)
        if ours:  # others are declared while a subscription is made
            self.on_change()

    def _read(self, parameters: Sequence[Parameter]) -> dict[str, Any]:
        """Return the values of those parameters that are ours."""
        return {
            parameter.name: self._specs[parameter.name].read(parameter.value)
            for parameter in parameters
            if parameter.name in self._specs
        }


def _declare(node: Node, spec: Spec, ignore_override: bool = False) -> Any:
    """Declare a parameter, and return its value; ValueError for an integer in place of a float."""
    if node.has_parameter(spec.name):  # since the node was configured before
        return node.get_parameter(spec.name).value
    try:
        is_list = isinstance(spec.default, list)
        empty = not is_list and is_empty_list(parameter_overrides(node).get(spec.name))
        descriptor = spec.descriptor()
        return node.declare_parameter(
            spec.name, spec.default, descriptor, ignore_override=empty or ignore_override
        ).value
    except InvalidParameterTypeException as error:
        if not isinstance(spec.default, float):
            raise
        hint = f"write it with a decimal point, as in {spec.name}:={spec.default}"
        raise ValueError(f"{error}; {hint}") from error


def is_empty_list(given: Parameter | None) -> bool:
    """Return whether a parameter is [] in a file, which has no type and no value."""
    return given is not None and given.value is None


def misspelt(names: Iterable[str], known: Collection[str] = SPEC_OF.keys()) -> list[str]:
    """Return a hint for each name that looks like a known one; ROS ignores it without a word."""
    return [
        f"there is no parameter {name}; did you mean {close[0]}?"
        for name in names
        if name not in known and not name.startswith("qos_overrides.")
        for close in [get_close_matches(name, known, 1, ALIKE)]
        if close
    ]


def _check_together(values: Mapping[str, Any]) -> None:
    """Raise ValueError for values that do not fit each other."""
    check_words(values)
    region_from(values)
    bases_of(values)
    folders_from(values)
    check_sources(values)
    stop, slow = values["speed_stop_distance"], values["speed_slow_distance"]
    if slow <= stop:
        raise ValueError(f"speed_slow_distance must exceed speed_stop_distance, {slow} <= {stop}")


def guard_parameter_services(node: Node) -> None:
    """Refuse a value that raises an exception, also one of an invalid type.

    Without this, rclpy raises it from the executor.
    """
    for service in node.services:
        if service.srv_type in (SetParameters, SetParametersAtomically):
            service.callback = _guarded(node, service.callback, service.srv_type)


def _guarded(node: Node, callback: Callable[[Any, Any], Any], kind: Any) -> Callable[..., Any]:
    def answer(request: Any, response: Any) -> Any:
        try:
            return callback(request, response)
        except Exception as error:
            reason = f"{type(error).__name__}: {shown(str(error))}"
            node.get_logger().error(f"a parameter could not be set: {format_exc()}", once=True)
            refusal = SetParametersResult(successful=False, reason=reason)
        if kind is SetParametersAtomically:
            return kind.Response(result=refusal)
        return kind.Response(results=[refusal])

    def one_by_one(request: Any, response: Any) -> Any:
        for parameter in request.parameters:
            response.results += answer(
                kind.Request(parameters=[parameter]), kind.Response()
            ).results
        return response

    return answer if kind is SetParametersAtomically else one_by_one
