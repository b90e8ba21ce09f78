"""A guard in front of a controller against cancelling and planning anew: somebody or something comes into the way.

In each run a Panda drives a trajectory to its goal in `scenarios/panda_shelf.yaml`, and at a random time a person
walks, or a ball of 0.1 m is carried, to a random place at its path, stays for some seconds, and leaves; some come too
late or not near enough to stop it. Messages of joints, people and things are lost, late and out of order. The *guard*
stops and goes on; the *planner* cancels once the robot stands, plans from there around what is in the way then, and
drives that; where it finds nothing it tries again. Both drive with the same proofs. Time is simulated, planning takes
what it takes on this machine.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace
from time import process_time
from typing import Any

import numpy as np
import pinocchio as pin

from bench._harness import Report
from bench._scenes import ACCELERATIONS
from bench.live import to_and_fro
from safe_ompl import (
    CollisionChecker,
    MotionProver,
    Obstacle,
    People,
    Person,
    Pose,
    RateLimits,
    Scenario,
    Scene,
    Sphere,
    time_path,
)
from safe_ompl.common import FloatArray
from safe_ompl.geometry import STANDING
from safe_ompl.live import Surroundings, Tracker
from safe_ompl.live.replanning import Shield, SpeedLimits
from safe_ompl.live.ros import Cell, Code, ControlOptions, Execution, LiveController, Outcome, TrajectoryGuard
from safe_ompl.live.ros.execution import Tolerance
from safe_ompl.live.simulation import ALL_KEYPOINTS, ContactMonitor, Solid, limb_solids, part_solids
from safe_ompl.planning import setup_scenario
from safe_ompl.scene import Goal

CLAIM = (
    "no contact while moving, and every trajectory goes on when its way is free, sooner than where it is planned anew"
)
TICK, FINE, PATIENCE = 0.05, 0.01, 40.0  # [s]
STANDS = 0.3  # [s] without motion, after which the planner cancels
SPEED, THING = 1.5, "ball"  # [m/s] of who and what comes
LOST, LATE, MOST = 0.1, 0.3, 0.12  # shares of messages that are lost, and late, and by how much at most [s]
AWAY = np.array([2.5, 0.0, 0.0])
BODY = 1.75 * np.array(list(STANDING.values())) + [0.0, 0.0, -0.75]


class Measured(Executor):
    """Does at once what it is given; the results come in simulated time, when they would be ready on this machine."""

    def __init__(self) -> None:
        self.now = 0.0
        self._waiting: list[tuple[float, Callable[[], None]]] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        found: Future[Any] = Future()
        begin = process_time()
        try:
            value = fn(*args, **kwargs)
            ready = lambda: found.set_result(value)  # noqa: E731
        except Exception as error:  # as any executor does
            failure = error
            ready = lambda: found.set_exception(failure)  # noqa: E731
        self._waiting.append((self.now + process_time() - begin, ready))
        return found

    def go_on(self, now: float) -> None:
        self.now = now
        for _, ready in [one for one in self._waiting if one[0] <= now]:
            ready()
        self._waiting = [one for one in self._waiting if one[0] > now]


@dataclass
class Visit:
    """Who or what comes at a time [s] to a place (3,), stays [s], and goes."""

    person: bool
    begin: float
    stays: float
    place: FloatArray

    def at(self, time: float) -> FloatArray:
        """Return where they are (3,)."""
        far = AWAY * [np.sign(self.place[0]) or 1.0, 1.0, 1.0] + [0.0, 0.0, 0.0 if self.person else self.place[2]]
        way = self.place - far
        needs = float(np.linalg.norm(way)) / SPEED
        share = min(time - self.begin, self.begin + 2 * needs + self.stays - time) / needs
        return np.asarray(far + np.clip(share, 0.0, 1.0) * way)


class Work:
    """The Panda, its way, and how both policies drive it."""

    def __init__(self) -> None:
        scenario = Scenario.load("panda_shelf")
        self.robot = scenario.build_robot()
        ball = Obstacle(THING, Sphere(0.1), Pose(tuple(AWAY)))
        self.scenario = replace(scenario, people=None)
        self.still = scenario.scene.without("operator")
        self.operator = scenario.scene["operator"]
        assert isinstance(self.operator.shape, Person)
        self.scene = Scene((*self.still, ball, self.operator))
        self.tracker, self.ball = Tracker(ALL_KEYPOINTS), ball
        self.prover = MotionProver(CollisionChecker(self.robot, self.still))
        most = RateLimits.of(self.robot, acceleration=ACCELERATIONS["panda"])
        self.limits = SpeedLimits(most)
        self.slower = RateLimits.of(self.robot, 0.5 * most.velocity, 0.4 * most.acceleration)
        self.way = to_and_fro(scenario, self.robot, self.slower, self.prover)[0]
        self.goal = self.way.at(self.way.duration).q

    def execution(self, way: Any, report: Callable[[Outcome], Any]) -> Execution:
        """Return a trajectory as a goal of the action has it."""
        times, points = way.points(20.0)
        n = self.robot.n
        rows = points["positions"], points["velocities"], points.get("accelerations")
        tolerance = Tolerance(np.full(n, 0.05), np.full(n, np.inf))
        return Execution(list(times), rows, tolerance, tolerance, report=report)

    def cell(self) -> Cell:
        """Return what a controller drives."""
        speeds = {THING: SPEED}

        def plan(start: FloatArray, goal: Any, cloud: Obstacle | None) -> Shield:
            around = Surroundings(self.scene, {"operator": self.tracker}, speeds, People(speed=1.6))
            options = replace(ControlOptions().replanning, limits=self.limits)
            shield = Shield(self.robot, around, options=options, prover=self.prover)
            goal.drive_with(shield, start, 0.05)
            return shield

        return Cell(self.robot, {"operator": self.tracker}, speeds, plan)

    def planned(self, q: FloatArray, visit: Visit, now: float, seed: int) -> Any:
        """Return a way round who is there now, and how long planning took [s]; None if there is none."""
        begin = process_time()
        at = visit.at(now)
        there = self.operator if visit.person else self.ball
        place = Pose((at[0], at[1], -0.75), (0.0, 0.0, 0.0, 1.0)) if visit.person else Pose(tuple(at))
        scene = self.still.with_obstacles(replace(there, pose=place))
        goal = Goal(configurations=(tuple(self.goal.tolist()),))
        try:
            setup = setup_scenario(replace(self.scenario, scene=scene, start=tuple(q.tolist()), goal=goal), self.robot)
            path = setup.plan("SafeRRTConnect", time=1.0, seed=seed, simplify=True).path
        except ValueError:
            path = None
        way = None if path is None else time_path(path, self.robot, self.slower, motion=self.prover)
        return way, process_time() - begin


def drive(work: Work, visit: Visit, *, replans: bool, seed: int) -> dict[str, Any]:
    """Drive once; return what came of it."""
    rng, robot, executor = np.random.default_rng(seed), work.robot, Measured()
    now, q, qd = 0.0, work.way.at(0.0).q, np.zeros(robot.n)
    controller = LiveController(work.cell(), lambda: now + 100.0, ControlOptions(), executor)
    guard, outcomes, told = TrajectoryGuard(controller, lambda: now + 100.0), list[Outcome](), list[Any]()
    guard.take(work.execution(work.way, outcomes.append))
    monitor, mail = ContactMonitor(robot), list[tuple[float, Callable[[], Any]]]()
    contacts, stopped, left, again, plans, least = 0, 0.0, 0.0, np.inf, 0, np.inf
    stands, ready = 0.0, None
    for k in range(round(PATIENCE / FINE)):
        now = k * FINE
        executor.go_on(now)
        begun = [command for command in told if command.time <= now + 100.0]
        if begun:
            state = begun[-1].at(now + 100.0)
            q, qd = state.q, state.qd
        at = visit.at(now)
        body = BODY + at * [1.0, 1.0, 0.0] if visit.person else BODY + AWAY
        thing = at if not visit.person else -AWAY
        if np.abs(qd).max() > 1e-6:
            left -= FINE * (SPEED + 4.0)
            if left < 0:
                points, _ = work.tracker.body.completed(ALL_KEYPOINTS.keypoints(body))
                solids: list[Solid] = limb_solids("operator", work.tracker.body, points)
                solids += part_solids(THING, work.ball.shape, pin.SE3(np.eye(3), thing))
                left = monitor.nearest(q, solids).distance
                contacts += left <= 0
                least = min(least, left)
        else:
            left = 0.0
            stopped += FINE * bool(told) * (not outcomes)
        stamp = now + 100.0
        sent: list[Callable[[], Any]] = [lambda t=stamp, a=q, b=qd: controller.see_joints(t, robot.joint_names, a, b)]
        if k % 4 == 0:
            sent.append(lambda t=stamp, a=body: controller.see_people(t, {"operator": a}))
            sent.append(lambda t=stamp, a=thing: controller.see_object(t, THING, Pose(tuple(a))))
        for message in sent:
            if rng.random() >= LOST:
                mail.append((now + MOST * rng.random() * (rng.random() < LATE), message))
        for _, message in sorted((one for one in mail if one[0] <= now), key=lambda one: one[0]):
            message()
        mail = [one for one in mail if one[0] > now]
        if k % round(TICK / FINE):
            continue
        guard.tick()
        if controller.driving and controller.command is not None and (not told or controller.command is not told[-1]):
            told = [*told[-9:], controller.command]
        waits = guard.execution is not None and guard.execution.done > 0 and not guard.execution.arrived
        stands = stands + TICK if waits and not qd.any() else 0.0
        if replans and stands > STANDS:
            guard.cancel()
        if outcomes and outcomes[-1].cancelled:
            outcomes.clear()
            again = now
        if ready is None and now >= again:
            ready, took = work.planned(q, visit, now, seed + plans)
            plans, again = plans + 1, now + max(took, 0.2)
        if ready is not None and now >= again:
            guard.take(work.execution(ready, outcomes.append))
            ready, again = None, np.inf
        if outcomes:
            break
    code = outcomes[0].code if outcomes else None
    return {"contacts": contacts, "stopped": stopped, "arrived": code is Code.SUCCESSFUL, "time": now, "plans": plans,
            "least": least, "reason": outcomes[0].reason if outcomes else "out of time"}  # fmt: skip


def visits(work: Work, number: int) -> list[Visit]:
    """Return who comes in each run."""
    rng, found = np.random.default_rng(0), []
    for k in range(number):
        begin = rng.uniform(-1.0, 0.8 * work.way.duration)
        tip = work.robot.keypoints(work.way.at(rng.uniform(0.3, 1.0) * work.way.duration).q)[-1]
        place = tip + np.array([0.0, 0.0, rng.uniform(-0.05, 0.2)])
        if k % 2 == 0:
            place = np.append(tip[:2] * (1 + rng.uniform(0.1, 0.4) / np.linalg.norm(tip[:2])), 0.0)
        found.append(Visit(k % 2 == 0, begin, rng.uniform(1.0, 5.0), place))
    return found


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--runs", type=int, default=100, metavar="N")
    parser.add_argument("--only", choices=("guard", "planner"), help="one of both")


def main(options: argparse.Namespace, report: Report) -> int:
    """Run all, with both."""
    work, rows, failed = Work(), [], 0
    policies = [options.only] if options.only else ["guard", "planner"]
    done = {name: [drive(work, visit, replans=name == "planner", seed=k)
                   for k, visit in enumerate(visits(work, options.runs))] for name in policies}  # fmt: skip
    waited = [k for k in range(options.runs) if all(done[name][k]["stopped"] > 0.3 for name in policies)]
    for name, mine in done.items():
        times = np.array([run["time"] for run in mine])
        barred = sum(run["stopped"] > 0.3 for run in mine)
        bad = [run for run in mine if not run["arrived"]]
        contacts = sum(run["contacts"] > 0 for run in mine)
        both = float(np.mean(times[waited])) if waited else float("nan")
        tail = float(np.percentile(times, 90))
        least = 1e3 * min(run["least"] for run in mine)
        plans = sum(run["plans"] for run in mine)
        rows.append(
            (name, len(mine), contacts, barred, len(mine) - len(bad), float(times.mean()), both, tail, plans, least)
        )
        for run in bad:
            print(f"{name}: {run['reason']}")
        failed |= name == "guard" and bool(contacts or bad)
    header = ("", "runs", "with contact while moving", "stopped", "arrived", "time, mean [s]", "where both stopped",
              "90 %", "plans", "least distance moving [mm]")  # fmt: skip
    report.table(header, rows)
    report.figure("time of the trajectory alone [s]", work.way.duration)
    return int(failed)
