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

"""SRDF: pairs of links not to check, groups, end effectors and the virtual joint of a robot."""

from __future__ import annotations

from typing import NamedTuple

from obb_collision.robots.description.urdf import Joint, JointKind
from obb_collision.robots.description.xml_values import Element, limited, named

#: Maximum number of groups, and of their elements in all: a hundred times those of large robots.
MOST_GROUPS, MOST_MEMBERS = 1000, 10_000
#: Maximum number of doubts that are kept; a file with more has one cause.
MOST_DOUBTS = 100
#: Pairs of links, each sorted.
Pairs = frozenset[tuple[str, str]]
#: The kinds of virtual joints.
VIRTUAL = {"fixed": JointKind.FIXED, "planar": JointKind.PLANAR, "floating": JointKind.FLOATING}


class VirtualJoint(NamedTuple):
    """The joint between a frame of the world and the root link."""

    name: str
    kind: JointKind
    parent_frame: str
    child_link: str


class Group(NamedTuple):
    """Joints and links that are planned for together, in the order of the tree."""

    joints: tuple[str, ...]
    links: tuple[str, ...]


class Semantics(NamedTuple):
    """The content of an SRDF.

    doubts: names that the robot does not have, and other faults that were ignored, one line each;
    unknown: the names of links among them.
    """

    virtual_joint: VirtualJoint | None
    disabled: Pairs
    enabled: Pairs
    default_disabled: tuple[str, ...]
    groups: dict[str, Group]
    group_states: dict[tuple[str, str], dict[str, tuple[float, ...]]]
    end_effectors: dict[str, str]
    doubts: tuple[str, ...]
    unknown: tuple[str, ...]


NO_SEMANTICS = Semantics(None, frozenset(), frozenset(), (), {}, {}, {}, (), ())


def sorted_pair(a: str, b: str) -> tuple[str, str]:
    """Return two names in alphabetical order."""
    return (a, b) if a <= b else (b, a)


def read_srdf(srdf: Element, name: str, links: tuple[str, ...], joints: list[Joint]) -> Semantics:
    """Read an SRDF; RobotError names file, line and element."""
    if srdf.tag != "robot":
        raise srdf.refuse("the root of an SRDF is <robot>")
    if srdf.word("name") != name:
        raise srdf.refuse(
            f"the URDF is of robot {name!r}: with the SRDF of another one, links that can collide "
            "would not be checked; give both the same name if they are of one robot"
        )
    reader = _Reader(srdf, links, joints)
    elements = srdf.children("disable_default_collisions")
    defaults = [reader.link(element, "link") for element in elements]
    disabled = reader.pairs("disable_collisions")
    return Semantics(
        reader.virtual_joint(),
        disabled,
        reader.pairs("enable_collisions"),
        tuple(dict.fromkeys(link for link in defaults if link is not None)),
        reader.groups(),
        reader.group_states(),
        reader.end_effectors(),
        tuple(reader.doubts),
        tuple(reader.unknown),
    )


class _Reader:
    """Reads an SRDF; unknown names are doubts and not errors, as in MoveIt."""

    def __init__(self, srdf: Element, links: tuple[str, ...], joints: list[Joint]) -> None:
        self._srdf, self._links, self._joints = srdf, links, joints
        self._parents = {joint.child: joint for joint in joints}
        self._by_name = {joint.name: joint for joint in joints}
        self._is_link = frozenset(links)
        self.doubts: list[str] = []
        self.unknown: dict[str, None] = {}

    def doubt(self, element: Element, reason: str) -> None:
        """Note a fault that is ignored."""
        if len(self.doubts) < MOST_DOUBTS:
            self.doubts.append(str(element.refuse(reason)))

    def link(self, element: Element, key: str) -> str | None:
        """Return the link that an attribute names; None, with a doubt, if there is none."""
        name = element.word(key)
        if name in self._is_link:
            return name
        self.unknown[name] = None
        self.doubt(element, f"its {key} {name!r} is not a link of the robot")
        return None

    def pairs(self, tag: str) -> Pairs:
        """Return the pairs of all elements of a tag."""
        elements = self._srdf.children(tag)
        links = [(self.link(e, "link1"), self.link(e, "link2")) for e in elements]
        return frozenset(sorted_pair(a, b) for a, b in links if a is not None and b is not None)

    def virtual_joint(self) -> VirtualJoint | None:
        """Return the virtual joint of the root link; note further virtual joints as doubts."""
        chosen = None
        for element in self._srdf.children("virtual_joint"):
            kind, child = element.choice("type", VIRTUAL), element.word("child_link")
            joint = VirtualJoint(element.word("name"), kind, element.word("parent_frame"), child)
            if joint.name in self._by_name:
                raise element.refuse("a joint of the URDF has the same name")
            if child != self._links[0]:
                self.doubt(element, f"its child_link {child!r} is not the root of the robot")
            elif chosen is not None:
                self.doubt(element, "there is another virtual joint of the root")
            else:
                chosen = joint
        return chosen

    def groups(self) -> dict[str, Group]:
        """Return all groups, including the members of their subgroups."""
        groups = limited(self._srdf.children("group"), MOST_GROUPS, "groups")
        limited([part for g in groups for part in g.children()], MOST_MEMBERS, "parts of groups")
        elements = named(groups, "group")
        members = {name: self._members(element) for name, element in elements.items()}
        return {name: self._group(name, elements, members) for name in elements}

    def _group(
        self,
        name: str,
        elements: dict[str, Element],
        members: dict[str, tuple[set[str], list[str]]],
    ) -> Group:
        """Return a group, including the members of its subgroups."""
        visited, waiting = {name}, [name]
        links: set[str] = set()
        while waiting:
            own, below = members[waiting.pop()]
            links |= own
            if name in below:
                raise elements[name].refuse("it is a part of itself")
            new = [other for other in below if other in members and other not in visited]
            visited.update(new)
            waiting += new
        return Group(
            tuple(joint.name for joint in self._joints if joint.child in links),
            tuple(link for link in self._links if link in links),
        )

    def _members(self, group: Element) -> tuple[set[str], list[str]]:
        """Return the links of a group's own elements, and the names of its subgroups.

        A joint brings its child link, and a link the joint above it.
        """
        links: set[str] = set()
        below: list[str] = []
        for element in group.children():
            if element.tag == "group":
                below.append(element.word("name"))
            elif element.tag == "chain":
                links.update(joint.child for joint in self._chain(element))
            elif element.tag == "joint":  # the virtual joint is not in the URDF
                joint = self._by_name.get(element.word("name"))
                links |= set() if joint is None else {joint.child}
            elif element.tag == "link" and (link := self.link(element, "name")) is not None:
                links.add(link)
        return links, below

    def _chain(self, element: Element) -> list[Joint]:
        """Return the joints from the base of a chain to its tip."""
        base, tip = self.link(element, "base_link"), self.link(element, "tip_link")
        chain: list[Joint] = []
        while base is not None and tip is not None and tip != base:
            if tip not in self._parents:
                self.doubt(element, "its base_link is not above its tip_link")
                return []
            chain.append(self._parents[tip])
            tip = chain[-1].parent
        return chain

    def end_effectors(self) -> dict[str, str]:
        """Return the group of each end effector, by its name."""
        tools = limited(self._srdf.children("end_effector"), MOST_GROUPS, "end effectors")
        return {element.word("name"): element.word("group") for element in tools}

    def group_states(self) -> dict[tuple[str, str], dict[str, tuple[float, ...]]]:
        """Return the values of joints by group and name of the state."""
        states: dict[tuple[str, str], dict[str, tuple[float, ...]]] = {}
        for state in self._srdf.children("group_state"):
            values = {}
            for element in state.children("joint"):
                count = len(element.text("value").split())
                values[element.word("name")] = element.numbers("value", max(count, 1))
            states[state.word("group"), state.word("name")] = values
        return states
