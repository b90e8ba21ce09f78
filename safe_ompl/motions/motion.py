"""Motions as piecewise polynomials: paths over arc length, splines over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from math import factorial, perm
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.common import FloatArray, InputError, IntArray, documents, finite_array, float_array, polynomials, shown
from safe_ompl.motions import forms
from safe_ompl.motions.cells import Boxes, Cells, CurvePoints, divided_edges
from safe_ompl.motions.laws import derivative_ranges, derivatives
from safe_ompl.motions.limits import RATE_TOLERANCE
from safe_ompl.robot import Robot, plain

# Rounding of joint values is counted only above this value. Smaller rounding is far below the margin of every proof.
_NEGLIGIBLE_ROUNDING = 1e-9  # [rad or m]
# A joint with limits that moves beyond this value is probably given in degrees.
_PROBABLY_DEGREES = 4 * np.pi  # [rad]
# When a motion is cut, shorter stretches are rounding errors.
_NEGLIGIBLE_STRETCH = 1e-12  # [s, or rad]


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion of n joints in K pieces, which are polynomials of time or of a path parameter.

    q(t) = Σ_k c_k u^k with u = (t − t_j) / (t_{j+1} − t_j) in [0, 1] on piece j. `of`, `through`, `hermite` and
    `sampled` convert other representations. Joint values are not wrapped: a continuous joint moves exactly as its
    values say. `time_path` computes a time law for a path.

    Parameters
    ----------
    times : array_like, shape (K + 1,)
        Increasing times [s] at which pieces begin and end.
    coefficients : array_like, shape (K, d + 1, n)
        c_0 … c_d of every piece [rad or m]; d ≤ 15.
    joint_names : tuple of str, optional
        The n joints. Default: the robot's joints, in its order.
    slack : array_like, shape (K, n), optional
        Bound of the distance between the motion and the polynomial, ≥ 0, if the motion is not known exactly [rad or m].
    timed : bool
        Whether `times` are seconds. If not, they are path parameters, and the motion has no velocities.
    rounding : array_like, shape (K, n), optional
        Bound of the summed rounding errors of c_0 … c_d from constructors [rad or m]. Default: coefficients are exact.
    corners : tuple of int, optional
        For a path: the knots 1 … K − 1 at which the direction changes and the robot stops.

    Raises
    ------
    InputError
        If a shape is wrong, a number is not finite, times do not increase, names repeat, the degree is above 15, or
        the position jumps by more than 1e-6 from one piece to the next.

    Examples
    --------
    >>> motion = Motion.hermite([0.0, 1.0], [[0.0], [1.0]], [[0.0], [0.0]])
    >>> motion.at([0.5])
    array([[0.5]])
    """

    times: FloatArray
    coefficients: FloatArray
    joint_names: tuple[str, ...] | None = None
    slack: FloatArray | None = None
    timed: bool = True
    rounding: FloatArray | None = None
    corners: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        coefficients = finite_array(self.coefficients, (None, None, None), "coefficients")
        pieces, size, n = forms.check_degree(coefficients).shape
        if not (pieces and size and n):
            raise InputError(f"must have pieces, powers and joints, got shape {coefficients.shape}", "coefficients")
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
            object.__setattr__(self, "joint_names", forms.named(self.joint_names, n))
        if self.corners and not (not self.timed and min(self.corners) > 0 and max(self.corners) < pieces):
            raise InputError(f"must be knots inside of a path of {pieces} pieces, got {self.corners}", "corners")
        _freeze(self, "times", times)
        _freeze(self, "coefficients", coefficients)
        jumps = np.abs(self.jumps(0))
        if (jumps > RATE_TOLERANCE[0]).any():
            piece, k = np.unravel_index(jumps.argmax(), jumps.shape)
            joint = f"column {k}" if self.joint_names is None else f"joint {self.joint_names[k]!r}"
            raise InputError(
                f"{joint} jumps by {jumps.max():.3g} at {times[piece + 1]:.6g}"
                f"{' s' if self.timed else ''}; pieces must begin where the one before ends",
                "motion",
            )

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
        """Duration [s]; for a path, the length of its parameter."""
        return float(self.times[-1] - self.times[0])

    @property
    def length(self) -> float:
        """Length of the parameter: arc length [rad], or time [s]."""
        return self.duration

    @property
    def knots(self) -> FloatArray:
        """Configurations (K + 1, n) at which pieces begin, and the end of the last piece [rad or m]."""
        return np.vstack([self.coefficients[:, 0], self.coefficients[-1].sum(axis=0)])

    @property
    def rated(self) -> bool:
        """Whether velocities and accelerations are known: the motion is timed and has no slack."""
        return self.timed and self.slack is None

    @cached_property
    def allowance(self) -> FloatArray:
        """Bound (K, n) of the distance of the motion from its polynomial: slack, rounding, preceding jump [rad or m].

        Rounding includes the evaluation of the polynomial where coefficients cancel and the error exceeds the margin of
        proofs.
        """
        rough = 4 * (self.degree + 1) * polynomials.EPS * np.abs(self.coefficients).sum(axis=1)
        rough[1:] += np.abs(self.jumps(0))
        rough += 0.0 if self.rounding is None else self.rounding
        # Small rounding must not make a tube, because proofs within a tube must also check pairs that cannot touch.
        allowance: FloatArray = np.where(rough > _NEGLIGIBLE_ROUNDING, rough, 0.0)
        return allowance if self.slack is None else allowance + self.slack

    def at(self, time: float | ArrayLike) -> FloatArray:
        """Return the configuration (n,) at a time [s], or (T, n) at times (T,). The motion rests before and after.

        Raises InputError if a time is NaN.
        """
        return self.derivative(time, 0)

    def derivative(self, time: float | ArrayLike, order: int = 1) -> FloatArray:
        """Return the time derivative of an order, shaped as by `at`.

        The derivative is 0 before the start and after the end. At a knot it is the derivative of the later piece.
        """
        order = documents.whole_number("order", order, at_least=0)
        given = float_array(time, (None,) if np.ndim(time) else (), "time")
        if np.isnan(given).any():
            raise InputError("time must be a number of seconds, got nan")
        t = np.atleast_1d(given)
        piece = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, self.pieces - 1)
        u = np.clip((t - self.times[piece]) / np.diff(self.times)[piece], 0.0, 1.0)[:, None]
        values = polynomials.values(self.derivative_coefficients(order)[piece], u)
        if order:
            values[(t < self.times[0]) | (t > self.times[-1])] = 0.0
        return values if given.ndim else values[0]

    def derivative_coefficients(self, order: int) -> FloatArray:
        """Return the coefficients (K, max(d − order, 0) + 1, n) of the time derivative of an order."""
        if order == 0:
            return self.coefficients
        if order > self.degree:
            return np.zeros((self.pieces, 1, self.n))
        factors = np.array([float(perm(k, order)) for k in range(order, self.degree + 1)])
        spans = np.diff(self.times)[:, None, None]
        return np.asarray(self.coefficients[:, order:] * factors[:, None] / spans**order)

    def jumps(self, order: int) -> FloatArray:
        """Return the jumps (K − 1, n) of the time derivative of an order between consecutive pieces."""
        held = self.derivative_coefficients(order)
        return np.asarray(held[1:, 0] - held[:-1].sum(axis=1))

    def for_robot(self, robot: Robot, degrees: bool = False) -> Motion:
        """Return the motion with its columns in the order of the robot's joints.

        With `degrees`, values of revolute joints are converted from degrees. Raises InputError if joints are missing or
        unknown; for a motion without names, if the number of columns differs; if a joint with limits moves beyond 4π
        rad, which suggests degrees.
        """
        order = forms.columns(self.joint_names, self.n, robot)
        found = self
        if degrees or order != list(range(self.n)):
            units = np.where(robot.prismatic, 1.0, np.pi / 180 if degrees else 1.0)
            coefficients = self.coefficients[:, :, order] * units
            slack, rounding = (None if rest is None else rest[:, order] * units for rest in (self.slack, self.rounding))
            if degrees:
                error = 2 * polynomials.EPS * np.abs(coefficients).sum(axis=1)
                rounding = error if rounding is None else rounding + error
            found = replace(self, coefficients=coefficients, joint_names=None, slack=slack, rounding=rounding)
        far = np.abs(found.knots).max(axis=0) * ~(robot.prismatic | robot.continuous)
        if (far > _PROBABLY_DEGREES).any():
            joint = robot.joint_names[int(far.argmax())]
            raise InputError(
                f"joint {joint!r} moves to {far.max():.4g} rad, more than two turns; if these are degrees, "
                "say so (degrees=True, --degrees)",
                "motion",
            )
        return found if found.joint_names == robot.joint_names else found.derived(joint_names=robot.joint_names)

    def derived(self, **changed: Any) -> Motion:
        """Return a copy with other values of some fields, which are valid by construction and not validated."""
        found = object.__new__(type(self))
        for field in fields(self):
            value = changed.get(field.name, getattr(self, field.name))
            if isinstance(value, np.ndarray):
                _freeze(found, field.name, value)
            else:
                object.__setattr__(found, field.name, value)
        return found

    def cut(self, cuts: Mapping[int, FloatArray]) -> Motion:
        """Return the motion with some of its pieces cut at increasing fractions in (0, 1)."""
        if not cuts:
            return self
        counts = np.ones(self.pieces, dtype=np.intp)
        counts[list(cuts)] += [len(at) for at in cuts.values()]
        of = np.repeat(np.arange(self.pieces), counts)
        low, high = np.zeros(len(of)), np.ones(len(of))
        for k, at in cuts.items():
            last = int(counts[: k + 1].sum())
            low[last - len(at) : last] = high[last - len(at) - 1 : last - 1] = at
        coefficients = self.coefficients[of]
        parts = counts[of] > 1
        coefficients[parts] = polynomials.restricted(coefficients[parts], low[parts], high[parts])
        begins, ends = self.times[of], self.times[of + 1]
        times = np.append(self.times[0], np.where(high == 1.0, ends, begins + high * (ends - begins)))
        size = np.abs(self.coefficients).sum(axis=1)
        rounding = np.zeros_like(size) if self.rounding is None else self.rounding
        rounding = (rounding + 4 * (self.degree + 1) * polynomials.EPS * size)[of]
        slack = None if self.slack is None else self.slack[of]
        corners = tuple(np.searchsorted(of, self.corners).tolist())
        changed = {"slack": slack, "rounding": rounding, "corners": corners}
        return self.derived(times=times, coefficients=coefficients, **changed)

    def part(self, first: float, last: float) -> Motion:
        """Return the part between two parameter values first < last. The parameter of the part begins at 0."""
        a, b = self.piece_at(np.array([first, last])).tolist()
        a += bool(self.times[a + 1] - first < _NEGLIGIBLE_STRETCH and a < b)
        b -= bool(last - self.times[b] < _NEGLIGIBLE_STRETCH and a < b)
        times = np.clip(self.times[a : b + 2], first, last) - first
        coefficients = self.coefficients[a : b + 1].copy()
        shares = (np.array([first, last]) - self.times[[a, b]]) / self._spans[[a, b]]
        begin, end = np.clip(shares, 0.0, 1.0).tolist()
        if end < 1.0:
            coefficients[-1] = polynomials.restricted(coefficients[-1], begin if a == b else 0.0, end)
        if begin > 0.0 and not (a == b and end < 1.0):
            coefficients[0] = polynomials.restricted(coefficients[0], begin, 1.0)
        slack, rounding = (None if rest is None else rest[a : b + 1] for rest in (self.slack, self.rounding))
        corners = tuple(k - a for k in self.corners if a < k <= b)
        return replace(self, times=times, coefficients=coefficients, slack=slack, rounding=rounding, corners=corners)

    def then(self, other: Motion) -> Motion:
        """Return this motion followed by another motion of the same joints, which begins at the end of this one.

        For paths the joining knot is a corner, at which the robot stops. Raises InputError if only one motion is timed,
        if the joint names differ, or if the second motion begins at another configuration.
        """
        if self.timed != other.timed:
            raise InputError("must have times in all parts, or in none", "times")
        if self.joint_names and other.joint_names and self.joint_names != other.joint_names:
            names = ", ".join(self.joint_names)
            raise InputError(
                f"must be {names}, as in the motion before, got {', '.join(other.joint_names)}", "joint_names"
            )
        count, size = self.pieces, max(self.degree, other.degree) + 1
        coefficients = np.zeros((count + other.pieces, size, self.n))
        coefficients[:count, : self.degree + 1] = self.coefficients
        coefficients[count:, : other.degree + 1] = other.coefficients
        times = np.concatenate([self.times - self.times[0], self.length + other.times[1:] - other.times[0]])
        if self.timed:
            rounding = np.concatenate(
                [np.zeros((part.pieces, part.n)) if part.rounding is None else part.rounding for part in (self, other)]
            )
            return Motion(times, coefficients, self.joint_names, rounding=rounding)
        corners = (*self.corners, count, *(count + k for k in other.corners))
        return Motion(times, coefficients, self.joint_names, timed=False, corners=corners)

    def among(self, robot: Robot, q: FloatArray, rows: Sequence[int]) -> Motion:
        """Return the motion of all joints of a robot: joints in `rows` follow this motion.

        The others stay at `q: (n,)`. Continuous joints are shifted by whole turns to begin as near to `q` as possible.
        """
        turns = 2 * np.pi * np.round((q[rows] - self.coefficients[0, 0]) / (2 * np.pi)) * robot.continuous[rows]
        coefficients = np.zeros((self.pieces, self.degree + 1, len(q)))
        coefficients[:, 0] = q
        coefficients[:, :, rows] = self.coefficients
        coefficients[:, 0, rows] += turns
        rounding = np.zeros((self.pieces, len(q)))
        rounding[:, rows] = self.allowance
        return replace(self, coefficients=coefficients, joint_names=robot.joint_names, rounding=rounding, slack=None)

    # ------------------------------------------------------------------------------------------- places and cells

    @cached_property
    def _spans(self) -> FloatArray:
        """Parameter lengths (K,) of the pieces."""
        return np.diff(self.times)

    def piece_at(self, s: FloatArray) -> IntArray:
        """Return the piece (S,) that contains each parameter value `s: (S,)`; at a knot, the later piece."""
        return np.asarray(np.clip(np.searchsorted(self.times, s, side="right") - 1, 0, self.pieces - 1))

    def places(self, s: FloatArray, pieces: IntArray | None = None) -> CurvePoints:
        """Return configurations and derivatives (S, n) at parameter values `s: (S,)`, on given pieces or as `piece_at`.

        In contrast to `at`, the first and the last piece are extrapolated beyond the ends.
        """
        which = self.piece_at(s) if pieces is None else pieces
        return CurvePoints(*derivatives(self.times, self.coefficients, which, plain(s)))

    def cells(self, step: float, turn: float = 0.1) -> Cells:
        """Return cells no longer than `step`, in each of which q′ changes by no more than `turn`."""
        if (step, turn) not in self._known:
            rates = self.derivative_coefficients(1)
            turned = np.linalg.norm(rates[:, 1:].sum(axis=1), axis=1)
            parts = np.maximum(1, np.ceil(np.maximum(self._spans / step, turned / turn))).astype(np.intp)
            self._known[step, turn] = self.between(divided_edges(self.times, parts))
        return self._known[step, turn]

    @cached_property
    def _known(self) -> dict[tuple[float, float], Cells]:
        """Cells computed so far."""
        return {}

    def between(self, edges: FloatArray) -> Cells:
        """Return the cells between parameter values (N + 1,), which include all knots.

        Ranges of derivatives come from Bernstein coefficients, widened by rounding and, for timed motions, by jumps
        between pieces (`roughness`). Cells record as stops the corners of a path, and the knots at which a timed motion
        is at rest.
        """
        piece = self.piece_at((edges[1:] + edges[:-1]) / 2)
        low, high = derivative_ranges(self.times, self.coefficients, piece, plain(edges))
        if self.timed:
            rough = np.array([self.roughness(order)[piece] for order in (1, 2, 3)])
            # Velocities at cell centres come from the polynomials, so the second derivative must cover the roughness of
            # the first.
            rough[1] = np.maximum(rough[1], rough[0] / (np.diff(edges)[:, None] / 2))
            low, high = low - rough, high + rough
        d3q_ds3 = np.maximum(np.abs(low[2]), np.abs(high[2]))
        # Sums of lengths are rounded, so each knot is matched to the nearest edge.
        stops = np.searchsorted((edges[1:] + edges[:-1]) / 2, self.times[self.rests])
        return Cells(edges, Boxes(low[0], high[0], low[1], high[1]), d3q_ds3, stops)

    @cached_property
    def rests(self) -> IntArray:
        """Inner knots at which the robot is at rest: corners of a path, or zero velocity of a timed motion."""
        if not self.timed:
            return np.array(sorted(self.corners), dtype=np.intp)
        moves = self._moves
        return np.asarray(np.flatnonzero(~(moves[0, 1:] | moves[1, :-1])) + 1)

    @property
    def _moves(self) -> Any:
        """Whether the robot moves (2, K) at the beginning and at the end of each piece."""
        return (self.end_rates > RATE_TOLERANCE[1]).any(axis=2)

    @property
    def end_rates(self) -> FloatArray:
        """Bounds (2, K, n) of |q′| at the beginning and at the end of each piece."""
        rates = self.derivative_coefficients(1)
        return np.asarray(np.abs(np.stack([rates[:, 0], rates.sum(axis=1)])) + self.roughness(1))

    def roughness(self, order: int) -> FloatArray:
        """Return the bound (K, n) that rounding and jumps between pieces add to the derivative of an order ≥ 1.

        Rounded coefficients with Σ|δc_k| ≤ ρ change the derivative by at most d!/(d − order)! ρ / Δtᵒ. A jump J of a
        lower derivative, i orders below, counts as i! J/Δtⁱ on the later piece. Larger jumps are reported as
        violations.
        """
        spans = self._spans[:, None]
        found = np.zeros((self.pieces, self.n))
        for lower in range(order):
            jumps = np.minimum(np.abs(self.jumps(lower)), RATE_TOLERANCE[lower])
            found[1:] += factorial(order - lower) * jumps / spans[1:] ** (order - lower)
        if self.rounding is None:
            return found
        # Jumps that rounding explains are not counted twice.
        return np.maximum(found, perm(self.degree, order) * self.rounding / spans**order)

    def __repr__(self) -> str:
        lasts = f", {self.duration:.3f} s" if self.timed else ""
        slack = "" if self.slack is None else f", slack {self.slack.max():.3g}"
        return f"Motion({self.pieces} pieces of degree {self.degree}, {self.n} joints{lasts}{slack})"

    @classmethod
    def through(cls, points: ArrayLike, times: ArrayLike | None = None, names: Sequence[str] | None = None) -> Motion:
        """Return the straight lines through way points (N, n). Without `times` (N,) [s] the motion is a path."""
        return cls._made(forms.straight(times, points, "way points"), names, timed=times is not None)

    @classmethod
    def _made(cls, pieces: forms.Pieces, names: Sequence[str] | None, **options: Any) -> Motion:
        times, coefficients, rounding = pieces
        return cls(times, coefficients, names, rounding=rounding, **options)  # type: ignore[arg-type]

    @classmethod
    def hermite(
        cls,
        times: ArrayLike,
        positions: ArrayLike,
        velocities: Any = None,
        accelerations: Any = None,
        names: Sequence[str] | None = None,
    ) -> Motion:
        """Return the motion that ROS 2's joint_trajectory_controller interpolates.

        Pieces are linear if only positions are given, cubic with velocities, and quintic with velocities and
        accelerations.

        Parameters
        ----------
        times : array_like, shape (N,)
            Increasing [s].
        positions, velocities, accelerations : array_like, shape (N, n)
            [rad, rad/s, rad/s²; m for prismatic joints]. Velocities and accelerations may be lists of rows in which
            None marks a point without them. Pieces at such a point have the lower degree.
        names : sequence of str, optional
            The joints.

        Raises
        ------
        InputError
            As the class, or if a point has accelerations but no velocities, which the controller does not interpolate.
        """
        return cls._made(forms.hermite(times, positions, velocities, accelerations), names)

    @classmethod
    def sampled(
        cls, times: ArrayLike, positions: ArrayLike, max_velocity: float | ArrayLike, names: Sequence[str] | None = None
    ) -> Motion:
        """Return linear interpolation of samples (N, n), with slack for the unknown motion between samples.

        In Δt a joint that moves by Δq with velocity at most v is within (v² − (Δq/Δt)²) Δt / 2v ≤ ½ v Δt of the line.
        `max_velocity`, a number or (n,), bounds the velocity of each joint at any time [rad/s or m/s]. Raises
        InputError as the class, or if consecutive samples are farther apart than `max_velocity` allows.
        """
        pieces, slack = forms.sampled(times, positions, max_velocity)
        return cls._made(pieces, names, slack=slack)

    @classmethod
    def of(cls, thing: Any, names: Sequence[str] | None = None, space: Any = None) -> Motion:
        """Convert an object of another library to a motion.

        Parameters
        ----------
        thing : object
            A `Motion`; SciPy's `PPoly` (`CubicSpline`, `Akima1DInterpolator`, …), `BPoly` or `BSpline` with values
            (n,); way points (N, n); a `PlanResult`; OMPL's `PathGeometric` or a solved `SimpleSetup`, in which angles
            are interpolated as by their space; or a `Trajectory`, interpolated between its `points` as by controllers.
        names : sequence of str, optional
            The joints, if the object does not name them.
        space : ob.StateSpace or Robot, optional
            The state space of a `PathGeometric`, which does not store it, or the robot with its joints.

        Raises
        ------
        InputError
            If the type is not supported, or as the class.
        """
        kinds = {kind.__name__ for kind in type(thing).__mro__}
        if isinstance(thing, Motion):
            return thing if names is None else replace(thing, joint_names=tuple(names))
        if "BPoly" in kinds:
            return cls._made(forms.bezier(np.swapaxes(forms.vector_coefficients(thing, 3), 0, 1), thing.x), names)
        if "PPoly" in kinds:
            return cls._made(forms.from_ppoly(thing), names)
        if "BSpline" in kinds:
            return cls._made(forms.bspline(thing), names)
        if "Trajectory" in kinds:
            times, points = thing.points()
            joints = thing.joint_names if names is None else names
            return cls.hermite(times, points["positions"], points["velocities"], points.get("accelerations"), joints)
        if hasattr(thing, "getSolutionPath"):
            thing, space = thing.getSolutionPath(), thing.getStateSpace()
        if hasattr(thing, "getStateCount"):
            return cls.through(forms.path_states(thing, space), names=names)
        if hasattr(thing, "joint_names") and hasattr(thing, "path"):
            if thing.path is None:
                raise InputError(f"{thing!r} has no path", "motion")
            thing, names = thing.path, thing.joint_names
        if isinstance(thing, (np.ndarray, list, tuple)):
            return cls.through(thing, names=names)
        raise InputError(
            "must be a Motion, SciPy's PPoly, BPoly or BSpline, way points (N, n), a PlanResult, a "
            f"Trajectory or OMPL's PathGeometric, got {shown(thing)}",
            "motion",
        )

    def to_mapping(self) -> dict[str, Any]:
        """Return the motion as plain data, which `from_mapping` reads back exactly."""
        held = {key: getattr(self, key) for key in ("times", "coefficients", "slack", "rounding")}
        arrays = {key: value.tolist() for key, value in held.items() if value is not None}
        names = None if self.joint_names is None else list(self.joint_names)
        return {"joint_names": names, **arrays, "timed": self.timed, "corners": list(self.corners)}

    @classmethod
    def from_mapping(cls, data: Mapping[str, Any]) -> Motion:
        """Read a motion from plain data; raise InputError if a key is missing, or as the class."""
        names = data.get("joint_names")
        return cls(
            documents.require(data, "times"),
            documents.require(data, "coefficients"),
            None if names is None else tuple(documents.sequence("joint_names", names)),
            data.get("slack"),
            documents.flag("timed", data.get("timed", True)),
            data.get("rounding"),
            tuple(documents.list_of("corners", data.get("corners", ()), documents.whole_number, at_least=1)),
        )


def _freeze(motion: Motion, name: str, array: FloatArray) -> None:
    array = np.ascontiguousarray(array)
    array.setflags(write=False)
    object.__setattr__(motion, name, array)
