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


"""The still picture: states and zones in colours of their own, texts apart from objects."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from each import each

import obb_collision as oc

pytest.importorskip("matplotlib")
from obb_collision.demo.listener import NO_PAIRS, Cycle, MarkerBoxes, Pairs
from obb_collision.demo.picture import draw_picture, save_picture
from obb_collision.demo.snapshot import (
    DOUBTFUL,
    EDGE_COLORS,
    FREE,
    OVERLAPPING,
    ROBOT,
    TOUCHING,
    DrawnScene,
    Label,
    take_snapshot,
)
from obb_collision.demo.status import Status
from obb_collision.node import NamedPair

NONE: Any = np.empty((0, 3))
ZONE = (0.1, 0.2, 0.9)


def make_snapshot(count: int, notes: int = 0, **changes: Any) -> DrawnScene:
    """Return a snapshot of boxes in rows."""
    random = np.random.default_rng(3)
    poses = np.tile([0.0, 0, 0, 0, 0, 0, 1], (count, 1))
    poses[:, 0], poses[:, 1] = np.arange(count) % 20, np.arange(count) // 20
    boxes = oc.Boxes.from_poses(poses, random.uniform(0.1, 0.4, (count, 3)))
    labels = [
        Label(boxes.centers[k % count], f"12 mm deep: box/{k} - a long name/{k}", ZONE, 1.0)
        for k in range(notes)
    ]
    fields: dict[str, Any] = {"names": [f"box/{k}" for k in range(count)], "boxes": boxes}
    fields |= {"states": np.full(count, FREE), "shapes": {}, "zones": {}, "notes": labels}
    fields |= {"near": np.empty((0, 2, 3)), "inside": np.empty(0, np.bool_)}
    fields |= dict.fromkeys(("contacts", "predicted", "cloud"), NONE)
    return DrawnScene(**(fields | changes))


def count_pixels(snapshot: DrawnScene, color: tuple[float, float, float]) -> int:
    figure: Any = draw_picture(snapshot, "", "")
    figure.legends.clear()
    figure.canvas.draw()
    pixels = np.asarray(figure.canvas.buffer_rgba())[..., :3].astype(int)
    return int((np.abs(pixels - 255.0 * np.array(color)) < 3.0).all(axis=2).sum())


@each("states", [(FREE, TOUCHING, DOUBTFUL), (ROBOT, OVERLAPPING)])
def test_edges_wear_the_colours_of_their_states(states: tuple[int, ...]) -> None:
    snapshot = make_snapshot(6, states=np.resize(states, 6))
    found = [count_pixels(snapshot, color) for color in EDGE_COLORS]
    assert {state for state, count in enumerate(found) if count > 150} == {*states}
    assert {state for state, count in enumerate(found) if count} == {*states}


def test_a_snapshot_has_states_pairs_and_the_boxes_that_decided_one() -> None:
    names = ["arm/hand/0", "arm/elbow/0", "box/0", "drum/0", "old/0"]
    poses = np.tile([0.0, 0, 0, 0, 0, 0, 1], (5, 1))
    poses[:, 0] = np.arange(5)
    doubtful = np.array([False, False, False, False, True])
    touching_pair = NamedPair("box/0", "drum/0", 0.0, True)
    deep_pair = NamedPair("arm/hand/0", "box/0", 0.004, False)
    colliding = np.array([True, False, True, True, False])
    boxes = MarkerBoxes(names, poses, np.ones((5, 3)), colliding, doubtful, [], "map", 1)
    places = np.array([[2.5, 0, 0], [np.nan] * 3])
    pairs = Pairs([touching_pair, deep_pair], places, frozenset({"box/0", "drum/0"}))
    cycle = Cycle(boxes, pairs, {}, {"arm"}, NONE, Status(), 0.0)
    shapes = {"drum/0": oc.shapes.Cylinder(0.5, 1.0)}
    snapshot = take_snapshot(cycle, shapes, {})
    assert snapshot.states.tolist() == [OVERLAPPING, ROBOT, OVERLAPPING, TOUCHING, DOUBTFUL]
    deep, touching = snapshot.notes
    assert deep.text.startswith("4 mm deep: arm/hand/0")
    assert deep.place.tolist() == [1.0, 0.0, 0.0]  # between the centres: not computed
    assert touching.text.startswith("≈ touching: box/0")
    assert snapshot.small() == [0]
    wires = [body.name for body in snapshot.wires()]
    assert sorted(wires) == sorted([*names, "box/0", "drum/0"])
    assert [text for text, *_ in snapshot.unknown().legend()] == ["5 unknown"]
    alone = take_snapshot(cycle._replace(pairs=NO_PAIRS), shapes, {})  # collisions may be off
    assert alone.states.tolist() == [OVERLAPPING, ROBOT, OVERLAPPING, OVERLAPPING, DOUBTFUL]


def test_zones_wear_colours_of_their_own() -> None:
    snapshot = make_snapshot(6, zones={"box/2": ZONE}, states=np.full(6, OVERLAPPING))
    assert count_pixels(snapshot, ZONE) > 100
    texts = [text for text, _, _ in snapshot.legend()]
    assert texts == ["5 overlapping", "box/2"]


def test_the_legend_names_what_is_there() -> None:
    cloud = np.array([[0.0, 0, 0], [9, 9, 9]])
    states = np.array([FREE, FREE, TOUCHING, OVERLAPPING])
    points: dict[str, Any] = {"contacts": cloud, "cloud": cloud, "inside": cloud[:, 0] < 1.0}
    snapshot = make_snapshot(4, states=states, **points)
    assert [text for text, _, _ in snapshot.legend()] == [
        "2 free", "1 touching ≈", "1 overlapping", "other point", "point in a zone", "contact",
    ]  # fmt: skip


@each("notes", [1, 7, 40])
def test_texts_cover_neither_each_other_nor_the_scene(notes: int) -> None:
    figure: Any = draw_picture(make_snapshot(80, notes), "title", "subtitle")
    figure.canvas.draw()
    (axes,) = figure.axes
    assert [text.get_text() for text in axes.texts] == [str(k + 1) for k in range(min(notes, 5))]
    boxes = [text.get_window_extent() for text in (*figure.texts, *figure.legends)]
    assert len(boxes) == 3 + min(notes, 17) + min(notes, 5) + (notes > 17)
    for one, other in combinations(boxes, 2):
        assert not one.overlaps(other)
    for box in boxes:
        assert not box.overlaps(axes.get_window_extent())
        assert box.x0 >= 0.0
        assert box.x1 <= figure.bbox.x1


def test_a_picture_of_many_objects_is_written(tmp_path: Path) -> None:
    save_picture(tmp_path / "many.png", make_snapshot(300, 9), "title", "subtitle")
    assert (tmp_path / "many.png").read_bytes().startswith(b"\x89PNG")


def test_all_of_a_scene_is_in_the_picture() -> None:
    for scale in (0.01, 1.0, 300.0):
        centers = np.array([[0, 0, -5], [1, 0, 0]]) * scale
        boxes = oc.Boxes(centers, [np.eye(3)] * 2, np.full((2, 3), scale))
        snapshot = make_snapshot(2, boxes=boxes)
        assert count_pixels(snapshot, EDGE_COLORS[FREE]) > 500
