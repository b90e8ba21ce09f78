"""SRDF files: reading groups and end effectors, and writing disabled collision pairs."""

from __future__ import annotations

import logging
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import pinocchio as pin

from safe_ompl.common import InputError, UnknownNameError, number, within
from safe_ompl.robot.collision import (
    adjacent_pairs,
    always_in_contact,
    build_collision_geometry,
    make_convex,
    sample_configurations,
)
from safe_ompl.robot.joints import limits_of
from safe_ompl.robot.urdf import PackageDir, PackageFolders, UrdfFile, existing_file, read_xml

_log = logging.getLogger(__name__)


class SrdfFile:
    """The groups and the disabled collision pairs of an SRDF. Raises InputError if the file is missing or not an SRDF.

    A file with xacro is expanded as in `UrdfFile`.
    """

    def __init__(
        self,
        path: str | Path,
        package_dirs: Sequence[str | PackageDir] = (),
        xacro_args: Mapping[str, str] | None = None,
    ) -> None:
        self.path = existing_file(path, "SRDF")
        self._root, _ = read_xml(self.path, str(path), PackageFolders(self.path, package_dirs), xacro_args, "SRDF")
        self._disabled, self._enabled = (self._pairs_of(f"{word}_collisions") for word in ("disable", "enable"))
        tags = self._root.iter("disable_default_collisions")
        self._off_by_default = frozenset(tag.get("link", "") for tag in tags)

    def _pairs_of(self, tag: str) -> frozenset[frozenset[str]]:
        return frozenset(frozenset((pair.get("link1", ""), pair.get("link2", ""))) for pair in self._root.iter(tag))

    def disables(self, first: str, second: str) -> bool:
        """Return whether the SRDF disables the collision check of two links.

        As in MoveIt, `disable_collisions` precedes `enable_collisions`, which precedes `disable_default_collisions`.
        """
        pair = frozenset((first, second))
        return pair in self._disabled or not (pair in self._enabled or pair.isdisjoint(self._off_by_default))

    def text(self) -> str:
        """Return the text of the SRDF after the expansion of xacro."""
        return ElementTree.tostring(self._root, encoding="unicode")

    def group_state(self, name: str, group: str | None) -> dict[str, float]:
        """Return the joint values of a group state [rad or m], preferably that of `group`.

        Joints with several values are left out. Raises UnknownNameError, with the known states, if there is no such
        state; InputError if a value is not a number, or if several groups have different states of this name.
        """
        states = [state for state in self._root.findall("group_state") if state.get("name") == name]
        if not states:
            known = dict.fromkeys(state.get("name", "") for state in self._root.findall("group_state"))
            raise UnknownNameError("group state", name, known, str(self.path))
        found: dict[str, str] = {}
        for state in [state for state in states if state.get("group") == group] or states:
            for joint in state.findall("joint"):
                word, text = joint.get("name", ""), joint.get("value", "")
                if found.setdefault(word, text) != text:
                    groups = ", ".join(state.get("group", "") for state in states)
                    contradiction = f"{name!r} is a state of the groups {groups}, with other values of {word!r}"
                    raise InputError(f"{contradiction}: choose one by the robot's group", str(self.path))
        with within(f"{self.path}: group_state {name!r}: joint ", ""):
            return {word: _finite(word, text) for word, text in found.items() if len(text.split()) <= 1}

    def group_joints(self, name: str, full: pin.Model) -> tuple[str, ...]:
        """Return the movable joints of a group's chains, joints, links and subgroups, in the order of `full`."""
        found = set(self._joints_of(name, full, ()))
        found -= {joint.get("name", "") for joint in self._root.findall("passive_joint")}
        ordered = tuple(joint for joint in list(full.names)[1:] if joint in found)
        if not ordered:
            raise InputError(f"group {name!r} has no movable joint", str(self.path))
        return ordered

    def group_tip(self, name: str, full: pin.Model) -> str | None:
        """Return the tip link of a group with one chain, else the link that carries its end effector, or None."""
        chains = self._group(name).findall("chain")
        carriers = [link for link, group in self.end_effectors() if group == name and full.existBodyName(link)]
        if len(chains) == 1:
            return chains[0].get("tip_link")
        return carriers[0] if carriers else None

    def end_effectors(self) -> Iterator[tuple[str, str | None]]:
        """Yield `parent_link` and `parent_group` (or None) of each end effector."""
        for effector in self._root.findall("end_effector"):
            yield effector.get("parent_link", ""), effector.get("parent_group")

    def arm(self, full: pin.Model, tip: str, fingers: Collection[str]) -> tuple[str, str] | None:
        """Return the group of the arm and the link at its end according to the SRDF, or None if it does not say.

        The arm carries the end effector with the most joints above it, unless `tip`, a link at the end of an arm, has
        more (legs have end effectors, too). Among the groups whose joints all lie on the chain to this link, the
        parent group of the end effector is chosen, or the smallest group of at least four joints, which is not a torso.
        The joints of `fingers` do not count.
        """

        def depth(end: tuple[str, str | None]) -> int:
            return len(full.supports[full.frames[full.getBodyId(end[0])].parentJoint])

        ends = [end for end in self.end_effectors() if full.existBodyName(end[0])]
        link, parent = max([*ends, (tip, None)], key=depth)
        joint = full.frames[full.getBodyId(link)].parentJoint
        above = {full.names[j] for j in list(full.supports[joint])[1:]}
        groups = {}
        for name in (group.get("name", "") for group in self._root.findall("group")):
            try:
                joints = set(self.group_joints(name, full)).difference(fingers)
            except InputError:
                # The group has joints that this robot does not have.
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
        known = (group.get("name", "") for group in self._root.findall("group"))
        raise UnknownNameError("group", name, known, str(self.path))

    def _joints_of(self, name: str, full: pin.Model, above: tuple[str, ...]) -> Iterator[str]:
        if name in above:
            raise InputError(f"group {name!r} contains itself", str(self.path))
        for entry in self._group(name):
            named = entry.get("name", "")
            if entry.tag == "group":
                yield from self._joints_of(named, full, (*above, name))
            elif entry.tag == "joint":
                if not any(frame.name == named for frame in full.frames):
                    known = list(full.names)[1:]
                    raise UnknownNameError(f"joint of group {name!r}", named, known, str(self.path))
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


def _finite(name: str, text: str) -> float:
    try:
        return number(name, float(text))
    except ValueError:
        raise InputError(f"must have a finite number as its value, got {text!r}", name) from None


class DisabledLinks(NamedTuple):
    """Two links that are not checked against each other, with the reason "Adjacent" or "Always"."""

    first: str
    second: str
    reason: str


def disabled_links(urdf: UrdfFile, samples: int, collision: str = "required") -> list[DisabledLinks]:
    """Return the pairs of links that a robot without an SRDF does not check, with all joints free, on convex hulls.

    Pairs that are not in contact in any of the samples remain checked, since samples do not prove absence of contact.
    """
    model = urdf.build_model()
    geometry = build_collision_geometry(urdf, model, collision)
    make_convex(geometry)
    geometry.addAllCollisionPairs()
    names = [model.frames[body.parentFrame].name for body in geometry.geometryObjects]

    def links(pairs: Iterable[pin.CollisionPair]) -> Counter[tuple[str, str]]:
        """Count the pairs of shapes of each pair of links."""
        return Counter((names[pair.first], names[pair.second]) for pair in pairs)

    adjacent, together = adjacent_pairs(model, geometry), links(geometry.collisionPairs)
    for pair in adjacent:
        geometry.removeCollisionPair(pair)
    ranges = {name for name in list(model.names)[1:] if limits_of(model, name)}
    mimics = {name: mimic for name, mimic in urdf.mimics().items() if {name, mimic.primary} <= ranges}
    always = always_in_contact(model, geometry, sample_configurations(model, samples, mimics))
    found = [DisabledLinks(a, b, "Adjacent") for a, b in links(adjacent)]
    for (a, b), count in links(always).items():
        if count == together[a, b]:
            found.append(DisabledLinks(a, b, "Always"))
        else:
            _log.info("%s, %s: only some of their shapes always touch; an SRDF cannot say which", a, b)
    return found


def srdf_text(robot: str, pairs: Iterable[DisabledLinks], samples: int) -> str:
    """Return an SRDF for the named robot. A comment in the file gives the number of samples."""
    # This module imports network modules. Only the writing of files needs it, so it is imported here.
    from xml.sax.saxutils import quoteattr

    disabled = "".join(
        f"  <disable_collisions link1={quoteattr(pair.first)} link2={quoteattr(pair.second)} "
        f"reason={quoteattr(pair.reason)}/>\n"
        for pair in pairs
    )
    return (
        '<?xml version="1.0"?>\n'
        f"<!-- Always: in contact in more than 95 % of {samples} configurations spread over the joint limits. -->\n"
        f"<robot name={quoteattr(robot)}>\n{disabled}</robot>\n"
    )
