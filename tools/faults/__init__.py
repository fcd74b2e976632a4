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

"""Faults around a node, each made with real processes, and what the node did.

``bench`` starts a node in another process and asks it, ``peers`` are programs beside it. The
faults are in ``processes``, ``resources`` and ``sensors``, one function per fault; ``__main__`` has
the list of them, and is ``python -m tools.faults``.
"""
