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

"""Mesh files, good, bad and blocking ones, and mutants of good ones."""

from __future__ import annotations

import os
from pathlib import Path
from random import Random

import numpy as np
import trimesh

from tools.fuzz.mutations.data import damaged

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
        found = box.export(file_type=kind)
        files[f"box.{kind}"] = found if isinstance(found, bytes) else found.encode()
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
