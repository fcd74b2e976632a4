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
from functools import cache
from pathlib import Path

import obb_collision

ROOT = Path(obb_collision.__file__).parent
KERNELS = {"_jit", "_kernel_cache", "_numba"}
BASE = KERNELS | {"_threads", "typing", "words"}
GEOMETRY = BASE | {"numerics", "geometry"}
LIBRARY = GEOMETRY | {"accuracy", "queries", "obb", "shapes", "scene"}
#: What each folder, or module beside them, may import besides itself.
LAYERS: dict[str, set[str]] = {
    "_numba": set(),
    "_kernel_cache": {"_numba"},
    "_jit": {"_kernel_cache", "_numba"},
    "_threads": {"words"},
    "typing": set(),
    "words": set(),
    "cli": {"words"},
    "accuracy": {"words"},
    "numerics": BASE,
    "geometry": BASE | {"numerics"},
    "shapes": GEOMETRY,
    "queries": GEOMETRY,
    "obb": GEOMETRY | {"queries"},
    "regions": {"scene"},
    "scene": GEOMETRY | {"accuracy", "queries", "obb", "shapes"},
    "robots": LIBRARY | {"cli"},
    "api": LIBRARY | {"regions", "robots", "scene_files"},
    "warm_up": LIBRARY | {"cli"},
    "scene_files": LIBRARY | {"robots"},
    "node": LIBRARY | {"cli", "robots", "scene_files", "warm_up"},
    "demo": LIBRARY | {"cli", "robots", "scene_files", "node"},
    "benchmarks": LIBRARY | {"cli", "scene_files"},
    "commands": {"cli", "node", "demo"},
    "__main__": {"commands"},
}
#: The layers that may import ROS.
ABOVE = {"node", "demo"}
ROS = {
    "ament_index_python", "builtin_interfaces", "diagnostic_msgs", "geometry_msgs", "launch",
    "moveit_msgs", "rcl_interfaces", "rclpy", "sensor_msgs", "std_msgs", "std_srvs", "tf2_ros",
    "trajectory_msgs", "vision_msgs", "visualization_msgs",
}  # fmt: skip
#: Allowed below the node: resolving a package:// mesh path, where ROS is there.
OPTIONAL = {("geometry", "ament_index_python")}
MODULES = sorted(p for p in ROOT.rglob("*.py") if p != ROOT / "__init__.py")


@cache
def imported(path: Path) -> set[str]:
    """Return the dotted names that a module imports; not those for the type checker alone."""
    names: set[str] = set()
    waiting: list[ast.AST] = [ast.parse(path.read_text())]
    while waiting:
        node = waiting.pop()
        if not (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"):
            waiting += ast.iter_child_nodes(node)
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            assert node.module is not None
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def test_no_layer_looks_up() -> None:
    for path in MODULES:
        layer = path.relative_to(ROOT).parts[0].removesuffix(".py")
        for name in imported(path):
            top, _, rest = name.partition(".")
            if top == "obb_collision" and rest:
                assert rest.split(".")[0] in LAYERS[layer] | {layer}, f"{path} imports {name}"
            if layer not in ABOVE:
                assert top not in ROS or (layer, top) in OPTIONAL, f"{path} imports {name}"


def folder(path: Path) -> str:
    """Return the folder of a module, dotted; of one beside the folders, its own name."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1]) or parts[0]


def folders_imported() -> dict[str, set[str]]:
    """Return for each folder those that its modules import from."""
    edges: dict[str, set[str]] = {}
    for path in MODULES:
        below = edges.setdefault(folder(path), set())
        if path.name == "__init__.py":  # names that load when first used
            continue
        for name in imported(path):
            parts = name.split(".")[1:]
            for count in range(1, len(parts) + 1):
                module = ROOT.joinpath(*parts[:count]).with_suffix(".py")
                if name.startswith("obb_collision.") and module in MODULES:
                    below.add(folder(module))
        below.discard(folder(path))
    return edges


def test_folders_import_in_one_direction() -> None:
    edges = folders_imported()
    order: list[str] = []
    while edges:
        free = sorted(name for name, below in edges.items() if not below - set(order))
        assert free, f"a circle among {sorted(edges)}"
        order += free
        for name in free:
            del edges[name]
    assert order.index("queries.verdict") < order.index("scene") < order.index("node")


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


def test_what_takes_long_to_import_loads_when_it_is_used() -> None:
    slow = {"scipy.spatial", "scipy.sparse", "scipy.special", "trimesh", "matplotlib"}
    code = f"import obb_collision.api, sys; print(*({slow!r} & sys.modules.keys()))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    )
    assert done.stdout.strip() == ""
