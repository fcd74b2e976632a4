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

"""Scenes with a region each find together what one finds, and a merger joins it by stamp."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import random_poses
from support import refused

import obb_collision as oc
from obb_collision.queries.verdict.coarse import meeting_bounds
from obb_collision.regions import Region, split_regions
from obb_collision.scene.store import region as splitting

FAR = 0.5
"""Largest distance that clearances are computed for (m), and the halo."""
EFFECTS = ("contacts", "clearance", "sweep", "points", "separations")
COORDINATES = st.sampled_from([-4.0, -1.5, -1.0, -0.5, 0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 40.0])
"""Few, so that boxes touch borders and each other exactly."""
SIZES = st.sampled_from([0.0, 0.25, 0.5, 1.0, 3.0, 100.0])
TURNS = st.sampled_from([(0, 0, 0, 1), (0, 0, 0.6, 0.8), (0.5, 0.5, 0.5, 0.5)])
SPEEDS = st.sampled_from([-20.0, -1.0, 0.0, 0.0, 0.0, 2.0, 30.0])
MIDDLE = np.array([3.0] * 3 + [0.0] * 4)
POINTS = np.array(np.meshgrid(*[np.arange(-2.0, 3.0, 0.75)] * 3)).reshape(3, -1).T

poses = st.builds(
    lambda place, turn: np.array([*place, *turn], np.float64),
    st.tuples(COORDINATES, COORDINATES, COORDINATES),
    TURNS,
)
boxes = st.tuples(st.tuples(SIZES, SIZES, SIZES), poses)
moves = st.lists(st.tuples(st.integers(0, 11), poses, st.tuples(*[SPEEDS] * 6)), max_size=6)
splits = st.tuples(*[st.integers(1, 3)] * 3)


def scene_of(given_boxes: Sequence[Any], region: Region | None, **options: Any) -> oc.Scene:
    """Return a scene with boxes, and everything switched on."""
    scene = oc.Scene(**options)
    for name in EFFECTS:
        scene.set_effect(name, "on")
    scene.set_effect("clearance", max_distance=FAR)
    scene.set_effect("points", margin=0.25)
    scene.obstacle_points = POINTS
    scene.region = region
    for number, (size, pose) in enumerate(given_boxes):
        scene.add(f"box/{number}", oc.shapes.Box(size), pose)
    return scene


def cubes(*places: float, size: float = 1.0) -> list[Any]:
    """Return boxes along the x axis."""
    return [([size] * 3, np.array([x, 0, 0, 0, 0, 0, 1.0])) for x in places]


def rows(table: Any, count: int) -> list[tuple[Any, ...]]:
    """Return the rows of a dataclass of arrays, comparable also where there is NaN."""
    columns = [
        column for column in vars(table).values() if np.ndim(column) and len(column) == count
    ]
    return [tuple(np.asarray(column[n]).tobytes() for column in columns) for n in range(count)]


def found(report: oc.Report) -> dict[str, list[Any]]:
    """Return all that a check found, as rows by what it is."""
    pairs = [tuple(pair) for pair in report.pairs.tolist()]
    measured = zip(pairs, report.verdicts.tolist(), report.depths.tolist(), strict=True)
    swept = report.swept
    inside = report.points_inside
    points = [
        row for row, n in zip(rows(inside, len(inside.counts)), inside.counts, strict=True) if n
    ]
    return {
        "pairs": list(measured),
        "contacts": rows(report.contacts, len(report.contacts.pairs)),
        "clearances": rows(report.clearances, len(report.clearances.pairs)),
        "passed": rows(swept.passed, len(swept.passed)),
        "predicted": rows(swept.predicted, len(swept.predicted)),
        "points": points,
    }


def check_union(whole: oc.Scene, parts: Sequence[oc.Scene]) -> None:
    """Check that regions find together what one scene finds, nothing twice."""
    one = found(whole.check())
    several = [found(part.check()) for part in parts]
    for what, expected in one.items():
        union = sorted(row for some in several for row in some[what])
        assert union == sorted(expected), what


@settings(max_examples=12, deadline=None)
@given(st.lists(boxes, min_size=2, max_size=12), splits, st.lists(moves, max_size=4), st.booleans())
def test_regions_find_all_together(given_boxes: Any, parts: Any, steps: Any, padded: bool) -> None:
    options: dict[str, Any] = {"padding": 0.75, "exact": True} if padded else {}
    regions = split_regions([-1.5] * 3, [1.5] * 3, parts, FAR)
    whole = scene_of(given_boxes, None, **options)
    scenes = [scene_of(given_boxes, region, **options) for region in regions]
    for scene in (whole, *scenes):
        scene.add("cloud", oc.shapes.Cloud(POINTS, 0.1))
    check_union(whole, scenes)
    for step in steps:
        for scene in (whole, *scenes):
            for number, pose, twist in step:
                if number < len(given_boxes):
                    scene.move(f"box/{number}", pose)
                    scene.set_twist(f"box/{number}", twist)
        check_union(whole, scenes)


@each("seed, accuracy", enumerate(["sphere", "aabb", "obb", "mesh"]))
def test_many_objects_that_come_move_and_go(seed: int, accuracy: str) -> None:
    random = np.random.default_rng(seed)
    regions = split_regions([0.0] * 3, [6.0] * 3, (2, 2, 1), FAR)
    scenes = [scene_of([], region, accuracy=accuracy) for region in (None, *regions)]
    shapes = (oc.shapes.Box([1.0, 0.5, 2.0]), oc.shapes.Sphere(0.5), oc.shapes.Cylinder(0.25, 1.5))
    names = [f"a/{n}" for n in range(160)]
    start = random_poses(160, random, 4.0) + MIDDLE
    for scene in scenes:
        for n, name in enumerate(names):
            scene.add(name, shapes[n % 3], start[n])
        scene.add("cloud", oc.shapes.Cloud(POINTS + MIDDLE[:3], 0.1))
        scene.allow("a/1*", "a/2*")
    for step in range(6):
        share = (160, 4, 40, 0, 1, 80)[step]
        moved = random.choice(160, share, replace=False)
        poses = random_poses(160, random, 4.0)[:share] + MIDDLE
        gone, name = int(random.integers(160)), f"b/{step}"
        for scene in scenes:
            scene.move([names[n] for n in moved], poses)
            scene.set_enabled(names[gone], bool(step % 2))
            scene.add(name, shapes[step % 3], start[gone])
            if step > 2:
                scene.remove(f"b/{step - 2}")
        check_union(scenes[0], scenes[1:])
    assert len(scenes[0].check()) > 20


def test_a_pair_belongs_to_one_region_though_its_point_is_on_the_border() -> None:
    pair = cubes(0.0, 1.0, size=2.0)
    border = float(meeting_bounds(scene_of(pair, None).boxes)[0][1, 0])  # their common part begins
    for cut in (np.nextafter(border, -1.0), border, np.nextafter(border, 1.0)):
        ends, wide = [-np.inf, cut, np.inf], [np.inf, np.inf]
        regions = [Region([ends[k], -np.inf, -np.inf], [ends[k + 1], *wide], FAR) for k in (0, 1)]
        assert sorted(len(scene_of(pair, region).check()) for region in regions) == [0, 1]


def test_what_stays_away_takes_no_part_and_what_comes_does() -> None:
    region = Region([-np.inf] * 3, [0.0, np.inf, np.inf], FAR)
    scene = scene_of(cubes(-5, 50, 60), region)
    report = scene.check()
    assert scene.objects.near.tolist() == [0]
    assert report.cycle.active.tolist()[:3] == [True, False, False]
    scene.move("box/1", [50.25, 0, 0, 0, 0, 0, 1])
    assert scene.check().cycle.active.tolist()[:3] == [True, False, False]
    scene.move("box/1", [-5.5, 0, 0, 0, 0, 0, 1])
    assert scene.check().names() == [("box/0", "box/1")]
    assert scene.objects.near.tolist() == [0, 1]
    scene.move("box/1", [50, 0, 0, 0, 0, 0, 1])
    assert scene.check().names() == []
    scene.region = None
    scene.move("box/2", [50.5, 0, 0, 0, 0, 0, 1])
    assert scene.check().names() == [("box/1", "box/2")]
    assert scene.objects.near.tolist() == [0, 1, 2]


def test_only_objects_far_away_that_move_leave_the_report_as_it_is() -> None:
    region = Region([-np.inf] * 3, [0.0, np.inf, np.inf], 1.0)
    scene = oc.Scene(region=region)
    for n, x in enumerate((-5.0, -5.5, 50.0)):
        scene.add(str(n), oc.shapes.Box([1, 1, 1]), [x, 0, 0, 0, 0, 0, 1])
    report = scene.check()
    scene.move("2", [60, 0, 0, 0, 0, 0, 1])
    assert scene.check() is report
    assert scene.any_collision()
    assert scene.query(oc.shapes.Sphere(1.0), [60, 0, 0, 0, 0, 0, 1]) == []
    assert scene.query(oc.shapes.Sphere(1.0), [-5, 0, 0, 0, 0, 0, 1]) == ["0", "1"]
    scene.clear()
    scene.add("far", oc.shapes.Box([1, 1, 1]), [9, 0, 0, 0, 0, 0, 1])
    scene.check()
    assert scene.objects.near.tolist() == []


def test_a_halo_smaller_than_what_effects_look_beyond_is_refused() -> None:
    part = Region([0, 0, 0], [1, 1, 1], 0.05)
    refused(r"halo .* at least 0\.1", oc.Scene, region=part)
    scene = oc.Scene()
    scene.set_effect("clearance", "off")
    scene.region = part
    for effect, options in (("clearance", {"mode": "on"}), ("points", {"margin": 0.06})):
        before = scene.effects[effect]
        refused("halo of the region must be at least", scene.set_effect, effect, **options)
        assert scene.effects[effect] == before
    scene.set_effect("points", margin=0.05)
    scene.region = Region([-np.inf] * 3, [np.inf] * 3)  # of everything: no halo is needed
    assert scene.region is None


@each("parts", [(1, 1, 1), (3, 1, 1), (2, 3, 4)])
def test_every_point_is_in_one_region_of_a_split(parts: tuple[int, int, int]) -> None:
    regions = split_regions([-1, 0, 2], [1, 3, 4], parts)
    assert len(regions) == np.prod(parts)
    cuts = np.unique([r.minimum for r in regions] + [r.maximum for r in regions])
    cuts = cuts[np.isfinite(cuts)]
    values = np.concatenate([cuts, np.nextafter(cuts, -np.inf), [-1e300, -1.0, 0.0, 7.0, 1e300]])
    points = np.array(np.meshgrid(values, values, values)).reshape(3, -1).T
    assert (np.sum([region.holds(points) for region in regions], axis=0) == 1).all()


def test_what_is_no_region_or_split_is_refused() -> None:
    for ends, reason in (
        (([0, 0, 0], [1, 0, 1]), "minimum must be below maximum"),
        (([0, 0, np.nan], [1, 1, 1]), "minimum must be below maximum"),
        (([0, 0], [1, 1, 1]), "minimum must have shape"),
        (([np.inf] * 3, [np.inf] * 3), "minimum must be below"),
        (([0, 0, 0], [1, 1, 1], -1.0), "halo must not be negative"),
        (([0, 0, 0], [1, 1, 1], np.inf), "halo"),
    ):
        refused(reason, Region, *ends)
    for split, reason in (
        (([0, 0, 0], [1, 1, 1], [0, 1, 1]), "parts"),
        (([0, 0, 0], [1, 1, 1], [2, 2]), "three"),
        (([0, 0, 0], [1, 1, 1], [5000, 1, 1]), "parts"),
        (([0, 0, 0], [1, 1, 1], [64, 64, 2]), "4096"),
        (([0, 0, 0], [0, 1, 1], [2, 1, 1]), "along an axis"),
        (([1, 0, 0], [np.nextafter(1, 2), 1, 1], [9, 1, 1]), "below maximum"),
    ):
        refused(reason, split_regions, *split)


PAIRS = [(name, "<i4") for name in ("ns_a", "id_a", "ns_b", "id_b")]
SECOND = 1_000_000_000
STEP = 0.1
"""Seconds between two signs of life."""


def pair_rows(*pairs: tuple[int, int], **more: Any) -> Any:
    """Return pair_rows of pairs of ids in one namespace."""
    made = np.zeros(len(pairs), [*PAIRS, *((name, "<f8") for name in more)])
    made["id_a"], made["id_b"] = np.array(pairs, np.int32).reshape(-1, 2).T
    for name, values in more.items():
        made[name] = values
    return made


class Run:
    """A merger and a clock: all regions that are there say so every STEP."""

    def __init__(self, *regions: str, objects: int = 10) -> None:
        self.merger = oc.regions.RegionMerger(regions, timeout=0.5)
        self.now = 0.0
        self.objects = dict.fromkeys(regions, objects)

    def wait(self, seconds: float) -> dict[str, str]:
        """Let time go by; return what is missing then."""
        for _ in range(round(seconds / STEP)):
            self.now += STEP
            for name, count in self.objects.items():
                self.merger.mark_alive(name, count, self.now)
        return self.merger.missing(self.now)

    def take(self, region: str, stamp: int, given: Any, **more: Any) -> Any:
        found = self.merger.take(region, stamp * SECOND, given, self.now, **more)
        return None if found is None else found[["id_a", "id_b"]].tolist()


@pytest.fixture
def run() -> Run:
    made = Run("west", "east")
    assert made.wait(0.3) == {"west": "back for 0.2 s", "east": "back for 0.2 s"}
    assert made.wait(0.4) == {}
    return made


def test_rows_of_a_topic_are_joined_and_sorted_once_all_regions_have_a_stamp(run: Run) -> None:
    assert run.take("west", 1, pair_rows((3, 4), (7, 8))) is None
    assert run.take("east", 1, pair_rows((1, 2)), topic="contacts") is None
    assert run.take("east", 2, pair_rows((1, 2))) is None
    assert run.take("east", 1, pair_rows((5, 6))) == [(3, 4), (5, 6), (7, 8)]
    assert run.take("west", 2, pair_rows()) == [(1, 2)]
    assert run.take("west", 1, pair_rows((3, 4)), topic="contacts") == [(1, 2), (3, 4)]
    assert run.merger.repeated == 0


def test_the_last_rows_of_a_stamp_count_and_a_later_stamp_ends_the_wait(run: Run) -> None:
    run.take("west", 1, pair_rows((1, 2)))
    run.take("west", 1, pair_rows((1, 3)))
    assert run.take("east", 1, pair_rows()) == [(1, 3)]
    run.take("west", 2, pair_rows((1, 4)))
    run.take("west", 3, pair_rows((1, 5)))
    assert run.take("east", 3, pair_rows()) == [(1, 5)]
    assert run.take("east", 2, pair_rows()) is None  # a stamp that nobody else will have again
    assert run.take("west", 2, pair_rows((9, 9))) == [(9, 9)]  # unless time begins anew


def test_what_passed_stays_when_a_region_evaluates_a_stamp_again(run: Run) -> None:
    """With nothing new in between, a node has nothing that passed the second time."""
    run.take("west", 1, pair_rows((1, 2), (3, 4), (5, 6), passed=[1.0, 1.0, 0.0]))
    run.take("west", 1, pair_rows((3, 4), (1, 2), passed=[1.0, 0.0]))
    run.take("west", 1, pair_rows((7, 8), passed=[0.0]))
    assert run.take("east", 1, pair_rows(passed=[])) == [(1, 2), (3, 4), (7, 8)]
    run.take("west", 1, pair_rows(passed=[]))
    assert run.take("east", 1, pair_rows(passed=[])) == []


def test_several_rows_of_a_pair_stay_but_two_regions_that_report_it_are_counted(run: Run) -> None:
    run.take("west", 1, pair_rows((1, 2), (1, 2)))
    assert run.take("east", 1, pair_rows((1, 2), (3, 4))) == [(1, 2), (1, 2), (3, 4)]
    assert run.merger.repeated == 1
    run.take("west", 2, pair_rows((1, 2), passed=[1.0]))
    assert run.take("east", 2, pair_rows((1, 2), passed=[0.0])) == [(1, 2), (1, 2)]
    assert run.merger.repeated == 1  # passed and to come are two things


def test_an_object_has_a_row_for_each_cloud_though_regions_share_them(run: Run) -> None:
    rows = np.zeros(2, [(name, "<i4") for name in ("ns", "id", "cloud_ns", "cloud_id")])
    rows["cloud_id"] = [4, 3]
    assert run.merger.take("west", SECOND, rows[:1], run.now) is None
    joined = run.merger.take("east", SECOND, rows[1:], run.now)
    assert joined is not None
    assert joined["cloud_id"].tolist() == [3, 4]
    assert run.merger.repeated == 0


def test_a_silent_region_is_missing_after_the_timeout_and_back_after_another(run: Run) -> None:
    del run.objects["east"]
    assert run.wait(0.4) == {}
    assert run.wait(0.3) == {"east": "silent for 0.7 s"}
    assert run.take("east", 1, pair_rows()) is None
    run.take("west", 1, pair_rows((1, 2)))
    run.objects["east"] = 0
    assert run.wait(2.0) == {"east": "0 of 10 objects"}
    assert run.take("east", 1, pair_rows()) is None
    run.objects["east"] = 10
    assert run.wait(0.4) == {"east": "back for 0.3 s"}
    assert run.take("east", 1, pair_rows()) is None  # may be of before it had all objects
    assert run.wait(0.3) == {}
    assert run.take("east", 1, pair_rows()) == [(1, 2)]


def test_objects_that_come_and_go_make_no_region_missing(run: Run) -> None:
    for count in (20, 5, 12, 13, 0, 40):
        run.objects["west"] = count
        assert run.wait(0.1) == {}
        run.objects["east"] = count
        assert run.wait(0.2) == {}
    run.objects["west"] = 41
    assert run.wait(0.8) == {"east": "40 of 41 objects"}


def test_rows_without_objects_unknown_regions_and_bad_names_are_refused(run: Run) -> None:
    refused("rows must be", run.merger.take, "west", 1, np.zeros(2), run.now)
    with pytest.raises(KeyError, match="no region named 'north'"):
        run.merger.mark_alive("north", 1, run.now)
    for wrong in ([], ["a", "a"], [""]):
        refused("regions", oc.regions.RegionMerger, wrong)
    refused("timeout", oc.regions.RegionMerger, ["a"], 0.0)


def test_stamps_that_never_become_complete_take_bounded_room(run: Run) -> None:
    for stamp in range(1000):
        assert run.take("west", stamp, pair_rows()) is None
    assert run.take("east", 0, pair_rows()) is None
    assert run.take("east", 999, pair_rows()) == []


def cut(regions: list[Region], row: int, at: float) -> None:
    """Cut one of some regions in two along an axis, if it reaches on both sides of a point."""
    low, high = regions[row].minimum, regions[row].maximum
    axis = row % 3
    if low[axis] < at < high[axis]:
        end, start = high.copy(), low.copy()
        end[axis] = start[axis] = at
        regions[row : row + 1] = [Region(low, end), Region(start, high)]


@each("seed", range(20))
def test_whether_regions_fill_space_once_is_exact(seed: int) -> None:
    rng = np.random.default_rng(seed)
    regions = [Region([-np.inf] * 3, [np.inf] * 3)]
    for _ in range(30):
        cut(regions, int(rng.integers(len(regions))), float(rng.normal()))
    assert splitting.coverage(regions) == (False, [])
    row = int(rng.integers(len(regions)))
    assert splitting.coverage(regions[:row] + regions[row + 1 :]) == (True, [])
    assert splitting.coverage([*regions, regions[row]])[1] == [row, len(regions)]
    low, high = regions[row].minimum, regions[row].maximum
    inner = np.flatnonzero(np.isfinite(high))
    if len(inner):
        end = high.copy()
        end[inner[0]] = np.nextafter(high[inner[0]], -np.inf)
        others = regions[:row] + regions[row + 1 :]
        assert splitting.coverage([*others, Region(low, end)]) == (True, [])
        end[inner[0]] = np.nextafter(high[inner[0]], np.inf)
        assert len(others) in splitting.coverage([*others, Region(low, end)])[1]
