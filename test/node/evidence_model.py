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

"""What can be known of a scene by all that was said of it: slow, with no code of the node."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatch
from itertools import combinations
from math import inf, isnan, nan
from typing import Any

ORDER = (
    *("starting", "inactive", "disabled", "internal_error", "blocked", "overload"),
    *("clock_stopped", "two_publishers", "no_objects", "required_missing", "input_silent"),
    *("input_unreadable", "messages_lost", "unknown_objects", "shape_building"),
    *("unplaced", "refused", "late_frame", "stale", "robot_unknown", "joint_unknown"),
    "base_unknown",
)
ARM, LINKS, EDGE = "arm", ("arm/base/0", "arm/hand/0"), 0.23
"""The robot, its links, and the edge of the first one: the other is moved by joints along x. With
this edge nothing just touches."""
OLD, DEAD = "stale: old stamp", "stale: dead transform"
ONE, HALF = "input_unreadable: one of two", "collides, and not all is known"
TWIN, TURNS, TWO = "two_publishers: of status", "two_publishers: of sets", "free: two senders"
KINDS = OLD, DEAD, ONE, HALF, TWIN, TURNS, TWO
"""What is known in ways that are worth counting."""
CHANGES = "objects", "object_transform"
TIMEOUT = "object_timeout"
Sender = tuple[str, int]
"""A topic, and which of its publishers."""
NOBODY = "", 0
Rows = list[tuple[str, float, float, str]]
OFFSET, WAIT, LONGEST_WAIT = 0.7, 0.2, 10.0
"""Where odom is, and for how long (s) states wait for it."""
REORDERED, MEMORY, AHEAD = 1.0, 1.0, 0.5
"""Age (s) of a state up to which an older one is late, and of one that names an unknown object;
and how far ahead a stamp is believed."""
SPEED, REACH = 0.37, 1.0


@dataclass
class Thing:
    """An object: what was said of it, and what of that could be used.

    sender, maker: of its latest state and marker; awaited: the size that is being built; shaped:
    whether it has one; seen: by a cycle; serial: of the node's, when it was last looked at;
    carried: when the transform was true that placed it, if that was the latest; told: its last
    speed; speed: that when it became stale; locked: its x in odom, if it follows that; is_alone:
    that alone has an age.
    """

    size: float
    of_set: bool = False
    expiry: float = inf
    sender: Sender = NOBODY
    maker: Sender = NOBODY
    x: float | None = None
    at: float = 0.0
    stamp: float = 0.0
    carried: float = inf
    locked: float | None = None
    is_alone: bool = False
    told: float = 0.0
    speed: float = 0.0
    states: list[tuple[float, str, float, float, float]] = field(default_factory=list)
    received: float = 0.0
    order: float = 0.0
    repeated: bool = False
    bad_pose: bool = False
    bad_shape: bool = False
    overtaken: bool = False
    held_back: bool = False
    late: bool = False
    stale: bool = False
    awaited: float | None = None
    shaped: bool = True
    is_mesh: bool = False
    seen: bool = False
    serial: int = -1

    @property
    def is_building(self) -> bool:
        return self.awaited is not None or not self.shaped

    def since(self, by_stamp: bool) -> float:
        if self.is_alone:
            return self.carried
        return min(self.at, self.carried, self.stamp if by_stamp and self.stamp else inf)

    def jump(self, by: float, by_stamp: bool) -> None:
        if by_stamp and self.stamp:
            self.carried = min(self.carried, self.stamp)
        for name in ("at", "received", "expiry", "carried"):
            setattr(self, name, getattr(self, name) + by)
        self.stamp = self.order = 0.0
        self.states = [(x, frame, s, at + by, c + by) for x, frame, s, at, c in self.states]


@dataclass
class Joint:
    """A joint, or the base: what came last of it; NaN: nothing."""

    x: float = nan
    stamp: float = 0.0
    at: float = -inf
    since: float = -inf
    frame: str = "map"
    bad: bool = False
    repeated: bool = False
    overdue: float = inf
    sender: Sender = NOBODY

    def after(
        self,
        x: float,
        stamp: float,
        now: float,
        fault: str,
        by_stamp: bool,
        sender: Sender,
        frame: str = "map",
    ) -> Joint:
        late = 0 < stamp < self.stamp and now - self.at <= REORDERED
        if fault or (isnan(x) and not late):
            return replace(self, bad=True)
        if late:
            return replace(self, overdue=self.at + REORDERED / 2)
        believed = stamp if stamp <= now + AHEAD else 0.0
        since = min(now, believed) if by_stamp and believed else now
        return Joint(x, believed, now, since, frame, repeated=not isnan(self.x), sender=sender)

    def is_unknown(self, now: float, limit: float) -> bool:
        return isnan(self.x) or self.bad or self.overdue < now or 0.0 < limit < now - self.since

    def jump(self, by: float, _: bool) -> None:
        self.stamp, self.at, self.since, self.overdue = 0.0, self.at + by, self.since + by, inf


@dataclass
class Robot:
    """Two links, where the base is and beyond two joints. edge: of the second, 0: not described."""

    edge: float = 0.0
    refused: bool = False
    base: Joint = field(default_factory=Joint)
    changed: bool = False

    def __post_init__(self) -> None:
        self.renew()

    def renew(self) -> None:
        """Make links whose joints are not known."""
        self.joints, self.changed = [Joint(), Joint()], True
        sizes = (EDGE, self.edge) if self.edge else ()
        self.links = {name: Thing(size) for name, size in zip(LINKS, sizes, strict=False)}

    def faults(self, now: float, given: dict[str, Any]) -> set[str]:
        """Return what is not known when links are placed."""
        if self.refused or not self.links:
            return {"robot_unknown"}
        limit = self.limit(given) if self.base.repeated else self.limit(given | {TIMEOUT: 0.0})
        found = {"base_unknown"} if self.base.is_unknown(now, limit) else set()
        if any(joint.is_unknown(now, given["joint_timeout"]) for joint in self.joints):
            found.add("joint_unknown")
        return found

    @staticmethod
    def limit(given: dict[str, Any]) -> float:
        own = last(given["object_timeout_overrides"], ARM)
        return float(given[TIMEOUT] if own is None else own)

    def codes(self, now: float, given: dict[str, Any], latest: Callable[[], float]) -> set[str]:
        found = self.faults(now, given)
        if self.links and not isnan(self.base.x):
            is_lost = self.base.frame == "lost"
            if self.base.frame == "odom":
                since = latest()  # in any case: it takes note of when it was seen
                is_lost = 0.0 < self.limit(given) < now - since
            found |= {"base_unknown"} if is_lost else set()
        return found


class Model:
    """What can be known. until: up to when odom is; steady: seconds, by which inputs are silent."""

    def __init__(self, now: float, steady: float, until: float, robot: Robot | None) -> None:
        self.now, self.steady, self.until, self.robot = now, steady, until, robot
        self.active = self.enabled = True
        self.activated = steady
        self.failed = self.broken = self.overloaded = False
        self.built: set[float] = set()
        self.delivers = ""
        self.deleting: list[str] = []
        self.removed: dict[str, Thing] = {}
        self.things: dict[str, Thing] = {}
        self.newcomers: dict[tuple[str, bool], float] = {}
        """When refused ones expire, by name and whether a set named them."""
        self.unknown: dict[str, float] = {}
        self.deleted: dict[str, float] = {}
        self.sender = NOBODY
        self.unreadable: set[Sender] = set()
        self.gone: set[Sender] = set()
        self.missed: dict[str, float] = {}
        self.heard: dict[str, float] = {}
        self.sets: list[tuple[str, float, float, Rows, Sender]] = []
        self.orders: dict[Sender, tuple[float, float]] = {}
        self.taking_turns = self.has_twin = False
        self.speakers: dict[str, list[Sender]] = {}  # by topic, the last one last
        self.declared = False
        self.ignored: list[str] = []
        self.by_stamp = True
        self.ticked = steady
        self.seen = 0.0, 0.0  # the latest transform of odom, and since when it is it
        self.pairs: list[tuple[Thing, Thing]] = []

    def declare(self) -> None:
        self.declared = not self.things and not self.newcomers

    def see(self) -> None:
        self.declared &= not self.things and not self.newcomers

    def hear(self, topic: str, number: int, lost: bool) -> None:
        """Take note of who sends the next message, and of whether some are lost before it."""
        self.sender = topic, number
        self.heard[topic] = self.steady
        known = self.speakers.get(topic, [])
        self.speakers[topic] = [*(one for one in known if one != self.sender), self.sender]
        self.gone.discard(self.sender)
        self.unreadable.discard(self.sender)
        if lost and topic in CHANGES:
            self.missed[topic] = self.now

    def look(self) -> None:
        """Forget senders that are gone and of which nothing is left, and losses made good."""
        for one in self.unreadable & self.gone:
            things = (t for t in self.things.values() if not t.stale)
            of_things = (sender for thing in things for sender in (thing.sender, thing.maker))
            if one not in (*of_things, *(joint.sender for joint in self.joints())):
                self.unreadable.discard(one)
        if self.taking_turns:
            self.orders = {one: x for one, x in self.orders.items() if one not in self.gone}
            self.taking_turns = len(self.orders) > 1
        self.unknown = {name: at for name, at in self.unknown.items() if name not in self.things}
        since = self.missed.get("object_transform", inf)
        bases = [] if self.robot is None else [self.robot.base.at]
        times = *bases, *(thing.received for thing in self.things.values())
        if not self.deleting and all(at > since for at in times):
            self.missed.pop("object_transform", None)

    def joints(self) -> list[Joint]:
        return [] if self.robot is None else [*self.robot.joints, self.robot.base]

    def is_placed_at(self, frame: str, stamp: float) -> bool:
        return frame == "map" or (frame == "odom" and stamp <= self.until)

    def is_late(self, thing: Thing, stamp: float) -> bool:
        late = 0 < stamp < thing.order and self.now - thing.received <= REORDERED
        thing.overtaken |= late
        return late

    def latest(self) -> float:
        """Return when the latest transform of odom was true, which is used now."""
        if self.seen[0] != self.until:
            self.seen = self.until, self.now
        return min(self.seen) if self.by_stamp else self.seen[1]

    def state(
        self, thing: Thing, x: float, frame: str, stamp: float, carried: float = inf,
        speed: float | None = None,
    ) -> None:  # fmt: skip
        if self.is_late(thing, stamp):
            return
        thing.bad_pose = thing.overtaken = False
        thing.locked = None
        thing.repeated |= thing.received > 0
        thing.received, thing.sender = self.now, self.sender
        if 0 < stamp <= self.now + AHEAD:
            thing.order = stamp
        thing.states.append((x, frame, stamp, self.now, carried))
        thing.told = thing.told if speed is None else speed

    def add(
        self, name: str, x: float, size: float, frame: str, stamp: float, fault: str, life: float,
        mesh: bool = False, locked: bool = False,
    ) -> None:  # fmt: skip
        thing = self.things.get(name)
        expiry = self.now + life if life else inf
        if thing is not None and thing.of_set:
            thing.bad_shape = True
            return
        if fault:
            self.refuse(name, fault, size, expiry)
            return
        if thing is None:
            before = self.removed.get(name)
            thing = self.things[name] = Thing(size, shaped=False)
            if before is not None and before.shaped and not before.is_mesh and frame == "map":
                # deleted and sent again as it was: another message about it
                thing.repeated = before.size == size and before.x is not None
        elif self.is_late(thing, stamp):
            return
        if mesh and size not in self.built:
            thing.awaited = size
        else:
            thing.size, thing.shaped, thing.awaited, thing.is_mesh = size, True, None, mesh
        thing.bad_shape, thing.expiry, thing.seen = False, expiry, False
        self.newcomers.pop((name, False), None)
        thing.maker = self.sender
        self.state(thing, x, frame, stamp)
        if locked:
            thing.locked = x
            thing.states.pop()
        self.see()

    def refuse(
        self, name: str, fault: str, size: float, expiry: float = inf, of_set: bool = False
    ) -> None:
        """Take note of a refused cube: the object may have another shape than was told last."""
        thing = self.things.get(name)
        if thing is None:
            self.newcomers[name, of_set] = expiry
        else:
            other = thing.is_mesh or thing.awaited is not None or size != thing.size
            is_shape = fault == "scale" or other
            thing.bad_shape = is_shape or (of_set and thing.bad_shape)
            thing.bad_pose |= not is_shape
            thing.expiry = max(thing.expiry, expiry)
        self.see()

    def is_of_set(self, name: str) -> bool:
        return name in self.things and self.things[name].of_set

    def delete(self, *names: str, is_named: bool = True) -> None:
        """Delete some, by name or all: then states that are on their way are of those alone."""
        named = [name for name, _ in self.newcomers]
        gone = [name for name in names if name in self.things or name in named]
        for name in names:
            if is_named or name in self.things:
                self.deleted[name] = self.now
                self.deleting.append(name)
                self.unknown.pop(name, None)
            if name in self.things and not self.is_of_set(name):
                self.removed[name] = self.things.pop(name)
            self.newcomers.pop((name, False), None)
        if gone:
            self.declare()

    def named(
        self, name: str, x: float, frame: str, stamp: float, fault: str = "",
        speed: float | None = None,
    ) -> None:  # fmt: skip
        thing = self.things.get(name)
        if thing is None:
            ignored = any(fnmatch(name, pattern) for pattern in self.ignored)
            if self.now - self.deleted.get(name, -inf) >= MEMORY and not ignored:
                self.unknown[name] = self.now
        elif fault:
            thing.bad_pose = True
        else:
            self.state(thing, x, frame, stamp, speed=speed)

    def take_set(self, frame: str, stamp: float, rows: Rows) -> None:
        self.taking_turns |= self.sender in self.orders and [*self.orders][-1] != self.sender
        order, received = self.orders.pop(self.sender, (0.0, -inf))
        if 0 < stamp < order and self.now - received <= REORDERED:
            self.orders[self.sender] = order, received
            self.doubt_set()
            return
        self.orders[self.sender] = stamp if 0 < stamp <= self.now + AHEAD else order, self.now
        if frame == "map":
            self.sets.clear()
        self.sets.append((frame, stamp, self.now, rows, self.sender))

    def doubt_set(self, is_read: bool = True) -> None:
        """Mark the boxes that are there once what came before is applied, or the input."""
        self.sync_sets()
        own = [thing for thing in self.things.values() if thing.of_set]
        for thing in own:
            thing.bad_pose = True
        if not (own and is_read):
            self.unreadable.add(self.sender)

    def sync(self, has_sets: bool = True) -> None:
        """Apply what waits: deletions, and the newest set that can be placed."""
        self.deleted.update(dict.fromkeys(self.deleting, self.now))
        self.deleting.clear()
        self.removed.clear()
        if has_sets:
            self.sync_sets()

    def sync_sets(self) -> None:
        usable = [self.is_placed_at(frame, stamp) for frame, stamp, *_ in self.sets]
        if any(usable):
            last = len(usable) - 1 - usable[::-1].index(True)
            self.use_set(*self.sets[last])
            del self.sets[: last + 1]
        for one in [one for one in self.sets if self.now - one[2] > WAIT]:
            self.sets.remove(one)
            for thing in self.things.values():
                thing.bad_pose |= thing.of_set
            if not one[3]:
                self.unreadable.add(one[4])
            for name, *_ in one[3]:
                if name not in self.things:
                    self.newcomers[name, True] = inf
        self.see()

    def use_set(
        self, frame: str, stamp: float, received: float, rows: Rows, sender: Sender
    ) -> None:
        speaker, self.sender = self.sender, sender
        self.newcomers = {key: at for key, at in self.newcomers.items() if not key[1]}
        for name in [n for n, thing in self.things.items() if thing.of_set]:
            if name not in [row[0] for row in rows]:
                del self.things[name]
        carried = self.latest() if frame == "odom" and not stamp else inf
        now, self.now = self.now, received
        for name, x, size, fault in rows:
            if name in self.things and not self.things[name].of_set:
                self.newcomers[name, True] = inf
                continue
            if fault:
                self.refuse(name, fault, size, of_set=True)
                continue
            thing = self.things.setdefault(name, Thing(size, True))
            thing.size, thing.bad_shape = size, False
            self.newcomers.pop((name, False), None)
            self.state(thing, x + OFFSET * (frame == "odom"), "map", stamp, carried)
        self.now, self.sender = now, speaker
        self.declare()

    def clear(self, fails: bool = False) -> None:
        for name in self.things:
            self.deleted[name] = self.now
            self.unknown.pop(name, None)
        self.sets.clear()
        self.taking_turns = False
        self.broken = fails
        if fails:
            return
        self.things.clear()
        self.newcomers.clear()
        self.unreadable.clear()
        self.missed.clear()
        if self.robot is not None:
            self.robot.renew()
        self.declare()

    def jump(self, by: float) -> None:
        """Set the clock back: ages stay, and stamps mean nothing any more."""
        for thing in self.all_things().values():
            thing.jump(by, self.by_stamp)
        for joint in self.joints():
            joint.jump(by, self.by_stamp)
        self.newcomers = {key: at + by for key, at in self.newcomers.items()}
        for times in (self.unknown, self.deleted, self.missed):
            times.update({name: at + by for name, at in times.items()})
        self.sets = [
            (frame, stamp, at + by, rows, who) for frame, stamp, at, rows, who in self.sets
        ]
        self.orders = {one: (0.0, at + by) for one, (_, at) in self.orders.items()}
        self.seen = self.seen[0], self.seen[1] + by

    def all_things(self) -> dict[str, Thing]:
        return self.things | (self.robot.links if self.robot else {})

    def cycle(self, given: dict[str, Any], fails: str = "", waited: bool = False) -> None:
        self.overloaded = waited
        self.broken |= fails in ("sets", "robots")
        self.failed = fails == "update" or (fails == "check" and self.active and self.enabled)
        self.sync(has_sets=fails != "sets")
        if self.robot is not None and fails != "robots":
            self.place_links(self.robot, given)
        if fails != "update":
            self.update(given)
        if not self.failed:
            self.pairs = self.colliding(given)

    def fail(self) -> None:
        """Take note of an error that came of a message."""
        self.broken = True
        self.unreadable.add(self.sender)

    def describe(self, edge: float) -> None:
        assert self.robot is not None
        robot, again = self.robot, self.robot.refused
        robot.refused = not edge
        if edge and (edge != robot.edge or again):
            robot.edge = edge
            robot.renew()

    def take_base(self, x: float, frame: str, stamp: float, fault: str) -> None:
        assert self.robot is not None
        given = x, stamp, self.now, fault, self.by_stamp, self.sender
        self.robot.base = base = self.robot.base.after(*given, frame)
        self.robot.changed |= base.at == self.now

    def take_joints(self, values: Sequence[Any], stamp: float, fault: str) -> None:
        assert self.robot is not None
        self.robot.changed = True
        for k, value in enumerate(values if self.robot.links else ()):
            if value is not None:
                joint = self.robot.joints[k]
                given = value, stamp, self.now, fault, self.by_stamp, self.sender
                self.robot.joints[k] = joint.after(*given)

    def place_links(self, robot: Robot, given: dict[str, Any]) -> None:
        is_unknown = bool(robot.faults(self.now, given))
        if robot.changed and not is_unknown:
            robot.changed, base = False, robot.base
            stamp = max(base.stamp, *(joint.stamp for joint in robot.joints))
            now, self.now = self.now, max(joint.at for joint in robot.joints)
            places = 0.0, sum(joint.x for joint in robot.joints)
            for thing, x in zip(robot.links.values(), places, strict=True):
                self.state(thing, base.x + x, base.frame, stamp)
            self.now = now
        for thing in robot.links.values():
            thing.bad_pose |= is_unknown

    def update(self, given: dict[str, Any]) -> None:
        over = [n for n, thing in self.things.items() if thing.seen and thing.expiry <= self.now]
        for name in over:
            del self.things[name]
        self.newcomers = {key: at for key, at in self.newcomers.items() if at > self.now}
        self.take_built()
        for name, thing in self.all_things().items():
            thing.seen = True
            self.place(thing)
            self.age(name, thing, given)
            since = self.now - thing.received
            thing.overtaken &= since <= REORDERED
            thing.held_back = thing.overtaken and since > REORDERED / 2

    def take_built(self) -> None:
        what, self.delivers = self.delivers, ""
        awaiting = [] if not what else [n for n, t in self.things.items() if t.awaited is not None]
        for name in awaiting:
            thing = self.things[name]
            if what == "built":
                assert thing.awaited is not None
                thing.size, thing.shaped, thing.is_mesh = thing.awaited, True, True
                self.built.add(thing.size)
            elif thing.shaped:
                thing.bad_shape = True
            else:
                del self.things[name]
                self.newcomers[name, False] = thing.expiry
            thing.awaited = None

    def colliding(self, given: dict[str, Any]) -> list[tuple[Thing, Thing]]:
        """Return the pairs that collide: links of the robot never do with each other."""
        boxes = [
            (thing, thing.x, 0.5 * thing.size + self.growth(name, thing, given), name in LINKS)
            for name, thing in self.all_things().items()
            if thing.x is not None and thing.shaped and not self.has(name, thing, given, "ignore")
        ]
        return [
            (a, b)
            for (a, xa, ra, is_link), (b, xb, rb, is_other) in combinations(boxes, 2)
            if self.enabled and self.active and abs(xa - xb) <= ra + rb
            if not (is_link and is_other)
        ]

    def left(self) -> list[tuple[Thing, Thing]]:
        """Return the pairs found last whose objects still exist."""
        there = {*map(id, self.all_things().values())}
        return [pair for pair in self.pairs if {*map(id, pair)} <= there]

    def place(self, thing: Thing) -> None:
        if thing.locked is not None:
            thing.states.append((thing.locked, "odom", 0.0, thing.received, inf))
        usable = [k for k, (_, frame, stamp, *_) in enumerate(thing.states)
                  if self.is_placed_at(frame, stamp)]  # fmt: skip
        if usable:
            x, frame, thing.stamp, thing.at, thing.carried = thing.states[usable[-1]]
            thing.x = x + OFFSET * (frame == "odom")
            if frame == "odom" and not thing.stamp:
                thing.carried = self.latest()
            del thing.states[: usable[-1] + 1]
            thing.late = False
        thing.late |= any(self.now - at > WAIT for *_, at, _ in thing.states)
        thing.states = [
            state
            for state in thing.states
            if self.now - state[3] <= (LONGEST_WAIT if state[1] == "odom" else WAIT)
            or state is thing.states[-1]
        ]

    def age(self, name: str, thing: Thing, given: dict[str, Any]) -> None:
        own = last(given["object_timeout_overrides"], name)
        thing.is_alone = own is None and not thing.repeated and None is not thing.locked
        thing.is_alone &= thing.carried < inf
        limit = given["object_timeout"] if thing.repeated or thing.is_alone else 0.0
        limit = limit if own is None else own
        before = thing.stale
        age = self.now - thing.since(self.by_stamp)
        thing.stale = thing.x is not None and 0.0 < float(limit) < age
        if thing.stale and not before:
            thing.order, thing.speed = 0.0, max(thing.told, SPEED)

    def has(self, name: str, thing: Thing, given: dict[str, Any], policy: str) -> bool:
        is_it = (last(given["stale_policy_overrides"], name) or given["stale_policy"]) == policy
        return thing.stale and is_it

    def moved(self, thing: Thing) -> float:
        return thing.speed * max(self.now - thing.since(self.by_stamp), 0.0)

    def growth(self, name: str, thing: Thing, given: dict[str, Any]) -> float:
        collides = self.has(name, thing, given, "collide")
        return min(REACH, self.moved(thing)) if collides else 0.0

    def codes(self, given: dict[str, Any]) -> list[str]:
        self.look()
        found = {*self.of_cycle(), *self.of_clock(given), *self.of_scene(given)}
        unknown = set() if not self.robot else self.robot.codes(self.now, given, self.latest)
        for name, thing in (self.things if unknown else self.all_things()).items():
            if self.has(name, thing, given, "ignore"):
                continue
            lost = self.has(name, thing, given, "collide") and self.moved(thing) > REACH
            if thing.is_building:
                found.add("shape_building")
            elif thing.bad_pose or thing.bad_shape or thing.held_back:
                found.add("refused")
            elif thing.x is None:
                found.add("unplaced")
            elif thing.late:
                found.add("late_frame")
            elif lost or self.has(name, thing, given, "unknown"):
                found.add("stale")
        return [code for code in ORDER if code in found | unknown]

    def kinds(self, codes: Sequence[str]) -> Iterator[str]:
        """Yield in which ways all or less is known."""
        for thing in self.all_things().values() if "stale" in codes else ():
            others = thing.at if thing.is_alone else min(thing.at, thing.stamp or inf)
            if thing.stale and thing.carried < others:
                yield DEAD
            elif thing.stale and self.by_stamp and 0.0 < thing.stamp < thing.at:
                yield OLD
        if any(self.speakers[one[0]][-1] not in self.unreadable for one in self.unreadable):
            yield ONE
        if self.left():
            yield from [HALF] * bool(codes)
        elif not codes and any(len(senders) > 1 for senders in self.speakers.values()):
            yield TWO
        if "two_publishers" in codes:
            yield from [TWIN] * self.has_twin
            yield from [TURNS] * self.taking_turns

    def of_cycle(self) -> Iterator[str]:
        if not self.active:
            yield "inactive"
        elif not self.enabled:
            yield "disabled"
        if self.failed or self.broken:
            yield "internal_error"
        if self.overloaded:
            yield "overload"
        if self.taking_turns or self.has_twin:
            yield "two_publishers"

    def of_clock(self, given: dict[str, Any]) -> Iterator[str]:
        entries = *given["object_timeout_overrides"], *given["required_inputs"]
        limits = [given[TIMEOUT], *(float(entry.split(": ")[1]) for entry in entries)]
        limits += [given["joint_timeout"]] if self.robot else []
        heard = max(self.heard.values(), default=-inf)
        patience = min(1.0, *(limit or inf for limit in limits))
        if heard - max(self.ticked, self.activated) > patience:
            yield "clock_stopped"

    def of_scene(self, given: dict[str, Any]) -> Iterator[str]:
        if not (self.things or self.newcomers or self.declared or given["expect_empty"]):
            yield "no_objects"
        if self.newcomers:
            yield "refused"
        for pattern in given["required_objects"]:
            if not any(fnmatch(name, pattern) for name in self.things):
                yield "required_missing"
        for text in given["required_inputs"]:
            topic, limit = text.split(": ")
            since = self.heard.get(topic, -inf)
            if since < self.activated or self.steady - since > float(limit):
                yield "input_silent"
        if self.unreadable:
            yield "input_unreadable"
        if self.missed:
            yield "messages_lost"
        for name, at in self.unknown.items():
            if name not in self.things and self.now - at < MEMORY:
                yield "unknown_objects"


def last(entries: Sequence[str], name: str) -> str | None:
    values = [entry.split(": ")[1] for entry in entries if fnmatch(name, entry.split(": ")[0])]
    return values[-1] if values else None
