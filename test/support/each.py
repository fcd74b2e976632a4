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

"""One test over a family of cases, which reports every case that fails."""

from __future__ import annotations

import inspect
import traceback
from collections.abc import Callable, Iterable
from typing import Any

import pytest


def renew(fixtures: Iterable[Any]) -> None:
    """Prepare fixtures for another case."""
    for fixture in fixtures:
        if isinstance(fixture, pytest.MonkeyPatch):
            fixture.undo()
        elif hasattr(fixture, "another_case"):
            fixture.another_case()


def each(name: str, values: Iterable[Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Run a test for each value of an argument, or of several, whose names commas part.

    The first failure is raised after all cases; the others are printed. A fixture serves all
    cases: in between its patches are undone, and its ``another_case`` is called, if it has one.
    """
    names, cases = [one.strip() for one in name.split(",")], list(values)

    def wrap(test: Callable[..., None]) -> Callable[..., None]:
        def run(**others: Any) -> None:
            failures: list[BaseException] = []
            for number, case in enumerate(cases):
                if number:
                    renew(others.values())
                given = zip(names, [case] if len(names) == 1 else case, strict=True)
                try:
                    test(**dict(given), **others)
                except (Exception, pytest.fail.Exception) as error:
                    print(f"in the case {name} = {case!r}")  # noqa: T201  # shown with a failure
                    if failures:
                        traceback.print_exception(error)
                    failures.append(error)
            if failures:
                raise failures[0]

        signature = inspect.signature(test)
        kept = [p for p in signature.parameters.values() if p.name not in names]
        run.__name__, run.__doc__, run.__module__ = test.__name__, test.__doc__, test.__module__
        run.__dict__.update(vars(test))
        vars(run)["__signature__"] = signature.replace(parameters=kept)
        return run

    return wrap
