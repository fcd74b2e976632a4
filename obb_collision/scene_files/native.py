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

"""Scene files of this package: top level, groups, rules, effects and robots."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable
from functools import partial
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.validation import without_warnings
from obb_collision.robots.robot import Robot
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.effects.base import Option
from obb_collision.scene.effects.settings import MODES
from obb_collision.scene.store.patterns import matching
from obb_collision.scene_files.description import (
    NODE_EFFECTS,
    AllowedRule,
    EffectChoice,
    SceneDescription,
    SceneRobot,
    View,
)
from obb_collision.scene_files.mesh_files import MeshFiles
from obb_collision.scene_files.objects import (
    ORIGIN,
    PATTERN_LETTERS,
    quaternion_of,
    read_accuracy,
    read_objects,
)
from obb_collision.scene_files.yaml_values import Problems, Reader, Value
from obb_collision.words import printable

#: Reads the patterns of a word or a list of words.
Patterns = Callable[[Value], tuple[str, ...]]


def read_effects(value: Value, patterns: Patterns) -> MappingProxyType[str, EffectChoice]:
    """Return the settings of each effect."""
    choices: dict[str, EffectChoice] = {}
    for name, entry in value.fields((*EFFECTS, *NODE_EFFECTS)).items():
        with value.problems.kept():
            choices[name] = _read_effect(name, entry, patterns)
    return MappingProxyType(choices)


def _read_effect(name: str, value: Value, patterns: Patterns) -> EffectChoice:
    if not value.is_mapping:
        return EffectChoice(value.choice(MODES))
    readers: dict[str, Reader] = {"mode": lambda entry: entry.choice(MODES)}
    options = EFFECTS[name].options if name in EFFECTS else {}
    if name in EFFECTS:
        readers["objects"] = patterns
    readers |= {key: partial(_read_option, key, option) for key, option in options.items()}
    settings = value.read({}, readers)
    chosen = {key: settings.pop(key) for key in options if key in settings}
    return EffectChoice(**settings, options=MappingProxyType(chosen))


def _read_option(key: str, option: Option, value: Value) -> float | str:
    with value.reasons():
        word = isinstance(option.default, str)
        checked = option.checked(key, value.text() if word else value.number())
    return checked


ROBOT_KEYS = ("name", "urdf", "srdf", "position", "rpy", "quaternion", "joints")
#: Names of robots: they are parts of names of topics.
ROBOT_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


def read_robots(
    values: list[Value], files: MeshFiles, problems: Problems
) -> tuple[SceneRobot, ...]:
    """Return the valid robots; others are problems."""
    robots: dict[str, SceneRobot] = {}
    for value in values:
        with problems.kept():
            robot = _read_robot(value, files)
            if robot.name in robots:
                value.refuse(f"the name {robot.name} stands twice")
            robots[robot.name] = robot
    return tuple(robots.values())


def _read_robot(value: Value, files: MeshFiles) -> SceneRobot:
    fields = value.fields(ROBOT_KEYS, ("name", "urdf"))
    name = fields["name"].text("a name")
    if not ROBOT_NAME.fullmatch(name):
        fields["name"].expected("letters, digits and _, the first a letter")
    urdf = files.path(fields["urdf"], "URDF")
    srdf = files.path(fields["srdf"], "SRDF") if "srdf" in fields else None
    place = fields["position"].triple() if "position" in fields else ORIGIN
    with fields["urdf"].reasons(), without_warnings():
        reading = files.reading
        robot = Robot.from_urdf(urdf, srdf, reading.folders, read_mesh=reading.read)
    for doubt in robot.doubts:
        value.doubt(doubt)
    zeros = np.array([float(name.endswith("/rot_w")) for name in robot.joint_names])
    state = tuple(np.clip(zeros, robot.lower, robot.upper).tolist())
    if "joints" in fields:
        state = read_state(fields["joints"], robot, state)
    return SceneRobot(name, urdf, srdf, robot, (*place, *quaternion_of(fields)), state)


def read_state(value: Value, robot: Robot, before: tuple[float, ...]) -> tuple[float, ...]:
    """Return a state; joints that the value does not name have the values of ``before``."""
    state = dict(zip(robot.joint_names, before, strict=True))
    limits = dict(zip(robot.joint_names, zip(robot.lower, robot.upper, strict=True), strict=True))
    for joint, entry in value.entries().items():
        if joint not in state:
            entry.refuse(f"no joint of the robot moves so{value.guess(joint, robot.joint_names)}")
        low, high = limits[joint]
        state[joint] = entry.number(
            f"a number within the joint's limits, {low:g} to {high:g}",
            lambda number, low=low, high=high: low <= number <= high,  # type: ignore[misc]
        )
    return tuple(state.values())


KEYS = (
    *("name", "description", "objects", "groups", "allowed", "accuracy", "padding"),
    *("time_budget", "effects", "robots", "view"),
)
#: Key of the accuracy of all objects that no other entry matches.
DEFAULT = "default"
#: Maximum number of patterns of a word or list, and of allowed pairs of patterns: all are compared
#: with the names of all objects.
MAX_PATTERNS, MAX_RULES = 1000, 100_000
#: Maximum time budget (s): a larger one is probably meant in milliseconds.
MAX_BUDGET = 1.0


def read_scene(top: Value, path: Path, files: MeshFiles) -> SceneDescription:
    """Return the description in a file; SceneFileError with all its problems."""
    problems = top.problems
    fields = top.fields(KEYS, ("objects",))
    objects, named = read_objects(fields["objects"].items(), files, problems)
    words = Words(named)

    def robots_of(value: Value) -> tuple[SceneRobot, ...]:
        robots = read_robots(value.items(), files, problems)
        words.add_links(robots)
        return robots

    readers: dict[str, Reader] = {
        "robots": robots_of,  # first, as patterns may match their links
        "groups": words.read_groups,  # then groups, which the other keys use
        "name": Value.text,
        "description": Value.prose,
        "allowed": lambda value: _read_allowed(value, words),
        "padding": Value.not_negative,
        "time_budget": lambda value: value.number(
            f"seconds, above 0 and at most {MAX_BUDGET:g}", lambda x: 0.0 < x <= MAX_BUDGET
        ),
        "effects": lambda value: read_effects(value, words.patterns),
        "view": _read_view,
        "accuracy": lambda value: _read_accuracies(value, words),
    }
    values: dict[str, Any] = {"name": printable(path.stem), **problems.read(fields, readers)}
    if "accuracy" in values:
        values["accuracy"], values["accuracies"] = values["accuracy"]
    return SceneDescription(objects=tuple(objects), notes=problems.doubts(), **values)


class Words:
    """The meaning of words in a file: groups, objects, or patterns of names."""

    def __init__(self, names: Collection[str]) -> None:
        self._names = names
        self._groups: dict[str, tuple[str, ...]] = {}
        self._links: list[str] = []
        self._looked_up: set[str] = set()

    def add_links(self, robots: Iterable[SceneRobot]) -> None:
        """Add the links of robots, whose objects are called ``ROBOT/LINK/0``, and so on."""
        for entry in robots:
            for link, shapes in zip(entry.robot.link_names, entry.robot.shapes, strict=True):
                name = f"{entry.name}/{link}"
                self._links += [name, *(f"{name}/{number}" for number in range(len(shapes)))]

    def read_groups(self, value: Value) -> MappingProxyType[str, tuple[str, ...]]:
        """Add the groups of a file."""
        for name, entry in value.entries().items():
            with value.problems.kept():
                self._groups[name] = ()  # words for it are no problems if it is invalid
                if name in self._names:
                    entry.refuse("an object has this name already")
                if name == DEFAULT or any(letter in PATTERN_LETTERS + "/" for letter in name):
                    entry.refuse(f"a group cannot have the name {name}")
                self._groups[name] = self.patterns(entry)
        return MappingProxyType(self._groups)

    def known_patterns(self, value: Value) -> tuple[str, ...]:
        """Return ``patterns``, with a doubt for each that matches nothing yet."""
        words = self.patterns(value)
        for word in words:
            if word in self._looked_up:
                continue
            self._looked_up.add(word)
            if not any(matching([word], [*names]).any() for names in (self._names, self._links)):
                value.doubt(f"{word} matches no object and no link of a robot")
        return words

    def patterns(self, value: Value) -> tuple[str, ...]:
        """Return the patterns of a word or a list of words."""
        values = value.items() if value.is_list else [value]
        if not values:
            value.expected("a pattern, a group, or a list of them")
        patterns: dict[str, None] = {}  # without repetitions, which groups of groups would multiply
        for item in values:
            patterns.update(dict.fromkeys(self.meant(item, item.text())))
            if len(patterns) > MAX_PATTERNS:
                value.refuse(f"these are more than {MAX_PATTERNS} patterns")
        return tuple(patterns)

    def meant(self, value: Value, word: str) -> tuple[str, ...]:
        """Return the patterns of a word.

        Patterns may match objects that are added later. A plain word must be a group or an object,
        so that a misspelt group is an error.
        """
        if word in self._groups:
            return self._groups[word]
        pattern = any(letter in PATTERN_LETTERS + "/" for letter in word)
        if not pattern and word not in self._names:
            hint = value.guess(word, [*self._groups, *self._names])
            value.refuse(f"{word} is not a group, object or pattern{hint}")
        return (word,)


def _read_allowed(value: Value, words: Words) -> tuple[AllowedRule, ...]:
    rules: list[AllowedRule] = []
    for entry in value.items():
        with value.problems.kept():
            if not entry.is_list or len(entry.items()) != 2:
                entry.expected("a pair of groups, names or patterns")
            first, second = (words.known_patterns(item) for item in entry.items())
            if len(rules) + len(first) * len(second) > MAX_RULES:
                value.refuse(f"these are more than {MAX_RULES} pairs of patterns")
            rules += [AllowedRule(a, b) for a, b in product(first, second)]
    return tuple(rules)


def _read_accuracies(
    value: Value, words: Words
) -> tuple[Accuracy, tuple[tuple[str, Accuracy], ...]]:
    """Return the accuracy of the scene, and those of patterns."""
    if not value.is_mapping:
        return read_accuracy(value), ()
    default = Accuracy.OBB
    levels: list[tuple[str, Accuracy]] = []
    for word, entry in value.entries().items():
        with value.problems.kept():
            if word == DEFAULT:
                default = read_accuracy(entry)
                continue
            level = read_accuracy(entry)
            levels += [(pattern, level) for pattern in words.meant(entry, word)]
    return default, tuple(levels)


def _read_view(value: Value) -> View:
    view = View(**value.read({"eye": Value.triple, "target": Value.triple}))
    if view.eye[:2] == view.target[:2]:
        value.refuse("eye and target must not stand above each other: then up is undefined")
    return view
