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

"""How Fast DDS is set up for the processes of a check: by environment and profile."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

HEARTBEAT = """<data_writer profile_name="writer" is_default_profile="true">
<times><heartbeatPeriod><sec>0</sec><nanosec>20000000</nanosec></heartbeatPeriod></times>
<historyMemoryPolicy>DYNAMIC</historyMemoryPolicy></data_writer>
<data_reader profile_name="reader" is_default_profile="true">
<historyMemoryPolicy>DYNAMIC</historyMemoryPolicy></data_reader>"""
"""What is lost is sent again after a heartbeat only: by default up to 3 seconds later. And Fast DDS
keeps by default for each place in a queue the memory of its largest message: bounded, but as much
as a leak of a node would be."""
NO_SHARED_MEMORY = """<transport_descriptors><transport_descriptor>
<transport_id>loopback</transport_id><type>UDPv4</type>
<interfaceWhiteList><address>127.0.0.1</address></interfaceWhiteList>
</transport_descriptor></transport_descriptors>
<participant profile_name="participant" is_default_profile="true"><rtps>
<userTransports><transport_id>loopback</transport_id></userTransports>
<useBuiltinTransports>false</useBuiltinTransports></rtps></participant>"""
"""A process that is killed while it writes to a queue in shared memory leaves it locked, and others
wait up to a second for each such queue; see ``docs/faults.md``. This sends by UDP."""
PROFILE = """<?xml version="1.0" encoding="UTF-8" ?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"><profiles>
{}
</profiles></dds>
"""
TRANSPORTS = "FASTDDS_BUILTIN_TRANSPORTS"
"""By UDP a message of 28 MB takes the middleware up to a minute on a busy machine, and what is
behind it waits: that is no fault of a node. LARGE_DATA sends by TCP."""
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
"""With LOCALHOST the layer of ROS chooses transports itself, shared memory among them."""


@contextmanager
def for_large_messages(folder: Path) -> Iterator[None]:
    """Set up participants that this process and its children make meanwhile: see the constants."""
    with _set_up(folder, HEARTBEAT, {TRANSPORTS: os.environ.get(TRANSPORTS, "LARGE_DATA")}):
        yield


@contextmanager
def for_killed_processes(folder: Path) -> Iterator[None]:
    """Set up the first participant of this process, and those of its children, alike."""
    with _set_up(folder, f"{NO_SHARED_MEMORY}\n{HEARTBEAT}", {RANGE: "SYSTEM_DEFAULT"}):
        yield


@contextmanager
def _set_up(folder: Path, profiles: str, more: dict[str, str]) -> Iterator[None]:
    profile = folder / "middleware.xml"
    profile.write_text(PROFILE.format(profiles))
    ours = {
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(profile),
        "RMW_FASTRTPS_USE_QOS_FROM_XML": "1",
        **more,
    }
    before = {name: os.environ.get(name) for name in ours}
    os.environ.update(ours)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
