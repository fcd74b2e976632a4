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

"""The speed of pairs beside parry3d compiled in Rust, without Python: same frames, by turns.

    python -m tools.peers.parry [--boxes 1000 10000 100000] [--rounds 5] [--markdown docs/speed.md]

It needs cargo. parry3d computes in single precision, so that a few of its verdicts differ.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from time import perf_counter

import numpy as np

import obb_collision as oc
from obb_collision.benchmarks.contestants import Frame, OurPairs, make_frames
from obb_collision.cli import Parser, interruptible, new_file, option
from obb_collision.typing import Floats
from tools.pages import as_markdown, write_into

SOURCES = Path(__file__).parent
FORM, SEED = "uniform", 1


def build(folder: Path, name: str) -> Path:
    """Compile the program of a peer for this processor, and return its path."""
    if shutil.which("cargo") is None:
        raise SystemExit("cargo is not installed: see rustup.rs")
    # capt needs std::simd, which a stable compiler has for crates that are named
    flags = {
        **os.environ,
        "RUSTFLAGS": "-C target-cpu=native",
        "RUSTC_BOOTSTRAP": "capt,capt_spheres",
    }
    where = ["--manifest-path", str(SOURCES / name / "Cargo.toml"), "--target-dir", str(folder)]
    subprocess.run(["cargo", "build", "--release", "--quiet", *where], env=flags, check=True)
    return next(path for path in (folder / "release").glob(f"{name}_*") if not path.suffix)


def write_frames(path: Path, half_extents: Floats, frames: list[Frame]) -> None:
    """Write the boxes and their poses as the program reads them."""
    with path.open("wb") as file:
        file.write(np.array([len(half_extents), len(frames), 1], "<u8").tobytes())
        for numbers in (half_extents, *(frame.poses for frame in frames)):
            file.write(numbers.astype("<f8").tobytes())


def our_times(half_extents: Floats, frames: list[Frame], threads: int) -> tuple[list[float], int]:
    """Return seconds per step of ``find_pairs``, and the pairs of the last one."""
    ours, times, pairs = OurPairs(half_extents, frames[0].poses), [], 0
    oc.set_threads(threads)
    for frame in frames:
        start = perf_counter()
        pairs = len(ours.pairs(ours.step(frame)))
        times.append(perf_counter() - start)
    return times, pairs


def measure(program: Path, boxes: int, rounds: int) -> dict[str, tuple[float, int]]:
    """Return milliseconds per step (median) and pairs, by the name of the contestant."""
    half_extents, frames = make_frames(FORM, boxes, 1.0, SEED)
    times: dict[str, list[float]] = {}
    pairs: dict[str, int] = {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "frames"
        write_frames(path, half_extents, frames)
        for number in range(rounds + 1):
            found = [
                (f"find_pairs, {n} thread{'s' * (n > 1)}", *our_times(half_extents, frames, n))
                for n in (1, 2)
            ]
            shown = subprocess.check_output([program, path], text=True).splitlines()
            for one in map(json.loads, shown):
                found.append((f"parry3d in Rust, {one['name']}", one["seconds"], one["pairs"]))
            for name, seconds, count in found:
                pairs[name] = count
                if number:  # the first round warms up
                    times.setdefault(name, []).extend(seconds)
    return {name: (1e3 * float(np.median(times[name])), pairs[name]) for name in times}


@interruptible("python -m tools.peers.parry")
def main(arguments: list[str] | None = None) -> int:
    """Print a table: milliseconds per step, and pairs found."""
    parser = Parser(prog="python -m tools.peers.parry", description=__doc__.split("\n")[0])
    parser.add_argument("--boxes", type=int, nargs="+", default=[1000, 10_000, 100_000])
    parser.add_argument("--rounds", type=int, default=5)
    option(parser, "--markdown", new_file(".md"), text="page whose table is written anew")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        program = build(Path(folder), "parry")
        found = {boxes: measure(program, boxes, options.rounds) for boxes in options.boxes}
    lines = [["ms per step", *(f"{boxes:,}" for boxes in found)]]
    for name in next(iter(found.values())):
        cells = (f"{row[name][0]:.3g} ({row[name][1]:,} pairs)" for row in found.values())
        lines.append([name, *cells])
    print(as_markdown(lines))
    if options.markdown:
        without = [[cell.partition(" (")[0] for cell in line] for line in lines]
        write_into(options.markdown, {"parry": as_markdown(without)})
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
