"""The parameters of the node: what they mean, their units and ranges, and checks at run time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter


@dataclass(frozen=True)
class Spec:
    """One parameter. ``limits`` are inclusive; ``choices`` are the words allowed."""

    name: str
    default: Any
    description: str
    limits: tuple[float, float] | None = None
    choices: tuple[str, ...] = ()
    fixed: bool = False
    """Read at the start only."""

    def descriptor(self) -> ParameterDescriptor:
        """Return what ``ros2 param describe`` shows."""
        descriptor = ParameterDescriptor(
            name=self.name, description=self.description, read_only=self.fixed
        )
        if self.choices:
            descriptor.additional_constraints = "one of " + ", ".join(self.choices)
        if self.limits is not None and isinstance(self.default, float):
            low, high = self.limits
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
        elif self.limits is not None:
            low, high = (int(limit) for limit in self.limits)
            descriptor.integer_range = [IntegerRange(from_value=low, to_value=high)]
        return descriptor

    def fault(self, value: Any) -> str | None:
        """Why a value can't be used, None if it can."""
        if self.choices and value not in self.choices:
            return f"{self.name} must be one of {', '.join(self.choices)}, not {value!r}"
        if isinstance(self.default, str) and not value:
            return f"{self.name} must not be empty"
        if self.limits is not None:
            low, high = self.limits
            if not (math.isfinite(value) and low <= value <= high):
                return f"{self.name} must be between {low:g} and {high:g}, not {value!r}"
        return None


SPECS = (
    Spec(
        "fixed_frame",
        "map",
        "Frame of the world boxes and of everything published. Read at the start only.",
        fixed=True,
    ),
    Spec("rate", 50.0, "Cycles per second (Hz).", (0.1, 1000.0)),
    Spec(
        "trigger",
        "timer",
        "What starts a cycle. timer: every 1/rate. arrival: every input message at once, but not "
        "sooner than min_period after the last cycle, and 1/rate after the last cycle without any.",
        choices=("timer", "arrival"),
    ),
    Spec(
        "min_period",
        0.002,
        "With trigger arrival: least time between two cycles (s), so that a burst is taken whole.",
        (0.0, 1.0),
    ),
    Spec("padding", 0.0, "Every box is grown by this on every side (m).", (0.0, 1000.0)),
    Spec(
        "object_timeout",
        0.0,
        "An object without a new state for longer than this is stale (s). 0: never.",
        (0.0, 1.0e6),
    ),
    Spec(
        "stale_policy",
        "keep",
        "What becomes of stale objects. keep: they go on colliding where they were last. ignore: "
        "they take part in no pair. Either way they are grey and counted in /diagnostics.",
        choices=("keep", "ignore"),
    ),
    Spec(
        "transform_timeout",
        0.2,
        "How long a state may wait for its frame's transform before it counts as refused (s). It "
        "is tried again until a newer state comes.",
        (0.0, 60.0),
    ),
    Spec("max_objects", 20000, "Objects beyond this many are refused.", (1, 1000000)),
    Spec("max_text_pairs", 100, "Pairs named in collisions_text; the total is stated.", (0, 10000)),
    Spec("marker_rate", 10.0, "Publications of ~/markers per second (Hz). 0: none.", (0.0, 100.0)),
    Spec(
        "marker_lifetime",
        1.0,
        "Lifetime of the markers (s), after which RViz drops those of a node that is gone. 0: for "
        "ever.",
        (0.0, 3600.0),
    ),
    Spec(
        "marker_form",
        "auto",
        "cubes: one CUBE an object. lines: all edges in one LINE_LIST a colour. auto: lines above "
        "marker_max_cubes objects.",
        choices=("auto", "cubes", "lines"),
    ),
    Spec(
        "marker_max_cubes", 200, "With marker_form auto: most objects drawn as CUBE.", (0, 100000)
    ),
    Spec("marker_line_width", 0.01, "Width of the lines in LINE_LIST markers (m).", (0.0001, 10.0)),
    Spec("warn_period", 5.0, "Least time between two warnings about one topic (s).", (0.0, 3600.0)),
)


class Parameters:
    """Declared parameters of a node, as attributes: ``parameters.rate``."""

    fixed_frame: str
    rate: float
    trigger: str
    min_period: float
    padding: float
    object_timeout: float
    stale_policy: str
    transform_timeout: float
    max_objects: int
    max_text_pairs: int
    marker_rate: float
    marker_lifetime: float
    marker_form: str
    marker_max_cubes: int
    marker_line_width: float
    warn_period: float

    def __init__(self, node: Node) -> None:
        """Declare all; an override that can't be used stops the node with the reason."""
        self.on_change: Callable[[], None] = lambda: None
        for spec in SPECS:
            value = node.declare_parameter(spec.name, spec.default, spec.descriptor()).value
            fault = spec.fault(value)
            if fault is not None:
                raise ValueError(fault)
            setattr(self, spec.name, value)
        node.add_on_set_parameters_callback(check_parameters)
        node.add_post_set_parameters_callback(self._take)

    def _take(self, parameters: Sequence[Parameter]) -> None:
        for parameter in parameters:
            if any(spec.name == parameter.name for spec in SPECS):
                setattr(self, parameter.name, parameter.value)
        self.on_change()


def check_parameters(parameters: Sequence[Parameter]) -> SetParametersResult:
    """Refuse what can't be used, with the reason; all of a set or none."""
    specs = {spec.name: spec for spec in SPECS}
    for parameter in parameters:
        spec = specs.get(parameter.name)
        fault = None if spec is None else spec.fault(parameter.value)
        if fault is not None:
            return SetParametersResult(successful=False, reason=fault)
    return SetParametersResult(successful=True)
