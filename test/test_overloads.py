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

"""Kernels for kernels: Python gets one of its own, and what it computes is the same."""

from __future__ import annotations

from pathlib import Path

import pytest
from numba.core import config, types

from obb_collision import _kernel_cache
from obb_collision._jit import njit
from obb_collision._overloads import Inner


@pytest.fixture(autouse=True)
def _empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have everything compiled: what is loaded needs no other kernel."""
    monkeypatch.setattr(_kernel_cache, "places", [tmp_path])


@njit
def inner(number: float) -> float:
    return number + 0.25


@njit
def outer(number: float) -> float:
    return 2.0 * inner(number)


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
def test_a_kernel_for_kernels_is_compiled_once_more_when_python_calls_it() -> None:
    assert outer(1.0) == 2.5
    args = (types.float64,)
    for_kernels = inner.overloads[args]  # type: ignore[attr-defined]
    assert inner(1.0) == 1.25
    for_python = inner.overloads[args]  # type: ignore[attr-defined]
    assert for_python is not for_kernels
    kinds = [isinstance(one._asdict()["library"], Inner) for one in (for_kernels, for_python)]
    assert kinds == [True, False]
    assert inner(2.0) == 2.25
    assert inner.overloads[args] is for_python  # type: ignore[attr-defined]
    assert outer(2.0) == 4.5


@njit
def known(number: float) -> float:
    return number - 0.25


@njit
def later(number: float) -> float:
    return 2.0 * known(number)


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
def test_a_kernel_that_python_has_called_does_for_kernels() -> None:
    assert known(1.0) == 0.75
    before = known.overloads[(types.float64,)]  # type: ignore[attr-defined]
    assert later(1.0) == 1.5
    assert known.overloads[(types.float64,)] is before  # type: ignore[attr-defined]
