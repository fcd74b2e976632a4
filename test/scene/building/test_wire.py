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

"""Messages between the processes that build."""

from __future__ import annotations

import os
import threading

import numpy as np
import pytest
from builders import PATIENCE
from each import each

from obb_collision.scene.building.wire import Pipe


def pipes() -> tuple[Pipe, Pipe, list[int]]:
    (a, b), (c, d) = os.pipe(), os.pipe()
    return Pipe(a, d), Pipe(c, b), [a, b, c, d]


def test_messages_come_back_as_they_were() -> None:
    near, far, descriptors = pipes()
    message = {
        "text": "ä\ud800\0",
        "number": 0.1,
        "none": None,
        "large": np.random.default_rng(0).normal(size=(500_000, 3)),
        "empty": np.empty((0, 3), np.int64),
        "whole": np.arange(5, dtype=np.int8),
        "flags": np.array([True, False]),
    }
    sender = threading.Thread(target=near.send, args=(message, PATIENCE))
    sender.start()
    got = far.receive(PATIENCE)
    sender.join(PATIENCE)
    assert got is not None
    assert got.keys() == message.keys()
    for name, value in message.items():
        np.testing.assert_array_equal(got[name], value)
        assert getattr(got[name], "dtype", None) == getattr(value, "dtype", None)
    with pytest.raises(TimeoutError):
        far.receive(0.0)
    os.close(descriptors[3])
    os.close(descriptors[1])
    assert near.receive(PATIENCE) is None


@each("data", [b"\xff" * 8, b"\2" + bytes(7) + b"no", b"\2" + bytes(7) + b"{}"])
def test_what_is_no_message_is_an_error(data: bytes) -> None:
    _, far, descriptors = pipes()
    os.write(descriptors[3], data)
    with pytest.raises(ValueError, match=r"."):
        far.receive(PATIENCE)
