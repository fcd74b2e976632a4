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


"""Parameters of the gate of a mobile base, by the names that nav2_collision_monitor has for them.

There are none unless ``polygons`` or ``observation_sources`` is given. Those of each polygon and
source are declared when the node is configured, which fails where they cannot be used.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from obb_collision.node.parameters.entries import Spec, pattern_from_text
from obb_collision.node.parameters.sources import FAR, MAX_SOURCES, check_names, source_from_text
from obb_collision.zones.outlines import Outline
from obb_collision.zones.sources import OBSERVATIONS, Observed
from obb_collision.zones.zones import (
    ACTIONS,
    APPROACH,
    STOP,
    Exclusion,
    Part,
    Settings,
    Zone,
    circle,
    polygon_from_text,
)

REQUIRED = ("polygons", "observation_sources")
"""The parameters without which there is no gate; where there is one, both are needed."""
SHAPES = POLYGON, CIRCLE, VELOCITY = ("polygon", "circle", "velocity_polygon")
ANY = (-FAR, FAR)
MANY = (-1, 1000000)
"""Limits of numbers of points and commands."""
DEFAULTS = {"autostart": False, "fixed_frame": "odom"}
"""What is different for parameters of the node, as nav2's monitor is."""


def _names(name: str, fixed: bool = False) -> Spec:
    return Spec(name, [""], fixed=fixed, entry=source_from_text, most=MAX_SOURCES)


NODE = (
    _names("polygons", fixed=True).means("Names of zones, in the order of nav2."),
    _names("observation_sources", fixed=True).means("Names of sensors for zones."),
    _names("exclusions", fixed=True).means(
        "Names of regions whose points do not count: NAME.points, NAME.frame_id, NAME.min_height, "
        "NAME.max_height. One that cannot be placed masks nothing."
    ),
    Spec("base_frame_id", "base_footprint", fixed=True).means("Frame of the base."),
    Spec("odom_frame_id", "odom", fixed=True).means("Frame in which the motion of the base is."),
    Spec("cmd_vel_in_topic", "cmd_vel_smoothed", fixed=True).means("Topic of commands."),
    Spec("cmd_vel_out_topic", "cmd_vel", fixed=True).means("Topic of safe commands."),
    Spec("state_topic", "", fixed=True, optional=True).means(
        "Topic of nav2_msgs/CollisionMonitorState, where nav2_msgs is installed. Empty: none."
    ),
    Spec("enable_stamped_cmd_vel", True, fixed=True).means("TwistStamped instead of Twist."),
    Spec("enabled", True, fixed=True).means("Whether zones act at the start; then see ~/toggle."),
    Spec("transform_tolerance", 0.1, (0.0, FAR)).means(
        "Largest age of the latest transform (s) where there is none for the moment asked for."
    ),
    Spec("source_timeout", 2.0, (0.0, FAR)).means("Age limit of sources (s). 0: none."),
    Spec("base_shift_correction", True).means(
        "Whether points move with the base since their stamp, by odom_frame_id."
    ),
    Spec("stop_pub_timeout", 1.0, (0.0, FAR)).means(
        "How long zeros are repeated with fail_closed false (s)."
    ),
    Spec("fail_closed", True).means(
        "Whether all that is not known gives zero, each command is answered, and a missing one by "
        "zero. false: as nav2_collision_monitor."
    ),
    Spec("bond_heartbeat_period", 0.1, (0.001, FAR), fixed=True).means(
        "Time between heartbeats for a lifecycle manager of nav2, where bond is installed (s)."
    ),
    Spec("command_timeout", 0.5, (0.0, FAR)).means(
        "Longest time without a command until zero is sent, with fail_closed (s). 0: none."
    ),
    Spec("zone_objects", ["*"], entry=pattern_from_text).means(
        "Objects of the scene that count in zones, by name or pattern."
    ),
    Spec("own_objects", [""], entry=pattern_from_text).means(
        "Objects of the scene that are the base itself, and do not count."
    ),
)
HEIGHTS = (
    Spec("min_height", -FAR, ANY).means("Points and parts of objects below do not count (m)."),
    Spec("max_height", FAR, ANY).means("Points and parts of objects above do not count (m)."),
)
ZONE = (
    Spec("type", "", choices=SHAPES, fixed=True).means("Type of the shape."),
    Spec("action_type", "", choices=ACTIONS).means("What is done if enough is inside."),
    Spec("points", "", optional=True).means(
        "Corners of a polygon in the frame of the base (m), '[[x, y], ...]', at least four."
    ),
    Spec("radius", -1.0, ANY).means("Radius of a circle (m)."),
    Spec("polygon_sub_topic", "", fixed=True, optional=True).means(
        "Topic of the shape, if it is no parameter: PolygonStamped, for circles Float32 (m)."
    ),
    Spec("polygon_subscribe_transient_local", False, fixed=True).means(
        "Whether that topic is latched."
    ),
    Spec("footprint_topic", "local_costmap/published_footprint", fixed=True, optional=True).means(
        "Topic of the footprint, for approach without other shapes: PolygonStamped."
    ),
    _names("velocity_polygons", fixed=True).means("Names of the parts of a velocity polygon."),
    Spec("holonomic", False, fixed=True).means("Whether parts are chosen by speed and direction."),
    Spec("enabled", True).means("Whether the zone acts."),
    Spec("min_points", 4, (1, MANY[1])).means("Number of points inside that are enough."),
    Spec("max_points", -1, MANY).means("Deprecated by nav2: min_points - 1."),
    Spec("slowdown_ratio", 0.5, (0.0, FAR)).means("Share of the speed that stays."),
    Spec("linear_limit", 0.5, ANY).means("Limit of the speed (m/s)."),
    Spec("angular_limit", 0.5, ANY).means("Limit of the turn rate (rad/s)."),
    Spec("time_before_collision", 2.0, (1e-3, FAR)).means(
        "The speed is reduced so that collisions stay this far ahead (s)."
    ),
    Spec("simulation_time_step", 0.1, ANY).means("Not used: times are exact."),
    _names("sources_names").means("Observation sources that count; without entries all."),
    Spec("trigger_consecutive_points", 1, MANY).means(
        "Commands in a row with enough inside until the zone acts."
    ),
    Spec("release_consecutive_points", 1, MANY).means(
        "Commands in a row without enough inside until the zone ends to act."
    ),
    Spec("visualize", False, fixed=True).means("Whether the zone is published, once per command."),
    Spec("polygon_pub_topic", "", fixed=True, optional=True).means("Its topic, by default NAME."),
    Spec("allow_leaving", False).means(
        "Whether a stop zone allows commands by which footprint comes nearer to nothing inside."
    ),
    Spec("footprint", "", optional=True).means(
        "Footprint of the base, for allow_leaving: corners like points, or a radius (m)."
    ),
    *HEIGHTS,
)
PART = (
    Spec("points", "", optional=True).means("Corners, as those of a polygon."),
    *(
        Spec(f"{kind}_{end}", 0.0, ANY).means(f"Limit of the {what} that the part is for.")
        for kind, what in (("linear", "speed (m/s)"), ("theta", "turn rate (rad/s)"))
        for end in ("min", "max")
    ),
)
DIRECTION = (
    Spec("direction_start_angle", -math.pi, ANY).means("First direction, if holonomic (rad)."),
    Spec("direction_end_angle", math.pi, ANY).means("Last direction, turning left (rad)."),
)
SOURCE = (
    Spec("type", OBSERVATIONS[0], choices=OBSERVATIONS, fixed=True).means(
        "Messages: LaserScan, PointCloud2, Range or PolygonInstanceStamped."
    ),
    Spec("topic", "scan", fixed=True).means("Topic."),
    Spec("enabled", True).means("Whether the source counts, and is missed."),
    Spec("source_timeout", 2.0, (0.0, FAR)).means(
        "Age limit (s), by default that of the node. 0: none, and it is never missed."
    ),
    Spec("min_height", 0.05, ANY).means("Lowest points of clouds, frame of the base (m)."),
    Spec("max_height", 0.5, ANY).means("Highest points of clouds, frame of the base (m)."),
    Spec("min_range", 0.0, ANY).means("Points of clouds nearer to the sensor do not count (m)."),
    Spec("use_global_height", False).means("Whether heights are the field height of clouds."),
    Spec("obstacles_angle", math.pi / 180.0, (1e-6, FAR)).means(
        "Angle between the points of the arc of a range (rad)."
    ),
    Spec("sampling_distance", 0.1, (1e-6, FAR)).means(
        "Distance between points on the borders of polygons (m)."
    ),
)
EXCLUSION = (
    Spec("points", "", optional=True).means("Corners of the region (m), '[[x, y], ...]'."),
    Spec("frame_id", "", optional=True).means("Its frame, by default that of the base."),
    *HEIGHTS,
)


def has_gate(overrides: Collection[str]) -> bool:
    """Return whether parameters ask for a gate."""
    return any(name in overrides for name in REQUIRED)


def node_specs(specs: Iterable[Spec], overrides: Mapping[str, Any]) -> list[Spec]:
    """Return the parameters of a node, with the defaults of a gate where it has one."""
    if not has_gate(overrides):
        return [*specs]
    defaults = DEFAULTS | {"fixed_frame": overrides.get("odom_frame_id", DEFAULTS["fixed_frame"])}
    changed = (replace(spec, default=defaults.get(spec.name, spec.default)) for spec in specs)
    return [*changed]


def group_names(values: Mapping[str, Any]) -> list[str]:
    """Return the names of the groups of parameters of a gate."""
    return [name for key in (*REQUIRED, "exclusions") for name in values.get(key, ())]


class GateParameters:
    """Declares and reads the parameters of a gate.

    declare: declares parameters, and raises ValueError for values that cannot be used; values: of
    all that are declared; given: those given at the start.
    """

    def __init__(self, declare: Any, values: Mapping[str, Any], given: Mapping[str, Any]) -> None:
        self._declare, self.values, self._given = declare, values, given

    def declare(self, others: set[str]) -> list[str]:
        """Declare all; others: names of other groups. ValueError for what cannot be used.

        Returns the parameters that were given, and are not used.
        """
        for name in REQUIRED:
            if name not in self._given:
                raise ValueError(f"{name} is missing")
        names = group_names(self.values)
        check_names(names, others)
        for name in self.values["polygons"]:
            self._group(name, ZONE, ("type", "action_type"))
            directed = DIRECTION if self.values[f"{name}.holonomic"] else ()
            for part in self.values[f"{name}.velocity_polygons"]:
                self._group(f"{name}.{part}", (*PART, *directed), [spec.name for spec in PART])
        timeout = self.values["source_timeout"]
        defaults = [
            replace(s, default=timeout) if s.name == "source_timeout" else s for s in SOURCE
        ]
        for name in self.values["observation_sources"]:
            self._group(name, defaults)
        for name in self.values["exclusions"]:
            self._group(name, EXCLUSION, ("points",))
        groups = {name.partition(".")[0] for name in names}
        given = (key for key in self._given if key.partition(".")[0] in groups)
        return [key for key in given if key not in self.values]

    def with_values(self, values: Mapping[str, Any]) -> GateParameters:
        """Return these parameters with other values."""
        return GateParameters(self._declare, values, self._given)

    def _group(self, group: str, specs: Iterable[Spec], required: Collection[str] = ()) -> None:
        for name in required:
            if f"{group}.{name}" not in self._given:
                raise ValueError(f"{group}.{name} is missing")
        self._declare(replace(spec, name=f"{group}.{spec.name}") for spec in specs)

    def _of(self, group: str, name: str) -> Any:
        return self.values[f"{group}.{name}"]

    def zones(self) -> list[Zone]:
        """Return the zones, with the shapes that parameters give; ValueError for one without."""
        return [self._zone(name) for name in self.values["polygons"]]

    def _zone(self, name: str) -> Zone:
        kind, text = self._of(name, "type"), self._of(name, "points")
        zone = Zone(name, self.settings(name))
        if kind == VELOCITY:
            parts = self._of(name, "velocity_polygons")
            if not parts:
                raise ValueError(f"{name}.velocity_polygons is missing")
            zone.parts = [self._part(f"{name}.{part}", name) for part in parts]
        elif kind == CIRCLE and f"{name}.radius" in self._given:
            zone.outline = circle(self._of(name, "radius"))
        elif kind == POLYGON and text:
            try:
                zone.outline = polygon_from_text(text)
            except ValueError:
                if not self._of(name, "polygon_sub_topic"):
                    raise
        elif not self.topic_of(name):
            raise ValueError(f"{name} has no shape: polygon_sub_topic is missing")
        return zone

    def topic_of(self, name: str) -> str:
        """Return the topic of the shape of a zone that has none by parameters, "" for none."""
        topic, is_polygon = self._of(name, "polygon_sub_topic"), self._of(name, "type") == POLYGON
        if is_polygon and not topic and self._of(name, "action_type") == APPROACH:
            topic = self._of(name, "footprint_topic")
        return str(topic)

    def shown_as(self, name: str) -> str:
        """Return the topic on which a zone is published, "" for none."""
        topic = str(self._of(name, "polygon_pub_topic") or name)
        return topic if self._of(name, "visualize") else ""

    def is_footprint(self, name: str) -> bool:
        """Return whether the shape of a zone by a topic is the footprint of the base."""
        is_approach = self._of(name, "action_type") == APPROACH
        return is_approach and not self._of(name, "polygon_sub_topic")

    def is_latched(self, name: str) -> bool:
        """Return whether the topic of a shape is latched."""
        return bool(self._of(name, "polygon_subscribe_transient_local"))

    def is_circle(self, name: str) -> bool:
        """Return whether a zone is a circle."""
        return bool(self._of(name, "type") == CIRCLE)

    def _part(self, group: str, zone: str) -> Part:
        numbers = [self._of(group, spec.name) for spec in PART[1:]]
        direction = None
        if self._of(zone, "holonomic"):
            direction = tuple(self._of(group, spec.name) for spec in DIRECTION)
        outline = polygon_from_text(self._of(group, "points"))
        return Part(outline, tuple(numbers[:2]), tuple(numbers[2:]), direction)

    def settings(self, name: str) -> Settings:
        """Return the parameters of a zone; ValueError for those that do not fit each other."""
        value = {spec.name: self._of(name, spec.name) for spec in ZONE}
        sources = tuple(value["sources_names"])
        for source in sources:
            if source not in self.values["observation_sources"]:
                raise ValueError(f"{name}.sources_names: {source!r} is no observation source")
        for key in ("trigger_consecutive_points", "release_consecutive_points"):
            if value[key] < 1:
                raise ValueError(f"{name}.{key} must be at least 1, got {value[key]}")
        least = value["min_points"]
        if value["max_points"] >= 0 and f"{name}.min_points" not in self._given:
            least = value["max_points"] + 1
        return Settings(
            value["action_type"],
            value["enabled"],
            least,
            value["slowdown_ratio"],
            value["linear_limit"],
            value["angular_limit"],
            value["time_before_collision"],
            sources,
            value["trigger_consecutive_points"],
            value["release_consecutive_points"],
            *self._heights(name),
            leaving=self._leaving(name),
        )

    def _heights(self, name: str) -> tuple[float, float]:
        low, high = self._of(name, "min_height"), self._of(name, "max_height")
        return (low if low > -FAR else -math.inf), (high if high < FAR else math.inf)

    def _leaving(self, name: str) -> Outline | None:
        if not self._of(name, "allow_leaving") or self._of(name, "action_type") != STOP:
            return None
        text = str(self._of(name, "footprint"))
        try:
            return circle(float(text))
        except ValueError:
            return polygon_from_text(text)

    def sources(self) -> list[Observed]:
        """Return the parameters of the observation sources."""
        names = self.values["observation_sources"]
        return [Observed(name, *(self._of(name, spec.name) for spec in SOURCE)) for name in names]

    def exclusions(self) -> list[Exclusion]:
        """Return the regions whose points do not count."""
        return [
            Exclusion(
                self._of(name, "frame_id") or self.values["base_frame_id"],
                polygon_from_text(self._of(name, "points")).corners.astype(np.float64),
                *self._heights(name),
            )
            for name in self.values["exclusions"]
        ]
