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

"""Wrong answers: tables of them, and bugs of others as named tests, by exact answers."""

from __future__ import annotations

import math
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import oracle
import pytest
from each import each
from exact_vectors import corners, root
from hull_distances import squared_distance
from support import family, stored

import obb_collision as oc
from obb_collision import Boxes, Verdict
from obb_collision.queries.verdict import Verdicts
from tools import known_bugs, wrong_answers
from tools.cases.families import FAMILIES, generate
from tools.known_bugs import KNOWN_BUGS, KnownBug
from tools.peers.pairs import PAIR_PEERS, Answer, PairPeer, PlacedBox


@each("name", FAMILIES)
def test_labels_are_those_of_the_oracle(name: str) -> None:
    """The command labels every pair by the library's integers; here is why it may."""
    a, b = family(name, 100, seed=7)
    truth = oracle.verdicts(stored(a), stored(b))
    np.testing.assert_array_equal(wrong_answers.exact_verdicts(a, b), truth)


def test_counting() -> None:
    truth = np.array([0, 0, 0, 1, 1, 1, 2, 2, 2], np.int8)
    given = np.array([0, 1, 2, 0, 1, 2, 0, 1, 2], np.int8)
    assert wrong_answers.count_own(truth, given, truth) == {
        "default_false": 2,  # OVERLAP said of a pair apart, and of one that touches
        "default_missed": 2,  # SEPARATE said of a pair that touches, and of one that overlaps
        "undecided": 2,
        "exact_wrong": 0,
    }
    assert wrong_answers.count_own(truth, truth, given)["exact_wrong"] == 6
    answers = np.array([0, 1, -1, 0, 1, -1, 0, 1, -1], np.int8)
    expected = {"false": 1, "missed": 2, "failed": 3}
    assert wrong_answers.count_judge(truth, answers) == expected


def test_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert wrong_answers.main(["--pairs", "30", "--seed", "3", "--markdown"]) == 0
    rows = [line.split(" | ") for line in capsys.readouterr().out.splitlines() if line[:1] == "|"]
    assert [row[0].removeprefix("| ") for row in rows[2:]] == list(FAMILIES)
    for _, truth, own, *_ in rows[2:]:
        assert sum(map(int, truth.split("/"))) == 30
        assert own == "0/0"


def test_a_missing_peer_is_said_and_a_wrong_verdict_fails_the_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    never = lambda *_: pytest.fail("it is asked")  # noqa: E731
    missing = PairPeer("nobody", "no-such-distribution", "no_such_module", never)
    monkeypatch.setattr(wrong_answers, "PEERS", (missing,))
    assert wrong_answers.main(["--pairs", "20", "--family", "ordinary"]) == 0
    assert "nobody: not installed" in capsys.readouterr().out

    def careless(a: Boxes, b: Boxes, exact: bool = False) -> Verdicts:
        return np.full(len(a), Verdict.OVERLAP, np.int8)

    monkeypatch.setattr(wrong_answers, "verdicts", careless)
    assert wrong_answers.main(["--pairs", "20", "--family", "ordinary"]) == 1


@pytest.mark.parametrize("peer", wrong_answers.PEERS, ids=lambda peer: peer.name)
def test_judges_are_right_where_it_is_easy(peer: PairPeer) -> None:
    """A column of wrong answers must not come from asking a peer the wrong way."""
    if peer.version() is None:
        pytest.skip(f"{peer.name} is not installed")
    for ask in (wrong_answers.judge_of(peer), wrong_answers.textbook):
        for name in ("ordinary scene", "each of the 15 axes alone"):
            a, b = generate(name, 300, seed=1)
            gaps = oracle.relative_separations(a, b)
            clear = np.abs(gaps) > 1e-4
            assert clear.sum() > 50
            collide = ask(a, b)[clear] == wrong_answers.COLLIDING
            np.testing.assert_array_equal(collide, gaps[clear] < 0.0)


def test_families_do_not_depend_on_one_another() -> None:
    for name in FAMILIES:
        for x, y in zip(generate(name, 50, 1), generate(name, 50, 1), strict=True):
            for left, right in zip(x, y, strict=True):
                np.testing.assert_array_equal(left, right)
        assert not np.array_equal(generate(name, 50, 1)[0][1], generate(name, 50, 2)[0][1])


def test_certified_verdicts_are_never_wrong_and_float32_is() -> None:
    sets = wrong_answers.pair_sets(60, 3, 200)
    rows = wrong_answers.measure_floats(sets, 0.0, lambda what: None)
    found = {(row.kernel, row.pairs_of): row for row in rows}
    for pairs in ("a scene", "100 km off", "hard pairs"):
        certified = found["certified float64", pairs]
        assert certified.false == certified.missed == 0
    assert found["plain float64", "hard pairs"].false > 0
    single = found["plain float32", "hard pairs"]
    assert single.missed > found["plain float64", "hard pairs"].missed == 0


def test_what_certainty_costs_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert wrong_answers.main(["--seconds", "0.001", "--pairs", "20"]) == 0
    assert capsys.readouterr().out.count("certified float64") == 3


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
def test_the_distances_of_boxes_are_exact_and_this_library_is_right_about_them(name: str) -> None:
    a, b, distance = BOXES[name]
    is_apart = distance > 0.0
    truth = oc.Verdict.SEPARATE if is_apart else oc.Verdict.OVERLAP
    assert oracle.verdict(a, b) == truth
    if is_apart:
        gap = float(root(squared_distance(corners(a), corners(b))))
    else:
        (gap,) = oracle.separations(*([np.array([x]) for x in box] for box in (a, b)))
    assert gap == pytest.approx(distance, rel=1e-12)
    one, two = (oc.Boxes([x.center], [x.rotation], [x.half_extents]) for x in (a, b))
    close = 1e-14 * np.abs(a.center).max() + 1e-16
    for x, y in ((one, two), (two, one)):
        assert oc.verdicts(x, y, exact=True)[0] == truth
        assert oc.verdicts(x, y)[0] in (truth, oc.Verdict.TOUCHING), "doubles may not decide it"
        found = oc.clearances(x, y, max_distance=1.0).distances[0]
        assert found == pytest.approx(distance, rel=1e-9, abs=close)
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


@each("collides, said, distance, wrong", [
    (True, -0.5, -0.5, ""), (True, math.nan, -0.5, ""), (True, -9.0, math.nan, ""),
    (False, 0.5, -0.5, "says apart"), (True, 0.0, 0.5, "says colliding"),
    (True, -0.6, -0.5, "distance -0.6"),
    (False, -1e-16, 1e-16, "contradicts itself: apart, -1e-16 m"),
])  # fmt: skip
def test_answers_are_judged(collides: bool, said: float, distance: float, wrong: str) -> None:
    bug = KnownBug("", "", "", "")
    assert known_bugs.fault(Answer(collides, said), distance, bug) == wrong


def test_exceptions_are_answers_and_missing_peers_are_not() -> None:
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
