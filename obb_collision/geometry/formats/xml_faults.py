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

"""Faults of XML that change nothing, and those that do."""

from __future__ import annotations

from typing import Any

#: By the name that lxml has for them: what parsers of ROS do not mind.
HARMLESS = {
    "NS_ERR_UNDEFINED_NAMESPACE": "a prefix is not declared",
    "ERR_UNKNOWN_VERSION": "its version of XML is unknown",
    "WAR_UNKNOWN_VERSION": "its version of XML is unknown",
    "ERR_RESERVED_XML_NAME": "its declaration is not at the start",
}


def first_fault(log: Any) -> Any:
    """Return the first entry of a parser's log that is not harmless, None without one."""
    return next((entry for entry in log if entry.type_name not in HARMLESS), None)
