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

"""Entries of lists of parameters: folders, ranges of the region, and robots with their bases."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from obb_collision.geometry.shapes.files import MeshFolders
from obb_collision.node.messages.conversions import UNUSABLE, ZERO, pose_kinds
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.effects.settings import OFF
from obb_collision.scene.store.region import Region, split_regions
from obb_collision.scene_files.native import ROBOT_NAME
from obb_collision.words import shown

ENTRY = re.compile(r"(?:([A-Za-z][A-Za-z0-9_-]*):\s+)?(/.*)")
"""An absolute path, before it perhaps the name of a package, which is no part of a path."""
INPUTS = (
    *("objects", "object_transform", "object_states", "object_poses", "object_boxes"),
    *("detections", "points"),
)
"""Topics that the nodes of all regions read."""
MAX_ROBOTS = 100
"""Most robots of a node."""
BY_TOPIC = "object_transform"
"""In place of a frame: the base is where this topic says."""
Range = tuple[str, float, float]
AXES = "xyz"
RANGE = re.compile(r"\s*([xyz])\s*:\s*(\S+)\s+to\s+(\S+)\s*")
"""An entry of the parameter ``region``."""


def folder_from_text(text: str) -> tuple[str, str]:
    """Return the package, "" for none, and the folder of ``FOLDER`` or ``PACKAGE: FOLDER``.

    ValueError for a path that is not absolute. The folder need not exist: it may be mounted later.
    """
    found = ENTRY.fullmatch(text)
    if found is None:
        raise ValueError(f"{shown(text)} is no absolute path, nor like 'arm_description: /opt/arm'")
    return found[1] or "", found[2]


def folders_from(values: Mapping[str, Any]) -> MeshFolders:
    """Return the folders that parameters mean; ValueError for a package that has two."""
    given: list[tuple[str, str]] = values["mesh_folders"]
    named = [(package, folder) for package, folder in given if package]
    packages = dict(named)
    if len(packages) < len(named):
        raise ValueError("mesh_folders must have at most one entry for each package")
    return MeshFolders(tuple(folder for package, folder in given if not package), packages)


def option_name(effect: str, option: str) -> str:
    """Return the parameter of an option; ``effects.sweep`` can't be a value and hold more."""
    return f"effects.{effect}_{option}"


def range_from_text(text: str) -> Range:
    """Return the axis and the ends (m) of an entry such as ``x: -inf to 5.0``."""
    found = RANGE.fullmatch(text)
    try:
        axis, low, high = found[1], float(found[2]), float(found[3])  # type: ignore[index]
    except (TypeError, ValueError):
        raise ValueError(f"{shown(text)} is not like 'x: -inf to 5.0'") from None
    if not low < high or low == math.inf or high == -math.inf:
        raise ValueError(f"{shown(text)}: the first number must be below the second")
    return axis, low, high


def text_from_region(region: Region) -> list[str]:
    """Return the entries of the parameter ``region``; [''] for everything."""
    ends = zip(AXES, region.minimum.tolist(), region.maximum.tolist(), strict=True)
    return [
        f"{axis}: {low!r} to {high!r}"
        for axis, low, high in ends
        if math.isfinite(low) or math.isfinite(high)
    ] or [""]


def region_from(values: Mapping[str, Any]) -> Region | None:
    """Return the region that parameters mean, None for everything.

    Raises ValueError for an axis given twice, and a halo that is smaller than what an effect that
    is not off looks beyond objects.
    """
    ranges: list[Range] = values["region"]
    if not ranges:
        return None
    low, high = np.full(3, -np.inf), np.full(3, np.inf)
    if len({axis for axis, _, _ in ranges}) < len(ranges):
        raise ValueError("region must have at most one entry for each of x, y and z")
    for axis, least, most in ranges:
        low[AXES.index(axis)], high[AXES.index(axis)] = least, most
    halo = values["region_halo"]
    for name, effect in EFFECTS.items():
        for key, option in effect.options.items():
            far = values[option_name(name, key)]
            if option.reaches and values[f"effects.{name}"] != OFF and far > halo:
                raise ValueError(
                    f"region_halo must be at least {option_name(name, key)}, {far:g} m, as far as "
                    f"the effect looks beyond objects, got {halo:g}"
                )
    return Region(low, high, halo)


class Base(NamedTuple):
    """Where a root link is: at a pose (7,) in the fixed frame, in a frame, or where a topic says.

    The frame is "" for that of the root link itself.
    """

    robot: str
    pose: tuple[float, ...] | None = None
    frame: str = ""


def robot_from_text(text: str) -> str:
    """Read the name of a robot; ValueError for one that can be no part of a topic."""
    if not ROBOT_NAME.fullmatch(text):
        raise ValueError(f"{shown(text)} must be letters, digits and _, and begin with a letter")
    return text


def base_from_text(text: str) -> Base:
    """Read ``NAME: FRAME`` or ``NAME: X Y Z QX QY QZ QW``; ValueError for anything else."""
    name, _, place = text.partition(":")
    words = place.split()
    if not name.strip() or len(words) not in (1, 7):
        raise ValueError(f"{shown(text)} is not like 'arm: 0 0 0.5 0 0 0 1' or 'arm: base_link'")
    robot = robot_from_text(name.strip())
    if len(words) == 1:
        return Base(robot, frame=words[0])
    try:
        pose = tuple(float(word) for word in words)
    except ValueError:
        raise ValueError(f"{shown(text)} must have seven numbers") from None
    if pose_kinds(np.array([pose]))[0] in (UNUSABLE, ZERO):
        raise ValueError(f"{shown(text)} is no pose: not finite, or a quaternion of zeros")
    return Base(robot, pose)


def touches_from_text(text: str) -> list[tuple[str, str]]:
    """Read ``ROBOT/LINK: ROBOT/LINK ...``, patterns of links, as pairs; ValueError else."""
    link, _, others = text.partition(":")
    if len(link.split()) != 1 or not others.split():
        raise ValueError(f"{shown(text)} is not like 'arm/hand: arm/finger_left arm/finger_right'")
    return [(link.strip(), other) for other in others.split()]


def bases_of(values: Mapping[str, Any]) -> dict[str, Base]:
    """Return where each robot stands, by name; ValueError for what does not fit together."""
    names: list[str] = values["robots"]
    given: list[Base] = values["robot_bases"]
    for parameter, robots in (("robots", names), ("robot_bases", [base.robot for base in given])):
        for number, name in enumerate(robots):
            if name in robots[:number]:
                raise ValueError(f"{parameter}: {name!r} is there twice")
            if name not in names:
                raise ValueError(f"robot_bases: {name!r} is none of robots")
    return {name: Base(name) for name in names} | {base.robot: base for base in given}


def region_parameters(
    minimum: str, maximum: str, parts: str, halo: str
) -> dict[str, dict[str, Any]]:
    """Return the parameters of the nodes that share a box split into parts, by namespace.

    All as words, with spaces between numbers. Raises ValueError for what is none.
    """
    low, high = ([float(word) for word in text.split()] for text in (minimum, maximum))
    regions = split_regions(low, high, [int(word) for word in parts.split()], float(halo))
    return {
        f"region_{number}": {"region": text_from_region(region), "region_halo": region.halo}
        for number, region in enumerate(regions)
    }


def shared_inputs(namespace: str) -> list[tuple[str, str]]:
    """Return the remappings by which a node in a namespace of its own reads what all read."""
    root = "/" + namespace + ("/" if namespace else "")
    return [(topic, root + topic) for topic in INPUTS]
