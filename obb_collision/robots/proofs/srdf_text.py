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

"""SRDF as text: the pairs of links that need not be checked, with what is known of the others."""

from __future__ import annotations

from collections.abc import Sequence
from xml.sax.saxutils import quoteattr

from obb_collision.robots.description.robot import Robot
from obb_collision.robots.description.xml_values import parse
from obb_collision.robots.proofs.proved_pairs import (
    ADJACENT,
    ALWAYS,
    CAN_COLLIDE,
    NEVER,
    UNDECIDED,
    PairProof,
)

#: The reasons that MoveIt's setup writes, of pairs that are not checked.
REASONS = {ADJACENT: "Adjacent", NEVER: "Never", ALWAYS: "Always"}


def srdf_text(robot: Robot, proofs: Sequence[PairProof], srdf: bytes | None = None) -> str:
    """Return an SRDF that has no pairs checked that are adjacent, or never or always collide.

    srdf: another one, whose disabled pairs are replaced, and of which all else stays.
    """
    lines = [
        f"  <disable_collisions link1={quoteattr(a)} link2={quoteattr(b)} "
        f'reason="{REASONS[proof.verdict]}"/>'
        for proof in proofs
        for a, b in (proof.links,)
        if proof.verdict in REASONS
    ]
    if srdf is None:
        start = f'<?xml version="1.0"?>\n<robot name={quoteattr(robot.name)}>'
        return "\n".join([start, *lines, "</robot>", ""])
    return _merged(srdf, lines)


def _merged(srdf: bytes, lines: list[str]) -> str:
    from lxml import etree

    root = parse(srdf, "srdf").node
    for element in root.findall("disable_collisions"):
        root.remove(element)
    if len(root):
        root[-1].tail = "\n  "
    else:
        root.text = "\n  "
    for line in lines:
        element = etree.fromstring(line.strip())
        element.tail = "\n  "
        root.append(element)
    if len(root):
        root[-1].tail = "\n"
    text: str = etree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0"?>\n{text}\n'


def report(robot: Robot, proofs: Sequence[PairProof]) -> str:
    """Return what is proved of each pair, a line each, and how many there are of each kind."""
    lines = [f"{a} - {b}: {_said(robot, proof)}" for proof in proofs for a, b in (proof.links,)]
    kinds = (ADJACENT, NEVER, ALWAYS, CAN_COLLIDE, UNDECIDED)
    counts = {kind: sum(proof.verdict == kind for proof in proofs) for kind in kinds}
    parts = [f"{count} {kind}" for kind, count in counts.items() if count]
    total = (
        f"{len(proofs)} pairs: {', '.join(parts)}" if proofs else "no pairs of links with shapes"
    )
    return "\n".join([*lines, total])


def _said(robot: Robot, proof: PairProof) -> str:
    if proof.witness is None:
        return f"{proof.verdict} ({proof.cells} cells)" if proof.cells else proof.verdict
    values = zip(robot.joint_names, proof.witness.tolist(), strict=True)
    return f"{proof.verdict}, as at " + ", ".join(f"{name} {value:.4g}" for name, value in values)
