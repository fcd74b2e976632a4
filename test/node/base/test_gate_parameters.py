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


"""Parameters of a gate that nav2_collision_monitor refuses, and what they mean."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
import yaml
from base_rig import SCAN, SQUARE, gate_parameters, zone
from each import each
from pages import ROOT, code_blocks

from obb_collision.node.parameters.base import NODE, GateParameters, node_specs
from obb_collision.node.parameters.entries import Spec
from obb_collision.node.parameters.parameters import SPECS
from obb_collision.zones.outlines import count_inside

STOP = zone("stop")
CIRCLE = {"type": "circle", "action_type": "stop", "radius": 0.4}
PART = {"points": SQUARE, "linear_min": 0.0, "linear_max": 1.0, "theta_min": -1.0, "theta_max": 1.0}


def velocity(part: dict[str, Any], **more: Any) -> dict[str, Any]:
    """Return a velocity polygon of one part."""
    parts = {f"fast.{key}": value for key, value in part.items()}
    return {"type": "velocity_polygon", "action_type": "stop", "velocity_polygons": ["fast"]} | (
        parts | more
    )


def without(group: dict[str, Any], name: str) -> dict[str, Any]:
    """Return parameters but one."""
    return {key: value for key, value in group.items() if key != name}


def read(zones: Any, sources: Any = None, **given: Any) -> GateParameters:
    """Declare parameters as a node does, and read all."""
    given = gate_parameters(zones, {"front": SCAN} if sources is None else sources) | given
    values: dict[str, Any] = {}

    def declare(specs: Iterable[Spec]) -> None:
        for spec in specs:
            value = given.get(spec.name, spec.default)
            if isinstance(spec.default, float) and not isinstance(value, float):
                raise ValueError(f"{spec.name}: write it with a decimal point")
            values[spec.name] = spec.read(value)

    declare(NODE)
    parameters = GateParameters(declare, values, given)
    parameters.unused = parameters.declare({"rate"})  # type: ignore[attr-defined]
    for part in (parameters.zones, parameters.sources, parameters.exclusions):
        part()
    return parameters


REFUSED: dict[str, tuple[Any, Any, dict[str, Any]]] = {
    "Z.type must be one of": ({"Z": STOP | {"type": "sphere"}}, None, {}),
    "Z.action_type must be one of": ({"Z": STOP | {"action_type": "jump"}}, None, {}),
    "front.type must be one of": ({"Z": STOP}, {"front": {"type": "costmap"}}, {}),
    "Z.type is missing": ({"Z": without(STOP, "type")}, None, {}),
    "Z.action_type is missing": ({"Z": without(STOP, "action_type")}, None, {}),
    "Z has no shape: polygon_sub_topic is missing": ({"Z": without(STOP, "points")}, None, {}),
    "Z has no shape: polygon_sub_topic": ({"Z": without(CIRCLE, "radius")}, None, {}),
    "needs 4 corners": ({"Z": STOP | {"points": "[[0, 0], [1, 0], [0, 1]]"}}, None, {}),
    "is not like": ({"Z": STOP | {"points": "[[0, 0], [1, 0], [0, 1], [1]]"}}, None, {}),
    "'rear' is no observation source": ({"Z": STOP | {"sources_names": ["rear"]}}, None, {}),
    "trigger_consecutive_points must": (
        {"Z": STOP | {"trigger_consecutive_points": 0}}, None, {},
    ),
    "release_consecutive_points must": (
        {"Z": STOP | {"release_consecutive_points": 0}}, None, {},
    ),
    "Z.fast.theta_max is missing": ({"Z": velocity(without(PART, "theta_max"))}, None, {}),
    "Z.velocity_polygons is missing": (
        {"Z": velocity({}) | {"velocity_polygons": [""]}}, None, {},
    ),
    "decimal point": ({"Z": CIRCLE | {"radius": 1}}, None, {}),
    "obstacles_angle must": ({"Z": STOP}, {"front": SCAN | {"obstacles_angle": 0.0}}, {}),
    "min_points must": ({"Z": STOP | {"min_points": 0}}, None, {}),
    "occurs twice": ({"Z": STOP}, None, {"polygons": ["Z", "Z"]}),
    "is the name of another": ({"rate": STOP}, None, {}),
}  # fmt: skip


@each("words", REFUSED)
def test_what_nav2_refuses_is_refused_with_its_name(words: str) -> None:
    zones, sources, given = REFUSED[words]
    with pytest.raises(ValueError, match=words):
        read(zones, sources, **given)


@each("name", ["polygons", "observation_sources"])
def test_both_lists_are_required_and_may_be_empty(name: str) -> None:
    given = without(gate_parameters({}, {}), name)
    values = {spec.name: spec.read(spec.default) for spec in NODE}
    with pytest.raises(ValueError, match=f"{name} is missing"):
        GateParameters(lambda specs: None, values, given).declare(set())
    parameters = read({}, {})
    assert parameters.zones() == []
    assert parameters.sources() == []


def test_without_the_lists_there_is_no_parameter_of_a_gate() -> None:
    assert node_specs(SPECS, {"rate": 10.0, "base_frame_id": "base"}) == list(SPECS)
    specs = {spec.name: spec for spec in node_specs(SPECS, {"polygons": ["Z"]})}
    assert specs["autostart"].default is False, "a lifecycle manager starts nav2's monitor"
    assert specs["fixed_frame"].default == "odom"


def test_defaults_and_what_is_not_used() -> None:
    sources = {"front": {"min_height": 0.1, "unheard": 1}}
    parameters = read({"Z": without(STOP, "min_points") | {"time_before_collision": 3.0}}, sources)
    (found,) = parameters.zones()
    assert found.settings.min_points == 4
    assert (found.settings.min_height, found.settings.max_height) == (-math.inf, math.inf)
    (source,) = parameters.sources()
    assert source[1:4] == ("scan", "scan", True)
    assert (source.source_timeout, source.max_height, source.sampling_distance) == (2.0, 0.5, 0.1)
    assert parameters.unused == ["front.unheard"]  # type: ignore[attr-defined]
    values = {spec.name: spec.default for spec in NODE}
    assert values | {
        "cmd_vel_in_topic": "cmd_vel_smoothed", "cmd_vel_out_topic": "cmd_vel", "state_topic": "",
        "base_frame_id": "base_footprint", "odom_frame_id": "odom", "transform_tolerance": 0.1,
        "source_timeout": 2.0, "stop_pub_timeout": 1.0, "base_shift_correction": True,
        "enabled": True, "enable_stamped_cmd_vel": True,
    } == values  # fmt: skip


def test_timeouts_of_sources_are_the_nodes_unless_they_have_their_own() -> None:
    sources = {"front": SCAN, "rear": {"topic": "rear", "source_timeout": 0.5}}
    front, rear = read({"Z": STOP}, sources, source_timeout=1.5).sources()
    assert (front.source_timeout, rear.source_timeout) == (1.5, 0.5)


def test_max_points_counts_from_the_other_side() -> None:
    zones = read({"Z": without(STOP, "min_points") | {"max_points": 3}}).zones()
    assert zones[0].settings.min_points == 4


@each(
    "text",
    ["[[.5, +1], [5e-1, -1.], [-.5, -1.], [-.5, 1]]", " [ [0.5,1],[0.5,-1],[-.5,-1],[-0.5,1.0] ]"],
)
def test_numbers_in_points_are_those_of_nav2(text: str) -> None:
    outline = read({"Z": STOP | {"points": text}}).zones()[0].outline
    assert outline is not None
    assert outline.corners.tolist() == [[0.5, 1.0], [0.5, -1.0], [-0.5, -1.0], [-0.5, 1.0]]


def test_what_a_message_says_is_on_a_border_is_inside() -> None:
    zones = read({"Z": STOP | {"points": "[[4.7, 0.3], [4.7, -0.3], [0, -0.3], [0, 0.3]]"}})
    shape = zones.zones()[0].outline
    assert shape is not None
    points = np.array([[0.1, 0.3], [0.1, -0.3], [4.7, 0.1], [4.7, 0.3]], np.float32)
    assert count_inside(points.astype(np.float64), *shape, np.empty(4, np.bool_)) == 4


def test_shapes_come_from_parameters_or_topics() -> None:
    bare = without(STOP, "points")
    footprint = bare | {"action_type": "approach"}
    by_topic = {"polygon_sub_topic": "shape"}
    parameters = read({
        "A": STOP, "B": bare | by_topic, "C": footprint, "D": footprint | by_topic,
        "E": CIRCLE, "F": without(CIRCLE, "radius") | by_topic, "G": velocity(PART),
        "H": footprint | {"footprint_topic": "feet"}, "I": STOP | by_topic | {"points": "none"},
    })  # fmt: skip
    default = "local_costmap/published_footprint"
    topics = [parameters.topic_of(name) for name in "ABCDEFGH"]
    assert topics == ["", "shape", default, "shape", "", "shape", "", "feet"]
    assert [parameters.is_footprint(name) for name in "CDH"] == [True, False, True]
    zones = {found.name: found for found in parameters.zones()}
    assert zones["E"].outline is not None
    assert zones["E"].outline.radius == 0.4
    assert zones["A"].outline is not None
    np.testing.assert_array_equal(zones["A"].outline.corners[0], [0.5, 0.5])
    assert [zones[name].outline for name in "BCDFGHI"] == [None] * 7
    assert len(zones["G"].parts) == 1


def flat(group: dict[str, Any], name: str = "") -> dict[str, Any]:
    """Return parameters by their dotted names."""
    found: dict[str, Any] = {}
    for key, value in group.items():
        found |= flat(value, f"{name}{key}.") if isinstance(value, dict) else {name + key: value}
    return found


def test_the_files_of_the_tutorial_are_read() -> None:
    blocks = code_blocks(ROOT / "docs" / "tutorials" / "replace_collision_monitor.md", "yaml")
    first, more = (yaml.safe_load(b)["collision_monitor"]["ros__parameters"] for b in blocks)
    parameters = read({}, {}, **flat(first))
    assert [found.name for found in parameters.zones()] == ["PolygonStop", "FootprintApproach"]
    assert parameters.unused == []  # type: ignore[attr-defined]
    parameters = read({}, {}, **flat(first), **flat(more))
    assert parameters.zones()[0].settings.leaving is not None
    assert [region.frame for region in parameters.exclusions()] == ["dock"]


def test_a_zone_that_may_be_left_needs_a_footprint() -> None:
    with pytest.raises(ValueError, match="is not like"):
        read({"Z": STOP | {"allow_leaving": True}})
    round_base = read({"Z": STOP | {"allow_leaving": True, "footprint": "0.25"}}).zones()[0]
    assert round_base.settings.leaving is not None
    assert round_base.settings.leaving.radius == 0.25
