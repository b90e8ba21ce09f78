"""A robot in MuJoCo under position servos with friction, delay and an unknown payload (pip install mujoco).

`ServoRobot` builds the physics from a `safe_ompl.Robot`: the same links, inertias and collision shapes, obstacles that
stand, one motor per joint. The controller is that of a position interface: it pulls each joint like a spring with a
damper to the last set point that has arrived, and compensates the gravity of the robot that it knows. It knows neither
the friction nor the payload.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import coal

try:
    import mujoco
except ModuleNotFoundError:
    raise SystemExit("mujoco is missing: pip install mujoco") from None
import numpy as np
import pinocchio as pin

from safe_ompl import Robot, Scene

STEP = 0.001  # [s] of the controller
_PARTS = 5  # steps of the physics in each
_ROBOT, _THINGS = 1, 2  # groups of shapes that touch each other
_SIZES = {
    coal.Box: (mujoco.mjtGeom.mjGEOM_BOX, lambda shape: shape.halfSide),
    coal.Sphere: (mujoco.mjtGeom.mjGEOM_SPHERE, lambda shape: [shape.radius, 0, 0]),
    coal.Capsule: (mujoco.mjtGeom.mjGEOM_CAPSULE, lambda shape: [shape.radius, shape.halfLength, 0]),
    coal.Cylinder: (mujoco.mjtGeom.mjGEOM_CYLINDER, lambda shape: [shape.radius, shape.halfLength, 0]),
    coal.Ellipsoid: (mujoco.mjtGeom.mjGEOM_ELLIPSOID, lambda shape: shape.radii),
}


@dataclass(frozen=True)
class Servo:
    """How good the controller of a robot is.

    Attributes
    ----------
    bandwidth : float
        Natural frequency of each joint under its servo, critically damped where the arm is hardest to turn [rad/s].
    delay : float
        From a set point until it counts [s].
    friction : float
        Dry friction in each joint, as a share of its largest torque.
    armature : float
        Inertia of motor and gear, as the joint feels it [kg·m²].
    payload : float
        Mass at the tip that the controller does not know [kg].
    """

    bandwidth: float = 60.0
    delay: float = 0.004
    friction: float = 0.01
    armature: float = 0.1
    payload: float = 0.5


@dataclass(frozen=True)
class BodyPart:
    """A part of a body that gives way: a mass behind a pad on a spring; nothing holds them, and they do not turn.

    Attributes
    ----------
    place, direction : ndarray, shape (3,)
        The point of the pad's surface that is hit [m], and from there to its middle; a unit vector.
    mass : float
        Of the part of the body [kg].
    stiffness : float
        Between pad and body [N/m].
    """

    place: np.ndarray
    direction: np.ndarray
    mass: float
    stiffness: float


class ServoRobot:
    """A robot of ours in MuJoCo; it stands at first.

    Parameters
    ----------
    robot : Robot
        Its joints turn or slide.
    scene : Scene
        Obstacles that stand.
    start : ndarray, shape (n,)
        Where it stands [rad].
    servo : Servo
        Its controller.
    part : BodyPart, optional
        Somebody whom it may hit.
    """

    def __init__(
        self, robot: Robot, scene: Scene, start: np.ndarray, servo: Servo, part: BodyPart | None = None
    ) -> None:
        self.n, self.servo, self._part = robot.n, servo, part
        self._robot, self._scene = robot, scene
        self._known, self._memory = robot.shared.model, robot.shared.model.createData()
        rng = np.random.default_rng(0)
        places = (robot.pinocchio_configuration(rng.uniform(robot.lower, robot.upper)) for _ in range(100))
        turned = [np.diag(pin.crba(self._known, self._memory, full)).copy() for full in places]
        inertias = np.max(turned, axis=0) + servo.armature
        self._stiffness, self._damping = inertias * servo.bandwidth**2, 2 * inertias * servo.bandwidth
        self._spec = mujoco.MjSpec()
        self._spec.option.timestep = STEP / _PARTS
        self._spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        self._add_robot(robot)
        for obstacle in scene:
            for name, shape, place in obstacle.geometries():
                self._add_shape(self._spec.worldbody, name, shape, place, _THINGS)
        if part is not None:
            self._add_part(part)
        self.model = self._spec.compile()
        self.data = mujoco.MjData(self.model)
        self.data.qpos[: self.n] = start
        mujoco.mj_forward(self.model, self.data)
        self._sent: deque[tuple[np.ndarray, np.ndarray]] = deque([(np.array(start), np.zeros(self.n))])

    def step(self, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """Send a set point of positions and velocities (n,); return where the joints are a millisecond later (n,)."""
        self._sent.append((q, qd))
        if len(self._sent) > 1 + round(self.servo.delay / STEP):
            self._sent.popleft()
        wanted, rate = self._sent[0]
        gravity = pin.computeGeneralizedGravity(self._known, self._memory, self.q)
        self.data.ctrl[:] = wanted + (self._damping * rate + gravity) / self._stiffness
        mujoco.mj_step(self.model, self.data, _PARTS)
        return self.q

    def meeting(self, part: BodyPart, velocity: np.ndarray) -> ServoRobot:
        """Return a robot in the same state whose link touches a part of a body, which has a velocity (3,) [m/s]."""
        twin = ServoRobot(self._robot, self._scene, self.q, self.servo, part)
        twin.data.qvel[: self.n], twin._sent = self.rates, self._sent.copy()
        middle = slice(self.n, self.n + 3)
        twin.data.qvel[middle] = velocity
        while abs(gap := twin.distance_to_part()) > 1e-5:  # goes where the pad touches
            twin.data.qpos[middle] -= (gap if gap < 0 else 0.9 * gap) * part.direction
        return twin

    @property
    def q(self) -> np.ndarray:
        """Where its joints are: (n,) [rad]."""
        return self.data.qpos[: self.n].copy()

    @property
    def rates(self) -> np.ndarray:
        """How fast its joints are: (n,) [rad/s]."""
        return self.data.qvel[: self.n].copy()

    def distance(self, farthest: float = 0.3) -> float:
        """Return the smallest distance between moving links and obstacles by MuJoCo, but the farthest at most [m]."""
        mujoco.mj_kinematics(self.model, self.data)
        groups, bodies, sizes = self.model.geom_contype, self.model.geom_bodyid, self.model.geom_rbound
        links = np.flatnonzero((groups == _ROBOT) & (bodies != 0))
        for link in links:
            for thing in np.flatnonzero((groups == _THINGS) & (bodies == 0)):
                apart = np.linalg.norm(self.data.geom_xpos[link] - self.data.geom_xpos[thing])
                if apart - sizes[link] - sizes[thing] < farthest:
                    farthest = min(farthest, mujoco.mj_geomDistance(self.model, self.data, link, thing, farthest, None))
        return float(farthest)

    def distance_to_part(self) -> float:
        """Return the smallest distance between moving links and the part of a body [m]."""
        mujoco.mj_kinematics(self.model, self.data)
        pad = self.model.geom("pad").id
        links = np.flatnonzero((self.model.geom_contype == _ROBOT) & (self.model.geom_bodyid != 0))
        return min(mujoco.mj_geomDistance(self.model, self.data, link, pad, 10.0, None) for link in links)

    @property
    def force(self) -> float:
        """The force between pad and body [N]; infinite once MuJoCo has warned that the physics is unstable."""
        assert self._part is not None
        if any(warning.number for warning in self.data.warning):
            return np.inf
        return float(self._part.stiffness * np.linalg.norm(self.data.qpos[self.n + 3 :]))

    # ------------------------------------------------------------------------------------------------- the world

    def _add_robot(self, robot: Robot) -> None:
        known, bodies = self._known, [self._spec.worldbody]
        for k in range(1, known.njoints):
            name, own, most = known.names[k], known.inertias[k], float(known.effortLimit[k - 1])
            body = bodies[known.parents[k]].add_body(name=name, **_pose(known.jointPlacements[k]))
            _weigh(body, own.mass, own.lever, own.inertia)
            slide, turn = np.split(np.ravel(known.joints[k].createData().S), 2)  # of the motion in the joint's frame
            kind = mujoco.mjtJoint.mjJNT_SLIDE if slide.any() else mujoco.mjtJoint.mjJNT_HINGE
            friction = self.servo.friction * most
            body.add_joint(name=name, type=kind, axis=slide + turn, armature=self.servo.armature, frictionloss=friction)
            motor = self._spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            motor.set_to_position(kp=self._stiffness[k - 1], kv=self._damping[k - 1])
            motor.forcelimited, motor.forcerange = True, [-most, most]
            bodies.append(body)
        for shape in robot.shared.collision_model.geometryObjects:
            self._add_shape(bodies[shape.parentJoint], shape.name, shape.geometry, shape.placement, _ROBOT)
        if self.servo.payload:
            tip = known.frames[robot.tip_frame]
            load = bodies[tip.parentJoint].add_body(name="payload", **_pose(tip.placement))
            _weigh(load, self.servo.payload, np.zeros(3), 1e-4 * np.eye(3))

    def _add_shape(
        self, body: mujoco.MjsBody, name: str, shape: coal.CollisionGeometry, place: pin.SE3, group: int
    ) -> None:
        touching = {"contype": group, "conaffinity": _ROBOT + _THINGS - group}
        label = f"{'robot' if group == _ROBOT else 'scene'}: {name}"
        if type(shape) in _SIZES:
            kind, size = _SIZES[type(shape)]
            body.add_geom(name=label, type=kind, size=size(shape), **_pose(place), **touching)
            return
        points = np.array(shape.points() if hasattr(shape, "points") else shape.vertices())
        self._spec.add_mesh(name=label, uservert=points.ravel())
        body.add_geom(name=label, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=label, **_pose(place), **touching)

    def _add_part(self, part: BodyPart, pad: float = 0.05, radius: float = 0.04) -> None:
        slide = {"type": mujoco.mjtJoint.mjJNT_SLIDE}
        body = self._spec.worldbody.add_body(name="body", pos=part.place + radius * part.direction, gravcomp=1.0)
        _weigh(body, part.mass, np.zeros(3), 1e-3 * np.eye(3))
        surface = body.add_body(name="pad", gravcomp=1.0)
        _weigh(surface, pad, np.zeros(3), 1e-4 * np.eye(3))
        damping = 0.1 * np.sqrt(part.stiffness * pad)
        for axis in np.eye(3):
            body.add_joint(axis=axis, **slide)
            surface.add_joint(axis=axis, stiffness=part.stiffness, damping=damping, **slide)
        ball = {"type": mujoco.mjtGeom.mjGEOM_SPHERE, "size": [radius, 0, 0]}
        hard = {"priority": 1, "solref": [STEP, 1.0], "solimp": [0.95, 0.99, 1e-4, 0.5, 2.0]}
        touching = {"contype": _THINGS, "conaffinity": _ROBOT, "friction": [0, 0, 0]}
        surface.add_geom(name="pad", **ball, **hard, **touching)  # only the spring behind it gives way


def _pose(place: pin.SE3) -> dict[str, np.ndarray]:
    x, y, z, w = pin.Quaternion(place.rotation).coeffs()
    return {"pos": place.translation, "quat": np.array([w, x, y, z])}


def _weigh(body: mujoco.MjsBody, mass: float, centre: np.ndarray, inertia: np.ndarray) -> None:
    body.mass, body.ipos, body.explicitinertial = mass, centre, True
    body.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
