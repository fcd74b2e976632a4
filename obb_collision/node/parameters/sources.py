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

"""Parameters of sensors: ``sources`` names them, and each name has a group of its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from obb_collision.node.objects.table import POLICIES
from obb_collision.node.parameters.entries import (
    INPUTS,
    Groups,
    Spec,
    pattern_from_text,
)
from obb_collision.scene_files.native import ROBOT_NAME
from obb_collision.words import shown

MAX_SOURCES = 100
"""Most sources of a node."""
NAMESPACE = "sources"
"""Before the name of a source: the object of ``front`` is ``sources/front/0``."""
POINTS = "points"
"""The topic and the name of the source that every node has, which is watched."""
TYPES = CLOUD, SCAN, RANGE = ("cloud", "scan", "range")
USES = OBSTACLE, WATCH = ("obstacle", "watch")
FAR = 1.0e6
"""Metres: a limit of this size leaves nothing out."""


def source_key(name: str) -> tuple[str, int]:
    """Return the key of the object of a source."""
    return f"{NAMESPACE}/{name}", 0


class SourceSettings(NamedTuple):
    """The parameters of a source, in the order of ``SPECS``, after its name."""

    name: str
    type: str
    topic: str
    use: str
    radius: float
    voxel: float
    min_range: float
    max_range: float
    min_height: float
    max_height: float
    height_frame: str
    leave_out: list[str]
    leave_out_padding: float
    shadows: bool
    timeout: float
    stale_policy: str

    @property
    def key(self) -> tuple[str, int]:
        """The key of its object."""
        return source_key(self.name)


SPECS = (
    Spec("type", CLOUD, choices=TYPES, fixed=True).means(
        "Type of the messages. cloud: sensor_msgs/PointCloud2. scan: sensor_msgs/LaserScan. range: "
        "sensor_msgs/Range; its object is the cap of the cone at the measured distance."
    ),
    Spec("topic", "", fixed=True, optional=True).means("Topic, by default the name of the source."),
    Spec("use", OBSTACLE, choices=USES, fixed=True).means(
        "obstacle: the points can collide. watch: they cannot; points_inside counts them."
    ),
    Spec("radius", 0.01, (0.0, 1000.0)).means("Radius of the ball around each point (m)."),
    Spec("voxel", 0.0, (0.0, 1000.0)).means(
        "Edge length of the cells of a grid (m). Each cell keeps the point nearest to its centre. "
        "The radius grows so that the balls cover the points left out. 0: all points are kept."
    ),
    Spec("min_range", 0.0, (0.0, FAR)).means("Points nearer to the sensor are left out (m)."),
    Spec("max_range", FAR, (0.0, FAR)).means("Points farther from the sensor are left out (m)."),
    Spec("min_height", -FAR, (-FAR, FAR)).means("Points below this height are left out (m)."),
    Spec("max_height", FAR, (-FAR, FAR)).means("Points above this height are left out (m)."),
    Spec("height_frame", "", optional=True).means(
        "Frame whose z is the height; by default the fixed frame."
    ),
    Spec("leave_out", [""], entry=pattern_from_text).means(
        "Robots, and objects by name, pattern or group. Points that were inside them at the stamp "
        "of the message are left out. A robot includes all its links and what is attached to it."
    ),
    Spec("leave_out_padding", 0.05, (0.0, 1000.0)).means(
        "Points nearer than this to what leave_out names are left out, too (m)."
    ),
    Spec("shadows", False).means(
        "Whether points that are hidden from the sensor by what leave_out names are left out, too."
    ),
    Spec("timeout", 0.5, (0.0, FAR)).means(
        "Age limit of the object, and longest wait for the first message (s). 0: no limit."
    ),
    Spec("stale_policy", POLICIES[0], choices=POLICIES).means(
        "How the object is treated when it is stale; see the parameter stale_policy."
    ),
)
"""The parameters of a source, each named after the source and a dot."""


def source_specs(name: str) -> list[Spec]:
    """Return the parameters of a source."""
    return [replace(spec, name=f"{name}.{spec.name}") for spec in SPECS]


def source_from_text(text: str) -> str:
    """Read the name of a source; ValueError for one that cannot be part of a topic."""
    if not ROBOT_NAME.fullmatch(text):
        raise ValueError(f"{shown(text)} must be letters, digits and _, and begin with a letter")
    return text


def sources_of(values: Mapping[str, Any]) -> list[SourceSettings]:
    """Return the settings of all sources."""
    return [_settings(values, name) for name in values["sources"]]


def _settings(values: Mapping[str, Any], name: str) -> SourceSettings:
    settings = SourceSettings(name, *(values[f"{name}.{spec.name}"] for spec in SPECS))
    return settings if settings.topic else settings._replace(topic=name)


def check_names(names: list[str], others: set[str]) -> None:
    """Raise ValueError for a name that occurs twice, or that an input or parameter has."""
    for row, name in enumerate(names):
        if name in names[:row]:
            raise ValueError(f"sources: {name!r} occurs twice")
        if name in others or name == POINTS:
            raise ValueError(f"sources: {name!r} is the name of another input or parameter")


def check_sources(values: Mapping[str, Any]) -> None:
    """Raise ValueError for parameters of sources that contradict each other."""
    if not values["sources"]:
        return
    groups, taken = Groups(values["groups"], values["robots"]), set(INPUTS)
    for source in sources_of(values):
        name = source.name
        if source.topic in taken or source.topic.partition("/")[0] in values["robots"]:
            raise ValueError(f"{name}.topic: another input has the topic {source.topic!r}")
        taken.add(source.topic)
        for what in ("range", "height"):
            low, high = (getattr(source, f"{end}_{what}") for end in ("min", "max"))
            if low > high:
                raise ValueError(f"{name}.max_{what} must not be below {name}.min_{what}")
        try:
            groups.all_meant(source.leave_out)
        except ValueError as error:
            raise ValueError(f"{name}.leave_out: {error}") from error
