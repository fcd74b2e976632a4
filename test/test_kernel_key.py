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

"""The key of a kernel: what it depends on, and nothing else; with bounds checks it is another.

With ``NUMBA_BOUNDSCHECK=1`` an access out of bounds raises, whatever the cache has without it:
``.ci/full`` runs all tests so. The arrays here are parts of larger ones, so that an access out of
their bounds does no harm where it is not checked.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import bounds_checks
import numba
import pytest
from each import each
from processes import PATIENCE

import obb_collision._jit as jit
from obb_collision._kernel_cache import FLAGS, config, fields_of, kernel_key
from obb_collision.warm_up.steps import possible_steps, task_of

KERNEL = """
from typing import NamedTuple
import numpy as np
from obb_collision._jit import njit

class Point(NamedTuple):
    x: float
    y: float

FACTOR = 2.0
STEPS = (1, 2)
ARRAY = np.array([1.0, 2.0])

@njit
def helper(x):
    return x + 1.0

@njit
def kernel(x):
    'Return something.'
    return Point(helper(x) * FACTOR + 0.25, ARRAY[STEPS[0]])
"""


@pytest.fixture(autouse=True)
def _own_kernels() -> Iterator[None]:
    """Leave those of a test out of those of the package."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jit, "kernels", [*jit.kernels])
        patch.setattr(jit, "caches", [*jit.caches])
        yield


def key_of(source: str) -> str:
    names: dict[str, Any] = {"__name__": "obb_collision.example"}
    exec(source, names)
    return kernel_key(names["kernel"])


@each(
    "before, after, same",
    [
        ("Return something.", "Return something else.", True),
        ("import numpy", "# a comment\nimport numpy", True),
        ("FACTOR = 2.0", "OTHER = 1\nFACTOR = 2.0", True),
        ("FACTOR = 2.0", "FACTOR = 2.0000000000000004", False),
        ("STEPS = (1, 2)", "STEPS = (1, 3)", False),
        ("1.0, 2.0]", "1.0, 3.0]", False),
        ("x + 1.0", "x + 2.0", False),
        ("x + 1.0", "x - 1.0", False),
        ("0.25", "0.5", False),
        ("    x: float\n    y: float", "    y: float\n    x: float", False),
    ],
)
def test_the_key_has_what_a_kernel_depends_on(before: str, after: str, same: bool) -> None:
    assert before in KERNEL
    assert (key_of(KERNEL) == key_of(KERNEL.replace(before, after, 1))) == same


@each("flag", FLAGS)
def test_the_key_has_the_settings_of_numba(flag: str, monkeypatch: pytest.MonkeyPatch) -> None:
    before = key_of(KERNEL)
    monkeypatch.setattr(config, flag, "another", raising=False)
    assert key_of(KERNEL) != before


def test_what_a_key_cannot_be_made_of_is_refused() -> None:
    with pytest.raises(TypeError, match="depends on a dict"):
        key_of(KERNEL.replace("STEPS = (1, 2)", "STEPS = {0: 1}"))


def test_every_kernel_has_a_key_of_its_own() -> None:
    for step in possible_steps():
        task_of(step)  # imports its kernels
    keys = {kernel_key(kernel) for kernel in jit.kernels}
    assert len(keys) == len(jit.kernels) > 250


def test_fields_in_another_order_are_another_signature() -> None:
    def signature(*fields: str) -> Any:
        make: Any = NamedTuple
        point = make("Point", [(field, float) for field in fields])
        return numba.typeof((point(1.0, 2.0), 1))

    first, second = signature("x", "y"), signature("y", "x")
    assert str(first) == str(second)
    assert fields_of(first) != fields_of(second)
    assert fields_of(first) == fields_of(signature("x", "y"))
    assert fields_of(jit.HeldType([("value", first)])) == (fields_of(first),)


OWN = """
import numpy as np
from obb_collision._jit import njit

@njit
def item(values, row):
    return values[row]

print(item(np.arange(4.0)[:3], 3))
"""
LENGTHS = """
import numpy as np
from obb_collision.numerics.vec3 import fill_lengths

lengths = np.zeros(3)
fill_lengths(np.ones((3, 3)), lengths[:2])
print(round(lengths[2] ** 2, 9))
"""
BOTH = f"""
for code in {(OWN, LENGTHS)!r}:
    try:
        exec(code, {{"__name__": "obb_collision.example"}})
    except Exception as error:
        print(f"{{type(error).__name__}}: {{error}}")
"""


def run(code: str, cache: Path, checked: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache), "NUMBA_BOUNDSCHECK": checked}
    return subprocess.run(
        [sys.executable, "-c", code], env=environment, timeout=PATIENCE, capture_output=True,
        text=True,
    )  # fmt: skip


def test_an_access_out_of_bounds_raises_with_the_flag(tmp_path: Path) -> None:
    assert run(BOTH, tmp_path, "0").stdout.split() == ["3.0", "3.0"]
    for _ in range(2):  # compiled, whatever the cache has without the flag, and from the cache
        checked = run(BOTH, tmp_path, "1")
        assert checked.stdout.splitlines() == ["IndexError: index is out of bounds"] * 2


CAUGHT = """
import numpy as np
import pytest
from bounds_checks import none_out_of_bounds
from obb_collision.numerics.vec3 import fill_lengths

with pytest.raises(AssertionError, match="accesses out of bounds, called from"):
    with none_out_of_bounds():
        try:
            fill_lengths(np.ones((3, 3)), np.zeros(3)[:2])
        except IndexError:
            pass
"""


@pytest.mark.skipif(sys.version_info < (3, 12), reason="sys.monitoring is of Python 3.12")
def test_one_that_is_caught_is_found_all_the_same(tmp_path: Path) -> None:
    support = str(Path(bounds_checks.__file__).parent)
    done = run(f"import sys; sys.path.append({support!r})" + CAUGHT, tmp_path, "1")
    assert done.returncode == 0, done.stderr
