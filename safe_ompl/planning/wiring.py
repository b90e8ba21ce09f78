"""Wiring: the plug-ins that a space information is given, ours and the user's own beside them."""

from __future__ import annotations

import atexit
from collections.abc import Mapping
from dataclasses import replace
from typing import Any
from weakref import ref

from safe_ompl.collision import FLOOR, CollisionChecker
from safe_ompl.common import Counts, InputError, positive
from safe_ompl.common import documents as document
from safe_ompl.danger import DangerField
from safe_ompl.planning.ompl import (
    RESOLUTION,
    AskedMotions,
    CertifiedMotionValidator,
    CollisionFreeValidity,
    ConfigurationCheck,
    Constraints,
    SampledValidity,
    StateBridge,
    UserCheck,
)
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene


class Wiring:
    """Gives a space information our state and motion validity, and takes over what the user sets there instead.

    A state validity checker or a motion validator of the user's own does not replace ours. Both checks apply to every
    query.

    Parameters
    ----------
    si : ob.SpaceInformation
        Its space must have the robot's joints as coordinates (see `joint_space`).
    checker : CollisionChecker
        Robot and scene.
    floor : float
        [m] As in `CertifiedMotionValidator`.

    Attributes
    ----------
    si : ob.SpaceInformation
        The space information.
    bridge : StateBridge
        Of its space.
    validity, validator : CollisionFreeValidity, CertifiedMotionValidator
        Our plug-ins.
    """

    def __init__(self, si: Any, checker: CollisionChecker, floor: float = FLOOR) -> None:
        self.si = si
        self.bridge = StateBridge(si.getStateSpace())
        self._resolution = RESOLUTION
        self._registered = False  # to let go of the user's checks when the program ends
        self.plug_in(CollisionFreeValidity(si, checker), CertifiedMotionValidator(si, checker, floor))

    def __repr__(self) -> str:
        return f"Wiring({self.checker!r})"

    def plug_in(self, validity: CollisionFreeValidity, validator: CertifiedMotionValidator) -> None:
        """Replace our own plug-ins; those of a user are asked besides ours."""
        self.validity, self.validator = validity, validator
        self.si.setStateValidityChecker(validity)
        self.si.setMotionValidator(validator)

    @property
    def checker(self) -> CollisionChecker:
        """Robot and scene."""
        return self.validity.checker

    @property
    def check(self) -> ConfigurationCheck:
        """The check of single configurations."""
        return self.validity.check

    @property
    def constraints(self) -> Constraints:
        """What configurations and motions must keep to."""
        return self.validity.getConstraints()

    def put(self, constraints: Constraints, checker: CollisionChecker | None = None) -> None:
        """Put other constraints in place, and perhaps the checker of another scene.

        Raises
        ------
        UnknownNameError
            If a constraint is about an obstacle that the scene does not have. Then all stays what it was.
        """
        if constraints.user and not self._registered:
            # A user's function refers to its module, which refers to the setup. The cycle closes in C++, where Python's
            # garbage collector cannot see it.
            atexit.register(_let_go, ref(self))
            self._registered = True
        self.validity.setConstraints(constraints, checker)
        self.validator.setConstraints(constraints, checker)

    # ----------------------------------------------------------------------------------- the user's own plug-ins

    def put_user_checker(self, checker: Any) -> None:
        """Ask a state validity checker of the user's own, too; None removes it.

        Raises
        ------
        InputError
            If it is no checker.
        """
        self._put_user_checks(self._sampled(checker), self._asked)
        self.si.setStateValidityChecker(self.validity)

    @property
    def resolution(self) -> float:
        """Distance [rad or m] between the samples of motions that the user's checker is asked about."""
        return self._resolution

    @resolution.setter
    def resolution(self, distance: float) -> None:
        self._resolution = positive(distance, "resolution", "distance in joint space [rad]")
        sampled = self.constraints.user_checker
        if sampled is not None:
            self._put_user_checks(self._sampled(sampled.checker), self._asked)

    def adopt(self) -> bool:
        """Take over the user's plug-ins that were set on the space information; return whether there were any.

        OMPL's bindings do not report when one is set, so planning and validation look for it.
        """
        checker, validator = self.si.getStateValidityChecker(), self.si.getMotionValidator()
        if checker is self.validity and validator is self.validator:
            return False
        sampled, asked = self.constraints.user_checker, self._asked
        if checker is not self.validity:
            sampled = self._sampled(checker)
        if validator is not self.validator:
            ours = self.validator.adds_nothing(validator)
            asked = None if ours else AskedMotions(validator, self.bridge)
        self._put_user_checks(sampled, asked)
        self.plug_in(self.validity, self.validator)
        return True

    @property
    def _asked(self) -> AskedMotions | None:
        return next((check for check in self.constraints.user if isinstance(check, AskedMotions)), None)

    def _sampled(self, checker: Any) -> SampledValidity | None:
        if checker is None or self.validity.adds_nothing(checker):
            return None
        return SampledValidity(checker, self.bridge, self._resolution)

    def _put_user_checks(self, *checks: UserCheck | None) -> None:
        given = tuple(check for check in checks if check is not None)
        self.put(replace(self.constraints, user=given))


def _let_go(wiring: ref[Wiring]) -> None:
    """Forget the user's checks at the end of the program; OMPL would report them as leaked."""
    alive = wiring()
    if alive is not None:
        alive.put(replace(alive.constraints, user=()))


def danger_field(
    robot: Robot, scene: Scene, options: Mapping[str, Any], counts: Counts | None = None
) -> DangerField:
    """Return the danger of a robot in a scene; options as `danger` of `SafeSetup`, errors as there."""
    if not isinstance(options, Mapping):
        raise InputError(f"danger must be a mapping of options, or None for none, got {options!r}")
    with document.within("danger"):
        document.check_keys(options, ("spacing", "aggregate", "weighting", "k1", "k2", "gamma", "sharpness"))
    options = dict(options)
    return DangerField.of_scene(robot, scene, options.pop("spacing", None), counts=counts, **options)
