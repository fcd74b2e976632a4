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

"""The model of a ``RobotScene``: what kernels need of robots and a scene, made anew on changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from obb_collision._jit import Held, hold
from obb_collision.accuracy import Accuracy
from obb_collision.geometry.poses import IDENTITY_POSE, compose_poses, rotate_vectors
from obb_collision.geometry.validation import warn_caller
from obb_collision.obb import OBB
from obb_collision.robots.checks.arrays import (
    Checked,
    JointLimits,
    LinkBodies,
    PairValues,
    Tests,
    allowed_links,
    body_pairs,
    chain_lengths,
    driving_joints,
    next_joint,
    one_tree,
    rigid_groups,
)
from obb_collision.robots.checks.bodies import (
    Kept,
    LinkMeshes,
    Part,
    World,
    WorldState,
    body_of,
    enclosing_spheres,
    is_about_z,
    joined,
    largest_padding,
    world_of,
)
from obb_collision.robots.checks.chains import NO_CHAINS, chains_of
from obb_collision.robots.kinematics.kinematics import FLOATING, PRISMATIC, Tree, link_poses
from obb_collision.scene.building.shape_cache import TRIANGLES, kind_of
from obb_collision.scene.scene import Scene
from obb_collision.shapes import Shape, Sphere
from obb_collision.typing import Floats, Integers, Mask, Rows
from obb_collision.words import shown

if TYPE_CHECKING:
    from obb_collision.robots.robot import Robot

#: Metres along each axis within which the first robot moves without the world, which is relative
#: to where that robot was, being placed again; farther away roundings would grow.
NEAR = 2.0
#: Metres, and radians, by which the axis of a body may be off that of its joint: the rounding of
#: angles such as 1.5708 in descriptions.
COAXIAL = 1e-5


@dataclass(frozen=True, eq=False)
class Attached:
    """Something attached to a link, at a pose in its frame; it may touch links.

    of_scene: it is an object of the scene, which is no obstacle meanwhile.
    """

    shape: Shape | OBB
    link: int
    pose: Floats
    touch_links: frozenset[int]
    padding: float
    of_scene: bool = False


@dataclass(frozen=True, eq=False)
class OwnBodies:
    """The bodies of robots, those of a link in a row, and the rows of names that they belong to."""

    parts: list[Part]
    bodies: LinkBodies
    owners: Rows
    allowed: Mask
    """(links and attached, the same): pairs that are not checked."""
    tree: Tree

    @classmethod
    def of(cls, parts: list[Part], allowed: Mask, chains: Floats, tree: Tree) -> OwnBodies:
        """Return the bodies of parts; chains (links,): the lengths up to links."""
        parts = sorted(parts, key=lambda part: part.link)
        bodies = [
            body_of(part.shape, part.pose, part.link, part.padding, float(chains[part.link]))
            for part in parts
        ]
        owners = np.array([part.owner for part in parts], np.int64)
        return cls(parts, joined(bodies), owners, allowed, tree)

    @cached_property
    def driven(self) -> Mask:
        """As ``driving_joints``."""
        return driving_joints(self.tree)

    @cached_property
    def moved(self) -> Mask:
        """(b, links) which joints move bodies: not one that turns a round body about its axis."""
        tree, moved = self.tree, self.driven[self.bodies.frames].copy()
        state = np.zeros((1, int(tree.columns.max(initial=-1)) + 8))
        state[:, tree.columns[tree.kinds == FLOATING] + 6] = 1.0
        places = link_poses(tree, state)[0]
        for row, (shape, pose, link, *_) in enumerate(self.parts):
            joint = next_joint(tree, link)
            if is_about_z(shape):
                body = compose_poses(places[link], np.asarray(pose, np.float64))
                while joint >= 0 and self._turns(joint, places, body, isinstance(shape, Sphere)):
                    moved[row, joint] = False
                    joint = next_joint(tree, int(tree.parents[joint]))
        return moved

    def _turns(self, joint: int, places: Floats, body: Floats, is_ball: bool) -> bool:
        """Return whether a joint turns a body that is round about its z axis about that axis."""
        tree, parent = self.tree, self.tree.parents[joint]
        if tree.kinds[joint] >= PRISMATIC:
            return False
        outer = places[parent, 3:] if parent >= 0 else IDENTITY_POSE[3:]
        axis = rotate_vectors(outer, tree.directions[joint])
        off = np.abs(np.cross(axis, body[:3] - places[joint, :3])).max()
        tilt = np.abs(np.cross(axis, rotate_vectors(body[3:], np.array((0.0, 0.0, 1.0))))).max()
        return bool(off <= COAXIAL and (is_ball or tilt <= COAXIAL))

    @cached_property
    def meshes(self) -> LinkMeshes:
        """The same bodies as meshes."""
        return LinkMeshes(self.parts)

    @cached_property
    def links(self) -> tuple[Rows, Rows, Floats, Floats]:
        """The frames of bodies, the first body of each, and spheres around them: see ``Tests``."""
        links, starts = np.unique(self.bodies.frames, return_index=True)
        starts = np.append(starts, len(self.parts)).astype(np.int64)
        return links, starts, *enclosing_spheres(self.bodies, starts)


@dataclass(frozen=True, eq=False)
class Prepared:
    """What kernels take, and the names of what bodies belong to."""

    checked: Checked
    own: OwnBodies
    world: World
    limits: JointLimits
    names: list[str]
    joint_names: tuple[str, ...]
    _moving: dict[Accuracy, Held] = field(default_factory=dict, init=False)
    _still: list[tuple[bytes, Prepared]] = field(default_factory=list, init=False)

    @cached_property
    def touching(self) -> PairValues:
        """Distances of zero: bodies must touch to collide."""
        return self.within(np.zeros(1))

    def within(self, reach: Floats) -> PairValues:
        """Return distances (k,) of all pairs of bodies, by state (k,), or one for all."""
        ends = self.checked.tests.first, len(self.checked.tests.pairs)
        return PairValues(*(np.repeat(reach[:, None], end, axis=1) for end in ends))

    @cached_property
    def meshes(self) -> Mask:
        """(b,) which bodies are meshes, whose pairs hulls do not decide."""
        own = [kind_of(part.shape) for part in self.own.parts]
        return np.append(np.array(own, np.int64), self.world.kinds) == TRIANGLES

    @cached_property
    def excess(self) -> Floats:
        """(b + 1,) that of bodies, and 0 for none."""
        return np.append(self.checked.bodies.excess, 0.0)

    @cached_property
    def held(self) -> Held:
        """``checked`` as kernels take it."""
        return hold(self.checked)

    @cached_property
    def without_self_pairs(self) -> Prepared:
        """The same where only pairs with the world are tested."""
        tests = self.checked.tests._replace(pairs=np.empty((0, 2), np.int64))
        return replace(self, checked=self.checked._replace(tests=tests))

    def without_still_pairs(self, standing: Mask | None = None) -> Prepared:
        """Return the same where pairs are tested only if a joint changes their distance.

        So one joint at least moves one of the two and not the other. standing (slots,): objects of
        the scene that nothing else moves either, None for all; pairs with others are tested.
        """
        count = len(self.world.slots)
        world = np.ones(count, np.bool_) if standing is None else standing[self.world.slots]
        key = world.tobytes()
        if not self._still or self._still[0][0] != key:
            tests, driven = self.checked.tests, self.own.moved
            one, other = (driven[tests.pairs[:, k]] for k in range(2))
            pairs = tests.pairs[(one != other).any(axis=1)]
            allowed = tests.allowed
            still = ~driven.any(axis=1)
            if still.any():
                room = np.zeros((tests.first, count), np.bool_)
                allowed = allowed.copy() if len(allowed) else room
                allowed[still] |= world
            changed = tests._replace(pairs=pairs, allowed=allowed)
            found = replace(self, checked=self.checked._replace(tests=changed))
            self._still[:] = [(key, found)]
        return self._still[0][1]

    def moving(self, accuracy: Accuracy) -> Held:
        """Return ``checked`` with what motions need."""
        if accuracy not in self._moving:
            tree, bodies, tests, *_ = self.checked
            boxes = bool(accuracy < Accuracy.HULL)
            chains = chains_of(tree, bodies, tests.pairs, tests.first, boxes)
            meshes = self.meshes & (accuracy == Accuracy.MESH)
            self._moving[accuracy] = hold(self.checked._replace(chains=chains, meshes=meshes))
        return self._moving[accuracy]

    def owners_of(self, bodies: Integers) -> Integers:
        """Return pairs of rows of ``names``, the smaller first, for pairs of bodies (m, 2)."""
        pairs = self.checked.owners[bodies]
        pairs.sort(axis=1)
        return pairs


class Model:
    """Robots with names for their links and joints, and what is attached to them."""

    def __init__(self, robots: Sequence[Robot], names: Sequence[str | None], bases: Floats) -> None:
        self.warns = True
        """Whether a check warns of a robot that nothing can collide with."""
        self.robots, self._names = tuple(robots), tuple(names)
        self.link_names = _prefixed(names, [robot.link_names for robot in robots])
        self.joint_names = _prefixed(names, [robot.joint_names for robot in robots])
        self.link_rows = {name: row for row, name in enumerate(self.link_names)}
        for parts in (self.link_names, self.joint_names):
            if len(set(parts)) < len(parts):
                raise ValueError(
                    "robots must have distinct names of links and joints; give a mapping from "
                    "names of robots, which come in front of them"
                )
        self.limits = JointLimits(robots)
        self._own: OwnBodies | None = None
        self._bare: set[int] = set()  # robots without bodies
        self._prepared: tuple[WorldState, Prepared] | None = None
        self._kept: Kept = {}
        self._chains: Floats = np.empty(0)
        self._offsets = np.full(len(robots), -1.0)  # allowed for from the origin to the roots
        self.origin = np.full(3, np.inf)
        self.set_bases(bases)
        self.paddings = self._grown = np.zeros(len(self.link_names))
        self.attached: dict[str, Attached] = {}
        self.link_objects: dict[str, tuple[str, ...]] = {}
        self._groups = rigid_groups(self.tree)
        self._allowed = allowed_links(robots, self._groups)

    def __getstate__(self) -> dict[str, Any]:
        """Return all but what is made of it and of the scene, when it is asked for."""
        return {**vars(self), "_own": None, "_prepared": None, "_kept": {}}

    @property
    def middle(self) -> Floats:
        """The state (joints,) of zeros, or what is next to them within the limits."""
        state = np.clip(np.zeros(len(self.joint_names)), self.limits.lower, self.limits.upper)
        state[self.tree.columns[self.tree.kinds == FLOATING] + 6] = 1.0
        return state

    def group_columns(self, group: str) -> list[int]:
        """Return the columns of a group's joints; KeyError for an unknown group."""
        names = [f"{name}/" if name is not None else "" for name in self._names]
        for prefix, robot in zip(names, self.robots, strict=True):
            for key, value in robot.groups.items():
                if prefix + key == group:
                    joints = {prefix + joint for joint in value.joints}
                    return [
                        column
                        for column, name in enumerate(self.joint_names)
                        if name in joints or name.rsplit("/", 1)[0] in joints
                    ]
        raise KeyError(f"group must be a group of the SRDF, got {shown(group)}")

    def set_bases(self, bases: Floats) -> None:
        """Set where the robots stand, by poses (r, 7); bodies are relative to a place nearby."""
        self.bases = bases
        if not (np.abs(bases[0, :3] - self.origin) <= NEAR).all():
            self.origin, self._prepared = bases[0, :3].copy(), None
        relative = bases.copy()
        relative[:, :3] -= self.origin
        self.tree = one_tree(self.robots, relative)
        if self._set_chains():
            self._forget()
        if self._prepared is not None:
            state, made = self._prepared
            checked = made.checked._replace(tree=self.tree)
            self._prepared = state, replace(made, checked=checked)

    def _set_chains(self) -> bool:
        """Set lengths of chains that are enough for the tree; return whether they have changed.

        A robot that moves gets room to move on.
        """
        offsets = np.abs(self.tree.translations[self.tree.parents < 0]).sum(axis=1)
        farther = offsets > self._offsets
        if not farther.any():
            return False
        room = 3.0 * NEAR if len(self._chains) else 0.0
        self._offsets[farther] = offsets[farther] + room
        lengths = chain_lengths(self.tree, self.limits.lower, self.limits.upper)
        counts = [len(robot.link_names) for robot in self.robots]
        self._chains = lengths + np.repeat(self._offsets - offsets, counts)
        return True

    def _forget(self) -> None:
        """Make the bodies of robots anew."""
        self._own = self._prepared = None

    def set_paddings(self, paddings: Floats) -> None:
        """Set by how much each link (links,) is grown."""
        self.paddings = paddings
        self._forget()

    def set_link_objects(self, names: dict[str, tuple[str, ...]]) -> None:
        """Set by link which objects of the scene are the link itself."""
        self.link_objects = names
        self._prepared = None

    def attach(self, name: str, attached: Attached) -> None:
        """Attach something, in place of what has its name."""
        body_of(attached.shape, attached.pose)  # it fails before anything has changed
        self.attached = {**self.attached, name: attached}
        self._forget()

    def detach(self, name: str) -> None:
        """Remove what is attached."""
        self.attached = {key: each for key, each in self.attached.items() if key != name}
        self._forget()

    def prepared(self, scene: Scene) -> Prepared:
        """Return the arguments of kernels for a scene as it is now."""
        last = self._prepared
        if last is None or not last[0].is_current(scene):
            state = WorldState(scene, self.left_out)
            last = self._prepared = state, self._made(scene)
        return last[1]

    @property
    def left_out(self) -> frozenset[str]:
        """The objects of the scene that are links, or attached."""
        attached = (name for name, each in self.attached.items() if each.of_scene)
        return frozenset(chain(attached, *self.link_objects.values()))

    def _own_bodies(self, scene: Scene) -> OwnBodies:
        """Return the bodies of links, grown as the objects that they are, and of the attached."""
        grown = self.paddings.copy()
        for link, names in self.link_objects.items():
            grown[self.link_rows[link]] += largest_padding(scene, names)
        if self._own is None or not np.array_equal(grown, self._grown):
            shapes = [shapes for robot in self.robots for shapes in robot.shapes]
            parts = [
                Part(shape, pose, link, float(grown[link]), link)
                for link, placed in enumerate(shapes)
                for shape, pose in placed
            ]
            attached = list(self.attached.values())
            for row, each in enumerate(attached, start=len(shapes)):
                padding = float(self.paddings[each.link]) + each.padding
                parts.append(Part(each.shape, each.pose, each.link, padding, row))
            self._look_for_bodies(parts)
            allowed = self._allowed_of(attached)
            self._grown, self._own = grown, OwnBodies.of(parts, allowed, self._chains, self.tree)
        return self._own

    def _look_for_bodies(self, parts: Sequence[Part]) -> None:
        """Warn, once each, of robots without bodies: they would be valid wherever they are."""
        of_links = np.repeat(range(len(self.robots)), [len(r.link_names) for r in self.robots])
        bare = {*range(len(self.robots))} - {int(of_links[part.link]) for part in parts}
        for row in sorted(bare - self._bare if self.warns else ()):
            name = self._names[row] or self.robots[row].name
            warn_caller(f"robot {shown(name)} collides with nothing: no link has a <collision>")
        self._bare |= bare

    def _allowed_of(self, attached: Sequence[Attached]) -> Mask:
        """Return the pairs not checked with rows for what is attached after those of the links."""
        links = [each.link for each in attached]
        groups = np.append(self._groups, self._groups[np.array(links, np.int64)])
        result = groups[:, None] == groups
        count = len(self._allowed)
        result[:count, :count] = self._allowed
        for row, each in enumerate(attached, start=count):
            touched = list(each.touch_links)
            result[row, touched] = result[touched, row] = True
        return result

    def _made(self, scene: Scene) -> Prepared:
        own = self._own_bodies(scene)
        world = world_of(scene, len(self.link_names), self.origin, self.left_out, self._kept)
        links = [*self.link_names, *self.attached]
        names, count, allowed = [*links, *world.names], len(links), own.allowed
        world_allowed = np.zeros((0, 0), np.bool_)
        counted = self._counted(scene, links, world.names)
        if counted is not None:
            allowed = allowed | ~counted[:, :count]
            world_allowed = np.ascontiguousarray(~counted[own.owners, count:])
        pairs, first, tree = body_pairs(own.owners, allowed), len(own.owners), world.tree
        tests = Tests(*own.links, pairs, world_allowed, first, tree.nodes, tree.starts, tree.order)
        bodies = joined([own.bodies, world.bodies])
        owners = np.concatenate([own.owners, np.arange(count, len(names)), [-1]])
        checked = Checked(self.tree, bodies, tests, owners, NO_CHAINS, np.empty(0, np.bool_))
        return Prepared(checked, own, world, self.limits, names, self.joint_names)

    def _counted(self, scene: Scene, links: list[str], objects: list[str]) -> Mask | None:
        """Return (links, links and objects) which pairs count by the rules of a scene.

        None: all of them. Any name of a link, of those that objects have that it is, will do.
        """
        known_as = [self.link_objects.get(link) or (link,) for link in links]
        names = [*chain.from_iterable(known_as), *objects]
        scene.rules.warn_of_unknown(names)
        rules = scene.rules.filter_of(names)
        if rules is None:
            return None
        count = sum(map(len, known_as))
        shape = count, count + len(objects)
        pairs = rules(*(each.ravel() for each in np.indices(shape))).reshape(shape)
        starts = np.cumsum([0, *map(len, known_as)])[:-1]
        pairs = np.logical_or.reduceat(pairs, starts, axis=0)
        among = np.logical_or.reduceat(pairs[:, :count], starts, axis=1)
        return np.hstack([among, pairs[:, count:]])


def _prefixed(names: Sequence[str | None], parts: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """Return the parts of all robots, each with the name of its robot in front, if it has one."""
    pairs = zip(names, parts, strict=True)
    return tuple(
        part if name is None else f"{name}/{part}" for name, each in pairs for part in each
    )
