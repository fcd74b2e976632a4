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

"""Shapes that are built only when a test says so."""

from __future__ import annotations

import threading

from rig import PATIENCE, Rig

from obb_collision.scene.building.jobs import Task, perform
from obb_collision.scene.building.process import Limits


class Gate:
    """Holds up what is built by a node until it is opened; counts the jobs.

    They are done by the thread that waits for them elsewhere: no process is started.
    """

    def __init__(self, rig: Rig, trees: bool = False) -> None:
        """Hold up shapes, or with ``trees`` the trees and hulls of shapes."""
        self.opened = threading.Event()
        self.jobs: list[str] = []
        objects = rig.node.objects
        builder = objects._tree_builder if trees else objects.shapes.builder
        builder.process.run = self.run  # type: ignore[method-assign]

    def run(self, task: Task, limits: Limits) -> object:
        assert self.opened.wait(PATIENCE)
        self.jobs.append(task[0].__name__)
        return perform(task)

    def open(self) -> None:
        self.opened.set()
