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

from collections.abc import Iterator, Sequence
from fnmatch import fnmatch
from itertools import combinations
from math import inf
from typing import Any

from evidence_sources import Message, Newest, Source, senders_of
from evidence_things import (
    AHEAD,
    CHANGES,
    DEAD,
    HALF,
    LINKS,
    LONGEST_WAIT,
    MEMORY,
    NOBODY,
    OFFSET,
    OLD,
    ONE,
    ORDER,
    REACH,
    REORDERED,
    SEEN,
    SPEED,
    TIMEOUT,
    TURNS,
    TWIN,
    TWO,
    WAIT,
    Joint,
    Robot,
    Rows,
    Sender,
    Thing,
    last,
)


class Model:
    """What can be known. until: up to when odom is; steady: seconds, by which inputs are silent."""

    def __init__(
        self,
        now: float,
        steady: float,
        until: float,
        robot: Robot | None,
        sources: Sequence[Source],
        watched: Sequence[str],
    ) -> None:
        self.now, self.steady, self.until, self.robot = now, steady, until, robot
        self.sources, self.watched = sources, watched
        self.active = self.enabled = True
        self.activated = steady
        self.failed = self.broken = self.overloaded = False
        self.built: set[float] = set()
        self.delivers = ""
        self.deleting: list[str] = []
        self.adding: set[str] = set()
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
        self.sets = Newest()
        self.has_twin = self.joints_age = False
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
        if topic in self.watched:
            return
        known = self.speakers.get(topic, [])
        self.speakers[topic] = [*(one for one in known if one != self.sender), self.sender]
        self.gone.discard(self.sender)
        self.unreadable.discard(self.sender)
        if lost and topic in CHANGES:
            self.missed[topic] = self.now

    def cannot_read(self) -> None:
        """Take note that the message cannot be read."""
        if self.sender[0] not in self.watched:
            self.unreadable.add(self.sender)

    @property
    def newest(self) -> list[Newest]:
        return [self.sets, *self.sources]

    @property
    def seen_things(self) -> dict[str, Thing]:
        return {source.name: source.thing for source in self.sources}

    def look(self) -> None:
        """Forget senders that are gone and of which nothing is left, and losses made good."""
        in_use = senders_of((self.things | self.seen_things).values())
        in_use |= {joint.sender for joint in self.joints()}
        self.unreadable -= self.gone - in_use
        for newest in self.newest:
            newest.forget(self.gone)
        self.unknown = {name: at for name, at in self.unknown.items() if name not in self.things}
        since = self.missed.get("object_transform", inf)
        bases = [] if self.robot is None else [self.robot.base.at]
        there = (thing for name, thing in self.things.items() if name not in self.adding)
        times = *bases, *(thing.received for thing in there)
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
            self.adding.add(name)
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
        if not self.sets.is_in_order(self.sender, stamp, self.now):
            self.doubt_set()
            return
        if frame == "map":
            self.sets.waiting.clear()
        self.sets.waiting.append(Message(frame, stamp, self.now, rows, self.sender))

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
        self.adding.clear()
        self.removed.clear()
        if has_sets:
            self.sync_sets()

    def sync_sets(self) -> None:
        waiting = self.sets.waiting
        usable = [self.is_placed_at(one.frame, one.stamp) for one in waiting]
        if any(usable):
            newest = len(usable) - 1 - usable[::-1].index(True)
            self.use_set(waiting[newest])
            del waiting[: newest + 1]
        for one in [one for one in waiting if self.now - one.at > WAIT]:
            waiting.remove(one)
            for thing in self.things.values():
                thing.bad_pose |= thing.of_set
            if not one.content:
                self.unreadable.add(one.sender)
            for name, *_ in one.content:
                if name not in self.things:
                    self.newcomers[name, True] = inf
        self.see()

    def use_set(self, one: Message) -> None:
        self.newcomers = {key: at for key, at in self.newcomers.items() if not key[1]}
        for name in [n for n, thing in self.things.items() if thing.of_set]:
            if name not in [row[0] for row in one.content]:
                del self.things[name]
        for name, x, size, fault in one.content:
            if name in self.things and not self.things[name].of_set:
                self.newcomers[name, True] = inf
                continue
            if fault:
                self.refuse(name, fault, size, of_set=True)
                continue
            thing = self.things.setdefault(name, Thing(size, of_set=True))
            thing.size, thing.bad_shape = size, False
            self.newcomers.pop((name, False), None)
            self.place_at(thing, x + OFFSET * (one.frame == "odom"), one)
        self.declare()

    def place_at(self, thing: Thing, x: float, one: Message) -> None:
        """Place a thing by a message that came earlier, now that its frame is known."""
        carried = self.latest() if one.frame == "odom" and not one.stamp else inf
        before = self.now, self.sender
        self.now, self.sender = one.at, one.sender
        self.state(thing, x, "map", one.stamp, carried)
        self.now, self.sender = before

    def clear(self, fails: bool = False) -> None:
        for name in self.things:
            self.deleted[name] = self.now
            self.unknown.pop(name, None)
        for newest in self.newest:
            newest.clear()
        self.broken = fails
        if fails:
            return
        for source in self.sources:
            source.renew()
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
        for newest in self.newest:
            newest.jump(by)
        if self.robot is not None:
            self.robot.trails = [[] for _ in self.robot.links]
        self.seen = self.seen[0], self.seen[1] + by

    def all_things(self) -> dict[str, Thing]:
        return self.things | self.seen_things | (self.robot.links if self.robot else {})

    def cycle(self, given: dict[str, Any], fails: str = "", waited: bool = False) -> None:
        self.overloaded = waited
        self.broken |= fails in ("sets", "robots", "sources")
        self.failed = fails == "update" or (fails == "check" and self.active and self.enabled)
        self.sync(has_sets=fails != "sets")
        if self.robot is not None and fails != "robots":
            self.place_links(self.robot, given)
        if self.sources and fails != "sources":
            self.sync_sources()
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

    def sync_sources(self) -> None:
        """Use what sensors saw, with the robot where it is by now."""
        robot = self.robot
        if robot is not None:
            robot.record(self.by_stamp)
            for thing in self.all_things().values() if any(s.waiting for s in self.sources) else ():
                self.place(thing)
            robot.record(self.by_stamp)
        for source in self.sources:
            source.apply(self)

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
        """Return the pairs that collide: links never do with each other, nor do clouds."""
        kinds = self.things, self.seen_things, self.robot.links if self.robot else {}
        bodies = [
            (thing, [thing.x + x for x in thing.points], size, kind)
            for kind, things in enumerate(kinds)
            for name, thing in things.items()
            if thing.x is not None and thing.shaped and not self.has(name, thing, given, "ignore")
            for size in [0.5 * thing.size + self.growth(name, thing, given)]
        ]
        return [
            (a, b)
            for (a, at, ra, kind), (b, bt, rb, other) in combinations(bodies, 2)
            if self.enabled and self.active and (kind != other or kind == 0)
            if any(abs(x - y) <= ra + rb for x in at for y in bt)
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
        own = last(self.limits(given), name)
        thing.is_alone = own is None and not thing.repeated and None is not thing.locked
        thing.is_alone &= thing.carried < inf
        limit = given["object_timeout"] if thing.repeated or thing.is_alone else 0.0
        limit = limit if own is None else own
        before = thing.stale
        age = self.now - thing.since(self.by_stamp)
        thing.stale = thing.x is not None and 0.0 < float(limit) < age
        if thing.stale and not before:
            thing.order, thing.speed = 0.0, max(thing.told, SPEED)

    def is_silent(self, source: Source, given: dict[str, Any]) -> bool:
        waited = self.steady - self.activated
        is_heard = self.heard.get(source.topic, -inf) >= self.activated
        return not is_heard and 0.0 < given[f"{source.topic}.timeout"] < waited

    def limits(self, given: dict[str, Any]) -> list[str]:
        """Return age limits by name; that of a source comes last."""
        of_sources = [f"{one.name}: {given[f'{one.topic}.timeout']}" for one in self.sources]
        return [*given["object_timeout_overrides"], *of_sources]

    def has(self, name: str, thing: Thing, given: dict[str, Any], policy: str) -> bool:
        of_source = (
            given.get(f"{name.split('/')[1]}.stale_policy") if name in self.seen_things else None
        )
        own = of_source or last(given["stale_policy_overrides"], name)
        return thing.stale and (own or given["stale_policy"]) == policy

    def moved(self, thing: Thing) -> float:
        return thing.speed * max(self.now - thing.since(self.by_stamp), 0.0)

    def growth(self, name: str, thing: Thing, given: dict[str, Any]) -> float:
        collides = self.has(name, thing, given, "collide")
        return min(REACH, self.moved(thing)) if collides else 0.0

    def codes(self, given: dict[str, Any]) -> list[str]:
        self.look()
        found = {*self.of_cycle(), *self.of_clock(given), *self.of_scene(given)}
        unknown = set() if not self.robot else self.robot.codes(self.now, given, self.latest)
        for name, thing in self.all_things().items():
            if not (unknown and name in LINKS):
                found |= {self.state_of(name, thing, given)}
        return [code for code in ORDER if code in found | unknown]

    def state_of(self, name: str, thing: Thing, given: dict[str, Any]) -> str:
        """Return the code of why a thing may not be where it is, "" if it is."""
        if self.has(name, thing, given, "ignore"):
            return ""
        lost = self.has(name, thing, given, "collide") and self.moved(thing) > REACH
        if thing.is_building:
            return "shape_building"
        if thing.bad_pose or thing.bad_shape or thing.held_back:
            return "refused"
        if thing.x is None:
            return "unplaced"
        if thing.late:
            return "late_frame"
        return "stale" if lost or self.has(name, thing, given, "unknown") else ""

    def kinds(self, codes: Sequence[str], given: dict[str, Any]) -> Iterator[str]:
        """Yield in which ways all or less is known."""
        unreadable = {topic for topic, _ in self.unreadable}
        for source in self.sources:
            yield SEEN + self.state_of(source.name, source.thing, given)
            yield from [f"{SEEN}input_silent"] * self.is_silent(source, given)
            yield from [f"{SEEN}input_unreadable"] * (source.topic in unreadable)
            yield from [f"{SEEN}two_publishers"] * source.taking_turns
            yield from [f"{SEEN}left out"] * source.left_out
            is_hit = any(source.thing in pair for pair in self.left())
            yield from [f"{SEEN}collides"] * is_hit
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
            yield from [TURNS] * self.sets.taking_turns

    def of_cycle(self) -> Iterator[str]:
        if not self.active:
            yield "inactive"
        elif not self.enabled:
            yield "disabled"
        if self.failed or self.broken:
            yield "internal_error"
        if self.overloaded:
            yield "overload"
        if self.has_twin or any(newest.taking_turns for newest in self.newest):
            yield "two_publishers"

    def of_clock(self, given: dict[str, Any]) -> Iterator[str]:
        entries = *self.limits(given), *given["required_inputs"]
        limits = [given[TIMEOUT], *(float(entry.split(": ")[1]) for entry in entries)]
        limits += [given["joint_timeout"]] if self.robot else []
        heard = max(self.heard.values(), default=-inf)
        patience = min(1.0, *(limit or inf for limit in limits))
        if heard - max(self.ticked, self.activated) > patience:
            yield "clock_stopped"

    def of_scene(self, given: dict[str, Any]) -> Iterator[str]:
        there = self.things or (self.sources and self.robot and self.robot.links)
        if not (there or self.newcomers or self.declared or given["expect_empty"]):
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
        if any(self.is_silent(source, given) for source in self.sources):
            yield "input_silent"
        if self.unreadable:
            yield "input_unreadable"
        if self.missed:
            yield "messages_lost"
        for name, at in self.unknown.items():
            if name not in self.things and self.now - at < MEMORY:
                yield "unknown_objects"
