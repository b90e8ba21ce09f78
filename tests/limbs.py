"""Limbs of a person beside a robot, by plain queries of Pinocchio and coal."""

import numpy as np
import pinocchio as pin

from bench._plain import fresh_data


class Limbs:
    """Distances of every limb from the robot, or from what moves of it, by all pairs, nothing left out."""

    def __init__(self, robot, obstacle, still=False):
        self.robot = robot
        self.geometry = robot.collision_model.copy()
        self.geometry.removeAllCollisionPairs()
        bodies = [k for k, body in enumerate(self.geometry.geometryObjects) if still or body.parentJoint]
        self.names = []
        for name, shape, placement in obstacle.geometries():
            added = self.geometry.addGeometryObject(pin.GeometryObject(name, 0, placement, shape))
            self.names.append(name.partition("/")[2])
            for body in bodies:
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


def least_left(stop_from, begins, limbs, people):
    """Return the least that is left [m] when people run at the robot while it stops, over stops from these instants.

    `stop_from(begin)` returns how long a stop takes, and a function of the time since to q and q̇. Limbs are as fast as
    `people` says. Where contact is allowed only limbs that would be harmed count.
    """
    regions = [people.region_of(name) for name in limbs.names]
    bears = np.array([region.force / np.sqrt(1e3 * region.mass * region.stiffness) for region in regions])
    least = np.inf
    for begin in begins:
        lasts, at = stop_from(begin)
        for t in np.linspace(0, 1 - 1e-6, 6) * lasts:
            q, qd = at(t)
            if np.abs(qd).max() <= 1e-9:
                continue
            gone = [people.speed_of(name) * (people.reaction_time + t) for name in limbs.names]
            left = limbs.at(q) - gone - people.clearance
            if people.contact:
                left = left[(left > 0) | (limbs.fastest(q, qd) > bears)]
            least = min(least, left.min(initial=np.inf))
    return least


def left_beside(trajectory, limbs, people, number):
    """Return the same of stops of a trajectory from so many random instants."""

    def stop_from(begin):
        stop = trajectory.stop_from(begin)
        return stop.duration, lambda t: stop.at(t)[:2]

    return least_left(stop_from, np.random.default_rng(0).uniform(0, trajectory.duration, number), limbs, people)
