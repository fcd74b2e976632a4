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

"""The mesh files of a scene file: where they may be, and how they are read."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from obb_collision.geometry.formats.parts import shortened
from obb_collision.geometry.shapes.files import (
    LARGEST_FILE,
    MOST_TRIANGLES,
    NO_FOLDERS,
    PACKAGE,
    MeshFolders,
    allowed_path,
    source_folder,
)
from obb_collision.geometry.shapes.primitives import Triple
from obb_collision.scene.building.builder import Limits, WorkerProcess
from obb_collision.scene.building.jobs import MeshFile
from obb_collision.scene_files.yaml_values import Value
from obb_collision.shapes import Mesh
from obb_collision.words import MAX_PATH

A_FILE = "a path or a file:// or package:// URI"


class MeshReading:
    """Reads mesh files: in this process, or with ``limits`` in another one.

    folders: from which they may be read, besides the folder of the scene file, its package and the
    shares of installed packages; largest, triangles: maximum bytes and triangles of a file.
    """

    def __init__(
        self,
        folders: MeshFolders = NO_FOLDERS,
        limits: Limits | None = None,
        largest: int = LARGEST_FILE,
        triangles: int = MOST_TRIANGLES,
    ) -> None:
        self.folders = folders
        self._limits, self._largest, self._triangles = limits, largest, triangles
        self._process = WorkerProcess()

    def read(self, path: Path, scale: Triple) -> Mesh:
        """Return a mesh; ValueError with the reason if it cannot be read."""
        if self._limits is None:
            return Mesh.from_file(path, scale)
        job = MeshFile(str(path), np.array(scale), None, self._largest, self._triangles)
        built = job.finish(self._process.run(job.task(), self._limits))
        assert built is not None  # it is None only for a version that the caller has
        return built[0]

    def close(self) -> None:
        """End the process."""
        self._process.stop()

    def abandon(self) -> None:
        """End the process from another thread; ``read`` then raises ValueError."""
        self._process.close()


class MeshFiles:
    """Mesh files by path, relative to the folder of the scene file, or by URI."""

    def __init__(self, scene_file: Path, reading: MeshReading) -> None:
        self._folder, self.reading = scene_file.parent, reading
        file = scene_file.absolute()
        self._own = source_folder(file) or file.parent
        self._read: dict[tuple[str, Triple], Mesh] = {}

    def mesh(self, value: Value, scale: Triple) -> Mesh:
        """Return the mesh of a file name, which is read once; SceneFileError if that fails."""
        file = value.text(A_FILE, MAX_PATH)
        if (file, scale) not in self._read:
            with value.reasons():
                self._read[file, scale] = self.reading.read(self._path(file), scale)
        return self._read[file, scale]

    def path(self, value: Value, what: str) -> Path:
        """Return the path of a file name; SceneFileError for a file that must not be read.

        what: kind of file, as messages call it.
        """
        file = value.text(A_FILE, MAX_PATH)
        with value.reasons():
            try:
                path = self._path(file)
            except ValueError as error:
                raise ValueError(f"{what} {str(error).removeprefix('mesh file ')}") from None
        return path

    def _path(self, file: str) -> Path:
        """Return the path of a file name; ValueError for a file that must not be read."""
        path, own = self._resolved(file)
        try:
            return allowed_path(path, (own, *self.reading.folders.chosen))
        except ValueError as error:
            raise ValueError(f"mesh file {shortened(str(path))}: {error}") from error

    def _resolved(self, file: str) -> tuple[Path, Path]:
        """Return the path of a file name, and the folder of the scene file's package.

        If a package is not installed, it may be that of the scene file.
        """
        if "://" not in file:
            return self._folder / file, self._own
        try:
            return self.reading.folders.resolve(file), self._own
        except (ValueError, OSError) as error:  # OSError: no environment of ROS is set
            package, _, inside = file.removeprefix(PACKAGE).partition("/")
            for folder in (self._folder.resolve(), *self._folder.resolve().parents):
                if file.startswith(PACKAGE) and folder.name == package:
                    return folder / inside, folder
            text = str(error)
            raise ValueError(text if file in text else f"mesh file {file}: {text}") from None
