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

"""The process that builds: it takes jobs from its standard input until that ends."""

from __future__ import annotations

import os
import signal
from contextlib import suppress
from pathlib import Path

import numpy as np

from obb_collision import _kernel_cache
from obb_collision.scene.building.jobs import perform
from obb_collision.scene.building.wire import NO_BUILDER, NO_MEMORY, BuildError, Message, Pipe
from obb_collision.shapes import Hull

#: Seconds beyond the time of a job after which the process ends itself.
GRACE = 5.0
#: Niceness of the process: the one it builds for comes first.
NICENESS = 5
#: Rows and columns of a matrix that OpenBLAS takes its buffer for.
SOME = 128


def main(memory: int, kernels: list[str]) -> None:
    """Work. memory: bytes that jobs may take beyond what the process has when it begins.

    kernels: folders of kernels besides the cache.
    """
    pipe = Pipe(os.dup(0), os.dup(1))
    # what libraries print must not get among the replies
    for descriptor in (0, 1):
        os.dup2(os.open(os.devnull, os.O_RDWR), descriptor)
    with suppress(OSError):
        os.nice(NICENESS)
    _look_for_kernels_in(kernels)
    _take_what_all_jobs_need()
    _limit_memory(memory)
    pipe.send({"ready": True})
    while (message := pipe.receive()) is not None:
        # Ends the process, even if it is blocked and its parent has ended.
        signal.setitimer(signal.ITIMER_REAL, message["seconds"] + GRACE)
        _look_for_kernels_in(message.pop("kernels"))
        pipe.send(_reply(message))
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        del message


def _look_for_kernels_in(folders: list[str]) -> None:
    """Use the folders that the process has, to which these kernels are sent, besides the cache."""
    known = set(map(str, _kernel_cache.places))
    _kernel_cache.places.extend(Path(folder) for folder in folders if folder not in known)


def _take_what_all_jobs_need() -> None:
    """Load what would else be part of the memory of the first job, or of its time."""
    import trimesh  # noqa: F401

    corners = np.vstack([np.zeros(3), np.eye(3)])
    _ = Hull(corners).local_box  # compiles what fits boxes, where the cache lacks it
    # OpenBLAS ends the process where it can't have its buffer
    np.linalg.svd(np.ones((SOME, SOME)) @ np.ones((SOME, SOME)))


def _reply(message: Message) -> Message:
    try:
        return perform(message)
    except MemoryError:
        return _refusal(NO_MEMORY, "")
    except BuildError as error:
        return _refusal(error.reason, error.detail)
    except Exception as error:
        return _refusal(NO_BUILDER, f"{type(error).__name__}: {error}"[:1000])


def _refusal(reason: str, detail: str) -> Message:
    return {"refused": reason, "detail": detail}


def _limit_memory(memory: int) -> None:
    """Let the process have so many bytes more, where the system can limit it."""
    try:
        import resource

        now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        limit = now + memory
        if hard != resource.RLIM_INFINITY:
            limit = min(limit, hard)
        resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    except (ImportError, OSError, ValueError):
        return
