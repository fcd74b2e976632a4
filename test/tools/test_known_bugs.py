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

"""Bugs of others as named tests, with exact answers by an oracle that shares no code."""

from __future__ import annotations

import math
from fractions import Fraction
from pathlib import Path
from typing import Any

import distances
import numpy as np
import oracle
import pytest
from each import each

import obb_collision as oc
from tools import known_bugs
from tools.known_bugs import KNOWN_BUGS, PAIR_PEERS, Answer, KnownBug, PlacedBox

BUGS = {bug.name: bug for bug in KNOWN_BUGS}
BOXES = {
    f"{bug.name} {k}": (a, b, distance)
    for bug in KNOWN_BUGS
    for k, ((a, b), distance) in enumerate(zip(bug.pairs, bug.distances, strict=True))
    if isinstance(a, PlacedBox) and isinstance(b, PlacedBox)
}


def exact(points: Any) -> list[list[Fraction]]:
    return [[Fraction(float(x)) for x in point] for point in points]


@each("name", BOXES)
def test_the_distances_of_boxes_are_exact(name: str) -> None:
    a, b, distance = BOXES[name]
    verdict = oracle.verdict(a, b)
    if distance > 0.0:
        assert verdict == oc.Verdict.SEPARATE
        gap = distances.root(distances.squared_distance(distances.box(a), distances.box(b)))
        assert gap == pytest.approx(distance, rel=1e-12)
    else:
        assert verdict == oc.Verdict.OVERLAP
        assert oracle.separations(*([np.array([x]) for x in box] for box in (a, b)))[
            0
        ] == pytest.approx(distance, rel=1e-12)


@each("name", BOXES)
def test_this_library_is_right_about_boxes(name: str) -> None:
    a, b, distance = BOXES[name]
    one, two = (oc.Boxes([x.center], [x.rotation], [x.half_extents]) for x in (a, b))
    for x, y in ((one, two), (two, one)):
        verdict = oc.verdicts(x, y, exact=True)[0]
        assert verdict == (oc.Verdict.SEPARATE if distance > 0.0 else oc.Verdict.OVERLAP)
        assert oc.verdicts(x, y)[0] in (verdict, oc.Verdict.TOUCHING), "doubles may not decide it"
        found = oc.clearances(x, y, max_distance=1.0).distances[0]
        assert found == pytest.approx(
            distance, rel=1e-9, abs=1e-14 * np.abs(a.center).max() + 1e-16
        )
    depths = oc.contacts(one, two).depths
    assert (depths <= max(0.0, -distance) + 1e-12).all(), "no contact is deeper than the boxes"


def test_the_convex_meshes_are_apart_by_what_a_plane_proves() -> None:
    bug = BUGS["mujoco#3383"]
    for (a, b), least in zip(bug.pairs, bug.distances, strict=True):
        gap = min(x for x, _, _ in exact(b)) - max(x for x, _, _ in exact(a))
        assert float(gap) == pytest.approx(least, rel=1e-12)
        assert gap > 0
        assert not known_bugs.ours(a, b).collides


def test_the_cubes_have_a_common_point() -> None:
    """The middle of the second one's corners is inside the first one, which is aligned."""
    ((a, b),) = BUGS["openGJK#13"].pairs
    middle = [sum(column) / 8 for column in zip(*exact(b), strict=True)]
    edge = max(map(max, exact(a)))
    assert all(abs(x) < edge for x in middle)
    assert known_bugs.ours(a, b).collides
    assert known_bugs.ours(b, a).collides


def test_the_depth_of_the_cubes_is_that_of_boxes() -> None:
    bug = BUGS["coal#823"]
    ((a, b),) = bug.pairs
    assert known_bugs.ours(a, b).collides
    assert known_bugs.ours(a, b).distance == pytest.approx(-0.5, abs=1e-8)
    one, two = (oc.OBB.from_points(x, fit="aabb") for x in (a, b))
    assert one.separation(two)[0] == bug.distances[0] == -0.5


@each(
    "answer, distance, wrong",
    [
        (Answer(True, -0.5), -0.5, ""),
        (Answer(True, math.nan), -0.5, ""),
        (Answer(True, -9.0), math.nan, ""),
        (Answer(False, 0.5), -0.5, "says apart"),
        (Answer(True, 0.0), 0.5, "says colliding"),
        (Answer(True, -0.6), -0.5, "distance -0.6"),
        (Answer(False, -1e-16), 1e-16, "contradicts itself: apart, -1e-16 m"),
    ],
)
def test_answers_are_judged(answer: Answer, distance: float, wrong: str) -> None:
    bug = KnownBug("", "", "", "")
    assert known_bugs.fault(answer, distance, bug) == wrong


def test_exceptions_are_answers_and_missing_peers_are_not(tmp_path: Path) -> None:
    lines = known_bugs.table([peer for peer in PAIR_PEERS if peer.version() is not None])
    assert [line[2] for line in lines[1:]] == ["right"] * 7 + ["\u2013"] + ["right"] * 2
    text = known_bugs.page(lines)
    assert all(bug.url in text and bug.report in text for bug in KNOWN_BUGS)


def test_the_command_writes_the_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert known_bugs.main(["--markdown", str(tmp_path / "page.md")]) == 0
    written = (tmp_path / "page.md").read_text(encoding="utf-8")
    page = (Path(__file__).parents[2] / "docs" / "known_bugs.md").read_text(encoding="utf-8")
    introduction = known_bugs.INTRODUCTION
    assert written.startswith(introduction)
    assert page.startswith(introduction), "write the page anew"
    assert "this library: right" in capsys.readouterr().out
