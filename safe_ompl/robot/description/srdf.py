"""SRDF files: groups of joints and named states."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Collection, Iterator
from pathlib import Path

import pinocchio as pin

from safe_ompl.errors import InputError, UnknownNameError
from safe_ompl.robot.description.urdf import existing_file


class SrdfFile:
    """The groups and states of an SRDF.

    Parameters
    ----------
    path : path-like
        The SRDF.

    Raises
    ------
    InputError
        If the file is missing or is not an SRDF.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = existing_file(path, "SRDF")
        try:
            self._root = ElementTree.parse(self.path).getroot()
        except ElementTree.ParseError as error:
            raise InputError(f"not a valid SRDF ({error})", str(path)) from None

    @property
    def group_names(self) -> tuple[str, ...]:
        """The groups, in the order of the file."""
        return tuple(group.get("name", "") for group in self._root.findall("group"))

    @property
    def state_names(self) -> tuple[str, ...]:
        """The states, each once: several groups may have one of the same name."""
        return tuple(dict.fromkeys(state.get("name", "") for state in self._root.findall("group_state")))

    def state(self, name: str) -> dict[str, float]:
        """Return the joint values [rad or m] of the state `name`, of all groups that have it.

        Joints with more than one value (a floating base) are left out.

        Raises
        ------
        UnknownNameError
            If no group has it.
        """
        states = [state for state in self._root.findall("group_state") if state.get("name") == name]
        if not states:
            raise UnknownNameError("state", name, self.state_names, str(self.path))
        joints = [joint for state in states for joint in state.findall("joint")]
        return {
            joint.get("name", ""): self._value(joint, name)
            for joint in joints
            if len(joint.get("value", "").split()) == 1
        }

    def group_joints(self, name: str, full: pin.Model) -> tuple[str, ...]:
        """Return the movable joints of a group, in the order of `full`: of its chains, joints, links and subgroups.

        Raises
        ------
        InputError
            If there is no such group, it names what the robot has not, or it has no movable joint.
        """
        found = set(self._joints_of(name, full, ()))
        found -= {joint.get("name", "") for joint in self._root.findall("passive_joint")}
        ordered = tuple(joint for joint in list(full.names)[1:] if joint in found)
        if not ordered:
            raise InputError(f"group {name!r} has no movable joint", str(self.path))
        return ordered

    def group_tip(self, name: str, full: pin.Model) -> str | None:
        """Return the last link of a group that is one chain, else the link that carries its end effector, or None."""
        chains = self._group(name).findall("chain")
        carriers = [
            link for link, group in self.end_effectors() if group == name and full.existBodyName(link)
        ]
        if len(chains) == 1:
            return chains[0].get("tip_link")
        return carriers[0] if carriers else None

    def end_effectors(self) -> Iterator[tuple[str, str | None]]:
        """Yield of each end effector the link that carries it, and its group of joints above, where that is said."""
        for effector in self._root.findall("end_effector"):
            yield effector.get("parent_link", ""), effector.get("parent_group")

    def arm(self, full: pin.Model, tip: str, fingers: Collection[str]) -> tuple[str, str] | None:
        """Return the group of the arm, and the link at its end, as the SRDF says; None where it says nothing.

        The arm is that of the end effector with the most joints above it, the first one of several, unless `tip` has
        more (legs have end effectors, too). Of the groups whose joints all lie on the way from the base to that link,
        that of the end effector is taken, or the one with the fewest joints, but four at least: an arm, not an arm and
        its torso.

        Parameters
        ----------
        full : pin.Model
            All joints of the URDF.
        tip : str
            A link at the end of an arm.
        fingers : collection of str
            Joints that do not count.
        """

        def depth(end: tuple[str, str | None]) -> int:
            return len(full.supports[full.frames[full.getBodyId(end[0])].parentJoint])

        ends = [end for end in self.end_effectors() if full.existBodyName(end[0])]
        link, parent = max([*ends, (tip, None)], key=depth)
        joint = full.frames[full.getBodyId(link)].parentJoint
        above = {full.names[j] for j in list(full.supports[joint])[1:]}
        groups = {}
        for name in self.group_names:
            try:
                joints = set(self.group_joints(name, full)).difference(fingers)
            except InputError:  # of joints that this robot has not
                continue
            if joints and above.issuperset(joints):
                groups[name] = len(joints)
        if not groups:
            return None
        if parent not in groups:
            enough = {name: number for name, number in groups.items() if number >= 4}
            parent = min(enough, key=enough.__getitem__) if enough else max(groups, key=groups.__getitem__)
        last = self.group_tip(parent, full)
        return parent, last if link == tip and last is not None else link

    def _group(self, name: str) -> ElementTree.Element:
        for group in self._root.findall("group"):
            if group.get("name") == name:
                return group
        raise UnknownNameError("group", name, self.group_names, str(self.path))

    def _joints_of(self, name: str, full: pin.Model, above: tuple[str, ...]) -> Iterator[str]:
        if name in above:
            raise InputError(f"group {name!r} contains itself", str(self.path))
        for entry in self._group(name):
            named = entry.get("name", "")
            if entry.tag == "group":
                yield from self._joints_of(named, full, (*above, name))
            elif entry.tag == "joint":
                self._known(full, named, name)
                yield named
            elif entry.tag == "link":
                yield full.frames[full.frames[self._link(full, named, name)].parentFrame].name
            elif entry.tag == "chain":
                yield from self._chain(full, entry, name)

    def _chain(self, full: pin.Model, chain: ElementTree.Element, group: str) -> Iterator[str]:
        base, at = (self._link(full, chain.get(key, ""), group) for key in ("base_link", "tip_link"))
        while at != base:
            if at == 0:
                raise InputError(
                    f"group {group!r}: {chain.get('tip_link')!r} is not above {chain.get('base_link')!r}",
                    str(self.path),
                )
            yield full.frames[at].name
            at = full.frames[at].parentFrame

    def _link(self, full: pin.Model, name: str, group: str) -> int:
        if not full.existBodyName(name):
            links = (frame.name for frame in full.frames if frame.type == pin.FrameType.BODY)
            raise UnknownNameError(f"link of group {group!r}", name, links, str(self.path))
        return int(full.getBodyId(name))

    def _known(self, full: pin.Model, joint: str, group: str) -> None:
        if not any(frame.name == joint for frame in full.frames):
            raise UnknownNameError(f"joint of group {group!r}", joint, list(full.names)[1:], str(self.path))

    def _value(self, joint: ElementTree.Element, state: str) -> float:
        try:
            return float(joint.get("value", ""))
        except ValueError:
            text = f"state {state!r}: {joint.get('value')!r} of joint {joint.get('name')!r} is not a number"
            raise InputError(text, str(self.path)) from None
