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

"""Where memory ends as the tables grow, objects are there whole, or not at all."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
from each import each
from objects_rig import ObjectsRig

from obb_collision.node.messages.conversions import name_from_key
from obb_collision.node.objects.table import COLUMNS, FIRST_ROWS
from obb_collision.shapes import Box


@each("failing", range(0, len(COLUMNS), 2))
def test_an_object_without_room_in_the_tables_leaves_no_trace(
    failing: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    keys = [("box", k) for k in range(FIRST_ROWS + 1)]
    rig = ObjectsRig(*keys[:-1])
    calls, made = 0, np.zeros_like

    def zeros_like(*given: Any, **options: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls > failing:
            raise MemoryError
        return made(*given, **options)

    objects = rig.objects
    monkeypatch.setattr(np, "zeros_like", zeros_like)
    with pytest.raises(MemoryError):
        objects.shapes.put(keys[-1], Box([1.0, 1.0, 1.0]))
    monkeypatch.undo()
    assert len({len(getattr(objects.table, column)) for column in COLUMNS}) == 1
    for known in (keys[:-1], keys):
        objects.update(rig.now)
        assert objects.scene.names == [name_from_key(key) for key in known]
        assert objects.table.keys(objects.scene.indices) == known
        objects.shapes.put(keys[-1], Box([1.0, 1.0, 1.0]))
