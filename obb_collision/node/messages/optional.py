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

"""Packages of ROS that need not be there: what one of them offers is None where it cannot be used.

None of them is on PyPI; on a robot they come by apt. One that is installed and broken, or of which
the type support is missing, is no reason to end.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from rclpy.type_support import check_for_type_support

unusable: dict[str, str] = {}
"""Why a package that is installed cannot be used, by its name."""


def optional(module: str, name: str = "") -> Any:
    """Return a module, or its type of messages or services; None where it cannot be used."""
    package = module.partition(".")[0]
    try:
        offered = import_module(module)
        if name:
            offered = getattr(offered, name)
            check_for_type_support(offered)
    except Exception as error:  # whatever a broken package raises
        if not (isinstance(error, ModuleNotFoundError) and error.name == package):
            unusable[package] = f"{type(error).__name__}: {error}"
        return None
    return offered
