"""Result of planning a program: parts of one motion, each with its robot, its scene and its proof."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from safe_ompl.common import InputError
from safe_ompl.motions import Motion, MotionCheck
from safe_ompl.robot import Robot
from safe_ompl.scene import Scenario, Scene


@dataclass(frozen=True)
class Stretch:
    """A part of a program's motion during which robot and scene do not change, with its proof.

    Attributes
    ----------
    step : int
        Index of the step, from 0.
    begin : float
        Time in the program at which the stretch begins [s].
    check : MotionCheck
        The motion, whose own time begins at 0, and its proof; `check.proof.checker` has robot and scene.
    curve : Motion or None
        The path of all joints, for controllers with a time law of their own; None while the robot waits.
    joints : tuple of str
        The joints that the step may move: the joints of its arm, or all joints.
    """

    step: int
    begin: float
    check: MotionCheck
    curve: Motion | None = None
    joints: tuple[str, ...] = ()

    @property
    def motion(self) -> Motion:
        """The motion of all joints; its time begins at 0."""
        return self.check.motion

    @property
    def robot(self) -> Robot:
        """The robot with its attached objects."""
        return self.check.proof.checker.robot

    @property
    def scene(self) -> Scene:
        """The obstacles, and which links may touch them."""
        return self.check.proof.checker.scene


@dataclass(frozen=True)
class ProgramResult:
    """Result of planning a program; true if the whole program is planned and proven.

    Attributes
    ----------
    scenario : Scenario
        The scenario that was planned.
    stretches : tuple of Stretch
        The stretches in order. If the program is not solved, the stretches of the longest partial plan.
    choices : tuple of str
        Grasps and places that were chosen, such as "grasp 2 of cube".
    why : str
        The step that cannot be planned, and the reason; empty if the program is solved.
    planning_time : float
        Duration of planning [s].

    Examples
    --------
    >>> result = plan_program("panda_beside_person")
    >>> bool(result), len(result.stretches)
    (True, 8)
    """

    scenario: Scenario
    stretches: tuple[Stretch, ...]
    choices: tuple[str, ...] = ()
    why: str = ""
    planning_time: float = 0.0

    def __bool__(self) -> bool:
        return not self.why

    @property
    def duration(self) -> float:
        """Duration of all stretches [s]."""
        return sum(stretch.motion.duration for stretch in self.stretches)

    @cached_property
    def motion(self) -> Motion:
        """All stretches as one motion in time of all joints, including gripper joints."""
        if not self.stretches:
            raise InputError("there is no motion: nothing was planned")
        size = max(stretch.motion.degree for stretch in self.stretches) + 1
        times, coefficients, allowance = [np.zeros(1)], [], []
        for stretch in self.stretches:
            motion = stretch.motion
            filled = np.zeros((motion.pieces, size, motion.n))
            filled[:, : motion.degree + 1] = motion.coefficients
            times.append(stretch.begin + motion.times[1:] - motion.times[0])
            coefficients.append(filled)
            allowance.append(motion.allowance)
        names = self.stretches[0].robot.joint_names
        return Motion(np.concatenate(times), np.concatenate(coefficients), names, rounding=np.concatenate(allowance))

    def as_dict(self) -> dict[str, Any]:
        """Return the result as a dict of plain values: the motion, if there is one, steps, choices and stretches."""
        steps = () if self.scenario.program is None else self.scenario.program.steps
        data = self.motion.to_mapping() if self.stretches else {}
        data |= {"scenario": self.scenario.name, "solved": bool(self), "why": self.why, "duration": self.duration}
        data |= {"planning_time": self.planning_time, "choices": list(self.choices), "steps": [str(k) for k in steps]}
        data["stretches"] = [
            {"step": s.step, "begin": s.begin, "duration": s.motion.duration, "claims": list(s.check.claims)}
            for s in self.stretches
        ]
        return data

    def __str__(self) -> str:
        steps = () if self.scenario.program is None else self.scenario.program.steps
        spans = dict.fromkeys(range(len(steps)), 0.0)
        for stretch in self.stretches:
            spans[stretch.step] += stretch.motion.duration
        done = max((stretch.step for stretch in self.stretches), default=-1)
        lines = [
            f"{k + 1:3d}  {f'{spans[k]:6.2f} s' if k <= done or self else '       –'}  {step}"
            for k, step in enumerate(steps)
        ]
        if self.why:
            return "\n".join([*lines, f"not solved: {self.why}"])
        claims = ", ".join(dict.fromkeys(claim for stretch in self.stretches for claim in stretch.check.claims))
        chosen = [f"chosen: {', '.join(self.choices)}"] if self.choices else []
        timing = f"{self.duration:.2f} s in {len(self.stretches)} stretches, planned in {self.planning_time:.2f} s"
        return "\n".join([*lines, *chosen, f"{timing}; proven: {claims}"])
