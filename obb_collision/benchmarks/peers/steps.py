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


"""The same full step by this library and by its peers: new poses in, colliding pairs out.

Each is built once from half extents and first poses, because a tree is only as good as the poses
it is built from. ``step`` takes a frame in the form that suits it, sets the poses of what moved,
updates, and returns what it found as it comes; ``pairs`` turns that into rows outside the timing.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

from obb_collision._threads import threads
from obb_collision.benchmarks.cases.forms import Frame
from obb_collision.benchmarks.peers.engines import Mujoco, Pybullet, Rapier
from obb_collision.benchmarks.peers.libraries import COAL_MANAGERS, Coal, PythonFcl, Trimesh
from obb_collision.geometry.boxes import Boxes
from obb_collision.scene.broad_phase.find_pairs import find_pairs
from obb_collision.scene.scene import Scene
from obb_collision.typing import Floats, Rows


class Peer(Protocol):
    """One way to do the step."""

    def step(self, frame: Frame) -> Any:
        """Set the poses and find the pairs."""

    def pairs(self, found: Any) -> Rows:
        """Return the pairs (m, 2) of what ``step`` returned, in any order."""


class OurPairs:
    """``find_pairs`` of this package from poses, validated as always."""

    def __init__(self, half_extents: Floats, poses: Floats) -> None:
        self._half_extents = half_extents

    def step(self, frame: Frame) -> Any:
        """Build the boxes and find the pairs."""
        return find_pairs(Boxes.from_poses(frame.poses, self._half_extents))

    def pairs(self, found: Any) -> Rows:
        """Return what was found."""
        return found


class OurScene:
    """``Scene`` of this package: named objects, with the effects asked for."""

    def __init__(self, effects: tuple[str, ...], half_extents: Floats, poses: Floats) -> None:
        self._effects = effects
        self._scene = Scene()
        names = [f"box/{k}" for k in range(len(poses))]
        self._indices = self._scene.add_boxes(names, 2.0 * half_extents, poses)

    def step(self, frame: Frame) -> Any:
        """Move what moved and check."""
        if len(frame.rows):
            self._scene.move_indices(self._indices[frame.rows], frame.moved)
        return self._scene.check(self._effects)

    def pairs(self, found: Any) -> Rows:
        """Return the pairs of the report."""
        return found.pairs


@dataclass(frozen=True)
class Contestant:
    """Somebody who does the step: a name, the module and distribution, and how it is built.

    threads: those it uses, None for as many as this library is set to.
    """

    name: str
    module: str
    make: Callable[[Floats, Floats], Peer]
    distribution: str = ""
    threads: int | None = 1

    @property
    def installed(self) -> bool:
        """Whether its module is there."""
        return importlib.util.find_spec(self.module) is not None

    @property
    def threads_used(self) -> int:
        """How many threads it uses now."""
        return threads() if self.threads is None else self.threads


def _ours(name: str, make: Callable[[Floats, Floats], Peer]) -> Contestant:
    return Contestant(name, "numba", make, threads=None)


PAIRS = _ours("find_pairs", OurPairs)
SCENE = _ours("Scene", partial(OurScene, ()))
SEPARATIONS = _ours("Scene, separations", partial(OurScene, ("separations",)))
CONTACTS = _ours("Scene, contacts", partial(OurScene, ("contacts",)))
OURS = (PAIRS, SCENE, SEPARATIONS, CONTACTS)

MUJOCO = Contestant("MuJoCo", "mujoco", Mujoco, "mujoco")
COAL = tuple(
    Contestant(f"coal {short}", "coal", partial(Coal, manager), "coal")
    for short, manager in COAL_MANAGERS.items()
)
PEERS = (
    MUJOCO,
    Contestant("rapier3d", "rapier3d", Rapier, "rapier3d", threads=None),
    *COAL,
    Contestant("python-fcl", "fcl", PythonFcl, "python-fcl"),
    Contestant("pybullet", "pybullet", Pybullet, "pybullet"),
    Contestant("trimesh", "fcl", Trimesh, "trimesh"),
)
