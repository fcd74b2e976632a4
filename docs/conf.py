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

"""How Sphinx builds the documentation: ``sphinx-build -W docs build/docs``."""

from __future__ import annotations

import re
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import obb_collision

ROOT = Path(__file__).parents[1]

project = "obb_collision"
author = "The obb_collision developers"
version = release = obb_collision.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = "obb_collision"
# Links to headings, as the repository's site makes them.
myst_heading_anchors = 3
napoleon_google_docstring = False
napoleon_use_rtype = False
autodoc_member_order = "bysource"
# The messages of the node are documented without ROS as well.
autodoc_mock_imports = [
    name
    for name in ("diagnostic_msgs", "geometry_msgs", "rclpy", "sensor_msgs", "std_msgs")
    if find_spec(name) is None
]
autodoc_typehints = "signature"

html_static_path = ["wide.css"]
html_css_files = ["wide.css"]
#: Names of the inside that public classes have: those that tests leave out, too, and what kernels
#: and the classes' own modules use.
CALLS = (ROOT / "test" / "support" / "public_calls.py").read_text(encoding="utf-8")
INSIDE = {"arrays", "blank", "cap", "behind"} | set(
    re.findall(r'"(\w+)"', CALLS.partition("INTERNAL = {")[2].partition("}")[0])
)

#: Pages that are files in the root of the repository.
ROOT_FILES = {"index": "README.md", "contributing": "CONTRIBUTING.md", "changes": "CHANGELOG.rst"}


def read_page(app: Any, name: str, source: list[str]) -> None:
    """Put the files of the root in their pages, and lead links to these files to the pages."""
    text = source[0]
    if name in ROOT_FILES:
        text = (ROOT / ROOT_FILES[name]).read_text(encoding="utf-8") + "\n" + text
        text = text.replace("](docs/", "](").replace("](LICENSE)", "](../LICENSE)")
    up = "../" * name.count("/")
    for page, file in ROOT_FILES.items():
        suffix = Path(file).suffix
        text = re.sub(rf"\]\((?:\.\./)*{file}", f"]({up}{page}{suffix}", text)
    source[0] = text


TEXTS: dict[str, list[str]] = {}


def keep(app: Any, what: str, name: str, value: Any, options: Any, lines: Any) -> None:
    """Keep the docstring of an attribute: napoleon takes all before its colon for a type."""
    if what in ("attribute", "data", "property"):
        TEXTS[name] = [*lines]


def restore(app: Any, what: str, name: str, value: Any, options: Any, lines: Any) -> None:
    """Give an attribute the docstring back that it had before napoleon."""
    lines[:] = TEXTS.get(name, lines)


def is_left_out(
    app: Any, what: str, name: str, value: Any, skip: bool, options: Any
) -> bool | None:
    """Return whether a name is none for users: of the inside, or a tuple's own."""
    return True if name in INSIDE or value in (tuple.count, tuple.index) else None


def setup(app: Any) -> None:
    """Connect what happens when a page, or a docstring, is read."""
    app.connect("source-read", read_page)
    app.connect("autodoc-process-docstring", keep, priority=1)
    app.connect("autodoc-process-docstring", restore, priority=900)
    app.connect("autodoc-skip-member", is_left_out)
