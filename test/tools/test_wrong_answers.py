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

"""The table of wrong answers counts right, and what it takes for the truth is the truth."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import oracle
import pytest
from each import each
from support import family, stored

from obb_collision import Boxes, Verdict
from obb_collision.queries.verdict import Verdicts
from tools import wrong_answers
from tools.cases.families import FAMILIES, generate


@each("name", FAMILIES)
def test_labels_are_those_of_the_oracle(name: str) -> None:
    """The command labels every pair by the library's integers; here is why it may."""
    a, b = family(name, 300, seed=7)
    np.testing.assert_array_equal(
        wrong_answers.exact_verdicts(a, b), oracle.verdicts(stored(a), stored(b))
    )


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


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "counts.json"
    arguments = ["--pairs", "30", "--seed", "3", "--markdown", "--json", str(file)]
    assert wrong_answers.main(arguments) == 0
    printed = capsys.readouterr().out
    report = json.loads(file.read_text())
    assert [row["family"] for row in report["families"]] == list(FAMILIES)
    for row in report["families"]:
        assert row["family"] in printed
        assert sum(row["truth"].values()) == row["pairs"] == 30
        assert {"default_false", "default_missed", "exact_wrong"} <= row["own"].keys()


def test_one_family_by_part_of_its_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert wrong_answers.main(["--pairs", "20", "--family", "resting"]) == 0
    assert "edge against edge" not in capsys.readouterr().out
    with pytest.raises(SystemExit):
        wrong_answers.main(["--family", "no such family"])


def test_a_missing_peer_is_said(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    missing = wrong_answers.Peer("nobody", "no-such-distribution", "no_such_module", _never, "")
    monkeypatch.setattr(wrong_answers, "PEERS", (missing,))
    assert wrong_answers.main(["--pairs", "5", "--family", "ordinary"]) == 0
    assert "nobody: not installed" in capsys.readouterr().out


def _never(module: object) -> wrong_answers.Judge:
    raise AssertionError(module)


def test_a_wrong_verdict_fails_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    def careless(a: Boxes, b: Boxes, exact: bool = False) -> Verdicts:
        return np.full(len(a), Verdict.OVERLAP, np.int8)

    monkeypatch.setattr(wrong_answers, "verdicts", careless)
    assert wrong_answers.main(["--pairs", "20", "--family", "ordinary"]) == 1


@pytest.mark.parametrize("peer", wrong_answers.PEERS, ids=lambda peer: peer.name)
def test_judges_are_right_where_it_is_easy(peer: wrong_answers.Peer) -> None:
    """A column of wrong answers must not come from asking a peer the wrong way."""
    judge = peer.judge()
    if judge is None:
        pytest.skip(f"{peer.name} is not installed")
    for ask in (judge, wrong_answers.textbook):
        for name in ("ordinary scene", "each of the 15 axes alone"):
            a, b = generate(name, 300, seed=1)
            gaps = oracle.relative_separations(a, b)
            clear = np.abs(gaps) > 1e-4
            assert clear.sum() > 50
            np.testing.assert_array_equal(
                ask(a, b)[clear] == wrong_answers.COLLIDING, gaps[clear] < 0.0
            )


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
