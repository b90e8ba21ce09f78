"""Track attached and detached objects between the stretches of a certificate, and compare them with a program.

The file contains motions, the objects attached or detached between them, and the allowed contacts. Robots and scenes
are built here from those at the beginning. An attached object keeps its pose in the hand, and a detached object keeps
its pose in the world, so that objects cannot change shape or drift. Links that may touch an object must stay out of the
part of the object that is deeper than the allowed depth.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import pinocchio as pin

from safe_ompl.certificates.claims import ClaimedContact, ClaimedStretch
from safe_ompl.common import CertificateError, FloatArray
from safe_ompl.geometry import Obstacle, Pose
from safe_ompl.robot import Attachment, Robot
from safe_ompl.scene import CONTACT_DEPTH, Attach, Detach, Gripper, Scene, Step

# Depths are equal up to this relative difference, because they are written as decimal numbers.
_EQUAL_DEPTHS = 1e-9
# At the end of a step, gripper joints are this near to the values of the program, because files hold rounded numbers.
_GRIPPER_TOLERANCE = 1e-6  # [rad or m]


class RecordedCell:
    """The robot and the scene of a program as objects are attached and detached.

    Attributes
    ----------
    held : dict of str to Attachment
        The objects that the robot holds, by name.
    scene : Scene
        The obstacles around the robot.
    """

    def __init__(self, robot: Robot, scene: Scene) -> None:
        self._robot, self._first, self.scene = robot, scene, scene
        self.held = {item.name: item for item in robot.spec.attached}

    def change(self, stretch: ClaimedStretch, q: FloatArray) -> None:
        """Detach and attach the objects of a stretch, which begins at configuration `q`."""
        if not (stretch.detach or stretch.attach):
            return
        model = self._robot.bare.shared.model
        data = model.createData()
        pin.framesForwardKinematics(model, data, self._robot.bare.pinocchio_configuration(q))
        for name in stretch.detach:
            if name not in self.held:
                raise CertificateError(f"{name!r} is put down, but not held")
            item = self.held.pop(name)
            known = self._first[name] if name in self._first.names else Obstacle(name, item.shape)
            place = data.oMf[model.getFrameId(item.link)] * item.pose.se3
            self.scene = self.scene.with_obstacles(known.moved(Pose.of(place)))
        for name, link in stretch.attach.items():
            if name not in self.scene.names:
                raise CertificateError(f"{name!r} is taken, but is no obstacle")
            if link not in self._robot.bare.shared.tips:
                raise CertificateError(f"{name!r} is taken by {link!r}, which is the tip of no arm")
            taken = self.scene[name]
            place = data.oMf[model.getFrameId(link)].inverse() * taken.pose.se3
            self.held[name] = Attachment(name, taken.shape, link, Pose.of(place))
            self.scene = self.scene.without(name)

    def during(self, contacts: Iterable[ClaimedContact]) -> tuple[Robot, Scene]:
        """Return robot and scene with the given contacts allowed."""
        contacts, scene, held = tuple(contacts), self.scene, dict(self.held)
        if not contacts and tuple(held.values()) == self._robot.spec.attached:
            return self._robot, scene
        for contact in contacts:
            item = held.get(contact.object)
            if item is None:
                scene = scene.touched([(link, contact.object) for link in contact.links], contact.depth)
                continue
            deepest = max(contact.depth, item.touch_depth or 0.0)
            held[item.name] = replace(item, touch_links=(*item.touch_links, *contact.links), touch_depth=deepest)
        robot = self._robot.bare
        for item in held.values():
            robot = robot.holding(item)
        return robot, scene


class AllowedChanges:
    """The attached and detached objects and the contacts that the steps of a program allow, in order."""

    def __init__(self, steps: Sequence[Step], robot: Robot) -> None:
        self._robot, self._passed = robot, 0
        self._changes, self._contacts = list[tuple[str, str | None]](), [dict[tuple[str, str], float]()]
        self._depths: dict[tuple[str, str], float] = {}
        # Values of the gripper joints at each change, as set by earlier steps.
        grips, self._grips = dict[str, float](), list[dict[str, float]]()
        for step in steps:
            if isinstance(step, Gripper):
                grips |= step.joints
            if isinstance(step, (Attach, Detach)):
                self._grips.append(dict(grips))
                self._changes.append((step.object, self._tip(step)))
                self._contacts.append({})
            for pair in getattr(step, "touching", ()):
                for known in (self._contacts[-1], self._depths):
                    known[pair] = max(known.get(pair, 0.0), getattr(step, "depth", 0.0))

    def _tip(self, step: Step) -> str | None:
        """Return the tip that takes an object, or None if the object is put down."""
        if isinstance(step, Detach):
            return None
        arm = getattr(step, "arm", None)
        tips = self._robot.shared.tips
        return tips[0] if arm is None else next(tip for tip in tips if tip.startswith(f"{arm}_"))

    def check(self, stretch: ClaimedStretch, held: Mapping[str, Attachment], q: FloatArray) -> None:
        """Raise CertificateError unless the program allows the changes before a stretch and its contacts.

        The stretch begins at `q: (n,)`, where gripper joints must be as preceding gripper steps leave them.
        """
        changes = [*((name, None) for name in stretch.detach), *stretch.attach.items()]
        wanted = self._changes[self._passed : self._passed + len(changes)]
        if sorted(wanted, key=str) != sorted(changes, key=str):
            words = ", ".join(f"{name!r} {'put down' if tip is None else f'taken by {tip!r}'}" for name, tip in changes)
            raise CertificateError(f"{words}: the program of the scenario differs")
        grips = [grip for some in self._grips[self._passed : self._passed + len(changes)] for grip in some.items()]
        for name, value in grips:
            here = float(q[self._robot.joint_names.index(name)])
            if abs(here - value) > _GRIPPER_TOLERANCE:
                words = (
                    f"{name!r} is at {here:g} when {' and '.join(sorted(item for item, _ in changes))} changes hands"
                )
                raise CertificateError(f"{words}: the program has moved it to {value:g} by then")
        self._passed += len(changes)
        for contact in stretch.contacts:
            for link in contact.links:
                pair = link, contact.object
                deepest = self._contacts[self._passed].get(pair, 0.0)
                if contact.object in held and link in self._robot.hand_links(held[contact.object].link):
                    deepest = max(deepest, self._depths.get(pair, CONTACT_DEPTH))
                if contact.depth > deepest * (1 + _EQUAL_DEPTHS):
                    words = f"{link!r} may touch {contact.object!r} {1e3 * contact.depth:g} mm deep"
                    raise CertificateError(f"{words}: the program of the scenario allows {1e3 * deepest:g} mm there")
