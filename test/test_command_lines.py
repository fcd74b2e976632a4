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

"""Command lines that can't be used: one line that says why, exit code 2, and nothing done."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

import pytest

SETUP = (Path(__file__).parents[1] / "setup.py").read_text()
SCRIPTS = dict(re.findall(r'"(obb_collision_\w+) = ([\w.]+:\w+)"', SETUP))
BENCHMARKS = {
    name: f"obb_collision.benchmarks.{name}:main"
    for name in (
        *("budget", "peers.convex_distances", "peers.sweeps", "peers.meshes"),
        *("peers.mesh_distances", "points"),
    )
}
WHOLES = ["x", "-1", "1.5", "", "nan", "9" * 5000, "9" * 400, "\ud800", "1\n2"]
REALS = ["x", "-1", "", "nan", "inf", "-inf", "1e999", "\ud800"]
FILES = ["/none/such/file", "/", "x" * 5000 + "/y", "nul\0", "\ud800/x", ""]
PLOTS = [*FILES, "x.exe"]
SEED, JSON = {"--seed": WHOLES}, {"--json": FILES}
NEED_ROS = ("obb_collision_node", "obb_collision_merge", "obb_collision_latency",
            "obb_collision_regions", "obb_collision_fuzz", "obb_collision_soak",
            "obb_collision_faults")  # fmt: skip
OPTIONS: dict[str, dict[str, list[str]]] = {
    "obb_collision_node": {},
    "obb_collision_merge": {},
    "obb_collision_regions": {
        "--objects": WHOLES, "--processes": WHOLES, "--seconds": REALS, "--halo": REALS, **SEED,
        **JSON,
    },
    "obb_collision_warm_up": {},
    "obb_collision_accuracy": {
        **dict.fromkeys(("--seed", "--bodies", "--pairs", "--timed"), WHOLES),
        "--seconds": REALS, "--plot": PLOTS, **JSON,
    },
    "obb_collision_demo": {
        "--seconds": REALS, "--objects": WHOLES, "--rate": REALS, "--picture": FILES, **SEED,
        "--scene": ["none", "/dev/zero", "/", "x" * 5000, "nul\0", "\ud800", "a\nb.yaml"],
    },
    "obb_collision_view": {"--port": [*WHOLES, "65536"], "--scene": ["none", "/", "nul\0"]},
    "obb_collision_soak": {
        "--seconds": REALS, "--steps": WHOLES, "--objects": WHOLES, "--warm-up": REALS,
        "--growth": REALS, "--log": FILES, **SEED, **JSON,
    },
    "obb_collision_fuzz": {"--messages": WHOLES, "--bound": REALS, "--log": FILES, **SEED},
    "obb_collision_known_bugs": {"--markdown": PLOTS},
    "obb_collision_robots": {
        **dict.fromkeys(("--boxes", "--states", "--motions", "--latency"), WHOLES),
        **dict.fromkeys(("--plot", "--markdown"), PLOTS), "--compared": WHOLES, **SEED, **JSON,
    },
    "obb_collision_faults": {"--only": ["none such", "", "\ud800"], "--markdown": PLOTS},
    "obb_collision_latency": {
        "--objects": WHOLES, "--new": WHOLES, "--seconds": REALS, **SEED, **JSON,
    },
    "obb_collision_srdf": {
        "--time-limit": [*REALS, "0"], "--output": FILES, "--report": FILES,
    },
    "obb_collision_speed": {
        **dict.fromkeys(("--sizes", "--threads", "--steps"), WHOLES), "--plot": PLOTS,
        **dict.fromkeys(("--moving", "--seconds", "--limit"), REALS), "--forms": ["none such"],
        "--markdown": PLOTS, **SEED, **JSON,
    },
    "obb_collision_wrong_answers": {"--pairs": WHOLES, "--family": ["none such"], **SEED, **JSON},
    "budget": {"--meshes": WHOLES, "--cycles": WHOLES, "--times": REALS, **JSON},
    "peers.convex_distances": {"--pairs": WHOLES, **JSON},
    "peers.sweeps": {"--pairs": WHOLES, **JSON},
    "peers.meshes": {"--pairs": WHOLES, **JSON},
    "peers.mesh_distances": {"--pairs": WHOLES, **JSON},
    "points": {"--points": WHOLES, "--boxes": WHOLES, **JSON},
}  # fmt: skip


def test_every_script_is_tried() -> None:
    assert set(OPTIONS) == {*SCRIPTS, *BENCHMARKS}


@pytest.mark.parametrize("script", OPTIONS)
def test_arguments_that_cannot_be_used_are_refused_in_a_line(
    script: str, capsys: pytest.CaptureFixture[str]
) -> None:
    if script in NEED_ROS:
        pytest.importorskip("rclpy")
    module, function = {**SCRIPTS, **BENCHMARKS}[script].split(":")
    main = getattr(import_module(module), function)
    cases = [[option, bad] for option, values in OPTIONS[script].items() for bad in values]
    cases += [["--nonsense"], ["--nonsense=\ud800\x1b"], *([option] for option in OPTIONS[script])]
    if script == "obb_collision_view":  # takes the name of a node
        cases += [["a b"], ["/"], ["\ud800"], ["a", "b"]]
    elif script == "obb_collision_srdf":
        cases += [["a.urdf", "extra"], []]
    elif script not in ("obb_collision_fuzz", "obb_collision_soak"):  # its are for the node
        cases += [["extra"]]
    for arguments in cases:
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        assert ended.value.code == 2, arguments
        printed, told = capsys.readouterr()
        assert printed == "", arguments
        assert told.count("\n") == 1, (arguments, told)
        assert told[:-1].isprintable(), (arguments, told)
        assert len(told) < 2000
        assert not arguments or arguments[0].split("=")[0] in told or arguments[0][0] != "-"
