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

"""The ROS 2 node: topics, parameters and services around a scene.

The public names load when first used, so that a console script can say in a line that ROS is
missing instead of failing on its way in.
"""

from __future__ import annotations

from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from obb_collision.node.messages.clouds import *  # noqa: F403
    from obb_collision.node.messages.conversions import *  # noqa: F403
    from obb_collision.node.messages.names import *  # noqa: F403
    from obb_collision.node.topics.topics import *  # noqa: F403

PUBLIC = {
    "messages.clouds": "boxes_from_ros boxes_to_ros poses_from_ros poses_to_ros",
    "messages.conversions": "namespace_table",
    "messages.names": "namespace_number",
    "topics.topics": "NamedClearance NamedContact NamedEvent NamedPair NamedPoints NamedPrediction "
    "clearances_from_ros collisions_from_ros collisions_to_ros contacts_from_ros events_from_ros "
    "named_clearances named_contacts named_events named_pairs named_passed_collisions "
    "named_points_inside named_predictions points_inside_from_ros predictions_from_ros",
}
"""The public names, by the module that they are in."""


def __getattr__(name: str) -> Any:
    for module, names in PUBLIC.items():
        if name in names.split():
            return resolve_name(f"{__name__}.{module}:{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
