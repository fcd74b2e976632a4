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

"""The region of a node: its parameters, whether its halo is large enough, and splits of a box."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from obb_collision.scene.effects import EFFECTS
from obb_collision.scene.effects.settings import OFF
from obb_collision.scene.store.region import Region, split_regions
from obb_collision.words import shown

AXES = "xyz"
RANGE = re.compile(r"\s*([xyz])\s*:\s*(\S+)\s+to\s+(\S+)\s*")
"""An entry of the parameter ``region``."""
INPUTS = (
    "objects",
    "object_transform",
    "object_states",
    "object_poses",
    "object_boxes",
    "detections",
    "points",
)
"""Topics that the nodes of all regions read."""
Range = tuple[str, float, float]


def option_name(effect: str, option: str) -> str:
    """Return the parameter of an option; ``effects.sweep`` can't be a value and hold more."""
    return f"effects.{effect}_{option}"


def range_from_text(text: str) -> Range:
    """Return the axis and the ends (m) of an entry such as ``x: -inf to 5.0``."""
    found = RANGE.fullmatch(text)
    try:
        axis, low, high = found[1], float(found[2]), float(found[3])  # type: ignore[index]
    except (TypeError, ValueError):
        raise ValueError(f"{shown(text)} is not like 'x: -inf to 5.0'") from None
    if not low < high or low == math.inf or high == -math.inf:
        raise ValueError(f"{shown(text)}: the first number must be below the second")
    return axis, low, high


def text_from_region(region: Region) -> list[str]:
    """Return the entries of the parameter ``region``; [''] for everything."""
    ends = zip(AXES, region.minimum.tolist(), region.maximum.tolist(), strict=True)
    return [
        f"{axis}: {low!r} to {high!r}"
        for axis, low, high in ends
        if math.isfinite(low) or math.isfinite(high)
    ] or [""]


def region_from(values: Mapping[str, Any]) -> Region | None:
    """Return the region that parameters mean, None for everything.

    Raises ValueError for an axis given twice, and a halo that is smaller than what an effect that
    is not off looks beyond objects.
    """
    ranges: list[Range] = values["region"]
    if not ranges:
        return None
    low, high = np.full(3, -np.inf), np.full(3, np.inf)
    if len({axis for axis, _, _ in ranges}) < len(ranges):
        raise ValueError("region must have at most one entry for each of x, y and z")
    for axis, least, most in ranges:
        low[AXES.index(axis)], high[AXES.index(axis)] = least, most
    halo = values["region_halo"]
    for name, effect in EFFECTS.items():
        for key, option in effect.options.items():
            far = values[option_name(name, key)]
            if option.reaches and values[f"effects.{name}"] != OFF and far > halo:
                raise ValueError(
                    f"region_halo must be at least {option_name(name, key)}, {far:g} m, as far as "
                    f"the effect looks beyond objects, got {halo:g}"
                )
    return Region(low, high, halo)


def region_parameters(
    minimum: str, maximum: str, parts: str, halo: str
) -> dict[str, dict[str, Any]]:
    """Return the parameters of the nodes that share a box split into parts, by namespace.

    All as words, with spaces between numbers. Raises ValueError for what is none.
    """
    low, high = ([float(word) for word in text.split()] for text in (minimum, maximum))
    regions = split_regions(low, high, [int(word) for word in parts.split()], float(halo))
    return {
        f"region_{number}": {"region": text_from_region(region), "region_halo": region.halo}
        for number, region in enumerate(regions)
    }


def shared_inputs(namespace: str) -> list[tuple[str, str]]:
    """Return the remappings by which a node in a namespace of its own reads what all read."""
    root = "/" + namespace + ("/" if namespace else "")
    return [(topic, root + topic) for topic in INPUTS]
