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

"""Distances of convex shapes: this library's beside coal's, in one run.

2,000 random pairs of each two kinds, those that are apart and those that overlap. This library has
all in one call; coal is called from Python pair by pair, with closest points, and with its shapes,
transforms, request and result made beforehand. One thread; processor time, turn by turn.

    python -m tools.peers.convex_distances [--pairs N] [--json FILE]
"""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from obb_collision.benchmarks.levels import coal_hull
from obb_collision.benchmarks.timing import on_threads, seconds_of
from obb_collision.cli import Parser, interruptible, new_file, option, whole
from obb_collision.geometry.shapes.meshes import Mesh
from obb_collision.geometry.trees.pool import HullPool, Hulls
from obb_collision.queries.convex.distances import convex_distances
from obb_collision.queries.convex.support import (
    BOX,
    CONE,
    CORNERS,
    CYLINDER,
    ROUND,
    SEGMENT,
    ConvexBodies,
)
from obb_collision.typing import Floats, Rows
from tools.peers.effects import Ask
from tools.peers.meshes import TURNS

KINDS = {
    "hull": CORNERS,
    "box": BOX,
    "capsule": SEGMENT,
    "ellipsoid": ROUND,
    "cylinder": CYLINDER,
    "cone": CONE,
}
PAIRS = [
    ("hull", "hull"),
    ("box", "box"),
    ("box", "hull"),
    ("capsule", "hull"),
    ("capsule", "capsule"),
    ("ellipsoid", "ellipsoid"),
    ("hull", "cylinder"),
    ("cylinder", "cylinder"),
    ("cone", "cone"),
    ("box", "cylinder"),
]
HULLS, CORNERS_EACH = 16, 40
OFFSETS = {"apart": (1.2, 2.0), "overlapping": (0.05, 0.45)}
"""How far the second centre is from the first one (m)."""


def directions(count: int, rng: np.random.Generator) -> Floats:
    """Return random unit vectors (n, 3)."""
    vectors = rng.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


class Shapes:
    """Random bodies of this library and the same ones of coal."""

    def __init__(self, coal: Any, rng: np.random.Generator) -> None:
        self._coal, self._rng, self._pool = coal, rng, HullPool()
        corners = [directions(CORNERS_EACH, rng) * (0.5, 0.4, 0.3) for _ in range(HULLS)]
        for each in corners:
            self._pool.append(Hulls.of(each))
        self._hulls = [coal_hull(coal, Mesh(each, ConvexHull(each).simplices)) for each in corners]

    def make(self, kind: str, count: int) -> ConvexBodies:
        """Return bodies of a kind at the origin, turned at random."""
        sizes, radii, given = np.zeros((count, 4)), np.zeros(count), KINDS[kind]
        random = self._rng.uniform(0.2, 0.5, (count, 4))
        if given in (BOX, ROUND):
            sizes[:, :3] = random[:, :3]
        elif given in (CYLINDER, CONE):
            sizes[:, :2], sizes[:, 3] = random[:, :1], random[:, 3]
        elif given == SEGMENT:
            sizes[:, 3], radii = random[:, 3], 0.6 * random[:, 0]
        return ConvexBodies(
            *(np.full(count, given, np.int8), sizes, radii, self._pool.all),
            *(self._rng.integers(0, HULLS, count), np.zeros((count, 3))),
            Rotation.random(count, random_state=self._rng).as_matrix(),
        )

    def placed(self, bodies: ConvexBodies, row: int) -> tuple[Any, Any]:
        """Return a body as coal's shape and transform."""
        coal, size, half = self._coal, bodies.sizes[row, :3].tolist(), bodies.sizes[row, 3]
        made: dict[int, Callable[[], Any]] = {
            CORNERS: lambda: self._hulls[bodies.rows[row]],
            BOX: lambda: coal.Box(*(2.0 * side for side in size)),
            SEGMENT: lambda: coal.Capsule(bodies.radii[row], 2.0 * half),
            ROUND: lambda: coal.Ellipsoid(*size),
            CYLINDER: lambda: coal.Cylinder(size[0], 2.0 * half),
            CONE: lambda: coal.Cone(size[0], 2.0 * half),
        }
        place = coal.Transform3s(bodies.rotations[row], bodies.centers[row])
        return made[int(bodies.kinds[row])](), place


def ask_coal(coal: Any, calls: list[tuple[Any, ...]]) -> Ask:
    """Return a function that asks coal for all distances (n,)."""
    request, result = coal.DistanceRequest(True), coal.DistanceResult()

    def run() -> Floats:
        found = []
        for call in calls:
            result.clear()
            found.append(coal.distance(*call, request, result))
        return np.array(found)

    return run


def compare(kinds: tuple[str, str], pairs: int) -> dict[str, dict[str, float]]:
    """Return figures of the pairs of two kinds that are apart, and of those that overlap.

    Microseconds per pair, how many times as fast as coal we are (the median of the turns), how far
    apart our bounds are at most, and how far coal is from ours (the median), in metres.
    """
    coal, rng = importlib.import_module("coal"), np.random.default_rng(5)
    shapes, rows = Shapes(coal, rng), np.arange(pairs)
    found = {}
    for name, (least, most) in OFFSETS.items():
        first, second = (shapes.make(kind, pairs) for kind in kinds)
        offsets = directions(pairs, rng) * rng.uniform(least, most, (pairs, 1))
        second = replace(second, centers=offsets)
        lower = convex_distances(first, second, rows, rows)[0].lower
        kept = np.flatnonzero((lower > 0.0) == (name == "apart"))
        if len(kept):
            found[name] = _compare(shapes, coal, first, second, kept)
    return found


def _compare(
    shapes: Shapes, coal: Any, first: ConvexBodies, second: ConvexBodies, rows: Rows
) -> dict[str, float]:
    ask = ask_coal(
        coal, [(*shapes.placed(first, row), *shapes.placed(second, row)) for row in rows]
    )

    def ours() -> object:
        return convex_distances(first, second, rows, rows)

    with on_threads(1):
        bounds, theirs = convex_distances(first, second, rows, rows)[0], ask()
        used = np.array([[seconds_of(run)[1] for run in (ours, ask)] for _ in range(TURNS)])
    best = 1e6 * used.min(axis=0) / len(rows)
    lower, upper = bounds.lower, bounds.upper
    return {
        "pairs": len(rows),
        "ours_us": best[0],
        "coal_us": best[1],
        "coal_ratio": float(np.median(used[:, 1] / used[:, 0])),
        "bounds_m": float((upper - lower)[lower > 0.0].max(initial=0.0)),
        "coal_differs_m": float(np.median(np.abs(theirs - lower))),
    }


@interruptible("convex_distances")
def main(arguments: list[str] | None = None) -> None:
    """Print the table; ``--json FILE`` writes it too."""
    parser = Parser(description="distances of convex shapes beside coal")
    option(parser, "--pairs", whole(1, 10**8), 2000, "pairs of each two kinds")
    option(parser, "--json", new_file(), text="write the figures to a file")
    options = parser.parse_args(arguments)
    if importlib.util.find_spec("coal") is None:
        parser.error("coal is not installed: pip install coal")
    rows = {}
    print(f"{'kinds':24}{'':13}{'pairs':>7}{'ours µs':>9}{'coal µs':>9}{'ratio':>7}{'differ':>9}")
    for kinds in PAIRS:
        for name, row in compare(kinds, options.pairs).items():
            rows[", ".join((*kinds, name))] = row
            print(
                f"{', '.join(kinds):24}{name:13}{row['pairs']:7}{row['ours_us']:9.2f}"
                f"{row['coal_us']:9.2f}{row['coal_ratio']:7.1f}{row['coal_differs_m']:9.0e}"
            )
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    raise SystemExit(main())
