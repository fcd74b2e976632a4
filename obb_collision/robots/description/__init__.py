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

"""Descriptions of robots: URDF and SRDF, joints, links and their shapes."""

from obb_collision.robots.description.joints import driven
from obb_collision.robots.description.urdf import MOST_GEOMETRIES, description_text
from obb_collision.robots.description.xml_values import RobotError

__all__ = ["MOST_GEOMETRIES", "RobotError", "description_text", "driven"]
