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

"""The topics of the effects, listened to once their kernels are ready."""

from __future__ import annotations

from typing import Any

from rig import Rig
from sensor_msgs.msg import PointCloud2

from obb_collision.node.messages.conversions import stamp_from_ros


def listening(rig: Rig, topic: str) -> None:
    """Subscribe, and wait until the effect is ready and its messages come."""
    rig.listen(topic)
    rig.until(lambda: topic in rig.last, topic)


def answer(rig: Rig, topic: str) -> PointCloud2:
    """Wait for the message of a topic that is about the last state sent."""

    def arrived() -> Any:
        message = rig.last.get(topic)
        return message is not None and stamp_from_ros(message.header.stamp) == rig.stamp

    rig.until(arrived, f"{topic} of the last state")
    return rig.last[topic]
