"""The result of a planning run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from safe_ompl.arrays import FloatArray
from safe_ompl.counts import Counts
from safe_ompl.paths.report import PathReport
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scene import Scene
from safe_ompl.setup.optimise import Improvement


@dataclass(frozen=True)
class PlanResult:
    """Outcome of one planning run; true if solved.

    Attributes
    ----------
    status : str
        OMPL's word for the outcome: "Exact solution", "Timeout", …
    path : ndarray, shape (N, n), or None
        Way points from start to goal [rad or m], validated.
    report : PathReport or None
        What there is to say about the path.
    planner : str
        Name of the planner.
    seed : int
        Seed of the run.
    joint_names : tuple of str
        Columns of the path.
    planning_time, simplification_time : float
        [s] Until the first path; and what was spent on making it better.
    counts : Counts
        Work done while planning and simplifying, validation and report not included.
    improvements : tuple of Improvement
        Of an optimisation: each path that was better than those before.
    interrupted : bool
        Whether Ctrl-C ended simplification or optimisation: the path is the best so far.
    robot, scene, danger : Robot, Scene, mapping; or None
        What was planned for, to look at and to save; results that come from other processes have none.
    """

    status: str
    path: FloatArray | None
    report: PathReport | None
    planner: str
    seed: int
    joint_names: tuple[str, ...]
    planning_time: float
    simplification_time: float = 0.0
    counts: Counts = field(default_factory=Counts)
    improvements: tuple[Improvement, ...] = ()
    interrupted: bool = False
    robot: Robot | None = field(default=None, repr=False, compare=False)
    scene: Scene | None = field(default=None, repr=False, compare=False)
    danger: Mapping[str, Any] | None = field(default=None, repr=False, compare=False)

    @property
    def solved(self) -> bool:
        """Whether there is a path from start to goal."""
        return self.path is not None

    def __bool__(self) -> bool:
        return self.solved

    def __getstate__(self) -> dict[str, Any]:
        """Return what travels to other processes: a robot would be built anew with every result."""
        return {**vars(self), "robot": None, "scene": None, "danger": None}

    def view(self, *, port: int = 8080, browser: bool = True) -> None:
        """Show the path in the browser, until Ctrl-C; needs the extra `safe-ompl[viewer]`.

        Raises
        ------
        InputError
            If the result does not know its robot and scene.
        SafeOmplError
            If viser is not installed.
        """
        from safe_ompl.viewer import (
            Exhibit,
            View,
        )  # a door: it is opened from here, and nothing below knows it

        View(Exhibit.of_results([self]), port=port).run(browser=browser)

    def as_dict(self) -> dict[str, Any]:
        """Return the result as plain numbers, lists and strings, in the form of the command line's JSON."""
        report = {"length": None, "danger": None, "clearance": None, "certified": False}
        told = {
            "planner": self.planner,
            "seed": self.seed,
            "status": self.status,
            "solved": self.solved,
            "planning_time": self.planning_time,
            "simplification_time": self.simplification_time,
            "joint_names": list(self.joint_names),
            "path": None if self.path is None else self.path.tolist(),
            **(self.report.as_dict() if self.report else report),
            "counts": self.counts.as_dict(),
        }
        if self.improvements:
            told["improvements"] = [improvement.as_dict() for improvement in self.improvements]
        if self.interrupted:
            told["interrupted"] = True
        return told
