"""Points of a robot's bodies and their Jacobians by Pinocchio, one at a time."""

import numpy as np
import pinocchio as pin


def body_points(robot, Q, rows, joints, points):
    """Return places (C, 3) and Jacobians (C, 3, n) of points given in the frames of joints, at `Q[rows]`."""
    model, places, jacobians = robot.shared.model, [], []
    data = model.createData()
    for row, joint, point in zip(rows, joints, points, strict=True):
        pin.computeJointJacobians(model, data, robot.pinocchio_configuration(Q[row]))
        turning = pin.getJointJacobian(model, data, int(joint), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        arm = data.oMi[int(joint)].rotation @ point
        places.append(data.oMi[int(joint)].translation + arm)
        jacobians.append(robot.coupling.columns(turning[:3] + np.cross(turning[3:], arm, axisa=0, axisc=0)))
    return np.array(places), np.array(jacobians)


def keypoint_jacobians(robot, q):
    """Return the Jacobians (K, 3, n) of the key points of a robot at `q`."""
    joints, offsets = robot.skeleton.joints, robot.skeleton.offsets
    return body_points(robot, np.array([q]), [0] * len(joints), joints, offsets)[1]
