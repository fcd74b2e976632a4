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


"""What zones make of a command: who wins, parts by speed, counts in a row, ways out, objects."""

from __future__ import annotations

import math

import numpy as np
import pytest
from each import each
from processes import run_python

from obb_collision.typing import Floats
from obb_collision.zones import (
    Cloud,
    Outline,
    Part,
    Settings,
    Surroundings,
    Twist,
    Zone,
    circle,
    decide,
    polygon_from_text,
)

SQUARE = polygon_from_text("[[0.5, 0.5], [0.5, -0.5], [-0.5, -0.5], [-0.5, 0.5]]")
LARGE = Outline(2.0 * SQUARE.corners)
AHEAD = (0.4, 0.0, 0.1)
SIGNS = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], np.float64)


def zone(action: str, outline: Outline = SQUARE, name: str = "", **settings: object) -> Zone:
    """Return a zone in which one point is enough."""
    return Zone(name or action, Settings(action, min_points=1, **settings), outline)  # type: ignore[arg-type]


def seeing(*points: tuple[float, ...], **sources: list[tuple[float, ...]]) -> Surroundings:
    """Return surroundings with points (x, y, z) of a source ``front``, and of others."""
    named = {"front": list(points)} | sources
    return Surroundings({n: np.array(p, np.float64).reshape(-1, 3) for n, p in named.items()})


def boxes(**centers: tuple[float, ...]) -> Surroundings:
    """Return surroundings with cubes of 20 cm by name."""
    corners = np.array([0.1 * SIGNS + center for center in centers.values()])
    return Surroundings({}, names=list(centers), corners=corners)


def test_of_equally_slow_ones_the_first_counts_and_stop_ends_the_search() -> None:
    near = seeing((0.2, 0.0, 0.0))
    zones = [zone("slowdown", name="a"), zone("slowdown", name="b", slowdown_ratio=0.5)]
    assert decide(AHEAD, zones, near).zone == "a"
    zones.append(zone("slowdown", name="c", slowdown_ratio=0.25))
    assert decide(AHEAD, zones, near).zone == "c"
    zones += [zone("stop", name="d"), zone("stop", name="e")]
    found = decide(AHEAD, zones, near)
    assert (found.zone, found.twist, found.action) == ("d", (0.0, 0.0, 0.0), "stop")
    later = zones[-1]
    assert not later.is_active, "after a stop no more is looked at"


@each("action", ["slowdown", "limit", "approach"])
def test_a_zero_command_is_not_made_slower(action: str) -> None:
    found = decide((0.0, 0.0, 0.0), [zone(action)], seeing((0.2, 0.0, 0.0)))
    assert found.action == "none"
    assert decide((0.0, 0.0, 0.0), [zone("stop")], seeing((0.2, 0.0, 0.0))).action == "stop"


def test_a_limit_keeps_the_shape_of_the_way() -> None:
    near = seeing((0.2, 0.0, 0.0))
    limit = zone("limit", linear_limit=0.5, angular_limit=0.4)
    assert decide((0.6, 0.8, 0.2), [limit], near).twist == pytest.approx((0.3, 0.4, 0.1))
    assert decide((0.1, 0.0, 0.8), [limit], near).twist == pytest.approx((0.05, 0.0, 0.4))
    within = decide((0.3, 0.0, 0.1), [limit], near)
    assert (within.twist, within.action) == ((0.3, 0.0, 0.1), "none")
    backwards = zone("limit", linear_limit=-1.0)
    assert decide((0.3, 0.0, 0.1), [backwards], near).twist == (0.0, 0.0, 0.0), "at least 0"


def test_approach_keeps_the_time_before_a_collision() -> None:
    ahead = zone("approach", time_before_collision=2.0)
    found = decide((0.5, 0.0, 0.0), [ahead], seeing((1.0, 0.0, 0.0)))
    assert found.finding.time == pytest.approx(1.0)
    assert found.twist == pytest.approx((0.25, 0.0, 0.0))
    assert decide((0.2, 0.0, 0.0), [ahead], seeing((1.0, 0.0, 0.0))).action == "none"
    inside = decide((1e9, 0.0, 0.0), [ahead], seeing((0.2, 0.0, 0.0)))
    assert (inside.twist, inside.action) == ((0.0, 0.0, 0.0), "approach")
    ahead.settings.min_points = 2
    assert decide((0.5, 0.0, 0.0), [ahead], seeing((1.0, 0.0, 0.0))).action == "none"


def test_points_of_the_chosen_sources_are_summed() -> None:
    stop = zone("stop")
    stop.settings.min_points = 3
    several = seeing((0.1, 0, 0), (0.2, 0, 0), rear=[(0.3, 0, 0)], top=[(0.4, 0, 0)])
    found = decide(AHEAD, [stop], several)
    assert found.finding.who == ["front", "rear", "top"]
    stop.settings.sources = ("front",)
    assert decide(AHEAD, [stop], several).action == "none"
    stop.settings.sources = ("front", "top")
    assert decide(AHEAD, [stop], several).finding.who == ["front", "top"]


def test_zones_that_are_off_or_without_a_shape_are_skipped() -> None:
    near, stop = seeing((0.2, 0.0, 0.0)), zone("stop")
    for skipped in (zone("none"), zone("stop", enabled=False), Zone("x", Settings("stop"))):
        assert decide(AHEAD, [skipped], near).action == "none"
        assert decide(AHEAD, [skipped, stop], near).action == "stop"


def test_zones_act_after_some_commands_and_end_after_others() -> None:
    stop = zone("stop", trigger=3, release=2)
    seen = [1, 1, 0, 1, 1, 1, 0, 1, 0, 0, 1]
    expected = [0, 0, 0, 0, 0, 1, 1, 1, 1, 0, 0]
    for inside, acts in zip(seen, expected, strict=True):
        around = seeing((0.2, 0.0, 0.0)) if inside else seeing()
        assert decide(AHEAD, [stop], around).action == ("stop" if acts else "none")
    ahead = zone("approach", trigger=3)
    assert decide(AHEAD, [ahead], seeing((0.2, 0.0, 0.0))).action == "approach"


def test_a_velocity_polygon_takes_the_first_part_that_covers_the_command() -> None:
    slow = Part(SQUARE, (0.0, 0.5), (-1.0, 1.0))
    fast = Part(LARGE, (0.5, 1.0), (-1.0, 1.0))
    moving = Zone("v", Settings("stop", min_points=1), None, [slow, fast])
    far = seeing((0.9, 0.0, 0.0))
    assert decide((2.0, 0.0, 0.0), [moving], far).action == "none", "none covered yet"
    assert decide((0.5, 3.0, 1.0), [moving], far).action == "none", "both ends, and x only"
    assert decide((0.6, 0.0, 0.0), [moving], far).action == "stop"
    assert decide((2.0, 0.0, 0.0), [moving], far).action == "stop", "the last one stays"
    assert decide((0.2, 0.0, -1.0), [moving], far).action == "none"


def test_holonomic_parts_have_a_direction_across_pi_too() -> None:
    linear, theta = (0.0, 1.0), (-1.0, 1.0)
    left = Part(SQUARE, linear, theta, (0.25 * math.pi, 0.75 * math.pi))
    back = Part(SQUARE, linear, theta, (0.75 * math.pi, -0.75 * math.pi))
    assert [part.covers((0.0, 0.5, 0.0)) for part in (left, back)] == [True, False]
    assert [part.covers((-0.5, 0.01, 0.0)) for part in (left, back)] == [False, True]
    assert [part.covers((-0.5, -0.01, 0.0)) for part in (left, back)] == [False, True]
    assert not left.covers((0.9, 0.9, 0.0)), "the speed, and not x, is compared"


def test_objects_count_beside_points() -> None:
    stop = zone("stop")
    stop.settings.min_points = 100
    found = decide(AHEAD, [stop], boxes(person=(0.55, 0.0, 0.5), shelf=(2.0, 0.0, 0.0)))
    assert found.finding.who == ["person"]
    found = decide((0.5, 0.0, 0.0), [zone("approach")], boxes(shelf=(1.5, 0.0, 0.0)))
    assert found.finding.time == pytest.approx(1.8)
    assert found.finding.who == ["shelf"]
    high = zone("approach", max_height=0.3)
    assert decide((0.5, 0.0, 0.0), [high], boxes(shelf=(1.0, 0.0, 0.5))).action == "none"
    assert decide((0.5, 0.0, 0.0), [high], boxes(shelf=(1.0, 0.0, 0.3))).action == "approach"
    angles = np.arange(64) * (np.pi / 32)
    rim = np.column_stack([1.0 + 0.2 * np.cos(angles), 0.2 * np.sin(angles), 0.0 * angles])
    pillar = Surroundings({}, names=["pillar"], hulls=[rim])
    assert decide((0.5, 0.0, 0.0), [zone("approach")], pillar).finding.time == pytest.approx(0.6)
    beside = Outline(np.array([[0.84, 0.4], [0.84, 0.16], [0.6, 0.16], [0.6, 0.4]]))
    assert decide(AHEAD, [zone("stop", beside)], pillar).action == "none", "but in its box"
    assert decide(AHEAD, [zone("stop", Outline(1.2 * beside.corners))], pillar).action == "stop"
    assert decide(AHEAD, [zone("stop", LARGE, min_height=0.1)], pillar).action == "none"
    ball = Surroundings({}, {"sources/a/0": Cloud(np.array([[1.2, 0.0, 0.0]]), 0.2)})
    found = decide((0.5, 0.0, 0.0), [zone("approach")], ball)
    assert found.finding.time == pytest.approx(1.0)


def test_nothing_that_moves_has_a_point_in_its_footprint() -> None:
    rng, moving = np.random.default_rng(5), 0
    for _ in range(2000):
        points = rng.uniform(-1.5, 1.5, (int(rng.integers(1, 30)), 3))
        x, y, turn = rng.uniform(-1.0, 1.0, 3).tolist()
        found = decide((x, y, turn), [zone("approach")], Surroundings({"front": points}))
        if any(found.twist):
            moving += 1
            assert (np.abs(points[:, :2]).max(axis=1) > 0.5).all()
    assert moving > 100


def test_warm_up_has_all_kernels() -> None:
    code = """
import numpy as np
from obb_collision import _jit
from obb_collision.warm_up import steps
steps.run(steps.ZONES)
from obb_collision.zones import *
before = _jit.loaded_kernels()
corners = np.zeros((2, 8, 3))
for outline in (circle(0.5), polygon_from_text("[[1, 1], [1, -1], [-1, -1], [-1, 1]]")):
    for action in ("stop", "slowdown", "limit", "approach"):
        for leaving in (None, outline, circle(0.3)):
            settings = Settings(action, min_height=0.1, max_height=1.0, leaving=leaving)
            for count in (1, 40):
                points = np.zeros((count, 3))
                clouds = {"cloud": Cloud(points, 0.1)}
                bodies = ["a", "b", "c"], corners, [points + 1]
                around = Surroundings({"front": points}, clouds, *bodies)
                decide((0.1, 0.0, 0.2), [Zone("z", settings, outline)], around)
new = _jit.loaded_kernels() - before
assert not new, new
"""
    run_python("-c", code)


def ring(distance: float) -> Floats:
    """Return the directions of 24 points about a base."""
    angles = np.arange(24) * (np.pi / 12)
    return distance * np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles])


@each("kind", ["points", "box", "cloud"])
@each("row", range(24))
def test_a_stop_zone_can_be_left_in_every_direction_that_opens(kind: str, row: int) -> None:
    round_base, stop = circle(0.25), zone("stop", circle(0.6))
    stop.settings.leaving = round_base
    center = ring(0.5)[row]
    around = {
        "points": Surroundings({"front": center[None]}),
        "cloud": Surroundings({}, {"cloud": Cloud(center[None], 0.05)}),
        "box": Surroundings({}, names=["box"], corners=(0.05 * SIGNS + center)[None]),
    }[kind]
    for turn in (0.0, 0.5, -0.5):
        assert decide((0.0, 0.0, turn), [stop], around).action == ("none" if turn else "stop")
    for way in ring(0.3):
        cosine = float(way @ center) / 0.15
        found = decide((float(way[0]), float(way[1]), 0.0), [stop], around)
        if cosine < -0.3 or cosine > 0.3:  # a box has corners: between them it depends
            assert (found.action == "none") == (cosine < 0.0)


def test_a_long_base_does_not_turn_into_what_is_beside_it() -> None:
    long = polygon_from_text("[[0.5, 0.2], [0.5, -0.2], [-0.5, -0.2], [-0.5, 0.2]]")
    stop = zone("stop", LARGE)
    stop.settings.leaving = long

    def allows(twist: Twist, *points: tuple[float, ...]) -> bool:
        return decide(twist, [stop], seeing(*points)).action == "none"

    assert not allows((0.0, 0.0, 0.5), (0.45, 0.3, 0.0)), "its front comes nearer"
    assert allows((0.0, 0.0, -0.5), (0.45, 0.3, 0.0))
    assert allows((-0.3, 0.0, 0.0), (0.7, 0.0, 0.0))
    assert not allows((-0.3, 0.0, 0.0), (0.7, 0.0, 0.0), (-0.7, 0.0, 0.0))
    assert not allows((0.0, 0.0, -0.5), (0.3, 0.1, 0.0)), "it touches already"
