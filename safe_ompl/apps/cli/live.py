"""`safe-ompl live`: a robot beside people and things that move, in simulated time."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from safe_ompl.apps.cli.live_actors import CLIP, Actors, choose_actors, clearance_of_movers, limits_of_still
from safe_ompl.apps.cli.options import (
    add_package_dirs,
    add_parser,
    add_run_options,
    add_scenario,
    count,
    finite,
    limit,
    load_scenario,
    noise,
    run_options,
    seconds,
    share,
)
from safe_ompl.apps.cli.output import error_console, make_folder, output_console, progress_bar, write_json
from safe_ompl.apps.cli.view import check_page
from safe_ompl.common import FloatArray
from safe_ompl.geometry import Pose
from safe_ompl.io import ticks_header, write_ticks
from safe_ompl.people.replanning import Replanner, ReplanningOptions
from safe_ompl.people.simulation import Faults, Simulation, Summary
from safe_ompl.planning import SafeSetup, setup_scenario
from safe_ompl.scene import People, Scenario
from safe_ompl.trajectories import RateLimits, Trajectory, time_path
from safe_ompl.view import read_recording, save_page

_PLANNER = "SafeRRTConnect"


def add_command(commands: Any) -> None:
    """Add `live` to the commands."""
    parser = add_parser(
        commands,
        "live",
        prepare,
        "drive a robot beside people and things that move, in simulated time",
        "Plan from start to goal and back, and drive there again and again beside a recorded person, or "
        "beside people and things that move at random. Every motion is proven at every tick, including its stop. A "
        "monitor looks for contacts.",
    )
    add_scenario(parser)
    parser.add_argument(
        "--people",
        metavar="FILE|random[:N]",
        help="a file of recorded key points (.npz), or the number of people who walk at random",
    )
    parser.add_argument("--clip", metavar="NAME", help=f"name of the recording in the file; default: {CLIP}")
    parser.add_argument(
        "--place",
        type=_place,
        metavar="X,Y,Z,YAW",
        help="where the origin of the recording, or the first person who walks, is in the world [m, rad]; default: "
        "where the first person of the scenario stands",
    )
    parser.add_argument(
        "--movers",
        type=count,
        default=0,
        metavar="N",
        help="number of balls of 0.1 m that fly around the robot",
    )
    parser.add_argument(
        "--mover-speed",
        type=limit,
        default=0.5,
        metavar="V",
        help="largest speed of these balls [m/s]; default: %(default)g",
    )
    parser.add_argument(
        "--seconds", type=seconds, default=60.0, metavar="S", help="simulated time; default: %(default)g"
    )
    parser.add_argument("--out", metavar="DIR", required=True, help="folder for ticks.jsonl and summary.json")
    parser.add_argument(
        "--html",
        metavar="FILE",
        help="also write a page that plays the simulation in any browser, offline (.html)",
    )
    parser.add_argument(
        "--tick", type=seconds, default=0.05, metavar="S", help="time between commands; default: %(default)g"
    )
    add_run_options(parser, usual_time="the scenario's")
    add_package_dirs(parser)
    group = parser.add_argument_group("faults")
    group.add_argument(
        "--noise",
        type=noise,
        default=0.0,
        metavar="M",
        help="largest error of key points, which the tracker knows [m]",
    )
    group.add_argument(
        "--drops", type=share, default=0.0, metavar="SHARE", help="share of the frames that are lost"
    )
    group.add_argument(
        "--late", type=share, default=0.0, metavar="SHARE", help="share of the ticks without an answer"
    )
    group.add_argument(
        "--faster",
        type=limit,
        default=1.0,
        metavar="FACTOR",
        help="factor of the speeds that are recorded, or that the robot relies on",
    )


def prepare(options: argparse.Namespace) -> Callable[[], int]:
    """Check what the options name, and return the job."""
    scenario = load_scenario(options.scenario, options.package_dir)
    latency = min(Faults.latency, options.tick)
    faults = Faults(options.noise, options.drops, options.late, options.seed, latency)
    robot = scenario.build_robot()
    people = replace(scenario.people or People(), who=None, clearance=clearance_of_movers(scenario))
    found = choose_actors(scenario, robot, people, options)
    setup = setup_scenario(limits_of_still(scenario, found), robot)
    make_folder(Path(options.out), "--out")
    check_page(options.html)
    replanner = Replanner(
        robot,
        found.scene,
        found.trackers,
        found.speeds,
        people=people,
        options=ReplanningOptions(tick=options.tick),
        motion=setup.certified_motion,
    )
    return Live(scenario, setup, replanner, found, faults, options)


@dataclass(frozen=True)
class Live:
    """The job of `safe-ompl live`."""

    scenario: Scenario
    setup: SafeSetup
    replanner: Replanner
    actors: Actors
    faults: Faults
    options: argparse.Namespace

    def __call__(self) -> int:
        """Plan, simulate, and write ticks and summary."""
        options, folder = self.options, Path(self.options.out)
        ways = self._trajectories()
        if ways is None:
            return 1
        actors = self.actors
        simulation = Simulation(self.replanner, ways, actors.people, actors.objects, faults=self.faults)
        ticks = _with_progress(simulation, options.seconds, options.tick)
        write_ticks(folder / "ticks.jsonl", self._header(simulation), ticks)
        summary = simulation.summary
        write_json(str(folder / "summary.json"), summary.as_dict())
        output_console().print(describe(summary))
        error_console().print(f"ticks and summary in {folder}")
        if options.html is None:
            error_console().print(f"see it: safe-ompl view {folder / 'ticks.jsonl'}")
        else:
            save_page(read_recording(folder / "ticks.jsonl", self.setup.robot), options.html)
            error_console().print(f"view in {options.html}")
        return 0

    def _header(self, simulation: Simulation) -> dict[str, Any]:
        replanner = self.replanner
        scene, moving = replanner.surroundings.scene, simulation.world.description()
        return ticks_header(replanner.tick, replanner.robot, scene, moving)

    def _trajectories(self) -> list[Trajectory] | None:
        scenario = self.scenario
        result = self.setup.plan(_PLANNER, **run_options(self.options, scenario, _PLANNER))
        if result.path is None:
            error_console().print(f"safe-ompl: {_PLANNER} found no path: {result.status}")
            return None
        return there_and_back(result.path, self.replanner, scenario)


def there_and_back(path: FloatArray, replanner: Replanner, scenario: Scenario) -> list[Trajectory]:
    """Return the trajectories along a path and back, under the scenario's limits."""
    limits = RateLimits.of(replanner.robot, scenario.motion.velocity, scenario.motion.acceleration)
    return [
        time_path(
            way,
            replanner.robot,
            limits,
            motion=replanner.motion,
            tool_speed=scenario.motion.tool_speed,
            link_speed=scenario.motion.link_speed,
        )
        for way in (path, path[::-1])
    ]


def describe(summary: Summary) -> str:
    """Return the summary of a simulation in one line."""
    median, late = (1e3 * t for t in summary.reaction)
    return (
        f"{summary.seconds:g} s: {summary.tasks} tasks, {summary.stops} stops; contacts while moving "
        f"{summary.contacts_while_moving}, after violations {summary.contacts_after_violations}, at rest "
        f"{summary.contacts_at_rest}; model obeyed {100 * summary.model_obeyed:.1f} % of the time; reaction "
        f"{median:.1f} ms (99 %: {late:.1f}); deadlines missed {summary.deadlines_missed}"
    )


def _with_progress(simulation: Simulation, seconds: float, tick: float) -> Iterator[dict[str, Any]]:
    with progress_bar(error_console()) as bar:
        task = bar.add_task("live", total=round(seconds / tick))
        for line in simulation.ticks(seconds):
            yield line
            bar.advance(task)


def _place(text: str) -> Pose:
    parts = text.split(",")
    try:
        x, y, z, yaw = (finite(part) for part in parts)
    except (ValueError, argparse.ArgumentTypeError):
        raise argparse.ArgumentTypeError(f"must be four finite numbers X,Y,Z,YAW, not {text!r}") from None
    return Pose((x, y, z), (0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2))))
