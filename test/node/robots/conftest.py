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

"""One node with a robot for all tests of a file that need nothing special of it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest


@pytest.fixture(scope="module")
def shared() -> Iterator[None]:
    """End the shared rig with the file."""
    yield
    from rig import end_shared

    end_shared()


@pytest.fixture
def arm(shared: None) -> Any:
    """Return a ``AskingRig`` whose robot has been started, as good as new."""
    from rig import SHARED
    from robot_rig import AskingRig

    if not SHARED:
        rig = AskingRig()
        rig.start_robot()
        SHARED.append(rig)
    SHARED[0].renew()
    return SHARED[0]
