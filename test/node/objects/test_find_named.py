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

"""Objects are found by name as by comparing a name with those of all objects."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("rclpy")
from obb_collision.node import namespace_number
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.names import stand_in
from obb_collision.node.objects.table import ObjectTable

SPACES = ("", "/", "a", "/a", "a/b", "b", "5", "#7", "é", stand_in(namespace_number("b")))
IDS = (0, 1, -1, 5, 2**31 - 1, -(2**31))
KEYS = st.tuples(st.sampled_from((*SPACES, 7, namespace_number("b"))), st.sampled_from(IDS))
"""Of an object: its namespace, or the number of one, and its id."""
TEXTS = ("", "01", "-0", "+1", " 1", "x", "1.0", str(2**31), str(-(2**31) - 1), str(2**32 + 1))
NAMES = st.tuples(
    st.sampled_from(("", "/", *(f"{space}/" for space in SPACES), "\ud800/", "no/")),
    st.sampled_from((*map(str, IDS), *TEXTS)),
).map("".join)


def slot_of(name: str, table: ObjectTable) -> int:
    """Return the slot of the first object whose name is this one, with a slash in front or not."""
    for text in (name, "/" + name):
        for slot in np.flatnonzero(table.live).tolist():
            (namespace, ident), number = table.key(slot), int(table.ns[slot])
            known = [namespace]
            if namespace == stand_in(number):  # its name was not received yet
                known += [space for space in SPACES if namespace_number(space) == number]
            if text in [f"{each}/{ident}" for each in known]:
                return int(slot)
    return -1


@settings(max_examples=300, deadline=None)
@given(
    changes=st.lists(st.tuples(st.booleans(), KEYS), max_size=20),
    names=st.lists(NAMES, max_size=20),
)
def test_the_slots_are_those_of_a_search(
    changes: list[tuple[bool, tuple[str | int, int]]], names: list[str]
) -> None:
    table = ObjectTable()
    free = iter(range(len(changes)))
    for ends, (space, ident) in changes:
        try:
            known = table.namespaces
            number = known.admit(space) if isinstance(space, str) else known.admit_number(space)
        except RefusedError:
            continue
        (slot,) = table.find(np.array([number]), np.array([ident])).tolist()
        if slot < 0:
            table.claim_many(np.array([next(free)]), np.array([number]), np.array([ident]))
        elif ends:
            table.release(slot)
            known.forget_unused()
    expected = [slot_of(name, table) for name in names]
    assert table.find_named(names).tolist() == expected
    assert table.find_named([]).tolist() == []


def test_an_id_that_is_too_large_is_not_one_of_the_next_namespace() -> None:
    table = ObjectTable()
    table.claim(0, ("a", 1))
    following = table.namespaces.admit_number(namespace_number("a") + 1)
    table.claim_many(np.array([1]), np.array([following]), np.array([1]))
    names = ["a/1", f"a/{1 + 2**32}", f"{stand_in(following)}/{1 - 2**32}", f"#{following}/1"]
    assert table.find_named(names).tolist() == [0, -1, -1, 1]
