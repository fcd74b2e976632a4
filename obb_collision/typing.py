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

"""Types of the whole package, each named once. Arrays that kernels take are C-contiguous."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
"""Numbers: lengths in metres, angles in radians, times in seconds."""
Integers = NDArray[np.int64]
"""Whole numbers."""
Rows = NDArray[np.int64]
"""Indices into the rows of other arrays."""
Mask = NDArray[np.bool_]
"""True where something holds."""
Vector = tuple[float, float, float]
"""A point or a vector in space; compiled, its numbers live in registers."""
Axes = tuple[Vector, Vector, Vector]
"""The three axes of a box, as a rule the columns of its rotation."""
Columns = tuple[NDArray[Any], ...]
"""A NamedTuple of arrays as a plain tuple: numba takes it from Python a microsecond faster."""
