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

"""Oriented bounding box collision checking.

The conventions hold everywhere in this package:

* Numbers are float64, lengths are metres, angles radians, times seconds.
* Frames: all boxes of a call or scene are in one common frame.
* Quaternions are ordered x y z w; poses are x y z qx qy qz qw.
* Rotations are (3, 3) matrices whose columns are the box axes.
* Boxes have half extents, never negative; zero makes a flat box, which is legal. The shapes of
  objects have full sizes.
* A box is the set {centre + sum_i t_i h_i a_i, abs(t_i) <= 1}, for the doubles as stored.
* Boxes are closed: touching is a collision. What doubles cannot distinguish from touching counts
  as touching.
* Separations are signed: positive apart, negative overlapping; the depth is its negative.
* Normals have unit length and point from the first box, a, to the second, b.
* Batches are asked alike, f(a, b, pairs=None): each row of a against the same row of b, or, with
  pairs (m, 2), rows of a against rows of b. Options go by their names.
* Invalid input raises ValueError, or TypeError for another type. The message names the argument,
  and the row in a batch; nothing has changed then. Docstrings say only what is not that.
* Points are what is handed in; positions are where a result is.
* Pairs are sorted: i < j in a pair, and the pairs in lexicographic order.
* Corners have one order: on the +z face left-top, left-bottom, right-bottom, right-top, then on
  the -z face right-top, right-bottom, left-bottom, left-top (right is +x, top is +y).

The public names, all in ``api``, load when first used: a console script must be able to say what is
missing, or to end, before seconds of imports. Examples take
``import numpy as np`` and ``import obb_collision as oc`` for granted.

Layers, each importing only those before it: ``numerics`` (arithmetic), ``geometry`` (what things
are), ``queries`` (a folder per question), ``obb``, ``boxes`` and ``shapes`` (one box, many, what an
object can be), ``scene`` (the store, the broad phase, the check, effects), ``regions``, ``robots``
(URDF, kinematics), ``scene_files`` (YAML and MoveIt), ``node`` (ROS), and above it ``demo`` and
``benchmarks``; more in CONTRIBUTING.md.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from obb_collision.api import *  # noqa: F403

__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    if name == "__all__" or not name.startswith("_"):
        api = import_module("obb_collision.api")
        if name == "__all__" or name in api.__all__:
            value = globals()[name] = getattr(api, name)
            return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*globals(), *__getattr__("__all__")]
