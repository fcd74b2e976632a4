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


"""Descriptions of robots being read, in a thread: meshes may take minutes."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock, Thread

from obb_collision.node.runtime.guard import INTERNAL_ERROR
from obb_collision.robots.robot import Robot
from obb_collision.scene_files.mesh_files import MeshReading

ENDING = 2.0
"""Seconds to wait at the end for the thread."""


class RobotReading:
    """A robot being made of its description, the meshes read in another process."""

    def __init__(self, meshes: MeshReading) -> None:
        self._meshes = meshes

    def read(self, urdf: str, srdf: str | None) -> Robot:
        """Return the robot; ValueError with the reason where there is none."""
        try:
            return Robot.from_urdf(urdf, srdf, self._meshes.folders, read_mesh=self._meshes.read)
        finally:
            self._meshes.close()

    def abandon(self) -> None:
        """Let ``read`` end soon: a mesh that is being read is none. At once, from any thread."""
        self._meshes.abandon()


class DescriptionReader:
    """Makes robots in a thread, the newest description only: meshes may take minutes to read."""

    def __init__(self, begin: Callable[[], RobotReading]) -> None:
        self.begin = begin
        self._reading: RobotReading | None = None
        self._lock = Lock()
        self._wanted: tuple[str, str | None] | None = None
        self._found: Robot | str | None = None
        self.thread: Thread | None = None

    @property
    def is_reading(self) -> bool:
        """Whether a description is being read, or what came of it was not taken yet."""
        with self._lock:
            return self.thread is not None or self._found is not None

    def request(self, urdf: str, srdf: str | None) -> None:
        """Read a description, in place of one that waits or is being read."""
        with self._lock:
            self._wanted, self._found = (urdf, srdf), None
            if self._reading is not None:
                self._reading.abandon()
            if self.thread is None:
                thread = Thread(target=self._work, name="robot_description", daemon=True)
                try:
                    thread.start()
                except RuntimeError as error:  # no memory for another one
                    self._wanted, self._found = None, f"{INTERNAL_ERROR}: {error}"
                else:
                    self.thread = thread

    def take(self) -> Robot | str | None:
        """Return the robot, or why there is none, once; None where nothing is new."""
        with self._lock:
            found, self._found = self._found, None
            return found

    def close(self) -> None:
        """End what is being read."""
        with self._lock:
            self._wanted, thread = None, self.thread
            if self._reading is not None:
                self._reading.abandon()
        if thread is not None:
            thread.join(ENDING)

    def _work(self) -> None:
        while True:
            found: Robot | str
            try:
                with self._lock:
                    wanted, self._wanted = self._wanted, None
                    if wanted is None:
                        self.thread = None
                        return
                    reading = self._reading = self.begin()
                found = reading.read(*wanted)
            except ValueError as error:
                found = str(error)
            except Exception as error:
                found = f"{INTERNAL_ERROR}: {type(error).__name__}: {error}"
            with self._lock:
                self._reading = None
                if self._wanted is None:
                    self._found = found
