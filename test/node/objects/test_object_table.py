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

"""The table of objects: their conditions, names and room; what is stale, and how boxes grow."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from objects_rig import SECOND, START, ObjectsRig
from rig import A1, A2, B1, Patch, Rig, color, cube, pose
from scipy.spatial.transform import Rotation

import obb_collision
from obb_collision.node import namespace_number
from obb_collision.node.diagnostics.answer import COLLIDING, FREE
from obb_collision.node.messages.box_markers import COLORS, DOUBTFUL
from obb_collision.node.messages.conversions import name_from_key
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.names import stand_in
from obb_collision.node.objects import conditions
from obb_collision.node.objects.states import AgeLimits, State
from obb_collision.node.objects.table import (
    COLLIDE,
    COLUMNS,
    FIRST_ROWS,
    IGNORE,
    UNKNOWN,
    ObjectTable,
)
from obb_collision.scene.store.patterns import Overrides
from obb_collision.shapes import Box, Mesh, Sphere
from obb_collision.typing import Floats

EVENTS = {name: one for name, one in vars(conditions).items() if isinstance(one, conditions.Event)}


@each("event", EVENTS.values())
def test_an_event_changes_its_facts_only_and_needs_others(event: conditions.Event) -> None:
    assert event.needs & conditions.LIVE
    for before in range(0, conditions.ALL + 1, 61):
        column = np.array([before], np.uint16)
        if before & event.needs == event.needs:
            conditions.happen(column, np.array([0]), event)
            assert column[0] == before & ~event.ends | event.begins
            assert column[0] & conditions.LIVE
        else:
            with pytest.raises(ValueError, match="is not allowed for an object in state"):
                conditions.happen(column, np.array([0]), event)
            assert column[0] == before


def test_what_is_refused_is_never_placed_and_who_waits_no_longer_is_not_tired() -> None:
    for name, event in EVENTS.items():
        assert not name.endswith("_REFUSED") or event.begins & conditions.STATES["refused"]
        assert bool(event.ends & conditions.WAITING) <= bool(event.ends & conditions.TIRED)


def test_a_new_object_is_unplaced_and_one_that_ended_has_no_fact() -> None:
    column = np.full(3, conditions.ALL, np.uint16)
    conditions.end(column, slice(0, 2))
    conditions.begin(column, np.array([1]))
    conditions.judge(column, conditions.STALE, np.array([True, False, True]))
    assert column.tolist() == [0, conditions.LIVE | conditions.STATES["unplaced"], conditions.ALL]
    with pytest.raises(ValueError, match="does not depend on the clock"):
        conditions.judge(column, conditions.LIVE, column > 0)


def test_nothing_else_writes_conditions() -> None:
    for file in (Path(obb_collision.__file__).parent / "node").rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Store):
                written = ast.unparse(node.value).split(".")[-1]
                assert "condition" not in written or file.name == "conditions.py", file


SPACES = ("", "/", "a", "/a", "a/b", "b", "5", "#7", "é", stand_in(namespace_number("b")))
IDS = (0, 1, -1, 5, 2**31 - 1, -(2**31))
KEYS = st.tuples(st.sampled_from((*SPACES, 7, namespace_number("b"))), st.sampled_from(IDS))
"""Of an object: its namespace, or the number of one, and its id."""
TEXTS = ("", "01", "-0", "+1", " 1", "x", "1.0", str(2**31), str(-(2**31) - 1), str(2**32 + 1))
NAMES = st.tuples(
    st.sampled_from(("", "/", *(f"{space}/" for space in SPACES), "\ud800/", "no/")),
    st.sampled_from((*map(str, IDS), *TEXTS)),
).map("".join)


def slot_of(name: str, table: ObjectTable) -> int:
    """Return the slot of the first object whose name is this one, with a slash in front or not."""
    for text in (name, "/" + name):
        for slot in np.flatnonzero(table.live).tolist():
            (namespace, ident), number = table.key(slot), int(table.ns[slot])
            known = [namespace]
            if namespace == stand_in(number):  # its name was not received yet
                known += [space for space in SPACES if namespace_number(space) == number]
            if text in [f"{each}/{ident}" for each in known]:
                return int(slot)
    return -1


@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(st.booleans(), KEYS), max_size=20), st.lists(NAMES, max_size=20))
def test_the_slots_are_those_of_a_search(changes: list[Any], names: list[str]) -> None:
    table = ObjectTable()
    free = iter(range(len(changes)))
    for ends, (space, ident) in changes:
        try:
            known = table.namespaces
            number = known.admit(space) if isinstance(space, str) else known.admit_number(space)
        except RefusedError:
            continue
        (slot,) = table.find(np.array([number]), np.array([ident])).tolist()
        if slot < 0:
            table.claim_many(np.array([next(free)]), np.array([number]), np.array([ident]))
        elif ends:
            table.release_many(np.array([slot]))
            known.forget_unused()
    expected = [slot_of(name, table) for name in names]
    assert table.find_named(names).tolist() == expected
    assert table.find_named([]).tolist() == []


def test_an_id_that_is_too_large_is_not_one_of_the_next_namespace() -> None:
    table = ObjectTable()
    table.claim(0, ("a", 1))
    following = table.namespaces.admit_number(namespace_number("a") + 1)
    table.claim_many(np.array([1]), np.array([following]), np.array([1]))
    names = ["a/1", f"a/{1 + 2**32}", f"{stand_in(following)}/{1 - 2**32}", f"#{following}/1"]
    assert table.find_named(names).tolist() == [0, -1, -1, 1]


@each("failing", range(0, len(COLUMNS), 2))
def test_an_object_without_room_in_tables_leaves_no_trace(failing: int, monkeypatch: Patch) -> None:
    keys = [("box", k) for k in range(FIRST_ROWS + 1)]
    rig = ObjectsRig(*keys[:-1])
    calls, made = 0, np.zeros_like

    def zeros_like(*given: Any, **options: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls > failing:
            raise MemoryError
        return made(*given, **options)

    objects = rig.objects
    monkeypatch.setattr(np, "zeros_like", zeros_like)
    with pytest.raises(MemoryError):
        objects.shapes.put(keys[-1], Box([1.0, 1.0, 1.0]))
    monkeypatch.undo()
    assert len({len(getattr(objects.table, column)) for column in COLUMNS}) == 1
    for known in (keys[:-1], keys):
        objects.update(rig.now)
        assert objects.scene.names == [name_from_key(key) for key in known]
        assert objects.table.keys(objects.scene.indices) == known
        objects.shapes.put(keys[-1], Box([1.0, 1.0, 1.0]))


SPEED = 2.0


def lost_sight(policy: str = COLLIDE, x: float = 4.0) -> ObjectsRig:
    """Return a cube at the origin whose sender stops, and one at ``x`` whose sender goes on."""
    rig = ObjectsRig(A1, A2)
    rig.limit(0.5, policy, speed=SPEED, reach=3.0)
    send(rig, 0, 0.0)
    rig.beside = x  # type: ignore[attr-defined]
    step(rig, 0.0)
    return rig


def send(rig: ObjectsRig, row: int, x: float, twist: Floats | None = None, frame: str = "") -> None:
    poses = np.array([pose(x)])
    rig.objects.states.store(rig.slots[[row]], poses, State(frame, 0, rig.now), twist)


def step(rig: ObjectsRig, seconds: float) -> None:
    """Run a cycle after some time; the second cube gets a new state."""
    rig.now += round(seconds * SECOND)
    send(rig, 1, rig.beside)  # type: ignore[attr-defined]
    rig.cycle()


def half_extents(rig: ObjectsRig, row: int = 0) -> Floats:
    extents: Floats = rig.objects.scene.obb(f"a/{row + 1}").half_extents
    return extents


def test_a_stale_box_collides_with_all_that_it_can_have_reached() -> None:
    rig = lost_sight(x=4.0)
    step(rig, 0.5)
    assert half_extents(rig).tolist() == [0.5] * 3, "not stale yet"
    step(rig, 0.5)
    assert half_extents(rig) == pytest.approx(0.5 + SPEED * 1.0)
    assert (rig.known().pairs, rig.known().level) == (0, FREE)
    step(rig, 0.49)
    assert rig.known().pairs == 0, "0.02 m apart"
    step(rig, 0.02)
    assert rig.known().level == COLLIDING
    assert rig.known().message == "1 pair collides; stale: a/1", "it may be beyond its growth"
    assert rig.is_doubtful()
    assert half_extents(rig, 1).tolist() == [0.5] * 3, "whose sender goes on"


@each("waits", [False, True])
def test_a_faster_twist_counts_also_while_its_state_waits(waits: bool) -> None:
    rig = lost_sight()
    twist = np.array([[0.0, 2.5, 0.0, 0.0, 0.0, 0.0]])
    send(rig, 0, 0.0, twist=twist)
    rig.cycle()
    if waits:  # for a frame that nobody publishes
        send(rig, 0, 0.0, twist=1.1 * twist, frame="nowhere")
    step(rig, 1.0)
    assert half_extents(rig) == pytest.approx(0.5 + (2.75 if waits else 2.5))


@each("policy", [COLLIDE, UNKNOWN])
def test_the_last_twist_that_was_told_counts_whenever_the_object_is_stale(policy: str) -> None:
    """It is stale twice, is sent without a twist in between, and has its policy afterwards."""
    rig = lost_sight(policy)
    rig.objects.states.wants_twists = lambda: policy == COLLIDE
    send(rig, 0, 0.0, twist=np.array([[0.0, 2.5, 0.0, 0.0, 0.0, 0.0]]))
    for _ in range(2):
        step(rig, 1.0)
        rig.limit(0.5, COLLIDE, speed=SPEED, reach=3.0)
        step(rig, 0.0)
        assert half_extents(rig) == pytest.approx(0.5 + 2.5)
        send(rig, 0, 0.0)
        step(rig, 0.0)
        assert half_extents(rig).tolist() == [0.5] * 3
    send(rig, 0, 0.0, twist=np.full((1, 6), np.nan))
    send(rig, 0, 0.0, twist=np.zeros((1, 6)))
    step(rig, 1.0)
    assert half_extents(rig) == pytest.approx(0.5 + SPEED), "slower, says the last one"


def test_a_grown_box_contains_the_object_however_it_moved_and_turned() -> None:
    rng = np.random.default_rng(11)
    for _ in range(200):
        size, age = rng.uniform(0.1, 3.0, 3), rng.uniform(0.6, 2.0)
        rig = ObjectsRig()
        rig.limit(0.5, COLLIDE, reach=1e6)
        points = rng.uniform(-0.5, 0.5, (30, 3)) * size + rng.uniform(-1.0, 1.0, 3)
        faces = rng.integers(0, 30, (20, 3))
        rig.slots = np.array([rig.objects.shapes.put(A1, Mesh(points, faces))])
        start = np.append(rng.uniform(-5.0, 5.0, 3), Rotation.random(None, rng).as_quat())
        twist = rng.uniform(-2.0, 2.0, 6)
        rig.objects.states.store(rig.slots, start[None], State("", 0, rig.now), twist[None])
        rig.cycle()
        rig.now += round(age * SECOND)
        rig.cycle()
        turn = Rotation.from_rotvec(twist[3:] * age) * Rotation.from_quat(start[3:])
        moved = turn.apply(points) + start[:3] + twist[:3] * age
        assert np.all(rig.objects.scene.obb("a/1").contains(moved))


def test_a_new_shape_and_padding_keep_the_growth() -> None:
    rig = lost_sight()
    step(rig, 1.0)
    rig.objects.scene.padding = 0.25
    assert half_extents(rig) == pytest.approx(0.75 + SPEED)
    rig.objects.shapes.put(A1, Box([2.0, 2.0, 2.0]))
    assert half_extents(rig) == pytest.approx(1.25 + SPEED)
    send(rig, 0, 0.0)
    step(rig, 0.01)
    assert half_extents(rig).tolist() == [1.25] * 3


def test_what_is_sent_once_does_not_age_and_each_object_has_its_own_limit() -> None:
    rig = ObjectsRig(A1, A2, B1)
    own, policies = Overrides([("a/2", 2.0)]), Overrides([("b/*", IGNORE)])
    rig.objects.staleness.limits = AgeLimits(0.5, own, policies=policies)
    for _ in range(2):
        for row in (0, 1, 2) if rig.now == START else (1, 2):
            send(rig, row, 3.0 * row)
        rig.cycle()
        rig.now += SECOND // 10
    rig.now += SECOND
    rig.cycle()
    assert rig.objects.table.has(conditions.STALE, rig.slots).tolist() == [False, False, True]
    assert rig.known().message == "free; 1 stale (accepted): b/1"
    rig.now += SECOND
    rig.cycle()
    assert (rig.known().reasons[0].code, rig.known().reasons[0].who) == ("stale", ("a/2",))


@each("accuracy", ["sphere", "aabb", "hull", "mesh"])
def test_every_accuracy_respects_the_growth(accuracy: str) -> None:
    rig = ObjectsRig(A1, A2)
    rig.limit(0.5, COLLIDE, speed=SPEED, reach=10.0)
    rig.beside = 3.0  # type: ignore[attr-defined]
    corners = np.array([[0.0, 0, 0], [0.4, 0, 0], [0, 0.4, 0], [0, 0, 0.4]])
    tetrahedron = Mesh(corners, np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]))
    for key, shape in ((A1, tetrahedron), (A2, Sphere(0.2))):
        rig.objects.shapes.put(key, shape)
    rig.objects.scene.accuracy = accuracy
    send(rig, 0, 0.0)
    step(rig, 0.0)
    assert rig.known().pairs == 0
    step(rig, 1.5)
    assert rig.known().pairs == 1


def test_markers_show_the_grown_box_in_grey() -> None:
    limits: dict[str, Any] = {"object_timeout_overrides": ["*: 0.3"], "stale_policy": "collide"}
    with Rig(stale_speed=0.5, **limits) as rig:
        rig.listen("obb_collision/markers")
        rig.send(cube(A1), cube(B1, (0.0, 5.0, 0.0)), stamped=False)

        def shown() -> Any:
            rig.send(cube(B1, (0.0, 5.0, 0.0)), stamped=False)
            message = rig.last.get("obb_collision/markers")
            found = {marker.ns: marker for marker in message.markers} if message else {}
            return {"a", "b"} <= found.keys() and found["a"].scale.x >= 1.5 and found

        found = rig.until(shown, "a grown marker")
        assert color(found["a"]) == COLORS[DOUBTFUL]
        assert found["b"].scale.x == 1.0
