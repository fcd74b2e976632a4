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

"""Each layer imports only those below it, and nothing below the node imports ROS."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import obb_collision

ROOT = Path(obb_collision.__file__).parent
LAYERS = {
    "_kernel_cache": set(),
    "api": {"geometry", "queries", "obb", "scene"},
    "_jit": {"_kernel_cache", "_compiling"},
    "_compiling": {"_kernel_cache"},
    "geometry": {"_jit"},
    "queries": {"_jit", "geometry"},
    "obb": {"_jit", "geometry", "queries"},
    "scene": {"_jit", "geometry", "queries", "obb"},
    "cli": {"geometry"},
    "benchmarks": {"cli", "_jit", "geometry", "queries", "obb", "scene"},
    "warm_up": {
        "cli",
        "_jit",
        "_kernel_cache",
        "_compiling",
        "geometry",
        "queries",
        "obb",
        "scene",
    },
    "node": {
        *(
            "cli",
            "_jit",
            "_kernel_cache",
            "_compiling",
            "geometry",
            "queries",
            "obb",
            "scene",
            "warm_up",
        ),
    },
    "checks": {"cli", "_jit", "geometry", "queries", "obb", "scene", "node"},
    "demo": {"cli", "geometry", "scene", "node"},
}
ROS = {
    "ament_index_python", "builtin_interfaces", "diagnostic_msgs", "geometry_msgs", "launch",
    "rcl_interfaces", "rclpy", "sensor_msgs", "std_msgs", "std_srvs", "tf2_ros",
    "visualization_msgs",
}  # fmt: skip
#: Allowed below the node: resolving a package:// mesh path, where ROS is there.
OPTIONAL = {("geometry", "ament_index_python")}
MODULES = sorted(p for p in ROOT.rglob("*.py") if p != ROOT / "__init__.py")


def imported(path: Path) -> set[str]:
    """Return the dotted names that a module imports, relative imports resolved."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            assert node.module is not None
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_no_layer_looks_up(path: Path) -> None:
    layer = path.relative_to(ROOT).parts[0].removesuffix(".py")
    for name in imported(path):
        top, _, rest = name.partition(".")
        if top == "obb_collision" and rest:
            assert rest.split(".")[0] in LAYERS[layer] | {layer}, f"{layer} imports {name}"
        if layer not in ("node", "checks", "demo"):
            assert top not in ROS or (layer, top) in OPTIONAL, f"{layer} imports {name}"


def test_every_layer_is_known() -> None:
    found = {p.relative_to(ROOT).parts[0].removesuffix(".py") for p in MODULES}
    assert found == set(LAYERS)


def test_the_library_imports_without_ros() -> None:
    code = f"""
import sys
for name in {sorted(ROS)!r}:
    sys.modules[name] = None
import obb_collision as oc
axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
print(len(oc.find_pairs(oc.Boxes([[0, 0, 0], [1, 0, 0]], [axes] * 2, [[1, 1, 1]] * 2))))
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    )
    assert done.stdout.strip() == "1"
