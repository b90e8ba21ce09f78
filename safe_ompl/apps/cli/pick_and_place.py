"""`safe-ompl new --pick-and-place`: a program for an arm with a gripper, planned before it is written."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.collision import CollisionChecker
from safe_ompl.common import FloatArray, InputError, SafeOmplError, files
from safe_ompl.drawing import RobotBody
from safe_ompl.geometry import Pose
from safe_ompl.robot import Robot, RobotSpec, configurations_at, finger_joints, has_range
from safe_ompl.scene import Scenario, Scene
from safe_ompl.tasks import ProgramResult, plan_program

# A gripper may have at most this many joints that move on their own.
_MOST_GRIPPER_JOINTS = 4
# The length of the pad at the end of a finger.
_PAD = 0.02  # [m]
# The least and the largest edge of the cube [m], and its share of the gripper's opening.
_LEAST_CUBE, _LARGEST_CUBE, _OPENING_SHARE = 0.02, 0.05, 0.6  # [m]
# The fingers are closer together than the edge by this.
_SQUEEZE = 0.0006  # [m]
# Distances and heights of the table, in reaches from the shoulder.
_TABLE_DISTANCES, _TABLE_HEIGHTS = (0.55, 0.45, 0.65), (-0.35, -0.2, -0.5)
# Angles left of straight ahead where the cube is picked and placed [rad].
_PICK, _PLACES = -0.5, (0.35, 0.6)  # [rad]
_LINE_WIDTH = 120  # letters
# The height above grasps and places [m], and the planning time for each table [s].
_HEIGHT_ABOVE, _TIME_PER_TABLE = 0.1, 10.0  # [m]


class CubeGripper:
    """The gripper of an arm with a tip: the joints that close it on a cube, and the pose of the tip then.

    Raises InputError if the arm has no gripper with two fingers that close.
    """

    def __init__(self, spec: RobotSpec, tip: str) -> None:
        assert spec.urdf is not None
        self._where = str(spec.urdf)
        urdf = spec.urdf_file()
        full, mimics, known = urdf.build_model(), urdf.mimics(), finger_joints(urdf.build_model())
        hand = full.subtrees[next(frame for frame in full.frames if frame.name == tip).parentJoint]
        fingers = [full.names[joint] for joint in hand if full.names[joint] in known]
        self.joints = [name for name in fingers if name not in mimics and has_range(full, full.getJointId(name))]
        if not self.joints:
            raise InputError(f"the arm with the tip {tip!r} has no gripper: no finger moves behind it", self._where)
        if len(self.joints) > _MOST_GRIPPER_JOINTS:
            raise InputError(f"cannot decide which of {len(self.joints)} joints close the hand", self._where)
        self._robot = robot = Robot(replace(spec, free=tuple(self.joints)))
        self._body, model = RobotBody(robot, coarse=True), robot.shared.model
        moved = {model.getJointId(name) for name in fingers if model.existJointName(name)}
        # Of each body the first joint that moves it within the hand; 0 if none does
        bodies = robot.shared.collision_model.geometryObjects
        self._roots = [next((j for j in model.supports[body.parentJoint] if j in moved), 0) for body in bodies]
        pairs = zip(robot.shared.body_links, self._roots, strict=True)
        self.links = list(dict.fromkeys(link for link, root in pairs if root))
        self._set_fingers(model.parents[min(moved)])
        self._set_grasp()

    def _set_fingers(self, wrist: int) -> None:
        """Find the two longest fingers, the direction in which they point, and the direction in which they close."""
        data = self._robot.shared.model.createData()
        full = self._robot.pinocchio_configuration(self._posture({}))
        pin.forwardKinematics(self._robot.shared.model, data, full)
        base = (self._robot.tip_pose(self._posture({})).inverse() * data.oMi[wrist]).translation
        first = self._corners({})
        if len(first) < 2:
            raise InputError("the gripper needs two moving fingers with collision shapes", self._where)
        self._ahead = _axis(np.mean([corners.mean(axis=0) for corners in first.values()], axis=0) - base)
        self._pair = sorted(first, key=lambda root: -float((first[root] @ self._ahead).max()))[:2]
        apart = first[self._pair[1]].mean(axis=0) - first[self._pair[0]].mean(axis=0)
        self._across = _axis(apart - self._ahead * (apart @ self._ahead))

    def _set_grasp(self) -> None:
        """Choose the edge of a cube [m], the joint values that hold it, and the poses of the tip in its frame."""
        limits = zip(self._robot.joint_names, self._robot.lower.tolist(), self._robot.upper.tolist(), strict=True)
        ends = {name: (low, high) for name, low, high in limits if name in self.joints}
        ways = [dict(zip(ends, values, strict=True)) for values in product(*ends.values())]
        self.open, shut = (choose(ways, key=lambda way: self._gap(way)[0]) for choose in (max, min))
        self.edge = round(min(_LARGEST_CUBE, _OPENING_SHARE * self._gap(self.open)[0]), 3)
        # Shares of the way from open to closed.
        least, most = 0.0, 1.0
        for _ in range(30):
            share = 0.5 * (least + most)
            self.closed = {n: round(value + share * (shut[n] - value), 5) for n, value in self.open.items()}
            gap, end = self._gap(self.closed)
            least, most = (share, most) if gap > self.edge - _SQUEEZE else (least, share)
        if self.edge < _LEAST_CUBE or abs(gap - self.edge) > 2 * _SQUEEZE:
            raise InputError("its fingers do not close on a cube of 2 cm or more", self._where)
        point, down = end - 0.25 * self.edge * self._ahead, np.array([0.0, 0.0, -1.0])
        own = np.column_stack([self._ahead, self._across, np.cross(self._ahead, self._across)])
        self.grasps = []
        for way in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0)):
            turn = np.column_stack([down, way, np.cross(down, way)]) @ own.T
            self.grasps.append(pin.SE3(turn, -turn @ point))

    def _posture(self, values: Mapping[str, float]) -> FloatArray:
        """Return a configuration near zero with the given values of the finger joints."""
        robot = self._robot
        still = np.clip(np.zeros(robot.n), robot.lower, robot.upper).tolist()
        return robot.configuration({**dict(zip(robot.joint_names, still, strict=True)), **values})

    def _corners(self, values: Mapping[str, float]) -> dict[int, FloatArray]:
        """Return the corners of each finger (K, 3) in the frame of the tip [m]."""
        q = self._posture(values)
        to_tip, found = self._robot.tip_pose(q).inverse(), dict[int, list[FloatArray]]()
        for root, link, place in zip(self._roots, self._body.links, self._body.placements(q), strict=True):
            if root:
                there = to_tip * place
                found.setdefault(root, []).append(link.moved(there.rotation, there.translation).vertices)
        return {root: np.vstack(parts) for root, parts in found.items()}

    def _gap(self, values: Mapping[str, float]) -> tuple[float, FloatArray]:
        """Return the distance between the ends of both fingers [m], and the point in the middle."""
        corners, ahead, across = self._corners(values), self._ahead, self._across
        pads = [corners[k][corners[k] @ ahead > (corners[k] @ ahead).max() - _PAD] for k in self._pair]
        low, high = float((pads[0] @ across).max()), float((pads[1] @ across).min())
        both = np.vstack(pads)
        middle = 0.5 * (both.min(axis=0) + both.max(axis=0))
        end = middle + ((both @ ahead).max() - middle @ ahead) * ahead
        return high - low, end + (0.5 * (low + high) - middle @ across) * across


def _axis(direction: FloatArray) -> FloatArray:
    """Return the axis of the frame with the smallest angle to a direction."""
    k = int(np.abs(direction).argmax())
    return np.asarray(np.sign(direction[k]) * np.eye(3)[k])


def planned(
    spec: RobotSpec, gripper: CubeGripper, about: Mapping[str, Any], shoulder: FloatArray, reach: float, folder: Path
) -> tuple[dict[str, Any], ProgramResult]:
    """Return a scenario `about` a robot and a person with a program that was planned successfully.

    The person stands straight ahead of the `shoulder: (3,)`. Raises SafeOmplError if no program could be planned.
    """
    robot, (person,) = Robot(spec), about["scene"]["obstacles"]
    ahead = float(np.arctan2(*np.subtract(person["position"], shoulder)[1::-1]))
    why = ""
    for height, radius in product(_TABLE_HEIGHTS, _TABLE_DISTANCES):
        top = round(float(shoulder[2]) + height * reach, 2)

        def spot(angle: float, above: float, far: float = radius * reach, top: float = top) -> dict[str, Any]:
            x, y = shoulder[:2] + far * np.array([np.cos(ahead + angle), np.sin(ahead + angle)])
            return {"position": [round(float(v), 3) for v in (x, y, top + above)], "yaw": round(ahead + angle, 4)}

        table = {"name": "table", "box": {"size": [0.4, round(1.8 * radius * reach, 2), 0.04]}, **spot(0.0, -0.02)}
        cube = {"name": "cube", "box": {"size": [gripper.edge] * 3}, **spot(_PICK, 0.5 * gripper.edge)}
        obstacles = [{**table, "color": "#b99a6b"}, {**cube, "color": "#d9822b"}, person]
        scene = Scene.from_mapping({"obstacles": obstacles})
        start = _start(robot, scene, Pose.from_mapping(spot(0.0, 2 * _HEIGHT_ABOVE)).se3, gripper)
        if isinstance(start, str):
            why = why or start
            continue
        content = {**about, "start": start, "scene": {"obstacles": obstacles}}
        content["program"] = _program(gripper, [spot(angle, 0.5 * gripper.edge) for angle in _PLACES], start)
        result = plan_program(Scenario.from_mapping(content, folder), time=_TIME_PER_TABLE)
        if result:
            return content, result
        why = result.why
    raise SafeOmplError(f"{spec.urdf}: the arm cannot pick and place from above on any table that was tried; {why}")


def _start(robot: Robot, scene: Scene, above: pin.SE3, gripper: CubeGripper) -> dict[str, float] | str:
    """Return a free configuration with the gripper above a pose, or the reason why there is none."""
    checker, rng = CollisionChecker(robot, scene), np.random.default_rng(0)
    middle = 0.5 * (np.maximum(robot.lower, -np.pi) + np.minimum(robot.upper, np.pi))
    found = np.vstack([configurations_at(robot, above * grasp, middle, rng) for grasp in gripper.grasps])
    for q in np.round(found[np.abs(found - middle).max(axis=1).argsort()], 3):
        if robot.within_limits(q).all() and not checker.in_collision(q):
            return dict(zip(robot.joint_names, q.tolist(), strict=True))
    touching = [pair for q in found if (pair := checker.colliding_pair(q)) is not None]
    return f"{' touches '.join(touching[0])}: see `safe-ompl srdf`" if touching else "out of reach"


def _program(gripper: CubeGripper, places: list[dict[str, Any]], start: dict[str, float]) -> dict[str, Any]:
    touching = [[link, "cube"] for link in gripper.links]
    grasps = [
        {"position": _rounded(g.translation), "rpy": _rounded(pin.rpy.matrixToRpy(g.rotation))} for g in gripper.grasps
    ]
    steps: list[dict[str, Any]] = [
        {"move": {"grasp": "cube", "up": _HEIGHT_ABOVE}},
        {"line": {"grasp": "cube"}},
        {"gripper": {"joints": gripper.closed, "touching": touching}},
        {"attach": "cube"},
        {"line": {"up": _HEIGHT_ABOVE, "touching": [["cube", "table"]]}},
        {"move": {"place": "cube", "up": _HEIGHT_ABOVE}},
        {"line": {"place": "cube", "touching": [["cube", "table"]]}},
        {"detach": "cube"},
        {"gripper": {"joints": gripper.open, "touching": touching}},
        {"line": {"up": _HEIGHT_ABOVE}},
        {"move": {"configuration": list(start.values())}},
    ]
    return {"grasps": {"cube": grasps}, "places": {"cube": places}, "steps": steps}


def _rounded(values: FloatArray) -> Any:
    return (np.round(values, 5) + 0.0).tolist()  # no -0.0


def block(value: Any, indent: str = "") -> str:
    """Return plain data as YAML; entries that fit into a line are written on one line."""
    line = files.dump_line(value)
    if not isinstance(value, (dict, list)) or (indent and len(indent) + len(line) < _LINE_WIDTH):
        return f" {line}"
    if isinstance(value, list):
        return "".join(f"\n{indent}- {block(item, indent + '  ').lstrip()}" for item in value)
    lines = (f"\n{indent}{files.dump_line(key)}:{block(item, indent + '  ')}" for key, item in value.items())
    return "".join(lines).lstrip("\n" * (not indent))
