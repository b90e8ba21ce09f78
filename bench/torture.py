"""Programs put together at random from the public interface, each in a process of its own: python bench/torture.py.

    python bench/torture.py [--programs 200] [--first 0] [--time 60]

Every program takes random steps: build, solve, clear, use again, delete, raise exceptions in callbacks, interrupt,
hand over bad input. Python's errors are part of the game; a program fails if its process is ended by a signal, hangs
past its time limit, breaks a promise (a path that the validator refuses, an exception that is not the one raised), or
leaves with the words "leaked instances". `python bench/torture.py --program 17` repeats one of them here.
"""

from __future__ import annotations

import argparse
import gc
import logging
import pickle
import random
import signal
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from ompl import base as ob
from ompl import tools as ot
from ompl import util as ou

from safe_ompl import (
    Benchmark,
    CollisionFreeValidity,
    DangerObjective,
    SafeOmplError,
    SafeSetup,
    Scenario,
    plan,
)
from safe_ompl.planning.planners.registry import make_planner, needs_place, planner_names
from safe_ompl.scene.scenario import find_scenario

STEPS = 25
BAD = (None, "x", -1, float("nan"), float("inf"), [], {}, True, 3.5, object())


class MishapError(Exception):
    """What callbacks raise."""


class Program:
    """A random program: what it holds, and the steps that it may take."""

    def __init__(self, number: int) -> None:
        self.rng = random.Random(number)
        self.scenario = Scenario.load(find_scenario("planar3"))
        self.robot = self.scenario.build_robot()
        self.setups: list[SafeSetup] = []
        self.planners: list[Any] = []
        self.others: list[Any] = []
        self.steps: list[Callable[[], object]] = [
            *(
                self.build,
                self.plan,
                self.plan,
                self.solve,
                self.solve,
                self.clear,
                self.new_planner,
                self.use_planner,
            ),
            *(
                self.drop,
                self.collect,
                self.mishap,
                self.interrupt,
                self.bad_input,
                self.bad_parameter,
                self.data,
            ),
            *(
                self.other_problem,
                self.simplify,
                self.benchmark,
                self.objective,
                self.lambda_checker,
                self.place,
            ),
            *(self.foreign_planner, self.travel, self.print, self.query),
        ]

    def run(self) -> None:
        """Take the steps; Python's errors that name what is wrong are fine."""
        for _ in range(STEPS):
            step = self.rng.choice(self.steps)
            print(step.__name__, flush=True)
            try:
                step()
            except (SafeOmplError, MishapError, TypeError, ValueError, RuntimeError) as error:
                print(
                    f"  {type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}",
                    flush=True,
                )

    # ------------------------------------------------------------------------------------------------ pieces

    def setup(self) -> SafeSetup:
        """Return one of the setups."""
        if not self.setups:
            self.build()
        return self.rng.choice(self.setups)

    def name(self) -> str:
        """Return the name of a planner."""
        return self.rng.choice(planner_names())

    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Return start and goal of the scenario."""
        return self.scenario.start_configuration(self.robot), self.scenario.goal_configurations(self.robot)[0]

    def check(self, setup: SafeSetup) -> None:
        """Insist that an exact solution is proven free."""
        plain = isinstance(setup.getStateValidityChecker(), CollisionFreeValidity)
        if setup.haveExactSolutionPath() and plain:
            assert setup.report(setup.solution()).certified, "a path that is not proven free"

    # ------------------------------------------------------------------------------------------------- steps

    def build(self) -> None:
        """Build a setup, with or without danger and goal."""
        setup = SafeSetup(self.robot, self.scenario.scene, danger=self.rng.choice([{}, None]))
        if self.rng.random() < 0.9:
            setup.setConfigurations(*self.ends())
        self.setups.append(setup)

    def plan(self) -> None:
        """Plan."""
        setup = self.setup()
        planner = (
            self.name() if self.rng.random() < 0.8 or not self.planners else self.rng.choice(self.planners)
        )
        result = setup.plan(planner, time=self.rng.choice([0.01, 0.1, 0.4]), seed=self.rng.randrange(9))
        assert not result or result.report.certified

    def solve(self) -> None:
        """Solve without clear."""
        setup = self.setup()
        time = self.rng.choice([0.0, 0.02, 0.2, ob.timedPlannerTerminationCondition(0.1)])
        setup.solve(time)
        self.check(setup)

    def clear(self) -> None:
        """Clear a setup, or one of its parts."""
        setup = self.setup()
        planner = setup.getPlanner()
        parts = [setup.clear, setup.clearStartStates, setup.getProblemDefinition().clearSolutionPaths]
        if planner is not None:
            parts += [planner.clear, planner.clearQuery]
        self.rng.choice(parts)()

    def new_planner(self) -> None:
        """Make a planner, and keep it."""
        self.planners.append(make_planner(self.name(), self.setup().getSpaceInformation()))

    def use_planner(self) -> None:
        """Give a planner, perhaps of another setup, to a setup."""
        if self.planners:
            self.setup().setPlanner(self.rng.choice(self.planners))

    def drop(self) -> None:
        """Forget something."""
        things = self.rng.choice([self.setups, self.planners, self.others])
        if things:
            things.pop(self.rng.randrange(len(things)))

    def collect(self) -> None:
        """Collect garbage."""
        gc.collect()

    def mishap(self) -> None:
        """Let a callback raise."""
        setup, left = self.setup(), self.rng.choice([1, 3, 20, 200])
        inner = setup.checker

        class Failing(CollisionFreeValidity):
            left = 0

            def isValid(self, state: Any) -> bool:
                Failing.left -= 1
                if Failing.left == 0:
                    raise MishapError("as planned")
                return super().isValid(state)

        class Dear(DangerObjective):
            def stateCost(self, state: Any) -> Any:
                raise MishapError("as planned")

        if self.rng.random() < 0.5 or setup.field is None:
            setup.setStateValidityChecker(Failing(setup.getSpaceInformation(), inner))
        else:
            setup.setOptimizationObjective(Dear(setup.getSpaceInformation(), setup.field))
        Failing.left = left
        try:
            setup.plan(self.name(), time=0.2)
        finally:
            Failing.left = 0
            setup.setStateValidityChecker(CollisionFreeValidity(setup.getSpaceInformation(), inner))
            if setup.field is not None:
                setup.setOptimizationObjective(DangerObjective(setup.getSpaceInformation(), setup.field))
        self.check(setup)

    def interrupt(self) -> None:
        """Interrupt planning as Ctrl-C does."""
        setup = self.setup()
        signal.signal(signal.SIGALRM, signal.default_int_handler)
        try:
            try:
                signal.setitimer(signal.ITIMER_REAL, self.rng.uniform(0.001, 0.1))
                setup.plan(self.name(), time=5.0)
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0)
        except KeyboardInterrupt:
            print("  KeyboardInterrupt", flush=True)
        self.check(setup)

    def bad_input(self) -> None:
        """Hand over what makes no sense."""
        setup, bad = self.setup(), self.rng.choice(BAD)
        calls = [
            lambda: setup.setConfigurations(bad, self.ends()[1]),
            lambda: setup.setConfigurations(self.ends()[0], bad),
            lambda: setup.setWorkspaceGoal(bad),
            lambda: setup.plan(bad, time=0.05),
            lambda: setup.plan("SafePRM", time=bad),
            lambda: setup.plan("SafePRM", time=0.05, seed=bad),
            lambda: setup.solve(bad),
            lambda: setup.report(bad),
            lambda: SafeSetup(bad, self.scenario.scene),
            lambda: SafeSetup(self.robot, bad),
            lambda: make_planner(bad, setup.getSpaceInformation()),
            lambda: plan(bad),
            lambda: setup.setGoal(bad),
            lambda: setup.setStateValidityChecker(bad),
        ]
        try:
            self.rng.choice(calls)()
        except AttributeError as error:  # Python's own word for arguments of a foreign kind
            print(f"  AttributeError: {error}", flush=True)

    def bad_parameter(self) -> None:
        """Set parameters to what makes no sense."""
        planner = make_planner(self.name(), self.setup().getSpaceInformation())
        setters = [
            name for name in dir(type(planner)) if name.startswith("set") and name != "setProblemDefinition"
        ]
        setter = self.rng.choice([name for name in setters if name not in ("setup", "setName")])
        getattr(planner, setter)(self.rng.choice(BAD))

    def data(self) -> None:
        """Ask for planner data."""
        setup = self.setup()
        data = ob.PlannerData(setup.getSpaceInformation())
        if (
            setup.getPlanner() is None or "BIT" not in setup.getPlanner().getName()
        ):  # whose graph leaks when read
            for _ in range(self.rng.choice([1, 2])):
                setup.getPlannerData(data)
            data.printGraphML()
        self.others.append(data)

    def other_problem(self) -> None:
        """Exchange start and goal, or try another goal."""
        start, goal = self.ends()
        self.setup().setConfigurations(
            *self.rng.choice([(goal, start), (start, [goal, goal + 0.01]), (start, start)])
        )

    def place(self) -> None:
        """Set a place as the goal."""
        setup = self.setup()
        setup.setStartConfiguration(self.ends()[0])
        setup.setWorkspaceGoal(self.rng.choice([self.scenario.goal.position, [9.0, 0.0, 0.0]]))

    def simplify(self) -> None:
        """Simplify what there is."""
        setup = self.setup()
        setup.simplifySolution(0.1)
        self.check(setup)

    def benchmark(self) -> None:
        """Benchmark two planners."""
        setup = self.setup()
        comparison = Benchmark(setup, "torture")
        for _ in range(2):
            comparison.addPlanner(self.name())
        request = ot.Request(
            maxTime=0.1,
            runCount=2,
            displayProgress=False,
            saveConsoleOutput=False,
            simplify=self.rng.random() < 0.5,
        )
        comparison.benchmark(request, processes=self.rng.choice([1, 2]))
        comparison.getRecordedExperimentData().text()

    def objective(self) -> None:
        """Change the objective."""
        setup = self.setup()
        si = setup.getSpaceInformation()
        setup.setOptimizationObjective(ob.PathLengthOptimizationObjective(si))

    def lambda_checker(self) -> None:
        """Take a lambda for the checker, one that may return nonsense, and go back."""
        setup = self.setup()
        answer = self.rng.choice([True, False, True, None, 1, np.True_])
        setup.setStateValidityChecker(lambda state: answer)
        try:
            setup.plan(self.name(), time=0.05)
        finally:
            setup.setStateValidityChecker(CollisionFreeValidity(setup.getSpaceInformation(), setup.checker))
            setup.clear()

    def foreign_planner(self) -> None:
        """Plan with a planner of another setup."""
        other = SafeSetup(self.robot, self.scenario.scene)
        self.setup().plan(make_planner(self.name(), other.getSpaceInformation()), time=0.05)

    def travel(self) -> None:
        """Pickle what can be pickled."""
        for thing in (self.robot, self.scenario, self.scenario.scene):
            pickle.loads(pickle.dumps(thing))

    def print(self) -> None:
        """Print everything."""
        for thing in (*self.setups, *self.planners):
            repr(thing), str(thing)

    def query(self) -> None:
        """Ask a planner on its own."""
        setup = self.setup()
        planner = make_planner(self.name(), setup.getSpaceInformation())
        planner.setProblemDefinition(setup.getProblemDefinition())
        if planner.getName() == "SORRTstar":  # never ends where the start is the goal; SafeSetup says so
            return
        if not needs_place(planner.getName()):
            planner.solve(ob.timedPlannerTerminationCondition(0.05))


def survives(number: int, time: float) -> str | None:
    """Run a program in a process of its own; return what went wrong with it, or None."""
    command = [sys.executable, __file__, "--program", str(number)]
    try:
        run = subprocess.run(command, capture_output=True, text=True, timeout=time)
    except subprocess.TimeoutExpired as error:
        return f"hangs in {_last_line(error.stdout)}"
    if run.returncode:
        return f"exit code {run.returncode} in {_last_line(run.stdout)}: {_last_line(run.stderr)}"
    return "leaks" if "leaked" in run.stderr else None


def _last_line(output: str | bytes | None) -> str:
    text = output.decode() if isinstance(output, bytes) else output or ""
    return (text.strip().splitlines() or ["nothing"])[-1]


def main() -> None:
    """Run the programs and count those that fail."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--programs", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="number of the first program")
    parser.add_argument("--time", type=float, default=60.0, help="limit of a program [s]")
    parser.add_argument("--program", type=int, help="run this one here")
    options = parser.parse_args()
    if options.program is not None:
        ou.setLogLevel(ou.LogLevel.LOG_NONE)
        logging.disable()
        Program(options.program).run()
        return
    wrong = 0
    for number in range(options.first, options.first + options.programs):
        words = survives(number, options.time)
        if words is not None:
            wrong += 1
            print(f"program {number}: {words}", flush=True)
    print(f"{wrong} of {options.programs} programs failed")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
