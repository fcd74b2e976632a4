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

"""The mesh files that a scene file names, each read once."""

from __future__ import annotations

from pathlib import Path

from obb_collision.geometry.shapes.files import resolve_path
from obb_collision.scene_files.description import Triple
from obb_collision.scene_files.yaml_values import Value
from obb_collision.shapes import Mesh
from obb_collision.words import MAX_PATH

PACKAGE = "package://"


class MeshFiles:
    """Mesh files by path, relative to the folder of the scene file, or by URI."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._read: dict[tuple[str, Triple], Mesh] = {}

    def mesh(self, value: Value, scale: Triple) -> Mesh:
        """Return the mesh that a value names. Raises SceneFileError that names the value."""
        file = value.text("a path or a file:// or package:// URI", MAX_PATH)
        if (file, scale) not in self._read:
            with value.reasons():
                self._read[file, scale] = Mesh.from_file(self._path(file), scale)
        return self._read[file, scale]

    def _path(self, file: str) -> Path:
        """Return the path of a file; a package that is not installed may be the scene file's."""
        if "://" not in file:
            return self._folder / file
        try:
            return resolve_path(file)
        except (ValueError, OSError) as error:  # OSError: no environment of ROS is set
            package, _, inside = file.removeprefix(PACKAGE).partition("/")
            for folder in (self._folder.resolve(), *self._folder.resolve().parents):
                if file.startswith(PACKAGE) and folder.name == package:
                    return folder / inside
            text = str(error)
            raise ValueError(text if file in text else f"mesh file {file}: {text}") from None
