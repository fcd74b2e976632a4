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

"""A cloud in many boxes: ``points_inside`` beside numpy box by box and scipy's cKDTree, in one run.

All three find for every box the number of points in it, the first and the nearest to its centre.
numpy tests all points against one box after the other. The tree is built over the cloud and gives
the points in the sphere around each box; those are tested. Times are medians of several turns; on a
machine that others use, the minimum processor time of all turns is more informative.

    python -m tools.points [--points N] [--boxes N] [--json FILE]
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from obb_collision.benchmarks.timing import on_threads, seconds_of
from obb_collision.cli import Parser, interruptible, new_file, option, whole
from obb_collision.geometry.boxes import Boxes
from obb_collision.queries.points.points import points_inside
from obb_collision.typing import Floats

#: Turns of this library, and of the peers, which take seconds.
TURNS = 9
PEER_TURNS = 1
#: Half edge of the cube in which centres and points are drawn, metres, for 200 boxes.
SPREAD = 2.5
SCENES = ("ordinary", "one box over all", "crowd in a hall", "long rods", "all points outside")

#: Counts, first and nearest (n,) of each box.
Found = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]


def scene(name: str, boxes: int, points: int) -> tuple[Boxes, Floats]:
    """Return boxes of 0.05 to 0.5 m half extents, or what the name says, and a cloud."""
    rng = np.random.default_rng(0)
    spread = SPREAD * (boxes / 200) ** (1 / 3)
    centers = rng.uniform(-spread, spread, (boxes, 3))
    half = rng.uniform(0.05, 0.5, (boxes, 3))
    cloud = rng.uniform(-spread, spread, (points, 3))
    if name == "one box over all":
        half[0] = 2.0 * spread
    elif name == "crowd in a hall":
        centers, half = 0.02 * centers, 0.02 * half
        half[0] = spread
        cloud[::2] *= 0.02
    elif name == "long rods":
        half[:] = 0.01, 0.01, 2.0 * spread
    elif name == "all points outside":
        cloud += 4.0 * spread
    return Boxes(centers, Rotation.random(boxes, random_state=rng).as_matrix(), half), cloud


def by_numpy(boxes: Boxes, cloud: Floats) -> Found:
    """Test all points against each box."""
    every = np.arange(len(cloud))
    return _by_box(boxes, cloud, (every for _ in range(len(boxes))))


def by_tree(boxes: Boxes, cloud: Floats) -> Found:
    """Build a tree of the points, and test those in the sphere around each box."""
    tree = cKDTree(cloud)
    radii = np.linalg.norm(boxes.half_extents, axis=1) * (1.0 + 1e-12)
    near = (
        np.asarray(tree.query_ball_point(center, radius, return_sorted=True), np.int64)
        for center, radius in zip(boxes.centers, radii, strict=True)
    )
    return _by_box(boxes, cloud, near)


def _by_box(boxes: Boxes, cloud: Floats, candidates: Iterable[NDArray[np.int64]]) -> Found:
    counts = np.zeros(len(boxes), np.int64)
    first, nearest = np.full((2, len(boxes)), -1)
    for b, rows in enumerate(candidates):
        offsets = (cloud if len(rows) == len(cloud) else cloud[rows]) - boxes.centers[b]
        inside = np.ones(len(rows), np.bool_)
        for axis, extent in zip(boxes.rotations[b].T, boxes.half_extents[b], strict=True):
            # by columns: far faster than a product of such narrow matrices
            along = offsets[:, 0] * axis[0] + offsets[:, 1] * axis[1] + offsets[:, 2] * axis[2]
            inside &= np.abs(along) <= extent
        held = np.flatnonzero(inside)
        counts[b] = len(held)
        if len(held):
            first[b] = rows[held[0]]
            nearest[b] = rows[held[(offsets[held] ** 2).sum(axis=1).argmin()]]
    return counts, first, nearest


def compare(name: str, boxes: int, points: int) -> dict[str, float]:
    """Return milliseconds of each side and the number of boxes on which they differ."""
    placed, cloud = scene(name, boxes, points)
    small = cloud.astype(np.float32)
    found = points_inside(placed, cloud)
    points_inside(placed, small)
    row: dict[str, float] = {"inside": float(found.counts.sum())}
    sides: dict[str, tuple[Callable[[], object], int]] = {
        "ours": (lambda: points_inside(placed, cloud), TURNS),
        "float32": (lambda: points_inside(placed, small), TURNS),
        "one thread": (lambda: _by_one_thread(placed, cloud), TURNS),
        "numpy": (lambda: by_numpy(placed, cloud), PEER_TURNS),
        "tree": (lambda: by_tree(placed, cloud), PEER_TURNS),
    }
    for side, (run, turns) in sides.items():
        times = np.array([seconds_of(run) for _ in range(turns)])
        row[f"{side}_ms"], row[f"{side}_cpu_ms"] = (
            1e3 * float(np.median(times[:, 0])),
            1e3 * float(times[:, 1].min()),
        )
    ours = (found.counts, found.first, found.nearest)
    theirs = by_numpy(placed, cloud)
    row["differ"] = sum(int((a != b).sum()) for a, b in zip(ours, theirs, strict=True))
    return row


def _by_one_thread(placed: Boxes, cloud: Floats) -> None:
    with on_threads(1):
        points_inside(placed, cloud)


@interruptible("points")
def main(arguments: list[str] | None = None) -> None:
    """Print the table; ``--json FILE`` writes it too."""
    parser = Parser(description="points of a cloud in many boxes, beside numpy and a k-d tree")
    option(parser, "--points", whole(1, 10**9), 1_000_000, "points of the cloud")
    option(parser, "--boxes", whole(1, 10**6), 200, "boxes it is tested against")
    option(parser, "--json", new_file(), text="write the figures to a file")
    options = parser.parse_args(arguments)
    rows = {}
    print(f"{options.points:,} points, {options.boxes} boxes; milliseconds, (processor)")
    print(f"{'':20}{'ours':>14}{'float32':>14}{'1 thread':>14}{'numpy':>16}{'cKDTree':>16}  differ")
    for name in SCENES:
        row = rows[name] = compare(name, options.boxes, options.points)
        cells = [
            f"{row[f'{side}_ms']:.0f} ({row[f'{side}_cpu_ms']:.0f})".rjust(width)
            for side, width in (
                ("ours", 14), ("float32", 14), ("one thread", 14), ("numpy", 16), ("tree", 16),
            )
        ]  # fmt: skip
        print(f"{name:20}{''.join(cells)}  {row['differ']:.0f}")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    raise SystemExit(main())
