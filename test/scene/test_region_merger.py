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

"""What several regions found is joined where all have evaluated a stamp, and only then."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import obb_collision as oc

PAIRS = [(name, "<i4") for name in ("ns_a", "id_a", "ns_b", "id_b")]
SECOND = 1_000_000_000
STEP = 0.1
"""Seconds between two signs of life."""


def rows(*pairs: tuple[int, int], **more: Any) -> Any:
    """Return rows of pairs of ids in one namespace."""
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


def test_rows_are_joined_and_sorted_once_all_regions_have_a_stamp(run: Run) -> None:
    assert run.take("west", 1, rows((3, 4), (7, 8))) is None
    assert run.take("east", 2, rows((1, 2))) is None
    assert run.take("east", 1, rows((5, 6))) == [(3, 4), (5, 6), (7, 8)]
    assert run.take("west", 2, rows()) == [(1, 2)]
    assert run.merger.repeated == 0


def test_the_last_rows_of_a_stamp_count_and_a_later_stamp_ends_the_wait_for_earlier_ones(
    run: Run,
) -> None:
    run.take("west", 1, rows((1, 2)))
    run.take("west", 1, rows((1, 3)))
    assert run.take("east", 1, rows()) == [(1, 3)]
    run.take("west", 2, rows((1, 4)))
    run.take("west", 3, rows((1, 5)))
    assert run.take("east", 3, rows()) == [(1, 5)]
    assert run.take("east", 2, rows()) is None  # a stamp that nobody else will have again
    assert run.take("west", 2, rows((9, 9))) == [(9, 9)]  # unless time begins anew


def test_what_passed_stays_when_a_region_evaluates_a_stamp_again(run: Run) -> None:
    """With nothing new in between, a node has nothing that passed the second time."""
    run.take("west", 1, rows((1, 2), (3, 4), (5, 6), passed=[1.0, 1.0, 0.0]))
    run.take("west", 1, rows((3, 4), (1, 2), passed=[1.0, 0.0]))
    run.take("west", 1, rows((7, 8), passed=[0.0]))
    assert run.take("east", 1, rows(passed=[])) == [(1, 2), (3, 4), (7, 8)]
    run.take("west", 1, rows(passed=[]))
    assert run.take("east", 1, rows(passed=[])) == []


def test_topics_are_joined_each_by_itself(run: Run) -> None:
    run.take("west", 1, rows((1, 2)), topic="contacts")
    assert run.take("east", 1, rows()) is None
    assert run.take("east", 1, rows((3, 4)), topic="contacts") == [(1, 2), (3, 4)]


def test_several_rows_of_a_pair_stay_but_two_regions_that_report_it_are_counted(run: Run) -> None:
    run.take("west", 1, rows((1, 2), (1, 2)))
    assert run.take("east", 1, rows((1, 2), (3, 4))) == [(1, 2), (1, 2), (3, 4)]
    assert run.merger.repeated == 1
    run.take("west", 2, rows((1, 2), passed=[1.0]))
    assert run.take("east", 2, rows((1, 2), passed=[0.0])) == [(1, 2), (1, 2)]
    assert run.merger.repeated == 1  # passed and to come are two things


def test_a_silent_region_is_missing_after_the_timeout_and_back_one_timeout_after_it_is_right(
    run: Run,
) -> None:
    del run.objects["east"]
    assert run.wait(0.4) == {}
    assert run.wait(0.3) == {"east": "silent for 0.7 s"}
    assert run.take("east", 1, rows()) is None
    run.take("west", 1, rows((1, 2)))
    run.objects["east"] = 0
    assert run.wait(2.0) == {"east": "0 of 10 objects"}
    assert run.take("east", 1, rows()) is None
    run.objects["east"] = 10
    assert run.wait(0.4) == {"east": "back for 0.3 s"}
    assert run.take("east", 1, rows()) is None  # may be of before it had all objects
    assert run.wait(0.3) == {}
    assert run.take("east", 1, rows()) == [(1, 2)]


def test_objects_that_come_and_go_make_no_region_missing(run: Run) -> None:
    for count in (20, 5, 12, 13, 0, 40):
        run.objects["west"] = count
        assert run.wait(0.1) == {}
        run.objects["east"] = count
        assert run.wait(0.2) == {}
    run.objects["west"] = 41
    assert run.wait(0.8) == {"east": "40 of 41 objects"}


def test_rows_without_objects_unknown_regions_and_bad_names_are_refused(run: Run) -> None:
    with pytest.raises(ValueError, match="rows must be"):
        run.merger.take("west", 1, np.zeros(2), run.now)
    with pytest.raises(KeyError, match="no region named 'north'"):
        run.merger.mark_alive("north", 1, run.now)
    for wrong in ([], ["a", "a"], [""]):
        with pytest.raises(ValueError, match="regions"):
            oc.regions.RegionMerger(wrong)
    with pytest.raises(ValueError, match="timeout"):
        oc.regions.RegionMerger(["a"], 0.0)


def test_stamps_that_never_become_complete_take_bounded_room(run: Run) -> None:
    for stamp in range(1000):
        assert run.take("west", stamp, rows()) is None
    assert run.take("east", 0, rows()) is None
    assert run.take("east", 999, rows()) == []
