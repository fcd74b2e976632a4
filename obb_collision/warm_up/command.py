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

"""The console script ``obb_collision warm-up``: compiles all kernels beforehand.

Slow imports are in ``main``, where Ctrl-C ends the command with one line.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from time import perf_counter
from typing import TYPE_CHECKING

from obb_collision.cli import Parser, Progress, interruptible

if TYPE_CHECKING:
    from obb_collision.warm_up.processes import CompileProgress


@interruptible("obb_collision warm-up", "; kernels compiled so far are kept")
def main(args: Sequence[str] | None = None) -> int:
    """Compile all kernels that the cache lacks; returns the exit code."""
    parser = Parser(
        prog="obb_collision warm-up",
        description="Compiles all kernels of obb_collision into the cache. Later starts on this "
        "machine need not compile. This takes a minute on two cores; a second run takes "
        "seconds and compiles nothing.",
    )
    parser.add_argument("-q", "--quiet", action="store_true", help="do not print progress")
    options = parser.parse_args(args)
    from obb_collision import _jit, _kernel_cache
    from obb_collision.warm_up.processes import compile_steps
    from obb_collision.warm_up.steps import possible_steps, task_of

    reason = _kernel_cache.why_not_kept()
    if reason:
        sys.stderr.write(f"obb_collision warm-up: kernels cannot be stored: {reason}\n")
        return 1
    start = perf_counter()
    steps = possible_steps()
    for step in steps:
        task_of(step)  # defines its kernels, which are counted then
    missing = len(_jit.unkept_kernels())
    with Progress() as display:

        def look(progress: CompileProgress) -> None:
            running, done = ", ".join(progress.running), len(set(progress.kernels))
            if not options.quiet:
                display.show(f"{running}: kernels compiled {done} / {missing}")

        progress = compile_steps(steps, look=look)
    failures = [f"obb_collision warm-up: {step}: {why}" for step, why in progress.failed.items()]
    for line in (*dict.fromkeys(progress.notes), *failures):
        sys.stderr.write(f"{line}\n")
    if failures:
        return 1
    folder = _kernel_cache.places[0]
    sizes = [file.stat().st_size for file in folder.rglob("*.kernel")]
    sys.stdout.write(
        f"{len(progress.kernels)} kernels compiled in {perf_counter() - start:.0f} s; "
        f"{folder}: {len(sizes)} kernels, {sum(sizes) / 1e6:.0f} MB\n"
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
