"""A motion in time with its robot and scene: what a trajectory file holds, and a view plays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from safe_ompl.common import FloatArray, InputError, finite_array
from safe_ompl.common import documents as document
from safe_ompl.io.problems import Problem
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene
from safe_ompl.trajectories import RATE, Trajectory

ACCELERATION = "joint acceleration"
"""What bounds the speed where no cap is reached."""


@dataclass(frozen=True, eq=False)
class TimedMotion:
    """Samples of a trajectory, the speed along its path, and what bounds that speed.

    Parameters
    ----------
    robot, scene : Robot, Scene
        Who moves, and among what.
    times : array_like, shape (T,)
        Instants, increasing from 0 [s].
    configurations : array_like, shape (T, n)
        Joint values [rad or m].
    speeds : array_like, shape (T,)
        Speed ṡ along the path [rad/s].
    bounds : mapping of str to (T,) array
        Name of a cap → the largest ṡ that it allows [rad/s]; +inf where it allows any.
    binding : sequence of str or None
        T names: the cap that the speed reaches; None where accelerations bind.
    danger : mapping, optional
        Options of the danger field.
    name : str, optional
        Who planned it.
    remarks : sequence of str, optional
        T lines, what there is to say of each sample; by default how fast it is, and what bounds that.

    Raises
    ------
    InputError
        If lengths differ, a value is not finite, or times do not increase from 0.
    """

    robot: Robot
    scene: Scene
    times: FloatArray
    configurations: FloatArray
    speeds: FloatArray
    bounds: Mapping[str, FloatArray] = field(default_factory=dict)
    binding: tuple[str | None, ...] = ()
    danger: Mapping[str, Any] | None = None
    name: str = ""
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        times = finite_array(self.times, (None,), "times")
        if len(times) < 2 or times[0] != 0.0 or (np.diff(times) <= 0).any():
            raise InputError(f"must increase from 0, two at least, got {len(times)}", "times")
        count = len(times)
        configurations = finite_array(self.configurations, (count, self.robot.n), "configurations")
        speeds = finite_array(self.speeds, (count,), "speeds")
        bounds = {to: np.asarray(values, dtype=float) for to, values in self.bounds.items()}
        for to, values in bounds.items():
            if values.shape != (count,):
                raise InputError(f"must have {count} values, got shape {values.shape}", f"bounds by {to}")
        if len(self.binding) != count:
            raise InputError(f"must have {count} names, got {len(self.binding)}", "binding")
        if len(self.remarks) not in (0, count):
            raise InputError(f"must have {count} lines, or none, got {len(self.remarks)}", "remarks")
        for key, value in (
            ("times", times),
            ("configurations", configurations),
            ("speeds", speeds),
            ("bounds", bounds),
            ("binding", tuple(self.binding)),
        ):
            object.__setattr__(self, key, value)

    @classmethod
    def of(
        cls,
        trajectory: Trajectory,
        robot: Robot,
        scene: Scene,
        *,
        rate: float = RATE,
        danger: Mapping[str, Any] | None = None,
        name: str = "",
    ) -> TimedMotion:
        """Return samples of a trajectory at a rate [Hz], and its end."""
        times, states = trajectory.sampled(rate)
        cells, _, speeds, _ = trajectory.law.at(times)
        binding = trajectory.binding()
        return cls(
            robot,
            scene,
            times,
            states.q,
            speeds,
            {cap.name: cap.speeds[cells] for cap in trajectory.caps},
            tuple(binding[cell] for cell in cells),
            danger,
            name,
        )

    @property
    def duration(self) -> float:
        """How long it takes [s]."""
        return float(self.times[-1])

    def at(self, times: FloatArray) -> FloatArray:
        """Return the configurations (S, n) at times (S,) [s]; at rest before and after."""
        steps = self.robot.difference(self.configurations[:-1], self.configurations[1:])
        unrolled = self.configurations[0] + np.vstack([np.zeros(self.robot.n), np.cumsum(steps, axis=0)])
        return np.stack([np.interp(times, self.times, column) for column in unrolled.T], axis=1)

    def sample(self, time: float) -> int:
        """Return the number of the sample at a time [s], or before it."""
        return int(np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, len(self.times) - 1))

    def remark(self, time: float) -> str:
        """Return what there is to say of it at a time [s]."""
        sample = self.sample(time)
        if self.remarks:
            return f"{min(time, self.duration):.2f} s: {self.remarks[sample]}"
        bound = self.binding[sample] or ACCELERATION
        return f"{min(time, self.duration):.2f} s: {self.speeds[sample]:.2f} rad/s, bounded by {bound}"

    # ---------------------------------------------------------------------------------------------- files

    def to_mapping(self) -> dict[str, Any]:
        """Return what a file holds besides the points of the trajectory; `from_mapping` reads both."""
        return {
            "planner": self.name,
            "speeds": self.speeds.tolist(),
            "bounds": {name: values.tolist() for name, values in self.bounds.items()},
            "binding": list(self.binding),
            "problem": Problem(self.robot, self.scene, self.danger).to_mapping(),
        }

    @classmethod
    def from_mapping(
        cls, data: Mapping[str, Any], robot: Robot | None = None, package_dirs: Sequence[Path] = ()
    ) -> TimedMotion:
        """Read the file of a trajectory, as `safe-ompl plan --trajectory` writes it.

        Parameters
        ----------
        data : mapping
            What it holds.
        robot : Robot, optional
            The robot, where it does not travel (one of `Robot.from_models`).
        package_dirs : sequence of Path, optional
            Folders that hold the packages, or the meshes, that its URDF names and that do not travel.

        Raises
        ------
        InputError, CertificateError
            If a key is missing or has no meaning, or robot and scene cannot be built.
        """
        about = Problem.from_mapping(document.require(data, "problem"), robot, package_dirs)
        points = document.sequence("points", document.require(data, "points"))
        bounds = document.mapping("bounds", document.require(data, "bounds"))
        return cls(
            about.robot,
            about.scene,
            *_points(points, about.robot.n),
            np.array(document.numbers("speeds", document.require(data, "speeds"))),
            {name: _with_infinity(f"bounds.{name}", values) for name, values in bounds.items()},
            tuple(document.sequence("binding", document.require(data, "binding"))),
            about.danger,
            str(data.get("planner") or ""),
        )


def _points(points: Sequence[Any], n: int) -> tuple[FloatArray, FloatArray]:
    """Return instants (T,) and configurations (T, n) of the points of a trajectory."""
    times, configurations = [], []
    for k, point in enumerate(points):
        with document.within(f"points[{k}]"):
            held = document.mapping("point", point)
            times.append(document.number("time_from_start", document.require(held, "time_from_start")))
            configurations.append(document.numbers("positions", document.require(held, "positions"), n))
    return np.array(times), np.array(configurations).reshape(-1, n)


def _with_infinity(key: str, values: Any) -> FloatArray:
    """Return numbers (T,), +inf where a file has null."""
    return np.array(
        [np.inf if v is None else document.number(key, v) for v in document.sequence(key, values)]
    )
