"""What proofs are worth in physics: MuJoCo drives what was proven (extra `mujoco`), some minutes.

A Panda and a UR5 in MuJoCo, under position servos with friction, delay and a payload that the controller does not know
(`examples/mujoco/servo_robot.py`), follow what was proven.

motions    Planned and timed motions among obstacles. Errors of the joints in the first ones make a tube, as
           `safe-ompl tube` does; the others are planned and proven with it. `proven` is the margin from every obstacle
           that is proven of the whole tube, `physics` the smallest distance that MuJoCo measures along the motion. A
           motion is `below` if physics is nearer than was proven; `below without a tube` takes the margin that is
           proven of the motion itself, and `missing` is by how much it was missed at worst.
drives     The replanner beside a person who walks about and reaches out, and who keeps to the promised speeds. People
           are kept away by what the tube moves the robot, too. Contacts are looked for at the joints of the physics.
live       The same where contact is allowed, without a tube. Wherever the robot touches a limb while it moves, faster
           than before in this contact, a copy of it in the same state, which drives on as the robot does, hits a part
           of a body as in `contact`, along the normal of the contact. `force` is the largest one of the first impact as
           a share of what the region bears, of a part that rests: people's own speed is not counted in what is
           promised. `with the limb's speed` is the same of a part as fast as the limb is. `speed` is the robot's own at
           the touching point, and `gap` that of the gap that closes, as shares of what is borne; limbs that are held
           against something are not simulated.
contact    A link at the speed that a region of the body bears (`people.contact`) hits a part of a body of that mass
           and stiffness which is free to give way. `first` is the largest force of the first impact, `later` that of
           the time after it while the robot drives on, both as a share of what the region bears.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from itertools import islice

import numpy as np

from bench._harness import Report
from bench._scenes import scattered
from bench._touches import TouchJudge
from examples.mujoco.servo_robot import STEP, BodyPart, Servo, ServoRobot
from safe_ompl import Box, Obstacle, People, Pose, RateLimits, Robot, SafeSetup, Scene, Trajectory
from safe_ompl.collision import CollisionChecker, MotionProver, Separation
from safe_ompl.common import FloatArray
from safe_ompl.live import Surroundings, Tracker
from safe_ompl.live.replanning import Action, Replanner
from safe_ompl.live.simulation import ALL_KEYPOINTS, Walker, World
from safe_ompl.live.simulation.simulation import Touch
from safe_ompl.motions import FACTOR, BodySpeeds, Motion, contact_speed, first_unproven
from safe_ompl.scene.constraints import CONTACT_TABLE

CLAIM = "a robot with a servo's errors stays outside what is proven with a tube, and meets nobody while it moves"
# Accelerations [rad/s²]; of the Panda half of what Franka publishes, with which the motors are too weak here at times.
ROBOTS = {"panda": [7.5, 3.75, 5, 6.25, 7.5, 10, 10], "ur5": [4.0] * 6}
MOTIONS = ("robot", "motions", "errors [mrad]", "tube [mrad]", "outside it", "proven [mm]", "physics [mm]")
MOTIONS += ("below", "below without a tube", "missing [mm]")
DRIVES = "robot", "drives", "tasks", "moving", "nearest moving [mm]", "contacts moving", "contacts at rest"
LIVE = *DRIVES, "speed, at most", "gap, at most"
HITS = "robot", "region", "hits", "speed, at most", "force, median", "force, at most", "with the limb's speed"
CONTACT = "robot", "region", "speed [m/s]", "bears [N]", "first / bears", "later / bears"
REGIONS = {part: name for name, part in CONTACT_TABLE.items()}
FIRST = 10  # motions whose errors make the tube
LOOKED = 5  # steps of physics between two measured distances
SETTLING = 0.3  # [s] that is driven on at the end of a motion
STRETCHED = {"panda": [0, 0.3, 0, -1.8, 0, 2.1, 0.785], "ur5": [0, -1.0, 1.6, -2.2, -1.57, 0]}
DRAWN_IN = {"panda": [0, 0, 0, -2.0, 0, 2.2, 0.785], "ur5": [0, -1.2, 1.6, -2.0, -1.57, 0]}
DRIFTING = 0.01  # [rad/s] slower than this a robot that is told to stand counts as standing
BEFORE = 0.3  # [rad] from where a robot starts until it hits somebody
LONGER = 0.3  # [rad] that it goes on then
ANSWER = 0.02  # [s] from a measurement to the command that answers it


def driven(body: ServoRobot, trajectory: Trajectory) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield set points and where the joints are then (n,), a step of the physics apart."""
    times = np.arange(0.0, trajectory.duration + SETTLING, STEP)
    states = trajectory.at(np.minimum(times, trajectory.duration))
    for q, qd in zip(states.q, states.qd, strict=True):
        yield q, body.step(q, qd)


def errors(robot: Robot, trajectory: Trajectory, scene: Scene, servo: Servo) -> tuple[FloatArray, float]:
    """Return the largest errors of the joints (n,) and the smallest distance from obstacles in physics [m]."""
    body = ServoRobot(robot, scene, trajectory.at(0.0).q, servo)
    largest, least = np.zeros(robot.n), np.inf
    for k, (wanted, found) in enumerate(driven(body, trajectory)):
        largest = np.maximum(largest, np.abs(found - wanted))
        if k % LOOKED == 0:
            least = min(least, body.distance(least if np.isfinite(least) else 1.0))
    return largest, least


def proven_margin(checker: CollisionChecker, trajectory: Trajectory, tube: tuple[float, ...]) -> float:
    """Return the margin [m] that is proven of all of a trajectory's curve within a tube, to a tenth of a millimetre."""

    def holds(margin: float) -> bool:
        proof = MotionProver(checker, separation=Separation(margin=margin, tube=tube))
        return first_unproven(trajectory.curve, proof) is None

    low, high = 0.0, 1.0
    if not holds(low):
        return -np.inf
    while high - low > 1e-4:
        middle = (low + high) / 2
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def planned(
    robot: Robot, limits: RateLimits, seed: int, tube: tuple[float, ...]
) -> tuple[CollisionChecker, Trajectory] | None:
    """Return a timed motion between two random places among random obstacles; None where none is found."""
    scene, rng = scattered(8, seed), np.random.default_rng(seed)
    setup = SafeSetup(robot, scene)
    if any(tube):
        setup.setTube(tube)
    places = (rng.uniform(robot.lower, robot.upper) for _ in range(200))
    motion = setup.motion_prover
    free = [q for q in places if motion.is_free(q, q)][:2]
    if len(free) < 2:
        return None
    setup.setConfigurations(*free)
    result = setup.plan("SafeRRTConnect", time=2.0, seed=seed, simplify=0.1)
    return (setup.checker, result.timed(limits)) if result else None


def motions(name: str, number: int, servo: Servo) -> tuple[tuple[object, ...], tuple[float, ...]]:
    """Return the row of a robot, and the tube that its errors in the first motions make."""
    robot = Robot.from_example(name)
    limits, none = RateLimits.of(robot, acceleration=ROBOTS[name]), (0.0,) * robot.n

    def problems(count: int, first: int, tube: tuple[float, ...]) -> Iterator[tuple[CollisionChecker, Trajectory]]:
        tried = (planned(robot, limits, seed, tube) for seed in range(first, first + 10 * count))
        return islice((found for found in tried if found is not None), count)

    worst = np.max(
        [errors(robot, way, checker.scene, servo)[0] for checker, way in problems(FIRST, 1000, none)], axis=0
    )
    tube = tuple((FACTOR * worst).tolist())
    outside, found = 0, []
    for checker, way in problems(number, 0, tube):
        error, physics = errors(robot, way, checker.scene, servo)
        worst, outside = np.maximum(worst, error), outside + bool((error > tube).any())
        found.append((proven_margin(checker, way, tube), physics, proven_margin(checker, way, none)))
    proven, physics, plain = np.reshape(found, (-1, 3)).T * 1e3
    missing = (plain - physics).max(initial=0.0)
    wide = [f"{1e3 * min(widths):.1f}–{1e3 * max(widths):.1f}" for widths in (worst, tube)]
    medians = [f"{np.median(values):.1f}" if number else "" for values in (proven, physics)]
    below = [int((physics < bound).sum()) for bound in (proven, plain)]
    return (name, len(found), *wide, outside, *medians, *below, f"{missing:.1f}"), tube


class Hit:
    """What becomes of a part of a body that a robot touches: at rest, and as fast as the limb is that it stands for.

    Parameters
    ----------
    body : ServoRobot
        The robot as it touches.
    touch : Touch
        Where.
    limb_velocity : ndarray, shape (3,)
        Of the limb there [m/s].
    people : People
        What they bear.
    """

    def __init__(self, body: ServoRobot, touch: Touch, limb_velocity: FloatArray, people: People) -> None:
        held = people.region_of(touch.limb)
        self.region, self._held = REGIONS[held], held
        self.speed = touch.speed / max(contact_speed(held), 1e-9)
        part = BodyPart(touch.point, touch.normal, held.mass, 1e3 * held.stiffness)
        self._robots = [body.meeting(part, velocity) for velocity in (np.zeros(3), limb_velocity)]
        self._left = round(1.5 * np.pi * np.sqrt(part.mass / part.stiffness) / STEP)
        self.forces = np.zeros(2)  # as shares of what the region bears

    def step(self, q: FloatArray, qd: FloatArray) -> None:
        """Go on with a set point of the robot as long as the first impact lasts."""
        for k, robot in enumerate(self._robots):
            robot.step(q, qd)
            self.forces[k] = max(self.forces[k], robot.force / max(self._held.force, 1e-9))
        self._left -= 1
        if self._left <= 0:
            self._robots = []


class Drive:
    """A robot that goes to and fro beside a person who walks about.

    Parameters
    ----------
    name : str
        Of the robot.
    seed : int
        Of the person and the ways.
    servo : Servo
        The controller.
    tube : tuple of float
        Errors of the joints that proofs count [rad]; empty: none.
    people : People
        What is promised.
    """

    def __init__(self, name: str, seed: int, servo: Servo, tube: tuple[float, ...], people: People) -> None:
        floor = Obstacle("floor", Box((3.0, 3.0, 0.02)), Pose((0.0, 0.0, -0.76)))
        self.robot, scene = Robot.from_example(name), Scene((floor,))
        setup = SafeSetup(self.robot, scene)
        if any(tube):
            setup.setTube(tube)
        proof = MotionProver(CollisionChecker(self.robot, scene), separation=Separation(tube=tube))
        tracker = Tracker(ALL_KEYPOINTS)
        place, start = np.array([0.0, 0.0, -0.75]), np.array([0.9, 0.0])
        self.walker = Walker(people, place, start, tracker=tracker, seed=seed)
        self.people = people
        self.replanner = Replanner(self.robot, Surroundings(scene, {"anna": tracker}, people=people), prover=proof)
        self.world = World({"anna": self.walker}, {}, self.replanner.surroundings)
        swing = 1.2 * np.eye(self.robot.n)[0] + 0.2 * np.eye(self.robot.n)[1]
        ends = [np.array(DRAWN_IN[name]) + side * swing for side in (-1, 1)]
        limits = RateLimits.of(self.robot, acceleration=ROBOTS[name])
        self.ways = []
        for k in range(2):
            setup.setConfigurations(ends[k], ends[1 - k])
            self.ways.append(setup.plan("SafeRRTConnect", seed=seed, simplify=0.1).timed(limits))
        self.body = ServoRobot(self.robot, scene, ends[0], servo)
        self.monitor = TouchJudge(self.robot, scene, people, tracker.body.height)
        self.hits: list[Hit] = []
        self.tasks = self.moved = 0
        self.least = np.inf
        self._fastest: dict[str, float] = {}  # speed of the latest hit of each limb that is touched now

    def run(self, seconds: float) -> None:
        """Drive for so long [s]."""
        replanner = self.replanner
        replanner.start(self.ways[0])
        old = command = None
        for k in range(round(seconds / replanner.tick)):
            now = k * replanner.tick
            replanner.update({"anna": self.walker.at(now)}, {}, now)
            if command is not None and command.action is Action.DONE:
                self.tasks += 1
                replanner.start(self.ways[self.tasks % 2])
            old, command = command, replanner.command(now + ANSWER)
            replanner.think()
            for i in range(round(replanner.tick / STEP)):
                time = now + i * STEP
                in_force = command if old is None or time >= now + ANSWER else old
                state = in_force.at(max(time, in_force.time))
                q = self.body.step(state.q, state.qd)
                for one in self.hits:
                    one.step(state.q, state.qd)
                moving = bool(np.abs(state.qd).max() > 1e-9 or np.abs(self.body.rates).max() > DRIFTING)
                self.moved += moving
                if i % LOOKED == 0:
                    self.look(time, q, moving)

    def look(self, time: float, q: FloatArray, moving: bool) -> None:
        """Look for contacts; note hits where the robot moves by a tenth faster than before in the same contact."""
        rates, keypoints = self.body.rates, self.world.keypoints(time)
        solids = self.world.solids(keypoints, time)
        near = self.monitor.observe(time, q, solids, moving=moving, obeyed=True, qd=rates)
        if moving:
            self.least = min(self.least, near.distance)
        if near.distance > 0:
            self._fastest = {}
        if not moving or near.distance > 0 or not self.people.contact:
            return
        ends = np.array(self.world.ends(keypoints, time))
        gone = (ends - self.world.ends(self.world.keypoints(time - STEP), time - STEP)) / STEP
        limbs = [solid.limb for solid in solids]
        for touch in self.monitor.touches(q, rates, solids):
            if touch.speed <= 1.1 * self._fastest.get(touch.limb, 0.0):
                continue
            self._fastest[touch.limb] = touch.speed
            (start, end), (first, second) = ends[limbs.index(touch.limb)], gone[limbs.index(touch.limb)]
            along = (touch.point - start) @ (end - start) / max((end - start) @ (end - start), 1e-12)
            velocity = first + np.clip(along, 0.0, 1.0) * (second - first)
            self.hits.append(Hit(self.body, touch, velocity, self.people))


def drives(
    name: str, options: argparse.Namespace, tube: tuple[float, ...], servo: Servo, people: People
) -> tuple[tuple[object, ...], list[tuple[object, ...]]]:
    """Return the row of a robot; and where contact is allowed, of each region that it touches."""
    runs = [Drive(name, seed, servo, tube, people) for seed in range(options.drives)]
    for run in runs:
        run.run(options.seconds)
    contacts = [contact.moving for run in runs for contact in run.monitor.contacts]
    share = np.mean([run.moved for run in runs]) * STEP / options.seconds
    row = (name, len(runs), sum(run.tasks for run in runs), f"{100 * share:.0f} %")
    row = (*row, f"{1e3 * min(run.least for run in runs):.1f}", sum(contacts), len(contacts) - sum(contacts))
    if not people.contact:
        return row, []
    judged = (max(getattr(run.monitor, key) for run in runs) for key in ("fastest", "closing"))
    regions, hits = [], [one for run in runs for one in run.hits]
    for region in CONTACT_TABLE:
        if own := [one for one in hits if one.region == region]:
            resting, moving = np.transpose([one.forces for one in own])
            most = (max(one.speed for one in own), np.median(resting), resting.max(), moving.max())
            regions.append((name, region, len(own), *(f"{value:.2f}" for value in most)))
    return (*row, *(f"{value:.2f}" for value in judged)), regions


def hit(name: str, region: str, servo: Servo) -> tuple[object, ...]:
    """Return the row of a robot that turns about its first joint, and hits a region of a body with its last link."""
    robot, part = Robot.from_example(name), CONTACT_TABLE[region]
    allowed, at_contact = contact_speed(part), np.array(STRETCHED[name])
    turn = np.eye(robot.n)[0]
    curve = Motion([0.0, 1e-3], [[at_contact, 1e-3 * turn]], timed=False)
    rate = allowed / float(BodySpeeds(robot).bounds(curve, curve.cells(1e-3))[:, :-1].max())
    tip = ServoRobot(robot, Scene(()), at_contact, servo).data.body(robot.joint_names[-1]).xpos
    sideways = np.array([-tip[1], tip[0], 0.0]) / np.hypot(*tip[:2])

    def body(q: FloatArray, away: float) -> ServoRobot:
        met = BodyPart(tip + away * sideways, sideways, part.mass, 1e3 * part.stiffness)
        return ServoRobot(robot, Scene(()), q, servo, met)

    touching = 1.0 - body(at_contact, 1.0).distance_to_part()
    driven = body(at_contact - BEFORE * turn, touching)
    ramp, forces = 2 * rate / ROBOTS[name][0], []
    lasts = 1.5 * np.pi * np.sqrt(part.mass / (1e3 * part.stiffness))
    for t in np.arange(0.0, ramp + (BEFORE + LONGER) / rate + lasts, STEP):
        gone = rate * (t * t / (2 * ramp) if t < ramp else t - ramp / 2)
        driven.step(at_contact + (gone - BEFORE) * turn, rate * min(t / ramp, 1.0) * turn)
        forces.append(driven.force)
    found = np.array(forces) / part.force
    over = int(np.argmax(found > 0.01)) + round(lasts / STEP)
    return (name, region, f"{allowed:.2f}", part.force, f"{found[:over].max():.2f}", f"{found[over:].max():.2f}")


def in_motions(options: argparse.Namespace, report: Report) -> int:
    """Drive planned motions with tubes."""
    rows = [motions(name, options.motions, Servo())[0] for name in ROBOTS]
    report.table(MOTIONS, rows)
    return int(any(row[7] for row in rows))


def in_drives(options: argparse.Namespace, report: Report) -> int:
    """Drive beside people who are not to be touched."""
    tubes = {name: motions(name, 0, Servo())[1] for name in ROBOTS}
    rows = [drives(name, options, tube, Servo(), People())[0] for name, tube in tubes.items()]
    report.table(DRIVES, rows)
    return int(any(row[5] for row in rows))


def live(options: argparse.Namespace, report: Report) -> None:
    """Drive beside people where contact is allowed."""
    found = [drives(name, options, (), Servo(), People(contact=True)) for name in ROBOTS]
    report.table(LIVE, [row for row, _ in found])
    hits = [row for _, rows in found for row in rows]
    if hits:
        report.table(HITS, hits)


def contact(options: argparse.Namespace, report: Report) -> None:
    """Hit regions of a body."""
    regions = [region for region, part in CONTACT_TABLE.items() if part.force]
    rows = [hit(name, region, Servo()) for name in ROBOTS for region in regions]
    report.table(CONTACT, rows)


PARTS = {"motions": in_motions, "drives": in_drives, "live": live, "contact": contact}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--motions", type=int, default=50, metavar="N", help="of each robot")
    parser.add_argument("--drives", type=int, default=10, metavar="N", help="of each robot")
    parser.add_argument("--seconds", type=float, default=12.0, help="of each drive")
