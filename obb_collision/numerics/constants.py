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

"""Constants that several modules share: the rounding unit, error bounds, limits.

Error bounds are multiples of ROUNDOFF. Their derivations, and the tests that measure the errors,
are listed in ``test/numerics/bounds.md``. A bound of a single module is a constant of that module.
"""

from __future__ import annotations

#: Unit roundoff u of float64: one operation is off by at most this, relative to its result.
ROUNDOFF = 2.0**-53

#: Largest magnitude accepted (metres). Sums of a few such numbers still can't overflow.
MAX_MAGNITUDE = 1e300

#: Rotations with entries of R^T R - I up to this are kept bit for bit: products of a few rotations
#: and conversions of quaternions are that accurate. The certified test allows for four times that.
ORTHONORMAL_ROUNDING = 16 * ROUNDOFF

#: Bound of a gap from the matrix of dot products, relative to T (``queries.verdict.verdict``).
FAST_BOUND = 1024 * ROUNDOFF
#: Bound of a gap along an axis computed carefully, relative to T (``queries.verdict.verdict``).
CAREFUL_BOUND = 16 * ROUNDOFF
#: Relative slack of a world bound: its sums and products are off by less than 6 roundoffs.
BOUND_SLACK = 8 * ROUNDOFF
#: A time is a quotient of two differences, by way of a reciprocal: off by 4 roundoffs.
TIME_ROUNDING = 8 * ROUNDOFF

#: Added to the bound of a gap or a half extent (metres): more than what gradual underflow can take
#: from their few products, 2^-1075 each time.
UNDERFLOW = 2.0**-1060
#: Added to a world bound (metres) for the same reason.
BOUND_UNDERFLOW = 2.0**-1065
#: Added to bounds of points moved by the relative pose of two meshes, which takes more products.
MESH_UNDERFLOW = 2.0**-1050
#: Added to bounds of products of coordinates, whose factors may have lost as much.
PRODUCT_UNDERFLOW = 2.0**-1000

#: Squared lengths below this may have lost digits to underflow.
SMALL_SQUARE = 2.0**-900
#: Cross products of two edges shorter than this, and components of a unit direction below it,
#: count as zero: doubles can't tell them from it.
PARALLEL = 2.0**-900
#: Squared length below which the cross product of two edges, by plain arithmetic, is too
#: uncertain for a rough gap along it.
SHORT_SQUARE = 2.0**-40

#: A vector made orthogonal to another was parallel to it if its length fell below this fraction:
#: the rest is mostly rounding.
DEPENDENT = 1e-8
#: Extents below this fraction of the largest count as zero: rounding leaves less than 1e-15 of a
#: plane, real thin things are above 1e-9.
FLAT = 1e-12
#: An earlier candidate for a box wins unless a later one is smaller by more than this fraction of
#: the volume, so that ties don't depend on rounding.
VOLUME_TIE = 1e-9

#: 2^27 + 1 splits a double into two halves of 26 bits whose products are exact (Dekker 1971).
SPLITTER = 134217729.0
