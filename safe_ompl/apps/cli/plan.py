"""`safe-ompl plan`: one path for one scenario."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

from safe_ompl.apps.benchmark import check_named_planner
from safe_ompl.apps.cli.arguments import (
    add_limit_options,
    add_planner_options,
    add_robot_options,
    given_parameters,
    given_robot,
    load_scenario,
    with_limits,
)
from safe_ompl.apps.cli.console import error_console, output_console
from safe_ompl.apps.cli.files import STANDARD_OUTPUT, check_writable, opened
from safe_ompl.apps.cli.pictures import check_picture
from safe_ompl.apps.cli.tables import plan_table
from safe_ompl.apps.cli.timed import add_timed_options, rate_limits, show_timed, timed
from safe_ompl.apps.cli.values import seconds
from safe_ompl.apps.cli.verify import certificate_of
from safe_ompl.common import InputError
from safe_ompl.io import marked, result_to_mapping
from safe_ompl.io import strict_json as json_line
from safe_ompl.planning import COSTS, PlanResult, SafeSetup, setup_scenario
from safe_ompl.planning.planners import make_planner
from safe_ompl.robot import Robot, RobotSpec
from safe_ompl.scene import Scenario
from safe_ompl.trajectories import RateLimits
from safe_ompl.view import draw_plan


def add_command(commands: Any) -> None:
    """Add `plan` to the commands."""
    parser = commands.add_parser(
        "plan", help="plan one path and report on it", description="Plan one path and report on it."
    )
    parser.add_argument("scenario", metavar="SCENARIO", help="name or YAML file, see `safe-ompl scenarios`")
    add_planner_options(parser, usual_time="the scenario's")
    parser.add_argument(
        "--optimise",
        type=seconds,
        metavar="SECONDS",
        help="plan, simplify, start anew and refine for so long; the best path counts",
    )
    parser.add_argument(
        "--cost",
        choices=COSTS,
        default="danger",
        help="what --simplify and --optimise make less: danger and length, or the duration beside people",
    )
    parser.add_argument(
        "--json",
        metavar="FILE",
        help="write the result as JSON, for `safe-ompl view`; - is standard output, without the table",
    )
    parser.add_argument("--plot", metavar="FILE", help="draw the path, its danger and its clearance (.png)")
    parser.add_argument(
        "--certificate", metavar="FILE", help="write the path with its proof, for `safe-ompl verify` (.json)"
    )
    add_timed_options(parser)
    add_limit_options(parser)
    add_robot_options(parser, instead_of="the scenario's")
    parser.set_defaults(prepare=prepare)


def prepare(options: argparse.Namespace) -> Callable[[], int]:
    """Check what the options name, and return the job."""
    begin = perf_counter()
    check_writable(options.json, "--json")
    check_writable(options.certificate, "--certificate")
    check_picture(options.plot, "--plot")
    _check_distinct(options)
    scenario = with_limits(load_scenario(options.scenario), options)
    spec = given_robot(options, lambda: scenario.robot)
    robot = scenario.build_robot() if spec is scenario.robot else spec.build()
    setup = setup_scenario(scenario, robot)
    check_named_planner(scenario, options.planner, setup)
    parameters = {**scenario.planners.get(options.planner, {}), **given_parameters(options)}
    make_planner(options.planner, setup.getSpaceInformation(), parameters)
    limits = rate_limits(scenario, robot, options)
    return Plan(scenario, spec, setup, parameters, options, perf_counter() - begin, limits)


def _check_distinct(options: argparse.Namespace) -> None:
    """Raise an error if two results are to be written to one file."""
    written: dict[Path, str] = {}
    for key in ("json", "certificate", "plot", "trajectory", "timed_plot"):
        file, option = getattr(options, key), f"--{key.replace('_', '-')}"
        if file is None or file == STANDARD_OUTPUT:
            continue
        place = Path(file).resolve()
        if place in written:
            raise InputError(f"{file!r} is written by {written[place]} already: give another file", option)
        written[place] = option


@dataclass(frozen=True)
class Plan:
    """The job of `safe-ompl plan`."""

    scenario: Scenario
    robot: RobotSpec
    setup: SafeSetup
    parameters: dict[str, Any]
    options: argparse.Namespace
    setup_time: float = 0.0
    rate_limits: RateLimits | None = None

    def __call__(self) -> int:
        """Plan, and show the result in all the ways that are asked for."""
        options = self.options
        result = self.setup.plan(
            options.planner,
            time=options.time or self.scenario.time,
            seed=options.seed,
            parameters=self.parameters,
            simplify=options.simplify,
            optimise=options.optimise,
            cost=options.cost,
        )
        result = replace(result, setup_time=self.setup_time + result.setup_time)
        if result.interrupted:
            error_console().print("safe-ompl: interrupted: the best path so far stands")
        if options.json:
            with opened(options.json) as stream:
                print(json_line(self._saved(result)), file=stream)
        if options.json != STANDARD_OUTPUT:
            output_console().print(plan_table(self.scenario.name, self.setup.robot.name, result))
        trajectory = None
        if self.rate_limits is not None and result.path is not None:
            trajectory = timed(result, self.scenario, self.rate_limits)
        if options.certificate and result.path is None:
            error_console().print(f"safe-ompl: there is no path: nothing is written to {options.certificate}")
        elif options.certificate:
            proof = certificate_of(result, self.setup, self.scenario, options.certificate, trajectory)
            with opened(options.certificate) as stream:
                print(json_line(proof), file=stream)
        if options.plot and result.path is not None:
            draw_plan(self.setup, result, options.plot)
        if trajectory is not None:
            show_timed(trajectory, result, self.scenario, options)
        return 0 if result else 1

    def _saved(self, result: PlanResult) -> dict[str, Any]:
        """Return the result in the form of `safe_ompl.save`, with the name of the scenario."""
        names = {"scenario": self.scenario.name, "robot": self.setup.robot.name}
        return {**marked("result", names), **result_to_mapping(result)}


def record(scenario: str, robot: Robot, result: PlanResult) -> dict[str, Any]:
    """Return a result in the form of the command line's JSON."""
    return {"scenario": scenario, "robot": robot.name, **result.as_dict()}
