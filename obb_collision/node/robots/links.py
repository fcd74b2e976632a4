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

"""The links of a robot as objects: one per collision shape, ``ROBOT/LINK`` its namespace."""

from __future__ import annotations

from collections.abc import Iterable
from fnmatch import fnmatchcase
from functools import cached_property
from typing import NamedTuple

import numpy as np

from obb_collision.geometry.poses import (
    IDENTITY_POSE,
    compose_poses,
    multiply_quaternions,
    rotate_vectors,
)
from obb_collision.node.inputs.boxes import OWNED
from obb_collision.node.messages.conversions import (
    LARGEST_COORDINATE,
    Key,
    Kinds,
    are_unusable,
    name_from_key,
    pose_kinds,
)
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.objects.objects import Objects
from obb_collision.node.objects.table import ObjectTable
from obb_collision.robots.checks.arrays import allowed_links, rigid_groups
from obb_collision.robots.robot import Robot
from obb_collision.scene.store.allowed import AllowedMatrix
from obb_collision.typing import Floats, Mask, Rows

TWIST_STEP = 1e-5
"""Radians or metres of the fastest joint over which twists are differences: an error of 1e-10."""
SLOWEST = TWIST_STEP
"""Radians or metres per second: of slower joints the differences are over a second."""


class AttachedObjects(NamedTuple):
    """Slots (n,) of objects, and the rows (n,) of the links that they are attached to.

    keys, serials (n,): of the objects, since another one can have their slot, or their name.
    """

    slots: Rows
    links: Rows
    keys: tuple[Key, ...]
    serials: tuple[int, ...]

    @classmethod
    def of(cls, table: ObjectTable, slots: Rows, links: Rows) -> AttachedObjects:
        """Return the objects at slots."""
        return cls(slots, links, tuple(table.keys(slots)), tuple(table.serial[slots].tolist()))

    @property
    def identity(self) -> tuple[object, ...]:
        """What differs where something else is attached, or is elsewhere."""
        return self.slots.tolist(), self.links.tolist(), self.keys, self.serials


NONE_ATTACHED = AttachedObjects(np.empty(0, np.int64), np.empty(0, np.int64), (), ())


class Located(NamedTuple):
    """Poses (n, 7) of links, their kinds (n,), and twists (n, 6)."""

    poses: Floats
    kinds: Kinds
    twists: Floats


class LinkObjects:
    """The collision shapes of a robot's links, as objects of the node."""

    def __init__(self, name: str, robot: Robot, objects: Objects) -> None:
        self.name, self.robot = name, robot
        self.rows = {link: row for row, link in enumerate(robot.link_names)}
        self._objects = objects
        parts = [
            (link, number, shape, pose)
            for link, placed in enumerate(robot.shapes)
            for number, (shape, pose) in enumerate(placed)
        ]
        self.keys: list[Key] = [
            (f"{name}/{robot.link_names[link]}", number) for link, number, _, _ in parts
        ]
        self._shapes = [shape for _, _, shape, _ in parts]
        self._links = np.array([link for link, *_ in parts], np.int64)
        self._poses = np.array([pose for *_, pose in parts]).reshape(-1, 7)
        self.slots: Rows = np.empty(0, np.int64)
        """Of the objects, in the order of the keys."""
        self._serials: Rows = np.empty(0, np.int64)
        self.are_speeds_known = True
        """Whether all twists are those of the velocities, none being out of range."""

    def add(self) -> None:
        """Add the links as objects; RefusedError, and nothing is added, where that fails."""
        shapes, table = self._objects.shapes, self._objects.table
        taken = [key for key in self.keys if key in table.slots]
        if taken:
            raise RefusedError(OWNED.reason, name_from_key(taken[0]))
        self.slots = shapes.put_new(self.keys, self._shapes)
        table.of_robot[self.slots] = True
        self._serials = table.serial[self.slots]

    @property
    def _present(self) -> Rows:
        """The slots of links whose objects exist; an error in ``~/clear`` may have ended some."""
        return self.slots[self._objects.table.have_serials(self.slots, self._serials)]

    def remove(self) -> None:
        """Remove the objects of the links."""
        self._objects.shapes.remove(self._present)
        self.slots = self._serials = self.slots[:0]

    def refuse(self) -> None:
        """Mark the places of the links as unknown: their last boxes stay, grey."""
        self._objects.states.refuse(self._present)

    def located(self, base: Floats, positions: Floats, velocities: Floats) -> Located:
        """Return poses and twists of the links; RefusedError for poses that can't be used.

        base: pose (7,) of the root link; positions, velocities: of the joints.
        """
        if len(self._present) < len(self.slots):
            raise RefusedError("links removed", "call ~/clear")
        try:
            links = self.robot.link_poses(positions[None])[0, self._links]
            poses = compose_poses(base, compose_poses(links, self._poses))
        except ValueError as error:  # a quaternion of zeros
            raise RefusedError("bad pose", str(error)) from error
        kinds = pose_kinds(poses)
        if are_unusable(kinds).any():
            raise RefusedError("bad pose", "of a link: out of range")
        self.are_speeds_known = True
        twists = self._twists((self._links, self._poses), base, positions, velocities)
        return Located(poses, kinds, twists)

    def _twists(
        self, bodies: tuple[Rows, Floats], base: Floats, positions: Floats, velocities: Floats
    ) -> Floats:
        """Return the twists (n, 6) of bodies, which are rows of links and poses in their frames."""
        links, places = bodies
        twists = np.zeros((len(links), 6))
        fastest = np.abs(velocities).max(initial=0.0)
        if fastest > 0.0:
            time = TWIST_STEP / max(float(fastest), SLOWEST)
            ends = positions + np.array((-time, time))[:, None] * velocities
            at_links = self.robot.link_poses(ends)[:, links]
            before, after = compose_poses(base, compose_poses(at_links, places))
            back = before[:, 3:] * (-1.0, -1.0, -1.0, 1.0)
            turns = multiply_quaternions(after[:, 3:], back)
            turns *= np.where(turns[:, 3:] < 0.0, -1.0, 1.0)
            twists = np.hstack((after[:, :3] - before[:, :3], 2.0 * turns[:, :3])) / (2.0 * time)
            bad = ~(np.abs(twists) <= LARGEST_COORDINATE).all(axis=1)
            twists[bad] = 0.0
            self.are_speeds_known &= not bad.any()
        return twists

    def set_twists(
        self, attached: AttachedObjects, poses: Floats, positions: Floats, velocities: Floats
    ) -> None:
        """Store how attached objects move, in the frames of their links, which are at poses."""
        table, slots, links = self._objects.table, attached.slots, attached.links
        if len(slots) and (velocities.any() or table.twist[slots].any()):
            bodies = links, table.pose[slots]
            twists = self._twists(bodies, IDENTITY_POSE, positions, velocities)
            back = poses[links, 3:] * (-1.0, -1.0, -1.0, 1.0)
            parts = (rotate_vectors(back, twists[:, k : k + 3]) for k in (0, 3))
            table.twist[slots] = table.last_twist[slots] = np.hstack(list(parts))

    @cached_property
    def names(self) -> dict[str, list[str]]:
        """The names of the objects, by ``ROBOT/LINK``."""
        names: dict[str, list[str]] = {}
        for key in self.keys:
            names.setdefault(key[0], []).append(name_from_key(key))
        return names

    def touched_by(self, link: int, touch_links: Iterable[tuple[str, str]]) -> set[int]:
        """Return the rows of links that objects attached to a link may touch.

        Those that never move against it, of an end effector with one of these, and of
        ``touch_links``: pairs of patterns of names ``ROBOT/LINK``.
        """
        groups, names = self._groups, self.robot.link_names
        rows = set(np.flatnonzero(groups == groups[link]).tolist())
        own, touched = {names[row] for row in rows}, set(rows)
        for group in map(self.robot.groups.get, self.robot.end_effectors.values()):
            if group is not None and own & set(group.links):
                touched |= {self.rows[name] for name in group.links}
        for pattern, others_pattern in touch_links:
            if fnmatchcase(f"{self.name}/{names[link]}", pattern):
                matching = (fnmatchcase(f"{self.name}/{name}", others_pattern) for name in names)
                touched |= {row for row, matches in enumerate(matching) if matches}
        return touched

    def matrix(
        self, attached: AttachedObjects, touch_links: Iterable[tuple[str, str]]
    ) -> AllowedMatrix:
        """Return which links and attached objects may touch.

        Links of one rigid body, adjacent ones, and those disabled by the SRDF.
        """
        touch_links, groups, count = [*touch_links], self._groups, len(self._allowed)
        holders, which = np.unique(attached.links, return_inverse=True)
        allowed = np.pad(self._allowed, (0, len(holders)))
        for row, link in enumerate(holders.tolist(), count):
            touched = [*self.touched_by(link, touch_links)]
            touched += [*(count + np.flatnonzero(groups[holders] == groups[link]))]
            allowed[row, touched] = allowed[touched, row] = True
        held = zip(map(name_from_key, attached.keys), which.tolist(), strict=True)
        return AllowedMatrix(self._rows | {name: count + row for name, row in held}, allowed)

    @cached_property
    def _groups(self) -> Rows:
        """The first link of the rigid body of each link (links,)."""
        return rigid_groups(self.robot.tree)

    @cached_property
    def _rows(self) -> dict[str, int]:
        """The row of the link of each object, by name."""
        return dict(zip(map(name_from_key, self.keys), self._links.tolist(), strict=True))

    @cached_property
    def _allowed(self) -> Mask:
        """Which links may touch (links, links)."""
        return allowed_links([self.robot], self._groups)
