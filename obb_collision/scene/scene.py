"""Scene: objects that come, move and go, and the check for collisions between them."""

from __future__ import annotations

from collections.abc import Iterable
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.poses import IDENTITY_POSE
from obb_collision.geometry.shapes import Shape
from obb_collision.geometry.validation import Floats, as_array
from obb_collision.obb import OBB
from obb_collision.queries.witness import witness_kernel
from obb_collision.scene.broad_phase import Pairs, find_candidates, find_candidates_of
from obb_collision.scene.pairs import colliding_pairs
from obb_collision.scene.report import Report
from obb_collision.scene.store import LocalBox, ObjectStore, Rows

#: With fewer than one object in this many changed, only pairs of the changed ones are looked at.
INCREMENTAL_SHARE = 32


class Scene:
    """A store of named objects that knows which of them collide.

    padding: metres by which every box is grown on each side.
    exact: decide by integer arithmetic what doubles can't tell from touching.
    """

    def __init__(self, *, padding: float = 0.0, exact: bool = False) -> None:
        self._store = ObjectStore()
        self._own_padding: set[int] = set()
        self._padding = 0.0
        self.padding = padding
        self._exact = exact
        self._bounds: tuple[Floats, Floats] | None = None
        self._report: Report | None = None

    def add(
        self,
        name: str,
        shape: Shape | OBB,
        pose: ArrayLike | None = None,
        *,
        padding: float | None = None,
    ) -> int:
        """Add an object, or replace the one of that name, and return its index.

        shape: a value of ``geometry.shapes`` or an OBB, in the object's own frame; its local box
        is fitted once. pose (7,): x y z qx qy qz qw, identity if not given. padding: metres, in
        place of the scene's. Raises ValueError for a bad pose or padding.
        """
        if not isinstance(name, str):
            raise ValueError(f"name must be a string, got {name!r}")
        where = IDENTITY_POSE if pose is None else as_array(pose, "pose", (7,))
        pad = self._padding if padding is None else padding
        _check_padding(pad)
        slot = self._store.put(name, _local_box(shape), where, pad)
        if padding is None:
            self._own_padding.discard(slot)
        else:
            self._own_padding.add(slot)
        return slot

    def move(self, name: str, pose: ArrayLike) -> None:
        """Give one object a new pose (7,). KeyError for an unknown name."""
        slot = self._store.slot(name)
        self._store.move(np.array([slot]), as_array(pose, "pose", (7,))[None])

    def move_many(self, names: Iterable[str], poses: ArrayLike) -> None:
        """Give objects new poses (n, 7), by name; all or, on an error, none."""
        self._store.move(self._store.slots_of(names), poses)

    def move_indices(self, indices: ArrayLike, poses: ArrayLike) -> None:
        """Give objects new poses (n, 7), by index array (n,); all or, on an error, none."""
        self._store.move(self._store.check_slots(indices), poses)

    def remove(self, name: str) -> None:
        """Take an object out. KeyError for an unknown name."""
        self._own_padding.discard(self._store.remove(name))

    def clear(self) -> None:
        """Take all objects out."""
        self._store = ObjectStore()
        self._own_padding.clear()
        self._bounds = None
        self._report = None

    def set_enabled(self, name: str, enabled: bool) -> None:
        """Let an object take part in collisions or not; it keeps its box either way."""
        slot = self._store.slot(name)
        if self._store.active[slot] != enabled:
            self._store.active[slot] = enabled
            self._store.changed[slot] = True

    @property
    def padding(self) -> float:
        """Metres by which boxes without a padding of their own are grown on every side."""
        return self._padding

    @padding.setter
    def padding(self, value: float) -> None:
        _check_padding(value)
        self._padding = float(value)
        rows = np.setdiff1d(self._store.live(), sorted(self._own_padding)).astype(np.int64)
        self._store.pad(rows, self._padding)

    def __len__(self) -> int:
        return len(self._store)

    def __contains__(self, name: object) -> bool:
        return name in self._store.slots

    def index(self, name: str) -> int:
        """Return the index of an object. KeyError for an unknown name."""
        return self._store.slot(name)

    def name(self, index: int) -> str:
        """Return the name of the object with an index. KeyError for an unknown one."""
        return str(self._store.names[self._store.check_slots(index)[0]])

    @property
    def names(self) -> list[str]:
        """The names of the objects, in the order of ``indices``."""
        return [str(self._store.names[slot]) for slot in self.indices]

    @property
    def indices(self) -> NDArray[np.int64]:
        """(n,) the indices of the objects, ascending."""
        return self._store.live()

    @property
    def boxes(self) -> Boxes:
        """The world boxes, padding included, in the order of ``indices``."""
        return self._store.boxes(self.indices)

    def obb(self, name: str) -> OBB:
        """Return the world box of one object, padding included."""
        return OBB(*self._store.all_boxes().row(self._store.slot(name)))

    def check(self) -> Report:
        """Return all colliding pairs. Only what changed since the last check is computed anew."""
        changed = np.flatnonzero(self._store.changed)
        if self._report is not None and len(changed) == 0:
            return self._report
        start = perf_counter()
        few = len(changed) * INCREMENTAL_SHARE < len(self._store.names)
        if self._report is not None and self._bounds is not None and few:
            pairs, verdicts, old = self._check_changed(changed, self._report, self._bounds)
        else:
            pairs, verdicts = self._check_all()
            old = None
        found = perf_counter()
        self._report = self._describe(pairs, verdicts, old, found - start)
        self._store.changed[:] = False
        return self._report

    def _check_all(self) -> tuple[Pairs, NDArray[np.int8]]:
        active = np.flatnonzero(self._store.active)
        boxes = self._store.boxes(active)
        minimum, maximum = boxes.world_bounds()
        pairs, verdicts = colliding_pairs(boxes, find_candidates(minimum, maximum), self._exact)
        shape = self._store.centers.shape
        self._bounds = (np.full(shape, np.inf), np.full(shape, -np.inf))
        self._bounds[0][active] = minimum
        self._bounds[1][active] = maximum
        return active[pairs], verdicts

    def _check_changed(
        self, changed: Rows, report: Report, bounds: tuple[Floats, Floats]
    ) -> tuple[Pairs, NDArray[np.int8], NDArray[np.int64]]:
        """Return pairs, verdicts, and each pair's row in the last report, -1 for those anew."""
        store = self._store
        active = changed[store.active[changed]]
        bounds[0][changed] = np.inf  # empty: overlaps nothing
        bounds[1][changed] = -np.inf
        bounds[0][active], bounds[1][active] = store.boxes(active).world_bounds()
        boxes = store.all_boxes()
        new, verdicts = colliding_pairs(boxes, find_candidates_of(*bounds, active), self._exact)
        kept = np.flatnonzero(~store.changed[report.pairs].any(axis=1))
        pairs = np.concatenate([report.pairs[kept], new])
        order = np.lexsort((pairs[:, 1], pairs[:, 0]))
        old = np.concatenate([kept, np.full(len(new), -1)])[order]
        return pairs[order], np.concatenate([report.verdicts[kept], verdicts])[order], old

    def _describe(
        self, pairs: Pairs, verdicts: NDArray[np.int8], old: Rows | None, seconds: float
    ) -> Report:
        """Add separations, normals and points, copied where the pair's row ``old`` has them."""
        start = perf_counter()
        boxes = self._store.all_boxes()
        gaps, normals, points = np.empty(len(pairs)), *np.empty((2, len(pairs), 3))
        anew = np.arange(len(pairs)) if old is None else np.flatnonzero(old < 0)
        results = np.empty(len(anew)), *np.empty((2, len(anew), 3))
        witness_kernel(boxes.centers, boxes.rotations, boxes.half_extents, pairs[anew], *results)
        gaps[anew], normals[anew], points[anew] = results
        if old is not None and self._report is not None:
            known = np.flatnonzero(old >= 0)
            last = self._report
            for new_values, values in (
                (gaps, last.separations),
                (normals, last.normals),
                (points, last.points),
            ):
                new_values[known] = values[old[known]]
        stages = {"pairs": seconds, "separations": perf_counter() - start}
        names = tuple(self._store.names)
        return Report(pairs, verdicts, gaps, normals, points, names, stages)


def _check_padding(padding: float) -> None:
    if as_array(padding, "padding", ()) < 0.0:
        raise ValueError("padding must not be negative")


def _local_box(shape: Shape | OBB) -> LocalBox:
    if isinstance(shape, OBB):
        return shape.center, shape.rotation, shape.half_extents
    return shape.local_box
