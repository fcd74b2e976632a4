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

"""URDF: links with their collision geometries, joints with their limits.

Appearance, masses and simulation are ignored. Sizes stay as in the file, meshes are read from their
files, and origins become poses.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from obb_collision.geometry.formats.parts import EmptyMeshError, is_empty, shortened
from obb_collision.geometry.poses import IDENTITY, Pose, quaternion_from_rpy
from obb_collision.geometry.shapes.files import (
    PACKAGE,
    MeshFolders,
    allowed_path,
    resolve_path,
    source_folder,
)
from obb_collision.geometry.shapes.primitives import NO_SCALE, Triple
from obb_collision.geometry.validation import check_kind
from obb_collision.robots.description.xml_values import (
    Element,
    RobotError,
    limited,
    named,
    parse,
    read_source,
)
from obb_collision.shapes import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from obb_collision.words import MAX_PATH, shown

#: Maximum number of links, ten times that of humanoids with hands: pairs of them are listed.
MOST_LINKS = 1000
#: Maximum number of collision geometries: all their pairs are listed, and adding one takes a node
#: 0.1 to 0.3 ms, in which no cycle runs. 10,000 took 11 s and 1.8 GB.
MOST_GEOMETRIES = 2000
#: The kinds of geometry; URDF has capsules from its version 1.2 on.
GEOMETRIES = ("box", "sphere", "cylinder", "capsule", "mesh")
#: Folders by the name of their package, or folders that contain packages.
PackageDirs = Mapping[str, str | Path] | Iterable[str | Path] | MeshFolders
#: Reads a mesh file, with a scale.
ReadMesh = Callable[[Path, Triple], Mesh]
#: A shape and its pose in the frame of its link.
PlacedShape = tuple[Shape, Pose]


class JointKind(IntEnum):
    """How a joint moves: the types of URDF."""

    FIXED = 0
    REVOLUTE = 1
    CONTINUOUS = 2
    PRISMATIC = 3
    PLANAR = 4
    FLOATING = 5


KINDS = {kind.name.lower(): kind for kind in JointKind}


class Mimic(NamedTuple):
    """The joint that determines another one's value: times a multiplier, plus an offset."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class Joint:
    """A joint. axis: unit vector, None if the file has none; limits: infinite if there are none."""

    name: str
    kind: JointKind
    parent: str
    child: str
    element: Element
    pose: Pose = IDENTITY
    axis: Triple | None = None
    lower: float = -math.inf
    upper: float = math.inf
    velocity: float = math.inf
    mimic: Mimic | None = None

    @property
    def drives(self) -> bool:
        """Whether the joint has variables of its own: it is neither fixed nor a mimic."""
        return self.kind is not JointKind.FIXED and self.mimic is None


@dataclass(frozen=True)
class Description:
    """A robot: shapes by link, and joints, both in the order of the file.

    doubts: faults that were ignored, one line each.
    """

    name: str
    shapes: dict[str, tuple[PlacedShape, ...]]
    joints: dict[str, Joint]
    element: Element
    doubts: tuple[str, ...]


class MeshSource:
    """Finds and reads the meshes of a robot: beside its URDF, in its package, and in others."""

    def __init__(
        self, file: Path | None, package_dirs: PackageDirs | None, read: ReadMesh | None
    ) -> None:
        self._read = Mesh.from_file if read is None else read
        if not callable(self._read):
            raise TypeError(f"read_mesh must be callable, got {shown(read)}")
        self._folders = _mesh_folders(package_dirs)
        self._option = "mesh_folders" if isinstance(package_dirs, MeshFolders) else "package_dirs"
        self._folder = None if file is None else file.absolute().parent
        self._meshes: dict[tuple[str, Triple], Mesh] = {}

    def mesh(self, name: str, scale: Triple) -> Mesh:
        """Return a mesh, which is read once; ValueError with the reason if it cannot be read."""
        if (name, scale) not in self._meshes:
            self._meshes[name, scale] = self._scaled(name, scale)
        return self._meshes[name, scale]

    def _scaled(self, name: str, scale: Triple) -> Mesh:
        """Read a mesh; it is mirrored along axes of negative scale."""
        x, y, z = (abs(part) for part in scale)
        path, own = self._path(name)
        try:
            allowed = allowed_path(path, (*self._folders.chosen, *own), self._option)
            mesh = self._read(allowed, (x, y, z))
        except ValueError as error:
            reason = str(error)
            if "mesh file" not in reason:
                reason = f"mesh file {shortened(str(path))}: {reason}"
            raise (EmptyMeshError if is_empty(error) else ValueError)(reason) from error
        signs = np.sign(scale)
        if (signs > 0.0).all():
            return mesh
        faces = mesh.faces[:, ::-1] if signs.prod() < 0.0 else mesh.faces
        return Mesh(mesh.vertices * signs, faces, mesh.scale, mesh.fit)

    def _path(self, name: str) -> tuple[Path, list[Path]]:
        """Return the path of a mesh, and the folders of the URDF that it may be in."""
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
                if above.name == package:  # the URDF's own package is not installed
                    return above / inside, [*own, above]
            raise ValueError(
                f"mesh file {shortened(name)}: package {package!r} is in none of {self._option}, "
                f"not installed, and not the URDF's own ({shortened(str(error))})"
            ) from None


def _mesh_folders(package_dirs: Any) -> MeshFolders:
    """Return the argument ``package_dirs`` as folders by package, and folders of packages."""
    if isinstance(package_dirs, MeshFolders):
        return package_dirs
    named = dict(package_dirs) if isinstance(package_dirs, Mapping) else {}
    is_list = package_dirs is not None and not isinstance(package_dirs, Mapping)
    folders = package_dirs if is_list else []
    folders = [folders] if isinstance(folders, (str, Path)) else folders
    check_kind(folders, Sequence, "package_dirs", set, frozenset)
    for name in named:
        check_kind(name, str, "package_dirs")
    for folder in (*named.values(), *folders):
        check_kind(folder, str, "package_dirs", Path)
    return MeshFolders(tuple(folders), named)


def read_urdf(robot: Element, source: MeshSource, doubts: list[str]) -> Description:
    """Read a URDF; RobotError names file, line and element.

    doubts: faults of its XML that were ignored; those of its content are added.
    """
    if robot.tag != "robot":
        raise robot.refuse("the root of a URDF is <robot>")
    elements = limited(robot.children("link"), MOST_LINKS, "links")
    geometries = [part for element in elements for part in element.children("collision")]
    limited(geometries, MOST_GEOMETRIES, "collision geometries")
    links = named(elements, "link")
    if not links:
        raise robot.refuse("there are no links")
    joints: dict[str, Joint] = {}
    for name, element in named(robot.children("joint"), "joint").items():
        joints[name] = joint = _read_joint(name, element, doubts)
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in links:
                raise element.refuse(f"its {role} {link!r} is not a link of this robot")
    for joint in joints.values():
        if joint.mimic is not None and joint.mimic.joint not in joints:  # as MoveIt does
            reason = f"it mimics {joint.mimic.joint!r}, which is not a joint: it moves by itself"
            doubts.append(str(joint.element.refuse(reason)))
            joints[joint.name] = replace(joint, mimic=None)
    shapes = {  # last, as meshes are read from files
        name: tuple(_read_collisions(element, source, doubts)) for name, element in links.items()
    }
    if not any(shapes.values()):
        doubts.append(str(robot.refuse("no link has a <collision>: nothing collides with it")))
    return Description(robot.word("name"), shapes, joints, robot, tuple(doubts))


def _read_collisions(link: Element, source: MeshSource, doubts: list[str]) -> Iterator[PlacedShape]:
    """Yield the shapes of a link; geometries without extent are doubts."""
    for element in link.children("collision"):
        try:
            yield _read_collision(element, source)
        except _NoExtentError as error:
            doubts.append(str(error))


def _read_collision(element: Element, source: MeshSource) -> PlacedShape:
    """Return the shape of an element; _NoExtentError for a geometry without extent."""
    geometry = element.needed("geometry")
    parts = geometry.children(*GEOMETRIES)
    if len(parts) != 1:
        reason = f"it must hold one of {', '.join(GEOMETRIES)}, got {len(parts) or 'none'}"
        raise geometry.refuse(reason)
    (shaped,) = parts
    try:
        shape = _mesh(shaped, source) if shaped.tag == "mesh" else _primitive(shaped)
        _ = shape.local_box
    except RobotError:
        raise
    except EmptyMeshError as error:
        raise _no_extent(shaped, str(error)) from error
    except ValueError as error:
        raise shaped.refuse(str(error)) from error
    except MemoryError as error:
        raise shaped.refuse("there is not enough memory") from error
    return shape, _read_origin(element)


class _NoExtentError(RobotError):
    """A geometry has no extent and is left out."""


def _no_extent(element: Element, reason: str) -> _NoExtentError:
    error = element.refuse(f"{reason}: it is left out")
    return _NoExtentError(error.file, error.line, error.element, error.reason)


def _primitive(element: Element) -> Shape:
    if element.tag == "box":
        return Box(element.numbers("size", 3))
    radius = element.number("radius")
    if radius == 0.0:
        raise _no_extent(element, "its radius is 0")
    if element.tag == "sphere":
        return Sphere(radius)
    length = element.number("length")
    return Cylinder(radius, length) if element.tag == "cylinder" else Capsule(radius, length)


def _mesh(element: Element, source: MeshSource) -> Shape:
    name = element.word("filename", MAX_PATH)
    x, y, z = element.numbers("scale", 3, NO_SCALE)
    if not x * y * z:
        raise element.refuse(f"its scale must not be zero, got {x:g} {y:g} {z:g}")
    return source.mesh(name, (x, y, z))


def _read_joint(name: str, element: Element, doubts: list[str]) -> Joint:
    kind = element.choice("type", KINDS)
    limits = _read_limits(element, kind, doubts)
    parent, child = (element.needed(role).word("link") for role in ("parent", "child"))
    place = _read_origin(element), _read_axis(element, kind)
    mimic = _read_mimic(element, kind)
    return Joint(name, kind, parent, child, element, *place, *limits, mimic)


def _read_origin(element: Element) -> Pose:
    origin = element.child("origin")
    if origin is None:
        return IDENTITY
    x, y, z = origin.numbers("xyz", 3, (0.0, 0.0, 0.0))
    if origin.get("quat_xyzw") is None:
        return (x, y, z, *quaternion_from_rpy(*origin.numbers("rpy", 3, (0.0, 0.0, 0.0))))
    if origin.get("rpy") is not None:
        raise origin.refuse("it has both rpy and quat_xyzw")
    return (x, y, z, *origin.unit("quat_xyzw", 4))


def _read_axis(element: Element, kind: JointKind) -> Triple | None:
    """Return the unit axis of a joint, None without one: a fixed joint's is ignored, often zero."""
    axis = None if kind in (JointKind.FIXED, JointKind.FLOATING) else element.child("axis")
    if axis is None or axis.get("xyz") is None:
        return None
    x, y, z = axis.unit("xyz", 3)
    length = math.hypot(x, y, z)  # of tiny numbers the division is not exact
    return x / length, y / length, z / length


def _read_limits(
    element: Element, kind: JointKind, doubts: list[str]
) -> tuple[float, float, float]:
    limit = element.child("limit")
    bounded = kind in (JointKind.REVOLUTE, JointKind.PRISMATIC)
    if limit is None:
        if bounded:
            raise element.refuse("<limit> is missing")
        return -math.inf, math.inf, math.inf
    velocity = limit.number("velocity", math.inf)
    if velocity < 0.0:
        doubts.append(str(limit.refuse(f"its velocity {velocity} is negative: it is ignored")))
        velocity = math.inf
    lower, upper = limit.number("lower", 0.0), limit.number("upper", 0.0)
    if lower > upper:
        wrong = f"its lower {lower} exceeds its upper {upper}"
        if bounded:
            raise limit.refuse(f"{wrong}: exchange them")
        kept = f"{wrong}: a {kind.name.lower()} joint has no limits"
        doubts.append(str(limit.refuse(kept)))
    if not bounded:
        return -math.inf, math.inf, velocity
    return lower, upper, velocity


def _read_mimic(element: Element, kind: JointKind) -> Mimic | None:
    mimic = element.child("mimic")
    if mimic is None or kind is JointKind.FIXED:
        return None
    if kind in (JointKind.PLANAR, JointKind.FLOATING):
        raise mimic.refuse(f"a {kind.name.lower()} joint can't mimic another one")
    return Mimic(mimic.word("joint"), mimic.number("multiplier", 1.0), mimic.number("offset", 0.0))


def description_text(urdf: Path) -> str:
    """Return the text of a URDF with meshes as ``file://`` URIs: on a topic it has no folder.

    ValueError for a file that is not XML.
    """
    from lxml import etree  # here, as what needs no robots need not load it

    data, file, _ = read_source(urdf, "urdf")
    top = parse(data, file).node
    for mesh in top.iter("mesh"):
        name = mesh.get("filename", "")
        if name and "://" not in name:
            mesh.set("filename", (urdf.parent / name).resolve().as_uri())
    return str(etree.tostring(top, encoding="unicode"))
