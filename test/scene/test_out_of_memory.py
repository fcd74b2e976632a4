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

"""Where memory ends in a change of a large scene, the scene is as before."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="limits of memory as Linux has them"
)

#: Makes a row of boxes that fill their arrays, each of which meets the next, and changes it with a
#: little more memory than it has, in steps of some MiB, until each change has been possible.
SCRIPT = """
import resource
import numpy as np
import obb_collision as oc

FREE = resource.getrlimit(resource.RLIMIT_AS)
FAR = [0, 9, 0, 0, 0, 0, 1]

def used():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[0]) * resource.getpagesize()

def row(count):
    scene, poses = oc.Scene(), np.zeros((count, 7))
    poses[:, 0], poses[:, 6] = 0.9 * np.arange(count), 1.0
    names, sizes, every = [str(k) for k in range(count)], np.ones((count, 3)), np.arange(count)
    scene.add_boxes(names, sizes, poses)
    return scene, [
        lambda: scene.add("new", oc.shapes.Box([1, 1, 1]), FAR),
        lambda: scene.add_boxes(["more", "0"], 0.5 * sizes[:2], [FAR, FAR]),
        lambda: scene.add_boxes(names, 0.95 * sizes, poses),
        lambda: scene.move_indices(every, poses + [0, 1, 0, 0, 0, 0, 0]),
        lambda: setattr(scene, "padding", 0.001),
        lambda: scene.objects.remove(every[::2]),
        lambda: scene.query(oc.shapes.Box([1, 1, 1])),
    ]

def state(scene):
    boxes = scene.boxes
    arrays = boxes.centers, boxes.half_extents, scene.objects.poses_of(scene.indices)
    seen = scene.names, scene.padding, len(scene.check())
    return [*seen, *(hash(array.tobytes()) for array in arrays)]

scene, changes = row(3000)
for change in changes:  # kernels need memory, too
    change()
    state(scene), scene.check().depths

scene, changes = row(131072)
assert len(scene.check()) == 131071
failed = 0
for number, change in enumerate(changes):
    before, report = state(scene), scene.check()
    old, pairs = scene.boxes, report.pairs.copy()
    depths = oc.separations(old, old, pairs).separations if scene.indices[-1] < len(scene) else None
    for mebibytes in range(0, 800, STEP):
        resource.setrlimit(resource.RLIMIT_AS, (used() + (mebibytes << 20), FREE[1]))
        try:
            change()
            break
        except MemoryError:
            failed += 1
        finally:
            resource.setrlimit(resource.RLIMIT_AS, FREE)
        assert state(scene) == before, (number, mebibytes)
    assert mebibytes < 800 - STEP, number
    assert depths is None or (report.separations == depths).all(), number
print(failed)
"""


def test_a_change_without_memory_for_it_does_not_happen() -> None:
    command = [sys.executable, "-c", SCRIPT.replace("STEP", "10")]
    environment = os.environ | {"OBB_COLLISION_THREADS": "1"}
    found = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert found.returncode == 0, found.stderr
    assert int(found.stdout) > 5
