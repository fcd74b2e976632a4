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

"""Robots as parameters: their names, and where they stand."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from obb_collision.node.messages.conversions import UNUSABLE, ZERO, pose_kinds
from obb_collision.scene_files.robots import ROBOT_NAME
from obb_collision.words import shown

MAX_ROBOTS = 100
"""Most robots of a node."""
BY_TOPIC = "object_transform"
"""In place of a frame: the base is where this topic says."""


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
    _refuse_twins("robots", names)
    given: list[Base] = values["robot_bases"]
    _refuse_twins("robot_bases", [base.robot for base in given])
    unknown = [base.robot for base in given if base.robot not in names]
    if unknown:
        raise ValueError(f"robot_bases: {unknown[0]!r} is none of robots")
    return {name: Base(name) for name in names} | {base.robot: base for base in given}


def _refuse_twins(parameter: str, names: Iterable[str]) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise ValueError(f"{parameter}: {name!r} is there twice")
        seen.add(name)
