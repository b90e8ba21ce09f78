"""Limits of the tool that are proven along whole motions: the tilt of an axis, and the position of the tip in a box."""

from __future__ import annotations

from abc import ABC, abstractmethod
from heapq import heappop, heappush
from math import atan2, sqrt

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.collision.motion import MotionVerdict, Verdict
from safe_ompl.common import FloatArray, InputError, finite_array, float_array, motion_ends, number
from safe_ompl.robot import Robot

# A motion stays undecided if it comes closer to its limit than about this.
_FLOOR = 1e-4  # [rad or m]
# Rounding error of kinematics. A proven motion keeps this distance from its limit.
_KINEMATICS_ROUNDING = 1e-9  # [rad or m]
_LEAST_LENGTH = 1e-9  # of a direction


class ToolLimit(ABC):
    """A requirement on the tool at every configuration, such as a largest tilt; a `MotionLimit` of `MotionProver`.

    While the joints move by Δ, its `excess` changes by at most Σ_i r_i·|Δ_i| with constant rates r (n,). If the excess
    at the centre of an interval of half-length s (a fraction of the edge) is below −s·Σ_i r_i·|Δ_i|, the whole interval
    keeps the limit. An interval that fails is halved, down to a change of 1e-4. Reports use the `name`.
    """

    name: str

    def __init__(self, robot: Robot, rates: FloatArray) -> None:
        self.robot = robot
        self.rates = rates
        self.rates.setflags(write=False)

    @abstractmethod
    def excess(self, q: ArrayLike) -> float:
        """Return by how much [rad or m] the limit is exceeded at `q: (n,)`; ≤ 0 if the limit holds."""

    @abstractmethod
    def refusal(self, q: ArrayLike) -> str:
        """Return a text that says how the limit is exceeded at `q: (n,)`."""

    def allows(self, q: ArrayLike) -> bool:
        """Return whether the limit holds at `q: (n,)`."""
        return self.excess(q) <= 0.0

    def holds_within(self, q: FloatArray, steps: FloatArray) -> bool:
        """Return whether the limit is proven while the joints are within `steps: (n,)` of `q: (n,)`."""
        return self.excess(q) + float(self.rates @ steps) + _KINEMATICS_ROUNDING <= 0.0

    def check(self, start: ArrayLike, end: ArrayLike) -> MotionVerdict:
        """Check the straight motion between two configurations (n,). Raises InputError if they are invalid.

        FREE: the limit is proven for every configuration. BLOCKED: the configuration at `at` exceeds the limit.
        UNDECIDED: near `at` the excess is too small for a proof. The `pair` is the limit's name and "its limit".
        """
        first, last = motion_ends(start, end, self.robot.n)
        delta = self.robot.difference(first, last)
        change = float(self.rates @ np.abs(delta))
        witness = (self.name, "its limit")
        # The heap has the interval with the worst centre on top.
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
        The robot. The axis is fixed to its tip.
    axis, direction : array_like, shape (3,)
        The axis in the frame of the tip, and its wanted direction in the world frame, with any length but 0.
    angle : float
        [rad] The largest angle between the two, in (0, π].

    Notes
    -----
    The axis a moves with ω × a, where ω = Σ_j z_j·dq_j sums over the revolute joints before the tip: |ω × a| ≤ Σ_j sin
    β_j |dq_j|. β_j is the largest angle (up to 90°) between the axis of joint j and a, so a wrist that turns about a
    itself adds nothing. Prismatic joints add nothing. Mimic joints count with their multipliers. Joint limits are not
    used.

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

    def refusal(self, q: ArrayLike) -> str:
        """Return a text with the angle and its limit."""
        tilt, limit = np.degrees([self.angle(q), self.limit])
        return f"the tool is {tilt:.4g}° from its direction, {limit:.4g}° are allowed"

    def as_dict(self) -> dict[str, object]:
        """Return the limit as plain numbers, as certificates claim it."""
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
        """Return how far [m] the tip is outside of the box at `q: (n,)`; inside, minus the distance to the wall."""
        tip = self.robot.tip_pose(q).translation
        return float(max((self.lower - tip).max(), (tip - self.upper).max()))

    def refusal(self, q: ArrayLike) -> str:
        """Return a text that says how far outside the tip is."""
        return f"the tip is {1e3 * self.excess(q):.4g} mm outside of its bounds"

    def as_dict(self) -> dict[str, object]:
        """Return the finite bounds of x, y and z, as certificates claim them."""
        largest = float(np.finfo(np.float64).max)
        bounds = dict(zip("xyz", zip(self.lower, self.upper, strict=True), strict=True))
        return {
            key: [max(float(low), -largest), min(float(high), largest)]
            for key, (low, high) in bounds.items()
            if np.isfinite([low, high]).any()
        }


def _turning_rates(robot: Robot, axis: FloatArray) -> FloatArray:
    """Return bounds (m,) of the rotation of a tip axis per radian of each of the model's joints.

    The recursion goes from the tip towards the base. The angle between a joint's axis and the tool's axis lies in an
    interval: the tool's axis turns about the previous joint on a cone. The angle to the next joint differs from the
    angle between both joints by at most the half-angle of the cone.
    """
    chain = robot.shared.chain
    rates = np.zeros(len(chain.parents))
    # The axis of the tool in the frame of the joint that carries the tip.
    tool: FloatArray = robot.tip_placement.rotation @ axis
    # Range of the angle between the tool's axis and `tool`, for any values of the joints beyond.
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
