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

"""Parts of rclpy that it does not document, and a node without any."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy")
from rig import NAMESPACE, Rig, cube

from obb_collision.node.runtime import inner


def test_a_node_that_ends_leaves_no_service() -> None:
    with Rig() as rig:
        rig.node.destroy_node()
        own = f"{NAMESPACE}/obb_collision/"
        rclpys = f"{own}get_type_description"  # it stays as long as the object of the node does

        def left() -> set[str]:
            names = {name for name, _ in rig.client.get_service_names_and_types()}
            return {name for name in names if name.startswith(own)}

        rig.until(lambda: left() <= {rclpys}, "no service")
        assert not [*rig.node.services]


def test_a_node_works_where_rclpy_has_none_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inner, "getattr", lambda _, name, default: default, raising=False)
    with Rig() as rig:
        rig.send(cube(("a", 1)), cube(("a", 2), (0.5, 0, 0)))
        assert rig.pairs() == {("a/1", "a/2")}
        assert all(result.successful for result in rig.set(padding=0.01))
        inner.release(rig.executor)
    assert not [*rig.node.services]
