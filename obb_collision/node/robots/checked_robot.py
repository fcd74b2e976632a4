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

"""A robot in the node's scene as it is: its frames, its attached objects, and its checks.

Attached objects have markers locked to the frame of a link. They are objects like all others,
placed in each cycle where their link is; in checks of states of the robot they are a part of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from time import monotonic
from typing import NamedTuple

import numpy as np

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.poses import compose_poses
from obb_collision.node.diagnostics.answer import first_names
from obb_collision.node.messages.conversions import name_from_key, unusable_poses
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.objects.frames import LINK_NOT_KNOWN, FrameSource
from obb_collision.node.objects.objects import Objects
from obb_collision.node.parameters.parameters import Parameters
from obb_collision.node.robots.joints import Joints
from obb_collision.node.robots.links import AttachedObjects, LinkObjects
from obb_collision.node.robots.robot_input import RobotInput
from obb_collision.robots.checks.bodies import WorldState
from obb_collision.robots.checks.distances import distance_rates, state_distances
from obb_collision.robots.checks.model import Prepared
from obb_collision.robots.checks.motions import check_motions
from obb_collision.robots.checks.states import check_states
from obb_collision.robots.kinematics.kinematics import PLANAR
from obb_collision.robots.robot import Robot
from obb_collision.robots.robot_scene import DEFAULT_RESOLUTION, RobotScene
from obb_collision.scene.store.patterns import Overrides
from obb_collision.typing import Floats, Rows

SCENE_NOT_KNOWN = "scene not known"
FEW = 4
"""Rows of a portion, at least."""
MOST_SCENES = 3
"""Scenes of a robot that are kept: without margin, with those of trajectories and of the stop."""


class Attachment(NamedTuple):
    """All that an attached object depends on."""

    serial: int
    link: str
    pose: tuple[float, ...]
    touch_links: tuple[str, ...]
    revision: int


class NodeRobotScene(RobotScene):
    """Robots in the node's scene; doubts are published."""

    warns = False
    still_pairs = False
    """Whether pairs count for speeds whose distance nothing changes, see ``standing``."""

    @property
    def _outer(self) -> Prepared:
        """The pairs with the world that count for speeds."""
        still = self.still_pairs
        made = self._prepared if still else self._prepared.without_still_pairs(self.standing)
        return made.without_self_pairs

    def least_distance(self, state: Floats, limit: float) -> float:
        """Return the least distance in a state (1, joints), infinite beyond a limit."""
        asked = state, limit, False, False, False
        found = state_distances(self._outer, self.accuracy, *asked)
        return float(found.distances[0])

    def is_near(self, state: Floats) -> bool:
        """Return whether a pair that counts collides in a state (1, joints)."""
        return bool(check_states(self._outer, self.accuracy, state, False).colliding[0])

    def free_share(self, start: Floats, end: Floats) -> float:
        """Return up to which share a motion between states (1, joints) is certainly free."""
        asked = self._outer, self.accuracy, start, end, DEFAULT_RESOLUTION
        if not check_motions(*asked, first=False).colliding[0]:
            return 1.0
        found = check_motions(*asked, first=True)
        return float(found.fractions[0]) if found.colliding[0] else 1.0

    def rates(
        self, state: Floats, velocities: Floats, limit: float, slots: Rows | None = None
    ) -> tuple[Floats, Rows, Floats]:
        """Return distances (m,), slots (m,) of objects, and ``distance_rates`` (m,).

        slots: of the objects that count, None for all.
        """
        outer = self._outer
        world, checked = outer.world.slots, outer.checked
        if slots is not None:
            tests = checked.tests
            allowed = np.repeat(~np.isin(world, slots)[None], tests.first, axis=0)
            if len(tests.allowed):
                allowed |= tests.allowed
            tests = tests._replace(allowed=allowed)
            outer = replace(outer, checked=checked._replace(tests=tests))
        near = distance_rates(outer, self.accuracy, state, velocities, limit)
        return near[0], world[near[1][:, 1] - len(outer.names) + len(world)], near[2]


class Stopping(NamedTuple):
    """How a robot can stop.

    speeds, decelerations (joints,): at most; lacking: what is not known, "" if all is.
    """

    speeds: Floats
    decelerations: Floats
    lacking: str = ""

    def time(self, velocities: Floats) -> float:
        """Return the time (s) in which all joints can stop together from velocities (joints,)."""
        return float((np.abs(velocities) / self.decelerations).max(initial=0.0))


def portions(count: int, quick: float) -> Iterator[slice]:
    """Yield slices of rows: a few at first, and more after some that were quick (s)."""
    start, size = 0, FEW
    while start < count:
        before = monotonic()
        yield slice(start, min(start + size, count))
        start += size
        size = 2 * size if monotonic() - before < quick else max(size // 2, FEW)


class CheckedRobot:
    """A robot in the node's scene, without the objects that are its own links.

    frames: where its base is; not_known: returns why states cannot be checked now, "" if they can.
    """

    def __init__(
        self,
        robot: RobotInput,
        objects: Objects,
        frames: LinkFrames,
        parameters: Parameters,
        clock: Callable[[], int],
        not_known: Callable[[], str],
    ) -> None:
        self.input, self.objects, self._frames = robot, objects, frames
        self.parameters, self.clock, self._not_known = parameters, clock, not_known
        self._made: dict[float, tuple[Robot, dict[str, Attachment], NodeRobotScene]] = {}
        self._stopping: tuple[Joints, list[tuple[str, float]], Stopping] | None = None

    @property
    def links(self) -> LinkObjects:
        """The links of the robot; RefusedError without a description."""
        if self.input.links is None:
            raise RefusedError(SCENE_NOT_KNOWN, f"robot {self.input.name}: {self.input.fault}")
        return self.input.links

    @property
    def robot(self) -> Robot:
        """The robot; RefusedError without a description."""
        return self.links.robot

    @property
    def joints(self) -> Joints:
        """The joints of the robot; RefusedError without a description."""
        if self.input.joints is None:
            raise RefusedError(SCENE_NOT_KNOWN, f"robot {self.input.name}: {self.input.fault}")
        return self.input.joints

    @property
    def stopping(self) -> Stopping:
        """How the robot can stop; RefusedError without a description."""
        joints, given = self.joints, self.parameters.joint_decelerations
        if self._stopping is None or self._stopping[:2] != (joints, given):
            values = Overrides(given)
            found = [values.value(f"{self.input.name}/{name}") for name in joints.names]
            decelerations = np.array([np.nan if v is None else v for v in found])
            lacking = ""
            for rows, what in (
                (np.isnan(decelerations), "joint_decelerations"),
                (np.isinf(joints.speed_limits), "a velocity limit"),
            ):
                names = [joints.names[row] for row in np.flatnonzero(rows)]
                if names and not lacking:
                    lacking = f"joints without {what}: {first_names(names, len(names))}"
            if (self.robot.tree.kinds >= PLANAR).any():
                lacking = "planar or floating joints"
            stopping = Stopping(joints.speed_limits, decelerations, lacking)
            self._stopping = joints, given, stopping
        return self._stopping[2]

    def scene(self, padding: float = 0.0) -> NodeRobotScene:
        """Return the scene that checks states as things are; RefusedError where those are unknown.

        padding: metres by which links are grown.
        """
        unknown = self._not_known()
        if unknown:
            raise RefusedError(SCENE_NOT_KNOWN, unknown)
        return self.grown(padding)

    def grown(self, padding: float) -> NodeRobotScene:
        """Return the scene as ``scene`` does, right after another one was returned."""
        robot, base = self.robot, self._base()
        made = self._made.get(padding)
        if made is None or made[0] is not robot:
            scene, named = self.objects.scene, {self.input.name: robot}
            checker = NodeRobotScene(named, scene, Accuracy.HULL, bases=[base], padding=padding)
            checker.link_objects = self.links.names
            kept = [(p, one) for p, one in self._made.items() if one[0] is robot and p != padding]
            self._made = dict(kept[1 - MOST_SCENES :])
            made = self._made[padding] = robot, {}, checker
        checker = made[2]
        checker.bases = base[None]
        try:
            self._attach(checker, made[1])
        except ValueError as error:  # it has the name of a link
            raise RefusedError(SCENE_NOT_KNOWN, f"not attached: {error}") from error
        return checker

    def _attach(self, checker: RobotScene, held: dict[str, Attachment]) -> None:
        """Attach and detach objects, and update ``held``, which lists them."""
        wanted = self._held()
        for name in [name for name in held if name not in wanted]:
            checker.detach(name)
            del held[name]
        for name, attachment in wanted.items():
            if held.get(name) != attachment:
                placed = name, attachment.link, attachment.pose
                checker.attach_object(*placed, touch_links=attachment.touch_links)
                held[name] = attachment

    def _held(self) -> dict[str, Attachment]:
        links, objects = self.links, self.objects
        attached, rows = self.input.attached, self.input.attached.links
        table, revision = objects.table, objects.scene.objects.revision
        named = [f"{links.name}/{link}" for link in links.robot.link_names]
        touched = {
            row: tuple(
                named[link] for link in sorted(links.touched_by(row, self.parameters.touch_links))
            )
            for row in np.unique(rows).tolist()
        }
        attachments = {}
        places = map(tuple, table.pose[attached.slots].tolist())
        for key, serial, row, pose in zip(
            attached.keys, attached.serials, rows.tolist(), places, strict=True
        ):
            held = Attachment(serial, named[row], pose, touched[row], revision)
            attachments[name_from_key(key)] = held
        return attachments

    def world(self, checker: RobotScene) -> tuple[object, ...]:
        """Return all that a certificate depends on: scene, base and attached objects."""
        return checker.world_state(), self._base().tobytes(), self._held()

    def is_world(self, world: tuple[object, ...]) -> bool:
        """Return whether scene, base and attached objects are as they were in ``world``."""
        state, base, held = world
        assert isinstance(state, WorldState)
        if not state.is_current(self.objects.scene):
            return False
        return base == self._base().tobytes() and held == self._held()

    def _base(self) -> Floats:
        """Return where the root link is (7,), in the fixed frame."""
        try:
            return self._frames.base(self.input)[0]
        except RefusedError as error:
            raise RefusedError(SCENE_NOT_KNOWN, error.detail) from error


class LinkFrames:
    """The frames of links, by joint states: ``ROBOT/LINK``, or LINK where one robot alone has it.

    inner: all other frames, and all frames at stamps. The frame in which a robot stands is of
    those, whatever its name.
    """

    def __init__(self, inner: FrameSource, fixed_frame: str, names: Sequence[str]) -> None:
        self._inner, self._fixed_frame, self._names = inner, fixed_frame, names
        self.waits, self.description = inner.waits, inner.description
        self.robots: Sequence[RobotInput] = ()

    def find(self, frame: str) -> tuple[RobotInput, int] | None:
        """Return the robot and the row of the link that a frame is of, None for another frame."""
        name, slash, link = frame.partition("/")
        own = slash and name in self._names
        matches = [
            (robot, row)
            for robot in self.robots
            if robot.links is not None and (robot.name == name or not own)
            for row in [robot.links.rows.get(link if own else frame)]
            if row is not None
        ]
        if len(matches) != 1 or any(robot.stands_in == frame for robot in self.robots):
            return None
        return matches[0]

    def lookup(self, frame: str, stamp: int) -> tuple[Floats, int]:
        """Return the pose (7,) of a frame, and its stamp; RefusedError also without joints.

        The stamp of a link is that of its base: joints have ages of their own.
        """
        link = self.find(frame) if stamp == 0 else None
        if link is None:
            return self._other(frame, stamp)
        robot, row = link
        if robot.fault:
            raise RefusedError(LINK_NOT_KNOWN, f"{frame!r}: {robot.fault}")
        base, at = self.base(robot)
        return compose_poses(base, robot.link_poses[row]), at

    def _other(self, frame: str, stamp: int) -> tuple[Floats, int]:
        try:
            return self._inner.lookup(frame, stamp)
        except RefusedError as error:
            name, slash, _ = frame.partition("/")
            robots = [robot for robot in self.robots if robot.links is None and robot.name == name]
            if slash and robots:
                raise RefusedError(LINK_NOT_KNOWN, f"{frame!r}: {robots[0].fault}") from error
            raise

    def base(self, robot: RobotInput) -> tuple[Floats, int]:
        """Return where the root link is (7,), in the fixed frame; RefusedError if not known.

        And the stamp of the transform that says so, 0 for none.
        """
        if robot.where is None:
            raise RefusedError(LINK_NOT_KNOWN, f"robot {robot.name}: no base")
        pose, frame = robot.where
        if frame in ("", self._fixed_frame):
            return pose, 0
        outer, at = self._inner.lookup(frame, 0)
        if unusable_poses(outer[None]).any():
            raise RefusedError(LINK_NOT_KNOWN, f"robot {robot.name}: bad pose of its base")
        return compose_poses(outer, pose), at


def find_attached(objects: Objects, frames: LinkFrames) -> dict[str, AttachedObjects]:
    """Return the objects attached to the links of each robot, by its name."""
    table = objects.table
    slots = np.flatnonzero(table.live & table.locked)
    parts_of: dict[str, list[tuple[Rows, Rows]]] = {}
    for index in np.unique(table.frame[slots]).tolist():
        link = frames.find(objects.placement.frame_table.name(index))
        if link is not None:
            attached = slots[table.frame[slots] == index]
            parts_of.setdefault(link[0].name, []).append(
                (attached, np.full(len(attached), link[1]))
            )
    return {
        name: AttachedObjects.of(table, *map(np.concatenate, zip(*parts, strict=True)))
        for name, parts in parts_of.items()
    }
