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

"""Hostile messages, bytes and files on all inputs of a node in another process.

``messages`` makes valid ones, ``mutations`` spoils them, ``cases`` has those that chance would not
make; ``meshes`` and ``scenes`` make files; ``stream`` numbers what is sent. ``child`` is the node's
process, ``frames`` what runs in it, ``client`` talks to it. ``session`` sends in batches, with
``services`` and ``probes`` in between, and ``usage`` judges what the node uses. ``command`` is the
console script ``obb_collision_fuzz``, ``scene_attack`` its part about scene files, ``report`` what
it prints.
"""
