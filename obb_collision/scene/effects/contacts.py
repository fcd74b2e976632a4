"""The effect ``contacts``: the contact patch of each colliding pair."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from obb_collision.geometry.boxes import Boxes
from obb_collision.queries.contacts import Contacts, contacts
from obb_collision.scene.broad_phase import Pairs
from obb_collision.scene.effects.base import (
    Cycle,
    Option,
    Outcome,
    PairTable,
    Setting,
    Table,
    pair_rows,
)

FIELDS = ("normals", "depths", "counts", "points", "point_depths", "axes")


class PairContacts(PairTable):
    """The contact patches of k colliding pairs: ``pairs`` (k, 2) and what ``Contacts`` has."""

    @property
    def patches(self) -> Contacts:
        """The patches, one row a pair."""
        return Contacts(**dict(zip(FIELDS, self.columns, strict=True)))


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
            self.name, cycle, setting, partial(_patches, limit=limit)
        )
        result = PairContacts(table.rows, table.pairs, table.columns, table.values)
        return Outcome(result, count, failures)


def _patches(boxes: Boxes, pairs: Pairs, limit: int) -> Table:
    found = contacts(boxes, pairs, limit)
    return tuple(getattr(found, field) for field in FIELDS)
