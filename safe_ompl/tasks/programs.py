"""Planning of programs of many steps, as one motion that is proven at all times.

Steps are data (`scene/program.py`). A best-first search over partial plans chooses grasps, places and branches of the
inverse kinematics. A partial plan is a plan of the first steps. Its cost is its duration, minus two seconds for each
planned step, plus one second for each failure after the same choices. An alternative enters the search with a lower
bound of its duration, and is planned only when it has the least cost. So the motion of the whole program is known
before the first step is executed, and no step is planned twice.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.common import (
    CollisionError,
    FloatArray,
    InputError,
    PlanningError,
    documents as document,
    number,
    seed as checked_seed,
)
from safe_ompl.geometry import Obstacle, Pose
from safe_ompl.motions import Motion, PathTimer, Trajectory
from safe_ompl.robot import Robot, configurations_at
from safe_ompl.scene import Attach, Detach, Goal, Gripper, Line, Move, Scenario, Seam, Step, Wait, configuration_for
from safe_ompl.tasks.corridor import Corridor
from safe_ompl.tasks.program_result import ProgramResult, Stretch
from safe_ompl.tasks.tool_motions import plan_tool
from safe_ompl.tasks.tool_path import ToolPath
from safe_ompl.tasks.workcell import CellState, ImpossibleError, ProvenMotion, Workcell, named

PROGRAM_TIME = 20.0  # [s]
# Each planned step reduces the cost of a partial plan by this time.
_STEP_DONE = 2.0  # [s]
# Each failure of a later step adds this time to the cost of all partial plans with the same choices.
_FAILURE_PENALTY = 1.0  # [s]
# A move may end in this many branches of the inverse kinematics.
_BRANCHES = 6
# One planner call takes at most this long.
_MOST_STEP_TIME = 2.0  # [s]
# A step is skipped if no joint would move farther than this.
_NEGLIGIBLE_MOTION = 1e-6  # [rad or m]
# The rate at which the trajectory of a move is sampled.
_POINT_RATE = 25.0  # [Hz]


def plan_program(scenario: Scenario | str | Path, *, time: float = PROGRAM_TIME, seed: int = 0) -> ProgramResult:
    """Plan the program of a scenario: one motion in time through all of its steps, proven throughout.

    Parameters
    ----------
    scenario : Scenario, str or Path
        A scenario with a program, or its name or file. The scenario's start is the first configuration of the arm; its
        robot's locked joints are the first positions of gripper joints.
    time : float
        Time limit [s].
    seed : int
        Seed of the random numbers. The same seed gives the same motion, unless the time runs out.

    Returns
    -------
    ProgramResult
        If it is not solved, `why` names the step that failed and the reason.

    Raises
    ------
    InputError
        If the scenario has no program, or a step names something that does not exist; the message begins with the step
        and its key.
    """
    if not isinstance(scenario, Scenario):
        scenario = Scenario.load(scenario)
    limit = number("time limit", time, above=0.0, kind="number of seconds")
    with _naming(scenario):
        return _ProgramPlanner(scenario, checked_seed(seed)).run(limit)


def program_robot(scenario: Scenario) -> Robot:
    """Return the robot at the beginning of a scenario's program; its gripper joints are not locked."""
    with _naming(scenario):
        cell = Workcell(scenario)
        return cell.holding(cell.begin)


def _naming(scenario: Scenario) -> AbstractContextManager[None]:
    """Prefix every InputError within the block with the file or the name of the scenario."""
    return document.within(str(scenario.file or scenario.name), ": ")


def _points(trajectory: Trajectory, robot: Robot) -> tuple[Motion, Motion]:
    """Return the Hermite spline through the sampled points of a trajectory, and the trajectory's curve."""
    times, points = trajectory.points(_POINT_RATE)
    rates = points["velocities"], points.get("accelerations")
    return Motion.hermite(times, points["positions"], *rates, robot.joint_names), trajectory.curve


@dataclass(frozen=True)
class _Node:
    """A partial plan of the steps before `step`; `action`, if given, plans that step by one alternative."""

    step: int
    state: CellState
    stretches: tuple[Stretch, ...] = ()
    choices: tuple[str, ...] = ()
    action: Callable[[], tuple[CellState, tuple[ProvenMotion, ...]]] | None = None
    duration: float = 0.0


class _ProgramPlanner:
    """Plans the program of one scenario."""

    def __init__(self, scenario: Scenario, seed: int) -> None:
        self._cell, self._scenario, self._seed = Workcell(scenario), scenario, seed
        assert scenario.program is not None
        self._program, self._steps = scenario.program, scenario.program.steps
        self._end = np.inf

    # --------------------------------------------------------------------------------------------------- search

    def run(self, time: float) -> ProgramResult:
        """Search for a plan of the program for at most `time` [s]."""
        begin = perf_counter()
        self._end, order = begin + time, count()
        best = _Node(0, self._cell.begin)
        waiting = [(0.0, next(order), 0.0, best)]
        # How often each sequence of choices failed, with any continuation.
        refused: Counter[tuple[str, ...]] = Counter()
        why, failed = "", -1

        def wait(cost: float, node: _Node) -> None:
            heapq.heappush(waiting, (cost + _FAILURE_PENALTY * refused[node.choices], next(order), cost, node))

        while waiting and best.step < len(self._steps):
            if perf_counter() > self._end:
                why = f"{why}; {time:g} s are over" if why else f"{time:g} s are over"
                break
            before, _, cost, node = heapq.heappop(waiting)
            # Failures of continuations since the node was queued have increased its cost, so it is queued again.
            if cost + _FAILURE_PENALTY * refused[node.choices] > before:
                wait(cost, node)
                continue
            try:
                if node.action is not None:
                    node = self._planned(node)
                    best = node if node.step > best.step else best
                    wait(node.duration - _STEP_DONE * node.step, node)
                    continue
                for bound, choice, action in self._alternatives(node):
                    ahead = replace(node, action=action, choices=(*node.choices, *choice))
                    wait(node.duration + bound - _STEP_DONE * node.step, ahead)
            except (ImpossibleError, CollisionError, PlanningError) as error:
                refused.update(node.choices[:k] for k in range(len(node.choices) + 1))
                if node.step >= failed:
                    failed, why = node.step, f"step {node.step + 1} ({self._steps[node.step]}): {error}"
        solved = best.step == len(self._steps)
        why = "" if solved else why or f"step {best.step + 1}: nothing is left to try"
        return ProgramResult(self._scenario, best.stretches, best.choices, why, perf_counter() - begin)

    def _planned(self, node: _Node) -> _Node:
        """Plan the step of a node by its action, and return the node after the step."""
        assert node.action is not None
        state, proven = node.action()
        stretches, duration = list(node.stretches), node.duration
        for each in proven:
            stretches.append(Stretch(node.step, duration, *each))
            duration += each.check.motion.duration
        return _Node(node.step + 1, state, tuple(stretches), node.choices, None, duration)

    def _alternatives(self, node: _Node) -> Iterator[tuple[float, list[str], Callable[[], Any]]]:
        """Yield alternatives for the next step: a lower bound of its duration [s], choices, and a planning function."""
        step, state = self._steps[node.step], node.state
        if isinstance(step, Move) and (step.configuration is not None or step.region is not None):
            yield 0.0, [], partial(self._move, step, state, None)
        elif isinstance(step, (Move, Line)):
            reached = isinstance(step, Line)
            for chosen, target, new_choice in self._targets(step, state):
                after = state._replace(chosen=chosen)
                if isinstance(step, Line):
                    yield 0.0, new_choice, partial(self._line, step, after, [target])
                    continue
                arm, q = self._cell.arm_at(step.arm, state)
                branches = configurations_at(arm, target, q, np.random.default_rng(self._seed))
                reached |= len(branches) > 0
                fastest = self._cell.limits_of(arm).velocity
                for branch in branches[:_BRANCHES]:
                    bound = float((np.abs(arm.difference(q, branch)) / fastest).max())
                    yield bound, new_choice, partial(self._move, step, after, branch)
            if not reached:
                raise ImpossibleError("no configuration has its tip there")
        elif isinstance(step, Seam):
            yield 0.0, [], partial(self._line, step, state, [pose.se3 for pose in step.poses])
        else:
            planned: dict[type[Step], Callable[..., Any]] = {
                Gripper: self._gripper,
                Attach: self._attach,
                Detach: self._detach,
                Wait: self._wait,
            }
            yield 0.0, [], partial(planned[type(step)], step, state)

    def _targets(self, step: Move | Line, state: CellState) -> Iterator[tuple[Mapping[Any, int], pin.SE3, list[str]]]:
        """Yield the alternative targets of a step: all choices so far, the tip's pose, and the new choice in words."""
        ((kind, value),) = step.targets.items()
        up = pin.SE3(np.eye(3), np.array([0.0, 0.0, step.up]))
        back = pin.SE3(np.eye(3), np.array([0.0, 0.0, -step.back]))
        if kind in ("pose", "by"):
            pose = value.se3 if kind == "pose" else self._cell.tip(step.arm, state)
            if kind == "by":
                pose.translation += np.array(value)
            yield state.chosen, up * pose * back, []
            return
        held = {item.name: item for item in state.held}
        item = held.get(value)
        if kind == "place" and item is None:
            raise ImpossibleError(f"{value!r} is not held")
        if kind == "grasp" and item is not None and item.link == self._cell.arm_at(step.arm, state)[0].tip:
            raise ImpossibleError(f"{value!r} is held already")
        options = getattr(self._program, f"{kind}s")[value]
        key = kind, value, step.arm
        known = state.chosen.get(key)
        for k, option in enumerate(options):
            if known not in (None, k):
                continue
            if kind == "place":
                in_hand = self._cell.tip(step.arm, state).inverse() * self._cell.link(held[value].link, state)
                pose = option.se3 * (in_hand * held[value].pose.se3).inverse()
            # Another link, such as the tip of the other arm, holds the object and hands it over.
            elif item is not None:
                pose = self._cell.link(item.link, state) * item.pose.se3 * option.se3
            else:
                pose = state.scene[value].pose.se3 * option.se3
            new_choice = [] if known is not None or len(options) == 1 else [f"{kind} {k + 1} of {value}"]
            yield {**state.chosen, key: k}, up * pose * back, new_choice

    # ---------------------------------------------------------------------------------------------------- steps

    def _move(self, step: Move, state: CellState, branch: FloatArray | None) -> Any:
        during = self._cell.during(step, state)
        arm, q = self._cell.arm_at(step.arm, during)
        goal = Goal(region=step.region) if step.region is not None else None
        setup = self._cell.setup(arm, during.scene, q, goal)
        if goal is None:
            wanted = branch
            if step.configuration is not None:
                wanted = configuration_for(arm, "configuration", step.configuration)
            assert wanted is not None
            if np.abs(arm.difference(q, wanted)).max() < _NEGLIGIBLE_MOTION:
                return state, ()
            setup.setConfigurations(q, wanted)
        left = min(_MOST_STEP_TIME, max(self._end - perf_counter(), 1e-3))
        result = setup.plan(time=left, seed=self._seed, simplify=setup.field is not None)
        if result.path is None:
            raise ImpossibleError(f"no path is found in {left:.2g} s")
        speeds = {key: getattr(self._scenario.motion, key) for key in ("tool_speed", "link_speed")}
        timer = PathTimer(arm, self._cell.limits_of(arm), motion=setup.motion_prover, **speeds)
        return self._cell.proven(step, state, *_points(timer.time(result.path), arm))

    def _line(self, step: Line | Seam, state: CellState, targets: list[pin.SE3]) -> Any:
        during = self._cell.during(step, state)
        arm, q = self._cell.arm_at(step.arm, during)
        poses = [arm.tip_pose(q), *targets]
        if len(poses) == 2 and np.abs(pin.log6(poses[0].inverse() * poses[1]).vector).max() < _NEGLIGIBLE_MOTION:
            return state, ()
        setup = self._cell.setup(arm, during.scene, q)
        corridor = Corridor(step.within, step.angle, step.free_axis)
        path = ToolPath.of(poses)
        limits = self._cell.limits_of(arm)
        found = plan_tool(setup, path, corridor, start=q, speed=step.speed, limits=limits, seed=self._seed)
        if found.motion is None:
            raise ImpossibleError(f"{100 * found.fraction:.0f} % of it can be followed; {found.why}")
        assert found.along is not None
        corners = tuple(np.searchsorted(found.along.times, path.corners - _NEGLIGIBLE_MOTION).tolist())
        return self._cell.proven(step, state, found.motion, replace(found.along, timed=False, corners=corners))

    def _gripper(self, step: Gripper, state: CellState) -> Any:
        robot = self._cell.holding(state)
        q = robot.configuration({**named(robot, state.q), **step.joints})
        if (beyond := robot.beyond_limits(q)) is not None:
            raise InputError(beyond, "gripper.joints")
        if np.abs(q - state.q).max() < _NEGLIGIBLE_MOTION:
            return state, ()
        trajectory = PathTimer(robot, self._cell.limits).time([state.q, q])
        return self._cell.proven(step, state, *_points(trajectory, robot))

    def _wait(self, step: Wait, state: CellState) -> Any:
        still = np.array([[state.q, np.zeros_like(state.q)]])
        return self._cell.proven(step, state, Motion(np.array([0.0, step.time]), still, self._cell.robot.joint_names))

    def _attach(self, step: Attach, state: CellState) -> Any:
        if step.object not in state.scene.names:
            raise ImpossibleError(f"{step.object!r} is held already")
        item = self._cell.taken(state.scene[step.object], step.arm, state)
        return state._replace(held=(*state.held, item), scene=state.scene.without(item.name)), ()

    def _detach(self, step: Detach, state: CellState) -> Any:
        item = next((item for item in state.held if item.name == step.object), None)
        if item is None:
            raise ImpossibleError(f"{step.object!r} is not held")
        before = self._scenario.scene
        known = before[item.name] if item.name in before.names else Obstacle(item.name, item.shape)
        pose = self._cell.link(item.link, state) * item.pose.se3
        scene = state.scene.with_obstacles(known.moved(Pose.of(pose)))
        chosen = {key: k for key, k in state.chosen.items() if key[1] != item.name}
        held = tuple(other for other in state.held if other is not item)
        return state._replace(held=held, scene=scene, chosen=chosen), ()
