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

"""A new effect is one file and one entry of the table of topics; the rest follows from them."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
import obb_collision

FILE = '''
"""The effect ``heights``: how far the second object of each colliding pair is above the first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from obb_collision.scene.broad_phase.broad_phase import NO_PAIRS
from obb_collision.scene.effects.base import Effect, Option, pair_rows


@dataclass(frozen=True, eq=False)
class Heights:
    pairs: np.ndarray
    heights: np.ndarray


def heights(boxes, pairs):
    first, second = boxes.centers[pairs, 2].T
    return Heights(pairs, second - first)


class HeightsEffect:
    name = "heights"
    description = "How far one object is above the other"
    options = {"floor": Option(0.0, -1.0, 1.0, "Not used (m).")}
    lazy = True

    def run(self, cycle, setting):
        return pair_rows(self.name, cycle, setting, heights, heights(cycle.boxes, NO_PAIRS))


EFFECT: Effect = HeightsEffect()
'''
ENTRY = """

from obb_collision.node.topics.rows import order_pairs, pair_rows

def _height_rows(result, state, dtype):
    found = order_pairs(result.pairs, state.table)
    rows = pair_rows(dtype, found, state)
    rows["height"] = found.flipped(result.heights[:, None])[:, 0]
    return rows


TOPICS["heights"] = Cloud(
    name="object_heights",
    fields=(("<f4", POSITION_FIELDS), ("<f8", ("height",)), ("<i4", PAIR_FIELDS)),
    make_rows=_height_rows,
    record=lambda a, b, height: (a, b, height),
    values=("height",),
)
"""
PROGRAM = """
import json
import numpy as np
import obb_collision as oc
from rig import Rig, cube
from obb_collision.node.parameters.table import SPECS
from obb_collision.node.topics.topics import TOPICS
from obb_collision.warm_up.steps import NODE_STEPS

scene = oc.Scene()
for name, z in (("a", 0.0), ("b", 0.25), ("c", 9.0)):
    scene.add(name, oc.OBB([0, 0, z], np.eye(3), [0.5] * 3))
scene.set_effect("heights", floor=0.5)
found = scene.check(effects=["heights"]).result("heights")
with Rig() as rig:
    rig.send(cube(("a", 2)), cube(("a", 1), (0, 0, 0.25)))
    rig.listen("object_heights", "/diagnostics")
    rig.until(lambda: "object_heights" in rig.last and rig.last["object_heights"].width, "rows")
    named = TOPICS["heights"].named(rig.last["object_heights"], ["a"])
    states = {rig.status(": cycle")["effect heights"]}
print(json.dumps({
    "package": oc.__file__,
    "pairs": found.pairs.tolist(),
    "heights": found.heights.tolist(),
    "named": named,
    "states": sorted(states),
    "parameters": {s.name: s.description for s in SPECS if s.name.startswith("effects.heights")},
    "steps": [step for step in NODE_STEPS if "heights" in step],
}))
"""


def test_an_effect_is_one_file_and_one_entry(tmp_path: Path) -> None:
    """Run a program with a copy of the package that has one more effect."""
    folder = tmp_path
    package = folder / "obb_collision"
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(Path(obb_collision.__file__).parent, package, ignore=ignored)
    (package / "scene" / "effects" / "heights.py").write_text(FILE)
    with (package / "node" / "topics" / "topics.py").open("a") as table:
        table.write(ENTRY)
    tools = Path(__file__).parents[1]
    others = os.environ.get("PYTHONPATH", "").split(os.pathsep)  # what is needed may be there
    path = os.pathsep.join(map(str, (folder, tools, tools.parent / "support", *others)))
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], cwd=folder, env={**os.environ, "PYTHONPATH": path},
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    seen: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    assert seen["package"].startswith(str(folder))
    assert (seen["pairs"], seen["heights"]) == ([[0, 1]], [0.25])
    assert seen["named"] == [["a/1", "a/2", -0.25]]
    assert seen["states"] == ["auto, computed"]
    parameters = seen["parameters"]
    assert parameters["effects.heights"] == (
        "How far one object is above the other: the topic object_heights."
    )
    assert set(parameters) == {f"effects.heights{end}" for end in ("", "_objects", "_floor")}
    assert seen["steps"] == ["effect heights"]
