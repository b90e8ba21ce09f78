"""Pinocchio's models of a robot, handed out as copies."""

from __future__ import annotations

import copy
from functools import cached_property

import pinocchio as pin

from safe_ompl.robot.bodies.reach import JointChain
from safe_ompl.robot.construction.parts import RobotParts, independent
from safe_ompl.robot.displacement_bounds import DisplacementBounds
from safe_ompl.robot.handout import Handout


class PinocchioModels(DisplacementBounds):
    """A robot that shows Pinocchio's models of itself: as copies, so that what users do to them changes no robot.

    Parameters
    ----------
    parts : RobotParts
        Pinocchio's models of the robot.

    Attributes
    ----------
    name : str
        Name for reports.
    """

    def __init__(self, parts: RobotParts) -> None:
        super().__init__(parts)
        self.name: str = parts.name

    @property
    def model(self) -> pin.Model:
        """A copy of Pinocchio's model of the joints that move, mimic joints included."""
        model: pin.Model = self._handed_model.get()
        return model

    @property
    def collision_model(self) -> pin.GeometryModel:
        """A copy of the bodies of the links, with the pairs of them that are checked against each other."""
        bodies: pin.GeometryModel = self._handed_bodies.get()
        return bodies

    @cached_property
    def visual_model(self) -> pin.GeometryModel:
        """A copy of the visual geometry; of the collision bodies where the visual meshes are missing."""
        return self.shared.read_visual() or independent(self.shared.collision_model)

    @property
    def chain(self) -> JointChain:
        """A copy of the joints as displacement bounds need them."""
        return copy.deepcopy(self._chain)

    @cached_property
    def _handed_model(self) -> Handout:
        return Handout(self.shared.model, pin.Model.copy, f"{self.name}: model")

    @cached_property
    def _handed_bodies(self) -> Handout:
        return Handout(self.shared.collision_model, independent, f"{self.name}: collision_model")
