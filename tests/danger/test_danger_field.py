"""Danger of configurations: aggregates, C-space gradients, moving danger points, counters, bad input."""

import math
import pickle

import numpy as np
import pinocchio as pin
import pytest

from safe_ompl import DangerField, InputError, Robot
from safe_ompl.common import Counts
from safe_ompl.danger.link_field import WEIGHTINGS, Segments, field
from safe_ompl.danger.points import AGGREGATES
from safe_ompl.robot.joint_tables import Coupling, KinematicTree
from safe_ompl.robot.reach import JointChain


class PlanarArm:
    """Turning joints in the plane z = 0, links of the given lengths; on request the last joint slides."""

    def __init__(self, lengths=(0.4, 0.3, 0.2), slides=False):
        self.n = len(lengths)
        self.lengths = np.array(lengths)
        self.segments = np.array([[k, k + 1] for k in range(self.n)])
        self.prismatic = np.zeros(self.n, dtype=bool)
        self.prismatic[-1] = slides
        self.joint_prismatic = self.prismatic
        self.coupling = Coupling.of([f"joint{k}" for k in range(self.n)], {})
        chain = JointChain(
            list(range(self.n)),
            [pin.SE3(np.eye(3), np.array([at, 0.0, 0.0])) for at in (0.0, *lengths[:-1])],
            np.where(self.prismatic[:, None], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]),
            self.prismatic,
            np.full(self.n, -1.0),
            np.full(self.n, 1.0),
        )
        offsets = np.array([[length, 0.0, 0.0] for length in (0.0, *lengths)])
        self.kinematics = KinematicTree(chain, np.arange(self.n + 1), offsets)

    def __repr__(self):
        return f"PlanarArm({self.lengths.tolist()})"

    def directions(self, Q):
        """Return unit vectors (B, n, 3) along the links."""
        angle = np.cumsum(np.where(self.prismatic, 0, Q), axis=1)
        return np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)

    def keypoints_batch(self, Q):
        links = (self.lengths + np.where(self.prismatic, Q, 0))[..., None] * self.directions(Q)
        return np.concatenate([np.zeros((len(Q), 1, 3)), np.cumsum(links, axis=1)], axis=1)

    def keypoints(self, q):
        return self.keypoints_batch(q[None])[0]

    def pull_back(self, Q, gradients):
        keypoints, directions, out = self.keypoints_batch(Q), self.directions(Q), np.zeros(Q.shape)
        for i, k in np.ndindex(self.n, self.n + 1):
            if k > i:
                arm = keypoints[:, k] - keypoints[:, i]
                turn = np.stack([-arm[:, 1], arm[:, 0], 0 * arm[:, 2]], axis=-1)
                motion = directions[:, i] if self.prismatic[i] else turn
                out[:, i] += np.einsum("bc,bc->b", motion, gradients[:, k])
        return out


ARM = PlanarArm()
Q = np.random.default_rng(1).uniform(-1, 1, (6, 3))
POINTS = np.random.default_rng(2).normal(size=(9, 3)) * [0.5, 0.5, 0.1] + [0.4, 0.3, 0.15]
WEIGHTS = np.random.default_rng(3).uniform(0.5, 2, 9)


def levels(q, points=POINTS, weights=WEIGHTS, weighting="unit"):
    return weights * field(ARM.keypoints(q)[None], Segments(ARM.segments), points, weighting=weighting)[0]


def differences(function, q, step=1e-6):
    return np.array([(function(q + h) - function(q - h)) / (2 * step) for h in step * np.eye(len(q))])


# ---------------------------------------------------------------------------------------------------- values


def test_maximum_by_default():
    danger = DangerField(ARM, POINTS, WEIGHTS)
    for q in Q:
        assert danger.value(q) == pytest.approx(levels(q).max(), rel=1e-12)
        assert danger.most_dangerous_point(q) == levels(q).argmax()


def test_weights_are_one_by_default():
    np.testing.assert_allclose(
        DangerField(ARM, POINTS).values(Q), DangerField(ARM, POINTS, np.ones(9)).values(Q), rtol=1e-15
    )


def test_softmax_is_a_smooth_maximum_from_above():
    peaks = DangerField(ARM, POINTS, WEIGHTS).values(Q)
    for sharpness in (1e-2, 1.0, 10.0, 1e6):
        soft = DangerField(ARM, POINTS, WEIGHTS, aggregate="softmax", sharpness=sharpness).values(Q)
        assert (soft >= peaks).all()
        assert (soft <= peaks + math.log(9) / sharpness + 1e-12).all()
    q = Q[0]
    soft = DangerField(ARM, POINTS, WEIGHTS, aggregate="softmax", sharpness=2.0).value(q)
    assert soft == pytest.approx(np.log(np.exp(2 * levels(q)).sum()) / 2, rel=1e-12)


@pytest.mark.parametrize("aggregate", AGGREGATES)
def test_empty_batch(aggregate):
    danger = DangerField(ARM, POINTS, aggregate=aggregate)
    values, gradients = danger.values_and_gradients(np.empty((0, 3)))
    assert values.shape == (0,)
    assert gradients.shape == (0, 3)
    assert DangerField(ARM, lambda q: POINTS, WEIGHTS).values(np.empty((0, 3))).shape == (0,)


@pytest.mark.parametrize("aggregate", AGGREGATES)
def test_infinite_at_contact(aggregate):
    touched = ARM.keypoints(Q[0])[2]
    danger = DangerField(ARM, [touched, *POINTS], aggregate=aggregate)
    values, gradients = danger.values_and_gradients(Q)
    assert values[0] == np.inf
    assert np.isfinite(values[1:]).all()
    assert np.isfinite(gradients).all()


def test_softmax_does_not_overflow():
    near = ARM.keypoints(Q[0])[2] + [0, 0, 1e-6]
    danger = DangerField(ARM, [near, *POINTS], aggregate="softmax", sharpness=1e4)
    assert danger.value(Q[0]) == pytest.approx(DangerField(ARM, [near]).value(Q[0]), rel=1e-12)


# ------------------------------------------------------------------------------------------------- gradients


@pytest.mark.parametrize("aggregate", AGGREGATES)
@pytest.mark.parametrize("weighting", WEIGHTINGS)
@pytest.mark.parametrize("slides", [False, True])
def test_gradient_against_differences(aggregate, weighting, slides):
    robot = PlanarArm(slides=slides)
    danger = DangerField(robot, POINTS, WEIGHTS, aggregate=aggregate, weighting=weighting, k1=0.7, sharpness=3.0)
    for q in Q:
        np.testing.assert_allclose(danger.gradient(q), differences(danger.value, q), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("weights", [None, WEIGHTS])
def test_the_terms_above_a_level_are_the_fields_of_single_points(weights):
    danger = DangerField(ARM, POINTS, weights)
    level = float(np.median(danger.values(Q)))
    rows, values, gradients = danger.terms_above(Q, level)
    single = [DangerField(ARM, POINTS[[m]], None if weights is None else weights[[m]]) for m in range(9)]
    expected = [
        (row, one.value(q), one.gradient(q)) for row, q in enumerate(Q) for one in single if one.value(q) > level
    ]
    assert len(expected) > 1
    np.testing.assert_array_equal(rows, [row for row, _, _ in expected])
    np.testing.assert_allclose(values, [value for _, value, _ in expected], rtol=1e-12)
    np.testing.assert_allclose(gradients, [slope for _, _, slope in expected], rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("aggregate", ["mean", "softmax"])
def test_a_danger_that_is_no_maximum_is_its_own_term(aggregate):
    danger = DangerField(ARM, POINTS, aggregate=aggregate)
    values, gradients = danger.values_and_gradients(Q)
    level = float(np.median(values))
    rows, above, slopes = danger.terms_above(Q, level)
    np.testing.assert_array_equal(rows, np.flatnonzero(values > level))
    np.testing.assert_array_equal(above, values[rows])
    np.testing.assert_array_equal(slopes, gradients[rows])


def test_vector_field_and_workspace_gradient():
    danger, q = DangerField(ARM, POINTS, weighting="length"), Q[0]
    values, slopes, vectors = (danger.field(q, POINTS), danger.workspace_gradient(q, POINTS), danger.vector(q, POINTS))
    np.testing.assert_allclose(values, levels(q, weights=1, weighting="length"), rtol=1e-12)
    for p, slope in zip(POINTS, slopes, strict=True):
        expected = differences(lambda x: danger.field(q, x[None])[0], p)
        np.testing.assert_allclose(slope, expected, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), values, rtol=1e-12)
    np.testing.assert_allclose(vectors * np.linalg.norm(slopes, axis=1)[:, None], slopes * values[:, None], rtol=1e-12)


# ----------------------------------------------------------------------------------- points that move with q


def test_points_from_a_callable():
    def above_the_tip(q):
        return ARM.keypoints(q)[-1] + np.array([[0, 0, 0.2], [0, 0, 0.3]])

    danger = DangerField(ARM, above_the_tip, [1.0, 5.0])
    expected = [DangerField(ARM, above_the_tip(q), [1.0, 5.0]).value(q) for q in Q]
    np.testing.assert_allclose(danger.values(Q), expected, rtol=1e-12)
    assert danger.most_dangerous_point(Q[0]) == 1
    assert danger.points is None


def test_gradient_holds_moving_points_fixed():
    def beside_the_elbow(q):
        return ARM.keypoints(q)[[1]] + np.array([0, 0, 0.1])

    q = Q[0]
    fixed = DangerField(ARM, beside_the_elbow(q)).gradient(q)
    np.testing.assert_allclose(DangerField(ARM, beside_the_elbow).gradient(q), fixed, rtol=1e-12)


def test_gradient_is_exact_for_the_point_of_greatest_field():
    """Envelope theorem: on a wall y = 1 the most dangerous point slides along as the robot moves."""
    x = np.linspace(-1, 2, 60001)
    wall = np.stack([x, np.full_like(x, 1.0), np.zeros_like(x)], axis=1)
    fixed = DangerField(ARM, wall)

    def worst(q):
        return wall[fixed.most_dangerous_point(q)][None]

    q = np.array([0.4, 0.5, -0.3])
    danger = DangerField(ARM, worst)
    np.testing.assert_allclose(danger.gradient(q), differences(danger.value, q, 1e-3), rtol=1e-4, atol=1e-5)


# --------------------------------------------------------------------------------------------- house keeping


def test_counts_configurations_and_points():
    counts = Counts()
    danger = DangerField(ARM, POINTS, counts=counts)
    danger.value(Q[0])
    danger.values(Q)
    danger.gradient(Q[0])
    danger.values_and_gradients(Q)
    assert danger.counts is counts
    assert (counts.field_configurations, counts.field_points) == (14, 14 * 9)
    for method in (danger.field, danger.workspace_gradient, danger.vector):
        method(Q[0], POINTS[:4])
    assert (counts.field_configurations, counts.field_points) == (17, 14 * 9 + 3 * 4)


def test_survives_pickling():
    danger = DangerField(ARM, POINTS, WEIGHTS, aggregate="softmax", weighting="length", sharpness=4.0)
    again = pickle.loads(pickle.dumps(danger))
    assert np.array_equal(again.values(Q), danger.values(Q))
    assert repr(again) == repr(danger)


def test_points_and_weights_cannot_change():
    points, weights = POINTS.copy(), WEIGHTS.copy()
    danger = DangerField(ARM, points, weights)
    before = danger.value(Q[0])
    points += 1
    weights *= 2
    assert danger.value(Q[0]) == before
    np.testing.assert_array_equal(danger.points, POINTS)
    np.testing.assert_array_equal(danger.weights, WEIGHTS)
    with pytest.raises(ValueError, match="read-only"):
        danger.points[0] = 0
    assert DangerField(ARM, POINTS).weights is None


# ------------------------------------------------------------------------------------------- no danger points


@pytest.mark.parametrize("points", [[], np.empty((0, 3)), lambda q: np.empty((0, 3))])
@pytest.mark.parametrize("aggregate", AGGREGATES)
@pytest.mark.parametrize("weighting", WEIGHTINGS)
def test_without_danger_points_danger_is_zero(points, aggregate, weighting):
    danger = DangerField(ARM, points, aggregate=aggregate, weighting=weighting)
    values, gradients = danger.values_and_gradients(Q)
    np.testing.assert_array_equal(values, np.zeros(len(Q)))
    np.testing.assert_array_equal(gradients, np.zeros(Q.shape))
    assert danger.value(Q[0]) == danger.minimum == 0.0
    assert danger.active(Q, 0.5) is danger
    assert len(danger.terms_above(Q, 0.0)[0]) == 0
    with pytest.raises(InputError, match="no danger points"):
        danger.most_dangerous_point(Q[0])


# ------------------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"points": [[0, 0, np.nan]]}, "danger points must be finite"),
        ({"points": [[0, 0]]}, r"danger points must have shape \(any, 3\), got \(1, 2\)"),
        ({"points": [0.0, 0, 0]}, r"danger points must have shape \(any, 3\), got \(3,\)"),
        ({"points": "here"}, "danger points must be numbers"),
        ({"weights": [1.0]}, r"danger weights must have shape \(9\), got \(1,\)"),
        ({"weights": [-1.0] * 9}, r"danger weights must be positive, got \[-1.0"),
        ({"weights": [0.0] + [1.0] * 8}, r"danger weights must be positive, got \[0.0\]"),
        ({"weights": [np.nan] * 9}, "danger weights must be finite"),
        ({"aggregate": "sum"}, "unknown aggregate 'sum'; known: max, mean, softmax"),
        ({"weighting": "mass"}, "unknown weighting 'mass'; known: unit, length"),
        ({"k1": 0.0}, "k1 must be a positive number, got 0.0"),
        ({"k1": "one"}, "k1 must be a positive number, got 'one'"),
        ({"sharpness": -1.0}, "sharpness must be a positive number, got -1.0"),
        ({"sharpness": math.inf}, "sharpness must be a positive number, got inf"),
    ],
)
def test_refuses(options, message):
    with pytest.raises(InputError, match=message):
        DangerField(**{"robot": ARM, "points": POINTS} | options)


def test_refuses_a_robot_without_links(tmp_path):
    (tmp_path / "wheel.urdf").write_text(
        """<robot name="wheel"><link name="base"/><link name="rim"/><joint name="turn" type="continuous">
        <parent link="base"/><child link="rim"/><axis xyz="0 0 1"/></joint></robot>"""
    )
    with pytest.raises(InputError, match="'wheel' has no link of any length"):
        DangerField(Robot.from_urdf(tmp_path / "wheel.urdf", collision="optional"), [[1.0, 0.0, 0.0]])


def test_refuses_bad_configurations():
    danger = DangerField(ARM, POINTS)
    with pytest.raises(InputError, match=r"configuration must have shape \(3,?\), got \(2,\)"):
        danger.value([0.0, 0.0])
    with pytest.raises(InputError, match=r"configurations must have shape \(any, 3\), got \(3,\)"):
        danger.values(Q[0])
    for q in ([np.nan, 0, 0], [0, np.inf, 0]):
        with pytest.raises(InputError, match="configuration must be finite, got"):
            danger.gradient(q)
        with pytest.raises(InputError, match="configurations must be finite, got"):
            danger.gradients([q])


def test_refuses_bad_points_of_a_field():
    danger = DangerField(ARM, POINTS)
    for method in (danger.field, danger.workspace_gradient, danger.vector):
        with pytest.raises(InputError, match=r"points must have shape \(any, 3\)"):
            method(Q[0], [0.0, 0.0, 0.0])


def test_refuses_a_source_that_changes_its_number_of_points():
    with pytest.raises(InputError, match=r"the number of danger points must not change, got \[1, 9\]"):
        DangerField(ARM, lambda q: POINTS if q[0] == Q[0, 0] else POINTS[:1]).values(Q)
    with pytest.raises(InputError, match=r"the number of danger points must not change, got \[2, 9\]"):
        DangerField(ARM, lambda q: POINTS, [1.0, 2.0]).value(Q[0])


def test_the_push_is_the_sum_over_all_points_and_the_ends_of_all_links(ur5):
    """Σ_m Σ_l J_lᵀ w_m CDF(p_m) with the Jacobians themselves (paper, §4.3)."""
    weights, q = np.linspace(0.5, 2.0, len(POINTS)), np.array([0.3, -1.0, 1.2, 0.1, 0.4, -0.2])
    field = DangerField(ur5, POINTS, weights)
    vectors, jacobians = field.vector(q, POINTS), ur5.keypoint_jacobians(q)
    expected = sum(
        weight * jacobians[end].T @ vector
        for weight, vector in zip(weights, vectors, strict=True)
        for _, end in ur5.segments
    )
    np.testing.assert_allclose(field.push(q), expected, rtol=1e-10, atol=1e-9)
