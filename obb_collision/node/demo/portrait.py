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

"""What the demo's picture shows: what the listener knows, as marks, legend and labels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from obb_collision.geometry.boxes import Boxes
from obb_collision.node.demo.bodies import bodies_of
from obb_collision.node.demo.camera import WAREHOUSE, Camera, camera_of
from obb_collision.node.demo.caption import Entry, Label, save_picture
from obb_collision.node.demo.file_scene import FileScene
from obb_collision.node.demo.followers import pair_of
from obb_collision.node.demo.listener import TOUCH_DEPTH, CollisionListener, told
from obb_collision.node.demo.picture import (
    CLOUD_COLORS,
    COLLIDING,
    COMING_COLOR,
    FREE,
    NEAR_COLOR,
    STATE_COLORS,
    STATE_NAMES,
    TOUCHING,
    IntArray,
    Marks,
    render,
)
from obb_collision.node.demo.raster import FloatArray
from obb_collision.node.demo.scene import DemoScene

#: Contacts named in the picture, the deepest ones; near pairs and collisions to come likewise.
MAX_LABELS = 12
MAX_NEAR, MAX_COMING = 4, 4


class Portrait:
    """A picture of a scene at a time; boxes: of its objects, in their order."""

    def __init__(
        self, scene: DemoScene | FileScene, time: float, boxes: Boxes, heard: CollisionListener
    ) -> None:
        self._scene, self._time, self._boxes, self._heard = scene, time, boxes, heard
        self._pairs = list(heard.pairs.items())
        self._deep = [k for k, (_, depth) in enumerate(self._pairs) if depth >= TOUCH_DEPTH]
        followers = heard.effects.followers
        self._coming = sorted(_rows(followers, "sweep"), key=lambda row: row.time)
        self._near = (
            followers["clearance"].lines if "clearance" in followers else np.empty((0, 2, 3))
        )
        self._inside = {row.name: row.points for row in _rows(followers, "points")}
        self._zones = [item.opacity < 1.0 for item in scene.items]

    def save(self, file: Path) -> None:
        """Draw and write it. OSError for the file."""
        scene, states, marks = self._scene, self._states(), self._marks()
        camera: Camera = WAREHOUSE
        if isinstance(scene, FileScene):
            camera = camera_of(scene.description.view, self._boxes)
        image = render(bodies_of(scene, self._time), self._boxes, states, marks, camera)
        title = scene.description.name if isinstance(scene, FileScene) else "obb_collision"
        pairs = f"{len(self._pairs)} pair{'s' * (len(self._pairs) != 1)} in contact"
        subtitle = f"{len(scene.items)} objects, {pairs}"
        save_picture(file, image, title, subtitle, self._legend(states), self._labels(camera))

    def _states(self) -> IntArray:
        """Return the state of each object; of a zone, whether something is in it."""
        states = dict.fromkeys((name for pair, _ in self._pairs for name in pair), TOUCHING)
        states |= dict.fromkeys((n for k in self._deep for n in self._pairs[k][0]), COLLIDING)
        states |= dict.fromkeys(self._inside, COLLIDING)
        return np.array([states.get(name, FREE) for name in self._scene.names])

    def _contacts(self) -> FloatArray:
        """Return the contact points, or a place for each deep pair without that effect."""
        followers = self._heard.effects.followers
        places = self._heard.points[self._deep]
        if "contacts" not in followers:
            return places
        return np.concatenate([places, followers["contacts"].points])

    def _marks(self) -> Marks:
        cloud = self._scene.points(self._time)
        points = np.empty((0, 3)) if cloud is None else cloud.astype(np.float64)
        inside = np.zeros(len(points), np.bool_)
        for row in np.flatnonzero(self._zones):
            local = (points - self._boxes.centers[row]) @ self._boxes.rotations[row]
            inside |= (np.abs(local) <= self._boxes.half_extents[row]).all(axis=1)
        coming = np.array([row.point for row in self._coming], np.float64).reshape(-1, 3)
        return Marks(self._contacts(), coming, self._near, points, inside)

    def _legend(self, states: IntArray) -> list[Entry]:
        kinds = [k for k, zone in zip(states.tolist(), self._zones, strict=True) if not zone]
        entries = []
        if len(self._contacts()):
            color = _rgb(STATE_COLORS[COLLIDING])
            entries.append(Entry("contact, and how deep", color, "dot"))
        if self._coming:
            entries.append(Entry("contact to come, and when", COMING_COLOR, "dot"))
        if len(self._near):
            entries.append(Entry("closest points, and how far", NEAR_COLOR, "line"))
        if self._inside:
            entries.append(Entry("point in a zone", _rgb(CLOUD_COLORS[1]), "speck"))
        return entries + [
            Entry(f"{kinds.count(k)} {word}", _rgb(STATE_COLORS[k]))
            for k, word in enumerate(STATE_NAMES)
        ]

    def _labels(self, camera: Camera) -> list[Label]:
        deepest = sorted(self._deep, key=lambda k: -self._pairs[k][1])[:MAX_LABELS]
        texts = [(self._heard.points[k], told(*self._pairs[k])) for k in deepest]
        texts += [
            (np.array(row.point), f"{pair_of(row)}  in {row.time:.1f} s")
            for row in self._coming[:MAX_COMING]
        ]
        lengths = np.linalg.norm(self._near[:, 0] - self._near[:, 1], axis=1)
        for k in np.argsort(lengths)[:MAX_NEAR].tolist():
            texts.append((self._near[k].mean(axis=0), f"{1e3 * lengths[k]:.0f} mm"))
        tops = self._boxes.centers + [0.0, 0.0, 1.0] * self._boxes.half_extents
        for name, top in zip(self._scene.names, tops, strict=True):
            if name in self._inside:
                texts.append((top, f"{name}: {self._inside[name]} points"))
        return [(*camera.pixels(place[None])[0].tolist(), text) for place, text in texts]


def _rows(followers: dict[str, Any], name: str) -> list[Any]:
    return followers[name].rows if name in followers else []


def _rgb(color: FloatArray) -> tuple[float, float, float]:
    red, green, blue = color.tolist()
    return red, green, blue
