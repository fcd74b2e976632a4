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

"""Steps of a walk that are faults of the node, of its clock, and of its time."""

from __future__ import annotations

from unittest.mock import patch

from evidence_machine import EvidenceMachine, key
from evidence_world import CYCLE_LIMIT, EITHER, FAIL, USUALLY, rule
from geometry_msgs.msg import TransformStamped
from rig import cube, pose
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray
from walks import one_of

from obb_collision.node.inputs import MarkerUpdate
from obb_collision.node.messages import conversions as cv


class FaultMachine(EvidenceMachine):
    """A machine in which errors happen, clocks jump, and cycles are late."""

    def heal(self, clears: bool) -> None:
        """Let an error be, or end it."""
        if clears:
            self.clear()
        self.tick()

    @rule(0.5, what=one_of(["check", "update", "sets", "robots", "sources"]), clears=USUALLY)
    def fail_in_a_cycle(self, what: str = "check", clears: bool = True) -> None:
        node = self.node
        if (what == "robots") > self.has_robot or (what == "sources") > self.has_sensors:
            what = "check"
        owner, name = {
            "check": (node.objects.scene, "check"),
            "update": (node.objects, "update"),
            "sets": (node.inputs.boxes, "apply"),
            "robots": (node.robots, "apply"),
            "sources": (node.sources, "apply"),
        }[what]
        self.world.advance(0.0503)
        with patch.object(owner, name, FAIL):
            self.cycle(what)
        self.heal(clears and what in ("sets", "robots", "sources"))

    @rule(0.5, what=one_of(["transform", "marker", "clear"]), clears=USUALLY)
    def fail_in_a_message(self, what: str = "clear", clears: bool = True) -> None:
        """Let an error leave objects other than they were sent; until ``clear`` nobody knows."""
        self.apply()
        node, names = self.node, sorted(self.model.things)
        if what == "clear":
            with patch.object(node.objects, "clear", FAIL):
                self.clear(fails=True)
        elif what == "marker":
            with patch.object(MarkerUpdate, "apply", FAIL):
                self.send("objects", MarkerArray(markers=[cube(("b", 0))]))
                node.inputs.markers.apply()
            self.model.fail()
        elif names:
            message = TransformStamped(header=Header(frame_id="map"), child_frame_id=names[0])
            message.transform = cv.transform_to_ros(pose(0.0))
            with patch.object(node.objects.states, "store", FAIL):
                self.send("object_transform", message)
            self.model.fail()
        self.heal(clears)

    @rule(0.5, by=one_of([-100.0, -0.3, 100.0]), fails=EITHER, clears=USUALLY)
    def jump(self, by: float = -100.0, fails: bool = False, clears: bool = False) -> None:
        """Set the clock to another time; forwards a simulation goes as fast as it likes."""
        markers, fails = self.node.inputs.markers, fails and by < 0.0
        self.apply()  # a stamp that waits would order those that come after it
        self.node.now()
        with patch.object(markers, "clock_jumped", FAIL if fails else markers.clock_jumped):
            self.world.advance(by, 0.0)
            self.node.now()
        if by < 0.0:
            self.model.jump(by)
        self.model.now, self.model.ticked = self.world.now, self.world.steady
        self.model.broken |= fails
        self.heal(fails and clears)

    @rule(2.0, step=one_of([0.2311, 0.4703, 1.3017]), says=USUALLY)
    def stand_still(self, step: float = 1.3017, says: bool = True) -> None:
        """Let the clock stand still while time goes by, and mostly somebody goes on to send."""
        self.world.advance(0.0, step)
        self.model.steady = self.world.steady
        if says:
            self.transform("a/0")
        self.cycle()

    @rule(0.5, silence=one_of([0.3017, 0.8917]))
    def block(self, silence: float = 0.8917) -> None:
        """Let no cycle end for some time."""
        self.tick()
        self.world.steady += silence
        self.node.status.look()
        self.compare(*["blocked"] * (silence > CYCLE_LIMIT))
        self.tick()

    @rule(0.5)
    def overload(self) -> None:
        """Let a message wait for longer than a cycle may take."""
        self.world.advance(0.0503)
        with patch.object(self.node.subscribed, "take_wait", lambda: 2.0 * CYCLE_LIMIT):
            self.cycle(waited=True)

    @rule(2.0, shift=EITHER)
    def steady_scene(self, shift: bool = False) -> None:
        """Send the same states again and again: nothing is said of it but what was said before."""
        kinds = []
        for step in (*[0.4703] * 6, *[0.1103] * 4):
            named = sorted(self.model.things.items())
            solid = [(name, thing) for name, thing in named if not thing.of_set]
            markers = [cube(key(n), (t.x or 0.0, 0, 0), [t.size] * 3) for n, t in solid]
            if markers:
                self.send("objects", MarkerArray(markers=markers))
                for marker, (name, thing) in zip(markers, solid, strict=True):
                    self.model.add(name, marker.pose.position.x, thing.size, "map", 0.0, "", 0.0)
            rows = [(name, thing) for name, thing in named if thing.of_set]
            if rows:
                first = key(rows[0][0])[1]
                self.boxes([(t.x or 0.0, t.size, "") for _, t in rows], first)
            if self.has_robot:
                self.base(0.7)
                self.joints([1.4, 3.0], None if shift else 0.0)
            self.see_all()
            self.tick(step)
            kinds.append(self.node.status.answer.kind)
        assert len({*kinds[6:]}) == 1, kinds
