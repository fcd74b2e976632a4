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

"""Tables of text cells, aligned or as Markdown, also between marks in a page; and the machine."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

Table = list[list[str]]


def as_text(lines: Table) -> str:
    """Return the table in columns of spaces."""
    widths = [max(len(line[k]) for line in lines) for k in range(len(lines[0]))]
    padded = ("  ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)) for line in lines)
    return "\n".join(line.rstrip() for line in padded)


def as_markdown(lines: Table) -> str:
    """Return the table in Markdown."""
    rule = ["---"] * len(lines[0])
    return "\n".join(f"| {' | '.join(line)} |" for line in [lines[0], rule, *lines[1:]])


def digits(value: float, count: int = 3) -> str:
    """Return a number with that many digits."""
    return f"{value:#.{count}g}".rstrip(".") if value < 10**count else f"{value:,.0f}"


def write_into(page: Path, blocks: dict[str, str]) -> None:
    """Replace what stands between ``<!-- speed: NAME -->`` and ``<!-- end -->`` in a page.

    A page that is not there yet gets all blocks.
    """
    if not page.exists():
        page.write_text("".join(f"<!-- speed: {k} -->\n<!-- end -->\n\n" for k in blocks))
    text = page.read_text(encoding="utf-8")
    for name, block in blocks.items():
        start, mark, rest = text.partition(f"<!-- speed: {name} -->\n")
        if mark:
            text = f"{start}{mark}{block}\n{rest[rest.index('<!-- end -->') :]}"
    page.write_text(text, encoding="utf-8")


def machine(distributions: Iterable[str]) -> dict[str, Any]:
    """Return what absolute times depend on; the versions of distributions, None if not there."""
    versions: dict[str, str | None] = {}
    for name in sorted({"numpy", "numba", *distributions}):
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = None
    facts = {"machine": platform.machine(), "cores": os.cpu_count()}
    return {**facts, "python": platform.python_version(), "versions": versions}


def machine_line(facts: dict[str, Any]) -> str:
    """Return the same in a line."""
    named = (f"{name} {found or 'not installed'}" for name, found in facts["versions"].items())
    head = f"{facts['machine']}, {facts['cores']} cores, Python {facts['python']}"
    return ", ".join([head, *named])
