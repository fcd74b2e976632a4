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

"""What goes wrong in the middle of a step, or is rare in it, leaves no scene with wrong boxes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from each import each
from scenes import random_poses

import obb_collision as oc
from obb_collision.scene import checker
from obb_collision.scene.store import placed, store
from obb_collision.shapes import Box


def interrupt(*_: Any, **__: Any) -> None:
    raise KeyboardInterrupt


def test_a_check_that_is_interrupted_loses_no_pair_later(monkeypatch: pytest.MonkeyPatch) -> None:
    poses = random_poses(200, np.random.default_rng(0), 2.0)
    scene = oc.Scene()
    scene.add_boxes([f"box/{k}" for k in range(200)], np.full((200, 3), 0.7), poses)
    pairs = scene.check().pairs
    assert len(pairs) > 100
    for k in range(200):  # so many that bounds are made anew
        scene.add(f"far/{k}", Box([0.1, 0.1, 0.1]), [100.0 + k, 0, 0, 0, 0, 0, 1])

    monkeypatch.setattr(checker, "run", interrupt)
    with pytest.raises(KeyboardInterrupt):
        scene.check()
    monkeypatch.undo()
    scene.check()
    for k in range(200):
        scene.move_indices([k], poses[[k]] + [1e-12, 0, 0, 0, 0, 0, 0])
        assert scene.check().pairs.tolist() == pairs.tolist(), k


def test_the_last_pose_of_an_object_counts_whatever_its_quaternion() -> None:
    # of unit length, but its rotation is not orthonormal to rounding
    loose = [0.8566620481794672, 0.0032782832822633614, 0.5158672540068304, 0.0006035819197282833]
    poses = np.array([[5.0, 0, 0, *loose], [1.0, 0, 0, 0, 0, 0, 1]])
    scene = oc.Scene()
    scene.add("box", Box([1, 1, 1]))
    scene.move_indices([0, 0], poses)
    assert (scene.boxes.centers[0] == scene.objects.poses_of([0])[0, :3]).all()
    scene.move_indices([0, 0], poses[::-1])
    assert (scene.boxes.centers[0] == [5, 0, 0]).all()


@each("quaternion", [(0, 0, 0, 1), (0, 0, 0, 2)])
@pytest.mark.filterwarnings("ignore:poses .quaternion. far from unit length")
def test_a_move_that_is_interrupted_can_be_made_again(
    monkeypatch: pytest.MonkeyPatch, quaternion: tuple[float, ...]
) -> None:
    scene = oc.Scene()
    scene.add_boxes(["a", "b"], np.ones((2, 3)), [[0, 0, 0, 0, 0, 0, 1], [5, 0, 0, 0, 0, 0, 1]])
    assert len(scene.check()) == 0
    for name in ("run", "place_boxes"):
        monkeypatch.setattr(placed, name, interrupt)
    with pytest.raises(KeyboardInterrupt):
        scene.move("b", [0.5, 0, 0, *quaternion])
    monkeypatch.undo()
    scene.move("b", [0.5, 0, 0, *quaternion])
    assert scene.check().names() == [("a", "b")]


def test_what_is_checked_is_kept_before_it_counts_as_checked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = oc.Scene()
    scene.add_boxes(["a", "b"], np.ones((2, 3)), [[0, 0, 0, 0, 0, 0, 1], [5, 0, 0, 0, 0, 0, 1]])
    scene.check()
    scene.move("b", [0.5, 0, 0, 0, 0, 0, 1])
    settle = store.ObjectStore.settle

    def settle_and_interrupt(one: store.ObjectStore) -> None:
        settle(one)
        raise KeyboardInterrupt

    monkeypatch.setattr(store.ObjectStore, "settle", settle_and_interrupt)
    with pytest.raises(KeyboardInterrupt):
        scene.check()
    monkeypatch.undo()
    assert scene.check().names() == [("a", "b")]
