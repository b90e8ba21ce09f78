"""What proofs are worth in physics: `python -m bench.physics` (pip install mujoco), some minutes.

A Panda and a UR5 in MuJoCo, under position servos with friction, delay and a payload that the controller does not know
(`examples/mujoco/servo_robot.py`), follow what was proven.

motions    Planned and timed motions among obstacles. Errors of the joints in the first ones make a tube, as
           `safe-ompl tube` does; the others are planned and proven with it. `proven` is the margin from every obstacle
           that is proven of the whole tube, `physics` the smallest distance that MuJoCo measures along the motion. A
           motion is `below` if physics is nearer than was proven; `below without a tube` takes the margin that is
           proven of the motion itself, and `missing` is by how much it was missed at worst.
drives     The replanner beside a person who walks about and reaches out, and who keeps to the promised speeds. People
           are kept away by what the tube moves the robot, too. Contacts are looked for at the joints of the physics.
contact    A link at the speed that a region of the body bears (`people.contact`) hits a part of a body of that mass
           and stiffness which is free to give way. `first` is the largest force of the first impact, `later` that of
           the time after it while the robot drives on, both as a share of what the region bears.
"""

from __future__ import annotations

import argparse
import logging
from collections.abc import Iterator
from itertools import islice

import numpy as np
from ompl import util as ou

from bench._scenes import scattered
from bench._timing import print_table
from examples.mujoco.servo_robot import STEP, BodyPart, Servo, ServoRobot
from safe_ompl import People, RateLimits, Robot, SafeSetup, Scene, Trajectory
from safe_ompl.collision import CertifiedMotion, CollisionChecker, Separation
from safe_ompl.common import FloatArray
from safe_ompl.geometry import Box, Obstacle, Pose
from safe_ompl.motions import FACTOR
from safe_ompl.people import Tracker
from safe_ompl.people.replanning import Doing, Replanner
from safe_ompl.people.simulation import ALL_KEYPOINTS, ContactMonitor, Walker, World
from safe_ompl.scene.people import CONTACT_TABLE
from safe_ompl.trajectories import BlendedCurve, BlendProof, BodySpeeds, Piece, contact_speed, robot_mass

# Accelerations [rad/s²]; of the Panda half of what Franka publishes, with which the motors are too weak here at times.
ROBOTS = {"panda": [7.5, 3.75, 5, 6.25, 7.5, 10, 10], "ur5": [4.0] * 6}
MOTIONS = (
    *(
        "robot",
        "motions",
        "errors [mrad]",
        "tube [mrad]",
        "outside it",
        "proven [mm]",
        "physics [mm]",
        "below",
    ),
    *("below without a tube", "missing [mm]"),
)
DRIVES = "robot", "drives", "tasks", "moving", "nearest moving [mm]", "contacts moving", "contacts at rest"
CONTACT = "robot", "region", "speed [m/s]", "bears [N]", "first / bears", "later / bears"
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
        proof = CertifiedMotion(checker, separation=Separation(margin=margin, tube=tube))
        bends = BlendProof(proof)
        for piece in trajectory.curve.pieces:
            end = piece.places(np.array([piece.length])).q[0]
            if not (proof.is_free(piece.start, end) if piece.straight else bends.holds(piece)):
                return False
        return True

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
    motion = setup.certified_motion
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

    def problems(
        count: int, first: int, tube: tuple[float, ...]
    ) -> Iterator[tuple[CollisionChecker, Trajectory]]:
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


def drive(name: str, seed: int, tube: tuple[float, ...], servo: Servo, seconds: float) -> list[float]:
    """Return the least distance while moving [m], contacts while moving and at rest, share of moving, and tasks."""
    robot, floor = Robot.from_example(name), Obstacle("floor", Box((3.0, 3.0, 0.02)), Pose((0.0, 0.0, -0.76)))
    scene = Scene((floor,))
    setup = SafeSetup(robot, scene)
    setup.setTube(tube)
    proof = CertifiedMotion(CollisionChecker(robot, scene), separation=Separation(tube=tube))
    people, tracker = People(), Tracker(ALL_KEYPOINTS)
    walker = Walker(people, np.array([0.0, 0.0, -0.75]), np.array([0.9, 0.0]), tracker=tracker, seed=seed)
    replanner = Replanner(robot, scene, {"anna": tracker}, people=people, motion=proof)
    world = World({"anna": walker}, {}, replanner.surroundings)
    swing = 1.2 * np.eye(robot.n)[0] + 0.2 * np.eye(robot.n)[1]
    ends = [np.array(DRAWN_IN[name]) + side * swing for side in (-1, 1)]
    limits, ways = RateLimits.of(robot, acceleration=ROBOTS[name]), []
    for k in range(2):
        setup.setConfigurations(ends[k], ends[1 - k])
        ways.append(setup.plan("SafeRRTConnect", seed=seed, simplify=0.1).timed(limits))
    body, monitor = ServoRobot(robot, scene, ends[0], servo), ContactMonitor(robot)
    replanner.start(ways[0])
    tasks, moved, least = 0, 0, np.inf
    old = command = None
    for k in range(round(seconds / replanner.tick)):
        now = k * replanner.tick
        replanner.update({"anna": walker.at(now)}, {}, now)
        if command is not None and command.doing is Doing.DONE:
            tasks += 1
            replanner.start(ways[tasks % 2])
        old, command = command, replanner.command(now + ANSWER)
        replanner.think()
        for i in range(round(replanner.tick / STEP)):
            time = now + i * STEP
            in_force = command if old is None or time >= now + ANSWER else old
            state = in_force.at(max(time, in_force.time))
            q = body.step(state.q, state.qd)
            moving = bool(np.abs(state.qd).max() > 1e-9 or np.abs(body.rates).max() > DRIFTING)
            moved += moving
            if i % LOOKED == 0:
                solids = world.solids(world.keypoints(time), time)
                near = monitor.observe(time, q, solids, moving=moving, obeyed=True)
                least = min(least, near.distance) if moving else least
    touched = [contact.moving for contact in monitor.contacts]
    return [least, sum(touched), len(touched) - sum(touched), moved * STEP / seconds, tasks]


def drives(
    name: str, options: argparse.Namespace, tube: tuple[float, ...], servo: Servo
) -> tuple[object, ...]:
    """Return the row of a robot."""
    runs = [drive(name, seed, tube, servo, options.seconds) for seed in range(options.drives)]
    least, moving, rest, moved, tasks = np.transpose(runs)
    share, nearest = f"{100 * moved.mean():.0f} %", f"{1e3 * least.min():.1f}"
    return name, len(runs), int(tasks.sum()), share, nearest, int(moving.sum()), int(rest.sum())


def hit(name: str, region: str, servo: Servo, people: People) -> tuple[object, ...]:
    """Return the row of a robot that turns about its first joint, and hits a region of a body with its last link."""
    robot, part = Robot.from_example(name), CONTACT_TABLE[region]
    mass = robot_mass(robot, people)
    allowed, at_contact = contact_speed(part, mass), np.array(STRETCHED[name])
    turn, still = np.eye(robot.n)[0], np.zeros(robot.n)
    curve = BlendedCurve([Piece(at_contact, turn, still, still, 1e-3)], [])
    rate = allowed / float(BodySpeeds(robot).bounds(curve, curve.cells(1e-3))[:, :-1].max())
    tip = ServoRobot(robot, Scene(()), at_contact, servo).data.body(robot.joint_names[-1]).xpos
    sideways = np.array([-tip[1], tip[0], 0.0]) / np.hypot(*tip[:2])

    def body(q: FloatArray, away: float) -> ServoRobot:
        met = BodyPart(tip + away * sideways, sideways, part.mass, 1e3 * part.stiffness)
        return ServoRobot(robot, Scene(()), q, servo, met)

    touching = 1.0 - body(at_contact, 1.0).distance_to_part()
    driven = body(at_contact - BEFORE * turn, touching)
    ramp, forces = 2 * rate / ROBOTS[name][0], []
    reduced = 1 / (1 / part.mass + 1 / mass)
    lasts = 1.5 * np.pi * np.sqrt(reduced / (1e3 * part.stiffness))
    for t in np.arange(0.0, ramp + (BEFORE + LONGER) / rate + lasts, STEP):
        gone = rate * (t * t / (2 * ramp) if t < ramp else t - ramp / 2)
        driven.step(at_contact + (gone - BEFORE) * turn, rate * min(t / ramp, 1.0) * turn)
        forces.append(driven.force)
    found = np.array(forces) / part.force
    over = int(np.argmax(found > 0.01)) + round(lasts / STEP)
    return (
        name,
        region,
        f"{allowed:.2f}",
        part.force,
        f"{found[:over].max():.2f}",
        f"{found[over:].max():.2f}",
    )


def main() -> None:
    """Run what the options choose."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", choices=("motions", "drives", "contact"))
    parser.add_argument("--motions", type=int, default=50, metavar="N", help="of each robot")
    parser.add_argument("--drives", type=int, default=10, metavar="N", help="of each robot")
    parser.add_argument("--seconds", type=float, default=12.0, help="of each drive")
    parser.add_argument(
        "--robot-mass", type=float, metavar="KG", help="in a contact; default: as `People` has it"
    )
    options = parser.parse_args()
    logging.disable(logging.WARNING)
    ou.setLogLevel(ou.LogLevel.LOG_NONE)
    servo = Servo()
    if options.only != "contact":
        number = 0 if options.only == "drives" else options.motions
        found = {name: motions(name, number, servo) for name in ROBOTS}
        if number:
            print_table(MOTIONS, [row for row, _ in found.values()])
        if options.only != "motions":
            print_table(DRIVES, [drives(name, options, tube, servo) for name, (_, tube) in found.items()])
    if options.only in (None, "contact"):
        people = People(robot_mass=options.robot_mass)
        regions = [region for region, part in CONTACT_TABLE.items() if part.force]
        print_table(CONTACT, [hit(name, region, servo, people) for name in ROBOTS for region in regions])


if __name__ == "__main__":
    main()
