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

"""Command lines: invalid arguments are refused in one line, with exit code 2 as by argparse."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Callable, Iterator
from functools import wraps
from pathlib import Path
from time import perf_counter
from traceback import clear_frames
from typing import Any, NoReturn, ParamSpec, TextIO, TypeVar

from obb_collision.words import printable, shown

#: Exit code for invalid arguments.
BAD_USAGE = 2
#: Exit code of a command that Ctrl-C ends, as in shells.
INTERRUPTED = 128 + signal.SIGINT

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")
Number = TypeVar("Number", int, float)


class _Help(argparse.ArgumentDefaultsHelpFormatter):
    """Shows defaults, except None and False."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        if action.default is None or action.default is False:
            return action.help
        return super()._get_help_string(action)


class Parser(argparse.ArgumentParser):
    """Shows defaults in its help, and reports errors in one line."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**{"formatter_class": _Help, **options})

    def error(self, message: str) -> NoReturn:
        """End with the reason."""
        reason = "\n".join(printable(line) for line in message.splitlines())
        self.exit(BAD_USAGE, f"{self.prog}: {reason}; see --help\n")


def option(parser: Any, name: str, kind: Any = None, default: Any = None, text: str = "") -> None:
    """Add an option with a value to a parser, or to a group of one."""
    parser.add_argument(name, type=kind, default=default, help=text)


def interruptible(
    name: str, detail: str = ""
) -> Callable[[Callable[Arguments, Result]], Callable[Arguments, Result | int]]:
    """Return a decorator for the main function of a command that Ctrl-C ends with one line."""

    def decorated(main: Callable[Arguments, Result]) -> Callable[Arguments, Result | int]:
        @wraps(main)
        def run(*args: Arguments.args, **options: Arguments.kwargs) -> Result | int:
            try:
                return main(*args, **options)
            except KeyboardInterrupt as interrupt:
                clear_frames(interrupt.__traceback__)  # progress bars end before the last line
                # on a new line, after ^C or a progress bar
                sys.stderr.write(f"\n{name}: interrupted{detail}\n")
                return INTERRUPTED

        return run

    return decorated


class Progress:
    """Prints progress: on a terminal one line that changes, elsewhere a line per topic.

    The topic of a line is its text without numbers at the end. stream: standard error by default.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._start, self._topic = perf_counter(), ""

    def __enter__(self) -> Progress:
        return self

    def show(self, what: str) -> None:
        """Write a line of progress, with the seconds since the start."""
        topic, line = what.rstrip("0123456789/ "), f"[{perf_counter() - self._start:4.0f} s] {what}"
        if self._stream.isatty():
            self._stream.write(f"\r\x1b[K{line[:100]}")
        elif topic != self._topic:
            self._stream.write(f"{line}\n")
        self._stream.flush()
        self._topic = topic

    def __exit__(self, *_: object) -> None:
        """Remove the line from a terminal."""
        if self._topic and self._stream.isatty():
            self._stream.write("\r\x1b[K")
            self._stream.flush()


def _within(kind: type[Number], what: str, low: Number, high: Number) -> Callable[[str], Number]:
    form = "" if kind is int else "g"

    def convert(text: str) -> Number:
        try:
            value = kind(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{shown(text)} is not a {what}") from None
        if not low <= value <= high:
            limits = f"must be between {low:{form}} and {high:{form}}"
            raise argparse.ArgumentTypeError(f"{limits}, got {shown(value)}")
        return value

    return convert


def whole(low: int, high: int) -> Callable[[str], int]:
    """Return a converter for argparse: an integer within limits, both included."""
    return _within(int, "whole number", low, high)


#: Converts a seed, of those that numpy takes as one integer.
SEED = whole(0, 2**32 - 1)


def real(low: float, high: float) -> Callable[[str], float]:
    """Return a converter for argparse: a number within limits, both included."""
    return _within(float, "number", low, high)


def mesh_files(folder: Path) -> Iterator[Path]:
    """Yield the mesh files, STL and OBJ, of a folder and those within."""
    return (file for file in folder.rglob("*") if file.suffix.lower() in (".stl", ".obj"))


def mesh_folder(text: str) -> Path:
    """Convert for argparse: a folder that has mesh files."""
    try:
        is_folder = "\0" not in text and Path(text).is_dir()
    except (OSError, ValueError):  # not a valid name
        is_folder = False
    if not is_folder:
        raise argparse.ArgumentTypeError(f"{shown(text)} is not a folder")
    if not any(mesh_files(Path(text))):
        raise argparse.ArgumentTypeError(f"{shown(text)} has no mesh files, STL or OBJ")
    return Path(text)


def new_file(*suffixes: str) -> Callable[[str], Path]:
    """Return a converter for argparse: a file in a folder that can be written to.

    suffixes: allowed ones; without any, all are allowed.
    """

    def convert(text: str) -> Path:
        path = Path(text)
        try:
            usable = "\0" not in text and path.parent.is_dir() and not path.is_dir()
            usable = usable and os.access(path if path.exists() else path.parent, os.W_OK)
        except (OSError, ValueError):  # not a valid file name
            usable = False
        if not usable:
            raise argparse.ArgumentTypeError(f"{shown(text)} cannot be written as a file")
        if suffixes and path.suffix.lower() not in suffixes:
            raise argparse.ArgumentTypeError(f"{shown(text)} must end in {' or '.join(suffixes)}")
        return path

    return convert
