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

"""Meshes of real robots and things, where they are installed: all of their triangles are read.

The counters here share no code with the readers: they count words and attributes.
"""

from __future__ import annotations

import importlib.util
import re
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest

from obb_collision.geometry.shapes.files import read_mesh

PLACES = [
    Path(sys.prefix, "lib", f"python3.{sys.version_info.minor}", "site-packages", *place)
    for place in (("cmeel.prefix", "share"), ("pybullet_data",))
]
if (spec := importlib.util.find_spec("pybullet_data")) is not None and spec.origin:
    PLACES.append(Path(spec.origin).parent)


def in_stl(data: bytes) -> int:
    text = data.count(b"endfacet")
    return text if text and data[:5] == b"solid" else (len(data) - 84) // 50


def in_obj(data: bytes) -> int:
    return sum(len(line.split()) - 3 for line in data.splitlines() if line.startswith(b"f "))


def in_dae(data: bytes) -> int:
    """Count the triangles of each geometry, as often as nodes of the scene show it."""
    root = ElementTree.fromstring(data)
    for node in root.iter():
        node.tag = node.tag.rpartition("}")[2]
    geometries = {one.get("id"): one for one in root.iter("geometry")}
    scenes = {one.get("id"): one for one in root.iter("visual_scene")}
    (shown,) = root.iter("instance_visual_scene")
    scene = scenes[shown.get("url", "")[1:]]
    assert not [*scene.iter("instance_node")], "a counter for these is missing"
    urls = [one.get("url", "")[1:] for one in scene.iter("instance_geometry")]
    count = 0
    for geometry in map(geometries.__getitem__, urls):
        count += sum(int(one.get("count", 0)) for one in geometry.iter("triangles"))
        words = " ".join(one.text or "" for one in geometry.iter("vcount")).split()
        count += sum(int(word) - 2 for word in words)
        assert not [*geometry.iter("polygons"), *geometry.iter("tristrips")]
    return count


COUNTERS: dict[str, Callable[[bytes], int]] = {".stl": in_stl, ".obj": in_obj, ".dae": in_dae}


@pytest.mark.slow
def test_all_triangles_of_real_meshes_are_read() -> None:
    files = {file for place in PLACES for file in place.rglob("*") if file.is_file()}
    files = {file for file in files if file.suffix.lower() in COUNTERS}
    if not files:
        pytest.skip("neither example-robot-data nor pybullet_data is installed")
    wrong, read = [], Counter[str]()
    for file in sorted(files):
        data, kind = file.read_bytes(), file.suffix.lower()
        wanted = COUNTERS[kind](re.sub(rb"\r\n?", b"\n", data) if kind == ".obj" else data)
        try:
            found = len(read_mesh(data, file.name)[1])
        except ValueError as error:
            wrong.append(f"{file}: {error}")
            continue
        read[kind] += 1
        if found != wanted:
            wrong.append(f"{file}: {found} triangles, {wanted} are counted")
    print(read)  # noqa: T201
    assert not wrong, "\n".join(wrong)
