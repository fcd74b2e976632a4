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

"""Mesh files: which may be read, and reading them into vertices and faces.

Only the file itself is read, none that it refers to: materials, textures and buffers in other files
could be anything, even a pipe that never ends. Archives and compressed formats are not read: a few
bytes of them can become any number.

Where somebody else names a file, it must be in an allowed folder: the share folders of installed
packages and the folders chosen. Symbolic links and ``..`` are resolved first. ``colcon build
--symlink-install`` fills share folders with links to the sources, so a link may lead to the sources
of the same package.
"""

from __future__ import annotations

import codecs
import os
import re
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote, urlparse

import numpy as np

from obb_collision.geometry.formats import dae, gltf, obj, off, ply, stl
from obb_collision.geometry.formats.parts import (
    NOTHING,
    SHOWN,
    EmptyMeshError,
    MeshError,
    Parts,
    TooManyError,
    Triangles,
    shortened,
)
from obb_collision.typing import Floats

#: Identifies a state of a file: time of modification (ns) and size (bytes).
Version = tuple[int, int]

#: How a URI begins that names a file of a package.
PACKAGE = "package://"
#: Maximum size of a file, bytes; the largest ones of real robots have some 100 MB.
LARGEST_FILE = 1 << 30
#: Bytes per read.
PORTION = 1 << 24
#: Readers by the suffix of a name; they return the unit in metres, None where a file has none.
READERS: dict[str, Callable[[bytes, Parts], float | None]] = {
    **dict.fromkeys(("stl", "stl_ascii"), stl.read),
    "obj": obj.read,
    "ply": ply.read,
    "off": off.read,
    "dae": dae.read,
    "glb": gltf.read_glb,
    "gltf": gltf.read_json,
}
#: Maximum number of triangles.
MOST_TRIANGLES = 100_000_000
#: In XML a document type may refer to other files, and its entities may grow without bound.
DOCUMENT_TYPE = "<!DOCTYPE"
#: Encodings of XML in which a document type is seen.
ENCODINGS = ("ascii", "us-ascii", "utf-8", "utf-16", "iso-8859-1")
DECLARED = re.compile(r"""<\?xml[^>]*?encoding\s*=\s*["']([^"']*)""")


def resolve_path(path: str | Path) -> Path:
    """Return the path of a file:// or package:// URI, or a path itself; else ValueError."""
    text = str(path)
    scheme, _, rest = text.partition("://")
    if not rest or isinstance(path, Path):
        return Path(path)
    try:
        if scheme == "file":
            parts = urlparse(text)
            if parts.netloc not in ("", "localhost"):
                raise ValueError("a file:// URI has three slashes: file:///folder/name")
            return Path(unquote(parts.path))
        if scheme == "package":
            package, _, inside = rest.partition("/")
            return _package_share(package) / unquote(inside)
    except ValueError as error:
        raise ValueError(f"mesh file {shortened(text)}: {shortened(str(error))}") from error
    raise ValueError(
        f"mesh file {shortened(text)}: only paths, file:// and package:// URIs can be read"
    )


def _package_share(package: str) -> Path:
    try:
        from ament_index_python.packages import get_package_share_directory
    except ImportError:
        raise ValueError("package:// needs ament_index_python (ROS)") from None
    try:
        return Path(get_package_share_directory(package))
    except (LookupError, OSError) as error:
        raise ValueError(str(error)) from error


def file_version(path: Path) -> Version:
    """Return the time of modification and size of a regular file; ValueError for anything else."""
    try:
        status = os.stat(path)
    except (OSError, ValueError) as error:
        raise ValueError(_reason(error)) from error
    return _regular(status)


def read_file(path: Path, largest: int = LARGEST_FILE) -> tuple[bytes, Version]:
    """Return the content of a regular file, and its version. Never waits for a pipe or a device.

    ValueError where it is missing, unreadable or has more than ``largest`` bytes.
    """
    file_version(path)  # before opening: that may have an effect on a device
    flags = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOFOLLOW", 0)
    try:
        descriptor = os.open(os.path.realpath(path), os.O_RDONLY | flags)
        try:
            version = _regular(os.fstat(descriptor))  # the path may mean another file by now
            _check_size(version[1], largest)
            portions: list[bytes] = []
            while portion := os.read(descriptor, PORTION):
                portions.append(portion)
                _check_size(sum(map(len, portions)), largest)
        finally:
            os.close(descriptor)
    except OSError as error:
        raise ValueError(_reason(error)) from error
    return b"".join(portions), version


def _regular(status: os.stat_result) -> Version:
    if not stat.S_ISREG(status.st_mode):
        raise ValueError("it is not a regular file")
    return status.st_mtime_ns, status.st_size


def _check_size(size: int, largest: int) -> None:
    if size > largest:
        raise ValueError(f"it has {size} bytes, {largest} is the limit")


def _reason(error: OSError | ValueError) -> str:
    if isinstance(error, FileNotFoundError):
        return "the file does not exist"
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


def read_mesh(
    data: bytes, name: str, most_triangles: int = MOST_TRIANGLES
) -> tuple[Floats, Triangles]:
    """Return vertices (n, 3) in metres and faces (m, 3) of all parts of a mesh file.

    data: content of the file; its type is the suffix of ``name``. ValueError where it can't be
    read whole or has more triangles, MemoryError where there is not enough memory.
    """
    kind = Path(name).suffix.lower()[1:]
    if kind not in READERS:
        what = f"its type {shortened(kind)!r} is" if kind else "its name has no suffix, which is"
        raise ValueError(f"it can't be read: {what} none of {', '.join(READERS)}")
    if kind == "dae":
        _check_xml(data)
    parts = Parts(most_triangles)
    try:
        with np.errstate(all="ignore"):  # infinite and NaN coordinates are refused later
            unit = READERS[kind](data, parts)
            vertices, faces = parts.joined(1.0 if unit is None else unit)
        if not len(vertices):
            raise EmptyMeshError(NOTHING)
        return vertices, faces
    except (MemoryError, TooManyError):
        raise
    except MeshError as error:
        raise type(error)(shortened(str(error))) from error
    except Exception as error:  # such as a text where a list is expected
        raise ValueError("it is damaged: it has a value that its place can't have") from error


def _check_xml(data: bytes) -> None:
    """Raise ValueError for XML with a document type, or in an encoding that could hide one."""
    start = data[:4]
    wide = start.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE, b"<\0", b"\0<"))
    if b"\0\0" in start:
        raise ValueError("it is XML in UTF-32")
    text = data.decode("latin-1")
    if wide:  # UTF-16 without zero bytes is its ASCII characters
        text = text.replace("\0", "")
    declared = DECLARED.search(text[:SHOWN])
    if declared is not None and declared[1].lower() not in ENCODINGS:
        raise ValueError(f"it is XML in {shortened(declared[1])!r}, none of {', '.join(ENCODINGS)}")
    if DOCUMENT_TYPE in text:
        raise ValueError(f"it has a {DOCUMENT_TYPE}, which may refer to other files")


#: Folders of the kernel and of devices, from which no file is read.
SYSTEM_FOLDERS = tuple(map(Path, ("/dev", "/proc", "/sys")))
MANIFEST = "package.xml"
#: Maximum size of a manifest, bytes.
LARGEST_MANIFEST = 1 << 20


@dataclass(frozen=True)
class MeshFolders:
    """Folders chosen by a user for mesh files, and for packages that are not installed.

    folders: they hold packages, or are packages; packages: folders by the name of the package.
    """

    folders: tuple[str | Path, ...] = ()
    packages: Mapping[str, str | Path] = field(default_factory=dict)

    @property
    def chosen(self) -> tuple[str | Path, ...]:
        """All chosen folders."""
        return *self.folders, *self.packages.values()

    def resolve(self, path: str | Path) -> Path:
        """Return the path of ``resolve_path``, which also looks for packages in these folders."""
        if isinstance(path, str) and path.startswith(PACKAGE):
            name, _, inside = path.removeprefix(PACKAGE).lstrip("/").partition("/")
            package = self._package(name)
            if package is not None:
                return package / unquote(inside)
        return resolve_path(path)

    def _package(self, name: str) -> Path | None:
        if name in self.packages:
            return Path(self.packages[name])
        for folder in map(Path, self.folders):
            if (folder / name).is_dir():
                return folder / name
            if folder.name == name:
                return folder
        return None


NO_FOLDERS = MeshFolders()


def allowed_path(path: Path, chosen: Iterable[str | Path], option: str = "mesh_folders") -> Path:
    """Return the real path of a path; ValueError unless it is in an allowed folder.

    chosen: allowed folders besides the shares of installed packages; option: the name of the
    setting that holds them.
    """
    try:
        real = Path(os.path.realpath(path))
    except (OSError, ValueError) as error:  # a zero byte, or a name that is too long
        raise ValueError(str(error)) from error
    if not any(real.is_relative_to(folder) for folder in SYSTEM_FOLDERS):
        if any(_is_within(real, folder) for folder in chosen):
            return real
        for name, share in package_shares():
            if _is_within(real, share) or _is_installed(path, share, real, name):
                return real
    leads = "" if real == path else f" leads to {shortened(str(real))}, which"
    raise ValueError(
        f"it{leads} is not in a folder from which meshes are read: the shares of installed "
        f"packages and {option}"
    )


def _is_within(real: Path, folder: str | Path) -> bool:
    return real.is_relative_to(os.path.realpath(folder))


def package_shares() -> Iterator[tuple[str, Path]]:
    """Yield name and share folder of each installed package; none without ROS."""
    with suppress(ImportError, OSError):  # OSError: no environment of ROS is set
        from ament_index_python.packages import get_packages_with_prefixes

        for name, prefix in get_packages_with_prefixes().items():
            yield name, Path(prefix, "share", name)


def source_folder(path: Path) -> Path | None:
    """Return the nearest folder above a path with the manifest of a package, else None."""
    return next((folder for folder in path.parents if (folder / MANIFEST).is_file()), None)


def _is_installed(path: Path, share: Path, real: Path, name: str) -> bool:
    """Return whether links in a share lead from a path to the sources of the same package."""
    if ".." in path.parts or not path.is_relative_to(share):
        return False
    source = source_folder(real)
    if source is None:
        return False
    try:
        manifest = read_file(source / MANIFEST, LARGEST_MANIFEST)[0]
    except ValueError:
        return False
    named = re.search(rb"<name>\s*([\w-]+)\s*</name>", manifest)
    return named is not None and named[1] == name.encode()
