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
from obb_collision.queries.accuracy import Accuracy, as_accuracy
from obb_collision.queries.coarse import sphere_bounds
from obb_collision.scene.broad_phase import Pairs, find_candidates, find_candidates_of
from obb_collision.scene.ladder import Found, decide_pairs, is_plain, needs_spheres
from obb_collision.scene.pairs import colliding_pairs
from obb_collision.scene.report import Report, describe
from obb_collision.scene.store import LocalBox, ObjectStore, Rows
from obb_collision.scene.tree_bank import TreeBank

#: With fewer than one object in this many changed, only pairs of the changed ones are looked at.
INCREMENTAL_SHARE = 32
#: Depth of the trees on the rung "obb_tree": eight boxes a mesh.
DEFAULT_DEPTH = 3


class Scene:
    """A store of named objects that knows which of them collide.

    padding: metres by which every box is grown on each side.
    exact: decide by integer arithmetic what doubles can't tell from touching.
    accuracy: the rung of ``Accuracy`` for objects without one of their own, or its name. A pair is
    decided on the lower rung of its two objects, above "obb" only where meshes or hulls are
    concerned that have no padding (see ``scene.ladder``).
    tree_depth: of the boxes of "obb_tree", 2^depth a mesh.
    Raises ValueError for a padding or depth below zero and an unknown accuracy.
    """

    def __init__(
        self,
        *,
        padding: float = 0.0,
        exact: bool = False,
        accuracy: Accuracy | str = "obb",
        tree_depth: int = DEFAULT_DEPTH,
    ) -> None:
        self.clear()
        self._padding = 0.0
        self.padding = padding
        self._exact = exact
        self._accuracy = as_accuracy(accuracy)
        self._tree_depth = _checked_depth(tree_depth)

    def add(
        self,
        name: str,
        shape: Shape | OBB,
        pose: ArrayLike | None = None,
        *,
        padding: float | None = None,
        accuracy: Accuracy | str | None = None,
    ) -> int:
        """Add an object, or replace the one of that name, and return its index.

        shape: a value of ``geometry.shapes`` or an OBB, in the object's own frame; its local box
        is fitted once. pose (7,): x y z qx qy qz qw, identity if not given. padding, metres, and
        accuracy: in place of the scene's. Raises ValueError for bad values of any of them.
        """
        if not isinstance(name, str):
            raise ValueError(f"name must be a string, got {name!r}")
        where = IDENTITY_POSE if pose is None else as_array(pose, "pose", (7,))
        pad = self._padding if padding is None else padding
        _check_padding(pad)
        rung = None if accuracy is None else as_accuracy(accuracy)
        slot = self._store.put(name, _local_box(shape), where, pad)
        self._store.kinds[slot] = self._bank.put(slot, shape)
        self._set_accuracy(slot, rung)
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
        slot = self._store.remove(name)
        self._own_padding.discard(slot)
        self._own_accuracy.discard(slot)
        self._bank.shapes.pop(slot, None)

    def clear(self) -> None:
        """Take all objects out."""
        self._store = ObjectStore()
        self._bank = TreeBank()
        self._own_padding: set[int] = set()
        self._own_accuracy: set[int] = set()
        self._bounds: tuple[Floats, Floats] | None = None
        self._spheres = False  # whether the bounds hold the spheres, too
        self._report: Report | None = None

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

    @property
    def accuracy(self) -> Accuracy:
        """The rung of the objects without one of their own; may be set, also by name."""
        return self._accuracy

    @accuracy.setter
    def accuracy(self, value: Accuracy | str) -> None:
        self._accuracy = as_accuracy(value)
        for slot in np.setdiff1d(self._store.live(), sorted(self._own_accuracy)).tolist():
            self._set_accuracy(int(slot), None)

    def set_accuracy(self, name: str, accuracy: Accuracy | str | None) -> None:
        """Give an object a rung of its own, or with None the scene's. KeyError, ValueError."""
        rung = None if accuracy is None else as_accuracy(accuracy)
        self._set_accuracy(self._store.slot(name), rung)

    def _set_accuracy(self, slot: int, own: Accuracy | None) -> None:
        if own is None:
            self._own_accuracy.discard(slot)
        else:
            self._own_accuracy.add(slot)
        value = self._accuracy if own is None else own
        if self._store.accuracies[slot] != value:
            self._store.accuracies[slot] = value
            self._store.changed[slot] = True

    @property
    def tree_depth(self) -> int:
        """Depth of the boxes on the rung "obb_tree": at most 2^depth of them a mesh."""
        return self._tree_depth

    @tree_depth.setter
    def tree_depth(self, value: int) -> None:
        self._tree_depth = _checked_depth(value)
        self._store.changed |= self._store.used & (self._store.accuracies >= Accuracy.OBB_TREE)

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
        spheres = needs_spheres(self._store)
        known = self._bounds is not None and (self._spheres or not spheres)
        last = self._report if few and known else None
        if last is not None and self._bounds is not None:
            found, old = self._check_changed(changed, last, self._bounds)
        else:
            self._spheres = spheres
            found, old = self._check_all(), None
        stages = {"pairs": perf_counter() - start}
        names = tuple(self._store.names)
        self._report = describe(self._store.all_boxes(), found, names, stages, last, old)
        self._store.changed[:] = False
        return self._report

    def _check_all(self) -> Found:
        active = np.flatnonzero(self._store.active)
        boxes = self._store.boxes(active)
        minimum, maximum = self._bounds_of(boxes)
        candidates = find_candidates(minimum, maximum)
        shape = self._store.centers.shape
        self._bounds = (np.full(shape, np.inf), np.full(shape, -np.inf))
        self._bounds[0][active] = minimum
        self._bounds[1][active] = maximum
        if not is_plain(self._store):
            return self._decide(active[candidates])
        pairs, verdicts = colliding_pairs(boxes, candidates, self._exact)
        return active[pairs], verdicts, _on_boxes(len(pairs))

    def _check_changed(
        self, changed: Rows, report: Report, bounds: tuple[Floats, Floats]
    ) -> tuple[Found, Rows]:
        """Return what is found, and each pair's row in the last report, -1 for those anew."""
        store = self._store
        active = changed[store.active[changed]]
        bounds[0][changed] = np.inf  # empty: overlaps nothing
        bounds[1][changed] = -np.inf
        bounds[0][active], bounds[1][active] = self._bounds_of(store.boxes(active))
        candidates = find_candidates_of(*bounds, active)
        if is_plain(store):
            new, verdicts = colliding_pairs(store.all_boxes(), candidates, self._exact)
            rungs = _on_boxes(len(new))
        else:
            new, verdicts, rungs = self._decide(candidates)
        kept = np.flatnonzero(~store.changed[report.pairs].any(axis=1))
        pairs = np.concatenate([report.pairs[kept], new])
        order = np.lexsort((pairs[:, 1], pairs[:, 0]))
        old = np.concatenate([kept, np.full(len(new), -1)])[order]
        verdicts = np.concatenate([report.verdicts[kept], verdicts])[order]
        rungs = np.concatenate([report.rungs[kept], rungs])[order]
        return (pairs[order], verdicts, rungs), old

    def _bounds_of(self, boxes: Boxes) -> tuple[Floats, Floats]:
        return sphere_bounds(boxes) if self._spheres else boxes.world_bounds()

    def _decide(self, candidates: Pairs) -> Found:
        return decide_pairs(self._store, self._bank, candidates, self._tree_depth, self._exact)


def _on_boxes(count: int) -> NDArray[np.int8]:
    return np.full(count, Accuracy.OBB, np.int8)


def _check_padding(padding: float) -> None:
    if as_array(padding, "padding", ()) < 0.0:
        raise ValueError("padding must not be negative")


def _checked_depth(depth: int) -> int:
    if isinstance(depth, bool) or not isinstance(depth, (int, np.integer)) or depth < 0:
        raise ValueError(f"tree_depth must be a whole number, not negative, got {depth!r}")
    return int(depth)


def _local_box(shape: Shape | OBB) -> LocalBox:
    if isinstance(shape, OBB):
        return shape.center, shape.rotation, shape.half_extents
    return shape.local_box
