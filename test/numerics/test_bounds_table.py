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

"""The tables of error bounds in ``bounds.md`` say what the constants and the tests are."""

from __future__ import annotations

import ast
import math
import re
from fractions import Fraction
from functools import cache
from importlib import import_module
from pathlib import Path

from each import each

import obb_collision
from obb_collision.numerics.constants import ROUNDOFF

PACKAGE = Path(obb_collision.__file__).parent
TESTS = Path(__file__).parent
PAGE = TESTS / "bounds.md"
CELLS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in PAGE.read_text(encoding="utf-8").splitlines()
    if re.match(r"\|.*`(numerics|geometry|queries|scene|robots)\.[\w.]+`", line)
]
#: How much longer a whole turn is taken than it is: no bound of an error.
NOT_LISTED = {"WHOLE_TURN"}


def multiple(text: str) -> Fraction:
    """Return the number that a bound such as ``16 u``, ``4 u^2`` or ``1 + 8 u`` is."""
    match = re.fullmatch(r"(1 \+ )?(\d+) u(\^2)?", text)
    assert match, f"{text!r} is no multiple of u"
    unit = Fraction(1, 2 ** (106 if match[3] else 53))
    return (1 if match[1] else 0) + int(match[2]) * unit


def constant_of(cells: list[str]) -> tuple[str, str]:
    """Return module and name of the constant of a row."""
    (name,) = [cell.strip("`") for cell in cells if re.fullmatch(r"`[a-z_.]+\.[A-Z_]+`", cell)]
    module, _, constant = name.rpartition(".")
    return module, constant


@each("cells", CELLS)
def test_a_bound_is_what_the_constant_says_and_a_test_measures_it(cells: list[str]) -> None:
    module, name = constant_of(cells)
    value = getattr(import_module(f"obb_collision.{module}"), name)
    assert Fraction(value) == multiple(cells[1])
    assert module in ("numerics.constants", multiples_of_roundoff()[name])
    if len(cells) == 4:  # a margin
        return
    file, _, test = cells[-1].strip("`").partition("::")
    (function,) = [
        node
        for node in ast.parse((TESTS / file).read_text()).body
        if isinstance(node, ast.FunctionDef) and node.name == test
    ]
    assert re.search(r"\bcheck(_ratios|_flips)?\(", ast.unparse(function)), "it measures"


@cache
def multiples_of_roundoff() -> dict[str, str]:
    """Return the module of each constant that is written as a multiple of ROUNDOFF."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        module = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                names = {n.id for n in ast.walk(node.value) if isinstance(n, ast.Name)}
                if "ROUNDOFF" in names:
                    assert node.targets[0].id not in found, "two constants of one name"
                    found[node.targets[0].id] = module
    return found


def test_every_bound_is_in_a_table() -> None:
    listed = {constant_of(cells)[1] for cells in CELLS}
    assert listed == set(multiples_of_roundoff()) - NOT_LISTED
    assert math.ldexp(1.0, -53) == ROUNDOFF


def test_no_name_of_a_number_has_two_values() -> None:
    """Among constants of arithmetic: the same name means the same everywhere."""
    values: dict[str, set[float]] = {}
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE).parts
        if parts[0] in ("numerics", "geometry", "queries"):
            module = import_module(f"obb_collision.{'.'.join(parts).removesuffix('.py')}")
            for name, value in vars(module).items():
                if name.isupper() and isinstance(value, float):
                    values.setdefault(name, set()).add(value)
    assert len(values) > 40
    assert {name for name, found in values.items() if len(found) > 1} == set()
