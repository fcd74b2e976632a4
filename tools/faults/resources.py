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

"""Few resources: descriptors and memory, for a node that runs."""

from __future__ import annotations

import resource
from pathlib import Path

import numpy as np
import trimesh
from geometry_msgs.msg import Point
from visualization_msgs.msg import Marker

from tools.faults.bench import Bench, check, cube

MORE = 64 * 2**20
"""Bytes of address space that a node gets beyond what it has."""
POINTS = 1_000_000
"""Points of a marker that do not fit into that."""
RIGHT = 1.0


def mesh_marker(folder: Path, number: int) -> Marker:
    """Return a marker of a mesh file of its own."""
    file = folder / f"mesh_{number}.stl"
    trimesh.creation.icosphere(subdivisions=2, radius=0.5).export(file)
    marker = cube(("mesh", number), (50.0 + 2.0 * number, 0.0, 0.0))
    marker.type, marker.mesh_resource = Marker.MESH_RESOURCE, f"file://{file}"
    return marker


def few_descriptors(bench: Bench) -> str:
    """Leave a node no descriptor, have it load a mesh file, and give it some back."""
    node = bench.start(f"mesh_folders:=['{bench.folder}']")
    node.limit(resource.RLIMIT_NOFILE, node.descriptors())
    bench.send([mesh_marker(bench.folder, 1)])
    longest = max(bench.probe() for _ in range(10))
    bench.until(
        lambda: bench.value("input objects", "rejected") + bench.value("objects", "unplaceable"),
        "refusal",
    )
    reasons = [key for key in bench.diagnostics["input objects"] if key.startswith("rejected: ")]
    reasons += [key for key in bench.diagnostics["objects"] if key.startswith("unplaceable: ")]
    check(longest <= RIGHT, f"right only after {longest:.2f} s")
    node.limit(resource.RLIMIT_NOFILE, -1)
    markers = [mesh_marker(bench.folder, number) for number in (1, 2)]

    def is_built() -> bool:
        bench.send(markers)
        bench.probe()
        return bench.value("objects", "unplaceable") == 0

    built = bench.until(is_built, "mesh, once there are descriptors again")
    return (
        f"others right after {longest:.2f} s at most; the mesh: {', '.join(reasons) or 'waited'}; "
        f"{built:.1f} s after there were some again all was placed"
    )


def little_memory(bench: Bench) -> str:
    """Leave a node 64 MiB of address space, and send it a message that takes more."""
    node = bench.start()
    for _ in range(5):
        bench.probe()
    node.limit(resource.RLIMIT_AS, node.status("VmSize") + MORE)
    marker = cube(("large", 1), (100.0, 0.0, 0.0))
    marker.type = Marker.POINTS
    marker.points = np.full(POINTS, Point()).tolist()
    bench.send_apart([marker])  # what it waits for, the probe does not
    bench.spin(2.0)
    longest = max(bench.probe() for _ in range(10))
    check(longest <= RIGHT, f"right only after {longest:.2f} s")
    bench.spin(1.1)  # for /diagnostics of after that
    failures = bench.diagnostics.get("internal errors", {}).get("message", "")
    refused = bench.diagnostics["input objects"]["message"]
    node.limit(resource.RLIMIT_AS, -1)
    after = bench.probe()
    return (
        f"others right after {longest:.2f} s at most; `/diagnostics`: {refused or 'none'}, "
        f"{failures}; {after:.2f} s with memory again"
    )
