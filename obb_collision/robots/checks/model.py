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

"""The model of a ``RobotScene``: robots and scene as arrays for kernels, updated on changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from obb_collision._jit import Held, hold
from obb_collision.accuracy import Accuracy
from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.poses import IDENTITY_POSE, as_poses, compose_poses, rotate_vectors
from obb_collision.geometry.trees.pool import Hulls
from obb_collision.geometry.validation import warn_caller
from obb_collision.obb import OBB
from obb_collision.queries.convex.support import HULL_CORE, ConvexBodies
from obb_collision.robots.checks.arrays import (
    NO_CHAINS,
    Checked,
    JointLimits,
    LinkBodies,
    PairValues,
    Tests,
    allowed_links,
    body_pairs,
    chain_lengths,
    chains_of,
    next_joint,
    one_tree,
    rigid_groups,
)
from obb_collision.robots.checks.balls import bodies_at
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
from obb_collision.robots.kinematics.kinematics import FIXED, FLOATING, PRISMATIC, Tree, link_poses
from obb_collision.scene.building.shape_cache import TRIANGLES, kind_of
from obb_collision.scene.scene import Scene
from obb_collision.shapes import Shape, Sphere
from obb_collision.typing import Floats, Integers, Mask, Rows
from obb_collision.words import shown

if TYPE_CHECKING:
    from obb_collision.robots.robot import Robot

#: Metres along each axis by which the base of the first robot may move before the origin of bodies
#: moves, too: far from the origin, roundings grow.
NEAR = 2.0
#: Metres, and radians, by which the axis of a body may differ from that of its joint: descriptions
#: round angles, as 1.5708.
COAXIAL = 1e-5


@dataclass(frozen=True, eq=False)
class Attached:
    """An object attached to a link at a pose in its frame, and the links that it may touch.

    of_scene: it is an object of the scene, which is not an obstacle meanwhile.
    """

    shape: Shape | OBB
    link: int
    pose: Floats
    touch_links: frozenset[int]
    padding: float
    of_scene: bool = False


@dataclass(frozen=True, eq=False)
class OwnBodies:
    """The bodies of robots, sorted by link, and the row of names of each."""

    parts: list[Part]
    bodies: LinkBodies
    owners: Rows
    allowed: Mask
    """(links and attached objects, the same): pairs that are not checked."""
    tree: Tree

    @classmethod
    def of(cls, parts: list[Part], allowed: Mask, chains: Floats, tree: Tree) -> OwnBodies:
        """Return the bodies of parts; chains (links,): the lengths of the chains to links."""
        parts = sorted(parts, key=lambda part: part.link)
        bodies = [
            body_of(part.shape, part.pose, part.link, part.padding, float(chains[part.link]))
            for part in parts
        ]
        owners = np.array([part.owner for part in parts], np.int64)
        return cls(parts, joined(bodies), owners, allowed, tree)

    @cached_property
    def driven(self) -> Mask:
        """(links + 1, links) whether the joint of a link moves a frame; the world is the last.

        Fixed joints, and joints with multiplier zero, move nothing.
        """
        tree, count = self.tree, len(self.tree.parents)
        moving = (tree.kinds != FIXED) & (tree.multipliers != 0.0)
        driven = np.zeros((count + 1, count), np.bool_)
        for link, parent in enumerate(tree.parents.tolist()):
            if parent >= 0:
                driven[link] = driven[parent]
            driven[link, link] = moving[link]
        return driven

    @cached_property
    def moved(self) -> Mask:
        """(b, links) which joints move a body; turning a round body about its axis does not."""
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
        """Return whether the axis of a joint is that of a body, which is round about its z axis."""
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
        """The bodies as meshes."""
        return LinkMeshes(self.parts)

    def placed(self, state: Floats, origin: Floats) -> tuple[Boxes, ConvexBodies]:
        """Return the boxes and hulls of the bodies in a state (joints,); origin: of bodies (3,)."""
        bodies, count = self.bodies, len(self.bodies.frames)
        poses = link_poses(self.tree, np.ascontiguousarray(state[None]))[0]
        positions, turns = as_poses(poses[bodies.frames], warn=False)
        positions += origin
        centers = positions + np.einsum("nij,nj->ni", turns, bodies.centers)
        boxes = Boxes.trusted(centers, turns @ bodies.rotations, bodies.half_extents)
        cores = np.full(count, HULL_CORE, np.int8), np.zeros((count, 4)), bodies.rounds
        hulls = Hulls(bodies.blocks, bodies.starts, bodies.radii), np.arange(count)
        return boxes, ConvexBodies(*cores, *hulls, positions, turns)

    @cached_property
    def links(self) -> tuple[Rows, Rows, Floats, Floats]:
        """``links``, ``starts``, ``centers`` and ``spheres`` of ``Tests``."""
        links, starts = np.unique(self.bodies.frames, return_index=True)
        starts = np.append(starts, len(self.parts)).astype(np.int64)
        return links, starts, *enclosing_spheres(self.bodies, starts)


@dataclass(frozen=True, eq=False)
class Prepared:
    """Robots and scene as kernels take them, and the names of links and objects."""

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
        """Distances of zero, for checks: bodies must touch to collide."""
        return self.within(np.zeros(1))

    def within(self, reach: Floats) -> PairValues:
        """Return the same distance for all pairs, by state (k,), or one for all states."""
        ends = self.checked.tests.first, len(self.checked.tests.pairs)
        return PairValues(*(np.repeat(reach[:, None], end, axis=1) for end in ends))

    @cached_property
    def meshes(self) -> Mask:
        """(b,) which bodies are meshes; their pairs need more than hulls to be decided."""
        own = [kind_of(part.shape) for part in self.own.parts]
        return np.append(np.array(own, np.int64), self.world.kinds) == TRIANGLES

    @cached_property
    def excess(self) -> Floats:
        """(b + 1,) the excess of each body, see ``LinkBodies``; the last is 0, for no body."""
        return np.append(self.checked.bodies.excess, 0.0)

    @cached_property
    def held(self) -> Held:
        """``checked`` in the form that kernels take."""
        return hold(self.checked)

    @cached_property
    def without_self_pairs(self) -> Prepared:
        """A copy that tests only pairs with the world."""
        tests = self.checked.tests._replace(pairs=np.empty((0, 2), np.int64))
        return replace(self, checked=self.checked._replace(tests=tests))

    def without_still_pairs(self, standing: Mask | None = None) -> Prepared:
        """Return a copy that tests pairs only if a joint moves one of the two and not the other.

        standing (slots,): objects of the scene at rest, None for all; pairs with other objects are
        always tested.
        """
        count = len(self.world.slots)
        world = np.ones(count, np.bool_) if standing is None else standing[self.world.slots]
        key = world.tobytes()
        if not self._still or self._still[0][0] != key:
            tests, driven = self.checked.tests, self.own.moved
            first, second = (driven[tests.pairs[:, k]] for k in range(2))
            pairs = tests.pairs[(first != second).any(axis=1)]
            allowed = tests.allowed
            still = ~driven.any(axis=1)
            if still.any():
                room = np.zeros((tests.first, count), np.bool_)
                allowed = allowed.copy() if len(allowed) else room
                allowed[still] |= world
            changed = tests._replace(pairs=pairs, allowed=allowed)
            self._still[:] = [(key, replace(self, checked=self.checked._replace(tests=changed)))]
        return self._still[0][1]

    def moving(self, accuracy: Accuracy) -> Held:
        """Return ``checked`` with chains and meshes, as motions need it."""
        if accuracy not in self._moving:
            tree, bodies, _, tests, *_ = self.checked
            boxes = bool(accuracy < Accuracy.HULL)
            chains = chains_of(tree, bodies, tests.pairs, tests.first, boxes)
            meshes = self.meshes & (accuracy == Accuracy.MESH)
            self._moving[accuracy] = hold(self.checked._replace(chains=chains, meshes=meshes))
        return self._moving[accuracy]

    def owners_of(self, bodies: Integers) -> Integers:
        """Return the rows of ``names`` of pairs of bodies (m, 2), the smaller first."""
        pairs = self.checked.owners[self.bodies_at(bodies)]
        pairs.sort(axis=1)
        return pairs

    def bodies_at(self, numbers: Integers) -> Integers:
        """Return the bodies of numbers in pairs (m, 2), which may be balls of clouds."""
        return bodies_at(self.checked.clouds, len(self.checked.bodies.frames), numbers)


class Model:
    """Robots with unique names of links and joints, and the objects attached to them."""

    def __init__(self, robots: Sequence[Robot], names: Sequence[str | None], bases: Floats) -> None:
        self.warns = True
        """Whether a check warns of a robot without collision geometry."""
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
        self._offsets = np.full(len(robots), -1.0)  # from the origin to the roots, within _chains
        self.origin = np.full(3, np.inf)
        self.set_bases(bases)
        self.paddings = self._grown = np.zeros(len(self.link_names))
        self.attached: dict[str, Attached] = {}
        self.link_objects: dict[str, tuple[str, ...]] = {}
        self._groups = rigid_groups(self.tree)
        self._allowed = allowed_links(robots, self._groups)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without arrays that are made again on demand."""
        return {**vars(self), "_own": None, "_prepared": None, "_kept": {}}

    @property
    def middle(self) -> Floats:
        """The state (joints,) of zeros, or of the limits nearest to zero."""
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
        """Set the poses (r, 7) of the root links; bodies are relative to an origin nearby."""
        self.bases = bases
        if not (np.abs(bases[0, :3] - self.origin) <= NEAR).all():
            self.origin, self._prepared = bases[0, :3].copy(), None
        relative = bases.copy()
        relative[:, :3] -= self.origin
        self.tree = one_tree(self.robots, relative)
        if self._set_chains():
            self._own = self._prepared = None
        if self._prepared is not None:
            state, made = self._prepared
            checked = made.checked._replace(tree=self.tree)
            self._prepared = state, replace(made, checked=checked)

    def _set_chains(self) -> bool:
        """Set lengths of chains that suffice for the tree; return whether they have changed.

        The lengths of a robot whose base moves have room for more motion.
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

    def set_paddings(self, paddings: Floats) -> None:
        """Set the padding of each link (links,), m."""
        self.paddings = paddings
        self._own = self._prepared = None

    def set_link_objects(self, names: dict[str, tuple[str, ...]]) -> None:
        """Set the objects of the scene that stand for links, by link."""
        self.link_objects = names
        self._prepared = None

    def attach(self, name: str, attached: Attached) -> None:
        """Attach an object, or replace the one of this name."""
        body_of(attached.shape, attached.pose)  # it fails before anything has changed
        self.attached = {**self.attached, name: attached}
        self._own = self._prepared = None

    def detach(self, name: str) -> None:
        """Remove an attached object."""
        self.attached = {key: value for key, value in self.attached.items() if key != name}
        self._own = self._prepared = None

    def prepared(self, scene: Scene) -> Prepared:
        """Return the arguments of kernels for a scene as it is now."""
        last = self._prepared
        if last is None or not last[0].is_current(scene):
            state = WorldState(scene, self.left_out)
            last = self._prepared = state, self._made(scene)
        return last[1]

    @property
    def left_out(self) -> frozenset[str]:
        """The objects of the scene that are not obstacles: they are links, or attached."""
        names = (name for name, attached in self.attached.items() if attached.of_scene)
        return frozenset(chain(names, *self.link_objects.values()))

    def _own_bodies(self, scene: Scene) -> OwnBodies:
        """Return the bodies of links, with paddings of their objects, and of attached objects."""
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
            for row, obj in enumerate(attached, start=len(shapes)):
                padding = float(self.paddings[obj.link]) + obj.padding
                parts.append(Part(obj.shape, obj.pose, obj.link, padding, row))
            self._warn_of_bare_robots(parts)
            allowed = self._allowed_of(attached)
            self._grown, self._own = grown, OwnBodies.of(parts, allowed, self._chains, self.tree)
        return self._own

    def _warn_of_bare_robots(self, parts: Sequence[Part]) -> None:
        """Warn, once each, of robots without bodies: all their states are valid."""
        of_links = np.repeat(range(len(self.robots)), [len(r.link_names) for r in self.robots])
        bare = {*range(len(self.robots))} - {int(of_links[part.link]) for part in parts}
        for row in sorted(bare - self._bare if self.warns else ()):
            name = self._names[row] or self.robots[row].name
            warn_caller(f"robot {shown(name)} collides with nothing: no link has a <collision>")
        self._bare |= bare

    def _allowed_of(self, attached: Sequence[Attached]) -> Mask:
        """Return the pairs of links and attached objects that are not checked."""
        links = [obj.link for obj in attached]
        groups = np.append(self._groups, self._groups[np.array(links, np.int64)])
        result = groups[:, None] == groups
        count = len(self._allowed)
        result[:count, :count] = self._allowed
        for row, obj in enumerate(attached, start=count):
            touched = list(obj.touch_links)
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
        clouds = world.clouds._replace(bodies=world.clouds.bodies + first)
        no_meshes = np.empty(0, np.bool_)
        checked = Checked(self.tree, bodies, clouds, tests, owners, NO_CHAINS, no_meshes)
        return Prepared(checked, own, world, self.limits, names, self.joint_names)

    def _counted(self, scene: Scene, links: list[str], objects: list[str]) -> Mask | None:
        """Return (links, links and objects) which pairs count by a scene's rules, None for all.

        A link that objects stand for has their names; one of them that counts is enough.
        """
        link_names = [self.link_objects.get(link) or (link,) for link in links]
        names = [*chain.from_iterable(link_names), *objects]
        scene.rules.warn_of_unknown(names)
        rules = scene.rules.filter_of(names)
        if rules is None:
            return None
        count = sum(map(len, link_names))
        shape = count, count + len(objects)
        pairs = rules(*(rows.ravel() for rows in np.indices(shape))).reshape(shape)
        starts = np.cumsum([0, *map(len, link_names)])[:-1]
        pairs = np.logical_or.reduceat(pairs, starts, axis=0)
        among = np.logical_or.reduceat(pairs[:, :count], starts, axis=1)
        return np.hstack([among, pairs[:, count:]])


def _prefixed(names: Sequence[str | None], parts: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """Return the parts of all robots, as ``ROBOT/PART`` where robots have names."""
    prefixes = ["" if name is None else f"{name}/" for name in names]
    return tuple(p + part for p, own in zip(prefixes, parts, strict=True) for part in own)
