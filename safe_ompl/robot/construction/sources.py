"""Blueprints of robots from a URDF, or from models of Pinocchio's."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.arrays import FloatArray
from safe_ompl.errors import InputError, UnknownNameError
from safe_ompl.notices import warn_once
from safe_ompl.robot.bodies.self_collision import sample_configurations, select_self_pairs
from safe_ompl.robot.construction.blueprint import Blueprint, RangeByJoint
from safe_ompl.robot.construction.chosen_joints import group_tip, joints_and_posture
from safe_ompl.robot.construction.parts import RobotParts, independent
from safe_ompl.robot.description.collision_shapes import (
    build_collision_geometry,
    links_with_visuals_alone,
    make_convex,
    warn_of_unchecked,
)
from safe_ompl.robot.description.srdf import SrdfFile
from safe_ompl.robot.description.urdf import UrdfFile
from safe_ompl.robot.joints.arm import default_tip
from safe_ompl.robot.joints.coupling import Mimic, resolved
from safe_ompl.robot.joints.reduction import (
    apply_mimic_limits,
    check_plannable,
    joint_limits,
    joints_without_range,
    override_limits,
    reduce_model,
    with_mimics,
)

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class UrdfBlueprint(Blueprint):
    """A robot from its URDF; see `Robot.from_urdf`."""

    urdf: str
    srdf: str | None
    package_dirs: tuple[str, ...]
    tip: str | None
    locked: Mapping[str, float]
    hulls: bool
    name: str | None
    limits: RangeByJoint
    collision: str = "required"
    group: str | None = None
    locked_state: str | None = None

    def assemble(self) -> RobotParts:
        """Read the files, lock joints, and build what remains."""
        file = UrdfFile(self.urdf, self.package_dirs)
        full = file.build_model()
        collision_model = build_collision_geometry(file, full, self.collision)
        mimics = {name: mimic for name, mimic in file.mimics().items() if full.existJointName(name)}

        def read_visual() -> pin.GeometryModel | None:
            try:
                geometry = file.build_geometry(full, pin.GeometryType.VISUAL)
            except InputError as error:
                warn_once(_log, f"{file.path.name}: drawing its collision bodies ({error})")
                return None
            return geometry if len(geometry.geometryObjects) else None

        source = _Source(full, collision_model, read_visual, mimics, str(file.path))
        name = self.name or full.name or file.path.stem
        parts = source.reduced(
            name,
            self.tip,
            self.locked,
            self.limits,
            self.hulls,
            srdf=self.srdf,
            group=self.group,
            locked_state=self.locked_state,
        )
        bare = links_with_visuals_alone(file, parts.model, parts.collision_model, self.collision)
        parts = replace(parts, bare_links=bare)
        warn_of_unchecked(name, parts.links_without_collision)
        return parts

    def with_limits(self, limits: RangeByJoint) -> UrdfBlueprint:
        return replace(self, limits={**self.limits, **limits})

    def state(self, name: str) -> dict[str, float]:
        return super().state(name) if self.srdf is None else SrdfFile(self.srdf).state(name)


@dataclass(frozen=True)
class ModelsBlueprint(Blueprint):
    """A robot from models of Pinocchio's, which nobody else may change; see `Robot.from_models`."""

    model: pin.Model
    collision_model: pin.GeometryModel
    visual_model: pin.GeometryModel | None
    tip: str | None
    locked: Mapping[str, float]
    hulls: bool
    name: str
    limits: RangeByJoint
    mimics: Mapping[str, Mimic]

    def assemble(self) -> RobotParts:
        """Lock joints, and build what remains; pairs that the collision model has are those that are checked."""
        source = _Source(
            self.model.copy(),
            independent(self.collision_model),
            lambda: self.visual_model,
            self.mimics,
            self.name,
        )
        return source.reduced(self.name, self.tip, self.locked, self.limits, self.hulls)

    def with_limits(self, limits: RangeByJoint) -> ModelsBlueprint:
        return replace(self, limits={**self.limits, **limits})


@dataclass(frozen=True)
class _Source:
    """All joints of a robot and its geometry, before joints are locked."""

    full: pin.Model
    collision_model: pin.GeometryModel
    read_visual: Callable[[], pin.GeometryModel | None]
    mimics: Mapping[str, Mimic]
    source: str

    def reduced(
        self,
        name: str,
        tip: str | None,
        locked: Mapping[str, float],
        limits: RangeByJoint,
        hulls: bool,
        *,
        srdf: str | None = None,
        group: str | None = None,
        locked_state: str | None = None,
    ) -> RobotParts:
        """Return the parts of the robot with its joints locked, bodies convex and self pairs chosen."""
        full, source, mimics = self.full, self.source, resolved(self.mimics, self.source)
        override_limits(full, limits, source)
        if tip is not None and not full.existFrame(tip):
            raise UnknownNameError("tip frame", tip, (frame.name for frame in list(full.frames)[1:]), source)
        held = joints_and_posture(
            full, mimics, locked, tip=tip, group=group, locked_state=locked_state, srdf=srdf, source=source
        )
        stiff = joints_without_range(full, set(list(full.names)[1:]) - set(mimics) - set(limits) - set(held))
        if stiff:
            values = ", ".join(f"{joint} = {value:g}" for joint, value in sorted(stiff.items()))
            warn_once(_log, f"{name}: held, as their limits leave no range (limits= gives others): {values}")
        held = with_mimics(full, mimics, {**held, **stiff}, source)
        model, collision_model = reduce_model(full, self.collision_model, held)
        check_plannable(model, source, stiff)
        if hulls:
            make_convex(collision_model)
        mimics = {joint: mimic for joint, mimic in mimics.items() if model.existJointName(joint)}
        apply_mimic_limits(model, mimics, source)
        joint_limits(model, source)
        _drop_fixed_pairs(collision_model)
        if not len(collision_model.collisionPairs):
            select_self_pairs(model, collision_model, srdf, _samples(model, mimics), name)

        def visual() -> pin.GeometryModel | None:
            drawn = self.read_visual()
            return None if drawn is None else reduce_model(full, drawn, held)[1]

        ends = tuple(full.names)[1:]
        tips = (tip or group_tip(full, srdf, group, source) or default_tip(full, model),)
        return RobotParts(name, source, model, collision_model, visual, ends, tips, mimics, held)


def _drop_fixed_pairs(geometry: pin.GeometryModel) -> None:
    """Drop the pairs of bodies that do not move against each other any more, as joints between them are locked."""
    joints = [part.parentJoint for part in geometry.geometryObjects]
    pairs = [pin.CollisionPair(pair.first, pair.second) for pair in geometry.collisionPairs]
    for pair in pairs:
        if joints[pair.first] == joints[pair.second]:
            geometry.removeCollisionPair(pair)


def _samples(model: pin.Model, mimics: Mapping[str, Mimic]) -> FloatArray:
    """Return configurations (S, nq) over the joint ranges at which mimic joints are where they belong."""
    rows = sample_configurations(model)
    for name, mimic in mimics.items():
        joint, first = (model.joints[model.getJointId(n)] for n in (name, mimic.primary))
        values = mimic.multiplier * rows[:, first.idx_q] + mimic.offset
        if joint.nq == 1:
            rows[:, joint.idx_q] = values
        else:
            rows[:, joint.idx_q], rows[:, joint.idx_q + 1] = np.cos(values), np.sin(values)
    return rows


def check_models(model: Any, *geometries: Any) -> None:
    """Raise InputError for anything but models of Pinocchio's."""
    if not isinstance(model, pin.Model):
        raise InputError(f"model must be a pin.Model, not {type(model).__name__}")
    for geometry in geometries:
        if geometry is not None and not isinstance(geometry, pin.GeometryModel):
            raise InputError(f"geometry must be a pin.GeometryModel, not {type(geometry).__name__}")
