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

"""Changes that happen whole or not at all: first what can fail, then writes that are completed."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


def completed(change: Callable[P, R]) -> Callable[P, R]:
    """Make a change again, from its start, if it breaks off; then what broke it off is raised.

    The change may be made any number of times in a row. Whatever needs memory in proportion to the
    objects comes before its first write, so that it can end only there.
    """

    @wraps(change)
    def whole(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return change(*args, **kwargs)
        except BaseException:
            change(*args, **kwargs)
            raise

    return whole
