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
from functools import cache
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from kinematics_oracle import OracleJoint, joint_trees, link_matrices, written
from small_robots import joint, link, urdf

import obb_collision as oc
from obb_collision.robots.proofs.proved_pairs import PairProof
from obb_collision.robots.srdf_command import main, srdf_text

CONFIG = Path(__file__).parents[3] / "config"
RADIUS = 0.15
BALL = f'<sphere radius="{RADIUS}"/>'
SAMPLES = 2000
KINDS = ("revolute", "continuous", "prismatic", "fixed")


def robot_of(joints: list[OracleJoint]) -> oc.Robot:
    """Return a robot of balls."""
    limit = '<limit lower="-0.7" upper="1.1" velocity="1" effort="1"/>'
    lines = [link(str(k), BALL) for k in range(len(joints) + 1)]
    return oc.Robot.from_urdf(urdf(*lines, *(written(one, limit) for one in joints)))


def distance(
    robot: oc.Robot, joints: list[OracleJoint], state: np.ndarray, pair: tuple[str, str]
) -> float:
    """Return how far two balls are apart, by 4x4 matrices."""
    places = link_matrices(joints, dict(zip(robot.joint_names, state.tolist(), strict=True)))
    a, b = (places[name][:3, 3] for name in pair)
    return float(np.linalg.norm(a - b)) - 2.0 * RADIUS


@given(joint_trees(KINDS, 6, 2, 0.6), st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_no_random_state_contradicts_a_proof(joints: list[OracleJoint], seed: int) -> None:
    robot = robot_of(joints)
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
            assert distance(robot, joints, states[gaps.argmin()], proof.links) > 0.0
        elif proof.verdict == "always":
            assert gaps.max() < 0.0
        elif proof.verdict == "can collide":
            assert proof.witness is not None
            assert (proof.witness >= lower).all()
            assert (proof.witness <= upper).all()
            assert distance(robot, joints, proof.witness, proof.links) < 1e-9
        elif proof.verdict == "adjacent":
            assert proof.links in robot.adjacent_pairs


def proved(robot: oc.Robot, time_limit: float = 20.0) -> dict[tuple[str, str], PairProof]:
    return {proof.links: proof for proof in robot.prove_pairs(time_limit)}


@cache
def proofs_of_the_arm() -> dict[tuple[str, str], PairProof]:
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


def test_no_state_of_the_arm_contradicts_its_srdf() -> None:
    others = [proof for proof in proofs_of_the_arm().values() if proof.verdict != "never"]
    elements = ['<disable_collisions link1="{}" link2="{}"/>'.format(*one.links) for one in others]
    robot = oc.Robot.from_urdf(CONFIG / "arm.urdf", urdf(*elements))
    states = np.random.default_rng(3).uniform(robot.lower, robot.upper, (100_000, 7))
    assert oc.RobotScene([robot]).check(states).valid.all()


def line_of(*places: float, kind: str = "revolute") -> oc.Robot:
    """Return balls in a row along x, joints between them that turn about z."""
    names = "abcdefgh"[: len(places) + 1]
    lines = [link(name, BALL) for name in names]
    for (one, other), place in zip(pairwise(names), places, strict=True):
        inner = f'<origin xyz="{place} 0 0"/><axis xyz="0 0 1"/>'
        limit = '<limit lower="-0.5" upper="0.5" velocity="1" effort="1"/>'
        lines.append(joint(one + other, kind, one, other, inner + limit))
    return oc.Robot.from_urdf(urdf(*lines))


def test_links_that_overlap_in_every_state_collide_always() -> None:
    proofs = proved(line_of(0.05, 0.05))
    assert proofs["a", "c"].verdict == "always"
    assert proved(line_of(0.05, 0.05, kind="fixed"))["a", "c"].verdict == "always"


def test_links_that_do_not_move_against_each_other_are_decided_at_once() -> None:
    proofs = proved(line_of(0.2, 0.2, kind="fixed"))
    assert proofs["a", "c"].verdict == "never"
    assert proofs["a", "c"].cells == 1


@each("gap", [1e-2, 1e-4, 1e-6])
def test_small_gaps_are_proved(gap: float) -> None:
    """At an angle of the middle one, the outer two of three balls are 0.62 cos(angle / 2) apart."""
    angle = float(2.0 * np.arccos((2.0 * RADIUS + gap) / 0.62))

    def robot(upper: float) -> oc.Robot:
        inner = f'<origin xyz="0.31 0 0"/><axis xyz="0 0 1"/><limit upper="{upper!r}"/>'
        joints = [joint(a + b, "revolute", a, b, inner) for a, b in ("ab", "bc")]
        return oc.Robot.from_urdf(urdf(*(link(name, BALL) for name in "abc"), *joints))

    proof = proved(robot(angle))["a", "c"]
    assert proof.verdict == "never"
    assert proof.cells < 1000
    assert proved(robot(angle + 8.0 * gap))["a", "c"].verdict == "can collide"


def test_what_has_no_bounds_is_undecided() -> None:
    for kind in ("planar", "floating"):
        proof = proved(line_of(0.5, 0.5, kind=kind))["a", "c"]
        assert (proof.verdict, proof.witness) == ("undecided", None)


def test_joints_without_limits_turn_once_around() -> None:
    assert proved(line_of(0.5, 0.15, kind="continuous"))["a", "c"].verdict == "never"
    assert proved(line_of(0.5, 0.25, kind="continuous"))["a", "c"].verdict == "can collide"


def test_time_that_is_up_leaves_pairs_undecided() -> None:
    robot = oc.Robot.from_urdf(CONFIG / "arm.urdf")
    verdicts = {proof.verdict for proof in robot.prove_pairs(1e-9)}
    assert verdicts <= {"adjacent", "can collide", "undecided"}
    assert "undecided" in verdicts


def test_progress_is_told_once_a_pair() -> None:
    seen: list[PairProof] = []
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
        ([str(tmp_path / "none")], "no such file"),
        ([str(CONFIG / "arm.urdf"), "--srdf", str(tmp_path)], "no regular file"),
    ):
        assert main(arguments) == 1
        printed, told = capsys.readouterr()
        assert printed == ""
        assert told.startswith("obb_collision srdf: ")
        assert reason in told
        assert told.count("\n") == 1


try:
    FILES = importlib.metadata.files("example-robot-data") or []
except importlib.metadata.PackageNotFoundError:
    pytest.skip("example-robot-data is not installed", allow_module_level=True)
#: Seconds per robot; both take about one.
PATIENCE = 60.0
STATES = 200_000


@each("name", ["panda.urdf", "ur5_joint_limited_robot.urdf"])
def test_all_pairs_are_decided_and_none_is_contradicted(name: str) -> None:
    file = next(Path(str(file.locate())).resolve() for file in FILES if file.name == name)
    share = next(folder for folder in file.parents if folder.name == "share")
    proofs = oc.Robot.from_urdf(file, package_dirs=[share]).prove_pairs(PATIENCE)
    assert all(proof.verdict != "undecided" for proof in proofs)
    others = "".join(
        '<disable_collisions link1="{}" link2="{}"/>'.format(*proof.links)
        for proof in proofs
        if proof.verdict != "never"
    )
    robot = oc.Robot.from_urdf(file, f'<robot name="r">{others}</robot>', [share])
    random = np.random.default_rng(11)
    states = random.uniform(robot.lower, robot.upper, (STATES, len(robot.lower)))
    assert oc.RobotScene([robot]).check(states).valid.all()
