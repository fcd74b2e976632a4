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

"""Which rung of ``Accuracy`` each object gets: the node's, or that of the last override it fits."""

from __future__ import annotations

import re
from collections.abc import Sequence
from fnmatch import translate

from obb_collision.queries.accuracy import Accuracy, as_accuracy

Override = tuple[str, Accuracy]
"""A pattern of names ``ns/id``, and the rung of the objects that match it."""


def override_from_text(text: str) -> Override:
    """Read ``PATTERN: RUNG``, or ``NAMESPACE=RUNG`` for all of a namespace.

    ValueError with the reason.
    """
    found = re.fullmatch(r"(.*?)\s*([:=])\s*(\w*)", text)
    if found is None:
        raise ValueError(f"{text!r} is not like 'gripper/*: mesh' or 'gripper=mesh'")
    where, sign, rung = found.groups()
    if sign == "=":
        where += "/*"
    elif "/" not in where and "*" not in where:
        hint = f"; all of a namespace are '{where}/*' or '{where}='" if where else ""
        raise ValueError(f"{where!r} in {text!r} is no name like 'gripper/1' or pattern{hint}")
    return where, as_accuracy(rung)


class Overrides:
    """Overrides, of which the last one that fits a name counts."""

    def __init__(self, overrides: Sequence[Override] = ()) -> None:
        self.overrides = tuple(overrides)
        self._tests = [(re.compile(translate(p)).match, rung) for p, rung in reversed(overrides)]

    def rung(self, name: str) -> Accuracy | None:
        """Return the rung of an object by its name, None for the node's own."""
        return next((rung for match, rung in self._tests if match(name)), None)

    def capped(self, highest: Accuracy) -> Overrides:
        """Return the same with no rung above ``highest``."""
        return Overrides([(pattern, min(rung, highest)) for pattern, rung in self.overrides])
