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

"""The folders from which mesh files are read, as texts."""

from __future__ import annotations

import os

from obb_collision.words import shown


def folder_from_text(text: str) -> str:
    """Return an absolute path; ValueError for another one.

    It need not exist: it may be mounted later.
    """
    if not os.path.isabs(text):
        raise ValueError(f"{shown(text)} is no absolute path")
    return text
