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


"""Goals: what is wanted beside what was measured, and their tables."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from obb_collision.benchmarks.step.tables import digits

#: Ways to send objects to the node, how many, milliseconds: the median, and what 99 % are below.
NODE = (
    ("object_poses", 1_000, 1.0, 3.0),
    ("object_poses", 10_000, 8.0, None),
    ("objects, other ids by DELETEALL", 500, 40.0, None),
    ("objects, other ids by differences", 500, 40.0, None),
    ("objects, other ids by lifetime", 500, 40.0, None),
    ("object_boxes, other ids", 500, 3.0, None),
)


@dataclass(frozen=True)
class Goal:
    """One figure: what, beside whom, what is wanted and what was measured; None: not measured."""

    what: str
    beside: str
    wanted: str
    measured: str
    met: bool | None


def ratio(what: str, beside: str, wanted: float, ours: float, theirs: float, unit: str) -> Goal:
    """Return how many times as fast ours is; times in the unit."""
    times = theirs / ours
    text = f"{digits(times)} times: {digits(ours)} and {digits(theirs)} {unit}"
    return Goal(what, beside, f"{wanted:g} times", text, bool(times >= wanted))


def below(what: str, wanted: float, measured: float, unit: str) -> Goal:
    """Return whether a time is below what is wanted."""
    text = f"{digits(measured)} {unit}"
    return Goal(what, "", f"below {wanted:g} {unit}", text, bool(measured < wanted))


def missing(what: str, beside: str, why: str) -> Goal:
    """Return a goal that could not be measured."""
    return Goal(what, beside, "", f"not measured: {why}", None)


def node_goals(rows: Sequence[dict[str, Any]]) -> Iterator[Goal]:
    """Return what the node reaches, from a row per way of sending objects."""
    found = {(row["way"], row["objects"]): row for row in rows}
    for way, objects, most, most_99 in NODE:
        row, late = found[way, objects], f", 99 % below {most_99:g} ms" if most_99 else ""
        what, wanted = f"node, {objects:,} by {way}", f"median below {most:g} ms{late}"
        if "median" not in row:
            yield Goal(what, "", wanted, "a frame has no answer", False)
            continue
        text = f"median {row['median']:.2f} ms, 99 % {row['99 %']:.2f} ms"
        met = row["median"] < most and (most_99 is None or row["99 %"] < most_99)
        yield Goal(what, "", wanted, text, met)


def node_table(rows: Sequence[dict[str, Any]]) -> list[list[str]]:
    """Return the rows of the node as a table, in milliseconds."""
    columns = ("median", "95 %", "99 %", "longest")
    lines = [["by", "objects", *columns]]
    for row in rows:
        times = [digits(row[key]) if key in row else "no answer" for key in columns]
        lines.append([row["way"], f"{row['objects']:,}", *times])
    return lines


def goal_table(goals: Sequence[Goal]) -> list[list[str]]:
    """Return the goals as a table."""
    words = {True: "met", False: "not met", None: "?"}
    lines = [["", "beside", "wanted", "measured", ""]]
    return lines + [[g.what, g.beside, g.wanted, g.measured, words[g.met]] for g in goals]
