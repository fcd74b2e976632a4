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


"""The text of a URDF as it is published: what it names by a relative path is an absolute URI."""

from __future__ import annotations

from pathlib import Path

from lxml import etree

from obb_collision.robots.description.xml_values import parse, read_source


def description_text(urdf: Path) -> str:
    """Return the text of a URDF, its meshes by ``file://``: on a topic it has no folder.

    ValueError where it is no XML.
    """
    data, file, _ = read_source(urdf, "urdf")
    top = parse(data, file).node
    for mesh in top.iter("mesh"):
        name = mesh.get("filename", "")
        if name and "://" not in name:
            mesh.set("filename", (urdf.parent / name).resolve().as_uri())
    return str(etree.tostring(top, encoding="unicode"))
