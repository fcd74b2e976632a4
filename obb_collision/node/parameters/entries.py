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

"""How parameters are read: their values and ranges, and the entries of lists.

Entries are groups of objects, folders, ranges of the region, and robots. Groups are names for sets
of objects, which other parameters use like names and patterns.
"""

from __future__ import annotations

import math
import re
import shlex
from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import Any, NamedTuple, TypeVar

import numpy as np
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor

from obb_collision.accuracy import instead_of
from obb_collision.geometry.shapes.files import MeshFolders
from obb_collision.node.messages.conversions import unusable_poses
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.effects.settings import MODES, OFF, ON
from obb_collision.scene.store.patterns import MAX_OVERRIDES, as_patterns
from obb_collision.scene.store.region import Region, split_regions
from obb_collision.scene_files.native import ROBOT_NAME
from obb_collision.words import MAX_NAME, MAX_OBJECT_NAME, MAX_PATH, check_name, shown

#: Most entries of a list, unless its parameter says otherwise, and most patterns among them: each
#: is compared with the names of all objects.
MAX_ENTRIES = MAX_PATTERNS = 1000
#: Most characters of an entry: two names and what stands between.
MAX_ENTRY = 2 * MAX_OBJECT_NAME + 10


@dataclass(frozen=True)
class Spec:
    """One parameter. ``limits`` are inclusive; ``choices`` are the words or numbers allowed."""

    name: str
    default: Any
    limits: tuple[float, float] | None = None
    choices: tuple[Any, ...] = ()
    fixed: bool = False
    """Read at the start only."""
    optional: bool = False
    """Whether a text may be empty."""
    entry: Callable[[str], Any] | None = None
    """How an entry of a list is read: it raises ValueError for one that can't be used."""
    most: int = MAX_ENTRIES
    """Most entries of a list."""
    description: str = ""

    def means(self, text: str) -> Spec:
        """Return the same with a description."""
        return replace(self, description=text + (" Read at the start only." if self.fixed else ""))

    def descriptor(self) -> ParameterDescriptor:
        """Return the descriptor, which ``ros2 param describe`` shows."""
        descriptor = ParameterDescriptor(
            name=self.name,
            description=self.description,
            read_only=self.fixed,
            # Unquoted off and on are booleans in YAML, and an empty list has no type in ROS.
            dynamic_typing=self.choices == MODES or isinstance(self.default, list),
        )
        if self.choices:
            descriptor.additional_constraints = "one of " + ", ".join(map(str, self.choices))
        if self.limits is not None and isinstance(self.default, float):
            low, high = self.limits
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
        elif isinstance(self.default, int) and not isinstance(self.default, bool):
            low, high = (int(limit) for limit in self.limits or (self.choices[0], self.choices[-1]))
            descriptor.integer_range = [IntegerRange(from_value=low, to_value=high)]
        return descriptor

    def read(self, value: Any) -> Any:
        """Return a value as the node uses it; ValueError with the reason if it can't be used.

        rclpy has verified type and range, which the descriptor says.
        """
        if isinstance(self.default, list):
            return self._read_list(value)
        if self.choices == MODES and isinstance(value, bool):
            value = ON if value else OFF
        if self.choices and value not in self.choices:
            words = ", ".join(map(str, self.choices))
            raise ValueError(
                f"{self.name} must be one of {words}, not {shown(value)}{instead_of(value)}"
            )
        if self.limits is not None and not self.limits[0] <= value <= self.limits[1]:
            low, high = self.limits  # rclpy takes what is a little beyond them
            raise ValueError(f"{self.name} must be between {low:g} and {high:g}, got {value!r}")
        if isinstance(value, str) and (value or not self.optional):
            check_name(value, self.name, MAX_PATH if self.optional else MAX_NAME)
        return value

    def _read_list(self, value: Any) -> list[Any]:
        """Return the entries; an empty text counts as none, for [] has no type in ROS."""
        entries = [value] if isinstance(value, str) else [] if value is None else value
        is_list = isinstance(entries, (list, tuple, array)) and len(entries) <= self.most
        if not is_list or not all(isinstance(entry, str) for entry in entries):
            most = (
                f" with at most {self.most} entries"
                if isinstance(entries, (list, tuple, array))
                else ""
            )
            raise ValueError(f"{self.name} must be a list of texts{most}, got {shown(value)}")
        kept = [entry.strip() for entry in entries if entry.strip()]
        patterns = sum(any(letter in entry for letter in "*?[") for entry in kept)
        if patterns > MAX_PATTERNS:
            raise ValueError(
                f"{self.name} must have at most {MAX_PATTERNS} patterns, got {patterns}"
            )
        for entry in kept:
            check_name(entry, f"an entry of {self.name}", MAX_ENTRY)
        if self.entry is None:
            return kept
        try:
            return [self.entry(entry) for entry in kept]
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}") from error


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
Value = TypeVar("Value")
Pair = tuple[str, str]
"""Two words: groups, names or patterns."""
GroupEntry = tuple[str, tuple[str, ...]]
"""The name of a group and words in it."""
WITH_WORDS = (
    *("allowed_pairs", "check_only_pairs", "padding_overrides", "accuracy_overrides"),
    *("object_timeout_overrides", "stale_policy_overrides", "required_objects", "ignored_objects"),
    *(f"effects.{effect}_objects" for effect in EFFECTS),
)
"""Parameters whose entries hold words."""
PAIRS = ("allowed_pairs", "check_only_pairs")
"""Those of two words each; of others with several parts the first one is a word."""
OF_ROBOTS = ("object_timeout_overrides", "stale_policy_overrides")
"""Those that may name robots."""
MAX_MEMBERS = MAX_OVERRIDES
"""Maximum names and patterns in a group, and in a list with all of its groups."""


def pattern_from_text(text: str) -> str:
    """Read a name or pattern; ValueError for anything else."""
    return as_patterns(text, "entry")[0]


def group_from_text(text: str) -> GroupEntry:
    """Read ``NAME: WORD WORD``; ValueError for anything else."""
    name, colon, words = text.partition(":")
    if not (colon and name.strip() and words.strip()):
        raise ValueError(f"{text!r} is not like 'gripper: hand/* finger/1'")
    name = name.strip()
    if not is_plain(name):
        raise ValueError(f"a group cannot have the name {name!r}")
    return name, split_words(words)


def pair_from_text(text: str) -> Pair:
    """Read ``WORD WORD``; ValueError for anything else."""
    words = split_words(text)
    if len(words) != 2:
        raise ValueError(f"{text!r} is not two names or patterns like 'robot/* table/1'")
    return words[0], words[1]


def split_words(text: str) -> tuple[str, ...]:
    """Return the words of a text; those with spaces are in quotes. ValueError with the reason."""
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise ValueError(f"{text!r}: {str(error).lower()}") from None
    return as_patterns(words, "words")


def is_plain(word: str) -> bool:
    """Return whether a word can only be a group: names of objects have a slash."""
    return not set(word) & set("/*?[")


class Groups:
    """Groups by name: a word means the members of a group, or itself as a name or pattern.

    robots: names that are no groups either. Raises ValueError for a group with a word that is none
    of these, or with too many members.
    """

    def __init__(self, entries: Iterable[GroupEntry], robots: Iterable[str] = ()) -> None:
        self._groups: dict[str, tuple[str, ...]] = {name: (name,) for name in robots}
        for name, words in entries:
            members = (*self._groups.get(name, ()), *self.all_meant(words))
            self._groups[name] = tuple(dict.fromkeys(members))
            if len(self._groups[name]) > MAX_MEMBERS:
                raise ValueError(f"the group {name!r} has more than {MAX_MEMBERS} members")

    def meant(self, word: str) -> tuple[str, ...]:
        """Return the names and patterns that a word stands for. ValueError for an unknown group.

        A misspelt group would silently make a rule about nothing.
        """
        if word in self._groups:
            return self._groups[word]
        if is_plain(word):
            close = get_close_matches(word, self._groups, 1)
            hint = f"; did you mean {close[0]}?" if close else ""
            if word and not close:
                hint = f"; all of a namespace are '{word}/*'"
            raise ValueError(f"{word!r} is not a group, a name like 'gripper/1' or a pattern{hint}")
        return (word,)

    def all_meant(self, words: Iterable[str]) -> list[str]:
        """Return the names and patterns that words stand for, each once."""
        return list(dict.fromkeys(name for word in words for name in self.meant(word)))

    def sides(self, pair: Pair) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return both sides of a pair."""
        return self.meant(pair[0]), self.meant(pair[1])

    def overrides(self, overrides: Iterable[tuple[str, Value]]) -> list[tuple[str, Value]]:
        """Return overrides of names and patterns for those of words."""
        return [(name, value) for word, value in overrides for name in self.meant(word)]


def check_words(values: Mapping[str, Any]) -> None:
    """Raise ValueError, beginning with the parameter, for a list with a word that is none.

    values: of all parameters, as ``Spec.read`` returns them.
    """
    for name in ("groups", *WITH_WORDS):
        try:
            if name == "groups":
                groups = Groups(values[name])
                groups_and_robots = Groups(values[name], values["robots"])
                continue
            words = [e if isinstance(e, str) else e[: 1 + (name in PAIRS)] for e in values[name]]
            _check(groups_and_robots if name in OF_ROBOTS else groups, words)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from error


def _check(groups: Groups, entries: Sequence[Any]) -> None:
    total = patterns = 0
    for entry in entries:
        words = (entry,) if isinstance(entry, str) else entry
        members = groups.all_meant(words)
        total += len(members)
        patterns += sum(not set("*?[").isdisjoint(name) for name in members)
    if total > MAX_MEMBERS or patterns > MAX_PATTERNS:
        raise ValueError(
            f"with their groups these are more than {MAX_MEMBERS} names or {MAX_PATTERNS} patterns"
        )


def folder_from_text(text: str) -> tuple[str, str]:
    """Return the package, "" for none, and the folder of ``FOLDER`` or ``PACKAGE: FOLDER``.

    ValueError for a path that is not absolute. The folder need not exist: it may be mounted later.
    """
    match = ENTRY.fullmatch(text)
    if match is None:
        raise ValueError(
            f"{shown(text)} is neither an absolute path nor like 'arm_description: /opt/arm'"
        )
    return match[1] or "", match[2]


def folders_from(values: Mapping[str, Any]) -> MeshFolders:
    """Return the folders that parameters mean; ValueError for a package that has two."""
    entries: list[tuple[str, str]] = values["mesh_folders"]
    named = [(package, folder) for package, folder in entries if package]
    packages = dict(named)
    if len(packages) < len(named):
        raise ValueError("mesh_folders must have at most one entry per package")
    return MeshFolders(tuple(folder for package, folder in entries if not package), packages)


def option_name(effect: str, option: str) -> str:
    """Return the parameter of an option; ``effects.sweep`` can't be a value and hold more."""
    return f"effects.{effect}_{option}"


EVERYTHING = "everything"
"""Bounds of a region that has none."""


def range_from_text(text: str) -> Range:
    """Return the axis and the ends (m) of an entry such as ``x: -inf to 5.0``."""
    match = RANGE.fullmatch(text)
    try:
        axis, low, high = match[1], float(match[2]), float(match[3])  # type: ignore[index]
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
    if not values["region"]:
        return None
    halo = values["region_halo"]
    for name, effect in EFFECTS.items():
        for key, option in effect.options.items():
            far = values[option_name(name, key)]
            if option.reaches and values[f"effects.{name}"] != OFF and far > halo:
                raise ValueError(
                    f"region_halo must be at least {option_name(name, key)}, {far:g} m, as far as "
                    f"the effect looks beyond objects, got {halo:g}"
                )
    return _region(values["region"], halo)


def bounds_text(region: Region | None) -> str:
    """Return the bounds of a region as text for a status, "everything" without any."""
    return (", ".join(text_from_region(region)) if region is not None else "") or EVERYTHING


def bounds_from_text(text: str) -> Region:
    """Return a region from the text of `bounds_text`; ValueError for any other text."""
    entries = [] if text == EVERYTHING else text.split(", ")
    return _region([range_from_text(entry) for entry in entries])


def _region(ranges: Sequence[Range], halo: float = 0.0) -> Region:
    low, high = np.full(3, -np.inf), np.full(3, np.inf)
    if len({axis for axis, _, _ in ranges}) < len(ranges):
        raise ValueError("region must have at most one entry per axis x, y, z")
    for axis, least, most in ranges:
        low[AXES.index(axis)], high[AXES.index(axis)] = least, most
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
    if unusable_poses(np.array([pose])).any():
        raise ValueError(
            f"{shown(text)} is not a pose: it is not finite, or its quaternion is zero"
        )
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
    bases: list[Base] = values["robot_bases"]
    for parameter, robots in (("robots", names), ("robot_bases", [base.robot for base in bases])):
        for number, name in enumerate(robots):
            if name in robots[:number]:
                raise ValueError(f"{parameter}: {name!r} occurs twice")
            if name not in names:
                raise ValueError(f"robot_bases: {name!r} is not in the parameter robots")
    return {name: Base(name) for name in names} | {base.robot: base for base in bases}


def region_parameters(
    minimum: str, maximum: str, parts: str, halo: str
) -> dict[str, dict[str, Any]]:
    """Return the parameters of the nodes that share a box split into parts, by namespace.

    All as words, with spaces between numbers. Raises ValueError for a word that is not a number.
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
