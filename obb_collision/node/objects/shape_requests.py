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

"""Shapes that are built in another process: which objects wait for them, and which exist.

Objects with the same file, or the same points, share one shape. It stays cached for some time after
the last of them is removed, since many senders delete everything and send it again. A file is
checked again when a marker names it again, at most once per CHECK_PERIOD.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from time import monotonic
from typing import Any
from weakref import WeakValueDictionary

from obb_collision.geometry.shapes.files import (
    LARGEST_FILE,
    MOST_TRIANGLES,
    NO_FOLDERS,
    MeshFolders,
    Version,
)
from obb_collision.node.messages.cdr import TOO_MANY_POINTS
from obb_collision.node.messages.conversions import Key
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.marker_shapes import ShapePlan, Signature
from obb_collision.scene.building.builder import Builder, Outcome
from obb_collision.scene.building.jobs import (
    TOO_MANY_TRIANGLES,
    Bodies,
    BuildError,
    Job,
    MeshFile,
    Triangles,
)
from obb_collision.shapes import Shape

CHECK_PERIOD = 1.0
"""Minimum seconds between two checks of the same file."""
KEPT_BYTES = 100_000_000
KEPT_SHAPES = 1000
"""Limits of the cache of shapes that no object has at present."""
CHECK = "check"
"""Marks requests to check a file, for which no object waits."""


@dataclass(frozen=True)
class BuiltShape:
    """The result for objects: a shape or an error. keys: None for all objects of that shape."""

    signature: Signature
    shape: Shape | None
    error: BuildError | None
    keys: tuple[Key, ...] | None


@dataclass(frozen=True)
class ShapeLimits:
    """Limits of what objects may request.

    file_size: bytes of a mesh file; triangles, points: of a shape; mesh_folders: where mesh files
    may be, besides the shares of installed packages.
    """

    file_size: int = LARGEST_FILE
    triangles: int = MOST_TRIANGLES
    points: int = 3 * MOST_TRIANGLES
    mesh_folders: MeshFolders = NO_FOLDERS

    def applied(self, job: Job) -> Job:
        """Return a job with the limits applied; RefusedError for a job beyond them."""
        if isinstance(job, MeshFile):
            return replace(
                job, largest=self.file_size, triangles=self.triangles, folders=self.mesh_folders
            )
        if isinstance(job, Triangles) and len(job.points) > 3 * self.triangles:
            detail = f"{len(job.points) // 3}, {self.triangles} is the limit"
            raise RefusedError(TOO_MANY_TRIANGLES, detail)
        if isinstance(job, (Triangles, Bodies)) and len(job.points) > self.points:
            raise RefusedError(TOO_MANY_POINTS, f"{len(job.points)}, {self.points} is the limit")
        return job


@dataclass
class _File:
    job: MeshFile
    version: Version | None
    next_check: float
    asked: bool = False


class ShapeRequests:
    """Requests shapes from a builder, and caches those in use.

    clock: seconds, rising.
    """

    def __init__(self, builder: Builder, clock: Callable[[], float] = monotonic) -> None:
        self._builder, self._clock = builder, clock
        self._built: WeakValueDictionary[Signature, Shape] = WeakValueDictionary()
        self._files: dict[Signature, _File] = {}
        self._recent: dict[Signature, Shape] = {}
        self._recent_bytes = 0
        self.limits = ShapeLimits()

    def built(self, plan: ShapePlan) -> Shape | None:
        """Return the shape of a plan if it is already built, else None."""
        shape = self._built.get(plan.signature)
        if shape is not None:
            self._use(plan.signature, shape)
            self.check_file(plan)
        return shape

    def _use(self, signature: Signature, shape: Shape) -> None:
        """Cache a shape, and drop those that were used longest ago."""
        recent = self._recent
        last = recent.pop(signature, None)
        self._recent_bytes += _size(shape) - (0 if last is None else _size(last))
        recent[signature] = shape
        while self._recent_bytes > KEPT_BYTES or len(recent) > KEPT_SHAPES:
            self._recent_bytes -= _size(recent.pop(next(iter(recent))))

    def check_file(self, plan: ShapePlan) -> None:
        """Request a new look at the file of a plan, if the plan has a file."""
        file = self._files.get(plan.signature)
        if file is not None:
            file.asked = True

    def request(self, key: Key, plan: ShapePlan) -> None:
        """Have the shape of a plan built for an object.

        RefusedError where it exceeds a limit, or too many wait.
        """
        assert plan.job is not None
        job = self.limits.applied(plan.job)
        try:
            self._builder.request(key, plan.signature, job)
        except BuildError as error:
            raise RefusedError(error.reason, error.detail) from error

    def poll(self) -> Iterator[BuiltShape]:
        """Yield the shapes and errors that came for objects since the last call."""
        for outcome in self._builder.poll():
            signature: Any = outcome.signature
            keys: tuple[Any, ...] | None = tuple(outcome.keys)
            if signature[0] == CHECK:
                signature, keys = signature[1], None
                is_unchanged = outcome.error is None and outcome.result is None
                if is_unchanged or signature not in self._files:
                    continue
            shape = self._keep(signature, outcome) if outcome.error is None else None
            yield BuiltShape(signature, shape, outcome.error, keys)
        self._look_at_files()

    def _keep(self, signature: Signature, outcome: Outcome) -> Shape:
        """Store and return a shape that was built."""
        built = outcome.result
        shape, version = built if isinstance(built, tuple) else (built, None)
        if version is not None:
            job: Any = outcome.job
            self._files[signature] = _File(job, version, self._clock() + CHECK_PERIOD)
        self._built[signature] = shape
        self._use(signature, shape)
        return shape

    def _look_at_files(self) -> None:
        """Have files looked at that a marker named again."""
        now = self._clock()
        for signature in [unused for unused in self._files if unused not in self._built]:
            del self._files[signature]
        for signature, file in self._files.items():
            if not file.asked or now < file.next_check:
                continue
            file.asked, file.next_check = False, now + CHECK_PERIOD
            check = (CHECK, signature)
            try:
                self._builder.request(check, check, replace(file.job, known=file.version))
            except BuildError:
                file.asked = True


def _size(shape: Shape) -> int:
    return sum(getattr(value, "nbytes", 0) for value in vars(shape).values())
