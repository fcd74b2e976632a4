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

"""Waiting for what a builder builds, without looking again and again."""

from __future__ import annotations

import threading
from typing import Any

from obb_collision.scene.building.builder import Builder, Outcome
from obb_collision.scene.building.jobs import Job

PATIENCE = 120.0
"""Seconds that building may take on a loaded machine."""


class Turn:
    """A job that is nothing: when its turn comes, all that was requested before is done."""

    size = 0

    def __init__(self) -> None:
        self.came = threading.Event()

    def task(self) -> None:
        """Be done here, by ``finish``."""
        self.came.set()

    def finish(self, result: None) -> None:
        """Return nothing."""


def wait_built(builder: Builder) -> None:
    """Wait until all that was requested so far is done, and can be polled."""
    turn = Turn()
    builder.request(turn, turn, turn)
    assert turn.came.wait(PATIENCE), "nothing is built"
    builder.cancel(turn)


def outcomes(builder: Builder) -> list[Outcome]:
    """Return the outcomes of all that was requested so far, in the order in which they came."""
    wait_built(builder)
    return builder.poll()


def build(builder: Builder, job: Job) -> Any:
    """Return what a job gives, or raise why it gives nothing."""
    builder.request("key", object(), job)
    (outcome,) = outcomes(builder)
    if outcome.error is not None:
        raise outcome.error
    return outcome.result
