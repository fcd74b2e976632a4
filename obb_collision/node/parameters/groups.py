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

"""Groups: names for sets of objects, which other parameters use like names and patterns."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from typing import Any, TypeVar

from obb_collision.node.parameters.specs import MAX_PATTERNS
from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.store.overrides import MAX_OVERRIDES
from obb_collision.scene.store.patterns import as_patterns

Value = TypeVar("Value")
Pair = tuple[str, str]
"""Two words: groups, names or patterns."""
GroupEntry = tuple[str, tuple[str, ...]]
"""The name of a group and words in it."""
WITH_WORDS = (
    *("allowed_pairs", "check_only_pairs", "padding_overrides", "accuracy_overrides"),
    *("object_timeout_overrides", "stale_policy_overrides", "required_objects", "ignored_objects"),
    *(f"effects.{effect}_objects" for effect in EFFECTS),
)
"""Parameters whose entries hold words."""
PAIRS = ("allowed_pairs", "check_only_pairs")
"""Those of two words each; of others with several parts the first one is a word."""
OF_ROBOTS = ("object_timeout_overrides", "stale_policy_overrides")
"""Those that may name robots."""
MAX_MEMBERS = MAX_OVERRIDES
"""Maximum names and patterns in a group, and in a list with all of its groups."""


def group_from_text(text: str) -> GroupEntry:
    """Read ``NAME: WORD WORD``; ValueError for anything else."""
    name, colon, words = text.partition(":")
    if not (colon and name.strip() and words.strip()):
        raise ValueError(f"{text!r} is not like 'gripper: hand/* finger/1'")
    name = name.strip()
    if not is_plain(name):
        raise ValueError(f"a group cannot be called {name!r}")
    return name, split_words(words)


def pair_from_text(text: str) -> Pair:
    """Read ``WORD WORD``; ValueError for anything else."""
    words = split_words(text)
    if len(words) != 2:
        raise ValueError(f"{text!r} is not two names or patterns like 'robot/* table/1'")
    return words[0], words[1]


def split_words(text: str) -> tuple[str, ...]:
    """Return the words of a text; those with spaces are in quotes. ValueError with the reason."""
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise ValueError(f"{text!r}: {str(error).lower()}") from None
    return as_patterns(words, "words")


def is_plain(word: str) -> bool:
    """Return whether a word can only be a group: names of objects have a slash."""
    return not set(word) & set("/*?[")


class Groups:
    """What a word stands for: the members of a group, or the name or pattern itself.

    robots: names that are no groups either. Raises ValueError for a group with a word that is none
    of these, or with too many members.
    """

    def __init__(self, entries: Iterable[GroupEntry], robots: Iterable[str] = ()) -> None:
        self._groups: dict[str, tuple[str, ...]] = {name: (name,) for name in robots}
        for name, words in entries:
            members = (*self._groups.get(name, ()), *self.all_meant(words))
            self._groups[name] = tuple(dict.fromkeys(members))
            if len(self._groups[name]) > MAX_MEMBERS:
                raise ValueError(f"the group {name!r} has more than {MAX_MEMBERS} members")

    def meant(self, word: str) -> tuple[str, ...]:
        """Return the names and patterns that a word stands for. ValueError for an unknown group.

        A misspelt group would silently make a rule about nothing.
        """
        if word in self._groups:
            return self._groups[word]
        if is_plain(word):
            close = get_close_matches(word, self._groups, 1)
            hint = f"; did you mean {close[0]}?" if close else ""
            if word and not close:
                hint = f"; all of a namespace are '{word}/*'"
            raise ValueError(f"{word!r} is no group, name like 'gripper/1' or pattern{hint}")
        return (word,)

    def all_meant(self, words: Iterable[str]) -> list[str]:
        """Return the names and patterns that words stand for, each once."""
        return list(dict.fromkeys(one for word in words for one in self.meant(word)))

    def sides(self, pair: Pair) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return both sides of a pair."""
        return self.meant(pair[0]), self.meant(pair[1])

    def overrides(self, overrides: Iterable[tuple[str, Value]]) -> list[tuple[str, Value]]:
        """Return overrides of names and patterns for those of words."""
        return [(one, value) for word, value in overrides for one in self.meant(word)]


def check_words(values: Mapping[str, Any]) -> None:
    """Raise ValueError, beginning with the parameter, for a list with a word that is none.

    values: of all parameters, as ``Spec.read`` returns them.
    """
    for name in ("groups", *WITH_WORDS):
        try:
            if name == "groups":
                groups = Groups(values[name])
                groups_and_robots = Groups(values[name], values["robots"])
                continue
            words = [e if isinstance(e, str) else e[: 1 + (name in PAIRS)] for e in values[name]]
            _check(groups_and_robots if name in OF_ROBOTS else groups, words)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from error


def _check(groups: Groups, entries: Sequence[Any]) -> None:
    total = patterns = 0
    for entry in entries:
        words = (entry,) if isinstance(entry, str) else entry
        members = groups.all_meant(words)
        total += len(members)
        patterns += sum(not set("*?[").isdisjoint(one) for one in members)
    if total > MAX_MEMBERS or patterns > MAX_PATTERNS:
        raise ValueError(
            f"with their groups these are more than {MAX_MEMBERS} names or {MAX_PATTERNS} patterns"
        )
