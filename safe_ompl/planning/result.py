"""The result of a planning run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import safe_ompl.danger as dangers
import safe_ompl.motions as motions
import safe_ompl.planning.simplification as simplification
from safe_ompl.collision import MotionProver
from safe_ompl.common import Counts, FloatArray, InputError, StaleSceneError, notebook_html
from safe_ompl.danger import DangerField
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene

_TIMES = ("setup_time", "planning_time", "simplification_time", "report_time")
# `as_dict` copies these attributes unchanged.
_WRITTEN_FIELDS = ("planner", "seed", "status", "solved", *_TIMES)


@dataclass(frozen=True)
class Improvement:
    """A path that costs less than all earlier paths of the run: the time at which it was found [s], and its cost."""

    time: float
    cost: float


@dataclass(frozen=True)
class PlanResult:
    """Result of one planning run; true if solved.

    Attributes
    ----------
    status : str
        OMPL's name of the status: "Exact solution", "Timeout", …
    path : ndarray, shape (N, n), or None
        Validated way points from start to goal [rad or m]. Angles of continuous joints do not jump at ±π.
    report : PathReport or None
        The proof of the path, and its danger, clearance and length, which are computed on first use.
    planner, seed : str, int
        Name of the planner, and seed of the run.
    joint_names : tuple of str
        Names of the columns of the path.
    setup_time, planning_time, simplification_time, validation_time : float
        Durations of setup, of planning up to the first path, of simplification or optimisation, and of validation [s].
        Their sum is the duration of the whole run.
    counts : Counts
        Queries and nodes of planning and simplification, without validation and report.
    improvements : tuple of Improvement
        With `optimise`: each path that costs less than all earlier ones.
    ways : tuple of float
        With `ways="all"`: the cost of each distinct way by the setup's objective, the way of `path` first. The default
        objective is the integral of danger [field · rad].
    repaired : str
        If the planner is a function: "unchanged", or how its path was repaired.
    interrupted : bool
        Whether Ctrl-C ended simplification or optimisation; the path is then the best one so far.
    planned_path : ndarray, shape (M, n), or None
        The path before simplification; None if it was not simplified.
    moving_obstacles : mapping or None
        The obstacles that may move: their ``speeds`` [m/s] by name, and the ``time`` [s] for which the path is free,
        however they move within these speeds.
    robot, scene, danger, motion : Robot, Scene, mapping, MotionProver; or None
        The inputs of the run, and the prover of the path. They are None in results from other processes.

    Examples
    --------
    >>> result = plan("planar2", seed=0)
    >>> bool(result), result.planner, result.path.shape[1]
    (True, 'SafeRRTConnect', 2)
    """

    status: str
    path: FloatArray | None
    report: simplification.PathReport | None
    planner: str
    seed: int
    joint_names: tuple[str, ...]
    planning_time: float
    simplification_time: float = 0.0
    counts: Counts = field(default_factory=Counts)
    improvements: tuple[Improvement, ...] = ()
    ways: tuple[float, ...] = ()
    repaired: str = ""
    interrupted: bool = False
    setup_time: float = 0.0
    validation_time: float = 0.0
    moving_obstacles: Mapping[str, Any] | None = None
    planned_path: FloatArray | None = field(default=None, compare=False, repr=False)
    robot: Robot | None = field(default=None, repr=False, compare=False)
    scene: Scene | None = field(default=None, repr=False, compare=False)
    danger: Mapping[str, Any] | None = field(default=None, repr=False, compare=False)
    motion: MotionProver | None = field(default=None, compare=False, repr=False)

    def timed(self, limits: motions.RateLimits | None = None, **options: Any) -> motions.Trajectory:
        """Return the path as a trajectory; parameters and errors of `time_path`.

        Raises InputError if there is no path, or if the result comes from another process (then call `time_path`), and
        StaleSceneError if obstacles have moved since planning.
        """
        if self.path is None:
            raise InputError(f"there is no path to time: {self.status}")
        if self.motion is None:
            raise InputError("the result has no robot and scene, because it comes from another process: call time_path")
        if self.motion.checker.scene != self.scene:
            raise StaleSceneError("obstacles have moved since this was planned: plan again, or call time_path")
        if options.get("max_danger") is not None and self.danger is not None:
            options = {"danger": dangers.KinetostaticField(self.danger_field()), **options}
        return motions.time_path(self.path, self.motion.checker.robot, limits, motion=self.motion, **options)

    def danger_field(self) -> DangerField:
        """Return the danger field of the run, for a robot at rest; `KinetostaticField` is for a robot in motion.

        Raises InputError if the path was planned without danger, or if the result comes from another process.
        """
        if self.robot is None or self.scene is None or self.danger is None:
            raise InputError("the result has no danger field: it was planned without one, or in another process")
        return DangerField.of_options(self.robot, self.scene, self.danger)

    @property
    def report_time(self) -> float:
        """The time that validation took, and danger and clearance if they were computed [s]."""
        return self.validation_time + (self.report.time if self.report is not None else 0.0)

    @property
    def certified(self) -> bool:
        """Whether there is a path, every edge is proven free, and the user's checker accepts the path."""
        return self.report is not None and self.report.certified

    @property
    def solved(self) -> bool:
        """Whether there is a path from start to goal."""
        return self.path is not None

    def __bool__(self) -> bool:
        return self.solved

    def __repr__(self) -> str:
        points = "no path" if self.path is None else f"{len(self.path)} way points"
        return f"PlanResult({self.status!r}, {points}, {self.planner!r}, seed={self.seed})"

    def __str__(self) -> str:
        """Return a summary: status, times, length and danger, clearance, proof; and repairs and ways, if any."""
        seconds = f"planned in {self.planning_time:.3f} s"
        if self.simplification_time:
            seconds += f", simplified in {self.simplification_time:.3f} s"
        lines = [f"{self.status}: {self.planner}, seed {self.seed}", seconds]
        if self.path is None or self.report is None:
            lines += ["no path", "clearance: none", "proof: none"]
        else:
            lines.append(f"{len(self.path)} way points, {self.report}")
        if self.repaired:
            lines.append(f"path of {self.planner}: {self.repaired}; proven")
        if self.ways:
            number, best, *others = len(self.ways), *self.ways
            found = f"{number} ways found" if others else "1 way found"
            next_best = f", next best {others[0]:.2f}" if others else ""
            lines.append(f"{found}: cost {best:.2f}{next_best}, by the objective")
        return "\n".join(lines)

    _repr_html_ = notebook_html

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for pickling, without the robot: unpickling would build it again for every result."""
        return {**vars(self), "robot": None, "scene": None, "danger": None, "motion": None}

    def as_dict(self) -> dict[str, Any]:
        """Return the result as a dict of plain values, which the command line writes as JSON."""
        keys = ("length", "danger", "clearance", "validation", "links_without_collision")
        report = {**dict.fromkeys(keys), "certified": False} if self.report is None else self.report.as_dict()
        content = {
            **{key: getattr(self, key) for key in _WRITTEN_FIELDS},
            "joint_names": list(self.joint_names),
            "path": None if self.path is None else self.path.tolist(),
            **report,
            "counts": asdict(self.counts),
        }
        if self.moving_obstacles is not None:
            content["moving_obstacles"] = dict(self.moving_obstacles)
        if self.planned_path is not None:
            content["planned_path"] = self.planned_path.tolist()
        if self.improvements:
            content["improvements"] = [dict(vars(improvement)) for improvement in self.improvements]
        if self.ways:
            content["ways"] = list(self.ways)
        if self.repaired:
            content["repaired"] = self.repaired
        if self.interrupted:
            content["interrupted"] = True
        return content
