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

"""The content of a scene file: objects, robots, groups, allowed pairs, accuracy, effects, lidar.

The lidar is simulated, for demos and measurements of the effect ``points``: its rays hit the floor
(z = 0) and the shapes of the objects that it sees.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import compress, groupby
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.poses import Pose
from obb_collision.geometry.shapes.primitives import NO_SCALE, Triple
from obb_collision.geometry.values import read_only_view
from obb_collision.robots.robot import Robot
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.scene import Scene
from obb_collision.scene.store.patterns import matching
from obb_collision.shapes import Box, Shape
from obb_collision.typing import Floats

Cloud = NDArray[np.float32]

#: Lines of a scanner, and their lowest and highest angle above the horizon, rad.
LINES = 32
LOWEST, HIGHEST = np.radians(-35.0), np.radians(15.0)
#: Standard deviation of a measured distance, and minimum distance, m.
NOISE, NEAREST = 0.01, 0.3
#: The direction of a ray of length zero: any.
UP = 0.0, 0.0, 1.0


@dataclass(frozen=True)
class Lidar:
    """A scanner: rays per revolution, range (m), position (3,), patterns of objects that it sees.

    seed: of the noise of the distances; equal seeds and times give equal clouds.
    """

    count: int
    range: float
    position: Triple = (0.0, 0.0, 1.0)
    sees: tuple[str, ...] = ("*",)
    seed: int = 0

    @cached_property
    def directions(self) -> Floats:
        """Unit directions (count, 3) of the rays, line by line from the lowest."""
        lines = min(LINES, self.count)
        line = np.arange(self.count) * lines // self.count
        turn = np.modf(np.arange(self.count) * lines / self.count)[0] * 2.0 * np.pi
        rise = LOWEST + (HIGHEST - LOWEST) * line / max(lines - 1, 1)
        x, y = np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn)
        return read_only_view(np.stack([x, y, np.sin(rise)], axis=1))

    def scan(self, scene: Scene, time: float) -> Cloud:
        """Return the points (k, 3) seen of a scene at a time (s), except on objects around it."""
        directions, origin = self.directions, np.array(self.position)
        with np.errstate(divide="ignore"):
            ways = np.where(directions[:, 2] < 0.0, -origin[2] / directions[:, 2], np.inf)
        ways[ways <= 0.0] = np.inf
        ways = np.minimum(ways, self.range)
        visible = set(compress(scene.names, matching(self.sees, scene.names)))
        while True:
            around = scene.cast_rays([origin], [UP], 0.0, accuracy=Accuracy.MESH, objects=visible)
            if not around.hits[0]:
                break
            visible.remove(scene.name(around.boxes[0]))
        origins = np.tile(origin, (len(directions), 1))
        hits = scene.cast_rays(origins, directions, ways, accuracy=Accuracy.MESH, objects=visible)
        ways = np.minimum(ways, hits.distances)
        moment = round(time * 1e6) % 2**63  # microseconds
        noise = np.random.default_rng([self.seed, moment]).normal(0.0, NOISE, self.count)
        seen = (ways >= NEAREST) & (ways < self.range)
        points = origin + (ways + noise)[seen, None] * directions[seen]
        return points.astype(np.float32)


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
    lidar: Lidar | None = None
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
