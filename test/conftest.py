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

"""Settings of the whole test suite: how much is tried, and a hypothesis profile without chance."""

from __future__ import annotations

import gc
import signal
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from typing import Any

import pytest
from bounds_checks import none_out_of_bounds
from hypothesis import HealthCheck, settings
from hypothesis import __version_info__ as hypothesis_version
from numba.core import config

# The same examples on every machine and every run; no deadline, since the first call compiles.
settings.register_profile(
    "repeatable",
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("repeatable")

# A shell without job control starts what is in the background with SIGINT ignored, and all that the
# tests start would inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

#: Folders that need ROS, or the parser of robots besides, are left out where there is none.
NEEDS = {"rclpy": ["node/*", "demo/*"], "lxml": ["node/robots/*"]}
collect_ignore_glob = [
    glob for name, globs in NEEDS.items() if not find_spec(name) for glob in globs
]

#: Pairs of each family that fit a test run of minutes on two cores.
DEFAULT_PAIRS = 300

#: Characters of an id of a test's parameter.
ID_LENGTH = 150


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--pairs",
        type=int,
        default=DEFAULT_PAIRS,
        help="box pairs of each family to check against exact arithmetic (a million: an hour)",
    )
    parser.addoption(
        "--hours",
        type=float,
        default=1.0,
        help="hours of its clock that the node lives through random walks (12: twenty minutes)",
    )
    parser.addoption("--walk", type=int, default=0, help="number of the first of these walks")


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile all kernels before all tests are run: both workers would compile the same ones."""
    options = session.config
    everything = options.args_source is pytest.Config.ArgsSource.TESTPATHS
    if everything and not (hasattr(options, "workerinput") or options.option.collectonly):
        subprocess.run([sys.executable, "-m", "obb_collision.warm_up.command"], check=False)


def pytest_collection_finish() -> None:
    """Leave thousands of collected tests out of what the garbage collector goes through in each."""
    if hypothesis_version >= (6, 99):  # older ones lose examples then, and call the test flaky
        gc.collect()
        gc.freeze()


def pytest_make_parametrize_id(val: object) -> str | None:
    """Shorten the ids of long values: a name of a million characters blocks colcon's terminal."""
    text = repr(val) if isinstance(val, (str, bytes, int)) else ""
    return f"{text[:ID_LENGTH]}..." if len(text) > ID_LENGTH else None


@pytest.fixture(scope="session")
def pairs(request: pytest.FixtureRequest) -> int:
    """How many pairs of each family to check."""
    return int(request.config.getoption("--pairs"))


@pytest.fixture
def write(tmp_path: Path) -> Any:
    """Return a function that writes a scene file and returns its path."""
    numbers = count()

    def write(text: str) -> Path:
        path = tmp_path / f"{next(numbers)}scene.yaml"
        path.write_text(text)
        return path

    return write


@pytest.fixture
def rig() -> Iterator[Any]:
    """Yield a collision node with its outside world: ``rig.Rig`` of test/node."""
    from rig import Rig

    with Rig() as made:
        yield made


@pytest.fixture(scope="module")
def one_robot() -> Iterator[None]:
    """End the rig that the tests of a file share with the file."""
    yield
    from rig import end_shared

    end_shared()


@pytest.fixture
def arm(one_robot: None) -> Any:
    """Return the ``robot_rig.AskingRig`` that the tests of a file share, as good as new."""
    from rig import SHARED
    from robot_rig import AskingRig

    if not SHARED:
        rig = AskingRig()
        rig.start_robot()
        SHARED.append(rig)
    SHARED[0].renew()
    return SHARED[0]


@pytest.fixture(autouse=bool(config.BOUNDSCHECK))
def within_bounds() -> Iterator[None]:
    """Let a test fail in which a kernel was out of bounds, whoever caught it."""
    with none_out_of_bounds():
        yield
