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

"""Scenes that several tests make, and builders of their shapes."""

from __future__ import annotations

import gc
import threading
import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import obb_collision as oc
from obb_collision.geometry.trees import pool
from obb_collision.scene.building.builder import Builder, Outcome
from obb_collision.scene.building.jobs import Job
from obb_collision.typing import Floats


def random_poses(count: int, rng: np.random.Generator, spread: float) -> Floats:
    quaternions = Rotation.random(count, rng).as_quat()
    return np.concatenate([rng.uniform(-spread, spread, (count, 3)), quaternions], axis=1)


def at(x: float, y: float = 0.0, z: float = 0.0, w: float = 1.0) -> list[float]:
    """Return a pose without rotation."""
    return [x, y, z, 0.0, 0.0, 0.0, w]


def filled_scene(count: int, seed: int = 0) -> oc.Scene:
    rng = np.random.default_rng(seed)
    scene = oc.Scene()
    for k, pose in enumerate(random_poses(count, rng, 0.7 * count ** (1 / 3))):
        scene.add(f"box/{k}", oc.shapes.Box(rng.uniform(0.1, 1.5, 3)), pose)
    return scene


def builds(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, Any]]:
    """Return what is built from now on: each tree and hull by its kind, and of what it is made."""
    made: list[tuple[str, Any]] = []

    def count(name: str, build: Any) -> None:
        def counted(body: Any) -> Any:
            made.append((name, body))
            return build(body)

        monkeypatch.setattr(pool, name, counted)

    for name in ("mesh_tree", "box_tree", "hull_mesh", "box_corners"):
        count(name, getattr(pool, name))
    return made


def counted(monkeypatch: pytest.MonkeyPatch, owner: Any, name: str, of: int) -> list[int]:
    """Return the lengths of an argument, by its number, of all calls of a function from now on."""
    lengths: list[int] = []
    function = vars(owner)[name]

    def call(*given: Any, **more: Any) -> Any:
        lengths.append(len(given[of]))
        return function(*given, **more)

    monkeypatch.setattr(owner, name, call)
    return lengths


def allocated(call: Callable[[], object]) -> int:
    """Return the most memory that a call takes at a time (bytes)."""
    gc.collect()
    tracemalloc.start()
    call()
    used = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return used


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
