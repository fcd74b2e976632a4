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

"""The self-filter of sensors: finds points inside robots and objects, as these were at a stamp.

Links of robots are objects, too, so one method serves both. The latest poses of an object are
stored, and its pose at the stamp is interpolated between two of them. An object is its box or,
above ``obb``, its hull, with its padding.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.boxes import Boxes, add_outwards
from obb_collision.geometry.poses import as_poses
from obb_collision.node.inputs.cuts import Points
from obb_collision.node.messages.conversions import NANOSECONDS, name_from_key
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.objects.frames import EXTRAPOLATION
from obb_collision.node.objects.objects import Objects
from obb_collision.node.objects.table import NO_TIME
from obb_collision.node.parameters.entries import Groups
from obb_collision.node.parameters.parameters import Parameters
from obb_collision.queries.convex.support import HULL_CORE, ConvexBodies
from obb_collision.queries.points.points import points_in_bodies
from obb_collision.queries.rays.hidden import add_hidden
from obb_collision.scene.building.shape_cache import BOX, CLOUD
from obb_collision.scene.refinement.bodies import box_bodies, convex_bodies
from obb_collision.scene.store.patterns import matching
from obb_collision.scene.store.placing import placed
from obb_collision.typing import Floats, Mask, Rows

REMEMBERED = 2 * NANOSECONDS
"""For how long (ns) poses are stored."""
MOST_REMEMBERED = 1000
"""Stored poses of an object, at most."""


class RobotParts(Protocol):
    """Finds the objects that are parts of a robot."""

    def __call__(self, name: str) -> tuple[Rows, int]:
        """Return the slots of links and attached objects, and up to when (ns) they are known.

        RefusedError while the robot is not known; NO_TIME where its state does not age.
        """
        ...


class LeftOut:
    """Finds points in what sources leave out, by its latest poses.

    words: returns the parameter ``leave_out`` of each source.
    """

    def __init__(
        self,
        objects: Objects,
        parameters: Parameters,
        robots: RobotParts,
        words: Callable[[], list[list[str]]],
    ) -> None:
        self._objects, self._parameters, self._robots = objects, parameters, robots
        self._words = words
        self._poses: dict[int, deque[tuple[int, Floats]]] = {}  # by serial, with their times
        self._matched: dict[tuple[str, ...], Rows] = {}
        self._basis: tuple[object, ...] = ()

    def place(self, now: int) -> None:
        """Place the objects that are left out by their newest states: points wait for these."""
        if any(self._words()):
            self._objects.placement.place(now)
            self.record()

    def clock_jumped(self, _: int) -> None:
        """Forget where everything was: stamps mean something else from now on."""
        self._poses.clear()

    def record(self) -> None:
        """Store the present poses of all objects that are left out."""
        lists = self._words()
        if not any(lists):
            self._poses.clear()
            return
        objects, table = self._objects, self._objects.table
        parts = [self._slots(words)[0] for words in lists if words]
        slots = np.unique(np.concatenate(parts))
        slots = slots[table.visible[slots]]
        times, serials = objects.staleness.known_since[slots], table.serial[slots].tolist()
        poses, kept = objects.scene.objects.poses_of(slots), {}
        for serial, time, pose in zip(serials, times.tolist(), poses, strict=True):
            states = kept[serial] = self._poses.get(serial) or deque(maxlen=MOST_REMEMBERED)
            if states and time <= states[-1][0]:
                states[-1] = states[-1][0], pose
                continue
            states.append((time, pose))
            while states[0][0] < time - REMEMBERED:
                states.popleft()
        self._poses = kept

    def inside(self, points: Points, words: Sequence[str], stamp: int, padding: float) -> Mask:
        """Return which points (n, 3), in the fixed frame, were inside what words mean at a stamp.

        stamp: ns, 0 for now. padding: metres. RefusedError ("extrapolation") where a robot's state
        at the stamp is not known.
        """
        result = np.zeros(len(points), np.bool_)
        for boxes, bodies in self._bodies(*self._at(words, stamp)):
            holders = points_in_bodies(boxes, bodies, points, padding, each_point=True).boxes
            assert holders is not None
            result |= holders >= 0
        return result

    def behind(
        self, points: Floats, words: Sequence[str], stamp: int, padding: float, sensor: Floats
    ) -> Mask:
        """Return which points (n, 3) what words mean hid from a sensor at (3,); see ``inside``."""
        result = np.zeros(len(points), np.bool_)
        for boxes, shapes in self._bodies(*self._at(words, stamp)):
            bodies = box_bodies(boxes, np.arange(len(boxes))) if shapes is None else shapes
            add_hidden(result, sensor, points, boxes, bodies, padding)
        return result

    def _slots(self, words: Sequence[str]) -> tuple[Rows, Rows, dict[str, bool]]:
        """Return all slots that words mean, those that patterns match, and the robots.

        Of each robot by name: whether all of it is meant, or only links that patterns match.
        """
        objects, parameters = self._objects, self._parameters
        basis = parameters.groups, parameters.robots, objects.table.ranks
        if not self._basis or any(a is not b for a, b in zip(basis, self._basis, strict=True)):
            self._basis, self._matched = basis, {}
        meant = Groups(parameters.groups, parameters.robots).all_meant(words)
        patterns = tuple(name for name in meant if name not in parameters.robots)
        robots = {name: True for name in meant if name in parameters.robots}
        if patterns not in self._matched:
            keys = list(objects.table.slots)
            rows = np.flatnonzero(matching(patterns, [name_from_key(key) for key in keys]))
            slots = np.array([objects.table.slots[keys[row]] for row in rows.tolist()], np.int64)
            kinds = objects.scene.objects.store.kinds
            self._matched[patterns] = slots[kinds[slots] != CLOUD]
        matched, parts = self._matched[patterns], []
        links = matched[objects.table.of_robot[matched]]
        own = {objects.table.key(slot)[0].partition("/")[0] for slot in links.tolist()}
        for name in parameters.robots:
            if name in own or any(pattern.startswith(f"{name}/") for pattern in patterns):
                robots.setdefault(name, False)
        for name, is_whole in robots.items():
            try:
                parts += [self._robots(name)[0]] if is_whole else []
            except RefusedError:
                continue
        return np.concatenate([matched, *parts]), matched, robots

    def _at(self, words: Sequence[str], stamp: int) -> tuple[Rows, Floats]:
        """Return slots (k,) and poses (k, 7) of what words mean, at a stamp."""
        _, matched, robots = self._slots(words)
        table, visible = self._objects.table, self._objects.table.visible
        of_robots = np.zeros(len(visible), np.bool_)
        parts = [matched[visible[matched]]]
        for name, is_whole in robots.items():
            slots, until = self._robots(name)
            if stamp and until < stamp:
                raise _unknown(name, stamp, until)
            of_robots[slots] = until != NO_TIME
            parts += [slots] if is_whole else []
        meant = np.unique(np.concatenate(parts))
        poses = np.empty((len(meant), 7))
        for row, slot in enumerate(meant.tolist()):
            known = self._poses.get(int(table.serial[slot]))
            first, last = (known[0][0], known[-1][0]) if known else (NO_TIME, 0)
            if not known or (stamp and of_robots[slot] and not first <= stamp <= last):
                raise _unknown(table.name(slot), stamp, last)
            poses[row] = between(known, stamp) if stamp else known[-1][1]
        return meant, poses

    def _bodies(self, slots: Rows, poses: Floats) -> Iterator[tuple[Boxes, ConvexBodies | None]]:
        """Yield boxes of objects at poses, with the convex bodies in them, None for mere boxes."""
        if len(slots) == 0:
            return
        store, cache = self._objects.scene.objects.store, self._objects.scene.objects.cache
        # without the growth of stale objects: points within it may be anything
        sizes = add_outwards(store.local_half_extents[slots], store.own_paddings[slots][:, None])
        columns = placed((store.local_centers[slots], store.local_rotations[slots], sizes), poses)
        boxes = Boxes.trusted(columns["centers"], columns["rotations"], sizes)
        shaped = (store.accuracies[slots] > Accuracy.OBB) & (store.kinds[slots] > BOX)
        rows = np.flatnonzero(shaped)
        cornered = rows[cache.cores(slots[rows])[:, 0] == HULL_CORE]
        shaped[cornered] = cache.build(store, slots[cornered], True, None)
        if not shaped.all():
            yield boxes[np.flatnonzero(~shaped)], None
        rows = np.flatnonzero(shaped)
        if len(rows):
            bodies = convex_bodies(store, cache, store.all_boxes(), slots[rows])
            centers, rotations = as_poses(poses[rows], warn=False)
            radii = bodies.radii - store.growths[slots[rows]]
            yield boxes[rows], replace(bodies, radii=radii, centers=centers, rotations=rotations)


def _unknown(name: str, stamp: int, until: int) -> RefusedError:
    """Return the error for a stamp without a known state; until: the last state's (ns), or 0."""
    if until == 0:
        return RefusedError(EXTRAPOLATION, f"{name}: no state is known")
    apart = (stamp - until) / NANOSECONDS
    side = "after" if apart >= 0.0 else "before"
    return RefusedError(EXTRAPOLATION, f"{name}: {abs(apart):.3f} s {side} its last state")


def between(states: Sequence[tuple[int, Floats]], time: int) -> Floats:
    """Return the pose (7,) at a time (ns), interpolated between states of rising times.

    Before the first and after the last state it is that of this state.
    """
    after = bisect_left(states, time, key=lambda state: state[0])
    if after == len(states) or after == 0:
        return states[max(0, after - 1)][1]
    (start, first), (end, last) = states[after - 1], states[after]
    share = (time - start) / (end - start)
    turned = last[3:] if first[3:] @ last[3:] >= 0.0 else -last[3:]
    quaternion = (1.0 - share) * first[3:] + share * turned
    return np.append(
        (1.0 - share) * first[:3] + share * last[:3], quaternion / np.linalg.norm(quaternion)
    )
