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

"""The effect ``contacts``: the contact patch of each colliding pair."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np
from numpy.typing import NDArray

from obb_collision.geometry.boxes import Boxes
from obb_collision.queries.contacts.contacts import LIMITS, contacts
from obb_collision.scene.broad_phase.broad_phase import Pairs
from obb_collision.scene.effects.base import (
    Cycle,
    Option,
    Outcome,
    PairTable,
    Setting,
    Table,
    pair_rows,
)
from obb_collision.typing import Floats

FIELDS = ("normals", "depths", "counts", "points", "point_depths", "axes")


BLANKS: dict[int, Table] = {
    limit: (
        *(np.empty((0, 3)), np.empty(0), np.empty(0, np.int64)),
        *(np.empty((0, limit, 3)), np.empty((0, limit)), np.empty(0, np.int8)),
    )
    for limit in LIMITS
}


class PairContacts(PairTable):
    """The contact patches of k colliding pairs (k, 2) of object indices, ``pairs``."""

    def __len__(self) -> int:
        return len(self.pairs)

    @property
    def normals(self) -> Floats:
        """(k, 3) unit vectors from the first to the second, along which they overlap least."""
        return self.columns[0]

    @property
    def depths(self) -> Floats:
        """(k,) metres along the normals."""
        return self.columns[1]

    @property
    def counts(self) -> NDArray[np.int64]:
        """(k,) how many points each pair has, at least one."""
        return self.columns[2]

    @property
    def points(self) -> Floats:
        """(k, max_points, 3) metres, in both boxes, the deepest first; NaN past the count.

        Equally deep to 2^-24 of the pair's half extents, summed, counts as equally deep.
        """
        return self.columns[3]

    @property
    def point_depths(self) -> Floats:
        """(k, max_points) metres that the faces overlap at each point; NaN past the count."""
        return self.columns[4]

    @property
    def axes(self) -> NDArray[np.int8]:
        """(k,) the number of the axis of each normal, as in ``queries.contacts``."""
        return self.columns[5]


class ContactPatches:
    """Up to ``max_points`` contact points of each colliding pair, between their boxes."""

    name = "contacts"
    options: Mapping[str, Option] = {
        "max_points": Option(4, 4, 8, "Most contact points of a pair.", choices=(4, 8)),
    }
    lazy = True

    def run(self, cycle: Cycle, setting: Setting) -> Outcome:
        """Compute the patches."""
        limit = int(setting.values["max_points"])
        table, count, failures = pair_rows(
            *(self.name, cycle, setting),
            *(partial(_patches, limit=limit), BLANKS[limit]),
        )
        result = PairContacts(table.rows, table.pairs, table.columns, table.values)
        return Outcome(result, count, failures)


def _patches(boxes: Boxes, pairs: Pairs, limit: int) -> Table:
    found = contacts(boxes, pairs, limit)
    return tuple(getattr(found, field) for field in FIELDS)
