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

"""Console scripts: what they say about themselves, and why they can't start, in a line."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from importlib import import_module

import pytest
from each import each
from programs import SCRIPTS, function_of

pytest.importorskip("rclpy")
import rig  # noqa: F401 - of this machine only

import obb_collision
from obb_collision import commands
from obb_collision.node.runtime import environment

PATIENCE = 120.0


@pytest.fixture(autouse=True)
def _signals_as_before() -> Iterator[None]:
    """Assert that commands give the signals back: here they are not alone in their process."""
    handlers = [signal.getsignal(number) for number in environment.SIGNALS]
    yield
    assert [signal.getsignal(number) for number in environment.SIGNALS] == handlers


@pytest.mark.parametrize("script", SCRIPTS)
def test_help_prints_the_usage_and_starts_nothing(
    script: str, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    module, function = SCRIPTS[script].split(":")
    monkeypatch.setattr(sys, "argv", [script, "--help"])
    handlers = {number: signal.getsignal(number) for number in environment.SIGNALS}
    with pytest.raises(SystemExit) as ended:
        sys.exit(getattr(import_module(module), function)())
    for number, handler in handlers.items():
        signal.signal(number, handler)  # what is alone in its process may end it without
    output, errors = capfd.readouterr()
    assert not ended.value.code, errors
    assert output.startswith(f"usage: {script}")
    assert "ready:" not in output + errors


def test_the_version_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        function_of("obb_collision")(["--version"])
    assert capsys.readouterr().out == f"{obb_collision.__version__}\n"


@pytest.mark.parametrize("command", [commands.node, commands.merge])
def test_without_ros_they_say_what_is_missing(
    command: object, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(environment, "find_spec", lambda name: None)
    assert callable(command)
    assert command([]) == 1
    assert "needs rclpy" in capsys.readouterr().err


@each(
    "parameter, reason",
    [
        ("rate:=-1.0", "rate out of range"),
        ("rate:=5", "expecting type 'DOUBLE'"),
        ("rate:=5", "write it with a decimal point, as in rate:=50.0"),
        ("trigger:=never", "trigger must be one of timer, arrival, not 'never'"),
        ("fixed_frame:=''", "fixed_frame must not be empty"),
        ("qos_overrides./objects.subscription.depth:=-3", "depth must be 1 to 100000, not -3"),
        ("qos_overrides./objects.subscription.reliability:=maybe", "`reliability`: `maybe`"),
    ],
)
def test_parameters_that_cannot_be_used_end_the_node_with_the_reason(
    parameter: str, reason: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert commands.node(["--ros-args", "-p", parameter]) == 1
    error = capfd.readouterr().err
    assert reason in error
    assert "Traceback" not in error


def test_parameters_that_look_misspelt_are_named(capfd: pytest.CaptureFixture[str]) -> None:
    given = ("acuracy:=mesh", "max_velocity:=1.0", "scene_file:=nowhere")  # the last one ends it
    words = [word for one in given for word in ("-p", one)]
    assert commands.node(["--ros-args", *words]) == 1
    error = capfd.readouterr().err
    assert "there is no parameter acuracy; did you mean accuracy?" in error
    assert "max_velocity" not in error


COMMANDS = {
    "obb_collision": commands.node,
    "obb_collision_demo": commands.demo,
    "obb_collision view": commands.view,
    "obb_collision status": commands.status,
}


def test_parameters_that_cannot_be_used_end_the_demo_with_the_reason(
    capfd: pytest.CaptureFixture[str],
) -> None:
    arguments = ["--no-picture", "--ros-args", "-p", "rate:=fast"]
    assert commands.demo(arguments) == 1
    error = capfd.readouterr().err
    assert "obb_collision_demo: Trying to set parameter 'rate'" in error
    assert "Traceback" not in error


@each(
    "arguments, reason",
    [
        (["--log-level", "loud"], "does not use a valid severity level"),
        (["-p", "rate"], "parse parameter override rule: '-p rate'"),
        (["-r", "__ns:=a b"], "parse remap rule"),
        (["--params-file", "/nowhere.yaml"], "Error opening YAML file"),
        (["--nonsense"], "['--nonsense']"),
        (["--enclave", "x y"], "must be absolute"),
        (["-p", "\udcff:=1"], "surrogates not allowed"),
    ],
)
@each("name", COMMANDS)
def test_ros_arguments_that_cannot_be_used_end_the_node_with_one_line(
    name: str, arguments: list[str], reason: str, capfd: pytest.CaptureFixture[str]
) -> None:
    command = COMMANDS[name]
    assert command(["--ros-args", *arguments]) == environment.BAD_USAGE
    error = capfd.readouterr().err
    (line,) = [line for line in error.splitlines() if line.startswith(f"{name}: ")]
    assert reason in line
    assert "Traceback" not in error


def test_other_arguments_end_the_node_with_one_line(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match=str(environment.BAD_USAGE)):
        commands.node(["--rate", "5", "--ros-args", "-p", "rate:=5.0"])
    error = capfd.readouterr().err
    assert error == ("obb_collision_node: unrecognized arguments: --rate 5; see --help\n")


def test_ros_arguments_end_with_two_dashes() -> None:
    arguments = ["a", "--ros-args", "-p", "x:=1", "--", "b", "--ros-args", "-h", "--ros-args"]
    assert environment.without_ros_arguments(arguments) == ["a", "b"]
