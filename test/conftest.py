"""Settings of the whole test suite: ``--pairs`` and a hypothesis profile without chance."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

# The same examples on every machine and every run; no deadline, since the first call compiles.
settings.register_profile(
    "repeatable",
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("repeatable")

#: Pairs of each family that fit a test run of minutes on two cores.
DEFAULT_PAIRS = 1500


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--pairs",
        type=int,
        default=DEFAULT_PAIRS,
        help="box pairs of each family to check against exact arithmetic (a million: an hour)",
    )


@pytest.fixture(scope="session")
def pairs(request: pytest.FixtureRequest) -> int:
    """How many pairs of each family to check."""
    return int(request.config.getoption("--pairs"))


@pytest.fixture
def rig() -> Iterator[Any]:
    """Yield a collision node with its outside world: ``rig.Rig`` of test/node."""
    from rig import Rig

    with Rig() as made:
        yield made
