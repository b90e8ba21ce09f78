"""Limits of the tool that are proven along whole motions: upright within an angle, the tip inside a box."""

from __future__ import annotations

from abc import ABC, abstractmethod
from heapq import heappop, heappush
from math import atan2, sqrt

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.collision.motion import MotionVerdict, Verdict
from safe_ompl.common import FloatArray, InputError, finite_array, float_array, motion_ends, number
from safe_ompl.robot import Robot

# A motion that comes nearer to its limit than about this stays undecided.
_FLOOR = 1e-4  # [rad or m]
# The rounding of kinematics. A proven motion keeps this distance from its limit.
_KINEMATICS_ROUNDING = 1e-9  # [rad or m]
_LEAST_LENGTH = 1e-9  # of a direction


class ToolLimit(ABC):
    """A requirement on the tool at every configuration, such as a largest tilt; a `MotionLimit` of `MotionProver`.

    While the joints move by Δ, its `excess` changes by at most Σ_i r_i·|Δ_i| with constant rates r (n,). If the excess
    at the centre of an interval of half-length s (a fraction of the edge) is below −s·Σ_i r_i·|Δ_i|, the whole interval
    keeps to the limit; an interval that fails is halved, down to a change of 1e-4. The `name` says what it limits, for
    reports.
    """

    name: str

    def __init__(self, robot: Robot, rates: FloatArray) -> None:
        self.robot = robot
        self.rates = rates
        self.rates.setflags(write=False)

    @abstractmethod
    def excess(self, q: ArrayLike) -> float:
        """Return by how much [rad or m] the limit is exceeded at `q: (n,)`; ≤ 0 where it is kept."""

    @abstractmethod
    def objection(self, q: ArrayLike) -> str:
        """Return in words what exceeds the limit at `q: (n,)`."""

    def allows(self, q: ArrayLike) -> bool:
        """Return whether the limit is kept at `q: (n,)`."""
        return self.excess(q) <= 0.0

    def holds_within(self, q: FloatArray, steps: FloatArray) -> bool:
        """Return whether the limit is proven to be kept while the joints are within `steps: (n,)` of `q: (n,)`."""
        return self.excess(q) + float(self.rates @ steps) + _KINEMATICS_ROUNDING <= 0.0

    def check(self, start: ArrayLike, end: ArrayLike) -> MotionVerdict:
        """Check the straight motion between two configurations (n,); raise InputError for others.

        FREE: every configuration keeps to the limit, proven. BLOCKED: the one at `at` does not. UNDECIDED: near `at`
        the limit is too near to tell. The `pair` is the limit's name and "its limit".
        """
        first, last = motion_ends(start, end, self.robot.n)
        delta = self.robot.difference(first, last)
        change = float(self.rates @ np.abs(delta))
        witness = (self.name, "its limit")
        # A heap with the interval of the worst centre on top.
        unproven: list[tuple[float, float, float]] = []
        # Most refused motions are refused at one of their ends.
        intervals = [(0.0, 0.0), (1.0, 0.0), (0.5, 0.5)]
        while True:
            for t, half in intervals:
                excess = self.excess(first + t * delta)
                if excess > 0.0:
                    return MotionVerdict(Verdict.BLOCKED, t, witness)
                if excess + half * change + _KINEMATICS_ROUNDING > 0.0:
                    heappush(unproven, (-excess, t, half))
            if not unproven:
                return MotionVerdict(Verdict.FREE)
            _, centre, half = heappop(unproven)
            if half * change < _FLOOR:
                return MotionVerdict(Verdict.UNDECIDED, centre, witness)
            intervals = [(centre - half / 2, half / 2), (centre + half / 2, half / 2)]


class ToolOrientation(ToolLimit):
    """Keeps an axis of the tool within an angle of a direction: a cup upright, a torch towards the wall.

    Parameters
    ----------
    robot : Robot
        The robot; the axis is fixed to its tip.
    axis, direction : array_like, shape (3,)
        The axis, in the frame of the tip, and where it is to point, in the world frame; of any length but 0.
    angle : float
        [rad] The largest angle between the two, in (0, π].

    Notes
    -----
    The axis a moves with ω × a, where ω = Σ_j z_j·dq_j sums over the joints that turn the tip: |ω × a| ≤ Σ_j sin β_j
    |dq_j|, with β_j the largest angle (up to 90°) that the axis of joint j can have with it: nothing where a wrist
    turns about the axis itself. Joints that slide turn nothing; mimic joints count with their multipliers. No joint
    limit is used.

    Examples
    --------
    >>> robot = Robot.from_example("ur5")
    >>> q = [0.0, -1.2, 1.4, -1.8, -1.57, 0.0]
    >>> axis = robot.tip_pose(q).rotation.T @ [0.0, 0.0, 1.0]
    >>> ToolOrientation(robot, axis=axis, direction=[0, 0, 1], angle=0.5).allows(q)
    True
    """

    name = "tool orientation"

    def __init__(self, robot: Robot, axis: ArrayLike, direction: ArrayLike, angle: float) -> None:
        self.axis = _unit(axis, "axis of the tool")
        self.direction = _unit(direction, "direction of the tool")
        self.limit = number("angle of the tool", angle, above=0.0, at_most=np.pi, kind="angle [rad]")
        super().__init__(robot, robot.coupling.radii(_turning_rates(robot, self.axis)))

    def __repr__(self) -> str:
        return f"ToolOrientation({self.axis.tolist()}, {self.direction.tolist()}, {self.limit:g})"

    def angle(self, q: ArrayLike) -> float:
        """Return the angle [rad] between axis and direction at `q: (n,)`."""
        return _angle(self.robot.tip_pose(q).rotation @ self.axis, self.direction)

    def excess(self, q: ArrayLike) -> float:
        """Return the angle less its limit [rad] at `q: (n,)`."""
        return self.angle(q) - self.limit

    def objection(self, q: ArrayLike) -> str:
        """Return the angle and its limit in words."""
        tilt, limit = np.degrees([self.angle(q), self.limit])
        return f"the tool is {tilt:.4g}° from its direction, {limit:.4g}° are allowed"

    def as_dict(self) -> dict[str, object]:
        """Return it as plain numbers, as certificates claim it."""
        return {"axis": self.axis.tolist(), "direction": self.direction.tolist(), "angle": self.limit}


class TipBounds(ToolLimit):
    """Keeps the tip inside a box whose sides are parallel to the axes of the world.

    Parameters
    ----------
    robot : Robot
        The robot.
    lower, upper : array_like, shape (3,)
        Opposite corners of the box [m], the lower one below the upper one; infinite where there is no wall.

    Examples
    --------
    >>> robot = Robot.from_example("ur5")
    >>> TipBounds(robot, [-1.0, -1.0, 0.2], [1.0, 1.0, 0.9]).allows([0.0, -1.2, 1.4, -1.8, -1.57, 0.0])
    True
    """

    name = "tip position"

    def __init__(self, robot: Robot, lower: ArrayLike, upper: ArrayLike) -> None:
        self.lower = _corner(lower, "lower corner")
        self.upper = _corner(upper, "upper corner")
        if not (self.lower < self.upper).all():
            raise InputError(
                f"the lower corner must be below the upper one, got {self.lower.tolist()} and {self.upper.tolist()}"
            )
        super().__init__(robot, robot.coupling.radii(robot.bounds.tip_radii))

    def __repr__(self) -> str:
        return f"TipBounds({self.lower.tolist()}, {self.upper.tolist()})"

    def excess(self, q: ArrayLike) -> float:
        """Return how far [m] the tip is outside of the nearest wall at `q: (n,)`; negative inside."""
        tip = self.robot.tip_pose(q).translation
        return float(max((self.lower - tip).max(), (tip - self.upper).max()))

    def objection(self, q: ArrayLike) -> str:
        """Return how far outside the tip is, in words."""
        return f"the tip is {1e3 * self.excess(q):.4g} mm outside of its bounds"

    def as_dict(self) -> dict[str, object]:
        """Return the bounds of x, y and z that are finite, as certificates claim them."""
        largest = float(np.finfo(np.float64).max)
        bounds = dict(zip("xyz", zip(self.lower, self.upper, strict=True), strict=True))
        return {
            key: [max(float(low), -largest), min(float(high), largest)]
            for key, (low, high) in bounds.items()
            if np.isfinite([low, high]).any()
        }


def _turning_rates(robot: Robot, axis: FloatArray) -> FloatArray:
    """Return by how much (m,) each of the model's joints turns an axis of the tip, at most, per radian of its own.

    Going from the tip towards the base, the angle between a joint's axis and the tool's lies in an interval: the tool
    turns about the joint above on a cone, and the angle to the joint below differs by up to the cone's from that
    between the two joints.
    """
    chain = robot.shared.chain
    rates = np.zeros(len(chain.parents))
    # The axis of the tool in the frame of the joint that carries the tip.
    tool: FloatArray = robot.tip_placement.rotation @ axis
    # The tool's axis makes angles in this range with `tool`, whatever the joints beyond.
    low = high = 0.0
    for i in chain.path_to_root(robot.tip_joint):
        if not chain.prismatic[i]:
            between = _angle(tool, chain.axes[i])
            low, high = (max(0.0, low - between, between - high), min(np.pi, between + high, 2 * np.pi - between - low))
            rates[i] = 1.0 if low <= np.pi / 2 <= high else max(np.sin(low), np.sin(high))
            tool = chain.axes[i]
        tool = chain.placements[i].rotation @ tool
    return np.minimum(1.0, rates + _KINEMATICS_ROUNDING * (rates > 0))


def _angle(a: FloatArray, b: FloatArray) -> float:
    """Return the angle [rad] between two unit vectors (3,)."""
    across = np.cross(a, b)
    return atan2(sqrt(float(across @ across)), float(a @ b))


def _unit(value: ArrayLike, name: str) -> FloatArray:
    vector: FloatArray = finite_array(value, (3,), name)
    length = float(np.linalg.norm(vector))
    if length < _LEAST_LENGTH:
        raise InputError(f"{name} must be a vector that is not zero, got {vector.tolist()}")
    return vector / length


def _corner(value: ArrayLike, name: str) -> FloatArray:
    corner = float_array(value, (3,), name)
    if np.isnan(corner).any():
        raise InputError(f"{name} must be 3 numbers [m], got {corner.tolist()}")
    return corner
