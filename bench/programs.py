"""Programs of steps: how quickly they are planned and proven, and what a robot with a servo's errors does in MuJoCo.

Each program that is shipped is planned from several seeds. Then MuJoCo drives it (extra `mujoco`): position servos with
friction and delay follow the motion, objects are free bodies which a weld holds from `attach` to `detach`, and the
controller does not know their mass. The errors of the joints make a tube. The program is planned again within it, and
steps that touch may reach deeper by as much as the tube moves the tip; then it is driven again. A contact is one that a
step does not allow: of a link or of what is held with anything but what may touch, of links with each other.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin

from bench._harness import Report
from examples.mujoco.servo_robot import STEP, Servo, ServoRobot, _pose, _weigh
from safe_ompl import Obstacle, ProgramResult, Robot, Scene, plan_program
from safe_ompl.common import FloatArray
from safe_ompl.motions import FACTOR, Motion
from safe_ompl.robot import Attachment
from safe_ompl.scene import Attach, Detach, Scenario, list_scenarios

CLAIM = "programs of 8 to 15 steps are planned in 2 s in the median, and only what may touch does in physics"
HEADER = ("program", "steps", "solved", "median [s]", "worst [s]", "duration [s]", "stretches")
PHYSICS = ("program", "tube [mrad]", "depth [mm]", "again [s]", "duration [s]", "outside", "contacts", "deepest")
MASS = 0.2  # [kg] of an object
SERVO = Servo(bandwidth=120.0, delay=0.001, payload=0.0)
LOOKED = 5  # steps between two looks for contacts
LATE = 0.05  # [s] a servo is behind: contacts of the step before are allowed as long
BEYOND = 0.15  # [m] that what is held reaches beyond the tip
SQUEEZE = 0.002  # [m] that a program without errors presses
WIDER = 3  # tubes that are tried, until one holds the errors
SETTLING = 0.2  # [s] after the last step
_ROBOT, _THING = 1, 2  # groups of shapes that touch each other, as in ServoRobot


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--programs", nargs="+", metavar="NAME", default=list(list_scenarios(programs=True)))
    parser.add_argument("--seeds", type=int, default=5)


def main(options: argparse.Namespace, report: Report) -> int:
    """Plan all, and drive all."""
    given = {name: Scenario.load(list_scenarios(programs=True)[name]) for name in options.programs}
    rows, medians = [], []
    for name, scenario in given.items():
        plan_program(scenario)
        found = [plan_program(scenario, seed=seed) for seed in range(options.seeds)]
        times = [result.planning_time for result in found]
        medians.append(np.median(times))
        said = sum(map(bool, found)), medians[-1], max(times), found[0].duration, len(found[0].stretches)
        rows.append((name, len(scenario.program.steps), *said))
    report.table(HEADER, rows)
    report.figure("median of the medians [s]", np.median(medians))
    unsolved = any(row[2] < options.seeds for row in rows)
    rows = [physics(scenario) for scenario in given.values()]
    report.table(PHYSICS, rows)
    contacts = [row[-2] for row in rows if row[-2] != ""]
    wrong, unplanned = sum(count != 0 for count in contacts), len(rows) - len(contacts)
    report.counted("programs driven in MuJoCo: contacts that no step allows", len(rows), wrong, unplanned)
    return int(unsolved or wrong > 0)


def physics(scenario: Scenario) -> tuple[object, ...]:
    """Return the row of a program: driven, planned within the tube that its errors make, and driven again."""
    program, driven = scenario.program, Replay(plan_program(scenario)).run()
    assert program is not None
    robot, tube = driven.robot, np.zeros(driven.robot.n)
    radii = robot.bounds.tip_radii
    grippers = [robot.joint_names.index(name) for name in program.gripper_joints]
    for _ in range(WIDER):
        tube = np.maximum(tube, FACTOR * driven.errors)
        moved = (radii + BEYOND) * (robot.coupling.matrix @ tube)
        depth = SQUEEZE + float(moved[radii > 0].sum()) + float(tube[grippers].max(initial=0.0))
        steps = [replace(step, depth=depth) if getattr(step, "touching", ()) else step for step in program.steps]
        limits = replace(scenario.limits, tube=tuple(tube.tolist()))
        within = plan_program(replace(scenario, program=replace(program, steps=tuple(steps)), limits=limits))
        row = scenario.name, f"{1e3 * tube.min():.1f}–{1e3 * tube.max():.1f}", 1e3 * depth, within.planning_time
        if not within:
            return (*row, within.why, "", "", "")
        driven = Replay(within).run()
        outside = int((driven.errors > tube).sum())
        if not outside:
            break
    for contact in sorted(driven.contacts):
        print("   ", scenario.name, *contact)
    return (*row, within.duration, outside, len(driven.contacts), 1e3 * driven.deepest)


class _Plain:
    """A robot whose joints are those of Pinocchio's model, those that follow others included."""

    def __init__(self, robot: Robot) -> None:
        model = robot.shared.model
        self.shared, self.tip_frame, self.n = robot.shared, robot.tip_frame, model.nv
        self.lower, self.upper = model.lowerPositionLimit, model.upperPositionLimit

    def pinocchio_configuration(self, q: FloatArray) -> FloatArray:
        return q


class World(ServoRobot):
    """A robot, obstacles that stand, and objects that are free, or held by a weld."""

    def __init__(self, robot: Robot, scene: Scene, objects: list[Obstacle], start: FloatArray) -> None:
        self._objects = objects
        super().__init__(_Plain(robot), scene, robot.pinocchio_configuration(start), SERVO)

    def _add_robot(self, robot: Robot) -> None:
        super()._add_robot(robot)
        for item in self._objects:
            body = self._spec.worldbody.add_body(name=item.name, **_pose(item.pose.se3))
            body.add_freejoint()
            _weigh(body, MASS, np.zeros(3), MASS * 1e-3 * np.eye(3))
            for part in item.shape.parts():
                self._add_shape(body, item.name, part.geometry, part.placement, _THING)
                body.geoms[-1].contype = body.geoms[-1].conaffinity = _ROBOT + _THING
            for holder in list(self._known.names)[1:]:
                weld = self._spec.add_equality(name=f"{holder}: {item.name}", type=mujoco.mjtEq.mjEQ_WELD, active=False)
                weld.name1, weld.name2, weld.objtype = holder, item.name, mujoco.mjtObj.mjOBJ_BODY
                weld.solref, weld.solimp = [0.002, 1.0], [0.99, 0.999, 1e-4, 0.5, 2.0]

    def hold(self, name: str, holder: str) -> None:
        """Weld an object to the link of a joint where both are; from then on it touches as the robot does."""
        link, item = (self._place(body) for body in (holder, name))
        relative, weld = _pose(link.inverse() * item), self.model.equality(f"{holder}: {name}").id
        self.model.eq_data[weld, :10] = [0.0, 0.0, 0.0, *relative["pos"], *relative["quat"]]
        self.data.eq_active[weld] = True
        self._grouped(name, _ROBOT, _THING)

    def _place(self, body: str) -> pin.SE3:
        w, x, y, z = self.data.body(body).xquat
        return pin.SE3(pin.Quaternion(w, x, y, z), self.data.body(body).xpos)

    def release(self, name: str) -> None:
        """Let an object be free."""
        for weld in range(self.model.neq):
            if self.model.equality(weld).name.endswith(f": {name}"):
                self.data.eq_active[weld] = False
        self._grouped(name, _ROBOT + _THING, _ROBOT + _THING)

    def _grouped(self, name: str, kind: int, touching: int) -> None:
        own = self.model.geom_bodyid == self.model.body(name).id
        self.model.geom_contype[own], self.model.geom_conaffinity[own] = kind, touching


class Replay:
    """A program that is driven: errors (n,) of joints, who touched whom on which step, and how deep, if they may."""

    def __init__(self, result: ProgramResult) -> None:
        scene, self._result, self.robot = result.scenario.scene, result, result.stretches[0].robot
        assert result.scenario.program is not None
        self._steps = result.scenario.program.steps
        moved = {step.object for step in self._steps if isinstance(step, (Attach, Detach))}
        objects = [item for item in scene if item.name in moved]
        self._world = World(self.robot, scene.without(*moved), objects, result.stretches[0].motion.knots[0])
        self.errors, self.contacts, self.deepest = np.zeros(self.robot.n), set[tuple[int, str, str]](), 0.0
        self._held: dict[str, Attachment] = {}
        model, shared = self._world.model, self.robot.shared
        bodies = [model.geom(f"robot: {body.name}").id for body in shared.collision_model.geometryObjects]
        links = dict(zip(bodies, shared.body_links, strict=True))
        self._names = [links.get(k) or self._thing(k) for k in range(model.ngeom)]
        self._pairs, self._bodies = [(bodies[a], bodies[b]) for a, b in shared.body_pairs], bodies
        self._rows = [list(shared.model.names)[1:].index(name) for name in self.robot.joint_names]

    def _thing(self, geom: int) -> str:
        body = self._world.model.body(self._world.model.geom_bodyid[geom]).name
        return self._world.model.geom(geom).name.removeprefix("scene: ") if body == "world" else body

    def run(self) -> Replay:
        """Drive all of it."""
        before: set[frozenset[str]] = set()
        for stretch in self._result.stretches:
            held = (item for item in stretch.robot.spec.attached if item not in self.robot.spec.attached)
            self._take({item.name: item for item in held})
            allowed = {frozenset(pair) for pair in getattr(self._steps[stretch.step], "touching", ())}
            self._drive(stretch.motion, stretch.step, allowed, before)
            before = allowed
        let_go = {frozenset((link, name)) for name in self._held for link in self.robot.shared.body_links}
        self._take({})
        end = self._result.stretches[-1].motion.knots[-1]
        still = Motion(np.array([0.0, SETTLING]), np.array([[end, 0 * end]]), self.robot.joint_names)
        self._drive(still, len(self._steps) - 1, before | let_go, before)
        return self

    def _take(self, held: dict[str, Attachment]) -> None:
        for name in self._held.keys() - held.keys():
            self._world.release(name)
        for name, item in held.items():
            if self._held.get(name) != item:
                self._world.release(name)
                self._world.hold(name, self._holder(item))
        self._held = held
        objects = {name: [geom for geom, own in enumerate(self._names) if own == name] for name in held}
        self._holding = [
            (link, geom)
            for name, item in held.items()
            for link in self._bodies
            if self._names[link] not in item.touch_links and not self._carries(link, item)
            for geom in objects[name]
        ]

    def _carries(self, link: int, item: Attachment) -> bool:
        """Return whether a shape is of the link that holds an object, or fixed to it."""
        return self._world.model.body(self._world.model.geom_bodyid[link]).name == self._holder(item)

    def _holder(self, item: Attachment) -> str:
        model = self.robot.shared.model
        return str(model.names[model.frames[model.getFrameId(item.link)].parentJoint])

    def _drive(self, motion: Motion, step: int, allowed: set[frozenset[str]], before: set[frozenset[str]]) -> None:
        times = np.arange(0.0, motion.duration, STEP)
        wanted, rates = motion.at(times), np.gradient(motion.at(times), STEP, axis=0)
        full, matrix = self.robot.model_values(wanted), self.robot.coupling.matrix
        for k, (q, qd) in enumerate(zip(full, rates @ matrix.T, strict=True)):
            found = self._world.step(q, qd)
            self.errors = np.maximum(self.errors, np.abs(found[self._rows] - wanted[k]))
            if k % LOOKED == 0:
                self._look(step, allowed | before if times[k] < LATE else allowed)

    def _look(self, step: int, allowed: set[frozenset[str]]) -> None:
        """Note who touches whom: by MuJoCo's contacts, and links each other by its distances."""
        model, data = self._world.model, self._world.data
        touching = [(*contact.geom, contact.dist) for contact in data.contact[: data.ncon]]
        for a, b in (*self._pairs, *self._holding):
            apart = np.linalg.norm(data.geom_xpos[a] - data.geom_xpos[b])
            if apart < model.geom_rbound[a] + model.geom_rbound[b]:
                touching.append((a, b, mujoco.mj_geomDistance(model, data, a, b, 0.01, None)))
        for *geoms, distance in touching:
            names = [self._names[geom] for geom in geoms]
            driven = [model.geom_contype[geom] == _ROBOT for geom in geoms]
            standing = [model.body_weldid[model.geom_bodyid[geom]] == 0 for geom in geoms]
            if distance >= 0 or not any(driven) or all(standing):
                continue
            if frozenset(names) in allowed:
                self.deepest = max(self.deepest, -float(distance))
            else:
                self.contacts.add((step + 1, *sorted(names)))
