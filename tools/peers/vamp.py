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

"""VAMP's Panda, compiled by its own headers: motions sampled at 32 states per rad.

Nothing of it is here: a checkout of github.com/KavrakiLab/vamp is needed, Eigen and g++. Its links
are 59 spheres in single precision, eight states at once.
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from obb_collision.geometry.poses import matrices_from_quaternions
from obb_collision.robots.robot import Robot
from obb_collision.scene_files.description import SceneObject
from obb_collision.shapes import Box
from obb_collision.typing import Floats, Mask

SOURCE = Path(__file__).parent / "vamp"
FLAGS = "-std=c++17", "-O3", "-mavx2", "-mfma", "-w"
EIGEN = Path("/usr/include/eigen3")
JOINTS = [f"panda_joint{number}" for number in range(1, 8)]


class Vamp:
    """The program, compiled into a folder against a checkout."""

    def __init__(self, checkout: Path, robot: Robot, folder: Path) -> None:
        if not set(JOINTS) <= set(robot.joint_names):
            raise ValueError("--vamp needs the robot to be the Panda")
        compiler = shutil.which("g++")
        if compiler is None or not EIGEN.is_dir():
            raise ValueError(f"--vamp needs g++, and Eigen in {EIGEN}")
        self._columns = [robot.joint_names.index(name) for name in JOINTS]
        self._program, self._question = folder / "motions", folder / "question"
        folders = (f"-I{folder}" for folder in (SOURCE, checkout / "src/impl", EIGEN))
        command = [compiler, *FLAGS, *folders, str(SOURCE / "main.cpp"), "-o", str(self._program)]
        try:
            subprocess.run(command, check=True, capture_output=True, text=True)
        except subprocess.CalledProcessError as error:
            raise ValueError(f"VAMP does not compile: {error.stderr[:400]}") from error

    def check(
        self, objects: Sequence[SceneObject], starts: Floats, ends: Floats, rounds: int
    ) -> tuple[float, Mask]:
        """Return the least processor time of all motions (s), and which of them are free (n,)."""
        boxes = np.empty((len(objects), 15))
        for row, one in zip(boxes, objects, strict=True):
            if not isinstance(one.shape, Box):
                raise ValueError(f"{one.name} is no box")
            turn = matrices_from_quaternions(np.array([one.pose[3:]]))[0]
            row[:] = *one.pose[:3], *turn.T.ravel(), *(0.5 * np.asarray(one.shape.size))
        with self._question.open("wb") as opened:
            opened.write(np.array([len(boxes), len(starts)], "<i8").tobytes())
            for numbers in (boxes, starts[:, self._columns], ends[:, self._columns]):
                opened.write(numbers.astype("<f4").tobytes())
        answer = subprocess.check_output([self._program, self._question, str(rounds)])
        return float(np.frombuffer(answer, "<f8", 1)[0]), np.frombuffer(answer, np.bool_, offset=8)
