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

"""``NUMBA_BOUNDSCHECK=1``: an access out of bounds raises, whatever the cache has without it.

``.ci/full`` runs all tests with that setting. The arrays here are parts of larger ones, so that an
access out of their bounds does no harm where it is not checked.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import bounds_checks
import pytest
from processes import PATIENCE

OWN = """
import numpy as np
from obb_collision._jit import njit

@njit
def item(values, row):
    return values[row]

print(item(np.arange(4.0)[:3], 3))
"""
KERNEL = """
import numpy as np
from obb_collision.queries.points.points import lengths_kernel

lengths = np.zeros(3)
lengths_kernel(np.ones((1, 3)), np.array([2]), lengths[:2])
print(round(lengths[2] ** 2, 9))
"""
BOTH = f"""
for code in {(OWN, KERNEL)!r}:
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
    for _ in range(2):  # compiled, and from the cache
        assert run(BOTH, tmp_path, "0").stdout.split() == ["3.0", "3.0"]
        checked = run(BOTH, tmp_path, "1")
        assert checked.stdout.splitlines() == ["IndexError: index is out of bounds"] * 2


CAUGHT = """
import numpy as np
import pytest
from bounds_checks import none_out_of_bounds
from obb_collision.queries.points.points import lengths_kernel

with pytest.raises(AssertionError, match="accesses out of bounds, called from"):
    with none_out_of_bounds():
        try:
            lengths_kernel(np.ones((1, 3)), np.array([2]), np.zeros(3)[:2])
        except IndexError:
            pass
"""


@pytest.mark.skipif(sys.version_info < (3, 12), reason="sys.monitoring is of Python 3.12")
def test_one_that_is_caught_is_found_all_the_same(tmp_path: Path) -> None:
    support = str(Path(bounds_checks.__file__).parent)
    done = run(f"import sys; sys.path.append({support!r})" + CAUGHT, tmp_path, "1")
    assert done.returncode == 0, done.stderr
