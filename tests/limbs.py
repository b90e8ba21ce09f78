"""Limbs of a person beside a robot, by plain queries of Pinocchio and coal."""

import numpy as np
import pinocchio as pin

from safe_ompl.collision import fresh_data


class Limbs:
    """Distances of every limb from the robot, by all pairs, nothing left out."""

    def __init__(self, robot, obstacle):
        self.robot = robot
        self.geometry = robot.collision_model.copy()
        self.geometry.removeAllCollisionPairs()
        moving = [k for k, body in enumerate(self.geometry.geometryObjects) if body.parentJoint]
        self.names = []
        for name, shape, placement in obstacle.geometries():
            added = self.geometry.addGeometryObject(pin.GeometryObject(name, 0, placement, shape))
            self.names.append(name.partition("/")[2])
            for body in moving:
                self.geometry.addCollisionPair(pin.CollisionPair(body, int(added)))
        self.data, self.memory = fresh_data(self.geometry), robot.model.createData()

    def at(self, q):
        """Return the distance of each limb (M,)."""
        full = self.robot.pinocchio_configuration(q)
        pin.computeDistances(self.robot.model, self.memory, self.geometry, self.data, full)
        found = np.array([result.min_distance for result in self.data.distanceResults])
        return found.reshape(len(self.names), -1).min(axis=1)

    def fastest(self, q, qd):
        """Return the speed of the fastest corner of the boxes about the moving bodies [m/s]."""
        full, rates = self.robot.pinocchio_configuration(q), self.robot.coupling.motions(qd)
        pin.forwardKinematics(self.robot.model, self.memory, full, rates)
        fastest = 0.0
        for body in self.robot.collision_model.geometryObjects:
            body.geometry.computeLocalAABB()
            box, motion = body.geometry.aabb_local, self.memory.v[body.parentJoint]
            ends = np.array([np.array(box.min_).ravel(), np.array(box.max_).ravel()])
            corners = np.array(np.meshgrid(*ends.T)).reshape(3, -1).T
            points = corners @ body.placement.rotation.T + body.placement.translation
            speeds = np.linalg.norm(np.cross(motion.angular, points) + motion.linear, axis=1)
            fastest = max(fastest, speeds.max())
        return fastest
