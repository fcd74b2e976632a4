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

"""Jobs: each has a task for the child process, and finishes its result in this process.

A task is a function and its arguments; the child runs it by ``perform``. ``task`` and ``finish``
run in the thread that talks to the child. Results are plain arrays (see ``_child``) without what
this side has already. ``finish`` checks them: kernels use the indices in them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from obb_collision.geometry.formats.parts import TooManyError, shortened
from obb_collision.geometry.formats.parts import Triangles as Faces
from obb_collision.geometry.shapes import files
from obb_collision.geometry.shapes.files import MeshFolders, allowed_path
from obb_collision.geometry.shapes.meshes import Hull, Mesh
from obb_collision.geometry.shapes.primitives import LocalBox, Shape
from obb_collision.geometry.trees.pool import Pool
from obb_collision.numerics.constants import MAX_MAGNITUDE
from obb_collision.typing import Floats

BAD_SHAPE = "bad shape"
BAD_POINTS = "bad points"
UNREADABLE = "unreadable mesh"
TOO_MANY_TRIANGLES = "too many triangles"
NO_MEMORY = "not enough memory"
TOO_SLOW = "building took too long"
NO_BUILDER = "shape builder failed"
TOO_MANY = "too many shapes waiting"

#: Corners (8, 3) of the unit cube.
CUBE_CORNERS = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])

#: A function and its arguments.
Task: TypeAlias = tuple[Callable[..., Any], tuple[Any, ...]]


class BuildError(ValueError):
    """An error of building; ``reason`` is a short fixed phrase, ``detail`` says more."""

    def __init__(self, reason: str, detail: str = "") -> None:
        super().__init__(reason, detail)
        self.reason = reason
        self.detail = detail

    def __str__(self) -> str:
        return f"{self.reason}: {self.detail}" if self.detail else self.reason


class Job(Protocol):
    """A job: a shape, tree, hull or pool to build."""

    @property
    def size(self) -> int:
        """Bytes that the job holds while it waits."""
        return 0

    def task(self) -> Task | None:
        """Return the task for the child process, None where the child has nothing to do."""
        return None

    def finish(self, result: Any) -> Any:
        """Return the product of the job from the result of its task."""
        raise NotImplementedError


def perform(task: Task | None) -> Any:
    """Return the result of a task; BuildError where it fails."""
    if task is None:
        return None
    function, arguments = task
    try:
        return function(*arguments)
    except BuildError:
        raise
    except ValueError as error:
        raise BuildError(BAD_SHAPE, shortened(str(error))) from error


@dataclass(frozen=True, eq=False)
class _PointsJob(Job):
    points: Floats

    @property
    def size(self) -> int:
        return self.points.nbytes


@dataclass(frozen=True, eq=False)
class Triangles(_PointsJob):
    """Builds a mesh of triangles from their corners (3n, 3), metres."""

    scale: Floats

    @property
    def _faces(self) -> Faces:
        return np.arange(len(self.points)).reshape(-1, 3)

    def task(self) -> Task:
        """Return the task that fits the local box."""
        return _box_of, (Mesh, self.points, self._faces, self.scale)

    def finish(self, result: LocalBox) -> Mesh:
        """Return the mesh."""
        points = np.array(self.points, np.float64)  # a copy: it may be a view of a message
        return Mesh.fitted(points, self._faces, self.scale, result)


@dataclass(frozen=True, eq=False)
class Bodies(_PointsJob):
    """Builds the hull of equal bodies of edge lengths ``widths`` (3,) at points (n, 3), metres."""

    widths: Floats

    def task(self) -> Task:
        """Return the task that fits the local box."""
        return _box_of, (_hull_of_bodies, self.points, self.widths)

    def finish(self, result: LocalBox) -> Hull:
        """Return the hull."""
        return Hull.fitted(body_corners(self.points, self.widths), result)


@dataclass(frozen=True, eq=False)
class MeshFile(Job):
    """Reads a mesh file from a path or URI, or from ``data``; the name's suffix is its type.

    largest, triangles: limits of bytes and triangles; folders: allowed besides the shares of
    installed packages, None for anywhere; known: a version that is built already, for which the
    result is None.
    """

    name: str
    scale: Floats
    data: bytes | None = None
    largest: int = files.LARGEST_FILE
    triangles: int = files.MOST_TRIANGLES
    folders: MeshFolders | None = None
    known: files.Version | None = None

    @property
    def size(self) -> int:
        """Bytes that the job holds while it waits."""
        return len(self.data or b"") + len(self.name)

    def task(self) -> Task:
        """Return the task that reads the file."""
        return MeshFile._read, (self,)

    def finish(
        self, result: tuple[Floats, Faces, LocalBox, files.Version | None] | None
    ) -> tuple[Mesh, files.Version | None] | None:
        """Return the mesh and the version of the file; None for the known version."""
        if result is None:
            return None
        vertices, faces, box, version = result
        return Mesh.fitted(vertices, faces, self.scale, box), version

    def _read(self) -> tuple[Floats, Faces, LocalBox, files.Version | None] | None:
        data, name, version = self.data, self.name, None
        with _errors_of(self.name):
            if data is None:
                folders = self.folders
                if folders is None:
                    path = files.resolve_path(name)
                else:
                    path = allowed_path(folders.resolve(name), folders.chosen)
                if self.known is not None and files.file_version(path) == self.known:
                    return None
                (data, version), name = files.read_file(path, self.largest), path.name
            mesh = Mesh(*files.read_mesh(bytes(data), name, self.triangles), self.scale)
            return mesh.vertices, mesh.faces, mesh.local_box, version


def arrays_of(pool: type[Pool[Any]], shape: Shape) -> tuple[NDArray[Any], ...]:
    """Return the arrays of a shape's tree or hull, as a kind of pool stores them."""
    return tuple(pool.arrays(pool.built(shape)).values())


def body_corners(points: Floats, widths: Floats) -> Floats:
    """Return the corners (8n, 3) of boxes of edge lengths ``widths`` (3,) at points (n, 3)."""
    return (points[:, None] + CUBE_CORNERS * widths).reshape(-1, 3)


def _box_of(kind: Callable[..., Shape], points: Floats, *more: Any) -> LocalBox:
    if not (np.abs(points) <= MAX_MAGNITUDE).all():
        raise BuildError(BAD_POINTS, "points must be finite")
    return kind(points, *more).local_box


def _hull_of_bodies(points: Floats, widths: Floats) -> Hull:
    return Hull(body_corners(points, widths))


@contextmanager
def _errors_of(name: str) -> Iterator[None]:
    """Turn the errors of a mesh file into BuildErrors that name the file."""
    try:
        yield
    except ValueError as error:
        text = str(error)
        is_named = text.startswith("mesh file ")
        reason = TOO_MANY_TRIANGLES if isinstance(error, TooManyError) else UNREADABLE
        raise BuildError(reason, text if is_named else f"{shortened(name)}: {text}") from error
