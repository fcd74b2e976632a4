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

"""Loading of a scene file in either format.

YAML is read as words, lists and mappings only. Size, nesting and number of values, where an alias
counts as all that it stands for, have limits, which bound the time of all later steps.
"""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError, files
from os import PathLike
from pathlib import Path
from typing import Any

import yaml
from yaml.composer import ComposerError
from yaml.parser import Parser
from yaml.reader import Reader
from yaml.resolver import Resolver
from yaml.scanner import Scanner

from obb_collision.geometry.shapes.files import MeshFolders, resolve_path
from obb_collision.geometry.validation import check_kind, warn_caller
from obb_collision.scene_files.description import SceneDescription
from obb_collision.scene_files.mesh_files import MeshFiles, MeshReading
from obb_collision.scene_files.moveit import MARKS, PlanningScene
from obb_collision.scene_files.native import read_scene
from obb_collision.scene_files.yaml_values import (
    MAPPING,
    SEQUENCE,
    Node,
    Problem,
    Problems,
    SceneFileError,
    Value,
)

#: Maximum size of a file, bytes: a scene with meshes in it, which takes a minute to read.
MAX_BYTES = 16_000_000
#: Maximum levels of lists and mappings: three times those of a planning scene.
MAX_LEVELS = 30
#: Maximum number of values, where those behind an alias count at every place.
MAX_VALUES = 4_000_000


class _LimitError(yaml.MarkedYAMLError):  # type: ignore[misc]
    """YAML that exceeds a limit."""


class PythonParser(Reader, Scanner, Parser):  # type: ignore[misc]
    """PyYAML's parser in Python, whose error messages users see."""

    def __init__(self, text: str) -> None:
        Reader.__init__(self, text)
        Scanner.__init__(self)
        Parser.__init__(self)


try:  # libyaml takes a tenth of the time
    from yaml.cyaml import CParser as FastParser
except ImportError:  # PyYAML may be built without it
    FastParser = PythonParser


class _Composer:
    """Makes nodes from the events of a parser, within the limits."""

    def __init__(self, parser: Any) -> None:
        self._next = parser.get_event
        self._resolve = Resolver().resolve
        self._level = 0
        self._count = 0
        self._anchors: dict[str, tuple[Node, int]] = {}  # with their numbers of values
        self._open: set[str] = set()  # anchors of nodes that are not complete

    def document(self) -> Node | None:
        """Return the only document, None for an empty file."""
        self._next()
        if isinstance(self._next(), yaml.StreamEndEvent):
            return None
        node = self._node(self._next())
        self._next()
        event = self._next()
        if not isinstance(event, yaml.StreamEndEvent):
            raise ComposerError(None, None, "but found another document", event.start_mark)
        return node

    def _node(self, event: yaml.Event) -> Node:
        if isinstance(event, yaml.AliasEvent):
            return self._aliased(event)
        self._add(1, event)
        anchor, before = event.anchor, self._count
        if anchor is not None:
            if anchor in self._anchors or anchor in self._open:
                raise ComposerError(None, None, "second occurrence", event.start_mark)
            self._open.add(anchor)
        self._level += 1
        if self._level > MAX_LEVELS:
            self._limit(f"nested too deeply, more than {MAX_LEVELS} levels", event)
        node = self._new(event)
        self._level -= 1
        if anchor is not None:
            self._anchors[anchor] = node, self._count - before + 1
        return node

    def _new(self, event: yaml.Event) -> Node:
        line, tag = event.start_mark.line, event.tag
        if isinstance(event, yaml.ScalarEvent):
            if tag is None or tag == "!":
                tag = self._resolve(yaml.ScalarNode, event.value, event.implicit)
            return Node(tag, event.value, line, event.style or None)  # libyaml: "" for plain ones
        value: list[Node] = []
        while not isinstance(inner := self._next(), yaml.CollectionEndEvent):
            value.append(self._node(inner))
        if isinstance(event, yaml.SequenceStartEvent):
            return Node(tag if tag not in (None, "!") else SEQUENCE, value, line)
        pairs = tuple(zip(value[::2], value[1::2], strict=True))
        return Node(tag if tag not in (None, "!") else MAPPING, pairs, line)

    def _aliased(self, event: yaml.AliasEvent) -> Node:
        """Return the node that an alias refers to."""
        if event.anchor not in self._anchors:
            if event.anchor in self._open:
                self._limit(f"&{event.anchor} contains itself", event)
            problem = f"found undefined alias {event.anchor!r}"
            raise ComposerError(None, None, problem, event.start_mark)
        node, count = self._anchors[event.anchor]
        self._add(count, event)
        return node

    def _add(self, count: int, event: yaml.Event) -> None:
        self._count += count
        if self._count > MAX_VALUES:
            self._limit(
                f"there are more than {MAX_VALUES} values, counting those repeated by aliases",
                event,
            )

    def _limit(self, reason: str, event: yaml.Event) -> None:
        raise _LimitError(problem=reason, problem_mark=event.start_mark)


def parse(file: str, text: str) -> Value:
    """Return the top value of a YAML text; SceneFileError if it is invalid or exceeds a limit."""
    try:
        try:
            node = _Composer(FastParser(text)).document()
        except _LimitError:
            raise
        except (yaml.YAMLError, ValueError, OverflowError, RecursionError):
            parser = PythonParser(text)
            node = _Composer(parser).document()
    except _LimitError as error:
        raise SceneFileError(file, [Problem(_line(error), "", str(error.problem))]) from None
    except yaml.MarkedYAMLError as error:
        raise _invalid(file, _line(error), str(error.problem)) from None
    except yaml.reader.ReaderError as error:
        raise _invalid(file, text.count("\n", 0, error.position) + 1, error.reason) from None
    except (ValueError, OverflowError) as error:  # numbers of directives and of escapes
        raise _invalid(file, parser.line + 1, str(error)) from None
    except RecursionError:  # the caller has used most of the stack
        raise SceneFileError(file, [Problem(parser.line + 1, "", "nested too deeply")]) from None
    if node is None:
        raise SceneFileError(file, [Problem(1, "", "the file is empty")])
    return Value(node, "", Problems(file))


def _line(error: yaml.MarkedYAMLError) -> int:
    mark = error.problem_mark or error.context_mark
    return 1 if mark is None else int(mark.line) + 1


def _invalid(file: str, line: int, reason: str) -> SceneFileError:
    return SceneFileError(file, [Problem(line, "", f"not valid YAML: {reason}")])


def read_text(path: Path) -> str:
    """Return the text of a file; SceneFileError if it cannot be read."""
    line = 0
    try:
        if path.exists() and not path.is_file():  # a device or pipe may be endless
            reason = "the path is a folder, a device or a pipe, not a file"
        else:
            with path.open("rb") as file:
                data = file.read(MAX_BYTES + 1)
            if len(data) <= MAX_BYTES:
                return data.decode("utf-8")
            reason = f"the file has more than {MAX_BYTES} bytes"
    except FileNotFoundError:
        reason = "the file does not exist"
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        reason = f"not UTF-8 text: {error.reason} at byte {error.start}"
    except OSError as error:
        reason = f"can't be read: {error.strerror}"
    except ValueError as error:  # not a valid file name
        reason = f"can't be read: {error}"
    raise SceneFileError(str(path), [Problem(line, "", reason)])


PACKAGE = "obb_collision"
#: Names of the scenes of the package, in its folder ``config``.
READY = ("tabletop", "warehouse", "lidar_zone", "arm_cell", "camera")


def load_scene(path: str | Path, mesh_folders: Sequence[str | Path] = ()) -> SceneDescription:
    r"""Return the description in a YAML file: a scene file, or a MoveIt planning scene.

    Its keys determine the format. The notes of the result name odd and ignored values; odd values
    also give a warning.

    Parameters
    ----------
    path : str or path
        A file, or the name of a scene of the package: "tabletop", "warehouse", "lidar_zone",
        "arm_cell" or "camera".
    mesh_folders : sequence of paths
        Folders from which meshes may be read, besides the file's own folder, its package and the
        share folders of installed packages. Packages are searched in them first.

    Returns
    -------
    SceneDescription
        Its ``build`` makes the scene.

    Raises
    ------
    SceneFileError
        A ValueError with file, line and key of each problem.

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
    """``load_scene`` without warnings, for callers that print the notes."""
    check_kind(path, str, "path", PathLike)
    return _load(path, meshes or MeshReading())[0]


def _load(path: str | Path, meshes: MeshReading) -> tuple[SceneDescription, tuple[str, ...]]:
    file = find_scene(path)
    with _without_collections():
        top = parse(str(file), read_text(file))
        return _read(top, file, MeshFiles(file, meshes)), top.problems.doubts()


@contextmanager
def _without_collections() -> Iterator[None]:
    """Pause the garbage collector: it would double the time, and there is no garbage."""
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
        return PlanningScene(top, meshes).description(file)
    if top.is_mapping:
        top.refuse("needs objects: (a scene) or world: (a MoveIt planning scene)")
    top.expected("a mapping (key: value)")


def find_scene(name: str | Path) -> Path:
    """Return the file of a path, or of the name of a scene of the package.

    Raises SceneFileError, with the names of the scenes, for another name.
    """
    path = Path(name)
    if os.path.exists(path) or path.suffix or len(path.parts) != 1:
        return path
    for folder in _config_folders() if str(name) in READY else ():
        if (folder / f"{name}.yaml").is_file():
            return folder / f"{name}.yaml"
    reason = f"the file does not exist; the scenes of the package are {', '.join(READY)}"
    raise SceneFileError(str(name), [Problem(0, "", reason)])


def _config_folders() -> Iterator[Path]:
    """Yield possible places of ``config``: beside the sources, installed by pip, or by colcon."""
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
