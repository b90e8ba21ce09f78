"""The cost functional of a path: length, and densities such as danger along it; with the exact gradient."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from safe_ompl.collision import CollisionChecker
from safe_ompl.common import FloatArray, IntArray, number
from safe_ompl.danger import DangerField
from safe_ompl.paths.measures import Curve
from safe_ompl.paths.simplify import kernels as kernel
from safe_ompl.robot import Robot, plain

_BESIDE, _CLOSELY = 0.4, 0.02  # [rad] so far from the ends peaks are looked for, at samples so close together
_EXCESS = 0.02  # share by which a peak is above what is forced


def peaks_beside_ends(curve: Curve, field: DangerField, forced: float) -> tuple[FloatArray, FloatArray]:
    """Return where danger peaks beside the ends of a path, above what the ends themselves force.

    Parameters
    ----------
    curve : Curve
        The path.
    field : DangerField
        The danger.
    forced : float
        The danger that no path between the ends avoids.

    Returns
    -------
    places : ndarray, shape (K,)
        Arc length of each peak [rad].
    configurations : ndarray, shape (K, n)
    """
    beside = np.arange(0.0, min(_BESIDE, 0.5 * curve.length), _CLOSELY)
    s = np.concatenate([beside, curve.length - beside[::-1]])
    samples = curve.at(s)
    danger = field.values(samples)
    inner = danger[1:-1]
    peak = (inner > (1.0 + _EXCESS) * forced) & (inner >= danger[:-2]) & (inner >= danger[2:])
    return s[1:-1][peak], samples[1:-1][peak]


STEP = 0.05  # [rad] between the samples of the cost of a path, as in its report
WEIGHT = 5.0  # of danger against length
_REFERENCE_SAMPLES = 64

_TINY = 1e-12  # [rad]
_SHORT = 0.1  # shorter segments than this share of the mean count as such a share


class Expansion(NamedTuple):
    """A density at B configurations, with its derivatives; where it bends, at C rows, it does like Σ vvᵀ or more.

    Attributes
    ----------
    values : ndarray, shape (B,)
    gradients : ndarray, shape (B, n)
    rows : ndarray of int, shape (C,)
    bends : ndarray, shape (C, n)
        The vectors v.
    """

    values: FloatArray
    gradients: FloatArray
    rows: IntArray
    bends: FloatArray


class QuadraticModel(NamedTuple):
    """The cost of a path (N, n) to the second order.

    Attributes
    ----------
    value : float
    gradient : ndarray, shape (N, n)
    blocks : ndarray, shape (N, n, n)
        Of about the Hessian, on its diagonal.
    beside : ndarray, shape (N − 1, n, n)
        Right of them.
    """

    value: float
    gradient: FloatArray
    blocks: FloatArray
    beside: FloatArray


class Density(Protocol):
    """Cost of a radian of path at a configuration."""

    def values(self, Q: FloatArray) -> FloatArray:
        """Return the density (B,) at `Q: (B, n)`."""

    def values_and_gradients(self, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the density (B,) and its gradients (B, n) at `Q: (B, n)`."""

    def expansion(self, Q: FloatArray) -> Expansion:
        """Return the density and its derivatives at `Q: (B, n)`."""


class DangerDensity:
    """λ·CDF(q)ᵖ with λ = weight/reference(CDF)ᵖ, so that one weight serves all robots and scenes.

    Parameters
    ----------
    field : DangerField
        The danger.
    reference : float
        The danger at which a radian of path costs `weight` radians of length.
    weight : float
        Of danger against length, ≥ 0.
    exponent : float
        p ≥ 1. Larger ones punish peaks.

    Raises
    ------
    InputError
        If a number is out of range.
    """

    def __init__(
        self, field: DangerField, reference: float, weight: float = WEIGHT, exponent: float = 1.0
    ) -> None:
        self.field = field
        self.reference = number("reference", reference, above=0.0)
        self.weight = number("weight", weight, at_least=0.0)
        self.exponent = number("exponent", exponent, at_least=1.0)

    def __repr__(self) -> str:
        return (
            f"DangerDensity({self.field!r}, {self.reference:g}, weight={self.weight:g}, "
            f"exponent={self.exponent:g})"
        )

    def values(self, Q: FloatArray) -> FloatArray:
        """Return the density (B,) at `Q: (B, n)`."""
        return self._of(self.field.values(Q) / self.reference)

    def values_and_gradients(self, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the density (B,) and its gradients (B, n) at `Q: (B, n)`."""
        return self.expansion(Q)[:2]

    def expansion(self, Q: FloatArray) -> Expansion:
        """Return the density and its derivatives at `Q: (B, n)`, the second ones as if the danger were linear."""
        danger, slopes = self.field.values_and_gradients(Q)
        relative = danger / self.reference
        slopes = slopes / self.reference
        p = self.exponent
        rates = self.weight * p * relative ** (p - 1)
        bend = self.weight * p * (p - 1) * relative ** (p - 2) if p > 1 else np.zeros(len(Q))
        return Expansion(
            self._of(relative), rates[:, None] * slopes, np.arange(len(Q)), np.sqrt(bend)[:, None] * slopes
        )

    def restricted(self, field: DangerField) -> DangerDensity:
        """Return the same density of another field, such as one of fewer danger points."""
        return DangerDensity(field, self.reference, self.weight, self.exponent)

    def _of(self, relative: FloatArray) -> FloatArray:
        density: FloatArray = self.weight * relative**self.exponent
        return density


def reference_danger(field: DangerField, checker: CollisionChecker) -> float:
    """Return the median danger over valid configurations, the scale of robot and scene; 1 if nothing is dangerous."""
    samples = _configurations(checker.robot)
    valid = samples[[not checker.in_collision(q) for q in samples]]
    return float(np.median(field.values(valid if len(valid) else samples))) or 1.0


def _configurations(robot: Robot) -> FloatArray:
    rng = np.random.default_rng(0)  # always the same: the scale belongs to robot and scene
    return rng.uniform(robot.lower, robot.upper, (_REFERENCE_SAMPLES, robot.n))


class PathCost:
    """J = ∫ (1 + Σ density(q(s))) ds over a path's arc length in joint space.

    Parameters
    ----------
    robot : Robot
        Whose joints move.
    densities : sequence of Density
        What a radian of path costs besides its length.
    """

    def __init__(self, robot: Robot, densities: Sequence[Density]) -> None:
        self.robot = robot
        self.densities = tuple(densities)

    def __repr__(self) -> str:
        return f"PathCost({self.robot!r}, {list(self.densities)!r})"

    def of(self, path: FloatArray, step: float = STEP) -> float:
        """Return J of a path (N, n), by the trapezoidal rule on samples at most `step` apart [rad]."""
        curve = Curve(self.robot, path)
        s = np.linspace(0.0, curve.length, 2 + int(curve.length / step))
        return float(np.trapezoid(self._total(curve.at(s)), s))

    def of_edges(self, starts: FloatArray, ends: FloatArray, samples: IntArray) -> FloatArray:
        """Return J (E,) of motions from `starts` to `ends: (E, n)`, by the midpoint rule on `samples: (E,)` each."""
        deltas = self.robot.difference(starts, ends)
        edge = np.repeat(np.arange(len(samples)), samples)
        first = np.concatenate([[0], np.cumsum(samples)[:-1]])
        t = (np.arange(len(edge)) - first[edge] + 0.5) / samples[edge]
        total = self._total(starts[edge] + t[:, None] * deltas[edge])
        costs: FloatArray = np.add.reduceat(total, first) / samples * np.linalg.norm(deltas, axis=1)
        return costs

    def value_and_gradient(self, path: FloatArray) -> tuple[float, FloatArray]:
        """Return J with two Gauss points on each segment of an unrolled path (N, n), and its exact gradient (N, n).

        See `safe_ompl.paths.simplify.kernels`.
        """
        nodes = self.nodes(path)
        values, slopes = np.ones(len(nodes)), np.zeros(nodes.shape)
        for density in self.densities:
            more, steeper = density.values_and_gradients(nodes)
            values += more
            slopes += steeper
        return kernel.integrated(plain(path), values, slopes)

    def model(self, path: FloatArray) -> QuadraticModel:
        """Return the same with about the Hessian of J.

        Length resists bending like springs, Σ f/2ℓ·‖x_{k+1} − x_k‖² with the path's mean density f. What the
        densities add is their Gauss-Newton part; so the whole is positive.
        """
        nodes = self.nodes(path)
        expansions = [density.expansion(nodes) for density in self.densities]
        value, gradient = kernel.integrated(
            plain(path),
            sum((expansion.values for expansion in expansions), np.ones(len(nodes))),
            sum((expansion.gradients for expansion in expansions), np.zeros(nodes.shape)),
        )
        lengths = np.linalg.norm(path[1:] - path[:-1], axis=1)
        mean = value / max(lengths.sum(), _TINY)
        blocks, beside = _springs(
            mean / np.maximum(lengths, max(_SHORT * lengths.mean(), _TINY)), path.shape[1]
        )
        for expansion in expansions:
            kernel.add_bends(plain(path), expansion.rows, plain(expansion.bends), blocks, beside)
        return QuadraticModel(value, gradient, blocks, beside)

    def nodes(self, path: FloatArray) -> FloatArray:
        """Return the Gauss points (2N − 2, n) of the segments of a path (N, n)."""
        return kernel.nodes(plain(path))

    def _total(self, Q: FloatArray) -> FloatArray:
        total = np.ones(len(Q))
        for density in self.densities:
            total += density.values(Q)
        return total


def _springs(stiffness: FloatArray, n: int) -> tuple[FloatArray, FloatArray]:
    """Return the Hessian of springs of stiffness (N − 1,) between way points: on the diagonal and beside it."""
    blocks, beside = np.zeros((len(stiffness) + 1, n, n)), np.zeros((len(stiffness), n, n))
    joint = np.arange(n)
    blocks[:-1, joint, joint] += stiffness[:, None]
    blocks[1:, joint, joint] += stiffness[:, None]
    beside[:, joint, joint] -= stiffness[:, None]
    return blocks, beside
