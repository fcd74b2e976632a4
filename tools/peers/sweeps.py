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

"""Moving boxes: this library's sweeps beside python-fcl's ``continuousCollide``, in one run.

Both get the same boxes moving from the same start to the same end poses. python-fcl is called
from Python pair by pair with objects and transforms made beforehand, which is how it is used.
Both are timed by the processor time of this process, turn by turn, the best of several turns.

What counts as a miss: the boxes certainly overlap at a time just after our time of contact (by
the certified verdicts, with poses computed by scipy), and the other side reports no collision.

For turning boxes python-fcl 0.7 gives different results in different runs on the same input: all
hits and no false ones, hardly any, or a hit for every pair. Consider its misses and false hits
before its speed.

    python -m tools.peers.sweeps [--pairs N]
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from obb_collision import sweeps, verdicts
from obb_collision.benchmarks.measuring import as_text
from obb_collision.boxes import Boxes
from obb_collision.cli import Parser, interruptible, option, whole
from obb_collision.queries.sweep.motion import MovingBoxes
from obb_collision.queries.sweep.sweep import Sweeps
from obb_collision.queries.verdict.verdict import Verdict
from obb_collision.typing import Floats

#: Turns of each side; the best counts, since others use the machine too.
TURNS = 5
#: How long after the first contact the overlap is looked for: several times, as a share of 1.
AFTER = (0.0, 1e-9, 1e-6, 1e-4, 1e-3, 1e-2, 0.05)

Motion = tuple[Boxes, Boxes]


def ordinary(rng: np.random.Generator, n: int, turning: bool) -> Motion:
    """2 n boxes of 0.1 to 1 m that cross a small room."""
    centers = rng.uniform(-2.0, 2.0, (2, 2 * n, 3))
    half_extents = rng.uniform(0.05, 0.5, (2 * n, 3))
    return _motion(rng, centers, half_extents, turning)


def bullets(rng: np.random.Generator, n: int, turning: bool) -> Motion:
    """Boxes of centimetres that fly 20 m at a wall of 1 mm, and the wall stands still."""
    wall = np.column_stack([np.full(n, 5e-4), *rng.uniform(0.5, 2.0, (2, n))])
    bullet = rng.uniform(0.005, 0.05, (n, 3))
    target = np.column_stack([np.zeros(n), *rng.uniform(-2.0, 2.0, (2, n))])
    way = rng.normal(size=(n, 3))
    way *= 20.0 / np.linalg.norm(way, axis=1, keepdims=True)
    share = rng.random((n, 1))
    start = np.stack([np.zeros((n, 3)), target - share * way], axis=1).reshape(-1, 3)
    end = np.stack([np.zeros((n, 3)), target + (1.0 - share) * way], axis=1).reshape(-1, 3)
    half_extents = np.stack([wall, bullet], axis=1).reshape(-1, 3)
    first, last = _motion(rng, np.stack([start, end]), half_extents, turning)
    for boxes in (first, last):
        boxes.arrays.rotations[::2] = np.eye(3)
    return first, last


def _motion(
    rng: np.random.Generator, centers: Floats, half_extents: Floats, turning: bool
) -> Motion:
    first = Rotation.random(len(half_extents), random_state=rng)
    turn = Rotation.from_rotvec(rng.uniform(-1.0, 1.0, (len(half_extents), 3)))
    last = turn * first if turning else first
    return (
        Boxes(centers[0], first.as_matrix(), half_extents),
        Boxes(centers[1], last.as_matrix(), half_extents),
    )


SCENES: dict[str, Callable[[np.random.Generator, int, bool], Motion]] = {
    "boxes in a room": ordinary,
    "bullets at a thin wall": bullets,
}


def processor_seconds(run: Callable[[], object]) -> float:
    """Return the time of the processor that a call takes, of all threads."""
    start = process_time()
    run()
    return process_time() - start


def compare(scene: str, pairs: int, turning: bool) -> dict[str, float]:
    """Return microseconds per pair of both sides, their ratio, and what python-fcl misses."""
    start, end = SCENES[scene](np.random.default_rng(0), pairs, turning)
    rows = np.arange(2 * pairs).reshape(-1, 2)
    fcl_sweep = _fcl(start, end, rows, turning)

    def ours() -> Sweeps:
        moving = MovingBoxes(start, end)
        return sweeps(moving, moving, rows, contacts=False)  # python-fcl gives a time, no point

    result, theirs = ours(), fcl_sweep()
    turns = [(processor_seconds(ours), processor_seconds(fcl_sweep)) for _ in range(TURNS)]
    times = np.array(turns).min(axis=0)
    certain = certain_overlaps(start, end, rows, result.times)
    return {
        "ours_us": 1e6 * times[0] / pairs,
        "fcl_us": 1e6 * times[1] / pairs,
        "ratio": times[1] / times[0],
        "hits": float(result.hits.mean()),
        "certain": int(certain.sum()),
        "fcl_misses": int((certain & ~theirs).sum()),
        "fcl_false": int((theirs & ~result.hits).sum()),
    }


def certain_overlaps(
    start: Boxes, end: Boxes, rows: NDArray[np.int64], times: Floats
) -> NDArray[np.bool_]:
    """Return (m,) whether each pair certainly overlaps soon after its time of contact."""
    found = np.zeros(len(rows), np.bool_)
    hits = np.flatnonzero(np.isfinite(times))
    for later in AFTER:
        at = np.minimum(times[hits] + later, 1.0)
        sides = [_poses_at(start, end, rows[hits, side], at) for side in (0, 1)]
        found[hits] |= verdicts(sides[0], sides[1]) == Verdict.OVERLAP
    return found


def _poses_at(start: Boxes, end: Boxes, rows: NDArray[np.int64], times: Floats) -> Boxes:
    first = Rotation.from_matrix(start.rotations[rows])
    turn = (Rotation.from_matrix(end.rotations[rows]) * first.inv()).as_rotvec()
    rotations = (Rotation.from_rotvec(turn * times[:, None]) * first).as_matrix()
    way = end.centers[rows] - start.centers[rows]
    return Boxes(start.centers[rows] + times[:, None] * way, rotations, start.half_extents[rows])


def _fcl(
    start: Boxes, end: Boxes, rows: NDArray[np.int64], turning: bool
) -> Callable[[], NDArray[np.bool_]]:
    fcl: Any = importlib.import_module("fcl")
    places = [
        [fcl.Transform(r, c) for r, c in zip(b.rotations, b.centers, strict=True)]
        for b in (start, end)
    ]
    objects = [
        fcl.CollisionObject(fcl.Box(*(2.0 * half)), place)
        for half, place in zip(start.half_extents, places[0], strict=True)
    ]
    # CCDM_TRANS keeps the rotation of the start, CCDM_LINEAR turns at constant speed
    kind = fcl.CCDMotionType.CCDM_LINEAR if turning else fcl.CCDMotionType.CCDM_TRANS
    request = fcl.ContinuousCollisionRequest(ccd_motion_type=kind)

    def run() -> NDArray[np.bool_]:
        hits = np.empty(len(rows), np.bool_)
        for n, (i, j) in enumerate(rows.tolist()):
            result = fcl.ContinuousCollisionResult()
            fcl.continuousCollide(
                objects[i], places[1][i], objects[j], places[1][j], request, result
            )
            hits[n] = result.is_collide
        return hits

    return run


@interruptible("python -m tools.peers.sweeps")
def main(arguments: list[str] | None = None) -> None:
    """Print the table."""
    parser = Parser(description="moving boxes beside python-fcl")
    option(parser, "--pairs", whole(1, 10**8), 20_000, "pairs of each row")
    options = parser.parse_args(arguments)
    lines = [["motion", "hits", "ours µs", "fcl µs", "ratio", "fcl misses", "fcl false"]]
    for turning in (False, True):
        for scene in SCENES:
            name = f"{scene}, {'turning' if turning else 'straight'}"
            row = compare(scene, options.pairs, turning)
            missed = f"{row['fcl_misses']:.0f} of {row['certain']:.0f}"
            times = [f"{row[key]:.2f}" for key in ("ours_us", "fcl_us", "ratio")]
            lines.append([name, f"{row['hits']:.0%}", *times, missed, f"{row['fcl_false']:.0f}"])
    print(as_text(lines))


if __name__ == "__main__":
    raise SystemExit(main())
