"""Robot and obstacles as Pinocchio's models, for the systems that plan on them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

try:
    import coal
except ImportError:  # Pinocchio before version 3
    import hppfcl as coal


class World:
    """A robot, and its bodies among the obstacles of one problem after the other."""

    def __init__(self, robot: dict[str, Any]) -> None:
        self.model = pin.buildModelFromUrdf(robot["urdf"])
        self._bodies = pin.buildGeomFromUrdf(self.model, robot["urdf"], pin.GeometryType.COLLISION)
        for body in self._bodies.geometryObjects:
            if isinstance(body.geometry, coal.BVHModelBase):
                body.geometry.buildConvexRepresentation(False)
                body.geometry = body.geometry.convex
        self._bodies.addAllCollisionPairs()
        pin.removeCollisionPairs(self.model, self._bodies, robot["srdf"])
        self.geometry = self._bodies

    def build(self, problem: dict[str, Any]) -> None:
        """Put the obstacles of a problem around the robot; the fixed base may stand on them."""
        self.geometry = self._bodies.copy()
        moving = [k for k, body in enumerate(self._bodies.geometryObjects) if body.parentJoint]
        for item in problem["obstacles"]:
            placement = pin.SE3(np.array(item["rotation"]), np.array(item["position"]))
            shape = {"box": coal.Box, "cylinder": coal.Cylinder, "sphere": coal.Sphere}[item["kind"]](*item["size"])
            added = self.geometry.addGeometryObject(pin.GeometryObject(item["name"], 0, placement, shape))
            for body in moving:
                self.geometry.addCollisionPair(pin.CollisionPair(body, added))
