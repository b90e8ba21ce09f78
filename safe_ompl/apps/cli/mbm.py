"""`safe-ompl mbm`: the problems of a MotionBenchMaker file, one JSON line each."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from safe_ompl.apps.benchmark import Run, Summary, failure, run_planner
from safe_ompl.apps.cli import arguments, output
from safe_ompl.apps.cli.arguments import option
from safe_ompl.apps.cli.compare import summary_table
from safe_ompl.apps.cli.plan import record
from safe_ompl.common import InputError, UnknownNameError
from safe_ompl.io import strict_json as json_line
from safe_ompl.planning import PlanResult, SafeSetup, setup_problem
from safe_ompl.planning.planners import make_planner
from safe_ompl.robot import EXAMPLES, Robot, RobotSpec
from safe_ompl.scene import WHERE_FROM, MbmFile, Scene

USUAL_TIME = 5.0  # [s]


def add_commands(commands: Any) -> None:
    """Add `mbm` to the commands."""
    parser = arguments.add_parser(
        commands,
        "mbm",
        prepare,
        "run a MotionBenchMaker file, one JSON line per problem",
        "Run the problems of a MotionBenchMaker file (JSON form), one JSON line per problem. "
        f"Every obstacle is dangerous, with weight 1; {WHERE_FROM}.",
    )
    option(parser, "file FILE", "the problems")
    option(parser, "--families A,B,...", "default: all", arguments.names)
    option(parser, "--problems 0:50", "which of each family; default: all", arguments.positions, slice(None))
    arguments.add_planner_options(parser, usual_time=f"{USUAL_TIME:g}")
    read = output.output_file(".jsonl", ".json", output.STANDARD_OUTPUT)
    option(parser, "--json FILE", "a line for each; default: standard output", read, output.STANDARD_OUTPUT)
    arguments.add_force(parser)
    option(parser, "--robot ROBOT", "an example robot, or a scenario with the robot; default: the file's")
    arguments.add_package_dirs(parser)


def prepare(options: argparse.Namespace) -> Callable[[], int]:
    """Check what the options name, and return the job."""
    file = MbmFile.load(options.file)
    robot = _robot(file, options)
    parameters = arguments.given_parameters(options)
    empty = SafeSetup(robot, Scene(), danger=None)
    make_planner(options.planner, empty.getSpaceInformation(), parameters)
    return Mbm(file, robot, _chosen(file, options), parameters, options)


@dataclass(frozen=True)
class Mbm:
    """The job of `safe-ompl mbm`."""

    file: MbmFile
    robot: Robot
    chosen: list[tuple[str, int]]
    parameters: dict[str, Any]
    options: argparse.Namespace

    def __call__(self) -> int:
        """Solve the problems, write a line for each, and show a table by family."""
        to_terminal = self.options.json == output.STANDARD_OUTPUT and sys.stdout.isatty()
        console = output.error_console()
        results: dict[str, list[PlanResult]] = {}
        with output.opened(self.options.json) as stream, output.progress_bar(console, hidden=to_terminal) as progress:

            def solve(problem: tuple[str, int]) -> None:
                line, result = self._solve(*problem)
                print(json_line(line), file=stream, flush=True)
                results.setdefault(problem[0], []).append(result)

            status = output.each_until_ctrl_c(progress.track(self.chosen, description=self.file.path.name), solve)
        summaries = [Summary.of(family, of_family) for family, of_family in results.items()]
        console.print(summary_table("family", summaries))
        return status or int(not all(result for of_family in results.values() for result in of_family))

    def _solve(self, family: str, k: int) -> tuple[dict[str, Any], PlanResult]:
        """Return the k-th problem's line, and its result."""
        index, widened, run = k, {}, Run(self.options.planner, self.options.seed)
        try:
            problem = self.file.problem(family, k)
            index, widened = problem.index, problem.widened_limits(self.robot)
            result = run_planner(
                setup_problem(problem, self.robot),
                run,
                time=self.options.time or USUAL_TIME,
                parameters=self.parameters,
                simplify=self.options.simplify,
            )
        except InputError as error:
            result = failure(f"Invalid input: {error}", *run, self.robot.joint_names)
        told = record(f"{family}/{index}", self.robot, result)
        return {"family": family, "index": index, **told, "widened_limits": widened}, result


def _robot(file: MbmFile, options: argparse.Namespace) -> Robot:
    """Return the robot of the options or of the file; its joints must be those of the file."""
    name = options.robot or file.robot
    if name in EXAMPLES:
        robot = Robot(RobotSpec(name))
    elif options.robot is not None:
        robot = arguments.load_scenario(name, options.package_dir).build_robot()
    else:
        raise InputError(f"{name!r} is not an example robot: give --robot", f"{file.path}: robot")
    if file.joint_names and set(file.joint_names) != set(robot.joint_names):
        raise InputError(
            f"the problems are for the joints {', '.join(file.joint_names)}, "
            f"but {robot.name} moves {', '.join(robot.joint_names)}; a scenario's robot says what is locked",
            f"{file.path}: joints",
        )
    return robot


def _chosen(file: MbmFile, options: argparse.Namespace) -> list[tuple[str, int]]:
    """Return family and position of each problem to solve."""
    for family in options.families or ():
        if family not in file.families:
            raise UnknownNameError("family", family, file.families, "--families")
    families = options.families or tuple(file.families)
    chosen = [(family, k) for family in families for k in range(file.families[family])[options.problems]]
    if not chosen:
        raise InputError("the range holds no problem of the file", "--problems")
    return chosen
