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

"""Commands: what they say of themselves, and why they cannot start or use their arguments."""

from __future__ import annotations

import re
import select
import signal
import subprocess
import sys
from argparse import ArgumentParser, ArgumentTypeError
from collections.abc import Callable, Iterator
from contextlib import suppress
from io import StringIO
from pathlib import Path

import pytest
from each import each
from processes import PATIENCE, PROGRAMS, SCRIPTS, function_of, limited

pytest.importorskip("rclpy")
import rig  # noqa: F401 - of this machine only

import obb_collision
from obb_collision import commands
from obb_collision.cli import Progress, real, whole
from obb_collision.node.runtime import environment
from obb_collision.words import command_line

Captured = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def _signals_as_before() -> Iterator[None]:
    """Assert that commands give the signals back: here they are not alone in their process."""
    handlers = [signal.getsignal(number) for number in environment.SIGNALS]
    yield
    assert [signal.getsignal(number) for number in environment.SIGNALS] == handlers


@pytest.mark.parametrize("script", SCRIPTS)
def test_help_prints_the_usage_and_starts_nothing(
    script: str, monkeypatch: pytest.MonkeyPatch, capfd: Captured
) -> None:
    monkeypatch.setattr(sys, "argv", [script, "--help"])
    handlers = {number: signal.getsignal(number) for number in environment.SIGNALS}
    with pytest.raises(SystemExit) as ended:
        sys.exit(function_of(script)())  # type: ignore[call-arg]
    for number, handler in handlers.items():
        signal.signal(number, handler)  # what is alone in its process may end it without
    output, errors = capfd.readouterr()
    assert not ended.value.code, errors
    assert output.startswith(f"usage: {script}")
    assert "ready:" not in output + errors


def test_commands_are_named_as_they_are_called_here(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: Captured
) -> None:
    wanted = "obb_collision warm-up"
    script = tmp_path / "lib" / "obb_collision" / "obb_collision"  # where colcon puts it
    script.parent.mkdir(parents=True)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nothing:{tmp_path}:")
    assert command_line(wanted) == wanted
    for name in ("obb_collision", "obb_collision_node"):
        (script.parent / name).write_text("#!/bin/sh")
        (script.parent / name).chmod(0o755)
    assert command_line(wanted) == f"ros2 run obb_collision {wanted}"
    with pytest.raises(SystemExit):
        commands.node(["--help"])
    example = "For example: ros2 run obb_collision obb_collision_node --ros-args"
    assert example in " ".join(capsys.readouterr().out.split())
    monkeypatch.setenv("PATH", f"{tmp_path}:{script.parent}")
    assert command_line(wanted) == wanted


def test_the_version_is_said_and_what_is_no_command_refused(capsys: Captured) -> None:
    with pytest.raises(SystemExit, match="0"):
        function_of("obb_collision")(["--version"])
    assert capsys.readouterr().out == f"{obb_collision.__version__}\n"
    for arguments in ([], ["nonsense"], ["--nonsense"]):
        with pytest.raises(SystemExit, match="2"):
            function_of("obb_collision")(arguments)
        assert capsys.readouterr().err.count("\n") == 1


def test_without_ros_they_say_so(monkeypatch: pytest.MonkeyPatch, capsys: Captured) -> None:
    monkeypatch.setattr(environment, "find_spec", lambda name: None)
    for command in (commands.node, commands.merge):
        assert command([]) == 1
        assert "needs rclpy" in capsys.readouterr().err


QOS = "qos_overrides./objects.subscription."


@each("parameter, reason", [
    ("rate:=-1.0", "rate out of range"), ("rate:=5", "expecting type 'DOUBLE'"),
    ("rate:=5", "write it with a decimal point, as in rate:=50.0"),
    ("trigger:=never", "trigger must be one of timer, arrival, not 'never'"),
    ("fixed_frame:=''", "fixed_frame must not be empty"),
    (f"{QOS}depth:=-3", "depth must be 1 to 100000, not -3"),
    (f"{QOS}reliability:=maybe", "`reliability`: `maybe`"),
    ("rate:=fast", "obb_collision_demo: Trying to set parameter 'rate'"),
])  # fmt: skip
def test_bad_parameters_end_it_with_a_reason(parameter: str, reason: str, capfd: Captured) -> None:
    given = ["--ros-args", "-p", parameter]
    in_demo = "_demo" in reason
    assert (commands.demo(["--no-picture", *given]) if in_demo else commands.node(given)) == 1
    error = capfd.readouterr().err
    assert reason in error
    assert "Traceback" not in error


def test_parameters_that_look_misspelt_are_named(capfd: Captured) -> None:
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


@each("arguments, reason", [
    (["--log-level", "loud"], "does not use a valid severity level"),
    (["-p", "rate"], "parse parameter override rule: '-p rate'"),
    (["-r", "__ns:=a b"], "parse remap rule"), (["--nonsense"], "['--nonsense']"),
    (["--params-file", "/nowhere.yaml"], "Error opening YAML file"),
    (["--enclave", "x y"], "must be absolute"), (["-p", "\udcff:=1"], "surrogates not allowed"),
])  # fmt: skip
@each("name", COMMANDS)
def test_ros_arguments_that_cannot_be_used_end_the_node_with_one_line(
    name: str, arguments: list[str], reason: str, capfd: Captured
) -> None:
    assert COMMANDS[name](["--ros-args", *arguments]) == environment.BAD_USAGE
    error = capfd.readouterr().err
    (line,) = [line for line in error.splitlines() if line.startswith(f"{name}: ")]
    assert reason in line
    assert "Traceback" not in error


def test_other_arguments_end_the_node_and_two_dashes_those_of_ros(capfd: Captured) -> None:
    with pytest.raises(SystemExit, match=str(environment.BAD_USAGE)):
        commands.node(["--rate", "5", "--ros-args", "-p", "rate:=5.0"])
    error = capfd.readouterr().err
    assert error == "obb_collision_node: unrecognized arguments: --rate 5; see --help\n"
    arguments = ["a", "--ros-args", "-p", "x:=1", "--", "b", "--ros-args", "-h", "--ros-args"]
    assert environment.without_ros_arguments(arguments) == ["a", "b"]


FILES = ["/none/such/file", "/", "x" * 5000 + "/y", "nul\0", "\ud800/x", ""]
#: What is refused by what converts an argument, or by an option that nothing converts.
BAD = {
    "whole": ["x", "-1", "1.5", "", "nan", "9" * 5000, "9" * 400, "\ud800", "1\n2"],
    "real": ["x", "-1", "", "nan", "inf", "-inf", "1e999", "\ud800"],
    "new_file": FILES,
    "mesh_folder": [*FILES[:1], *FILES[2:5], str(Path(__file__).parent)],
    "scene_file": ["none", "/dev/zero", "/", "x" * 5000, "nul\0", "\ud800", "a\nb.yaml"],
    "node_name": ["a b", "/", "\ud800"],
    "_peer_of": ["none such"],
    "_only": ["raw", "raw:x", "raw:9-1", "\ud800"],
    "--family": ["none such"],
}
ENDINGS = {"--picture", "--plot", "--markdown"}
#: Those that an interrupt ends as any other end does.
END_OTHERWISE = {
    *("obb_collision_node", "obb_collision_merge", "obb_collision_demo", "obb_collision view"),
    *("obb_collision status", "python -m tools.soak"),
}
SAME = {"obb_collision", "obb_collision node", "obb_collision merge", "obb_collision demo"}


def bad_arguments(main: Callable[[list[str]], int]) -> Iterator[list[str]]:
    """Yield what a program refuses, for each of its arguments."""
    found: list[ArgumentParser] = []
    with pytest.MonkeyPatch.context() as patch, suppress(TypeError):  # it gets no arguments
        patch.setattr(ArgumentParser, "parse_known_args", lambda made, *_: found.append(made))
        main([])
    for action in found[0]._actions:
        option = action.option_strings[-1:]
        if option and action.nargs in (None, "+"):
            yield [*option]
        names = [getattr(action.type, "__qualname__", "").partition(".")[0], *option]
        values = ["none such", "", "\ud800"] if action.choices else []
        values += [bad for name in names for bad in BAD.get(name, [])]
        values += ["x.exe"] if values and ENDINGS & set(option) else []
        yield from ([*option, bad] for bad in values)


def test_limits_of_numbers_are_within_them() -> None:
    kinds: tuple[Callable[[str], float], ...] = (whole(2, 5), real(2.0, 5.0))
    for convert in kinds:
        assert [convert(text) for text in ("2", "3", "5")] == [2, 3, 5]
        for text in ("1", "6"):
            with pytest.raises(ArgumentTypeError, match="must be between 2 and 5"):
                convert(text)


@pytest.mark.parametrize("script", sorted(set(PROGRAMS) - SAME))
def test_bad_arguments_are_refused_in_a_line(script: str, capsys: Captured) -> None:
    main = function_of(script)
    cases = [*bad_arguments(main), ["--nonsense"], ["--nonsense=\ud800\x1b"]]
    if script == "obb_collision srdf":
        cases += [["a.urdf", "extra"], []]
    elif script not in ("python -m tools.fuzz", "python -m tools.soak"):  # its are for the node
        cases += [["a", "extra"]]
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


def test_progress_is_a_line_that_changes_on_a_terminal_and_else_one_per_topic() -> None:
    said, terminal = [], StringIO()
    vars(terminal)["isatty"] = lambda: True
    for stream in (terminal, StringIO()):
        with Progress(stream) as progress:
            for what in ("a 1/2", "a 2/2", "b"):
                progress.show(what)
        said.append(stream.getvalue())
    shown, written = (re.sub(r"\[ *\d+ s\]", "", text) for text in said)
    assert shown == "\r\x1b[K a 1/2\r\x1b[K a 2/2\r\x1b[K b\r\x1b[K"
    assert written == " a 1/2\n b\n"


@each("script", sorted(set(PROGRAMS) - SAME - END_OTHERWISE))
def test_an_interrupt_is_one_line_and_exit_code_130(
    script: str, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(ArgumentParser, "parse_known_args", interrupted)
    assert function_of(script)([]) == 130
    name = script.removeprefix("python -m tools.peers.")  # one has its own name only
    assert re.search(rf"^\n[\w. -]*{name}: interrupted(; .*)?\n$", capsys.readouterr().err)


def test_a_signal_ends_a_program_that_runs() -> None:
    code = (  # where SIGINT is ignored, as in the background of a shell, Python leaves it at that
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from tools.wrong_answers import main; "
        "raise SystemExit(main(['--pairs', '200000']))"
    )
    command = [sys.executable, "-c", code]
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **pipes) as process:  # type: ignore[call-overload]
        begun, _, _ = select.select([process.stderr], [], [], PATIENCE)  # progress: it runs
        with limited(process):
            said = None
            while said is None:  # an interrupt within a callback is lost
                process.send_signal(signal.SIGINT)
                with suppress(subprocess.TimeoutExpired):
                    _, said = process.communicate(timeout=10.0)
    assert begun
    assert process.returncode == 130
    assert said.splitlines()[-1] == "python -m tools.wrong_answers: interrupted"
    assert "Traceback" not in said
