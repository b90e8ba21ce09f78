"""The danger of a configuration: the robot's field at the places that must not come to harm."""

from __future__ import annotations

from collections.abc import Callable, Sized
from functools import cached_property
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from safe_ompl.arrays import FloatArray, IntArray, finite_array, positive
from safe_ompl.collision.arguments import configuration, configurations
from safe_ompl.counts import Counts
from safe_ompl.danger.obstacles import DangerousObstacles
from safe_ompl.errors import InputError, UnknownNameError
from safe_ompl.maths import field as maths
from safe_ompl.maths.field import Segments, Weighting
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scene import Scene

Aggregate: TypeAlias = Literal["max", "mean", "softmax"]
PointSource: TypeAlias = Callable[[FloatArray], ArrayLike]
AGGREGATES: tuple[Aggregate, ...] = ("max", "mean", "softmax")


class DangerField:
    """Cumulative danger field of a robot at danger points, CDF(q) = aggregate_m w_m CDF(p_m; q) (paper §3).

    The field of the robot at a point is the sum over its links of k₁ ∫ dt/‖p − r_t‖, eq. (5)–(7). The danger
    of a configuration is its maximum over the danger points, as in the paper, or a mean.

    Parameters
    ----------
    robot : Robot
        Gives the key points and segments of the skeleton.
    points : array_like, shape (M, 3), or callable
        Danger points in the world frame [m]. A callable maps a configuration (n,) to its danger points,
        always equally many, such as the nearest point of each obstacle (see Notes). Without any point the danger
        is zero everywhere.
    weights : array_like, shape (M,), optional
        w > 0 for each point, the danger weight of its obstacle; 1 by default.
    aggregate : {"max", "mean", "softmax"}
        With levels x_m = w_m CDF(p_m): the largest; their mean; or the smooth (1/β) log Σ_m exp(β x_m), which
        exceeds the largest by no more than log(M)/β.
    weighting : {"unit", "length"}
        Every link weighs the same (eq. 4), or in proportion to its length (eq. 1).
    k1 : float
        k₁ > 0 of the elementary field (6). The danger is in k₁/m with unit weighting, else in k₁.
    sharpness : float
        β > 0 of the softmax, in units of 1/danger. Large values approach the maximum.
    counts : Counts, optional
        Where evaluations are counted.

    Attributes
    ----------
    robot, aggregate, weighting, k1, sharpness, counts
        As given.
    revision : int
        How often obstacles have moved. What was computed at another revision is of another scene.

    Raises
    ------
    InputError
        If the robot has no links; if points or weights have the wrong shape, are not finite,
        or weights are not positive; if `aggregate` or `weighting` is unknown; if `k1` or `sharpness` is not positive.

    Notes
    -----
    Gradients hold the danger points where they are. For points that a callable moves with the configuration
    this leaves out (∂CDF/∂p)·(dp/dq). It vanishes where a point stays (on a corner, say) and where it is the
    point of its obstacle at which the field is greatest (envelope theorem). The point *nearest* to the robot
    is close to that one but not the same: there the gradient is an approximation, the better the smaller the
    obstacle. Values are exact for the points used.

    With "max" the gradient is that of the most dangerous point: one of the subgradients where two points tie.
    """

    def __init__(
        self,
        robot: Robot,
        points: ArrayLike | PointSource,
        weights: ArrayLike | None = None,
        *,
        aggregate: Aggregate = "max",
        weighting: Weighting = "unit",
        k1: float = 1.0,
        sharpness: float = 10.0,
        counts: Counts | None = None,
    ) -> None:
        if aggregate not in AGGREGATES:
            raise UnknownNameError("aggregate", aggregate, AGGREGATES)
        maths.check_weighting(weighting)
        if not len(robot.segments):
            raise InputError(
                f"{robot.name!r} has no link of any length for a danger; give a tip beyond its joints"
            )
        self.robot = robot
        self.aggregate = aggregate
        self.weighting = weighting
        self.k1 = positive(k1, "k1")
        self.sharpness = positive(sharpness, "sharpness")
        self.counts = Counts() if counts is None else counts
        self._segments = Segments(robot.segments, _constant_lengths(robot))
        self._obstacles: DangerousObstacles | None = None
        self.revision = 0
        self._take_points(points, weights)

    @classmethod
    def of_scene(
        cls, robot: Robot, scene: Scene, spacing: float | None = None, **options: Any
    ) -> DangerField:
        """Return the field at the danger points of a scene (`Scene.danger_points`); it can `move` with them.

        Parameters
        ----------
        robot : Robot
            The robot.
        scene : Scene
            The obstacles.
        spacing : float, optional
            Distance between danger points [m]; default: the scene's own.
        **options
            As of the class.
        """
        obstacles = DangerousObstacles(scene, spacing)
        field = cls(robot, *obstacles.points, **options)
        field._obstacles = obstacles
        return field

    def move(self, scene: Scene) -> None:
        """Take the danger points of a scene in which nothing but places of obstacles differs, such as `Scene.moved`.

        From here on the danger is that of a field made anew for that scene.

        Raises
        ------
        InputError
            If anything else differs, or the field was not made by `of_scene`. Then it stays as it was.
        """
        if self._obstacles is None:
            raise InputError(
                "this field knows points, not a scene; DangerField.of_scene makes one that can move"
            )
        if self._obstacles.move(scene):
            self._take_points(*self._obstacles.points)
            self.revision += 1

    def _take_points(self, points: ArrayLike | PointSource, weights: ArrayLike | None) -> None:
        """Take danger points and weights, and forget what followed from others."""
        self._points: FloatArray | PointSource = points if callable(points) else _danger_points(points)
        number = None if self.points is None else len(self.points)
        self._weights: FloatArray | None = None if weights is None else _danger_weights(weights, number)
        vars(self).pop("minimum", None)

    def __repr__(self) -> str:
        points = repr(self._points) if self.points is None else f"<{len(self.points)} points>"
        return (
            f"DangerField({self.robot!r}, {points}, aggregate={self.aggregate!r}, "
            f"weighting={self.weighting!r}, k1={self.k1:g}, sharpness={self.sharpness:g})"
        )

    @property
    def points(self) -> FloatArray | None:
        """The danger points (M, 3) [m], read-only; None where a callable gives them."""
        return self._points if isinstance(self._points, np.ndarray) else None

    @property
    def weights(self) -> FloatArray | None:
        """The weights (M,) of the danger points, read-only; None where all are 1."""
        return self._weights

    # ------------------------------------------------------------------------------ danger of configurations

    def value(self, q: ArrayLike) -> float:
        """Return the danger CDF(q) at `q: (n,)`; +inf where a segment passes through a danger point.

        Raises
        ------
        InputError
            If `q` has the wrong shape or is not finite.
        """
        return float(self._danger(self._single(q))[0])

    def values(self, Q: ArrayLike) -> FloatArray:
        """Return the danger (B,) at a batch of configurations `Q: (B, n)`; see `value`."""
        return self._danger(self._batch(Q))

    def gradient(self, q: ArrayLike) -> FloatArray:
        """Return ∇CDF(q), (n,), at `q: (n,)` [danger/rad or danger/m]; see the Notes of the class.

        Raises
        ------
        InputError
            If `q` has the wrong shape or is not finite.
        """
        gradient: FloatArray = self.gradients(self._single(q))[0]
        return gradient

    def gradients(self, Q: ArrayLike) -> FloatArray:
        """Return the gradients (B, n) at a batch of configurations `Q: (B, n)`; see `gradient`."""
        return self.values_and_gradients(Q)[1]

    def values_and_gradients(self, Q: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the danger (B,) and its gradients (B, n) at `Q: (B, n)` for the price of the gradients."""
        Q = self._batch(Q)
        keypoints, points = self._keypoints(Q), self.points_at(Q)
        levels = self._levels(keypoints, points)
        if not levels.size:
            return np.zeros(len(Q)), np.zeros(Q.shape)
        return self._aggregated(levels), self._pulled_back(Q, keypoints, *self.contributions(levels, points))

    def terms_above(self, Q: ArrayLike, level: float) -> tuple[IntArray, FloatArray, FloatArray]:
        """Return the terms of the danger that are above a level at `Q: (B, n)`.

        Where the danger is the maximum over danger points, its terms are w_m CDF(p_m); else it is its own only term.

        Returns
        -------
        rows : ndarray of int, shape (C,)
            Configuration of each of them.
        values : ndarray, shape (C,)
        gradients : ndarray, shape (C, n)
            [danger/rad or danger/m]

        Raises
        ------
        InputError
            If `Q` has the wrong shape or is not finite.
        """
        Q = self._batch(Q)
        if self.aggregate != "max":
            values, gradients = self.values_and_gradients(Q)
            above = np.flatnonzero(values > level)
            return above, values[above], gradients[above]
        keypoints, points = self._keypoints(Q), self.points_at(Q)
        levels = self._levels(keypoints, points)
        rows, terms = np.nonzero(levels > level)
        gradients = self._pulled_back(Q[rows], keypoints[rows], *self._chosen(points, rows, terms))
        return rows, levels[rows, terms], gradients

    def most_dangerous_point(self, q: ArrayLike) -> int:
        """Return the index of the danger point with the largest w_m CDF(p_m) at `q: (n,)`.

        Raises
        ------
        InputError
            If `q` has the wrong shape or is not finite, or there are no danger points.
        """
        Q = self._single(q)
        levels = self._levels(self._keypoints(Q), self.points_at(Q))[0]
        if not len(levels):
            raise InputError("there are no danger points; give an obstacle a weight > 0")
        return int(levels.argmax())

    @cached_property
    def minimum(self) -> float:
        """A proven lower bound of the danger at any configuration: every link as far away as it can get.

        Zero where there are no danger points, a callable gives them, or prismatic joints make the links' lengths
        change (eq. 1).
        """
        if self.points is None or not len(self.points):
            return 0.0
        if self.weighting == "length" and self._segments.lengths is None:
            return 0.0
        ends = self.robot.keypoint_reaches(self.points)[self.robot.segments]
        farthest = ends.max(axis=1)  # (L, M): no point of a segment is farther away than both of its ends
        lengths = self._segments.lengths if self.weighting == "length" else None
        charges = np.ones(len(farthest)) if lengths is None else lengths.ravel()
        return float(self.aggregated(self.k1 * (charges @ (1.0 / farthest))[None])[0])

    # --------------------------------------------------------------------------------------- parts of danger

    @property
    def segments(self) -> Segments:
        """The link segments; their lengths are None where a prismatic joint may change them."""
        return self._segments

    def link_fields(self, keypoints: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the field of every link at the danger points, and the points' distances from the links.

        Parameters
        ----------
        keypoints : ndarray, shape (B, K, 3)
            Key points of the skeleton at B configurations [m].

        Returns
        -------
        fields : ndarray, shape (B, L, M)
            φ_l(p_m) with unit weighting (4), unweighted; +inf on a segment.
        distances : ndarray, shape (B, L, M)
            [m]

        Raises
        ------
        InputError
            If a callable gives the danger points.
        """
        points = self.points
        if points is None:
            raise InputError("the danger points depend on the configuration; fields of links need fixed ones")
        self.count(keypoints, points)
        if not len(points):
            nothing = np.zeros((len(keypoints), len(self._segments.pairs), 0))
            return nothing, nothing
        fields = maths.segment_fields(keypoints, self._segments, points, k1=self.k1)
        return fields, maths.segment_distances(keypoints, self._segments, points)

    def aggregated(self, fields: FloatArray) -> FloatArray:
        """Return the danger (B,) where the robot's field at the danger points is `fields: (B, M)`, unweighted."""
        return self._aggregated(fields if self._weights is None else fields * self._weights)

    def active(self, Q: ArrayLike, share: float) -> DangerField:
        """Return the field of those danger points that matter near the configurations `Q: (B, n)`.

        These are the points whose w_m CDF(p_m) reaches the given share of the maximum at one of them, at least. Where
        the danger is a mean, or a callable gives the points, all of them matter, and the field itself is returned.

        Raises
        ------
        InputError
            If `Q` has the wrong shape or is not finite.
        """
        if self.points is None or not len(self.points) or self.aggregate != "max":
            return self
        levels = self._levels(self._keypoints(self._batch(Q)), self.points)
        near = (levels >= share * levels.max(axis=1, keepdims=True)).any(axis=0)
        weights = None if self._weights is None else self._weights[near]
        return self if near.all() else self.with_points(self.points[near], weights)

    def with_points(self, points: FloatArray, weights: FloatArray | None) -> DangerField:
        """Return the field at other danger points (M, 3) with weights (M,)."""
        return DangerField(
            self.robot,
            points,
            weights,
            aggregate=self.aggregate,
            weighting=self.weighting,
            k1=self.k1,
            sharpness=self.sharpness,
            counts=self.counts,
        )

    # ---------------------------------------------------------------------------- the field in the workspace

    def field(self, q: ArrayLike, points: ArrayLike) -> FloatArray:
        """Return the field CDF(p), (M,), of the robot at `q: (n,)` at any `points: (M, 3)` [m], unweighted.

        Raises
        ------
        InputError
            If `q` or `points` has the wrong shape or is not finite; so do the other methods of this kind.
        """
        values: FloatArray = self._field(*self._scene(q, points))[0]
        return values

    def workspace_gradient(self, q: ArrayLike, points: ArrayLike) -> FloatArray:
        """Return the gradient ∇_p CDF(p), (M, 3), of the field at `points: (M, 3)` [m]; zero on a segment."""
        return self._workspace_gradient(*self._scene(q, points))

    def vector(self, q: ArrayLike, points: ArrayLike) -> FloatArray:
        """Return the vector field (8), (M, 3), at `points: (M, 3)` [m]: CDF(p) long, towards the robot."""
        scene = self._scene(q, points)
        return maths.vector_field(self._field(*scene)[0], self._workspace_gradient(*scene))

    def push(self, q: ArrayLike) -> FloatArray:
        """Return the joint motion (n,) that the field's vectors ask for at `q: (n,)`, Σ_m Σ_l J_lᵀ w_m CDF(p_m).

        J_l is the Jacobian of the distal end of link l; the sum goes over all danger points (paper, §4.3). It is not
        finite where a segment passes through a danger point.
        """
        Q = self._single(q)
        keypoints, points = self._scene(Q[0], self.points_at(Q).reshape(-1, 3))
        vectors = maths.vector_field(
            self._field(keypoints, points)[0], self._workspace_gradient(keypoints, points)
        )
        total = vectors.sum(axis=0) if self._weights is None else self._weights @ vectors
        pushes = np.zeros(keypoints.shape)
        np.add.at(pushes[0], self.robot.segments[:, 1], total)
        motion: FloatArray = self.robot.pull_back(Q, pushes)[0]
        return motion

    # ------------------------------------------------------------------------------------------------ within

    def _single(self, q: ArrayLike) -> FloatArray:
        return configuration(q, self.robot.n)[None]

    def _batch(self, Q: ArrayLike) -> FloatArray:
        return configurations(Q, self.robot.n)

    def _danger(self, Q: FloatArray) -> FloatArray:
        return self._aggregated(self._levels(self._keypoints(Q), self.points_at(Q)))

    def _keypoints(self, Q: FloatArray) -> FloatArray:
        return self.robot.keypoints(Q[0])[None] if len(Q) == 1 else self.robot.keypoints_batch(Q)

    def _scene(self, q: ArrayLike, points: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return key points (1, K, 3) and field points (M, 3), and count them."""
        keypoints, checked = self._keypoints(self._single(q)), finite_array(points, (None, 3), "points")
        self.count(keypoints, checked)
        return keypoints, checked

    def points_at(self, Q: FloatArray) -> FloatArray:
        """Return the danger points, (M, 3) or, where they depend on the configuration, (B, M, 3)."""
        if isinstance(self._points, np.ndarray):
            return self._points
        found = [_danger_points(self._points(q)) for q in Q]
        numbers = {len(points) for points in found}
        if self._weights is not None:
            numbers.add(len(self._weights))
        if len(numbers) > 1:
            raise InputError(f"the number of danger points must not change, got {sorted(numbers)}")
        return np.reshape(found, (len(Q), *(numbers or {1}), 3))

    def count(self, keypoints: FloatArray, points: FloatArray) -> None:
        """Count an evaluation of the points at every configuration."""
        self.counts.field_configurations += len(keypoints)
        self.counts.field_points += len(keypoints) * points.shape[-2]

    def _field(self, keypoints: FloatArray, points: FloatArray) -> FloatArray:
        return maths.field(keypoints, self._segments, points, weighting=self.weighting, k1=self.k1)

    def _workspace_gradient(self, keypoints: FloatArray, points: FloatArray) -> FloatArray:
        weighting, k1 = self.weighting, self.k1
        gradient = maths.workspace_gradient(keypoints, self._segments, points, weighting=weighting, k1=k1)
        return gradient.reshape(-1, 3)

    def _levels(self, keypoints: FloatArray, points: FloatArray) -> FloatArray:
        """Return w_m CDF(p_m), (B, M), and count it."""
        self.count(keypoints, points)
        levels = self._field(keypoints, points)
        if self._weights is not None:
            levels *= self._weights
        return levels

    def _pulled_back(
        self, Q: FloatArray, keypoints: FloatArray, points: FloatArray, rates: FloatArray
    ) -> FloatArray:
        """Return Σ_m rate_m ∂CDF(p_m)/∂q, (B, n), of points (m, 3) or (B, m, 3) with rates (B, m)."""
        weighting, k1 = self.weighting, self.k1
        pulls = maths.keypoint_gradient(keypoints, self._segments, points, rates, weighting=weighting, k1=k1)
        return self.robot.pull_back(Q, pulls)

    def _aggregated(self, levels: FloatArray) -> FloatArray:
        """Return the danger (B,) of levels (B, M); zero where there are none."""
        if not levels.shape[1]:
            return np.zeros(len(levels))
        danger: FloatArray = levels.mean(axis=1) if self.aggregate == "mean" else levels.max(axis=1)
        if self.aggregate == "softmax":
            danger += np.log(self._exponentials(levels).sum(axis=1)) / self.sharpness
        return danger

    def contributions(self, levels: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the points that matter, (B, m, 3) or (M, 3), and ∂CDF/∂CDF(p) for each, (B, m)."""
        if self.aggregate == "max":
            return self._chosen(points, np.arange(len(levels)), levels.argmax(axis=1))
        weights = np.ones(levels.shape[1]) if self._weights is None else self._weights
        if self.aggregate == "mean":
            return points, np.broadcast_to(weights / levels.shape[1], levels.shape)
        shares = self._exponentials(levels)
        shares /= shares.sum(axis=1, keepdims=True)
        return points, shares * weights

    def _chosen(self, points: FloatArray, rows: IntArray, terms: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return danger points (C, 1, 3) and weights (C, 1): for each of `rows: (C,)` the one of `terms: (C,)`."""
        chosen = points[terms] if points.ndim == 2 else points[rows, terms]
        weights = np.ones(len(terms)) if self._weights is None else self._weights[terms]
        return chosen[:, None], weights[:, None]

    def _exponentials(self, levels: FloatArray) -> FloatArray:
        """Return exp(β (x_m − max x)), (B, M), which cannot overflow; 1 where x_m is the maximum."""
        peaks = levels.max(axis=1, keepdims=True)
        gaps = np.subtract(levels, peaks, out=np.zeros_like(levels), where=levels != peaks)
        exponentials: FloatArray = np.exp(self.sharpness * gaps)
        return exponentials


def _danger_points(points: ArrayLike) -> FloatArray:
    """Return danger points (M, 3) in Fortran order, which the field reads fastest; read-only."""
    if isinstance(points, Sized) and not len(points):
        points = np.zeros((0, 3))
    checked = np.asfortranarray(finite_array(points, (None, 3), "danger points"))
    checked.setflags(write=False)
    return checked


def _danger_weights(weights: ArrayLike, number: int | None) -> FloatArray:
    checked = finite_array(weights, (number,), "danger weights")
    if not (checked > 0).all():
        raise InputError(
            f"danger weights must be positive, got {checked[checked <= 0].tolist()}; leave out the others"
        )
    checked.setflags(write=False)
    return checked


def _constant_lengths(robot: Robot) -> FloatArray | None:
    """Return the lengths (L,) [m] of the segments, or None where a prismatic joint may change them."""
    if robot.joint_prismatic.any():
        return None
    start, end = robot.keypoints(np.zeros(robot.n))[robot.segments.T]
    lengths: FloatArray = np.linalg.norm(end - start, axis=-1)
    return lengths
