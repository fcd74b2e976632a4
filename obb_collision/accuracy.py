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

"""Levels of accuracy, a ladder from coarse to exact: how closely to look at a pair."""

from __future__ import annotations

from enum import IntEnum

from obb_collision.words import shown


class Accuracy(IntEnum):
    """What stands for an object when a pair is decided, coarse to exact.

    SPHERE and AABB never miss what OBB reports, OBB never what HULL reports, and HULL never what
    MESH reports. Neither of the first two is the stricter one: spheres suit cubes, AABBs suit what
    stands upright.

    A coarser level is not always the cheaper one: it reports more pairs, so that whole checks on
    the first two take longer than on OBB. The page on accuracy has both times, measured.

    Examples
    --------
    >>> oc.Scene(accuracy="mesh").accuracy == oc.Accuracy.MESH > oc.Accuracy.OBB
    True
    """

    SPHERE = 0  #: the sphere around the box
    AABB = 1  #: the world-axis-aligned box around the box
    OBB = 3  #: the box, all 15 axes, certified; the default
    HULL = 5  #: the convex hull of a mesh
    MESH = 6  #: the triangles; watertight meshes are solids, open ones surfaces

    @property
    def label(self) -> str:
        """Its name as users write it: in lower case."""
        return self.name.lower()


#: Names of the levels that need nothing but boxes, and of all.
BOX_LEVELS = tuple(level.label for level in Accuracy if level <= Accuracy.OBB)
ALL_LEVELS = tuple(level.label for level in Accuracy)


def as_accuracy(value: Accuracy | str | int) -> Accuracy:
    """Return a level from itself, its name in lower case or its number; ValueError otherwise."""
    if isinstance(value, str) and value in ALL_LEVELS:
        return Accuracy[value.upper()]
    if not isinstance(value, (str, bool)):
        try:
            return Accuracy(value)
        except (ValueError, TypeError):
            pass
    words = ", ".join(ALL_LEVELS)
    raise ValueError(f"accuracy must be one of {words}, got {shown(value)}{instead_of(value)}")


def instead_of(value: object) -> str:
    """Return the end of a sentence about a level of former times; others were better in all."""
    former = isinstance(value, str) and value in ("obb_faces", "obb_tree")
    return ": use obb or hull instead" if former else ""


def as_box_accuracy(value: Accuracy | str | int) -> Accuracy:
    """Return a level that needs nothing but boxes; ValueError naming the choices otherwise."""
    level = as_accuracy(value)
    if level > Accuracy.OBB:
        raise ValueError(
            f"accuracy must be one of {', '.join(BOX_LEVELS)}, got {level.label}: "
            "the mesh levels need a Scene with mesh objects"
        )
    return level
