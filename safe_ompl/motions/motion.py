"""Motions that something else made, as piecewise polynomials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import perm
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import (
    FloatArray,
    InputError,
    documents,
    finite_array,
    float_array,
    number,
    polynomials,
    shown,
    whole_number,
)
from safe_ompl.motions.inputs import (
    DEGREE,
    columns,
    increasing,
    named,
    of_degree,
    path_states,
    rate_rows,
    slack_between,
    vectors,
)
from safe_ompl.robot import Robot

JUMP = 1e-6  # [rad or m] allowed between pieces; proofs add it to a piece's `allowance`
_TURNS = 4 * np.pi  # [rad] beyond which a joint that has limits is probably given in degrees


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion of n joints in K pieces, polynomials of time.

    q(t) = Σ_k c_k u^k with u = (t − t_j) / (t_{j+1} − t_j) in [0, 1] on piece j. Other forms of motions are
    converted by `of`, `through`, `hermite`, `bezier`, `bspline`, `profile` and `sampled`.

    Parameters
    ----------
    times : array_like, shape (K + 1,)
        Where pieces begin and end, increasing [s].
    coefficients : array_like, shape (K, d + 1, n)
        c_0 … c_d of every piece [rad or m]; d ≤ 15.
    joint_names : tuple of str, optional
        The n joints. Default: those of the robot, in its order.
    slack : array_like, shape (K, n), optional
        Where not every configuration is known: how far the motion may be from the polynomial, ≥ 0 [rad or m].
    timed : bool
        Whether `times` are seconds; otherwise they are parameters of a path, and it has no rates.
    rounding : array_like, shape (K, n), optional
        Bound of the sum of the errors of c_0 … c_d, which constructors round [rad or m]. Default: they are exact.
    short_way : bool
        Whether continuous joints go the short way on pieces that are straight: `for_robot` adds whole turns then.

    Raises
    ------
    InputError
        If a shape is wrong, a number is not finite, times do not increase, names repeat, the degree is above 15, or
        the position jumps by more than 1e-6 from one piece to the next.
    """

    times: FloatArray
    coefficients: FloatArray
    joint_names: tuple[str, ...] | None = None
    slack: FloatArray | None = None
    timed: bool = True
    rounding: FloatArray | None = None
    short_way: bool = False

    def __post_init__(self) -> None:
        coefficients = finite_array(self.coefficients, (None, None, None), "coefficients")
        pieces, size, n = of_degree(coefficients).shape
        if not (pieces and size and n):
            raise InputError(
                f"must have pieces, powers and joints, got shape {coefficients.shape}", "coefficients"
            )
        if self.short_way and size != 2:
            raise InputError(f"is for straight pieces, not for a degree of {size - 1}", "short_way")
        times = finite_array(self.times, (pieces + 1,), "times")
        if not (np.diff(times) > 0).all():
            raise InputError(f"must increase, got {shown(times.tolist())}", "times")
        for name, values in (("slack", self.slack), ("rounding", self.rounding)):
            if values is not None:
                array = finite_array(values, (pieces, n), name)
                if (array < 0).any():
                    raise InputError(f"must not be negative, got {array.min():g}", name)
                _freeze(self, name, array)
        if self.joint_names is not None:
            object.__setattr__(self, "joint_names", named(self.joint_names, n))
        _freeze(self, "times", times)
        _freeze(self, "coefficients", coefficients)
        jumps = self._jumps
        if (jumps > JUMP).any():
            piece, joint = np.unravel_index(jumps.argmax(), jumps.shape)
            raise InputError(
                f"{self._joint(int(joint))} jumps by {jumps.max():.3g} at {times[piece + 1]:.6g}"
                f"{' s' if self.timed else ''}; pieces must begin where the one before ends",
                "motion",
            )

    # -------------------------------------------------------------------------------------- values and copies

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.coefficients.shape[2])

    @property
    def pieces(self) -> int:
        """Number K of pieces."""
        return len(self.coefficients)

    @property
    def degree(self) -> int:
        """Degree d of the polynomials."""
        return int(self.coefficients.shape[1]) - 1

    @property
    def duration(self) -> float:
        """How long it takes [s]; where it is not timed, the length of its parameter."""
        return float(self.times[-1] - self.times[0])

    @property
    def knots(self) -> FloatArray:
        """Configurations (K + 1, n) where pieces begin, and where the last one ends [rad or m]."""
        return np.vstack([self.coefficients[:, 0], self.coefficients[-1].sum(axis=0)])

    @property
    def rated(self) -> bool:
        """Whether velocities and accelerations are known: it is timed, and without slack."""
        return self.timed and self.slack is None

    @cached_property
    def allowance(self) -> FloatArray:
        """How far each piece (K, n) may be from its polynomial: slack, rounding, and the jump before it [rad or m]."""
        allowance: FloatArray = np.zeros((self.pieces, self.n))
        for part in (self.slack, self.rounding):
            allowance += 0.0 if part is None else part
        allowance[1:] += self._jumps
        return allowance

    @property
    def control_points(self) -> FloatArray:
        """Bernstein coefficients (K, d + 1, n): each piece is in the convex hull of its own [rad or m]."""
        return polynomials.bernstein(self.coefficients)

    def at(self, time: float | ArrayLike) -> FloatArray:
        """Return the configuration (n,) at a time [s], or (T, n) at times (T,); it rests before and after.

        Raises
        ------
        InputError
            If a time is not a number.
        """
        return self.derivative(time, 0)

    def derivative(self, time: float | ArrayLike, order: int = 1) -> FloatArray:
        """Return the derivative by time of an order, as `at`; 0 before and after, at knots that of the later piece.

        Raises
        ------
        InputError
            If a time is not a number.
        """
        order = whole_number("order", order, at_least=0)
        given = float_array(time, (None,) if np.ndim(time) else (), "time")
        if np.isnan(given).any():
            raise InputError("time must be a number of seconds, got nan")
        t = np.atleast_1d(given)
        piece = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, self.pieces - 1)
        spans = np.diff(self.times)
        u = np.clip((t - self.times[piece]) / spans[piece], 0.0, 1.0)[:, None]
        held = self.derivative_coefficients(order)[piece]
        values = held[:, -1].copy()
        for k in range(held.shape[1] - 2, -1, -1):
            values = values * u + held[:, k]
        if order:
            values[(t < self.times[0]) | (t > self.times[-1])] = 0.0
        return values if given.ndim else values[0]

    def derivative_coefficients(self, order: int) -> FloatArray:
        """Return the coefficients (K, max(d − order, 0) + 1, n) of the derivative by time of an order."""
        if order > self.degree:
            return np.zeros((self.pieces, 1, self.n))
        factors = np.array([float(perm(k, order)) for k in range(order, self.degree + 1)])
        spans = np.diff(self.times)[:, None, None]
        found: FloatArray = self.coefficients[:, order:] * factors[:, None] / spans**order
        return found

    def restricted(self, first: float, last: float) -> Motion:
        """Return the part of the motion from one time to another [s].

        Raises
        ------
        InputError
            If the times are outside of the motion, or not in this order.
        """
        begin, end = float(self.times[0]), float(self.times[-1])
        first = number("first time", first, at_least=begin, at_most=end)
        last = number("last time", last, above=first, at_most=end)
        low = int(np.searchsorted(self.times, first, side="right")) - 1
        high = int(np.searchsorted(self.times, last, side="left"))
        times, coefficients = self.times[low : high + 1].copy(), self.coefficients[low:high].copy()
        rounding = np.zeros((self.pieces, self.n)) if self.rounding is None else self.rounding
        rounding = rounding[low:high].copy()
        shares = (np.array([first, last]) - times[[0, -2]]) / (times[[1, -1]] - times[[0, -2]])
        cuts = {0: (shares[0], shares[1])} if high - low == 1 else {0: (shares[0], 1.0), -1: (0.0, shares[1])}
        for piece, (left, right) in cuts.items():
            if (left, right) != (0.0, 1.0):
                rounding[piece] += (
                    4 * (self.degree + 1) * polynomials.EPS * np.abs(coefficients[piece]).sum(axis=0)
                )
                coefficients[piece] = polynomials.restricted(coefficients[piece], left, right)
        times[[0, -1]] = first, last
        slack = None if self.slack is None else self.slack[low:high]
        return replace(self, times=times, coefficients=coefficients, slack=slack, rounding=rounding)

    def for_robot(self, robot: Robot, degrees: bool = False) -> Motion:
        """Return the same motion with its columns in the order of the robot's joints.

        Parameters
        ----------
        robot : Robot
            The robot.
        degrees : bool
            Whether joints that turn are in degrees.

        Raises
        ------
        InputError
            If joints are missing or there are more; without names, if the number of columns differs. If a joint that
            has limits moves beyond 4π rad, which degrees look like.
        """
        order = columns(self.joint_names, self.n, robot)
        units = np.where(robot.prismatic, 1.0, np.pi / 180 if degrees else 1.0)
        coefficients = self.coefficients[:, :, order] * units
        slack, rounding = (
            None if part is None else part[:, order] * units for part in (self.slack, self.rounding)
        )
        limited = ~(robot.prismatic | robot.continuous)
        ends = coefficients[-1].sum(axis=0)
        far = np.abs([*coefficients[:, 0], ends]).max(axis=0) * limited
        if (far > _TURNS).any():
            joint = robot.joint_names[int(far.argmax())]
            raise InputError(
                f"joint {joint!r} moves to {far.max():.4g} rad, more than two turns; if these are degrees, "
                "say so (degrees=True, --degrees)",
                "motion",
            )
        if degrees:
            rounding = (0.0 if rounding is None else rounding) + 2 * polynomials.EPS * np.abs(
                coefficients
            ).sum(axis=1)
        if self.short_way and robot.continuous.any():
            coefficients, rounding = _unwound(coefficients, rounding, robot)
        return Motion(
            self.times, coefficients, robot.joint_names, slack, self.timed, rounding, short_way=False
        )

    def __repr__(self) -> str:
        lasts = f", {self.duration:.3f} s" if self.timed else ""
        slack = "" if self.slack is None else f", slack {self.slack.max():.3g}"
        return f"Motion({self.pieces} pieces of degree {self.degree}, {self.n} joints{lasts}{slack})"

    # ---------------------------------------------------------------------------------------- constructors

    @classmethod
    def through(
        cls, points: ArrayLike, times: ArrayLike | None = None, names: Sequence[str] | None = None
    ) -> Motion:
        """Return the straight lines through way points (N, n); continuous joints go the short way, as on planned paths.

        Without `times` (N,) [s] it is a path.
        """
        held = finite_array(points, (None, None), "way points")
        if times is None and len(held) == 1:
            held = np.repeat(held, 2, axis=0)  # a path that stays
        if len(held) < 2:
            raise InputError(f"must be two at least, got {len(held)}", "way points")
        at = np.arange(float(len(held))) if times is None else increasing(times, len(held), "times")
        return cls._straight(at, held, names, timed=times is not None, short_way=True)

    @classmethod
    def _straight(
        cls, at: FloatArray, held: FloatArray, names: Sequence[str] | None, **options: Any
    ) -> Motion:
        ends = np.stack([held[:-1], held[1:]], axis=1)
        return cls._made(at, *polynomials.hermite(np.diff(at), ends, None, None), names, **options)

    @classmethod
    def _made(
        cls, times: FloatArray, coefficients: FloatArray, rounding: FloatArray, names: Any, **options: Any
    ) -> Motion:
        return cls(times, coefficients, names, rounding=rounding, **options)

    @classmethod
    def hermite(
        cls,
        times: ArrayLike,
        positions: ArrayLike,
        velocities: Any = None,
        accelerations: Any = None,
        names: Sequence[str] | None = None,
    ) -> Motion:
        """Return what ROS 2's joint_trajectory_controller interpolates; the numbers of continuous joints as they are.

        Lines where only positions are given, cubic pieces with velocities, quintic ones with accelerations besides.

        Parameters
        ----------
        times : array_like, shape (N,)
            Increasing [s].
        positions, velocities, accelerations : array_like, shape (N, n)
            [rad, rad/s, rad/s²; m where a joint slides]. Velocities and accelerations may be lists of rows with None
            for points that have none: pieces at such a point have the lower degree.
        names : sequence of str, optional
            The joints.

        Raises
        ------
        InputError
            As the class, or if a point has accelerations but no velocities, which the controller does not interpolate.
        """
        at = increasing(times, None, "times")
        held = finite_array(positions, (len(at), None), "positions")
        rates, has_rates = rate_rows(velocities, held.shape, "velocities")
        bends, has_bends = rate_rows(accelerations, held.shape, "accelerations")
        if (has_bends & ~has_rates).any():
            point = int(np.flatnonzero(has_bends & ~has_rates)[0])
            raise InputError(f"point {point} has accelerations, but no velocities", "motion")
        cubic, quintic = has_rates[:-1] & has_rates[1:], has_bends[:-1] & has_bends[1:]
        degrees = np.where(cubic, np.where(quintic, 5, 3), 1)
        coefficients = np.zeros((len(at) - 1, int(degrees.max()) + 1, held.shape[1]))
        rounding = np.zeros_like(coefficients[:, 0])
        for degree in set(degrees.tolist()):
            which = np.flatnonzero(degrees == degree)
            ends = which[:, None] + [0, 1]
            v, a = rates[ends] if degree > 1 else None, bends[ends] if degree > 3 else None
            made = polynomials.hermite(at[which + 1] - at[which], held[ends], v, a)
            coefficients[which, : degree + 1], rounding[which] = made
        return cls._made(at, coefficients, rounding, names)

    @classmethod
    def bezier(
        cls, control_points: ArrayLike, times: ArrayLike | None = None, names: Sequence[str] | None = None
    ) -> Motion:
        """Return Bézier curves of control points (K, d + 1, n) one after another; without `times` (K + 1,), a path."""
        points = of_degree(finite_array(control_points, (None, None, None), "control points"))
        count = len(points) + 1
        at = np.arange(float(count)) if times is None else increasing(times, count, "times")
        made = polynomials.powers(points, np.zeros_like(points[:, 0]))
        return cls._made(at, *made, names, timed=times is not None)

    @classmethod
    def bspline(
        cls, knots: ArrayLike, coefficients: ArrayLike, degree: int, names: Sequence[str] | None = None
    ) -> Motion:
        """Return a B-spline where it is defined, from knot `degree` to knot N [s].

        Parameters
        ----------
        knots : array_like, shape (N + degree + 1,)
            Not decreasing [s].
        coefficients : array_like, shape (N, n)
            Control points [rad or m].
        degree : int
            1 to 15.
        names : sequence of str, optional
            The joints.

        Raises
        ------
        InputError
            As the class, or if the knots are none of such a spline.
        """
        degree = whole_number("degree of the B-spline", degree, at_least=1, at_most=DEGREE)
        held = finite_array(coefficients, (None, None), "control points")
        at = finite_array(knots, (None,), "knots")
        if len(at) != len(held) + degree + 1 or len(held) <= degree:
            raise InputError(
                f"must be {degree + 1} more than control points, and these {degree + 1} at least, got "
                f"{len(at)} knots and {len(held)} control points",
                "knots",
            )
        if (np.diff(at) < 0).any() or not at[len(held)] > at[degree]:
            raise InputError(f"must not decrease, and span some time, got {shown(at.tolist())}", "knots")
        return cls._made(*polynomials.spline(at, held, degree), names)

    @classmethod
    def profile(
        cls,
        start: ArrayLike,
        durations: ArrayLike,
        accelerations: ArrayLike | None = None,
        *,
        jerks: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        names: Sequence[str] | None = None,
    ) -> Motion:
        """Return phases of constant acceleration (a trapezoidal profile) or of constant jerk (an S-curve).

        Parameters
        ----------
        start : array_like, shape (n,)
            Where it begins [rad or m].
        durations : array_like, shape (K,)
            Of the phases, ≥ 0; those of 0 are left out [s].
        accelerations, jerks : array_like, shape (K, n)
            One of them [rad/s² or rad/s³; m where a joint slides].
        velocity, acceleration : array_like, shape (n,), optional
            At the start; an acceleration where jerks are given. Default: 0.
        names : sequence of str, optional
            The joints.

        Raises
        ------
        InputError
            As the class, or if a duration is negative, or both or none of accelerations and jerks are given.
        """
        q = finite_array(start, (None,), "start")
        if (accelerations is None) == (jerks is None):
            raise InputError("needs either accelerations or jerks", "profile")
        if acceleration is not None and jerks is None:
            raise InputError("is for phases of constant jerk", "acceleration")
        spans = finite_array(durations, (None,), "durations")
        if (spans < 0).any():
            raise InputError(f"must not be negative, got {spans.min():g}", "durations")
        kind, phases = ("accelerations", accelerations) if jerks is None else ("jerks", jerks)
        pushes = finite_array(phases, (len(spans), len(q)), kind)  # type: ignore[arg-type]
        rates = (("velocity", velocity), ("acceleration", acceleration))[: 1 if jerks is None else 2]
        zero = np.zeros(len(q))
        state = [q, *(zero if rate is None else finite_array(rate, q.shape, name) for name, rate in rates)]
        moving = spans > 0
        made = polynomials.integrated(np.array(state), spans[moving], pushes[moving])
        return cls._made(np.append(0.0, np.cumsum(spans[moving])), *made, names)

    @classmethod
    def sampled(
        cls,
        times: ArrayLike,
        positions: ArrayLike,
        max_velocity: float | ArrayLike,
        names: Sequence[str] | None = None,
    ) -> Motion:
        """Return bare samples: lines, and a slack for what a joint of bounded velocity may do in between.

        In Δt a joint that moves by Δq no faster than v is at most (v² − (Δq/Δt)²) Δt / 2v ≤ ½ v Δt from the line.
        Numbers of continuous joints are taken as they are.

        Parameters
        ----------
        times : array_like, shape (N,)
            Increasing [s].
        positions : array_like, shape (N, n)
            [rad or m]
        max_velocity : float or array_like, shape (n,)
            No joint is faster at any time, > 0 [rad/s or m/s].
        names : sequence of str, optional
            The joints.

        Raises
        ------
        InputError
            As the class, or if samples are farther apart than that velocity allows.
        """
        at = increasing(times, None, "times")
        held = finite_array(positions, (len(at), None), "positions")
        return cls._straight(at, held, names, slack=slack_between(at, held, max_velocity))

    @classmethod
    def of(cls, thing: Any, names: Sequence[str] | None = None, space: Any = None) -> Motion:
        """Return the motion that `thing` is.

        Parameters
        ----------
        thing : object
            A `Motion`; SciPy's `PPoly` (`CubicSpline`, `Akima1DInterpolator`, …), `BPoly` or `BSpline` with values
            (n,); way points (N, n); a `PlanResult`, a `JointPath`; OMPL's `PathGeometric`, or a solved `SimpleSetup`.
        names : sequence of str, optional
            The joints, where it does not name them itself.
        space : ob.StateSpace, optional
            The space of a `PathGeometric`, which does not know it: that of a robot is `joint_space(robot)`.

        Raises
        ------
        InputError
            If it is none of these, or as the class.
        """
        kinds = {kind.__name__ for kind in type(thing).__mro__}
        if isinstance(thing, Motion):
            return thing if names is None else replace(thing, joint_names=tuple(names))
        if kinds & {"PPoly", "BPoly"}:
            return cls._of_pieces(thing, "BPoly" in kinds, names)
        if "BSpline" in kinds:
            knots, degree = np.asarray(thing.t), int(thing.k)
            return cls.bspline(knots, vectors(thing, 2)[: len(knots) - degree - 1], degree, names)
        if hasattr(thing, "getSolutionPath"):
            thing, space = thing.getSolutionPath(), thing.getStateSpace()
        if hasattr(thing, "getStateCount"):
            return cls.through(path_states(thing, space), names=names)
        if hasattr(thing, "joint_names") and (hasattr(thing, "path") or hasattr(thing, "points")):
            path = thing.path if hasattr(thing, "path") else thing.points
            if path is None:
                raise InputError(f"{thing!r} has no path", "motion")
            return cls.through(path, names=thing.joint_names)
        if isinstance(thing, (np.ndarray, list, tuple)):
            return cls.through(thing, names=names)
        proven = "; a Trajectory is proven when it is made" if "Trajectory" in kinds else ""
        raise InputError(
            "must be a Motion, SciPy's PPoly, BPoly or BSpline, way points (N, n), a PlanResult, a JointPath or "
            f"OMPL's PathGeometric, got {shown(thing)}{proven}",
            "motion",
        )

    @classmethod
    def _of_pieces(cls, thing: Any, is_bernstein: bool, names: Sequence[str] | None) -> Motion:
        """Return SciPy's piecewise polynomials: of (t − x_j), highest power first, or of Bernstein."""
        pieces = finite_array(np.swapaxes(vectors(thing, 3), 0, 1), (None, None, None), "coefficients")
        if is_bernstein:
            return cls.bezier(pieces, thing.x, names)
        times = increasing(thing.x, len(pieces) + 1, "times")
        zeros = int(
            (np.cumsum(np.abs(pieces[:, :-1]).sum(axis=(0, 2))) == 0).sum()
        )  # powers that no piece has
        rising = of_degree(pieces[:, zeros:][:, ::-1])
        orders = np.arange(float(rising.shape[1]))
        coefficients = rising * (np.diff(times)[:, None] ** orders)[..., None]
        rounding = polynomials.EPS * np.einsum(
            "k,jkn->jn", np.where(orders > 0, orders + 3, 0.0), np.abs(coefficients)
        )
        return cls._made(times, coefficients, rounding, names)

    # ------------------------------------------------------------------------------------------------ files

    def to_mapping(self) -> dict[str, Any]:
        """Return plain data that `from_mapping` reads back exactly."""
        held = {key: getattr(self, key) for key in ("times", "coefficients", "slack", "rounding")}
        said = {key: value.tolist() for key, value in held.items() if value is not None}
        names = None if self.joint_names is None else list(self.joint_names)
        return {"joint_names": names, **said, "timed": self.timed, "short_way": self.short_way}

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any]) -> Motion:
        """Read a motion from plain data.

        Raises
        ------
        InputError
            If a key is missing, or as the class.
        """
        names = data.get("joint_names")
        return cls(
            documents.require(data, "times"),
            documents.require(data, "coefficients"),
            None if names is None else tuple(documents.sequence("joint_names", names)),
            data.get("slack"),
            documents.flag("timed", data.get("timed", True)),
            data.get("rounding"),
            documents.flag("short_way", data.get("short_way", False)),
        )

    # ------------------------------------------------------------------------------------------------ internals

    @cached_property
    def _jumps(self) -> FloatArray:
        """Return how far (K − 1, n) each piece begins from where the one before ends."""
        jumps: FloatArray = np.abs(self.coefficients[1:, 0] - self.coefficients[:-1].sum(axis=1))
        return jumps

    def _joint(self, column: int) -> str:
        return f"column {column}" if self.joint_names is None else f"joint {self.joint_names[column]!r}"


def _unwound(
    coefficients: FloatArray, rounding: FloatArray | None, robot: Robot
) -> tuple[FloatArray, FloatArray]:
    """Return straight pieces (K, 2, n) on which continuous joints go the short way, as `robot.difference` does."""
    turns = 2 * np.pi * np.round(coefficients[:, 1] / (2 * np.pi)) * robot.continuous
    before = np.vstack([np.zeros(robot.n), np.cumsum(turns, axis=0)[:-1]])
    unwound = coefficients - np.stack([before, turns], axis=1)
    error = 2 * polynomials.EPS * (np.abs(coefficients).sum(axis=1) + np.abs(before)) * robot.continuous
    return unwound, error if rounding is None else rounding + error


def _freeze(motion: Motion, name: str, array: FloatArray) -> None:
    array = np.ascontiguousarray(array)
    array.setflags(write=False)
    object.__setattr__(motion, name, array)
