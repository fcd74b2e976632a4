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

"""Pairs of the Panda and of the UR5 are decided, where example-robot-data is installed."""

from __future__ import annotations

import importlib.metadata
from pathlib import Path

import numpy as np
import pytest
from each import each

import obb_collision as oc

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
