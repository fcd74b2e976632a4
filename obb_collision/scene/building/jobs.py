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

"""Jobs of building: each is sent as a message, done in another process, and finished here.

``message`` and ``finish`` run in the thread that talks to the other process; ``perform`` runs in
that process. What both sides have already is not sent back.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from obb_collision.geometry.shapes import files
from obb_collision.geometry.shapes.files import MeshFolders, allowed_path
from obb_collision.geometry.shapes.meshes import Hull, Mesh
from obb_collision.geometry.shapes.primitives import LocalBox
from obb_collision.geometry.trees.pool import HullPool, Pool, TreePool
from obb_collision.numerics.constants import MAX_MAGNITUDE
from obb_collision.scene.building.wire import BAD_SHAPE, BuildError, Message
from obb_collision.shapes import Shape
from obb_collision.typing import Floats

if TYPE_CHECKING:  # the process that builds needs none of these
    from obb_collision.scene.building.shape_cache import Entry, Packed, PerShape

#: Names of jobs, and where what they build goes to.
POOLS: dict[str, type[Pool[Any]]] = {"tree": TreePool, "hull": HullPool}


@dataclass(frozen=True, eq=False)
class BuildJob:
    """The tree or hull of a shape."""

    shape: Mesh | Hull
    per_shape: PerShape[Any]

    @property
    def size(self) -> int:
        """Bytes that the job holds while it waits: the shape is there anyway."""
        return 0

    def message(self) -> dict[str, Any]:
        """Return what is sent."""
        (name,) = (name for name, kind in POOLS.items() if isinstance(self.per_shape.pool, kind))
        return {"job": name} | _sent(self.shape)

    def finish(self, reply: dict[str, Any]) -> tuple[Pool[Any], Any, int]:
        """Return the pool that what was built is in, itself, and its row."""
        pool = self.per_shape.pool
        item = pool.made(reply)
        with pool.lock:
            return pool, item, pool.append(item)


@dataclass(frozen=True, eq=False)
class PackJob:
    """A new pool of the items in use; nothing is sent."""

    built: dict[Entry[Any], Any]
    per_shape: PerShape[Any]

    @property
    def size(self) -> int:
        """Bytes that the job holds while it waits: the items are there anyway."""
        return 0

    def message(self) -> None:
        """Return None: there is nothing to send."""

    def finish(self, reply: dict[str, Any]) -> Packed[Any]:
        """Return the new pool."""
        return self.per_shape.packed(self.built)


def _sent(shape: Mesh | Hull) -> dict[str, Any]:
    center, rotation, half_extents = shape.local_box
    box = {"center": center, "rotation": rotation, "half_extents": half_extents}
    scale = np.array(shape.scale)
    if isinstance(shape, Mesh):
        return box | {"vertices": shape.vertices, "faces": shape.faces, "scale": scale}
    return box | {"points": shape.points, "scale": scale}


def _received(message: dict[str, Any]) -> Mesh | Hull:
    box = message["center"], message["rotation"], message["half_extents"]
    if "vertices" in message:
        return Mesh.fitted(message["vertices"], message["faces"], message["scale"], box)
    return Hull.fitted(message["points"], box, message["scale"])


def perform_build(message: dict[str, Any]) -> dict[str, Any]:
    """Build a tree or hull."""
    pool = POOLS[message["job"]]
    return pool.arrays(pool.built(_received(message)))


BAD_POINTS = "bad points"
UNREADABLE = "unreadable mesh"
TOO_MANY_TRIANGLES = "too many triangles"

#: Corners (8, 3) of the unit cube.
CUBE_CORNERS = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


class Job(Protocol):
    """One thing to build."""

    @property
    def size(self) -> int:
        """Bytes that the job holds while it waits."""

    def message(self) -> Message | None:
        """Return what is sent; ``job`` is the name in ``PERFORM``. None: it is done by finish."""

    def finish(self, reply: Message) -> Any:
        """Return what was built."""


@dataclass(frozen=True, eq=False)
class Triangles:
    """A mesh of points (3n, 3) metres, three of them a triangle."""

    points: Floats
    scale: Floats

    @property
    def size(self) -> int:
        """Bytes that the job holds while it waits."""
        return self.points.nbytes

    def message(self) -> Message:
        """Return what is sent."""
        return {"job": "triangles", "points": self.points, "scale": self.scale}

    def finish(self, reply: Message) -> Mesh:
        """Return the mesh."""
        points = np.array(self.points, np.float64)  # what is given may be a view on a message
        faces = np.arange(len(points)).reshape(-1, 3)
        return Mesh.fitted(points, faces, self.scale, local_box(reply))


@dataclass(frozen=True, eq=False)
class Bodies:
    """The hull of equal bodies of edge lengths ``widths`` (3,) at points (n, 3), metres."""

    points: Floats
    widths: Floats

    @property
    def size(self) -> int:
        """Bytes that the job holds while it waits."""
        return self.points.nbytes

    def message(self) -> Message:
        """Return what is sent."""
        return {"job": "bodies", "points": self.points, "widths": self.widths}

    def finish(self, reply: Message) -> Hull:
        """Return the hull."""
        return Hull.fitted(body_corners(self.points, self.widths), local_box(reply))


@dataclass(frozen=True, eq=False)
class MeshFile:
    """A mesh file by its path or URI, or what one holds (``data``, its type by the suffix of name).

    largest, triangles: the most that it may have, in bytes and in triangles; folders: where it may
    be, besides the shares of installed packages, None: anywhere; known: the version that is built
    already; the result is None if the file still has it.
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

    def message(self) -> Message:
        """Return what is sent."""
        message = {"name": self.name, "scale": self.scale, "triangles": self.triangles}
        if self.data is not None:
            return message | {"job": "data", "data": np.frombuffer(self.data, np.uint8)}
        folders = None if self.folders is None else vars(self.folders)
        place = {"largest": self.largest, "folders": folders}
        return message | place | {"job": "file", "known": self.known}

    def finish(self, reply: Message) -> tuple[Mesh, files.Version | None] | None:
        """Return the mesh and, of a file, its version; None if it is the known one."""
        if "vertices" not in reply:
            return None
        mesh = Mesh.fitted(reply["vertices"], reply["faces"], self.scale, local_box(reply))
        version = reply.get("version")
        return mesh, None if version is None else (int(version[0]), int(version[1]))


def body_corners(points: Floats, widths: Floats) -> Floats:
    """Return the corners (8n, 3) of boxes of edge lengths ``widths`` (3,) at points (n, 3)."""
    return (points[:, None] + CUBE_CORNERS * widths).reshape(-1, 3)


def local_box(reply: Message) -> LocalBox:
    """Return the box in a reply."""
    return reply["center"], reply["rotation"], reply["half_extents"]


def boxed(shape: Shape) -> Message:
    """Return a reply with the box of a shape."""
    center, rotation, half_extents = shape.local_box
    return {"center": center, "rotation": rotation, "half_extents": half_extents}


def _triangles(message: Message) -> Message:
    points = _checked_points(message)
    faces = np.arange(len(points)).reshape(-1, 3)
    return boxed(Mesh(points, faces, message["scale"]))


def _bodies(message: Message) -> Message:
    return boxed(Hull(body_corners(_checked_points(message), message["widths"])))


def _checked_points(message: Message) -> Floats:
    points: Floats = message["points"]
    if not (np.abs(points) <= MAX_MAGNITUDE).all():
        raise BuildError(BAD_POINTS, "points must be finite")
    return points


def _data(message: Message) -> Message:
    name = message["name"]
    with _refused(name):
        return _mesh(message, message["data"].tobytes(), name)


def _file(message: Message) -> Message:
    name = message["name"]
    with _refused(name):
        if message["folders"] is None:
            path = files.resolve_path(name)
        else:
            folders = MeshFolders(**message["folders"])
            path = allowed_path(folders.resolve(name), folders.chosen)
        if message["known"] is not None and files.file_version(path) == tuple(message["known"]):
            return {}
        data, version = files.read_file(path, message["largest"])
        return _mesh(message, data, path.name) | {"version": np.array(version)}


@contextmanager
def _refused(name: str) -> Iterator[None]:
    """Turn the errors of a mesh file into refusals that name it."""
    try:
        yield
    except ValueError as error:
        text = str(error)
        known = text.startswith("mesh file ")  # it names the file
        reason = TOO_MANY_TRIANGLES if isinstance(error, files.TooManyError) else UNREADABLE
        raise BuildError(reason, text if known else f"{files.shortened(name)}: {text}") from error


def _mesh(message: Message, data: bytes, name: str) -> Message:
    mesh = Mesh(*files.read_mesh(data, name, message["triangles"]), message["scale"])
    return {"vertices": mesh.vertices, "faces": mesh.faces} | boxed(mesh)


PERFORM: dict[str, Callable[[Message], Message]] = {
    "triangles": _triangles,
    "bodies": _bodies,
    "data": _data,
    "file": _file,
    **dict.fromkeys(POOLS, perform_build),
}


def perform(message: Message) -> Message:
    """Do the job of a message; BuildError with the reason where that can't be."""
    try:
        return PERFORM[message["job"]](message)
    except BuildError:
        raise
    except ValueError as error:
        raise BuildError(BAD_SHAPE, files.shortened(str(error))) from error
