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

"""The folders from which mesh files are read, as texts."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from obb_collision.geometry.shapes.folders import MeshFolders
from obb_collision.words import shown

ENTRY = re.compile(r"(?:([A-Za-z][A-Za-z0-9_-]*):\s+)?(/.*)")
"""An absolute path, before it perhaps the name of a package, which is no part of a path."""


def folder_from_text(text: str) -> tuple[str, str]:
    """Return the package, "" for none, and the folder of ``FOLDER`` or ``PACKAGE: FOLDER``.

    ValueError for a path that is not absolute. The folder need not exist: it may be mounted later.
    """
    found = ENTRY.fullmatch(text)
    if found is None:
        raise ValueError(f"{shown(text)} is no absolute path, nor like 'arm_description: /opt/arm'")
    return found[1] or "", found[2]


def folders_from(values: Mapping[str, Any]) -> MeshFolders:
    """Return the folders that parameters mean; ValueError for a package that has two."""
    given: list[tuple[str, str]] = values["mesh_folders"]
    named = [(package, folder) for package, folder in given if package]
    packages = dict(named)
    if len(packages) < len(named):
        raise ValueError("mesh_folders must have at most one entry for each package")
    return MeshFolders(tuple(folder for package, folder in given if not package), packages)
