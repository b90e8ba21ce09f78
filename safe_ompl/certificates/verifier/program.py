"""Verifies the certificate of a program: each stretch on its own, and that together they are one motion.

The file carries motions, which objects change hands between them, and which contacts are allowed; robots and scenes are
built here from those that the program begins with. What is taken stays where it is in the hand, and what is put down
where it is in the world, so that nothing can change its shape or drift. What may touch an object must stay out of all
that is deeper in it than is said.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.certificates.claims import RATES, ClaimedContact, ProgramCertificate, StretchClaims, at_most
from safe_ompl.certificates.verifier.bodies import Budget
from safe_ompl.certificates.verifier.polynomials import RecordedMotion
from safe_ompl.certificates.verifier.verify import (
    TIME,
    Terms,
    Verified,
    check_digest,
    malformed_refused,
    not_covered,
    origin,
    proven,
)
from safe_ompl.common import CertificateError, FloatArray, documents as document, number
from safe_ompl.geometry import Obstacle, Pose
from safe_ompl.robot import Attachment, Robot
from safe_ompl.scene import CONTACT_DEPTH, Attach, Detach, Program, Scene, Step

# Depths whose relative difference is below this are the same: they are written as decimal numbers.
_DEEPER = 1e-9


class RecordedCell:
    """The robot and the scene of a program as objects change hands.

    Attributes
    ----------
    held : dict of str to Attachment
        What the robot holds, by name.
    scene : Scene
        What stands about it.
    """

    def __init__(self, robot: Robot, scene: Scene) -> None:
        self._first, self.scene = scene, scene
        self._empty = Robot(replace(robot.spec, attached=())) if robot.spec.attached else robot
        self._data = self._empty.shared.model.createData()
        self.held = {item.name: item for item in robot.spec.attached}

    def change(self, stretch: StretchClaims, q: FloatArray) -> None:
        """Put down and take what changes hands before a stretch, where the robot is at `q`."""
        model = self._empty.shared.model
        pin.framesForwardKinematics(model, self._data, self._empty.pinocchio_configuration(q))
        for name in stretch.detach:
            if name not in self.held:
                raise CertificateError(f"{name!r} is put down, but not held")
            item = self.held.pop(name)
            known = self._first[name] if name in self._first.names else Obstacle(name, item.shape)
            place = self._data.oMf[model.getFrameId(item.link)] * item.pose.se3
            self.scene = self.scene.with_obstacles(known.moved(Pose.of(place)))
        for name, link in stretch.attach.items():
            if name not in self.scene.names:
                raise CertificateError(f"{name!r} is taken, but is no obstacle")
            if link not in self._empty.shared.tips:
                raise CertificateError(f"{name!r} is taken by {link!r}, which is the tip of no arm")
            taken = self.scene[name]
            place = self._data.oMf[model.getFrameId(link)].inverse() * taken.pose.se3
            self.held[name] = Attachment(name, taken.shape, link, Pose.of(place))
            self.scene = self.scene.without(name)

    def during(self, contacts: Iterable[ClaimedContact]) -> tuple[Robot, Scene]:
        """Return robot and scene while some contacts are allowed."""
        robot, scene, held = self._empty, self.scene, dict(self.held)
        for contact in contacts:
            item = held.get(contact.object)
            if item is None:
                scene = scene.touched([(link, contact.object) for link in contact.links], contact.depth)
                continue
            deepest = max(contact.depth, item.touch_depth or 0.0)
            held[item.name] = replace(item, touch_links=(*item.touch_links, *contact.links), touch_depth=deepest)
        for item in held.values():
            robot = robot.holding(item)
        return robot, scene


class _Allowed:
    """What the program of a scenario says of objects that change hands, and of contacts, in the order of its steps."""

    def __init__(self, program: Program, robot: Robot) -> None:
        self._robot, self._passed = robot, 0
        self._changes, self._contacts = list[tuple[str, str | None]](), [dict[tuple[str, str], float]()]
        self._depths: dict[tuple[str, str], float] = {}
        for step in program.steps:
            if isinstance(step, (Attach, Detach)):
                self._changes.append((step.object, self._tip(step)))
                self._contacts.append({})
            for pair in getattr(step, "touching", ()):
                for known in (self._contacts[-1], self._depths):
                    known[pair] = max(known.get(pair, 0.0), getattr(step, "depth", 0.0))

    def _tip(self, step: Step) -> str | None:
        """Return the tip that takes an object; None where it is put down."""
        if isinstance(step, Detach):
            return None
        arm = getattr(step, "arm", None)
        tips = self._robot.shared.tips
        return tips[0] if arm is None else next(tip for tip in tips if tip.startswith(f"{arm}_"))

    def check(self, stretch: StretchClaims, held: Mapping[str, Attachment]) -> None:
        """Raise CertificateError unless the program says what changes hands before a stretch, and may touch on it."""
        changes = [*((name, None) for name in stretch.detach), *stretch.attach.items()]
        wanted = self._changes[self._passed : self._passed + len(changes)]
        if sorted(wanted, key=str) != sorted(changes, key=str):
            said = ", ".join(f"{name!r} {'put down' if tip is None else f'taken by {tip!r}'}" for name, tip in changes)
            raise CertificateError(f"{said}: the program of the scenario has it otherwise")
        self._passed += len(changes)
        for contact in stretch.contacts:
            for link in contact.links:
                pair = link, contact.object
                deepest = self._contacts[self._passed].get(pair, 0.0)
                if contact.object in held and link in self._robot.hand_links(held[contact.object].link):
                    deepest = max(deepest, self._depths.get(pair, CONTACT_DEPTH))
                if contact.depth > deepest * (1 + _DEEPER):
                    words = f"{link!r} may touch {contact.object!r} {1e3 * contact.depth:g} mm deep"
                    raise CertificateError(f"{words}: the program of the scenario allows {1e3 * deepest:g} mm there")


def verify_program(
    content: Mapping[str, Any],
    robot: Robot | None = None,
    scene: Scene | None = None,
    *,
    terms: Terms | None = None,
    package_dirs: Sequence[Path] = (),
    time: float = TIME,
) -> Verified:
    """Check the certificate of a program: every stretch as `verify` does, and that they are one motion.

    Parameters
    ----------
    content : mapping
        The certificate.
    robot, scene : Robot, Scene, optional
        What it must begin with; default: what the file carries, and then it says nothing of any other.
    terms, package_dirs, time
        As for `verify`; the time is for all stretches together.

    Raises
    ------
    CertificateError
        If anything in it does not hold: names the stretch.
    InputError
        As `verify`.
    """
    budget = Budget(number("time", time, above=0.0, kind="number of seconds"))
    with malformed_refused():
        program = ProgramCertificate.read(content)
        about = origin(program, robot, scene, package_dirs)
        cell, last, counts = RecordedCell(about.robot, about.scene), None, np.zeros(3, dtype=int)
        allowed = None if terms is None or terms.program is None else _Allowed(terms.program, about.robot)
        for k, stretch in enumerate(program.stretches):
            with _naming(k):
                stretch.motion.check_for(about.robot)
                last = RecordedMotion(stretch.motion, last)
                last.check_joined()
                cell.change(stretch, last.begin[0])
                if allowed is not None:
                    allowed.check(stretch, cell.held)
                if terms is not None:
                    terms.check(stretch)
                counts += proven(stretch, *cell.during(stretch.contacts), budget, last)
        check_digest(program.digest, content)
        edges, intervals, distances = counts.tolist()
        return Verified(
            edges,
            intervals,
            distances,
            claims=_sentences(program.stretches, about.words),
            not_claimed=_not_claimed(program.stretches),
            not_covered=tuple(not_covered(about.robot, about.scene)),
            robot=about.robot.name,
            obstacles=about.scene.names,
            own=about.own,
        )


def _sentences(stretches: Sequence[StretchClaims], about: str) -> tuple[str, ...]:
    """Return what holds of all stretches together."""
    spans = [float(stretch.motion.times[-1] - stretch.motion.times[0]) for stretch in stretches if stretch.motion.timed]
    said = [f"every motion of {len(stretches)} stretches is free{about}"]
    lasts = f" of {sum(spans):.3f} s" if len(spans) == len(stretches) else ""
    joined = "they are one motion" if spans else "they are one path"
    others = f", {len(stretches) - len(spans)} stretches of which are not in time" if spans and not lasts else ""
    smooth = ", without jumps of velocity" if lasts and len(stretches) > 1 else ""
    said.append(f"{joined}{lasts}{others}{smooth}")
    holds: dict[tuple[str, str], list[int]] = {}
    touch: dict[tuple[tuple[str, ...], str, float], list[int]] = {}
    held: dict[str, str] = {}
    for k, stretch in enumerate(stretches):
        held = {name: link for name, link in held.items() if name not in stretch.detach} | dict(stretch.attach)
        for name, link in held.items():
            holds.setdefault((name, link), []).append(k)
        for contact in stretch.contacts:
            touch.setdefault((contact.links, contact.object, contact.depth), []).append(k)
    said += [f"{link} holds {name}, where it took it, in {_numbers(k)}" for (name, link), k in holds.items()]
    for (links, name, depth), numbers in touch.items():
        deep = f"no deeper than {at_most(1e3 * depth)} mm"
        said.append(f"{' and '.join(links)} may touch {name}, {deep}, in {_numbers(numbers)}")
    if touch:
        said.append("nothing else touches, but what is held and the links that do not move against its tip")
    first, *others_ = ([*stretch.sentences("")[1:]] for stretch in stretches)
    own = {stretch.motion.sentences[0] for stretch in stretches}
    return (*said, *(claim for claim in first if claim not in own and all(claim in one for one in others_)))


def _not_claimed(stretches: Sequence[StretchClaims]) -> tuple[str, ...]:
    """Return what could be claimed of some stretch, and is not; one that is not in time has no rates to claim."""
    rates = [() if stretch.motion.timed else tuple(RATES) for stretch in stretches]
    both = zip(stretches, rates, strict=True)
    return tuple(dict.fromkeys(name for stretch, more in both for name in (*stretch.not_claimed, *more)))


def _numbers(numbers: Sequence[int]) -> str:
    """Return stretches by their numbers, which are in order, neighbours as a range."""
    runs: list[list[int]] = []
    for k in numbers:
        if runs and runs[-1][-1] == k - 1:
            runs[-1].append(k)
        else:
            runs.append([k])
    named = (str(run[0]) if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs)
    return f"{'stretch' if len(numbers) == 1 else 'stretches'} {', '.join(named)}"


@contextmanager
def _naming(stretch: int) -> Iterator[None]:
    """Put the number of a stretch before every error."""
    try:
        with document.within(f"stretch {stretch}", ": "), malformed_refused():
            yield
    except CertificateError as error:
        raise CertificateError(f"stretch {stretch}: {error}") from None
