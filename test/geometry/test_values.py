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

"""Values: nobody can write to their arrays, and attributes that are set are checked or refused."""

from __future__ import annotations

import copy
import inspect
import pickle
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from each import each
from public_calls import INSTANCES, INTERNAL, public_calls, public_objects
from small_robots import slider

import obb_collision as oc

#: Kernels', what the node sets, and how a URDF was read.
INSIDE = INTERNAL | {
    "arrays", "cache", "cycle", "element", "standing", "store", "tree", "warns",
}  # fmt: skip
DATA = Path(__file__).parents[1] / "data"
MADE = {
    **{name: call for name, call in public_calls().items() if call.works},
    **INSTANCES,
    "Robot": lambda: oc.Robot.from_urdf(slider('<sphere radius="1"/>')),
    "SceneDescription": lambda: oc.load_scene(DATA / "scene.yaml"),
    "Report": lambda: INSTANCES["Scene"]().check(effects=["sweep"]),
}
PUBLIC = {
    kind
    for _, kind in public_objects()
    if inspect.isclass(kind) and not inspect.isabstract(kind) and not issubclass(kind, Enum)
}


def attributes(value: Any) -> Iterator[tuple[str, Any]]:
    """Yield name and value of all that can be read of an object."""
    for name in dir(value):
        if name[0] != "_" and name not in INSIDE:
            with suppress(ValueError):  # an effect that is off
                found = getattr(value, name)
                if not inspect.isroutine(found):
                    yield name, found


def is_ours(value: Any) -> bool:
    """Return whether something is a value of this package, and no class."""
    ours = type(value).__module__.startswith("obb_collision")
    return ours and not isinstance(value, (Enum, type))


def values_in(value: Any, way: str, seen: list[Any]) -> Iterator[tuple[str, Any]]:
    """Yield this package's values and the arrays that can be reached from one, by the way there."""
    if isinstance(value, np.ndarray):
        yield way, value
    elif is_ours(value):
        if not any(value is one for one in seen):
            seen.append(value)
            yield way, value
            for name, found in attributes(value):
                yield from values_in(found, f"{way}.{name}", seen)
    elif isinstance(value, (list, tuple, Mapping)):
        parts = value.items() if isinstance(value, Mapping) else enumerate(value)
        for key, part in parts:
            yield from values_in(part, f"{way}[{key!r}]", seen)


def check_arrays(value: Any) -> None:
    """Assert that no array can be written to that is there the next time."""
    first, second = (dict(values_in(value, type(value).__name__, [])) for _ in range(2))
    for way, array in first.items():
        if isinstance(array, np.ndarray) and array.flags.writeable:
            assert not np.shares_memory(array, second[way]), way


def refuses(value: Any, name: str) -> bool:
    try:
        setattr(value, name, object())
    except (AttributeError, TypeError, ValueError):
        return True
    return False


def check_attributes(value: Any) -> None:
    """Assert that attributes of a value, and of what is in it, refuse what makes no sense."""
    for way, one in values_in(value, type(value).__name__, []):
        if is_ours(one):
            for name, _ in attributes(one):
                assert refuses(one, name), f"{way}.{name}"


def made(name: str) -> Any:
    """Return what a public call gives."""
    make: Any = MADE[name]
    return make.function(**make.good) if hasattr(make, "good") else make()


@each("name", MADE)
def test_no_array_can_be_written_and_attributes_are_checked(name: str) -> None:
    """What functions return belongs to the caller, who may write to its arrays."""
    value = made(name)
    if type(value) in PUBLIC:
        check_arrays(value)
    check_attributes(value)


def test_every_public_type_is_looked_at() -> None:
    assert {type(made(name)) for name in MADE} >= PUBLIC
    assert len(PUBLIC) > 20


@each("name, misspelt, right", [
    ("Scene", "paddings", "padding"), ("RobotScene", "link_object", "link_objects"),
])  # fmt: skip
def test_a_misspelt_property_is_refused_with_a_guess(name: str, misspelt: str, right: str) -> None:
    with pytest.raises(AttributeError, match=f"{name} has no '{misspelt}' .* mean {right}"):
        setattr(made(name), misspelt, {})


COPIES: dict[str, Callable[[Any], Any]] = {
    "pickled": lambda value: pickle.loads(pickle.dumps(value)),
    "copied": copy.copy,
    "copied with all in it": copy.deepcopy,
}


@each("way", COPIES)
@each("name", ["Boxes", "Capsules", "HalfSpaces", "MeshTrees", "MovingBoxes", "PlacedMeshes"])
def test_batches_can_be_pickled_and_copied(name: str, way: str) -> None:
    """Kernels have arrays of one kind, which may be written to; nothing is there twice."""
    value = made(name)
    dict(attributes(value))  # views are there
    again = COPIES[way](value)
    check_arrays(again)
    check_attributes(again)
    old, new = (dict(values_in(one.arrays, name, [])) for one in (value, again))
    assert old.keys() == new.keys()
    for one, array in new.items():
        if isinstance(array, np.ndarray):
            assert array.flags.writeable
            assert np.array_equal(array, old[one])
    if name == "PlacedMeshes":
        assert again.trees.arrays is again.arrays.trees
    if way == "pickled":
        assert len(pickle.dumps(value)) == len(pickle.dumps(made(name)))
