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

"""Answers of the library as hashes: recorded before a change of its structure, compared after.

    python -m tools.answers record FILE     PYTHONPATH must have test/support
    python -m tools.answers compare FILE    exits with 1, and names what changed

Families of box pairs, scenes of all shapes at each accuracy with all effects, robots' states,
motions and distances. The hashes are those of every bit, so they belong to one machine.
"""

from __future__ import annotations

import dataclasses
import enum
import hashlib
import json
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from small_robots import random_arm, random_states, random_world

import obb_collision as oc
from tools.cases.families import FAMILIES, generate

ACCURACIES = ("sphere", "aabb", "obb", "hull", "mesh")
EFFECTS = ("contacts", "clearance", "sweep")
SCENES = 10
PAIRS = 400


def feed(digest: Any, value: object) -> None:
    """Add a result, with all its parts, to a hash."""
    if isinstance(value, enum.Enum):
        value = value.value
    if dataclasses.is_dataclass(value) or hasattr(value, "_fields"):
        names = getattr(value, "_fields", None) or [f.name for f in dataclasses.fields(value)]  # type: ignore[arg-type]
        for name in names:
            feed(digest, getattr(value, name))
    elif isinstance(value, dict):
        feed(digest, sorted(value.items()))
    elif isinstance(value, (list, tuple)):
        for part in value:
            feed(digest, part)
    elif isinstance(value, (np.ndarray, np.generic)) and np.asarray(value).dtype != object:
        digest.update(np.ascontiguousarray(np.asarray(value) + 0).tobytes())  # -0.0 is 0.0
    elif isinstance(value, (str, bool, int, float, bytes, type(None))):
        digest.update(repr(value).encode())
    else:
        raise TypeError(f"no hash of {type(value).__name__}")


def hashed(value: object) -> str:
    """Return the hash of a result."""
    digest = hashlib.sha256()
    feed(digest, value)
    return digest.hexdigest()[:16]


def of_boxes() -> Iterator[tuple[str, object]]:
    """Yield the answers of the questions about batches of boxes."""
    rng = np.random.default_rng(5)
    for name in FAMILIES:
        a, b = (oc.Boxes(*arrays) for arrays in generate(name, PAIRS, 5))
        ends = [
            oc.Boxes(x.centers + rng.normal(0, 0.3, (PAIRS, 3)), x.rotations, x.half_extents)
            for x in (a, b)
        ]
        moving = oc.MovingBoxes(a, ends[0]), oc.MovingBoxes(b, ends[1])
        yield f"{name} verdicts", oc.verdicts(a, b)
        yield f"{name} exact", oc.verdicts(a, b, exact=True)
        yield f"{name} separations", oc.separations(a, b)
        yield f"{name} contacts", oc.contacts(a, b)
        yield f"{name} clearances", oc.clearances(a, b)
        yield f"{name} sweeps", oc.sweeps(*moving)
        yield f"{name} overlap", [oc.overlap_volumes(a, b), oc.iou(a, b)]
        yield f"{name} rays", oc.cast_segments(a, b.centers, b.centers[::-1])
        yield f"{name} points", oc.points_inside(a, b.centers, 0.1)
        yield f"{name} pairs", oc.find_pairs(a, b)


def of_scenes() -> Iterator[tuple[str, object]]:
    """Yield the answers of scenes of all shapes."""
    for seed in range(SCENES):
        rng = np.random.default_rng(seed)
        for accuracy in ACCURACIES:
            scene = random_world(np.random.default_rng(seed), 40)
            scene.accuracy = oc.Accuracy[accuracy.upper()]
            scene.padding = 0.01 * (seed % 3)
            for name in EFFECTS:
                scene.set_effect(name, "on")
            for name in scene.names[::3]:
                scene.set_twist(name, rng.normal(0, 0.5, 6))
            report = scene.check()
            parts = [report.pairs, report.verdicts, report.accuracies]
            yield f"scene {seed} {accuracy} pairs", parts
            yield (
                f"scene {seed} {accuracy} depths",
                [report.depths, report.positions, report.normals],
            )
            for name in EFFECTS:
                yield f"scene {seed} {accuracy} {name}", report.result(name)
            hits = scene.cast_rays(rng.normal(0, 1, (50, 3)), rng.normal(0, 1, (50, 3)))
            yield f"scene {seed} {accuracy} rays", hits


def of_robots() -> Iterator[tuple[str, object]]:
    """Yield the answers about states and motions of robots among objects."""
    for seed in range(SCENES):
        rng = np.random.default_rng(seed)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "arm.urdf"
            file.write_text(random_arm(rng, 6))
            robot = oc.Robot.from_urdf(file)
        for accuracy in ("obb", "hull", "mesh"):
            scene = oc.RobotScene(robot, random_world(rng, 20), accuracy=accuracy)
            states = random_states(rng, robot, 60)
            yield f"robot {seed} {accuracy} states", scene.check(states)
            near = scene.distances(states[:20])
            bounds = near.distances, near.upper_bounds, near.first_pairs
            where = near.points, near.directions, near.names
            yield f"robot {seed} {accuracy} distances", [*bounds, *where]
            yield (
                f"robot {seed} {accuracy} motions",
                scene.check_motions(states[:15], states[15:30]),
            )


def answers(parts: tuple[Callable[[], Iterator[tuple[str, object]]], ...]) -> dict[str, str]:
    """Return the hash of each answer by its question."""
    return {name: hashed(value) for part in parts for name, value in part()}


def main(how: str, path: str) -> int:
    """Record answers in a file, or compare with those in it; returns the exit code."""
    hashes = answers((of_boxes, of_scenes, of_robots))
    if how == "record":
        Path(path).write_text(json.dumps(hashes, indent=0, sort_keys=True))
        print(f"{len(hashes)} answers recorded")
        return 0
    known = json.loads(Path(path).read_text())
    changed = sorted(name for name in {*hashes, *known} if hashes.get(name) != known.get(name))
    print(f"{len(hashes)} answers, {len(changed)} changed", *changed[:50], sep="\n")
    return 1 if changed else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
