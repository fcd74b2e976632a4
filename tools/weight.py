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

"""Weight of the project, counted over tracked files, beside its limits.

python -m tools.weight [--collect] [--path]
"""

from __future__ import annotations

import ast
import io
import os
import re
import subprocess
import sys
import tokenize
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

from obb_collision.cli import Parser, interruptible

PACKAGE = "obb_collision"
PUBLIC_ENOUGH = ("types", "config", "cgutils")
"""Modules of ``numba.core`` that its documentation of extensions uses."""
NOT_INNER = {"_exit", "_fields", "_replace", "_asdict", "_make", "_field_defaults"}
"""Names with an underscore that the standard library documents."""
LAYOUT = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT)
STEPS = (
    ("objects/states.py", "store"),
    ("store/store.py", "_write"),
    ("broad_phase/find_pairs.py", "pairs_of_keys"),
    ("outputs/outputs.py", "_publish_rows"),
)
"""Where poses are on their way to collisions: files, and functions in them."""
Function = ast.FunctionDef | ast.AsyncFunctionDef
LONG = 40
"""Lines of a function, without its docstring, above which it is long."""
SAME = 10
"""Lines of code in a row that make a duplicate."""
Figures = dict[str, int | None]


class Source:
    """A Python file: its text and its syntax tree."""

    def __init__(self, root: Path, name: str) -> None:
        self.name, self.text = name, (root / name).read_text("utf-8")
        self.tree = ast.parse(self.text)
        self.nodes: list[Any] = list(ast.walk(self.tree))

    def all(self, *kinds: type) -> Iterator[Any]:
        """Yield the nodes of these kinds."""
        return (node for node in self.nodes if isinstance(node, kinds))

    @property
    def imports(self) -> list[tuple[str, str]]:
        """Modules and the names imported from them; the name of a whole module is empty."""
        whole = [(name.name, "") for node in self.all(ast.Import) for name in node.names]
        return whole + [
            (node.module or "", name.name)
            for node in self.all(ast.ImportFrom)
            for name in node.names
        ]

    @cached_property
    def needs(self) -> list[tuple[str, bool]]:
        """Modules of the package, or names in them, and whether only types are imported."""
        tests = (n for n in self.all(ast.If) if "TYPE_CHECKING" in ast.unparse(n.test))
        typed = {id(part) for node in tests for part in ast.walk(node)}
        return [
            (f"{node.module}.{name.name}", id(node) in typed)
            for node in self.all(ast.ImportFrom)
            for name in node.names
            if node.module and node.module.split(".")[0] == PACKAGE
        ]

    @property
    def definitions(self) -> set[str]:
        """Public names that the module defines: constants, functions and classes."""
        names = {n.name for n in self.tree.body if isinstance(n, Function | ast.ClassDef)}
        for node in self.tree.body:
            if isinstance(node, ast.Assign | ast.AnnAssign):
                parts = {part for part in ast.walk(node) if isinstance(part, ast.Name)}
                names |= {part.id for part in parts if isinstance(part.ctx, ast.Store)}
        return {name for name in names if not name.startswith("_")}

    @cached_property
    def code(self) -> list[str]:
        """The lines that hold code: not blank, comment, docstring, or import."""
        tokens = tokenize.generate_tokens(io.StringIO(self.text).readline)
        lines: set[int] = set()
        for token in tokens:
            if token.type not in (*LAYOUT, tokenize.ENDMARKER):
                lines.update(range(token.start[0], token.end[0] + 1))
        for node in self.all(ast.Import, ast.ImportFrom, ast.Expr):
            text = getattr(getattr(node, "value", None), "value", None)
            if not isinstance(node, ast.Expr) or isinstance(text, str):
                lines.difference_update(range(node.lineno, node.end_lineno + 1))
        texts = self.text.splitlines()
        return [texts[line - 1].strip() for line in sorted(lines)]

    @property
    def foreign_names(self) -> Iterator[tuple[str, bool]]:
        """Attributes with one underscore, and whether they are those of ``self`` or ``cls``."""
        for node in self.all(ast.Attribute):
            if is_private(node.attr):
                owner = node.value.id if isinstance(node.value, ast.Name) else ""
                yield node.attr, owner in ("self", "cls")
        for node in self.all(ast.Call):
            if isinstance(node.func, ast.Name) and node.func.id in ("getattr", "setattr"):
                name = ast.unparse(node.args[1])[1:-1]
                if is_private(name):
                    yield name, False


def is_private(name: str) -> bool:
    """Return whether a name begins with one underscore."""
    return name.startswith("_") and not name.startswith("__") and name not in NOT_INNER


class Project:
    """The tracked files of a project."""

    def __init__(self, root: Path, names: Iterable[str]) -> None:
        self.root, self.names = root, sorted(names)
        sources = [Source(root, name) for name in self.names if name.endswith(".py")]
        self.package = [source for source in sources if source.name.startswith(f"{PACKAGE}/")]
        self.tests = [source for source in sources if source.name.startswith("test/")]
        self.all = sources

    @cached_property
    def classes(self) -> list[ast.ClassDef]:
        """The classes of the package."""
        return [node for source in self.package for node in source.all(ast.ClassDef)]

    @cached_property
    def functions(self) -> list[Function]:
        """The functions and methods of the package."""
        kinds = (ast.FunctionDef, ast.AsyncFunctionDef)
        return [node for source in self.package for node in source.all(*kinds)]

    def lines(self, folder: str) -> int:
        """How many lines the Python files of a folder have."""
        return sum(s.text.count("\n") for s in self.all if s.name.startswith(folder))

    def inner_users(self, library: str) -> list[str]:
        """Return the modules that use private names or inner modules of a library.

        An attribute counts as the library's unless the package defines one of the same name.
        """
        ours = {node.name for node in (*self.functions, *self.classes)}
        for source in self.package:
            ours |= {n.attr for n in source.nodes if _is_set_on_self(n)}
            ours |= {n.target.id for n in source.all(ast.AnnAssign) if hasattr(n.target, "id")}
            ours |= {n.id for n in source.all(ast.Name) if isinstance(n.ctx, ast.Store)}
        users = []
        for source in self.package:
            modules = [(m, name) for m, name in source.imports if m.split(".")[0] == library]
            paths = {f"{module}.{name}".rstrip(".") for module, name in modules}
            paths |= {ast.unparse(n) for n in source.all(ast.Attribute)}
            inner = {
                match[1]
                for path in paths
                if (match := re.match(rf"{library}(?:\.core)?\.(\w+)", path))
                and (f"{library}.core." in path or is_private(match[1]))
            }
            inner -= set(PUBLIC_ENOUGH)
            inner |= {name for _, name in modules if is_private(name)}
            if modules:
                inner |= {name for name, _ in source.foreign_names if name not in ours}
            if inner:
                users.append(source.name)
        return users


def _is_set_on_self(node: ast.AST) -> bool:
    return (
        isinstance(node, ast.Attribute)
        and isinstance(node.ctx, ast.Store)
        and isinstance(node.value, ast.Name)
        and node.value.id == "self"
    )


def _is_long(node: Function) -> bool:
    parts = node.args
    return len([*parts.posonlyargs, *parts.args, *parts.kwonlyargs]) >= 10


def _is_tall(node: Function) -> bool:
    first, text = node.body[0], ast.get_docstring(node)
    start = first if text is None or len(node.body) == 1 else node.body[1]
    head = first.lineno - node.lineno
    return head + node.end_lineno - start.lineno + 1 > LONG  # type: ignore[operator]


def module_graph(sources: Sequence[Source], types: bool) -> dict[str, set[str]]:
    """Return the imports of each module, also within functions; types: with those for types."""
    names = (source.name.removesuffix(".py").removesuffix("/__init__") for source in sources)
    paths = {name.replace("/", "."): s for name, s in zip(names, sources, strict=True)}
    graph: dict[str, set[str]] = {}
    for path, source in paths.items():
        wanted = (name for name, typed in source.needs if types or not typed)
        modules = {name if name in paths else name.rpartition(".")[0] for name in wanted}
        graph[path] = (modules & set(paths)) - {path}
    return graph


def circles(graph: Mapping[str, set[str]]) -> set[frozenset[str]]:
    """Return the groups of modules that import each other, directly or not."""
    reached: dict[str, set[str]] = {}
    for start in graph:
        visited, waiting = set[str](), [start]
        while waiting:
            new = graph[waiting.pop()] - visited
            visited |= new
            waiting += new
        reached[start] = visited
    return {
        frozenset(path for path in visited if start in reached[path])
        for start, visited in reached.items()
        if start in visited
    }


def arrows(graph: Mapping[str, set[str]], folder: str) -> set[tuple[str, str]]:
    """Return which rooms of a folder import which; rooms are its folders and its files."""
    depth = folder.count(".") + 1
    inside = {path: path.split(".")[depth] for path in graph if path.startswith(f"{folder}.")}
    pairs = {(inside[a], inside[b]) for a in inside for b in graph[a] if b in inside}
    return {(a, b) for a, b in pairs if a != b}


def duplicates(sources: Iterable[Source]) -> int:
    """Return how many runs of at least SAME lines repeat earlier ones."""
    seen, count = set[tuple[str, ...]](), 0
    for source in sources:
        runs = [tuple(source.code[k : k + SAME]) for k in range(len(source.code) - SAME + 1)]
        before = False
        for run in runs:
            again = run in seen
            count += again and not before
            seen.add(run)
            before = again
    return count


def _private_uses(source: Source) -> int:
    imported = sum(is_private(n) for m, n in source.imports if m.split(".")[0] == PACKAGE)
    return imported + sum(not own for _, own in source.foreign_names)


def _public_names(project: Project) -> int:
    api = next(s for s in project.package if s.name == f"{PACKAGE}/api.py")
    for node in api.all(ast.Assign):
        if ast.unparse(node.targets[0]) == "__all__":
            return len(node.value.elts)
    return 0


def figures(project: Project) -> Figures:
    """Return the figures that files alone determine, by the names of ``LIMITS``."""
    package, tests = project.package, project.tests
    names = Counter(name for source in package for name in source.definitions)
    running, graph = (module_graph(package, types) for types in (False, True))
    at_run_time = circles(running)
    imported = {m for s in tests for m, _ in s.imports if m.split(".")[0] == PACKAGE}
    return {
        "lines of the package": project.lines(f"{PACKAGE}/"),
        "its files": len(package),
        "its lines of code": sum(len(source.code) for source in package),
        "lines of tools/": project.lines("tools/"),
        "lines of tests": project.lines("test/"),
        "public names": _public_names(project),
        "arrows among the rooms of node": len(arrows(graph, f"{PACKAGE}.node")),
        "circles of imports at run time": len(at_run_time),
        "circles by names of types only": len(circles(graph) - at_run_time),
        "duplicates of ten lines": duplicates(package),
        "functions above 40 lines": sum(map(_is_tall, project.functions)),
        "names with several definitions": sum(count > 1 for count in names.values()),
        "functions of ten or more arguments": sum(map(_is_long, project.functions)),
        "modules on inner parts of numba": len(project.inner_users("numba")),
        "modules on inner parts of rclpy": len(project.inner_users("rclpy")),
        "private names used in tests": sum(map(_private_uses, tests)),
        "modules that tests import from": len(imported),
    }


LIMITS: Figures = {
    "lines of the package": 59_500,  # 63,500 after four more issues
    "its files": 310,
    "its lines of code": 32_600,  # 34,800 then
    "lines of tools/": 10_000,
    "lines of tests": 39_000,
    "tests collected": 4_000,
    "public names": 35,
    "arrows among the rooms of node": 60,
    "circles of imports at run time": 0,
    "circles by names of types only": 3,
    "duplicates of ten lines": 2,
    "functions above 40 lines": 17,
    "names with several definitions": 262,
    "functions of ten or more arguments": 3,
    "modules on inner parts of numba": 1,
    "modules on inner parts of rclpy": 1,
    "private names used in tests": 40,
    "modules that tests import from": 125,
    "functions from poses to collisions": 30,
    "their files": 17,
}


def collected(root: Path) -> int:
    """Return how many tests pytest collects."""
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-p", "no:cacheprovider"]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    return sum("::" in line for line in done.stdout.splitlines())


def path_of_poses(root: Path, objects: int = 100, samples: int = 10) -> tuple[int, int]:
    """Return how many functions and files poses go through in a node, to its collisions.

    Those that wait while poses are stored, objects placed, pairs found, or collisions published.
    """
    from tools.latency import Latency

    functions: set[tuple[str, int]] = set()
    caller = sys.modules[Latency.__module__].__file__

    def note(frame: Any, event: str, _: object) -> None:
        place = Path(frame.f_code.co_filename), frame.f_code.co_name
        if event != "call" or not any(place[0].match(end) and place[1] == n for end, n in STEPS):
            return
        while frame.f_code.co_filename != caller:
            code, frame = frame.f_code, frame.f_back
            if code.co_filename.startswith(f"{root / PACKAGE}{os.sep}"):
                functions.add((code.co_filename, code.co_firstlineno))

    latency = Latency()
    try:
        latency.measure("object_poses", objects, 0.1)
        sys.setprofile(note)
        for _ in range(samples):
            latency.sample("object_poses")
    finally:
        sys.setprofile(None)
        latency.close()
    return len(functions), len({file for file, _ in functions})


def table(values: Figures) -> str:
    """Return figures beside their limits, a row each; too large ones are marked."""
    rows = []
    for name, most in LIMITS.items():
        value = values.get(name)
        shown = "not counted" if value is None else f"{value:,}"
        mark = " *" if value is not None and most is not None and value > most else ""
        rows.append(f"{name:36}{shown:>12}{most:>9,}{mark}")
    return "\n".join(rows)


@interruptible("python -m tools.weight")
def main(arguments: list[str] | None = None) -> int:
    """Print the table."""
    parser = Parser(prog="python -m tools.weight", description="What the project weighs.")
    parser.add_argument("--collect", action="store_true", help="collect the tests, too")
    parser.add_argument("--path", action="store_true", help="follow poses through a node, too")
    options = parser.parse_args(arguments)
    root = Path(__file__).parents[1]
    names = subprocess.check_output(["git", "ls-files"], cwd=root, text=True).splitlines()
    values = figures(Project(root, [name for name in names if (root / name).is_file()]))
    if options.collect:
        values["tests collected"] = collected(root)
    if options.path:
        path = path_of_poses(root)
        values["functions from poses to collisions"], values["their files"] = path
    print(table(values))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
