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

"""From a path to a scene description, whichever of the two formats the file is in."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError, files
from os import PathLike
from pathlib import Path

from obb_collision.geometry.kinds import check_kind
from obb_collision.geometry.shapes.files import resolve_path
from obb_collision.geometry.shapes.folders import MeshFolders
from obb_collision.geometry.validation import warn_caller
from obb_collision.scene_files.description import SceneDescription
from obb_collision.scene_files.errors import Problem, SceneFileError
from obb_collision.scene_files.mesh_files import MeshFiles, MeshReading
from obb_collision.scene_files.moveit import MARKS, read_planning_scene
from obb_collision.scene_files.native import read_scene
from obb_collision.scene_files.reading import parse, read_text
from obb_collision.scene_files.yaml_values import Value

PACKAGE = "obb_collision"
#: Names of the scenes in the folder ``config`` of the package.
READY = ("tabletop", "warehouse", "lidar_zone", "arm_cell")


def load_scene(path: str | Path, mesh_folders: Sequence[str | Path] = ()) -> SceneDescription:
    r"""Return the description in a YAML file: a scene file, or a MoveIt planning scene.

    Its keys decide which. What is left out or odd is in the notes of the result; a quaternion far
    from unit length also gives a warning.

    Parameters
    ----------
    path : str or path
        A file, or the name of a scene that comes with the package: "tabletop", "warehouse",
        "lidar_zone" or "arm_cell".
    mesh_folders : sequence of paths
        Folders whose mesh files it may name, besides its own folder, its package and the share
        folders of installed packages; packages are looked for in them first.

    Returns
    -------
    SceneDescription
        Its ``build`` makes the scene.

    Raises
    ------
    SceneFileError
        A ValueError, naming file, line and key of everything that is wrong.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.NamedTemporaryFile("w", suffix=".yaml") as file:
    ...     _ = file.write("name: cell\nobjects:\n- {name: cup, shape: sphere, radius: 0.1}\n")
    ...     file.flush()
    ...     description = oc.load_scene(file.name)
    >>> description.names
    ['cup']
    >>> oc.load_scene("tabletop").name
    'tabletop'
    """
    check_kind(path, str, "path", PathLike)
    check_kind(mesh_folders, list, "mesh_folders", tuple)
    for folder in mesh_folders:
        check_kind(folder, str, "an entry of mesh_folders", PathLike)
    description, doubts = _load(path, MeshReading(MeshFolders(tuple(mesh_folders))))
    for doubt in doubts:
        warn_caller(doubt)
    return description


def describe_scene(path: str | Path, meshes: MeshReading | None = None) -> SceneDescription:
    """Return what ``load_scene`` does without a warning: for callers that print all notes."""
    check_kind(path, str, "path", PathLike)
    return _load(path, meshes or MeshReading())[0]


def _load(path: str | Path, meshes: MeshReading) -> tuple[SceneDescription, tuple[str, ...]]:
    file = find_scene(path)
    with _without_collections():
        top = parse(str(file), read_text(file))
        return _read(top, file, MeshFiles(file, meshes)), top.problems.doubts()


@contextmanager
def _without_collections() -> Iterator[None]:
    """Let the garbage collector rest: it takes as long as all else, and finds nothing here."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def _read(top: Value, file: Path, meshes: MeshFiles) -> SceneDescription:
    if top.peek("objects") is not None:
        return read_scene(top, file, meshes)
    if any(top.peek(mark) is not None for mark in MARKS):
        return read_planning_scene(top, file, meshes)
    if top.is_mapping:
        top.refuse("needs objects: (a scene) or world: (a MoveIt planning scene)")
    top.expected("a mapping (key: value)")


def find_scene(name: str | Path) -> Path:
    """Return the file of a path, or of the name of a scene that comes with the package.

    Raises SceneFileError, with the names there are, where there is neither.
    """
    path = Path(name)
    if os.path.exists(path) or path.suffix or len(path.parts) != 1:
        return path
    for folder in _config_folders() if str(name) in READY else ():
        if (folder / f"{name}.yaml").is_file():
            return folder / f"{name}.yaml"
    reason = f"there is no such file; the scenes of the package are {', '.join(READY)}"
    raise SceneFileError(str(name), [Problem(0, "", reason)])


def _config_folders() -> Iterator[Path]:
    """Yield where ``config`` may be: beside the sources, where pip put it, where colcon did."""
    root = Path(__file__).resolve().parents[2]
    yield root / "config"
    yield root / "share" / PACKAGE / "config"  # by pip --target
    try:
        installed = files(PACKAGE) or []
    except PackageNotFoundError:
        installed = []
    for entry in installed:
        if entry.name == f"{READY[0]}.yaml":
            yield Path(str(entry.locate())).resolve().parent
    with suppress(ValueError, OSError):  # without ROS there are no packages
        yield resolve_path(f"package://{PACKAGE}/config")
