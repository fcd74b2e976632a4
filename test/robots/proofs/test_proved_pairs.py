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

"""Pairs of links that are proved to be apart or to collide always, also of real robots."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Iterable
from functools import cache
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from kinematics_oracle import OracleJoint, joint_trees, link_matrices, written
from small_robots import joint, link, urdf

import obb_collision as oc
from obb_collision.robots.srdf_command import main, srdf_text

CONFIG = Path(__file__).parents[3] / "config"
RADIUS = 0.15
BALL = f'<sphere radius="{RADIUS}"/>'
SAMPLES = 2000
KINDS = ("revolute", "continuous", "prismatic", "fixed")


@given(joint_trees(KINDS, 6, 2, 0.6), st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_no_random_state_contradicts_a_proof(joints: list[OracleJoint], seed: int) -> None:
    """Of robots of balls."""
    limit = '<limit lower="-0.7" upper="1.1" velocity="1" effort="1"/>'
    lines = [link(str(k), BALL) for k in range(len(joints) + 1)]
    robot = oc.Robot.from_urdf(urdf(*lines, *(written(one, limit) for one in joints)))

    def distance(state: np.ndarray, pair: tuple[str, str]) -> float:
        """Return how far two balls are apart, by 4x4 matrices."""
        places = link_matrices(joints, dict(zip(robot.joint_names, state.tolist(), strict=True)))
        a, b = (places[name][:3, 3] for name in pair)
        return float(np.linalg.norm(a - b)) - 2.0 * RADIUS

    proofs = robot.prove_pairs(2.0)
    assert [proof.links for proof in proofs] == [
        (min(a, b), max(a, b)) for a, b in combinations(robot.link_names, 2)
    ]
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    states = np.random.default_rng(seed).uniform(lower, upper, (SAMPLES, len(lower)))
    poses = robot.link_poses(states)  # equal to the oracle's, see ``test_kinematics``
    for proof in proofs:
        a, b = (robot.link_names.index(name) for name in proof.links)
        gaps = np.linalg.norm(poses[:, a, :3] - poses[:, b, :3], axis=1) - 2.0 * RADIUS
        if proof.verdict == "never":
            assert gaps.min() > 0.0
            assert distance(states[gaps.argmin()], proof.links) > 0.0
        elif proof.verdict == "always":
            assert gaps.max() < 0.0
        elif proof.verdict == "can collide":
            assert proof.witness is not None
            assert (proof.witness >= lower).all()
            assert (proof.witness <= upper).all()
            assert distance(proof.witness, proof.links) < 1e-9
        elif proof.verdict == "adjacent":
            assert proof.links in robot.adjacent_pairs


def proved(robot: oc.Robot, time_limit: float = 20.0) -> dict[tuple[str, str], Any]:
    return {proof.links: proof for proof in robot.prove_pairs(time_limit)}


@cache
def proofs_of_the_arm() -> dict[tuple[str, str], Any]:
    return proved(oc.Robot.from_urdf(CONFIG / "arm.urdf"))


def test_the_arm_is_decided_and_its_srdf_has_just_these_pairs() -> None:
    robot = oc.Robot.from_urdf(CONFIG / "arm.urdf", CONFIG / "arm.srdf")
    proofs = proofs_of_the_arm()
    assert len(proofs) == 36
    verdicts = {proof.verdict for proof in proofs.values()}
    assert verdicts == {"adjacent", "never", "can collide"}
    unchecked = {links for links, proof in proofs.items() if proof.verdict != "can collide"}
    assert robot.disabled_pairs == unchecked
    checked = oc.RobotScene([robot])
    for proof in proofs.values():
        if proof.witness is not None:
            found = checked.check(proof.witness[None], all_pairs=True)
            assert not found.valid[0]
            assert not found.out_of_limits.any()


def no_state_contradicts(proofs: Iterable[Any], file: Path, count: int, *more: Any) -> None:
    """Assert that links which never collide do not in so many states; more: of the robot."""
    others = [proof for proof in proofs if proof.verdict != "never"]
    elements = ['<disable_collisions link1="{}" link2="{}"/>'.format(*one.links) for one in others]
    named = urdf(*elements).replace('"r"', f'"{oc.Robot.from_urdf(file, None, *more).name}"')
    robot = oc.Robot.from_urdf(file, named, *more)
    states = np.random.default_rng(3).uniform(robot.lower, robot.upper, (count, len(robot.lower)))
    assert oc.RobotScene([robot]).check(states).valid.all()


def test_no_state_of_the_arm_contradicts_its_srdf() -> None:
    no_state_contradicts(proofs_of_the_arm().values(), CONFIG / "arm.urdf", 100_000)


def line_of(*places: float, kind: str = "revolute") -> oc.Robot:
    """Return balls in a row along x, joints between them that turn about z."""
    names = "abcdefgh"[: len(places) + 1]
    lines = [link(name, BALL) for name in names]
    for (one, other), place in zip(pairwise(names), places, strict=True):
        inner = f'<origin xyz="{place} 0 0"/><axis xyz="0 0 1"/>'
        limit = '<limit lower="-0.5" upper="0.5" velocity="1" effort="1"/>'
        lines.append(joint(one + other, kind, one, other, inner + limit))
    return oc.Robot.from_urdf(urdf(*lines))


@each("places, kind, verdict", [
    ((0.05, 0.05), "revolute", "always"), ((0.05, 0.05), "fixed", "always"),
    ((0.2, 0.2), "fixed", "never"), ((0.5, 0.5), "planar", "undecided"),
    ((0.5, 0.5), "floating", "undecided"),  # which have no bounds
    ((0.5, 0.15), "continuous", "never"), ((0.5, 0.25), "continuous", "can collide"),
])  # fmt: skip
def test_balls_in_a_row_are_decided(places: tuple[float, ...], kind: str, verdict: str) -> None:
    """Joints without limits turn once around; what does not move is decided at once."""
    proof = proved(line_of(*places, kind=kind))["a", "c"]
    assert proof.verdict == verdict
    assert proof.witness is None or verdict != "undecided"
    assert proof.cells == 1 or (kind, verdict) != ("fixed", "never")


@each("gap", [1e-2, 1e-4, 1e-6])
def test_small_gaps_are_proved(gap: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """At an angle of the middle one, the outer two of three balls are 0.62 cos(angle / 2) apart."""
    angle = float(2.0 * np.arccos((2.0 * RADIUS + gap) / 0.62))

    def robot(upper: float) -> oc.Robot:
        inner = f'<origin xyz="0.31 0 0"/><axis xyz="0 0 1"/><limit upper="{upper!r}"/>'
        joints = [joint(a + b, "revolute", a, b, inner) for a, b in ("ab", "bc")]
        return oc.Robot.from_urdf(urdf(*(link(name, BALL) for name in "abc"), *joints))

    proof = proved(robot(angle))["a", "c"]
    assert proof.verdict == "never"
    assert proof.cells < 1000
    for _ in range(2):
        assert proved(robot(angle + 8.0 * gap))["a", "c"].verdict == "can collide"
        # what a descent finds first the search finds, too, and proves nothing else
        monkeypatch.setattr(
            "obb_collision.robots.proofs.proved_pairs.descend_from", lambda *_: False
        )


def test_time_that_is_up_leaves_pairs_undecided_and_progress_is_told_once_a_pair() -> None:
    seen: list[Any] = []
    proofs = oc.Robot.from_urdf(CONFIG / "arm.urdf").prove_pairs(1e-9)
    assert {proof.verdict for proof in proofs} <= {"adjacent", "can collide", "undecided"}
    assert "undecided" in {proof.verdict for proof in proofs}
    proofs = line_of(0.31, 0.31).prove_pairs(5.0, seen.append)
    assert sorted(proof.links for proof in seen) == [proof.links for proof in proofs]


def test_an_srdf_is_written_that_reads_as_it_was_proved() -> None:
    robot = oc.Robot.from_urdf(CONFIG / "arm.urdf")
    proofs = list(proofs_of_the_arm().values())
    unchecked = {proof.links for proof in proofs if proof.verdict in ("never", "adjacent")}
    again = oc.Robot.from_urdf(CONFIG / "arm.urdf", srdf_text(robot, proofs))
    assert again.disabled_pairs == unchecked
    given = (CONFIG / "arm.srdf").read_bytes()
    kept = oc.Robot.from_urdf(CONFIG / "arm.urdf", srdf_text(robot, proofs[:3], given))
    assert kept.disabled_pairs == {proof.links for proof in proofs[:3]} & unchecked
    assert set(kept.groups) == {"arm", "gripper", "all"}


def test_names_that_mean_something_in_xml_are_written_as_they_are() -> None:
    name = "&lt;&quot;&amp;'"
    text = urdf(link(name, BALL), link("b", BALL), joint("j", "fixed", name, "b", ""))
    robot = oc.Robot.from_urdf(text)
    again = oc.Robot.from_urdf(text, srdf_text(robot, robot.prove_pairs(1.0)))
    assert again.disabled_pairs == {("<\"&'", "b")}
    assert again.doubts == ()


def test_it_writes_the_srdf_and_the_report(tmp_path: Path) -> None:
    out, report = tmp_path / "arm.srdf", tmp_path / "report.txt"
    urdf, given = CONFIG / "arm.urdf", CONFIG / "arm.srdf"
    assert main([str(urdf), "-o", str(out), "--srdf", str(given), "--report", str(report)]) == 0
    robot, before = (oc.Robot.from_urdf(urdf, srdf) for srdf in (out, given))
    assert robot.disabled_pairs == before.disabled_pairs
    assert robot.groups == before.groups
    lines = report.read_text().splitlines()
    assert "base - upper_arm: never" in lines[1]
    assert "base - forearm: can collide, as at turn" in lines[2]
    assert lines[-1] == "36 pairs: 8 adjacent, 16 never, 12 can collide"


def test_it_prints_the_srdf_by_itself(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(CONFIG / "arm.urdf")]) == 0
    printed, told = capsys.readouterr()
    robot = oc.Robot.from_urdf(CONFIG / "arm.urdf", printed)
    assert len(robot.disabled_pairs) == 24
    assert told.endswith("36 pairs: 8 adjacent, 16 never, 12 can collide\n")


def test_bad_files_are_said_in_a_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad = tmp_path / "bad.urdf"
    bad.write_text('<robot name="r">\n<link/></robot>')
    for arguments, reason in (
        ([str(bad)], "bad.urdf:2: link of robot 'r': its name is missing"),
        ([str(tmp_path / "none")], "does not exist"),
        ([str(CONFIG / "arm.urdf"), "--srdf", str(tmp_path)], "not a regular file"),
    ):
        assert main(arguments) == 1
        printed, told = capsys.readouterr()
        assert printed == ""
        assert told.startswith("obb_collision srdf: ")
        assert reason in told
        assert told.count("\n") == 1


@each("name", ["panda.urdf", "ur5_joint_limited_robot.urdf"])
def test_all_pairs_are_decided_and_none_is_contradicted(name: str) -> None:
    try:
        files = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("example-robot-data is not installed")
    file = next(Path(str(file.locate())).resolve() for file in files if file.name == name)
    share = next(folder for folder in file.parents if folder.name == "share")
    proofs = oc.Robot.from_urdf(file, package_dirs=[share]).prove_pairs(60.0)  # it takes about one
    assert all(proof.verdict != "undecided" for proof in proofs)
    no_state_contradicts(proofs, file, 200_000, [share])
