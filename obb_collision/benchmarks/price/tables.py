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

"""The tables of the accuracy benchmark, and the sentences that sum them up."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from obb_collision.benchmarks.price.effects import EffectRow
from obb_collision.benchmarks.price.fits import FitRow
from obb_collision.benchmarks.price.floats import FloatRow
from obb_collision.benchmarks.price.rows import Price, Row
from obb_collision.benchmarks.price.upkeep import compact_numbers


def format_result(
    prices: Sequence[Price],
    fits: Sequence[FitRow],
    floats: Sequence[FloatRow],
    effects: Sequence[EffectRow],
) -> str:
    """Return everything as text."""
    parts = [format_price(price) for price in prices]
    parts += [
        format_effects(effects),
        format_fits(fits),
        format_floats(floats),
        "\n".join(format_claims(prices)),
    ]
    return "\n\n".join(part for part in parts if part)


def format_price(price: Price) -> str:
    """Return the table of a corpus."""
    if price.shapes == 0:
        return f"{price.corpus}: none ({price.note})"
    note = f" ({price.note})" if price.note else ""
    head = (
        f"{price.corpus}: {price.shapes} shapes{note}, {price.pairs} pairs whose AABBs overlap, "
        f"{price.colliding} collide; a step moves {price.bodies}"
    )
    lines = [
        head,
        f"{'':16}{'a pair, ns':>11}{'x obb':>7}{'a step, ms':>12}{'memory, bytes':>15}"
        f"{'once, ms':>10}{'false: of reports':>19}{'of pairs':>10}{'missed':>8}",
    ]
    base = price.row("obb").pair_ns
    lines += [_line(row, base) for row in price.rows]
    if price.missing:
        lines.append(f"not installed, so not compared: {', '.join(price.missing)}")
    return "\n".join(lines)


def _line(row: Row, base: float) -> str:
    return (
        f"{row.name:16}{row.pair_ns:11,.0f}{row.pair_ns / base:7.1f}"
        f"{_or_dash(row.step_ms, '12.2f')}{_or_dash(row.bytes, '15,.0f')}"
        f"{_or_dash(row.prepare_ms, '10.1f')}{100.0 * row.false_of_reports:18.1f}%"
        f"{100.0 * row.false_of_pairs:9.1f}%{row.missed:8}"
    )


def _or_dash(value: float | None, form: str) -> str:
    width = int(form.split(".")[0].rstrip(","))
    return f"{'-':>{width}}" if value is None else f"{value:{form}}"


def format_effects(rows: Sequence[EffectRow]) -> str:
    """Return the table of the effects on each level."""
    if not rows:
        return ""
    lines = [
        "Effects: errors in mm, to the finest level; shapes measure 1 m across; of times the way",
        f"{'':28}{'pairs':>7}{'a pair, ns':>12}{'mean':>10}{'worst':>10}{'unsafe':>8}"
        f"{'peer to ours, mm':>18}",
    ]
    for row in rows:
        differ = "" if row.differ is None else f"{1e3 * row.differ:18.3g}"
        unsafe = "" if row.peer else str(row.unsafe)
        lines.append(
            f"{row.effect + ' ' + row.name:28}{row.pairs:7}{row.pair_ns:12,.0f}"
            f"{1e3 * row.mean_error:10.3g}{1e3 * row.worst_error:10.3g}{unsafe:>8}{differ}"
        )
    return "\n".join(lines)


def format_fits(rows: Sequence[FitRow]) -> str:
    """Return the table of the fits."""
    if not rows:
        return ""
    lines = [
        f"Fits of a box to {rows[0].meshes} meshes: volume over that of the best box",
        f"{'':16}{'mean':>8}{'worst':>8}{'ms':>8}",
    ]
    for row in rows:
        lines.append(f"{row.fit:16}{row.mean_volume:8.3f}{row.worst_volume:8.2f}{row.mean_ms:8.1f}")
    return "\n".join(lines)


def format_floats(rows: Sequence[FloatRow]) -> str:
    """Return the table of the kernels."""
    lines = [
        "The 15-axis test of two boxes, wrong verdicts by exact arithmetic",
        f"{'':20}{'':12}{'pairs':>8}{'a pair, ns':>12}{'false':>8}{'missed':>8}{'undecided':>11}",
    ]
    for row in rows:
        lines.append(
            f"{row.kernel:20}{row.pairs_of:12}{row.pairs:8}{row.pair_ns:12.1f}{row.false:8}"
            f"{row.missed:8}{row.undecided:11}"
        )
    return "\n".join(lines)


def claims(prices: Sequence[Price]) -> dict[str, Any]:
    """Return what the run shows about the promises of the levels, as numbers."""
    meshes = [price for price in prices if price.surface_pairs or price.corpus != "boxes"]
    found: dict[str, Any] = {
        "meshes": sum(price.shapes for price in meshes),
        "pairs": sum(price.pairs for price in meshes),
        "missed": sum(price.missed for price in prices),
        "surface_pairs": sum(price.surface_pairs for price in meshes),
        "surface_differ": sum(price.surface_differ for price in meshes),
        "ratios": {price.corpus: price.ratios for price in prices},
    }
    return found


def format_claims(prices: Sequence[Price]) -> list[str]:
    """Return the same as sentences."""
    found = claims(prices)
    lines = [
        f"No level may miss what a more exact one reports: {found['missed']} missed on "
        f"{found['meshes']} meshes and {found['pairs']:,} pairs of them."
    ]
    if found["surface_pairs"]:
        lines.append(
            f"Surfaces against python-fcl's triangles: {found['surface_differ']} of "
            f"{found['surface_pairs']:,} pairs differ. (It has no solids: what lies wholly inside "
            "another it misses.)"
        )
    names = {"box": "obb", "hull": "hull", "mesh": "mesh"}
    for corpus, ratios in found["ratios"].items():
        for label, ratio in ratios.items():
            level = names[label.split()[-1]]
            lines.append(f"{corpus}: {label} takes {ratio:.1f} times as long per pair as {level}.")
    lines.append(
        "Called from Python, the peers with one pair per call, the levels with all pairs in one. "
        f"Ratios are medians of turns; times are this machine's. Memory: a sphere has 4 numbers "
        f"of 8 bytes, an AABB 6, a box 15 ({compact_numbers()} if an axis is left to compute); "
        "trees and meshes are stored once per shape."
    )
    return lines
