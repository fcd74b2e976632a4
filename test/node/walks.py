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

"""Walks through random steps, each known by its number, and the fewest steps of one that fail."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from random import Random
from typing import Any, TypeAlias, TypeVar

Draw: TypeAlias = Callable[[Random], Any]
Step: TypeAlias = tuple[str, dict[str, Any]]
Function = TypeVar("Function", bound=Callable[..., Any])

MOODS = 0.0, 1.0, 1.0, 4.0
"""By which of these a walk favours each kind of step: what is rare comes often in some walk."""
MOST_TRIALS = 400
"""Walks tried to find the fewest steps of one that fails: half a minute."""


def one_of(values: Sequence[Any]) -> Draw:
    return lambda random: random.choice(values)


def several(values: Sequence[Any], least: int, most: int) -> Draw:
    """Draw different ones."""
    return lambda random: random.sample(values, random.randint(least, most))


def repeated(draw: Draw, least: int, most: int) -> Draw:
    return lambda random: [draw(random) for _ in range(random.randint(least, most))]


def draw_all(draws: dict[str, Draw], random: Random) -> dict[str, Any]:
    return {name: draw(random) for name, draw in draws.items()}


class Rules:
    """Kinds of steps, which are methods of a machine, with their weights and arguments."""

    def __init__(self) -> None:
        self._draws: dict[str, dict[str, Draw]] = {}
        self._weights: dict[str, float] = {}

    def add(self, name: str, weight: float = 1.0, /, **draws: Draw) -> None:
        self._draws[name], self._weights[name] = draws, weight

    def __call__(self, weight: float = 1.0, /, **draws: Draw) -> Callable[[Function], Function]:
        def add(function: Function) -> Function:
            self.add(function.__name__, weight, **draws)
            return function

        return add

    def walk(self, random: Random, length: int) -> Iterator[Step]:
        """Draw a walk, which has favourites of its own."""
        weights = [weight * random.choice(MOODS) for weight in self._weights.values()]
        if not any(weights):
            weights = [*self._weights.values()]
        for name in random.choices([*self._draws], weights, k=length):
            yield name, draw_all(self._draws[name], random)


def check(go: Callable[[Sequence[Step]], None], steps: Sequence[Step], name: str) -> None:
    """Go through the steps of a walk; an error says the fewest of them that fail."""
    error = _error(go, steps)
    if error is not None:
        fewest = _fewest(go, list(steps))
        last = _error(go, fewest) or error
        raise AssertionError(f"{name}: {last!r}\n{as_text(fewest)}") from last


def as_text(steps: Sequence[Step]) -> str:
    """Return steps as calls of a machine m."""
    return "\n".join(
        f"    m.{name}({', '.join(f'{key}={value!r}' for key, value in arguments.items())}),"
        for name, arguments in steps
    )


def _error(go: Callable[[Sequence[Step]], None], steps: Sequence[Step]) -> Exception | None:
    try:
        go(steps)
    except Exception as error:
        return error
    return None


def _fewest(go: Callable[[Sequence[Step]], None], steps: list[Step]) -> list[Step]:
    """Leave out steps, and then arguments, without which it fails all the same."""
    trials = 0

    def fails(fewer: list[Step]) -> bool:
        nonlocal trials
        trials += 1
        return trials < MOST_TRIALS and _error(go, fewer) is not None

    size = len(steps) // 2
    while size:
        start = 1  # the first one begins the walk
        while start < len(steps):
            fewer = steps[:start] + steps[start + size :]
            if fails(fewer):
                steps = fewer
            else:
                start += size
        size //= 2
    for k, (name, arguments) in enumerate(steps):
        for key in arguments:
            left = {other: value for other, value in steps[k][1].items() if other != key}
            fewer = [*steps[:k], (name, left), *steps[k + 1 :]]
            if fails(fewer):
                steps = fewer
    return steps
