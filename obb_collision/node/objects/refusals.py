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

"""New objects that were refused, and names of objects that are not there."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice

from obb_collision.node.messages.conversions import NANOSECONDS, Key, name_from_key
from obb_collision.node.messages.marker_shapes import NO_BODY
from obb_collision.node.messages.names import namespace_number, shortened, stand_in, whole_from_text
from obb_collision.node.objects.table import NO_TIME, ObjectTable
from obb_collision.scene.store.patterns import Overrides

MAX_UNPLACEABLE = 1000
"""Maximum refused objects stored, the latest ones: bounds the memory that senders can use."""
OTHERS = "others", 1 << 32
"""Stands for those beyond it: no marker has such an id, so only what concerns all removes it."""


class Unplaceable(dict[Key, str]):
    """Reasons why objects were refused, by key; names that are too long are shortened.

    A refusal stays until the same input has more about the object, whatever other inputs send.
    """

    def __init__(self) -> None:
        super().__init__()
        self._expiries: dict[Key, dict[int, int]] = {}  # by input

    def add(self, key: Key, reason: str, expiry: int = NO_TIME, of_set: int = 0) -> None:
        """Store why an object is refused, until ``expiry`` (ns); not for markers without a body.

        of_set: the number of the input of complete sets that sent the object, else 0. Then only the
        next set of this input removes the refusal.
        """
        if reason == NO_BODY:
            self.delete(key)
            return
        key = shortened(key[0]), key[1]
        self._put(key, reason, self.forget(key) | {of_set: expiry})
        if len(self) > MAX_UNPLACEABLE:
            both = self.forget(next(iter(self))), self.forget(OTHERS)
            latest = {
                of_input: max(of.get(of_input, 0) for of in both)
                for of_input in {**both[0], **both[1]}
            }
            self._put(OTHERS, "too many refused", latest)

    def _put(self, key: Key, reason: str, expiries: dict[int, int]) -> None:
        self[key], self._expiries[key] = reason, expiries

    def forget(self, key: Key) -> dict[int, int]:
        """Remove the refusal of a key, if there is one; return when it expires (ns), by input."""
        self.pop(key, None)
        return self._expiries.pop(key, {})

    def _end(self, key: Key, inputs: Iterable[int]) -> None:
        """Forget what some inputs have refused."""
        expiries = self._expiries.get(key, {})
        for number in inputs:
            expiries.pop(number, None)
        if not expiries:
            self.forget(key)

    def delete(self, key: Key) -> None:
        """Remove the refusal of an object that a marker deletes or replaces."""
        self._end((shortened(key[0]), key[1]), [0])

    def delete_all(self, namespace: str | None) -> None:
        """Remove the refusals of markers, all or those of a namespace."""
        shown = None if namespace is None else shortened(namespace)
        for key in [key for key in self if shown in (None, key[0])]:
            self.delete(key)

    def forget_set(self, of_set: int) -> None:
        """Remove the refusals of the last set of an input."""
        for key in list(self):
            self._end(key, [of_set])

    def expire(self, now: int) -> None:
        """Remove the refusals of objects whose lifetime is over."""
        for key, expiries in list(self._expiries.items()):
            self._end(key, [number for number, expiry in expiries.items() if expiry <= now])

    def clock_jumped(self, shift: int) -> None:
        """Shift times by a jump of the clock (ns)."""
        for expiries in self._expiries.values():
            for number, expiry in expiries.items():
                expiries[number] = expiry if expiry == NO_TIME else expiry + shift


MEMORY = NANOSECONDS
"""For how long (ns) a name counts after its last state, and for how long not after its DELETE."""
MAX_NAMES = 1000
"""Names stored: bounds the memory that senders can use, and the time to look them up."""
MAX_READ = 10_000
"""Names of a message that are read; whether further ones are ignored is not known."""
MAX_DELETED = 10_000
"""Objects of a message whose DELETE is remembered; states of further ones count for a second."""


class UnknownObjects:
    """Names without an object, each with the time (ns) of its last state."""

    def __init__(self, table: ObjectTable) -> None:
        self._table = table
        self._came: dict[str, int] = {}
        self._deleted: dict[str, int] = {}
        self._left_out = -MEMORY  # when there were more names than are stored
        self.ignored: Overrides[bool] = Overrides()
        """Names, and patterns of names, that do not count."""

    def note(self, names: Iterable[str], now: int) -> None:
        """Take note of names for which a state came, and that have no object."""
        for number, name in enumerate(names):
            key = _plain(name)
            if number < MAX_READ and (
                now - self._deleted.get(key, now - MEMORY) < MEMORY or self.ignored.value(key)
            ):
                continue
            if number == MAX_READ or (key not in self._came and len(self._came) == MAX_NAMES):
                self._left_out = now
                break
            self._came[key] = now

    def left_out(self, now: int) -> bool:
        """Return whether there may be more names at a time (ns) than are stored."""
        return 0 <= now - self._left_out < MEMORY

    def deleted(self, keys: Iterable[Key], now: int) -> None:
        """Note deleted objects: states of theirs may be on their way."""
        self._forget_deleted(now)
        others: dict[str, str] = {}  # as bulk poses name a namespace once it is gone
        for key in islice(keys, MAX_DELETED):
            if key[0] not in others:
                others[key[0]] = stand_in(namespace_number(key[0]))
            for name in (_plain(name_from_key(key)), f"{others[key[0]]}/{key[1]}"):
                self._deleted[name] = now
                self._came.pop(name, None)

    def _forget_deleted(self, now: int) -> None:
        if self._deleted:
            self._deleted = {n: at for n, at in self._deleted.items() if 0 <= now - at < MEMORY}

    def names(self, now: int) -> list[str]:
        """Return the names that count at a time (ns)."""
        self._forget_deleted(now)
        if not self._came:
            return []
        names = list(self._came)
        present = (self._table.find_named([self._present(name) for name in names]) >= 0).tolist()
        self._came = {
            name: at
            for (name, at), is_present in zip(self._came.items(), present, strict=True)
            if not is_present and 0 <= now - at < MEMORY
        }
        return list(self._came)

    def _present(self, name: str) -> str:
        """Return the present name of an object whose namespace was known by its number only."""
        namespace, _, ident = name.rpartition("/")
        number = whole_from_text(namespace[1:]) if namespace.startswith("#") else None
        text = None if number is None else self._table.namespaces.names.get(number)
        return name if text is None else f"{text}/{ident}"

    def clock_jumped(self, shift: int) -> None:
        """Shift times by a jump of the clock (ns)."""
        self._left_out += shift
        for times in (self._came, self._deleted):
            times.update({name: at + shift for name, at in times.items()})


def _plain(name: str) -> str:
    """Return a name as the table finds it: a slash in front may be missing."""
    return shortened(name.removeprefix("/"))
