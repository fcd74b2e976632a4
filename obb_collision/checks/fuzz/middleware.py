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

"""The middleware of an attack: what it releases, repeats, and sends by."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

PROFILE = """<?xml version="1.0" encoding="UTF-8" ?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"><profiles>
<data_writer profile_name="writer" is_default_profile="true">
<times><heartbeatPeriod><sec>0</sec><nanosec>20000000</nanosec></heartbeatPeriod></times>
<historyMemoryPolicy>DYNAMIC</historyMemoryPolicy></data_writer>
<data_reader profile_name="reader" is_default_profile="true">
<historyMemoryPolicy>DYNAMIC</historyMemoryPolicy></data_reader>
</profiles></dds>
"""
"""By default Fast DDS keeps for each place in a queue the memory of its largest message: bounded,
but as much as a leak of the node would be. And what a full segment of shared memory loses is sent
again only after a heartbeat: by default up to 3 seconds later, in which nothing is tried."""
TRANSPORT = "FASTDDS_BUILTIN_TRANSPORTS"
"""By UDP a message of 28 MB takes the middleware up to a minute on a busy machine, and what is
behind it waits: that is no fault of the node. LARGE_DATA sends by TCP."""


@contextmanager
def set_up(folder: Path) -> Iterator[None]:
    """Have the participants that this process and its children make meanwhile be set up so."""
    profile = folder / "middleware.xml"
    profile.write_text(PROFILE)
    ours = {
        TRANSPORT: os.environ.get(TRANSPORT, "LARGE_DATA"),
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(profile),
        "RMW_FASTRTPS_USE_QOS_FROM_XML": "1",
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
