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


"""Zones about a moving base, and the command that is safe in them."""

from obb_collision.zones.bodies import MOST_CORNERS, box_outlines, distances_at, meeting_times
from obb_collision.zones.gate import Cloud, Surroundings, decide
from obb_collision.zones.outlines import (
    Outline,
    Twist,
    count_inside,
    first_visit,
    seen_at,
    time_of_many,
)
from obb_collision.zones.zones import Part, Settings, Zone, circle, polygon_from_text

__all__ = [
    "MOST_CORNERS",
    "Cloud",
    "Outline",
    "Part",
    "Settings",
    "Surroundings",
    "Twist",
    "Zone",
    "box_outlines",
    "circle",
    "count_inside",
    "decide",
    "distances_at",
    "first_visit",
    "meeting_times",
    "polygon_from_text",
    "seen_at",
    "time_of_many",
]
