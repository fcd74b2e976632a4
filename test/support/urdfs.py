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

"""Robots as URDF text, for tests."""

from __future__ import annotations

LIMIT = '<limit lower="-1" upper="2" velocity="3" effort="1"/>'


def urdf(*elements: str) -> str:
    """Return a robot of some elements, each on a line of its own: the first one on line 2."""
    return '<robot name="r">\n' + "\n".join(elements) + "\n</robot>"


def link(name: str, *geometries: str) -> str:
    """Return a link with collision geometries."""
    inner = "".join(f"<collision><geometry>{one}</geometry></collision>" for one in geometries)
    return f'<link name="{name}">{inner}</link>'


def joint(name: str, kind: str, parent: str, child: str, inner: str = LIMIT) -> str:
    """Return a joint."""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f"{inner}</joint>"
    )
