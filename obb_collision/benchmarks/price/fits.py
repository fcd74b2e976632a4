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

"""The fits of a box to a mesh: the size of each box relative to the best one, and the time."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import zip_longest
from time import perf_counter, thread_time

import numpy as np

from obb_collision.benchmarks.price.scenes import Corpus
from obb_collision.geometry.fitting.fit import FITS, fit_points
from obb_collision.geometry.shapes.meshes import Mesh


@dataclass(frozen=True)
class FitRow:
    """A fit over all meshes: volume relative to the best box of any fit, and milliseconds."""

    fit: str
    meshes: int
    mean_volume: float  #: geometric mean
    worst_volume: float
    mean_ms: float


def measure_fits(
    corpora: Iterable[Corpus], seconds: float, show: Callable[[str], None]
) -> list[FitRow]:
    """Fit boxes to the meshes of corpora, as many as fit in ``seconds``, at least one."""
    end = perf_counter() + seconds
    rows = zip_longest(*(corpus.shapes.values() for corpus in corpora))
    meshes = [shape for row in rows for shape in row if isinstance(shape, Mesh)]
    volumes: list[list[float]] = []
    times: list[list[float]] = []
    for k, mesh in enumerate(meshes):
        if volumes and perf_counter() > end:
            break
        show(f"fits {k + 1}/{len(meshes)}")
        points = mesh._points()
        found = [_fit(points, fit) for fit in FITS]
        if min(volume for volume, _ in found) > 0.0:
            volumes.append([volume for volume, _ in found])
            times.append([spent for _, spent in found])
    sizes, spent = np.array(volumes).reshape(-1, len(FITS)), np.array(times).reshape(-1, len(FITS))
    if len(sizes) == 0:
        return []
    ratios = sizes / sizes.min(axis=1, keepdims=True)
    return [
        FitRow(
            fit,
            len(ratios),
            float(np.exp(np.log(ratios[:, k]).mean())),
            float(ratios[:, k].max()),
            1e3 * float(spent[:, k].mean()),
        )
        for k, fit in enumerate(FITS)
    ]


def _fit(points: np.ndarray, fit: str) -> tuple[float, float]:
    """Return volume and seconds."""
    start = thread_time()
    _, _, half_extents = fit_points(points, fit)
    return 8.0 * float(half_extents.prod()), thread_time() - start
