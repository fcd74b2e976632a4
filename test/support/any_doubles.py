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

"""Boxes of any doubles that are accepted, from subnormal to 1e300, for hypothesis."""

from __future__ import annotations

from hypothesis import strategies as st

numbers = st.floats(-1e300, 1e300)
vectors = st.tuples(numbers, numbers, numbers)
extents = st.tuples(*3 * [st.floats(0.0, 1e300)])
quaternions = st.tuples(*4 * [st.floats(-1.0, 1.0)]).filter(any)
