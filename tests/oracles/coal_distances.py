"""Distances of two shapes by coal, with nothing known before."""

import coal
import numpy as np
import pinocchio as pin


def coal_distance(shape, place, other, elsewhere=(0.0, 0.0, 0.0)):
    """Return the signed distance [m] of two shapes at their places, poses of Pinocchio or points (3,)."""
    poses = (p if isinstance(p, pin.SE3) else pin.SE3(np.eye(3), np.asarray(p)) for p in (place, elsewhere))
    here, there = (coal.Transform3s(pose.rotation, pose.translation) for pose in poses)
    return coal.distance(shape, here, other, there, coal.DistanceRequest(), coal.DistanceResult())
