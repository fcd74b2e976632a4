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

"""Every public name is documented in numpy sections, with an example that runs."""

from __future__ import annotations

import doctest
import inspect
import re
from enum import Enum
from typing import Any

import numpy as np
from each import each
from public_calls import public_methods, public_objects

import obb_collision as oc

OBJECTS = dict(public_objects())
METHODS = dict(public_methods())
DOCUMENTED = {**OBJECTS, **METHODS}


def sections(value: Any) -> set[str]:
    """Return the titles of the sections of a docstring."""
    return set(re.findall(r"^(\w+)\n-+$", inspect.getdoc(value) or "", re.MULTILINE))


def arguments(value: Any) -> set[str]:
    """Return the names of the arguments of a function or a class."""
    if inspect.isclass(value) and issubclass(value, Enum):
        return set()
    return set(inspect.signature(value).parameters) - {"self", "cls"}


@each("name", DOCUMENTED)
def test_examples_run(name: str) -> None:
    known: dict[str, Any] = {"oc": oc, "np": np}
    said: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    for example in examples_of(name):
        found = doctest.DocTestParser().get_doctest(example, known, name, None, 0)
        runner.run(found, out=said.append, clear_globs=False)
        known = found.globs
    assert runner.failures == 0, "".join(said)


def examples_of(name: str) -> list[str]:
    """Return the docstring of a name, after that of its class where it goes on with its example."""
    text = inspect.getdoc(DOCUMENTED[name]) or ""
    owner = name.rpartition(".")[0]
    if f"as in the example of ``{owner}``" not in text:
        return [text]
    return [inspect.getdoc(OBJECTS[owner]) or "", text]


@each("name", OBJECTS)
def test_every_public_name_has_its_sections_and_an_example(name: str) -> None:
    value = OBJECTS[name]
    text = inspect.getdoc(value) or ""
    assert ">>> " in text
    found = sections(value)
    assert "Examples" in found
    if name in MADE_BY_THE_LIBRARY:
        return
    names = arguments(value)
    assert not names or {"Parameters", "Raises"} <= found
    assert all(re.search(rf"^(\w+, )*{one}\b.* : ", text, re.MULTILINE) for one in names)
    assert inspect.isclass(value) or "Returns" in found


@each("name", METHODS)
def test_every_public_method_has_its_sections(name: str) -> None:
    value = METHODS[name]
    text = inspect.getdoc(value) or ""
    found = sections(value)
    names = arguments(value)
    if names:
        assert {"Parameters", "Raises", "Examples"} <= found
        missing = [
            n for n in names if not re.search(rf"^\**(\w+, )*\**{n}\b.* : ", text, re.MULTILINE)
        ]
        assert missing == []


#: What a user gets and does not make.
MADE_BY_THE_LIBRARY = {"MeshTrees", "Report", "Robot", "SceneDescription", "shapes.Shape"}
