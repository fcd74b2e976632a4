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

"""From a file to its top value. Nothing is constructed but words, lists and mappings."""

from __future__ import annotations

from pathlib import Path

import yaml

from obb_collision.scene.files.errors import Problem, Problems, SceneFileError
from obb_collision.scene.files.values import Value


def parse(file: str, text: str) -> Value:
    """Return the top of a YAML text. Raises SceneFileError where it is none."""
    problems = Problems(file)
    try:
        node = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = 1 if mark is None else mark.line + 1
        raise SceneFileError(file, [Problem(line, "", f"no YAML: {error.problem}")]) from None
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise SceneFileError(file, [Problem(line, "", f"no YAML: {error.reason}")]) from None
    except RecursionError:
        raise SceneFileError(file, [Problem(1, "", "nested too deeply")]) from None
    if node is None:
        raise SceneFileError(file, [Problem(1, "", "the file is empty")])
    return Value(node, "", problems)


def read_text(path: Path) -> str:
    """Return the text of a file. Raises SceneFileError where it can't be read."""
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        reason = "there is no such file"
    except UnicodeDecodeError as error:
        reason = f"no UTF-8 text: {error.reason} at byte {error.start}"
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        reason = f"can't be read: {error}"
    raise SceneFileError(str(path), [Problem(1, "", reason)])
