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

"""Reading the description of a robot beside the cycles."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock, Thread
from typing import Protocol

from obb_collision.node.runtime.guard import INTERNAL_ERROR
from obb_collision.robots.description.robot import Robot

ENDING = 2.0
"""Seconds to wait at the end for the thread."""


class Reading(Protocol):
    """One description being read."""

    def read(self, urdf: str, srdf: str | None) -> Robot:
        """Return the robot; ValueError with the reason where there is none."""

    def abandon(self) -> None:
        """Let ``read`` end soon, whatever it returns or raises; at once, from any thread."""


Begin = Callable[[], Reading]


class DescriptionReader:
    """Makes robots in a thread, the newest description only: meshes may take minutes to read."""

    def __init__(self, begin: Begin) -> None:
        self._begin = begin
        self._reading: Reading | None = None
        self._lock = Lock()
        self._wanted: tuple[str, str | None] | None = None
        self._found: Robot | str | None = None
        self._thread: Thread | None = None

    @property
    def is_reading(self) -> bool:
        """Whether a description is being read, or what came of it was not taken yet."""
        with self._lock:
            return self._thread is not None or self._found is not None

    def request(self, urdf: str, srdf: str | None) -> None:
        """Read a description, in place of one that waits or is being read."""
        with self._lock:
            self._wanted, self._found = (urdf, srdf), None
            if self._reading is not None:
                self._reading.abandon()
            if self._thread is None:
                thread = Thread(target=self._work, name="robot_description", daemon=True)
                try:
                    thread.start()
                except RuntimeError as error:  # no memory for another one
                    self._wanted, self._found = None, f"{INTERNAL_ERROR}: {error}"
                else:
                    self._thread = thread

    def take(self) -> Robot | str | None:
        """Return the robot, or why there is none, once; None where nothing is new."""
        with self._lock:
            found, self._found = self._found, None
            return found

    def close(self) -> None:
        """End what is being read."""
        with self._lock:
            self._wanted, thread = None, self._thread
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
                        self._thread = None
                        return
                    reading = self._reading = self._begin()
                found = reading.read(*wanted)
            except ValueError as error:
                found = str(error)
            except Exception as error:
                found = f"{INTERNAL_ERROR}: {type(error).__name__}: {error}"
            with self._lock:
                self._reading = None
                if self._wanted is None:
                    self._found = found
