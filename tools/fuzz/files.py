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

"""Files for a node: meshes, descriptions of robots and scenes, good ones and mutants.

``python -m tools.fuzz.files`` reads mutated scenes or robots in a process of its own.
"""

from __future__ import annotations

import json
import os
import re
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from random import Random

import numpy as np
import trimesh

from obb_collision.robots.robot import Robot
from obb_collision.scene_files import READY, describe_scene, find_scene
from tools.fuzz.mutations import damaged

OBJ = b"mtllib pipe.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 2 3 4\nf 1 3 4\n"
STL = b"""solid a
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 1 0.5
endloop
endfacet
endsolid a
"""
ENTITIES = b"""<?xml version="1.0"?><!DOCTYPE COLLADA [<!ENTITY a "aaaaaaaaaa">
<!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;"><!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;&b;&b;">
<!ENTITY x SYSTEM "file:///etc/passwd">]><COLLADA>&c;&x;</COLLADA>"""
PLY = b"""ply
format ascii 1.0
element vertex 4000000000
property float x
property float y
property float z
element face 4000000000
property list uchar int vertex_indices
end_header
0 0 0
"""
GLTF = b"""{"asset":{"version":"2.0"},"buffers":[{"byteLength":4000000000,"uri":"pipe.stl"}],
"bufferViews":[{"buffer":0,"byteLength":4000000000}],"accessors":[{"bufferView":0,
"componentType":5126,"count":300000000,"type":"VEC3"}],"meshes":[{"primitives":[
{"attributes":{"POSITION":0}}]}],"nodes":[{"mesh":0}],"scenes":[{"nodes":[0]}]}"""
MUTANTS = 16
"""Files that are written anew with other damage."""
SHARE = 0.3
"""Share of the markers whose file is a mutant."""


class Meshes:
    """Files in a folder, by their URIs."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._good = good_files()
        self._uris = [f"file://{path}" for path in write_files(folder, self._good)]

    def uri(self, random: Random) -> str:
        """Return the URI of a file."""
        if random.random() > SHARE:
            return random.choice(self._uris)
        name, data = random.choice(list(self._good.items()))
        path = self._folder / f"mutant_{random.randrange(MUTANTS)}{Path(name).suffix}"
        path.write_bytes(damaged(data, random))
        return f"file://{path}"


def good_files() -> dict[str, bytes]:
    """Return the contents of good files by name, one per type."""
    box = trimesh.creation.box((1.0, 0.5, 0.25))
    files = {"good.obj": OBJ, "good.stl": STL}
    for kind in ("ply", "glb", "dae", "stl"):
        content = box.export(file_type=kind)
        files[f"box.{kind}"] = content if isinstance(content, bytes) else content.encode()
    return files


def write_files(folder: Path, good: dict[str, bytes]) -> list[Path]:
    """Write mesh files of every kind into a folder; returns their paths."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4")
    contents = {
        **good,
        "half.stl": STL[: len(STL) // 2],
        "half.glb": good["box.glb"][: len(good["box.glb"]) // 2],
        "empty.obj": b"",
        "empty.dae": b"",
        "text.glb": b"glTF" + bytes(100),
        "noise.ply": bytes(range(256)) * 4,
        "huge.stl": bytes(80) + b"\xff\xff\xff\xff" + bytes(50),
        "claims.ply": PLY,
        "entities.dae": ENTITIES,
        "outside.gltf": GLTF,
        "nan.stl": STL.replace(b"0.5", b"nan"),
        "inf.obj": OBJ.replace(b"v 1 0 0", b"v inf 1e308 -1e308"),
        "indices.obj": OBJ.replace(b"f 1 2 3", b"f 1 2 99999999"),
        "negative.obj": OBJ.replace(b"f 1 2 3", b"f -9 0 -1"),
        "flat.stl": bytes(80) + (1).to_bytes(4, "little") + bytes(50),
        "point.obj": b"v 0 0 0\n",
        "deep.gltf": b'{"nodes":' + b"[" * 100_000,
        "long.obj": b"v " + b"1" * 1_000_000 + b" 0 0\n",
        "no_type": corners.tobytes(),
        "unknown.xyzw": OBJ,
        "archive.zip": b"PK\3\4" + bytes(200),
        "name with \u00e4 %41 #.stl": STL,
    }
    for name, content in contents.items():
        (folder / name).write_bytes(content)
    with (folder / "sparse.stl").open("wb") as sparse:  # more than mesh_file_size allows
        sparse.truncate(2_000_000_000)
    for name in ("pipe.stl", "pipe.mtl"):
        if not (folder / name).exists():
            os.mkfifo(folder / name)
    (folder / "folder.stl").mkdir(exist_ok=True)
    for name, target in (("loop.stl", "loop.stl"), ("zero.stl", "/dev/zero"), ("gone.stl", "no")):
        if not (folder / name).is_symlink():
            (folder / name).symlink_to(target)
    others = ("sparse.stl", "pipe.stl", "folder.stl", "loop.stl", "zero.stl", "gone.stl", "none")
    return [folder / name for name in (*contents, *others)]


MESH = "part.obj"
"""The mesh of the robot, in the folder of its URDF, and of a scene."""
JOINTS = """
<joint name="j{k}" type="{kind}"><parent link="l{k}"/><child link="l{n}"/>
<origin xyz="0 0 0.1" rpy="0.1 0 0"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" velocity="1" effort="1"/>
{mimic}</joint>"""
LINKS = """
<link name="l{k}">
<collision><origin xyz="0.1 0 0"/>
<geometry>{geometry}</geometry></collision></link>"""
GEOMETRIES = (
    '<box size="1 1 1"/>', '<sphere radius="1"/>', '<cylinder radius="1" length="2"/>',
    '<capsule radius="1" length="2"/>', f'<mesh filename="{MESH}" scale="1 1 -1"/>',
    '<mesh filename="package://bot/part.obj"/>',
)  # fmt: skip
KINDS = ("revolute", "continuous", "prismatic", "planar", "floating", "fixed")
SRDF = """<robot name="bot">
<virtual_joint name="v" type="planar" parent_frame="world" child_link="l0"/>
<group name="a"><chain base_link="l0" tip_link="l3"/></group>
<group name="b"><group name="a"/><joint name="j4"/><link name="l5"/></group>
<group_state name="s" group="a"><joint name="j0" value="0.5"/></group_state>
<disable_default_collisions link="l1"/>
<enable_collisions link1="l1" link2="l2"/>
<disable_collisions link1="l0" link2="l3"/>
</robot>"""
VALUES = (
    *("nan", "inf", "-inf", "1e308", "1e999", "-1", "0", "", "0x10", "1_0", "é", "\u0663", "1,5"),
    *("1 2", "1 2 3", "0 0 0", "1 2 3 4", "l0", "l1", "j0", "j1", "v", "x" * 1_000_000),
    *("file:///dev/zero", "package://bot/../../etc/passwd", "../../../../etc/passwd", MESH),
    *("http://127.0.0.1:9/a.stl", "&amp;", "&#0;", "&a;", "&#1114111;", "&lt;", "<", '"'),
)
INSERTED = (
    '<!DOCTYPE robot [<!ENTITY a "b">]>', '<!ENTITY a SYSTEM "file:///etc/passwd">', "<!--", "-->",
    "<![CDATA[", "<?xml version='1.0'?>", "<x>" * 100, "<x/>" * 1000, "</robot>", "<robot>",
    '<robot xmlns="http://www.ros.org/wiki/xacro">', "<link/>", "<joint/>", "<collision/>",
    "<mimic joint='j0'/>", "<origin quat_xyzw='0 0 0 0'/>",
)  # fmt: skip


def urdf() -> str:
    """Return a robot with every kind of joint and geometry."""
    links = [LINKS.format(k=k, geometry=geometry) for k, geometry in enumerate((*GEOMETRIES, ""))]
    links[-1] = '<link name="l6"/>'
    joints = [
        JOINTS.format(k=k, n=k + 1, kind=kind, mimic='<mimic joint="j0"/>' if k == 1 else "")
        for k, kind in enumerate(KINDS)
    ]
    return '<robot name="bot">' + "\n".join(links + joints) + "\n</robot>"


def _with_other_value(line: str, random: Random) -> str:
    """Replace the value of an attribute, or its name, or that of an element."""
    matches = list(re.finditer(r'"[^"]*"|\b\w+(?==)|(?<=<)\w+', line))
    if not matches:
        return random.choice(VALUES)
    match = random.choice(matches)
    value = random.choice(VALUES)
    return line[: match.start()] + (f'"{value}"' if line[match.start()] == '"' else value) + line[
        match.end() :
    ]  # fmt: skip


def mutated(
    text: str,
    random: Random,
    inserted: Sequence[str] = INSERTED,
    change: Callable[[str, Random], str] = _with_other_value,
) -> bytes:
    """Return the text of a file with lines removed, added or changed."""
    lines = text.splitlines()
    for _ in range(random.choice((0, 0, 1, 1, 2, 4))):
        row = random.randrange(len(lines))
        choice = random.random()
        if choice < 0.15:
            del lines[row]
        elif choice < 0.3:
            lines.insert(row, random.choice(lines))
        elif choice < 0.45:
            lines.insert(row, random.choice(inserted))
        else:
            lines[row] = change(lines[row], random)
        lines = lines or [""]
    data = "\n".join(lines).encode()
    return damaged(data, random) if random.random() < 0.2 else data


def mutated_robot(seed: int, number: int) -> tuple[bytes, bytes]:
    """Return a URDF and an SRDF of which one was changed, or both, by their number."""
    random = Random(f"{seed} robot {number}")
    return mutated(urdf(), random), mutated(SRDF, random)


def read_robot(folder: Path, seed: int, number: int) -> str:
    """Read a robot and place its links; returns why it was refused, or an empty text."""
    (folder / MESH).write_bytes(OBJ)
    for name, data in zip(("bot.urdf", "bot.srdf"), mutated_robot(seed, number), strict=True):
        (folder / name).write_bytes(data)
    try:
        robot = Robot.from_urdf(
            folder / "bot.urdf", folder / "bot.srdf", {"bot": folder},
            move_virtual_joint=bool(number % 2),
        )  # fmt: skip
        robot.link_poses([1.0] * len(robot.joint_names))
    except ValueError as error:
        return f"{type(error).__name__}: {error}"
    return ""


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
    return mutated(random.choice(texts()), random, (BOMB,), _with_other_scalar)


def _with_other_scalar(line: str, random: Random) -> str:
    """Replace a value after a colon or comma, or the indentation."""
    if random.random() < 0.2:
        return random.choice((" ", "\t", "")) + line.strip()
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
