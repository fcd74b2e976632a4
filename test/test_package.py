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

"""The package: imports of its layers, versions, docstrings with examples that run, the licence."""

from __future__ import annotations

import ast
import doctest
import importlib
import inspect
import pkgutil
import re
import sys
import typing
from enum import Enum
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from each import each
from processes import run_python
from public_calls import RESULTS, public_methods, public_objects

import obb_collision
import obb_collision as oc
from obb_collision import _jit
from obb_collision._numba import function_of
from tools.weight import Source, arrows, circles, module_graph

SOURCE = Path(obb_collision.__file__).parent
ROOT = SOURCE.parent
KERNELS = {"_jit", "_kernel_cache", "_numba"}
BASE = KERNELS | {"_child", "_threads", "typing", "words"}
GEOMETRY = BASE | {"numerics", "geometry"}
LIBRARY = GEOMETRY | {"accuracy", "queries", "obb", "boxes", "shapes", "scene"}
#: What each folder, or module beside them, may import besides itself.
LAYERS: dict[str, set[str]] = {
    "_numba": set(),
    "_kernel_cache": {"_numba", "words"},
    "_jit": {"_kernel_cache", "_numba"},
    "_child": set(),
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
    "boxes": GEOMETRY | {"obb"},
    "regions": {"scene"},
    "zones": BASE,
    "scene": GEOMETRY | {"accuracy", "queries", "obb", "boxes", "shapes"},
    "robots": LIBRARY | {"cli"},
    "api": LIBRARY | {"regions", "robots", "scene_files"},
    "warm_up": LIBRARY | {"cli"},
    "scene_files": LIBRARY | {"robots"},
    "node": LIBRARY | {"cli", "robots", "scene_files", "warm_up", "zones"},
    "demo": LIBRARY | {"cli", "robots", "scene_files", "node"},
    "benchmarks": LIBRARY | {"cli", "scene_files", "demo"},
    "commands": {"cli", "node", "demo", "words"},
    "__main__": {"commands"},
}
#: The layers that may import ROS.
ABOVE = {"node", "demo"}
ROS = {
    "ament_index_python", "bond", "builtin_interfaces", "diagnostic_msgs", "geometry_msgs",
    "launch", "moveit_msgs", "nav2_msgs", "rcl_interfaces", "rclpy", "sensor_msgs", "std_msgs",
    "std_srvs", "tf2_ros", "trajectory_msgs", "vision_msgs", "visualization_msgs",
}  # fmt: skip
#: Allowed below the node: resolving a package:// mesh path, where ROS is there.
OPTIONAL = {("geometry", "ament_index_python")}
MODULES = {p for p in SOURCE.rglob("*.py") if p != SOURCE / "__init__.py"}


#: The rooms of the node: its folders, and files beside them. Each imports only those before it,
#: and what only the type checker reads counts, too.
ROOMS = (
    *("messages", "runtime", "diagnostics", "objects", "topics", "parameters", "inputs"),
    *("outputs", "robots", "cycle", "status", "base", "merger", "node"),
)
MOST_ARROWS, MOST_CIRCLES = 60, 3


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
    layers = {path: path.relative_to(SOURCE).parts[0].removesuffix(".py") for path in MODULES}
    assert set(layers.values()) == set(LAYERS)
    for path, layer in layers.items():
        for name in imported(path):
            top, _, rest = name.partition(".")
            if top == "obb_collision" and rest:
                assert rest.split(".")[0] in LAYERS[layer] | {layer}, f"{path} imports {name}"
            if layer not in ABOVE:
                assert top not in ROS or (layer, top) in OPTIONAL, f"{path} imports {name}"


def folder(path: Path) -> str:
    """Return the folder of a module, dotted; of one beside the folders, its own name."""
    parts = path.relative_to(SOURCE).with_suffix("").parts
    return ".".join(parts[:-1]) or parts[0]


def test_folders_import_in_one_direction() -> None:
    edges: dict[str, set[str]] = {}
    for path in MODULES:
        below = edges.setdefault(folder(path), set())
        if path.name == "__init__.py":  # names that load when first used
            continue
        for name in imported(path):
            parts = name.split(".")[1:]
            for count in range(1, len(parts) + 1):
                module = SOURCE.joinpath(*parts[:count]).with_suffix(".py")
                if name.startswith("obb_collision.") and module in MODULES:
                    below.add(folder(module))
        below.discard(folder(path))
    order = [*TopologicalSorter(edges).static_order()]  # CycleError for a circle
    assert order.index("queries.verdict") < order.index("scene") < order.index("node")


def test_rooms_of_the_node_import_in_one_direction_and_no_modules_in_a_circle() -> None:
    sources = [Source(ROOT, str(path.relative_to(ROOT))) for path in MODULES]
    running, graph = (module_graph(sources, types) for types in (False, True))
    found = arrows(graph, "obb_collision.node")
    assert {room for pair in found for room in pair} == set(ROOMS)
    assert [pair for pair in found if ROOMS.index(pair[0]) < ROOMS.index(pair[1])] == []
    assert len(found) <= MOST_ARROWS
    assert circles(running) == set()
    by_types = circles(graph)
    assert len(by_types) <= MOST_CIRCLES
    assert not any(name.startswith("obb_collision.node.") for names in by_types for name in names)


def test_the_library_imports_without_ros_and_what_takes_long_loads_when_it_is_used() -> None:
    code = f"""
import sys
for name in {sorted(ROS)!r}:
    sys.modules[name] = None
import obb_collision as oc
import obb_collision.api
slow = "scipy.spatial", "scipy.sparse", "scipy.special", "trimesh", "matplotlib"
assert not {{*slow}} & sys.modules.keys()
axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
assert len(oc.find_pairs(oc.Boxes([[0, 0, 0], [1, 0, 0]], [axes] * 2, [[1, 1, 1]] * 2))) == 1
"""
    run_python("-c", code)


ARRAYS = re.compile(r"Floats|Integers|Rows|Mask|Radii|NDArray")
OTHERS = ("obb_collision.node", "obb_collision.demo", "obb_collision.benchmarks")


def holds_arrays(kind: Any) -> bool:
    """Return whether a type, a tuple or NamedTuple with all that is in it, holds arrays."""
    fields = getattr(kind, "__annotations__", {}) if hasattr(kind, "_fields") else {}
    if any(ARRAYS.search(str(field)) for field in fields.values()):
        return True
    within = typing.get_type_hints(kind).values() if fields else typing.get_args(kind)
    return "ndarray" in str(kind) or any(map(holds_arrays, within))


def test_what_counts_references_takes_no_arrays_from_what_does_not() -> None:
    for module in pkgutil.walk_packages(obb_collision.__path__, "obb_collision."):
        if not module.name.startswith(OTHERS) and not module.name.endswith("__main__"):
            importlib.import_module(module.name)  # so that all kernels are defined
    counts = {kernel: "_nrt" not in kernel.targetoptions for kernel in _jit.kernels}
    given = {kernel: typing.get_type_hints(function_of(kernel))["return"] for kernel in counts}
    lends = {kernel for kernel in counts if not counts[kernel] and holds_arrays(given[kernel])}
    assert {function_of(kernel).__name__ for kernel in lends} >= {"borrowed_core"}
    wrong = [
        (function.__name__, function_of(kernel).__name__)
        for function in (function_of(kernel) for kernel in counts if counts[kernel])
        for kernel in lends
        if any(function.__globals__.get(name) is kernel for name in function.__code__.co_names)
    ]
    assert not wrong


PACKAGE = ElementTree.parse(ROOT / "package.xml").getroot()
SETUP = (ROOT / "setup.py").read_text(encoding="utf-8")
#: Where rosdep's name is neither that of the module, nor that behind python3-.
KEYS = {"llvmlite": "python3-numba", "tf2_ros": "tf2_ros_py", "trimesh": "python3-trimesh-pip"}
#: From PyPI only: the extra "bench", and "view", without which the demo works, too.
EXTRAS = {
    "coal", "example_robot_data", "fcl", "mujoco", "pinocchio", "pybullet_data", "viser",
}  # fmt: skip
#: Messages for which there is a topic or a service only where somebody has installed them.
OPTIONAL_MESSAGES = {"bond", "moveit_msgs", "nav2_msgs", "vision_msgs"}


def dependencies() -> set[str]:
    """Return the top-level modules that the package and its launch files import anywhere."""
    files = [*MODULES, *(ROOT / "launch").glob("*.py")]
    names = {name for path in files for name in imported(path)}
    optional = r'\boptional_\w+\(\s*"(\w+)'
    names |= {name for path in files for name in re.findall(optional, path.read_text())}
    tops = {name.partition(".")[0] for name in names}
    return tops - set(sys.stdlib_module_names) - {"obb_collision"}


def test_what_is_imported_or_launched_is_declared_for_rosdep_and_both_descriptions_agree() -> None:
    declared = {element.text for element in PACKAGE.findall("exec_depend")}
    modules = dependencies() - EXTRAS - OPTIONAL_MESSAGES
    assert {"rclpy", "builtin_interfaces", "numpy"} <= modules, "the search finds imports"
    keys = {name: {KEYS.get(name, name), f"python3-{name}"} for name in modules}
    assert [name for name in modules if not keys[name] & declared] == []
    text = (ROOT / "launch" / "obb_collision.launch.py").read_text(encoding="utf-8")
    assert set(re.findall(r'package="(\w+)"', text)) == {"obb_collision", "rviz2"}
    assert "rviz2" in declared
    for key in ("version", "maintainer", "author", "license", "url"):
        assert f'{key}="{PACKAGE.findtext(key)}"' in SETUP


def keys_of(distribution: str) -> set[str]:
    """Return the keys of package.xml that rosdep looks for in a distribution of ROS."""
    keys = set()
    for element in PACKAGE.iter():
        condition = element.get("condition", "").replace("$ROS_DISTRO", distribution)
        terms = [term.split(" != ") for term in condition.split(" and ") if term]
        if element.tag.endswith("depend") and all(a != b for a, b in terms):
            keys.add(str(element.text))
    return keys


def test_ubuntu_24_has_what_rosdep_asks_of_apt_there() -> None:
    text = (ROOT / ".ci" / "noble.txt").read_text(encoding="utf-8")
    known = {line.split()[0]: line.split()[1:] for line in text.splitlines() if line[0] != "#"}
    assert "python3-numba" in keys_of("lyrical")
    for distribution in ("jazzy", "kilted"):
        keys = {key for key in keys_of(distribution) if key.startswith("python3-")}
        assert {"python3-numpy", "python3-trimesh-pip"} < keys
        missing = [k for k in keys if known[k][1] == "-" and not known[k][0].startswith("pip:")]
        assert not missing, "rosdep has these keys, and noble no package"
    by_pip = {package.removeprefix("pip:") for package, version in known.values() if version == "-"}
    names = {name.removeprefix("python3-") for name in by_pip}
    for page in ("README.md", "docs/install.md"):
        text = (ROOT / page).read_text(encoding="utf-8")
        assert f"pip install --break-system-packages {' '.join(sorted(names))}  #" in text
        assert re.findall(r"rosdep .*--skip-keys (.*)$", text, re.M) == ["python3-trimesh-pip"]


def versions(file: str) -> dict[str, str]:
    """Return versions by name in a file of the CI."""
    text = (ROOT / ".ci" / file).read_text(encoding="utf-8")
    return dict(re.findall(r"^[^#\n]*?([\w-]+)==([\d.]+)", text, re.MULTILINE))


def test_the_long_ci_tries_lower_bounds_and_slow_tests_and_those_of_ubuntu_are_allowed() -> None:
    bounds = dict(re.findall(r'"([\w-]+)>=([\d.]+)"', SETUP))
    bounds.pop("python", None)
    oldest, ubuntu = versions("oldest.txt"), versions("ubuntu-24.04.txt")
    assert {"numpy", "numba", "scipy", "pytest"} <= set(bounds)
    assert oldest == bounds
    settings = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert f"setuptools>={oldest['setuptools'].partition('.')[0]}" in settings
    assert '"-m", "not slow",' in settings
    assert re.search(r"pytest .* -m ''( |$)", (ROOT / ".ci" / "full").read_text(), re.MULTILINE)
    for name in set(ubuntu) & set(bounds):
        found, least = ([int(part) for part in one[name].split(".")] for one in (ubuntu, bounds))
        assert found >= least, name
    assert {"numpy", "scipy", "numba"} <= set(ubuntu)


def test_source_files_begin_with_copyright_and_the_apache_license() -> None:
    header = Path(__file__).read_text(encoding="utf-8").partition("\n\n")[0] + "\n\n"
    first, _, rest = header.partition("\n")
    assert first == "# Copyright 2026 The obb_collision developers"
    wanted = (ROOT / "LICENSE").read_text(encoding="utf-8").partition("Licensed under the Apache")
    text = " ".join(line.removeprefix("#").strip() for line in rest.splitlines()).split()
    assert text == ("Licensed under the Apache" + wanted[2]).split()
    folders = (ROOT / name for name in ("launch", "obb_collision", "test", "tools"))
    files = [ROOT / "setup.py", *(file for folder in folders for file in folder.rglob("*.py"))]
    contents = {path: path.read_text(encoding="utf-8") for path in files}
    assert len(contents) > 400
    without = [path for path, text in contents.items() if text and not text.startswith(header)]
    assert without == []


OBJECTS = dict(public_objects())
METHODS = dict(public_methods())
DOCUMENTED = {**OBJECTS, **METHODS}
#: Arguments that need no words: an object by its name or index, and another one of the same kind.
SELF_EXPLAINING = {"name", "index", "other"}


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
    text, owner = inspect.getdoc(DOCUMENTED[name]) or "", name.rpartition(".")[0]
    goes_on = f"as in the example of ``{owner}``" in text  # that of its class
    for example in [inspect.getdoc(OBJECTS[owner]) or "", text] if goes_on else [text]:
        found = doctest.DocTestParser().get_doctest(example, known, name, None, 0)
        runner.run(found, out=said.append, clear_globs=False)
        known = found.globs
    assert runner.failures == 0, "".join(said)


@each("name", DOCUMENTED)
def test_what_is_public_has_its_sections_and_an_example(name: str) -> None:
    value = DOCUMENTED[name]
    text, names = inspect.getdoc(value) or "", arguments(value)
    found = set(re.findall(r"^(\w+)\n-+$", text, re.MULTILINE))
    assert ">>> " in text or name in METHODS
    assert "Examples" in found or not (name in OBJECTS or names)
    names -= SELF_EXPLAINING
    if name not in RESULTS:  # which a user gets and does not make
        assert not names or "Parameters" in found
        for one in names:
            assert re.search(rf"^\**(\w+, )*\**{one}\b.* : ", text, re.MULTILINE), one
        assert name in METHODS or inspect.isclass(value) or "Returns" in found
