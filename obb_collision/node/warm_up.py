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

"""Kernels made ready before a cycle needs them: at the start, or in a thread beside the cycles.

The machine code of a kernel is loaded (0.2 s) or, the first time on a machine, compiled: a second
for one, half a minute for those of triangles. What a cycle always needs is made ready before the
node subscribes; an accuracy or an effect that somebody asks for later must not stop the cycles.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from queue import SimpleQueue
from threading import Thread
from time import perf_counter

import numpy as np

from obb_collision.geometry.shapes import Box, Mesh
from obb_collision.node.marker_batch import Faults, gather, settle
from obb_collision.node.marker_scan import scan_markers
from obb_collision.node.markers import Markers
from obb_collision.queries.accuracy import Accuracy
from obb_collision.scene.scene import Scene

OBJECTS = 64
"""Enough that one moved object of them takes the incremental way through the scene."""
TETRAHEDRON = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
TETRAHEDRON_FACES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))


def warm_up() -> None:
    """Make ready what every cycle needs, whatever is asked of the node."""
    scene = _row_of_boxes()
    for x in (0.0, 0.1):
        scene.move_indices(np.array([0]), np.array([(x, 0.1, 0, 0, 0.6, 0, 0.8)]))
        report = scene.check(effects=["separations"])
        _ = report.colliding, report.depths
    _warm_up_crowds()
    keys = [("", number) for number in range(OBJECTS)]
    data = Markers("").write(keys, scene.boxes, np.zeros(OBJECTS, np.int64), 0, 0.0, None)
    markers = gather([scan_markers(data)], [0])
    settle(markers, Faults(len(markers)), 0, 0)


def warm_up_rung(rung: Accuracy) -> None:
    """Make ready what pairs on a rung need: meshes, and a mesh and a box."""
    scene = Scene(accuracy=rung)
    for number in range(2):
        mesh = Mesh(TETRAHEDRON, TETRAHEDRON_FACES)
        scene.add(f"mesh {number}", mesh, (0.3 * number, 0.1, 0.0, 0.0, 0.0, 0.6, 0.8))
    scene.add("box", Box((0.5, 0.5, 0.5)))
    scene.check()


def warm_up_effect(name: str) -> None:
    """Make ready what an effect needs."""
    scene = _row_of_boxes()
    scene.set_effect(name, "on")
    scene.set_twists(np.arange(OBJECTS), np.full((OBJECTS, 6), 0.1))
    clouds = [np.zeros((4, size), kind)[:, :3] for size in (3, 4) for kind in ("f4", "f8")]
    for points, step in zip(clouds, (0.25, 3.0, 0.9, 1.0), strict=True):
        scene.points = points
        scene.check()
        poses = np.zeros((OBJECTS, 7))
        poses[:, 0], poses[:, 6] = step * np.arange(OBJECTS), 1.0
        scene.move_indices(np.arange(OBJECTS), poses)
    scene.check()


def _warm_up_crowds() -> None:
    """Make ready what more colliding pairs than a limit need: two places full of boxes."""
    scene = Scene(max_pairs=1)
    for number in range(2 * OBJECTS):
        x = 10.0 * (number >= 4)  # too few in one place, and in the other enough
        scene.add(str(number), Box((1.0, 1.0, 1.0)), (x, 0, 0, 0, 0, 0.6, 0.8))
    assert scene.check().truncated


def _row_of_boxes() -> Scene:
    scene = Scene()
    for number in range(OBJECTS):
        scene.add(str(number), Box((1.0, 1.0, 1.0)), (0.75 * number, 0, 0, 0, 0, 0.6, 0.8))
    return scene


class WarmUp:
    """What is ready, and a thread for what isn't yet.

    Things are rungs of ``Accuracy`` and names of ``EFFECTS``. ``say`` and ``complain`` take lines
    for the log.
    """

    def __init__(self, say: Callable[[str], None], complain: Callable[[str], None]) -> None:
        self._say, self._complain = say, complain
        self._ready: set[Accuracy | str] = {rung for rung in Accuracy if rung <= Accuracy.OBB}
        self._ready.add("separations")
        self._asked: set[Accuracy | str] = set()
        self._queue: SimpleQueue[Accuracy | str] = SimpleQueue()
        self._thread: Thread | None = None

    def finish(self, things: Iterable[Accuracy | str]) -> None:
        """Make things ready now."""
        for thing in things:
            if thing not in self._ready:
                self._say(_beginning(thing))
                self._make(thing)

    def is_ready(self, thing: Accuracy | str) -> bool:
        """Return whether a thing is ready; if not, see to it that it will be."""
        if thing in self._ready:
            return True
        if thing not in self._asked:
            self._asked.add(thing)
            self._say(_beginning(thing))
            self._queue.put(thing)
            if self._thread is None:
                # A daemon: who ends the node does not want to wait for it.
                self._thread = Thread(target=self._work, daemon=True, name="warm-up")
                self._thread.start()
        return False

    def _work(self) -> None:
        while True:
            self._make(self._queue.get())

    def _make(self, thing: Accuracy | str) -> None:
        start = perf_counter()
        try:
            if isinstance(thing, Accuracy):
                warm_up_rung(thing)
            else:
                warm_up_effect(thing)
        except Exception as error:
            self._complain(f"{_named(thing)}: {type(error).__name__}: {error}")
        self._ready.add(thing)
        self._say(f"{_named(thing)} ready after {perf_counter() - start:.1f} s")


def _beginning(thing: Accuracy | str) -> str:
    return f"making {_named(thing)} ready: seconds, the first time on a machine up to a minute"


def _named(thing: Accuracy | str) -> str:
    if isinstance(thing, Accuracy):
        return f"accuracy {thing.name.lower()}"
    return f"effect {thing}"
