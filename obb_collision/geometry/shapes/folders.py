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

"""Which mesh files may be read where somebody else names them: those in allowed folders.

Allowed are the share folders of installed packages and the folders chosen. A path counts as where
it leads: symbolic links and ``..`` are resolved first. ``colcon build --symlink-install`` fills
share folders with links to the sources, so a link may lead to the sources of the same package.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote

from obb_collision.geometry.shapes.files import PACKAGE, read_file, resolve_path, shortened

#: Files of the kernel and of devices: none of them is ever read.
NEVER = tuple(map(Path, ("/dev", "/proc", "/sys")))
MANIFEST = "package.xml"
#: Maximum size of a manifest, bytes.
LARGEST_MANIFEST = 1 << 20


@dataclass(frozen=True)
class MeshFolders:
    """The folders chosen: mesh files may be in them, and packages that are not installed.

    folders: those in which packages are, or that are one; packages: folders by name of the package.
    """

    folders: tuple[str | Path, ...] = ()
    packages: Mapping[str, str | Path] = field(default_factory=dict)

    @property
    def chosen(self) -> tuple[str | Path, ...]:
        """All of them."""
        return *self.folders, *self.packages.values()

    def resolve(self, path: str | Path) -> Path:
        """Return what ``resolve_path`` does, of packages in these folders, too."""
        if isinstance(path, str) and path.startswith(PACKAGE):
            name, _, inside = path.removeprefix(PACKAGE).lstrip("/").partition("/")
            found = self._package(name)
            if found is not None:
                return found / unquote(inside)
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


#: None chosen.
NO_FOLDERS = MeshFolders()


def allowed_path(path: Path, chosen: Iterable[str | Path]) -> Path:
    """Return where a path leads; ValueError unless that is in an allowed folder.

    chosen: the folders that are allowed besides the share folders of installed packages.
    """
    try:
        real = Path(os.path.realpath(path))
    except (OSError, ValueError) as error:  # a zero byte, or a name that is too long
        raise ValueError(str(error)) from error
    if not any(real.is_relative_to(folder) for folder in NEVER):
        if any(_is_within(real, folder) for folder in chosen):
            return real
        for name, share in package_shares():
            if _is_within(real, share) or _is_installed(path, share, real, name):
                return real
    leads = "" if real == path else f" leads to {shortened(str(real))}, which"
    raise ValueError(
        f"it{leads} is in no folder from which meshes are read: the shares of installed packages "
        "and mesh_folders"
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
    """Return the nearest folder above a path that has a package's manifest, None without one."""
    return next((folder for folder in path.parents if (folder / MANIFEST).is_file()), None)


def _is_installed(path: Path, share: Path, real: Path, name: str) -> bool:
    """Return whether a path in a share leads, by links, into the source folder of its package."""
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
