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

"""The collision geometries of links as shapes: sizes as written, meshes from their files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from obb_collision.geometry.poses import Pose
from obb_collision.geometry.shapes.files import (
    PACKAGE,
    MeshFolders,
    allowed_path,
    resolve_path,
    shortened,
    source_folder,
)
from obb_collision.geometry.validation import check_kind
from obb_collision.robots.description.urdf import Collision, Description, Triple
from obb_collision.robots.description.xml_values import Element, RobotError
from obb_collision.shapes import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from obb_collision.words import MAX_PATH, shown

#: Where packages are: a folder by name, or folders in which packages are.
PackageDirs = Mapping[str, str | Path] | Iterable[str | Path] | MeshFolders
#: Reads a mesh file, with a scale.
ReadMesh = Callable[[Path, Triple], Mesh]
#: A shape and its pose in the frame of its link.
PlacedShape = tuple[Shape, Pose]


class MeshSource:
    """Where the meshes of a robot are: its URDF's folder and package, and folders of packages."""

    def __init__(
        self, file: Path | None, package_dirs: PackageDirs | None, read: ReadMesh | None
    ) -> None:
        self._read = Mesh.from_file if read is None else read
        if not callable(self._read):
            raise TypeError(f"read_mesh must be callable, got {shown(read)}")
        self._folders = _mesh_folders(package_dirs)
        self._folder = None if file is None else file.absolute().parent
        self._found: dict[tuple[str, Triple], Mesh] = {}

    def mesh(self, name: str, scale: Triple) -> Mesh:
        """Return a mesh; ValueError with the reason where there is none. Each is read once."""
        if (name, scale) not in self._found:
            self._found[name, scale] = self._scaled(name, scale)
        return self._found[name, scale]

    def _scaled(self, name: str, scale: Triple) -> Mesh:
        """Return a mesh whose scale may be negative: then the mesh is mirrored."""
        x, y, z = (abs(part) for part in scale)
        path, own = self._path(name)
        try:
            mesh = self._read(allowed_path(path, (*self._folders.chosen, *own)), (x, y, z))
        except ValueError as error:
            reason = str(error)
            raise ValueError(
                reason if "mesh file" in reason else f"mesh file {shortened(str(path))}: {reason}"
            ) from error
        signs = np.sign(scale)
        if (signs > 0.0).all():
            return mesh
        faces = mesh.faces[:, ::-1] if signs.prod() < 0.0 else mesh.faces
        return Mesh(mesh.vertices * signs, faces, mesh.scale, mesh.fit)

    def _path(self, name: str) -> tuple[Path, list[Path]]:
        """Return the path that a name leads to, and the folders of the description itself."""
        folder = self._folder
        own = [] if folder is None else [source_folder(folder / "urdf") or folder]
        if name.startswith(PACKAGE):
            return self._in_package(name, own)
        if "://" in name or Path(name).is_absolute():
            return resolve_path(name), own
        if folder is None:
            raise ValueError(f"mesh file {shortened(name)}: a relative path needs the URDF's file")
        return folder / name, own

    def _in_package(self, name: str, own: list[Path]) -> tuple[Path, list[Path]]:
        try:
            return self._folders.resolve(name), own
        except (ValueError, OSError) as error:  # OSError: no environment of ROS is set
            package, _, inside = name.removeprefix(PACKAGE).lstrip("/").partition("/")
            for above in () if self._folder is None else (self._folder, *self._folder.parents):
                if above.name == package:  # the URDF's own package, which is not installed
                    return above / inside, [*own, above]
            raise ValueError(
                f"mesh file {shortened(name)}: package {package!r} is in none of package_dirs, "
                f"not installed, and not the URDF's own ({shortened(str(error))})"
            ) from None


def _mesh_folders(given: Any) -> MeshFolders:
    """Return folders by the name of a package, and folders in which packages are."""
    if isinstance(given, MeshFolders):
        return given
    named, folders = {}, []
    if isinstance(given, Mapping):
        named = dict(given)
    elif given is None or isinstance(given, (str, Path)):
        folders = [] if given is None else [given]
    else:
        check_kind(given, Sequence, "package_dirs", set, frozenset)
        folders = list(given)
    for name in named:
        check_kind(name, str, "package_dirs")
    for folder in (*named.values(), *folders):
        check_kind(folder, str, "package_dirs", Path)
    return MeshFolders(tuple(folders), named)


def shapes_of(description: Description, source: MeshSource) -> dict[str, tuple[PlacedShape, ...]]:
    """Return the shapes of each link, with their poses; RobotError naming the element."""
    read = partial(_shape, source=source)
    return {
        link: tuple((read(each), each.pose) for each in collisions)
        for link, collisions in description.links.items()
    }


def _shape(collision: Collision, source: MeshSource) -> Shape:
    element = collision.element
    try:
        shape = _mesh(element, source) if element.tag == "mesh" else _primitive(element)
        _ = shape.local_box
    except RobotError:
        raise
    except ValueError as error:
        raise element.refuse(str(error)) from error
    except MemoryError as error:
        raise element.refuse("there is not enough memory") from error
    return shape


def _primitive(element: Element) -> Shape:
    if element.tag == "box":
        if element.get("size") is None:
            raise element.refuse("its size is missing")
        return Box(element.numbers("size", 3, ()))
    radius = element.number("radius")
    if element.tag == "sphere":
        return Sphere(radius)
    length = element.number("length")
    return Cylinder(radius, length) if element.tag == "cylinder" else Capsule(radius, length)


def _mesh(element: Element, source: MeshSource) -> Shape:
    name = element.word("filename", MAX_PATH)
    x, y, z = element.numbers("scale", 3, (1.0, 1.0, 1.0))
    if not x * y * z:
        raise element.refuse(f"its scale must not be zero, got {x:g} {y:g} {z:g}")
    return source.mesh(name, (x, y, z))
