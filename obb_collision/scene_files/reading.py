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

"""From a file to its top value. Nothing is constructed but words, lists and mappings.

The size of a file, its nesting and its number of values, each alias counted as all that it stands
for, have limits, which bound the time of everything that reads it later.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from obb_collision.scene_files.errors import Problem, Problems, SceneFileError
from obb_collision.scene_files.yaml_values import Value

#: Bytes of a file: a scene with its meshes written out, which takes a minute to read.
MAX_BYTES = 16_000_000
#: Levels of lists and mappings: three times those of a planning scene.
MAX_LEVELS = 30
#: Values in a file, those behind an alias counted at every place.
MAX_VALUES = 4_000_000


class _LimitError(yaml.MarkedYAMLError):  # type: ignore[misc]
    """A file that is YAML, but exceeds a limit."""


class _Loader(yaml.SafeLoader):  # type: ignore[misc]
    """PyYAML's loader, with limits."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._level = 0
        self._count = 0
        self._sizes: dict[str, int] = {}  # values behind each anchor that is complete

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event = self.peek_event()
        is_alias = isinstance(event, yaml.AliasEvent)
        before = self._count
        self._count += self._sizes.get(event.anchor, 1) if is_alias else 1
        self._level += 1
        if self._level > MAX_LEVELS:
            self._limit(f"nested too deeply, more than {MAX_LEVELS} levels", event)
        if self._count > MAX_VALUES:
            self._limit(f"there are more than {MAX_VALUES} values, with what aliases add", event)
        if is_alias and event.anchor in self.anchors and event.anchor not in self._sizes:
            self._limit(f"&{event.anchor} contains itself", event)
        node: yaml.Node | None = super().compose_node(parent, index)
        self._level -= 1
        if event.anchor is not None and not is_alias:
            self._sizes[event.anchor] = self._count - before
        return node

    def _limit(self, reason: str, event: yaml.Event) -> None:
        raise _LimitError(problem=reason, problem_mark=event.start_mark)


def parse(file: str, text: str) -> Value:
    """Return the top value of a YAML text; SceneFileError if it is none or exceeds a limit."""
    try:
        loader = _Loader(text)
    except yaml.reader.ReaderError as error:
        raise _no_yaml(file, text.count("\n", 0, error.position) + 1, error.reason) from None
    try:
        node = loader.get_single_node()
    except _LimitError as error:
        raise SceneFileError(file, [Problem(_line(error), "", str(error.problem))]) from None
    except yaml.MarkedYAMLError as error:
        raise _no_yaml(file, _line(error), str(error.problem)) from None
    except yaml.reader.ReaderError as error:
        raise _no_yaml(file, text.count("\n", 0, error.position) + 1, error.reason) from None
    except (ValueError, OverflowError) as error:  # numbers of directives and of escapes
        raise _no_yaml(file, loader.line + 1, str(error)) from None
    except RecursionError:  # called from deep within something else
        raise SceneFileError(file, [Problem(loader.line + 1, "", "nested too deeply")]) from None
    finally:
        loader.dispose()
    if node is None:
        raise SceneFileError(file, [Problem(1, "", "the file is empty")])
    return Value(node, "", Problems(file))


def _line(error: yaml.MarkedYAMLError) -> int:
    mark = error.problem_mark or error.context_mark
    return 1 if mark is None else int(mark.line) + 1


def _no_yaml(file: str, line: int, reason: str) -> SceneFileError:
    return SceneFileError(file, [Problem(line, "", f"no YAML: {reason}")])


def read_text(path: Path) -> str:
    """Return the text of a file. Raises SceneFileError if it cannot be read."""
    line = 0
    try:
        if path.exists() and not path.is_file():  # a device or a pipe may never end
            reason = "this is no file but a folder, a device or a pipe"
        else:
            with path.open("rb") as file:
                data = file.read(MAX_BYTES + 1)
            if len(data) <= MAX_BYTES:
                return data.decode("utf-8")
            reason = f"the file has more than {MAX_BYTES} bytes"
    except FileNotFoundError:
        reason = "there is no such file"
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        reason = f"no UTF-8 text: {error.reason} at byte {error.start}"
    except OSError as error:
        reason = f"can't be read: {error.strerror}"
    except ValueError as error:  # not a valid file name
        reason = f"can't be read: {error}"
    raise SceneFileError(str(path), [Problem(line, "", reason)])
