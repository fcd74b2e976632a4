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

"""Counts of the project's weight, each on a small project."""

from __future__ import annotations

from pathlib import Path

from each import each

from tools.weight import LIMITS, Project, figures, table

SETUP = 'entry_points={"console_scripts": ["one = a.b:main", "two = a:main"]}\n'
SMALL = {
    "setup.py": SETUP,
    "obb_collision/api.py": '__all__ = ["a", "b", "c"]\n',
    "obb_collision/accuracy.py": "class Accuracy(IntEnum):\n    SPHERE = 0\n    MESH = 1\n",
    "obb_collision/base.py": "class Base:\n    size: int\n\n    def grow(self):\n        pass\n",
    "obb_collision/scene.py": '''"""How scenes are."""
# a comment, and a blank line

import numpy as np


class Scene(Base):
    """Text,
    on two lines."""

    def __init__(self):
        self.padding, self._hidden = 0, """code
        on two lines"""

    def check(self):
        return np.hypot(
            1,

            2,
        )
''',
}


def counted(folder: Path, **more: str) -> dict[str, int | None]:
    """Return the figures of the small project, with more files: a module by its name."""
    parts = {"in_": "obb_collision/", "test_": "test/test_", "tool_": "tools/"}
    files = dict(SMALL)
    for name, text in more.items():
        start = next(start for start in parts if name.startswith(start))
        files[f"{parts[start]}{name.removeprefix(start)}.py"] = text
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return figures(Project(folder, files))


def test_a_small_project_is_counted(tmp_path: Path) -> None:
    found = counted(tmp_path, tool_a="1\n2\n", test_a="1\n2\n3\n")
    assert found["lines of the package"] == 1 + 3 + 5 + 20
    assert found["its files"] == 4
    # of the scene: class, def, three of code, def, and five with a blank one inside brackets
    assert found["its lines of code"] == 1 + 3 + 4 + (1 + 1 + 2 + 1 + 4)
    assert (found["lines of tools/"], found["lines of tests"]) == (2, 3)
    assert found["public names"] == 3
    assert found["public members of Scene"] == len({"size", "grow", "padding", "check"})
    assert (found["console scripts"], found["levels of accuracy"]) == (2, 2)
    assert found["module docstrings that ask"] == 1
    assert set(found) <= set(LIMITS)


@each(
    "row, text, more",
    [
        ("classes called Bodies or Sides", "class Bodies: ...\nclass Sides: ...\n", 2),
        ("class names used twice", "class Base: ...\nclass New: ...\n", 1),
        ("functions of ten or more arguments", "def f(a, b, c, d, e, f, g, h, *, i, j): ...\n", 1),
        ("functions of ten or more arguments", "def f(a, b, c, d, e, f, g, h, *, i): ...\n", 0),
        ("starred tuples", "f(*(a, b))\nf(*a)\n[*(a, b)]\n", 1),
        ("fmt: skip", "a = 1  # fmt: skip\n", 1),
        ("modules on inner parts of numba", "from numba.core import types, config\n", 0),
        ("modules on inner parts of numba", "import numba\nnumba.core.types.f8\n", 0),
        ("modules on inner parts of numba", "from numba.core import caching, types\n", 1),
        ("modules on inner parts of numba", "import numba\nnumba.core.caching\n", 1),
        ("modules on inner parts of numba", "from numba.extending import _Intrinsic\n", 1),
        ("modules on inner parts of numba", "import numba\ndef f(a): a._inner\n", 1),
        ("modules on inner parts of numba", "import numba\n_own = 1\ndef f(a): a._own\n", 0),
        ("modules on inner parts of rclpy", "import rclpy\ndef f(a): a._inner\n", 1),
        ("modules on inner parts of rclpy", "import rclpy\ngetattr(a, '_inner')\n", 1),
        ("modules on inner parts of rclpy", "def f(a): a._inner, a._replace()\n", 0),
    ],
)
def test_what_a_module_adds(tmp_path: Path, row: str, text: str, more: int) -> None:
    before = counted(tmp_path)[row]
    assert before is not None
    assert counted(tmp_path, in_new=text)[row] == before + more


def test_what_tests_reach_into(tmp_path: Path) -> None:
    text = """
import obb_collision as oc
from obb_collision.scene import _private, Scene
from obb_collision.scene import check
class A:
    def test(self):
        self._own = Scene()._padding
"""
    found = counted(tmp_path, test_a=text, test_b="from obb_collision.scene import Scene\n")
    assert found["private names used in tests"] == 2
    assert found["modules that tests import from"] == 2


def test_figures_above_their_limits_are_marked() -> None:
    values: dict[str, int | None] = {"its files": 331, "public names": 34}
    plain = table(values)
    assert f"its files{331:>39}      330 *" in plain
    assert f"public names{34:>36}       34\n" in plain
    assert f"tests collected{'not counted':>33}    4,000\n" in plain
