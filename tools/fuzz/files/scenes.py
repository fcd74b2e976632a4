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

"""Mutated scene files: read in a process of their own, and given to a node at its start.

That process reads mutated robots as well.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from random import Random

from obb_collision.scene_files import READY, describe_scene, find_scene
from tools.fuzz.files.meshes import OBJ
from tools.fuzz.files.robots import read_robot
from tools.fuzz.mutations.data import damaged

OBJECTS = """
name: cell
padding: 0.01
accuracy: hull
allowed: [[cup, table], ["a*", "*"]]
objects:
- {name: cup, shape: sphere, radius: 0.1, position: [0, 0, 1]}
- {name: table, shape: box, size: [1, 2, 0.1], position: [0, 0, 0], rpy: [0, 0, 1.5]}
- {name: part, shape: mesh, file: part.obj, scale: [1, 1, 1]}
- {name: hull, shape: hull, points: [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]}
"""
MOVEIT = """
name: shelf
robot_state: {joint_state: {name: [a], position: [1.0]}}
world:
  collision_objects:
  - id: box
    header: {frame_id: map}
    primitives: [{type: 1, dimensions: [1, 2, 3]}]
    primitive_poses: [{position: {x: 0, y: 0, z: 0}, orientation: {x: 0, y: 0, z: 0, w: 1}}]
allowed_collision_matrix: {entry_names: [a], entry_values: [{enabled: [true]}]}
"""
SCALARS = (
    *(".nan", ".inf", "-.inf", "1e308", "-1", "0", "1e999", "2147483648", "true", "~", "''"),
    *("[]", "{}", "[[[]]]", "'*'", '"\\0"', "!!python/object:os.system {}", "*a", "&a [*a]", "0x"),
    *("file:///dev/zero", "package://nobody/a.stl", "../../etc/passwd", "2026-01-01", "1_0", "é"),
    *("x" * 1_000_000, "[" * 2000, "{a: " * 500),
)
BOMB = "a: &a [x, x]\nb: &b [*a, *a, *a, *a]\nc: &c [*b, *b, *b, *b]\nd: [*c, *c, *c, *c]\n"
MESH = "part.obj"
ARM = ("arm.urdf", "arm.srdf", "arm_finger.obj")
"""The files of the robot of a scene of the package."""
SHOWN = 300


def texts() -> list[str]:
    """Return the scenes from which mutations start."""
    ready = [find_scene(name).read_text() for name in READY]
    return [OBJECTS, MOVEIT, *ready]


def place_files(folder: Path) -> None:
    """Write the files that the scenes name."""
    (folder / MESH).write_bytes(OBJ)
    for file in ARM:
        (folder / file).write_bytes(find_scene("arm_cell").with_name(file).read_bytes())


def mutated_scene(seed: int, number: int) -> bytes:
    """Return a scene file that was changed, by its number."""
    random = Random(f"{seed} scene {number}")
    lines = random.choice(texts()).splitlines()
    for _ in range(random.choice((0, 1, 1, 2, 4))):
        row = random.randrange(len(lines))
        choice = random.random()
        if choice < 0.2:
            del lines[row]
        elif choice < 0.35:
            lines.insert(row, random.choice(lines))
        elif choice < 0.45:
            lines[row] = random.choice((" ", "\t", "")) + lines[row].strip()
        elif choice < 0.5:
            lines.insert(row, BOMB)
        else:
            lines[row] = _with_other_scalar(lines[row], random)
        lines = lines or [""]
    data = "\n".join(lines).encode()
    return damaged(data, random) if random.random() < 0.3 else data


def _with_other_scalar(line: str, random: Random) -> str:
    """Replace what stands behind a colon or a comma."""
    places = [at for at, letter in enumerate(line) if letter in ":,[-"]
    if not places:
        return random.choice(SCALARS)
    at = random.choice(places)
    rest = line[at + 1 :]
    end = min((rest.index(letter) for letter in ",]}" if letter in rest), default=len(rest))
    return f"{line[: at + 1]} {random.choice(SCALARS)}{rest[end:]}"


def read(path: Path) -> str:
    """Read a scene file; returns why it was refused, or an empty text."""
    try:
        describe_scene(path)
    except ValueError as error:
        return f"{type(error).__name__}: {error}"
    return ""


def read_scene(folder: Path, seed: int, number: int) -> str:
    """Read the scene file of a number; returns why it was refused, or an empty text."""
    place_files(folder)
    path = folder / "scene.yaml"
    path.write_bytes(mutated_scene(seed, number))
    return read(path)


READERS = {"scene": read_scene, "robot": read_robot}
"""What is read by number, by the word that ``--only`` has for it."""


def own_time() -> float:
    """Return a time (s) that stops while this thread waits for a processor, where Linux counts."""
    try:
        waited = int(Path("/proc/thread-self/schedstat").read_text().split()[1])
    except OSError:
        waited = 0
    return time.perf_counter() - waited * 1e-9


def main() -> None:
    """Read files by number, and print a line for each: number, seconds, outcome."""
    what, folder, seed, first, last = sys.argv[1], Path(sys.argv[2]), *map(int, sys.argv[3:6])
    for number in range(first, last):
        start = own_time()
        refused = READERS[what](folder, seed, number)[:SHOWN]
        line = json.dumps([number, own_time() - start, refused])
        sys.stdout.write(f"{line}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
