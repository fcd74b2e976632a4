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

"""All programs of the project: by how they are called, where their function is."""

from __future__ import annotations

import re
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from obb_collision.commands import SUBCOMMANDS

ROOT = Path(__file__).parents[2]
TOOLS = (
    *("faults", "fuzz", "goals", "known_bugs", "latency"),
    *("regions", "robots", "soak", "peers.effects", "peers.engines"),
    *("weight", "wrong_answers", "peers.sweeps"),
)
SCRIPTS = dict(
    re.findall(r'"(obb_collision\w*) = ([\w.]+:\w+)"', (ROOT / "setup.py").read_text("utf-8"))
)
PROGRAMS = {
    **SCRIPTS,
    **{f"obb_collision {name}": f"obb_collision.{at}" for name, (at, _) in SUBCOMMANDS.items()},
    **{
        f"python -m tools.{name}": f"tools.{name}"
        + (".__main__:main" if (ROOT / "tools" / name).is_dir() else ":main")
        for name in TOOLS
    },
}
NEED_ROS = {
    *("obb_collision_node", "obb_collision_merge", "obb_collision node", "obb_collision merge"),
    *(f"python -m tools.{name}" for name in ("faults", "fuzz", "latency", "regions", "soak")),
}


def function_of(program: str) -> Callable[[list[str]], int]:
    """Return the function that a program calls."""
    module, name = PROGRAMS[program].split(":")
    found: Callable[[list[str]], int] = getattr(import_module(module), name)
    return found


def program_of(words: list[str]) -> tuple[str, list[str]]:
    """Return the program that a command line calls, and its arguments."""
    length = 3 if words[:2] == ["python", "-m"] else 2 if words[0] == "obb_collision" else 1
    return " ".join(words[:length]), words[length:]
