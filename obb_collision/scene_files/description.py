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

"""The content of a scene file: objects, robots, groups, allowed pairs, accuracy, effects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.poses import Pose
from obb_collision.geometry.shapes.primitives import NO_SCALE, Triple
from obb_collision.robots.robot import Robot
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.scene import Scene
from obb_collision.scene.store.patterns import matching
from obb_collision.shapes import Box, Shape

#: Effects of the node only: topics for people and monitors.
NODE_EFFECTS = (
    *("collisions", "text", "in_collision", "collision_status", "events"),
    *("markers", "diagnostics"),
)
Color = tuple[float, float, float, float]


@dataclass(frozen=True)
class SceneObject:
    """An object: name, shape, pose (x y z qx qy qz qw).

    padding (m), accuracy: None for those of the scene; color: red, green, blue and opacity from 0
    to 1, for pictures; an opacity below 1 makes the object a zone.
    """

    name: str
    shape: Shape
    pose: Pose
    padding: float | None = None
    accuracy: Accuracy | None = None
    color: Color | None = None


@dataclass(frozen=True)
class SceneRobot:
    """A robot: name, files, pose of the root link (x y z qx qy qz qw), and state.

    state: values of ``robot.joint_names``.
    """

    name: str
    urdf: Path
    srdf: Path | None
    robot: Robot
    pose: Pose
    state: tuple[float, ...]


@dataclass(frozen=True)
class AllowedRule:
    """Whether objects that match two patterns may touch; the last matching rule counts."""

    first: str
    second: str
    allowed: bool = True


@dataclass(frozen=True)
class EffectChoice:
    """Settings of an effect: mode, patterns of objects, options; None if the file has none."""

    mode: str | None = None
    objects: tuple[str, ...] | None = None
    options: Mapping[str, float | str] = field(default_factory=lambda: MappingProxyType({}))


@dataclass(frozen=True)
class View:
    """Viewpoint of a picture of the scene, and the point in its centre, m."""

    eye: Triple
    target: Triple


@dataclass(frozen=True)
class SceneDescription:
    """The content of a scene file, to build the scene and to draw it.

    groups: patterns by name; accuracies: patterns and their levels, the last match counts;
    time_budget: seconds per check, None for no budget; robots: for ``RobotScene``, not a part of
    the scene that ``build`` makes; notes: odd or ignored values of the file, one line each.

    Examples
    --------
    >>> oc.SceneDescription("empty", ()).build()
    Scene(0 objects, accuracy 'obb')
    """

    name: str
    objects: tuple[SceneObject, ...]
    description: str = ""
    groups: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: MappingProxyType({}))
    allowed: tuple[AllowedRule, ...] = ()
    accuracy: Accuracy = Accuracy.OBB
    accuracies: tuple[tuple[str, Accuracy], ...] = ()
    padding: float = 0.0
    time_budget: float | None = None
    effects: Mapping[str, EffectChoice] = field(default_factory=lambda: MappingProxyType({}))
    robots: tuple[SceneRobot, ...] = ()
    view: View | None = None
    notes: tuple[str, ...] = ()

    @property
    def names(self) -> list[str]:
        """The names of the objects, in their order."""
        return [obj.name for obj in self.objects]

    def build(self) -> Scene:
        """Return the scene, with its rules and effects."""
        budget: dict[str, Any] = {}
        if self.time_budget is not None:
            budget["time_budget"] = self.time_budget
        scene = Scene(padding=self.padding, accuracy=self.accuracy, **budget)
        levels = zip(self.objects, self.object_accuracies(), strict=True)
        for plain, run in groupby(levels, lambda pair: _is_plain_box(pair[0])):
            objects, accuracies = zip(*run, strict=True)
            if plain:
                sizes, poses = zip(*((obj.shape.size, obj.pose) for obj in objects), strict=True)
                scene.add_boxes([obj.name for obj in objects], sizes, poses, accuracies)
                continue
            for obj, level in zip(objects, accuracies, strict=True):
                scene.add(obj.name, obj.shape, obj.pose, padding=obj.padding, accuracy=level)
        for rule in self.allowed:
            scene.allow(rule.first, rule.second, rule.allowed)
        for name, choice in self.effects.items():
            if name in EFFECTS:
                scene.set_effect(name, choice.mode, choice.objects, **choice.options)
        return scene

    def object_accuracies(self) -> list[Accuracy | None]:
        """Return each object's own accuracy, or that of its last pattern, None for the scene's."""
        result: list[Accuracy | None] = [None] * len(self.objects)
        for pattern, accuracy in self.accuracies:
            for row in np.flatnonzero(matching([pattern], self.names)):
                result[row] = accuracy
        for k, obj in enumerate(self.objects):
            result[k] = result[k] if obj.accuracy is None else obj.accuracy
        return result


def _is_plain_box(obj: SceneObject) -> bool:
    """Return whether an object is a box without scale and without its own padding."""
    return type(obj.shape) is Box and obj.shape.scale == NO_SCALE and obj.padding is None
