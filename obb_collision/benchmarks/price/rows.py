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

"""Results of a level or peer on a corpus, and of the corpus as a whole."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from obb_collision.typing import Mask


@dataclass
class Row:
    """A level or peer: what it costs and how often it is wrong; None if not measured."""

    name: str
    peer: bool
    pair_ns: float = 0.0
    step_ms: float | None = None
    bytes: float | None = None
    prepare_ms: float | None = None
    pairs: int = 0  #: candidates decided
    reports: int = 0
    false: int = 0  #: reports of bodies whose triangles do not collide
    missed: int = 0  #: bodies whose triangles collide, not reported

    def count(self, answers: Mask, truth: Mask) -> None:
        """Add the results for pairs."""
        self.pairs += len(truth)
        self.reports += int(answers.sum())
        self.false += int((answers & ~truth).sum())
        self.missed += int((truth & ~answers).sum())

    @property
    def false_of_reports(self) -> float:
        """Share of the reports that are false."""
        return self.false / max(1, self.reports)

    @property
    def false_of_pairs(self) -> float:
        """Share of the candidates that are falsely reported."""
        return self.false / max(1, self.pairs)

    def as_dict(self) -> dict[str, Any]:
        """Return all numbers, the shares included."""
        shares = {name: getattr(self, name) for name in ("false_of_reports", "false_of_pairs")}
        return asdict(self) | shares


@dataclass
class Price:
    """The rows of a corpus and what compares two of them."""

    corpus: str
    note: str
    shapes: int
    bodies: int
    pairs: int = 0
    colliding: int = 0
    rows: list[Row] = field(default_factory=list)
    out_of_order: int = 0  #: pairs that a more exact level reports and a coarser one doesn't
    ratios: dict[str, float] = field(default_factory=dict)  #: peer's time over that of our level
    surface_pairs: int = 0  #: pairs compared between python-fcl's triangles and ours as surfaces
    surface_differ: int = 0
    missing: list[str] = field(default_factory=list)  #: peers that are not installed

    @property
    def missed(self) -> int:
        """Pairs that a level of ours must report and does not: none, or there is a defect."""
        return self.out_of_order + sum(row.missed for row in self.rows if not row.peer)

    def row(self, name: str) -> Row:
        """Return the row of a name."""
        return next(row for row in self.rows if row.name == name)
