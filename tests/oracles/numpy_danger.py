"""The danger of configurations from Pinocchio's kinematics and NumPy's field: an oracle for the compiled loop."""

import numpy as np
import pinocchio as pin
from oracles import numpy_field


def keypoints(robot, Q):
    """Return the key points (B, K, 3): the frames at the ends of links, placed by Pinocchio."""
    tree, model = robot.kinematics.keypoints, robot.shared.model
    data, places = model.createData(), []
    for q in Q:
        pin.forwardKinematics(model, data, robot.pinocchio_configuration(q))
        places.append([data.oMi[int(key["joint"])].act(key["offset"]) for key in tree])
    return np.reshape(places, (len(Q), len(tree), 3))


def danger_and_gradient(danger, Q):
    """Return the danger (B,) of a `DangerField` and its gradients (B, n) at `Q: (B, n)`."""
    robot, pairs, points = danger.robot, danger.robot.segments, danger.points_at(Q)
    places = keypoints(robot, Q)
    charges = danger.k1 * (np.ones(points.shape[-2]) if danger.weights is None else danger.weights)
    levels = charges * numpy_field.potentials(places, pairs, points, danger.weighting).sum(axis=1)
    values, shares = _aggregate(levels, danger.aggregate, danger.sharpness)
    forces = numpy_field.keypoint_gradient(places, pairs, points, shares * charges, danger.weighting)
    jacobians = np.array([robot.keypoint_jacobians(q) for q in Q])
    return values, np.einsum("bkc,bkci->bi", forces, jacobians)


def _aggregate(levels, aggregate, sharpness):
    """Return the danger (B,) and its derivatives by the levels (B, M)."""
    if aggregate == "mean":
        return levels.mean(axis=1), np.full(levels.shape, 1 / levels.shape[1])
    peaks = levels.max(axis=1, keepdims=True)
    if aggregate == "max":
        return peaks[:, 0], np.eye(levels.shape[1])[levels.argmax(axis=1)]
    with np.errstate(invalid="ignore"):
        rises = np.exp(sharpness * np.where(levels == peaks, 0.0, levels - peaks))
    total = rises.sum(axis=1, keepdims=True)
    return (peaks + np.log(total) / sharpness)[:, 0], rises / total
