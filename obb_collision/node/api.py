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

"""All public names of the node; ``obb_collision.node`` loads them from here when first used."""

from obb_collision.node.messages.clouds import (
    boxes_from_ros,
    boxes_to_ros,
    poses_from_ros,
    poses_to_ros,
)
from obb_collision.node.messages.conversions import namespace_table
from obb_collision.node.messages.names import namespace_number
from obb_collision.node.topics.topics import (
    NamedClearance,
    NamedContact,
    NamedEvent,
    NamedPair,
    NamedPoints,
    NamedPrediction,
    clearances_from_ros,
    collisions_from_ros,
    collisions_to_ros,
    contacts_from_ros,
    events_from_ros,
    named_clearances,
    named_contacts,
    named_events,
    named_pairs,
    named_passed_collisions,
    named_points_inside,
    named_predictions,
    points_inside_from_ros,
    predictions_from_ros,
)

__all__ = [
    "NamedClearance",
    "NamedContact",
    "NamedEvent",
    "NamedPair",
    "NamedPoints",
    "NamedPrediction",
    "boxes_from_ros",
    "boxes_to_ros",
    "clearances_from_ros",
    "collisions_from_ros",
    "collisions_to_ros",
    "contacts_from_ros",
    "events_from_ros",
    "named_clearances",
    "named_contacts",
    "named_events",
    "named_pairs",
    "named_passed_collisions",
    "named_points_inside",
    "named_predictions",
    "namespace_number",
    "namespace_table",
    "points_inside_from_ros",
    "poses_from_ros",
    "poses_to_ros",
    "predictions_from_ros",
]
