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

What takes long to import is imported where Ctrl-C ends the command with one line.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
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
    wanted = possible_steps()
    for step in wanted:
        task_of(step)  # so that its kernels can be counted
    missing = len(_jit.unkept_kernels())
    with Progress() as shown:

        def look(progress: CompileProgress) -> None:
            running, done = ", ".join(progress.running), len(set(progress.kernels))
            if not options.quiet:
                shown.show(f"{running}: kernels compiled {done} / {missing}")

        progress = compile_steps(wanted, look=look)
    for note in dict.fromkeys(progress.notes):
        sys.stderr.write(f"{note}\n")
    for step, reason in progress.failed.items():
        sys.stderr.write(f"obb_collision warm-up: {step}: {reason}\n")
    if progress.failed:
        return 1
    size, files = cache_size(_kernel_cache.places[0])
    sys.stdout.write(
        f"{len(progress.kernels)} kernels compiled in {perf_counter() - start:.0f} s; "
        f"{_kernel_cache.places[0]}: {files} kernels, {size / 1e6:.0f} MB\n"
    )
    return 0


def cache_size(folder: Path) -> tuple[int, int]:
    """Return the bytes and the number of kernels in a folder, of all versions of the sources."""
    sizes = [file.stat().st_size for file in folder.rglob("*.kernel")]
    return sum(sizes), len(sizes)


if __name__ == "__main__":
    raise SystemExit(main())
