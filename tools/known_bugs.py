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

"""Asks this library and the installed peers about pairs from bug reports on other libraries."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

import obb_collision as oc
from obb_collision import clearances, verdicts
from obb_collision.boxes import Boxes
from obb_collision.cli import Parser, interruptible, new_file, option
from obb_collision.geometry.trees.obb_tree import MeshTrees
from obb_collision.queries.meshes.placed import PlacedMeshes
from obb_collision.queries.verdict.verdict import SEPARATE
from tools.pages import as_markdown
from tools.peers.pairs import (
    FARTHEST,
    PAIR_PEERS,
    Answer,
    Body,
    PairPeer,
    PlacedBox,
    outward_faces,
)

OURS = "this library"
RIGHT, NOTHING = "right", "\u2013"
INTRODUCTION = """# Known bugs of others

What users reported about other libraries, asked of this one and of the installed peers.
`python -m tools.known_bugs --markdown docs/known_bugs.md` writes this page, and fails if an answer
of this library is wrong. An oracle without shared code has the exact answers.

An answer is wrong if it takes apart for colliding or the reverse, is off by more than 1e-6 m,
contradicts itself, or is an exception. Peers run at their defaults. pybullet and rapier3d answer
for boxes only, without distances.
"""
REMARK = """
In fcl#493 and fcl#495 the exact answer hangs on 4e-17 and 2e-16 m, within the tolerance of all
peers: there a library must not contradict itself. In the other pairs the gross errors are mended.
"""


#: Most that an answer may be off (m).
TOLERANCE = 1e-6
#: Seed of the pairs of convex meshes in place of those of mujoco#3383.
SEED = 7


@dataclass(frozen=True)
class KnownBug:
    """A report and its pairs, or the closest pairs that can be stated exactly.

    report: its sentence; source: where the numbers are from. distances (metres): the exact one of
    each pair, negative for the depth of those that overlap, NaN for any depth; if they are
    ``least``, the exact one is at least that.
    """

    name: str
    url: str
    report: str
    source: str
    pairs: tuple[tuple[Body, Body], ...] = ()
    distances: tuple[float, ...] = ()
    least: bool = False


def read_bugs() -> tuple[KnownBug, ...]:
    """Return the reports of ``known_bugs.json``, in metres.

    Their distances are those of exact arithmetic, rounded once: the tests compute them again with
    an oracle that shares no code with the library. ``hulls``: how many random pairs there are.
    """
    bugs = []
    for bug in json.loads(Path(__file__).with_suffix(".json").read_text("utf-8")):
        hulls = bug.pop("hulls", 0)
        pairs = tuple((_body(a), _body(b)) for a, b in bug.pop("pairs", ()))
        distances = [math.nan if gap is None else gap for gap in bug.pop("distances", ())]
        if hulls:
            pairs, distances = _random_hulls(hulls)
        bugs.append(KnownBug(**bug, pairs=pairs, distances=tuple(distances), least=bool(hulls)))
    return tuple(bugs)


def _body(data: Any) -> Body:
    """Return a box as the library stores it, or corners."""
    if not isinstance(data, dict):
        return np.array(data)
    return PlacedBox(**{name: np.array(value) for name, value in data.items()})


def _random_hulls(count: int) -> tuple[tuple[tuple[Body, Body], ...], list[float]]:
    """Return pairs of convex bodies that planes separate, and by how much at least (m).

    Corners are whole millimetres, and the planes are normal to x, so that both are exact.
    """
    rng = np.random.default_rng(SEED)
    pairs, gaps = [], []
    for _ in range(count):
        a, b = (np.round(rng.uniform(-0.2, 0.2, (16, 3)), 3) for _ in range(2))
        b[:, 0] = np.round(b[:, 0] + rng.uniform(0.45, 0.8), 3)
        a, b = a[ConvexHull(a).vertices], b[ConvexHull(b).vertices]
        pairs.append((a, b))
        gaps.append(float(b[:, 0].min() - a[:, 0].max()))
    return tuple(pairs), gaps


KNOWN_BUGS = read_bugs()


def ours(a: Body, b: Body) -> Answer:
    """Return the answer of this library: exact verdict, and distance or depth."""
    if isinstance(a, PlacedBox) and isinstance(b, PlacedBox):
        box_a, box_b = (Boxes([x.center], [x.rotation], [x.half_extents]) for x in (a, b))
        collides = verdicts(box_a, box_b, exact=True)[0] != SEPARATE
        result = clearances(box_a, box_b, max_distance=FARTHEST)
        return Answer(bool(collides), float(result.distances[0]))
    assert not isinstance(a, PlacedBox)
    assert not isinstance(b, PlacedBox)
    trees = MeshTrees.join([MeshTrees.build(x, outward_faces(x)) for x in (a, b)])
    bodies = PlacedMeshes(trees, [0, 1], np.zeros((2, 3)), [np.eye(3)] * 2)
    verdict = oc.verdicts(bodies, bodies, [[0, 1]], exact=True)[0]
    apart = oc.separations(bodies, bodies, [[0, 1]]).separations[0]
    return Answer(bool(verdict != SEPARATE), float(apart))


def fault(answer: Answer, distance: float, bug: KnownBug) -> str:
    """Return the fault of an answer, empty for none. distance: NaN for any depth."""
    if answer.collides != (not distance > 0.0):
        return "says colliding" if answer.collides else "says apart"
    value = answer.distance
    low, high = distance - TOLERANCE, math.inf if bug.least else distance + TOLERANCE
    if not (math.isnan(value) or math.isnan(distance) or low <= value <= high):
        return f"distance {value:.3g}"
    if value > 0.0 if answer.collides else value < 0.0:
        return f"contradicts itself: {'colliding' if answer.collides else 'apart'}, {value:.1g} m"
    return ""


def judged(bug: KnownBug, peer: PairPeer | None) -> str:
    """Return the verdict on a library in a case, in words; None: this library."""
    faults, asked = [], 0
    for (a, b), distance in zip(bug.pairs, bug.distances, strict=True):
        try:
            answer = ours(a, b) if peer is None else peer.answer(a, b)
            wrong = fault(answer, distance, bug)
        except NotImplementedError:
            continue
        except Exception as error:  # peers raise any exception
            wrong = f"raises {type(error).__name__}"
        asked += 1
        faults.append(wrong)
    wrong_ones = [wrong for wrong in faults if wrong]
    if not asked:
        return NOTHING
    if not wrong_ones:
        return RIGHT
    return wrong_ones[0] if asked == 1 else f"{len(wrong_ones)} of {asked}: {wrong_ones[0]}"


def table(peers: Sequence[PairPeer]) -> list[list[str]]:
    """Return header and lines, as text cells."""
    header = ["report", "exact", OURS, *(f"{peer.name} {peer.version()}" for peer in peers)]
    return [header, *(_line(bug, peers) for bug in KNOWN_BUGS)]


def _line(bug: KnownBug, peers: Sequence[PairPeer]) -> list[str]:
    exact = ", ".join(_exact(distance) for distance in bug.distances)
    if len(bug.distances) > 3:
        exact = f"{len(bug.distances)} pairs apart, by {min(bug.distances):.3g} m or more"
    cells = [judged(bug, peer) for peer in (None, *peers)]
    return [f"[{bug.name}]({bug.url})", exact or NOTHING, *cells]


def _exact(distance: float) -> str:
    if math.isnan(distance):
        return "colliding"
    how = "apart by" if distance > 0.0 else "overlap by"
    return f"{how} {abs(distance):.3g} m"


def page(lines: list[list[str]]) -> str:
    """Return the page: what was reported, the exact answer, ours, and peers that are wrong."""
    (_, _, _, *peers), *answers = lines
    rows = [["report", "what was reported", "exact", OURS, "wrong today"]]
    for bug, (link, exact, ours, *theirs) in zip(KNOWN_BUGS, answers, strict=True):
        wrong = [
            f"{peer} {answer}"
            for peer, answer in zip(peers, theirs, strict=True)
            if answer not in (RIGHT, NOTHING)
        ]
        rows.append([link, bug.report, exact, ours, "; ".join(wrong)])
    asked = f"Peers: {', '.join(peers)}.\n"
    return "\n".join((INTRODUCTION, asked, as_markdown(rows), REMARK))


def _plain(lines: list[list[str]]) -> Iterator[str]:
    for bug, line in zip(KNOWN_BUGS, lines[1:], strict=True):
        yield f"{bug.name} ({bug.url}): {line[1]}"
        yield from (
            f"    {name}: {cell}" for name, cell in zip(lines[0][2:], line[2:], strict=True)
        )


@interruptible("python -m tools.known_bugs")
def main(arguments: Sequence[str] | None = None) -> int:
    """Ask all; exit code 1 if an answer of this library is wrong."""
    summary = (__doc__ or "").splitlines()[0]
    parser = Parser(prog="python -m tools.known_bugs", description=summary)
    option(parser, "--markdown", new_file(".md"), text="write the page, as docs/known_bugs.md")
    options = parser.parse_args(arguments)
    peers = [peer for peer in PAIR_PEERS if peer.version() is not None]
    lines = table(peers)
    print("\n".join(_plain(lines)))
    missing = [peer.name for peer in PAIR_PEERS if peer not in peers]
    if missing:
        print(f"not installed, left out: {', '.join(missing)}")
    if options.markdown:
        options.markdown.write_text(page(lines), encoding="utf-8")
    return int(any(line[2] not in (RIGHT, NOTHING) for line in lines[1:]))


if __name__ == "__main__":
    sys.exit(main())
