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

"""Runs the comparisons within a time, beside what else the process does."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import islice

import numpy as np

from obb_collision._kernel_cache import KernelMissingError, only_loading
from obb_collision.node.self_test.comparisons import COMPARISONS, Comparison

TIME = 1.7
"""Seconds that all comparisons may take together, so that the answer is there within two."""
WORK, PAUSE = 5e-4, 1e-4
"""Seconds of work at a time, and of the pause after it, in which a cycle gets the interpreter."""
SEED = 2026
SHOWN = 3
"""Differences that are told; all are counted."""
STOPPED = "the node ends"
LATE = "no time was left"


@dataclass
class Result:
    """What one comparison came to: how many pieces were compared, and which of them differ."""

    comparison: Comparison
    compared: int = 0
    different: int = 0
    examples: list[str] = field(default_factory=list)
    seconds: float = 0.0
    reason: str = ""
    """Why it ended before it was complete, "" if it was."""

    @property
    def failed(self) -> bool:
        """Whether anything was wrong, or nothing was compared at all."""
        return self.different > 0 or (self.reason != "" and not self.compared)


def compare_all(
    stopped: Callable[[], bool] = lambda: False,
    clock: Callable[[], float] = time.perf_counter,
    seconds: float = TIME,
) -> Iterator[Result]:
    """Yield the result of each comparison; what one leaves of its time is the next one's."""
    start = clock()
    for number, comparison in enumerate(COMPARISONS, 1):
        yield compare(comparison, stopped, clock, start + seconds * number / len(COMPARISONS))


def compare(
    comparison: Comparison,
    stopped: Callable[[], bool],
    clock: Callable[[], float],
    end: float,
) -> Result:
    """Make one comparison until a time; kernels are not compiled, which would hold up cycles."""
    result = Result(comparison)
    start = paused = clock()
    pieces = comparison.run(np.random.default_rng(SEED))
    try:
        with only_loading():
            while not result.reason:
                differences = [*islice(pieces, 1)]
                if not differences:
                    break
                result.compared += 1
                if differences[0]:
                    result.different += 1
                    result.examples += differences[: SHOWN - len(result.examples)]
                now = clock()
                if now >= end:
                    result.reason = LATE
                elif stopped():
                    result.reason = STOPPED
                elif now - paused >= WORK:
                    time.sleep(PAUSE)
                    paused = clock()
    except KernelMissingError:
        result.reason = "its kernels are not compiled yet"
    except Exception as error:
        result.different += 1
        result.examples.append(f"{type(error).__name__}: {error}")
    result.seconds = clock() - start
    return result
