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

"""A process of a fault: started in an environment, limited, stopped, killed."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

ENDING = 30.0
"""Seconds that a process has to end after SIGINT."""
NODE = "obb_collision.node.node"
PEERS = "tools.faults.peers"


class Process:
    """A Python module in a process of its own; its output goes to ``log``."""

    def __init__(
        self, module: str, arguments: Sequence[str], log: Path, environment: Mapping[str, str]
    ) -> None:
        self.log = log
        with log.open("ab") as output:
            self._process = subprocess.Popen(
                [sys.executable, "-m", module, *arguments],
                env={**os.environ, **environment},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
            )

    @property
    def exit_code(self) -> int | None:
        """Exit code, None while it runs; below zero: the signal that ended it."""
        return self._process.poll()

    def send(self, number: signal.Signals) -> None:
        """Send a signal."""
        self._process.send_signal(number)

    def end(self) -> int:
        """End it as Ctrl-C would, else by force; returns its exit code."""
        if self.exit_code is None:
            self.send(signal.SIGCONT)
            self.send(signal.SIGINT)
        with suppress(subprocess.TimeoutExpired):
            return self._process.wait(timeout=ENDING)
        return self.kill()

    def kill(self) -> int:
        """End it by force, at once; returns its exit code."""
        if self.exit_code is None:
            self._process.kill()
        return self._process.wait()

    def limit(self, what: int, most: int) -> None:
        """Limit a resource of the running process (RLIMIT_*); its parent's stays."""
        _, hard = resource.prlimit(self._process.pid, what)
        resource.prlimit(self._process.pid, what, (most if most >= 0 else hard, hard))

    def status(self, field: str) -> int:
        """Return a size from /proc (bytes), such as VmRSS."""
        lines = Path(f"/proc/{self._process.pid}/status").read_text().splitlines()
        (found,) = (line.split()[1] for line in lines if line.startswith(f"{field}:"))
        return 1024 * int(found)

    def scheduled(self) -> tuple[int, int]:
        """Return for how long the main thread has run, and has waited for a processor (ns)."""
        running, waiting, _ = Path(f"/proc/{self._process.pid}/schedstat").read_text().split()
        return int(running), int(waiting)

    def crowding(self, before: tuple[int, int]) -> float:
        """Return how many times longer than alone all took since ``scheduled`` was as given."""
        pairs = zip(self.scheduled(), before, strict=True)
        running, waiting = (now - then for now, then in pairs)
        return 1.0 + waiting / max(running, 1)

    def descriptors(self) -> int:
        """Return how many files it has open."""
        return len(os.listdir(f"/proc/{self._process.pid}/fd"))

    def said(self, text: str) -> bool:
        """Return whether its output has a text."""
        return text in self.log.read_text(errors="replace")
