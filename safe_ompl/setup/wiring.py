"""OMPL's SimpleSetup wired with the plug-ins of a robot in a scene, and with the user's own beside them."""

from __future__ import annotations

import atexit
import logging
from collections.abc import Mapping, Sequence
from typing import Any
from weakref import ref

import numpy as np
from numpy.typing import ArrayLike
from ompl import base as ob
from ompl import geometric as og

from safe_ompl import document
from safe_ompl.arrays import FloatArray, finite_array, positive
from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.motion import FLOOR, CertifiedMotion
from safe_ompl.counts import Counts
from safe_ompl.danger.field import DangerField
from safe_ompl.errors import InputError
from safe_ompl.paths.report import PathReport
from safe_ompl.paths.validation import Validation, validate
from safe_ompl.plugins.motion import CertifiedMotionValidator
from safe_ompl.plugins.objective import DangerObjective
from safe_ompl.plugins.states import StateBridge, joint_space
from safe_ompl.plugins.user_checks import RESOLUTION, AskedMotions, SampledValidity, UserCheck
from safe_ompl.plugins.validity import CollisionFreeValidity
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scene import Scene

_log = logging.getLogger(__name__)


class WiredSetup(og.SimpleSetup):  # type: ignore[misc]
    """The part of `SafeSetup` that holds the plug-ins, and looks at paths with them; parameters as there.

    A state validity checker or a motion validator of the user's own does not replace ours: states and motions must
    pass both, whoever asks.
    """

    def __init__(
        self,
        robot: Robot,
        scene: Scene,
        *,
        danger: Mapping[str, Any] | None = {},
        floor: float = FLOOR,
        movable: Sequence[str] = (),
    ) -> None:
        super().__init__(joint_space(robot))
        si = self.getSpaceInformation()
        self.robot = robot
        self.scene = scene
        self.counts = Counts()
        self.checker = CollisionChecker(robot, scene, self.counts, movable=movable)
        self.field = None if danger is None else danger_field(robot, scene, danger, self.counts)
        self.danger_options = None if danger is None else dict(danger)
        self._bridge = StateBridge(self.getStateSpace())
        self._sampled: SampledValidity | None = None  # the user's checker
        self._asked: AskedMotions | None = None  # the user's motion validator
        self._resolution = RESOLUTION
        self._registered = False  # to let go of the user's checks when the program ends
        self._validity = CollisionFreeValidity(si, self.checker)
        super().setStateValidityChecker(self._validity)
        self._validator = CertifiedMotionValidator(si, self.checker, floor)
        si.setMotionValidator(self._validator)
        if self.field is not None:
            self.setOptimizationObjective(DangerObjective(si, self.field))

    # ------------------------------------------------------------------------------- the user's own plug-ins

    def setStateValidityChecker(self, checker: Any) -> None:
        """Have only states that a checker of the user's own accepts, besides being within limits and free.

        Planners, motions, simplification, goals and reports obey it. Nothing can be proven of it: motions are sampled
        (`setSamplingResolution`), and reports say so. A checker that is set on the space information itself is taken
        over by the next `setup`, `solve`, `plan`, `report` or the like.

        Parameters
        ----------
        checker : ob.StateValidityChecker, callable or None
            Answers for a state with a bool; what it raises arrives unchanged. None: there is none any more.

        Raises
        ------
        InputError
            If it is nothing of the kind.
        """
        self._take_checker(self._sampled_version(checker))

    def _sampled_version(self, checker: Any) -> SampledValidity | None:
        if checker is None or self._validity.adds_nothing(checker):
            return None
        return SampledValidity(checker, self._bridge, self._resolution)

    def _take_checker(self, checker: SampledValidity | None) -> None:
        self._sampled = checker
        super().setStateValidityChecker(self._validity)
        self._take_user_checks()

    def setSamplingResolution(self, distance: float) -> None:
        """Set the distance [rad or m] in joint space between the samples of motions that the user's checker is asked.

        Raises
        ------
        InputError
            If it is not positive.
        """
        self._resolution = positive(distance, "resolution", "distance in joint space [rad]")
        if self._sampled is not None:
            self._take_checker(SampledValidity(self._sampled.checker, self._bridge, self._resolution))

    def getSamplingResolution(self) -> float:
        """Return the distance [rad or m] between the samples of motions that the user's checker is asked about."""
        return self._resolution

    @property
    def user_checks(self) -> tuple[UserCheck, ...]:
        """The user's own state validity checker and motion validator, as far as there are."""
        return tuple(check for check in (self._sampled, self._asked) if check is not None)

    def _take_user_checks(self) -> None:
        if self.user_checks and not self._registered:
            # A function knows its module, and that the setup: no collector finds the way back, which is C++'s.
            atexit.register(_let_go, ref(self))
            self._registered = True
        self._validity.setUserChecks(self.user_checks)
        self._validator.setUserChecks(self.user_checks)

    def _adopt_plugins(self) -> bool:
        """Take over the user's plug-ins that were set on the space information; return whether there were any.

        OMPL's bindings do not tell when one is set there: whoever plans or judges looks.
        """
        si = self.getSpaceInformation()
        checker, validator = si.getStateValidityChecker(), si.getMotionValidator()
        if checker is not self._validity:
            self._take_checker(self._sampled_version(checker))
        if validator is not self._validator:
            ours = self._validator.adds_nothing(validator)
            self._asked = None if ours else AskedMotions(validator, self._bridge)
            si.setMotionValidator(self._validator)
            self._take_user_checks()
        return checker is not self._validity or validator is not self._validator

    # ------------------------------------------------------------------------------------- paths and solutions

    def solution(self) -> FloatArray:
        """Return the solution path (N, n) found last.

        Raises
        ------
        InputError
            If there is none.
        """
        if not self.haveSolutionPath():
            raise InputError("there is no solution: call solve or plan first, and see whether it succeeds")
        path = self.getSolutionPath()
        return np.array([self._bridge.read(path.getState(i)) for i in range(path.getStateCount())])

    @property
    def certified_motion(self) -> CertifiedMotion:
        """What proves motions under the limits that are set now."""
        return self._validator.motion

    def report(self, path: ArrayLike) -> PathReport:
        """Validate a path (N, n), and return the report on it; danger and clearance are computed when looked at."""
        self._adopt_plugins()
        array = finite_array(path, (None, self.robot.n), "path")
        return PathReport.of(array, self.checker, self.field, self._validator.motion)

    def is_free(self, path: ArrayLike) -> Validation:
        """Return whether a path (N, n) may be driven in this scene, under the limits and checks set now.

        Returns
        -------
        Validation
            True if so; else `why` names the edge and the pair, and `refused` holds them.

        Raises
        ------
        InputError
            If the path is empty, has the wrong shape, or is not finite.
        """
        self._adopt_plugins()
        array = finite_array(path, (None, self.robot.n), "path")
        if not len(array):
            raise InputError("path must have a configuration at least, got none")
        return validate(array, self._validator.motion)

    def _state(self, q: FloatArray) -> Any:
        state = self.getStateSpace().allocState()
        self._bridge.write(q, state)
        return state

    def _set_solution(self, path: FloatArray) -> None:
        """Put a path (N, n) in the place of the solution; where that was approximate, so is this."""
        solution = og.PathGeometric(self.getSpaceInformation())
        for q in path:
            solution.append(self._state(q))
        problem = self.getProblemDefinition()
        approximate, difference = problem.hasApproximateSolution(), problem.getSolutionDifference()
        problem.clearSolutionPaths()
        planner = self.getPlanner()  # none, if a planner solved the problem on its own
        name = "" if planner is None else planner.getName()
        problem.addSolutionPath(solution, approximate, max(0.0, difference), name)

    def getPlannerData(self, data: Any) -> None:
        """Fill an `ob.PlannerData` with what the planner has built; ours also have a `plannerGraph`, with danger."""
        planner = self.getPlanner()
        fill = getattr(planner, "fillPlannerData", None)
        if fill is None:
            super().getPlannerData(data)
        else:
            data.clear()
            fill(data)


def _let_go(setup: ref[WiredSetup]) -> None:
    """Forget the checks of the user's own, at the end of the program: OMPL would call them leaked."""
    alive = setup()
    if alive is not None:
        alive._sampled = alive._asked = None
        alive._take_user_checks()


def planner_data(planner: Any) -> Any:
    """Return what a planner has built, as an `ob.PlannerData`: of our planners, of OMPL's, and outside `SafeSetup`.

    OMPL's bindings let no planner in Python answer `getPlannerData`: under a plain `og.SimpleSetup` that stays empty.
    """
    data = ob.PlannerData(planner.getSpaceInformation())
    fill = getattr(planner, "fillPlannerData", None) or planner.getPlannerData
    fill(data)
    return data


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
