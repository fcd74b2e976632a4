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

"""package.xml, setup.py and the sources agree."""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).parent.parent
PACKAGE = ElementTree.parse(ROOT / "package.xml").getroot()
SETUP = (ROOT / "setup.py").read_text(encoding="utf-8")
#: Where rosdep's name is not that of the module.
KEYS = {
    "collada": "python3-collada",
    "lxml": "python3-lxml",
    "matplotlib": "python3-matplotlib",
    "numba": "python3-numba",
    "llvmlite": "python3-numba",
    "numpy": "python3-numpy",
    "scipy": "python3-scipy",
    "tf2_ros": "tf2_ros_py",
    "trimesh": "python3-trimesh-pip",
    "yaml": "python3-yaml",
}
#: From PyPI only: the extra "bench", and "view", without which the demo works, too.
EXTRAS = {
    "coal", "example_robot_data", "fcl", "mujoco", "pinocchio", "pybullet_data", "viser",
}  # fmt: skip
#: Messages for which there is a topic or a service only where somebody has installed them.
OPTIONAL = {"moveit_msgs", "vision_msgs"}


def imported() -> set[str]:
    """Return the top-level modules that the package and its launch file import anywhere."""
    found = set()
    for path in [*(ROOT / "obb_collision").rglob("*.py"), *(ROOT / "launch").glob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                found.add(node.module)
            elif isinstance(node, ast.Call) and ast.unparse(node.func).startswith("optional_"):
                found.add(ast.literal_eval(node.args[0]))
    tops = {name.partition(".")[0] for name in found}
    return tops - set(sys.stdlib_module_names) - {"obb_collision"}


def test_what_is_imported_is_declared_for_rosdep() -> None:
    declared = {element.text for element in PACKAGE.findall("exec_depend")}
    modules = imported() - EXTRAS - OPTIONAL
    assert {"rclpy", "builtin_interfaces", "numpy"} <= modules, "the search finds imports"
    assert {KEYS.get(name, name) for name in modules} <= declared


def test_what_the_launch_file_starts_is_declared() -> None:
    text = (ROOT / "launch" / "obb_collision.launch.py").read_text(encoding="utf-8")
    started = set(re.findall(r'package="(\w+)"', text)) - {"obb_collision"}
    assert started == {"rviz2"}
    assert started <= {element.text for element in PACKAGE.findall("exec_depend")}


def test_both_descriptions_of_the_package_agree() -> None:
    for key, element in {
        "version": PACKAGE.findtext("version"),
        "maintainer": PACKAGE.findtext("maintainer"),
        "author": PACKAGE.findtext("author"),
        "license": PACKAGE.findtext("license"),
        "url": PACKAGE.findtext("url"),
    }.items():
        assert f'{key}="{element}"' in SETUP


def versions(text: str, between: str) -> dict[str, str]:
    """Return versions by name, of ``name>=1.2`` and the like."""
    return dict(re.findall(rf"^[^#\n]*?([\w-]+){between}([\d.]+)", text, re.MULTILINE))


def test_the_lower_bounds_are_what_the_long_ci_tries() -> None:
    bounds = dict(re.findall(r'"([\w-]+)>=([\d.]+)"', SETUP))
    bounds.pop("python", None)
    oldest = versions((ROOT / ".ci" / "oldest.txt").read_text(encoding="utf-8"), "==")
    assert {"numpy", "numba", "scipy", "pytest"} <= set(bounds)
    assert oldest == bounds
    assert f"setuptools>={'.'.join(oldest['setuptools'].split('.')[:1])}" in (
        ROOT / "pyproject.toml"
    ).read_text(encoding="utf-8")


def test_what_is_marked_slow_is_run_by_the_long_ci() -> None:
    settings = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert '"-m", "not slow",' in settings
    assert re.search(r"pytest .* -m ''( |$)", (ROOT / ".ci" / "full").read_text(), re.MULTILINE)


def test_ubuntus_versions_are_allowed() -> None:
    bounds = dict(re.findall(r'"([\w-]+)>=([\d.]+)"', SETUP))
    ubuntu = versions((ROOT / ".ci" / "ubuntu-24.04.txt").read_text(encoding="utf-8"), "==")
    for name in set(ubuntu) & set(bounds):
        found, least = ([int(part) for part in one[name].split(".")] for one in (ubuntu, bounds))
        assert found >= least, name
    assert {"numpy", "scipy", "numba"} <= set(ubuntu)


SOURCES = sorted(
    [ROOT / "setup.py"]
    + [
        path
        for folder in ("launch", "obb_collision", "test", "tools")
        for path in (ROOT / folder).rglob("*.py")
    ]
)
#: The comment block of this file: copyright, licence, where it is.
HEADER = Path(__file__).read_text(encoding="utf-8").partition("\n\n")[0] + "\n\n"


def test_the_header_is_that_of_the_apache_license() -> None:
    first, _, rest = HEADER.partition("\n")
    assert first == "# Copyright 2026 The obb_collision developers"
    wanted = (ROOT / "LICENSE").read_text(encoding="utf-8").partition("Licensed under the Apache")
    text = " ".join(line.removeprefix("#").strip() for line in rest.splitlines()).split()
    assert text == ("Licensed under the Apache" + wanted[2]).split()


def test_source_files_begin_with_copyright_and_licence() -> None:
    contents = {path: path.read_text(encoding="utf-8") for path in SOURCES}
    assert len(contents) > 400
    without = [path for path, text in contents.items() if text and not text.startswith(HEADER)]
    assert without == []
