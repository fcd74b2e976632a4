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

"""What kernels need of robots and a scene, made anew only where it has changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.robots.bodies.bodies import merged
from obb_collision.robots.bodies.robot_arrays import (
    Attached,
    allowed_links,
    attached_body,
    body_pairs,
    chain_lengths,
    mimic_limits,
    one_tree,
    rigid_groups,
    with_attached,
)
from obb_collision.robots.bodies.state_arrays import Bodies, Tests
from obb_collision.robots.bodies.world import Kept, World, WorldState, world_of
from obb_collision.robots.checks.mesh_bodies import MeshBodies
from obb_collision.robots.checks.motions import joint_reaches
from obb_collision.robots.checks.own_bodies import OwnBodies, mesh_bodies, own_bodies
from obb_collision.robots.description.robot import Robot
from obb_collision.robots.kinematics.kinematics import FIXED, FLOATING, PRISMATIC, Tree
from obb_collision.scene.scene import Scene
from obb_collision.scene.store.allowed import AllowedPairs
from obb_collision.scene.store.pair_table import PairFilter
from obb_collision.typing import Floats, Integers, Mask, Rows

#: Metres along each axis within which the first robot moves without the world, which is relative
#: to where that robot was, being placed again; farther away roundings would grow.
NEAR = 2.0
#: Quaternions whose sum is shorter are opposite: between them, motions have no certain speed.
OPPOSITE = 1e-6


@dataclass(frozen=True, eq=False)
class Arrays:
    """What kernels take, and the names of what bodies belong to."""

    tree: Tree
    bodies: Bodies
    tests: Tests
    world: World
    names: list[str]
    owners: Rows
    """(b + 1,) the row in names of each body, and -1 for none."""

    def owners_of(self, bodies: Integers) -> Integers:
        """Return pairs of rows of ``names``, the smaller first, for pairs of bodies (m, 2)."""
        return np.sort(self.owners[bodies], axis=1)


class Model:
    """Robots with names for their links and joints, and what is attached to them."""

    def __init__(self, robots: Sequence[Robot], names: Sequence[str | None], bases: Floats) -> None:
        self.robots = tuple(robots)
        self.link_names = prefixed(names, [robot.link_names for robot in robots])
        self.joint_names = prefixed(names, [robot.joint_names for robot in robots])
        self.link_rows = {name: row for row, name in enumerate(self.link_names)}
        if len(self.link_rows) < len(self.link_names) or len(set(self.joint_names)) < len(
            self.joint_names
        ):
            raise ValueError(
                "robots must have distinct names of links and joints; give a mapping from names of "
                "robots, which come in front of them"
            )
        self.lower = np.concatenate([robot.lower for robot in robots])
        self.upper = np.concatenate([robot.upper for robot in robots])
        self._mimics = mimic_limits(robots)
        self._bodies: OwnBodies | None = None
        self._meshes: MeshBodies | None = None
        self._arrays: tuple[WorldState, Arrays] | None = None
        self._kept: Kept = {}
        self._chains: Floats = np.empty(0)
        self._offsets = np.full(len(robots), -1.0)  # allowed for from the origin to the roots
        self.origin = np.full(3, np.inf)
        self.set_bases(bases)
        self.paddings = self._grown = np.zeros(len(self.link_names))
        self.attached: dict[str, Attached] = {}
        self.link_objects: dict[str, tuple[str, ...]] = {}
        self._groups, self._allowed = (
            rigid_groups(self.tree),
            allowed_links(robots, rigid_groups(self.tree)),
        )
        self._quaternions = [int(c) for c in self.tree.columns[self.tree.kinds == FLOATING]]

    def set_bases(self, bases: Floats) -> None:
        """Set where the robots stand, by poses (r, 7); bodies are relative to a place nearby."""
        self.bases = bases
        if not (np.abs(bases[0, :3] - self.origin) <= NEAR).all():
            self.origin, self._arrays = bases[0, :3].copy(), None
        relative = bases.copy()
        relative[:, :3] -= self.origin
        self.tree = one_tree(self.robots, relative)
        if self._set_chains():
            self._bodies = self._arrays = None
        if self._arrays is not None:
            state, arrays = self._arrays
            self._arrays = state, replace(arrays, tree=self.tree)

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
        lengths = chain_lengths(self.tree, self.lower, self.upper)
        counts = [len(robot.link_names) for robot in self.robots]
        self._chains = lengths + np.repeat(self._offsets - offsets, counts)
        return True

    def set_paddings(self, paddings: Floats) -> None:
        """Set by how much each link (links,) is grown."""
        self.paddings = paddings
        self._bodies = self._arrays = self._meshes = None

    def set_link_objects(self, names: dict[str, tuple[str, ...]]) -> None:
        """Set by link which objects of the scene are the link itself."""
        self.link_objects = names
        self._arrays = None

    def attach(self, name: str, attached: Attached) -> None:
        """Attach something, in place of what has its name."""
        attached_body(attached, self._chains, 0.0)  # it fails before anything has changed
        self.attached = {**self.attached, name: attached}
        self._bodies = self._arrays = self._meshes = None

    def detach(self, name: str) -> None:
        """Remove what is attached."""
        self.attached = {key: each for key, each in self.attached.items() if key != name}
        self._bodies = self._arrays = self._meshes = None

    def check_quaternions(self, states: Floats, name: str) -> None:
        """Raise ValueError for a floating joint whose quaternion is zero."""
        for column in self._quaternions:
            zero = np.flatnonzero(~states[:, column + 3 : column + 7].any(axis=1))
            if len(zero):
                raise ValueError(f"{name} must have no quaternion of zeros, row {zero[0]}")

    def check_turns(self, starts: Floats, ends: Floats) -> None:
        """Raise ValueError where a quaternion would move through zero."""
        for column in self._quaternions:
            turns = [states[:, column + 3 : column + 7] for states in (starts, ends)]
            units = [turn / np.linalg.norm(turn, axis=1, keepdims=True) for turn in turns]
            opposite = np.flatnonzero(np.linalg.norm(units[0] + units[1], axis=1) < OPPOSITE)
            if len(opposite):
                raise ValueError(
                    "ends must not have quaternions opposite to those of starts: which way to turn "
                    f"is not clear, row {opposite[0]}"
                )

    def out_of_limits(self, states: Floats) -> Mask:
        """Return (n, joints) which joints are out of their limits, or drive one that is."""
        out = np.asarray((states < self.lower) | (states > self.upper))
        columns, multipliers, offsets, lower, upper = self._mimics
        for n, column in enumerate(columns.astype(np.int64).tolist()):
            moved = multipliers[n] * states[:, column]
            room = 4.0 * ROUNDOFF * (np.abs(moved) + abs(offsets[n]))
            value = moved + offsets[n]
            out[:, column] |= (value < lower[n] - room) | (value > upper[n] + room)
        return out

    def joint_reaches(self, arrays: Arrays, starts: Floats, ends: Floats) -> Floats:
        """Return how far each body can be from each joint during motions, as ``Speeds`` has it."""
        moved = np.zeros(len(self.lower))
        for states in (starts, ends):
            moved = np.maximum(moved, np.abs(states).max(axis=0, initial=0.0))
        count = arrays.tests.first
        bodies = arrays.bodies
        extents = np.linalg.norm(bodies.centers[:count], axis=1) + bodies.spheres[:count]
        return joint_reaches(self.tree, bodies.frames[:count], extents, moved)

    def displacements(self, arrays: Arrays, states: Floats, deviations: Floats) -> Floats:
        """Return (n,) how far any point of a body moves at most if joints do by deviations (n, j).

        states (m, joints): between which joints are; no joint may be planar or floating.
        """
        reaches, tree = self.joint_reaches(arrays, states, states), self.tree
        moved = np.zeros((len(deviations), len(reaches)))
        for link, (kind, column) in enumerate(zip(tree.kinds, tree.columns, strict=True)):
            if kind == FIXED:
                continue
            by = np.abs(tree.multipliers[link] * deviations[:, column])[:, None]
            reach = np.where(kind == PRISMATIC, 1.0, reaches[:, link])
            moved += np.where(reaches[:, link] >= 0.0, by * reach, 0.0)
        largest: Floats = moved.max(axis=1, initial=0.0) * (1.0 + 1e-9)
        return largest

    def arrays(self, scene: Scene) -> Arrays:
        """Return what kernels take, for a scene as it is now."""
        last = self._arrays
        if last is None or not last[0].is_current(scene):
            state = WorldState(scene, self.left_out)
            last = self._arrays = state, self._made(scene)
        return last[1]

    @property
    def left_out(self) -> frozenset[str]:
        """The objects of the scene that are links, or attached."""
        links = (name for names in self.link_objects.values() for name in names)
        return frozenset(links) | {name for name, each in self.attached.items() if each.of_scene}

    def _paddings_in(self, scene: Scene) -> Floats:
        """Return by how much each link is grown with what the objects that it is are padded by."""
        store, paddings = scene._store, self.paddings.copy()
        for link, names in self.link_objects.items():
            slots = [store.slots[name] for name in names if name in store.slots]
            paddings[self.link_rows[link]] += store.own_paddings[slots].max(initial=0.0)
        return paddings

    def _made(self, scene: Scene) -> Arrays:
        grown = self._paddings_in(scene)
        if not np.array_equal(grown, self._grown):
            self._grown, self._bodies, self._meshes = grown, None, None
        if self._bodies is None:
            attached = list(self.attached.values())
            self._bodies = own_bodies(
                self.robots, self._grown, attached, self.paddings, self._chains
            )
        of_links = self._bodies
        own, owners = of_links.bodies, of_links.owners
        frame = len(self.link_names)
        world = world_of(scene._store, scene._cache, frame, self.origin, self.left_out, self._kept)
        links = [*self.link_names, *self.attached]
        objects = [str(scene._store.names[slot]) for slot in world.slots]
        names = [*links, *objects]
        allowed = with_attached(self._allowed, self._groups, list(self.attached.values()))
        world_allowed = np.zeros((0, 0), np.bool_)
        known_as = [self.link_objects.get(link) or (link,) for link in links]
        count = sum(map(len, known_as))
        counted = _rules(scene, [*(name for each in known_as for name in each), *objects])
        if counted is not None:
            rows, columns = (each.ravel() for each in np.indices((count, count + len(objects))))
            starts = np.cumsum([0, *map(len, known_as)])[:-1]
            pairs = counted(rows, columns).reshape(count, count + len(objects))
            pairs = np.logical_or.reduceat(pairs, starts, axis=0)  # any name of a link will do
            allowed = allowed | ~np.logical_or.reduceat(pairs[:, :count], starts, axis=1)
            world_allowed = ~pairs[owners, count:]
        tests = Tests(
            of_links.links, of_links.starts, of_links.centers, of_links.spheres,
            body_pairs(owners, allowed), np.ascontiguousarray(world_allowed), len(owners),
            world.tree.nodes, world.tree.starts, world.tree.order,
        )  # fmt: skip
        all_owners = np.concatenate([owners, np.arange(len(links), len(names)), [-1]])
        return Arrays(self.tree, merged(own, world.bodies), tests, world, names, all_owners)

    def mesh_bodies(self) -> MeshBodies:
        """Return the bodies of robots as meshes, in the same order."""
        if self._meshes is None:
            self._meshes = mesh_bodies(
                self.robots, self._grown, list(self.attached.values()), self.paddings
            )
        return self._meshes


def prefixed(names: Sequence[str | None], parts: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """Return the parts of all robots, each with the name of its robot in front, if it has one."""
    pairs = zip(names, parts, strict=True)
    return tuple(
        part if name is None else f"{name}/{part}" for name, each in pairs for part in each
    )


def _rules(scene: Scene, names: list[str]) -> PairFilter | None:
    """Return which pairs of names count by the rules of a scene, None for all."""
    rules = AllowedPairs()
    rules.replace(AllowedPairs.of(scene.allowed))
    rules.only, rules.within = scene.check_only, scene.allowed_within
    return rules.pair_filter(names, 0)
