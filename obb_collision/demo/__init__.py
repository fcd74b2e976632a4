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

"""The demo and the live view, which use the topics like any other program.

``command`` has the console script ``obb_collision_demo``, a node and a moving scene in one process
with real topics between them, and ``obb_collision view``, a running node's topics in the browser.
``motion`` reads how a scene moves, ``scene`` names its shapes, ``run`` publishes it, ``listener``
follows a node; ``snapshot`` is drawn by ``picture`` (a file) and ``view`` (the browser).
"""
