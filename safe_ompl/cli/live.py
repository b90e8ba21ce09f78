"""`safe-ompl live`: a robot beside a recorded person who moves, in simulated time."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.arrays import FloatArray
from safe_ompl.cli.arguments import add_run_options, load_scenario, seconds
from safe_ompl.cli.console import error_console, output_console, progress_bar
from safe_ompl.cli.files import json_line, make_folder
from safe_ompl.errors import InputError
from safe_ompl.live.movers import Playback
from safe_ompl.live.replanner import Replanner
from safe_ompl.live.simulation import Faults, Simulation, Summary
from safe_ompl.live.ticks import write_ticks
from safe_ompl.people.body import PELVIS, TrackedBody, facing
from safe_ompl.people.recordings import Recording
from safe_ompl.people.tracking import Tracker
from safe_ompl.scenario.people import People
from safe_ompl.scenario.scenario import Scenario
from safe_ompl.scene.pose import Pose
from safe_ompl.scene.shapes.person import Person
from safe_ompl.setup.safe_setup import setup_scenario
from safe_ompl.trajectories.limits import RateLimits
from safe_ompl.trajectories.timing import time_path
from safe_ompl.trajectories.trajectory import Trajectory

_PLANNER = "SafeRRTConnect"
_SOMEBODY = "person"


def add_command(commands: Any) -> None:
    """Add `live` to the commands."""
    parser = commands.add_parser(
        "live",
        help="drive a robot beside a recorded person who moves, in simulated time",
        description="Plan from start to goal and back, and drive there again and again beside a recorded person. What "
        "is driven is proven at every tick, including its stop. A judge looks for contacts.",
    )
    parser.add_argument("scenario", metavar="SCENARIO", help="name or YAML file, see `safe-ompl scenarios`")
    parser.add_argument("--people", metavar="FILE", required=True, help="recordings of key points (.npz)")
    parser.add_argument(
        "--clip", metavar="NAME", default="clip_0", help="which one of them; default: %(default)s"
    )
    parser.add_argument(
        "--place",
        type=_place,
        metavar="X,Y,Z,YAW",
        help="where the recording's origin is in the world [m, rad]; default: she stands where the scenario's first "
        "person does",
    )
    parser.add_argument(
        "--seconds", type=seconds, default=60.0, metavar="S", help="how long; default: %(default)g"
    )
    parser.add_argument("--out", metavar="DIR", required=True, help="where ticks.jsonl and summary.json go")
    parser.add_argument(
        "--tick", type=seconds, default=0.05, metavar="S", help="between commands; default: %(default)g"
    )
    add_run_options(parser, usual_time="the scenario's")
    group = parser.add_argument_group("faults")
    group.add_argument(
        "--noise", type=float, default=0.0, metavar="M", help="errors of key points [m], promised"
    )
    group.add_argument(
        "--drops", type=float, default=0.0, metavar="SHARE", help="of the frames that are lost"
    )
    group.add_argument(
        "--late", type=float, default=0.0, metavar="SHARE", help="of the ticks without an answer"
    )
    group.add_argument(
        "--faster",
        type=seconds,
        default=1.0,
        metavar="FACTOR",
        help="how many times as fast as recorded she moves",
    )
    parser.set_defaults(prepare=prepare)


def prepare(options: argparse.Namespace) -> Callable[[], int]:
    """Check what the options name, and return the job."""
    scenario = load_scenario(options.scenario)
    recording = Recording.load(options.people, options.clip)
    faults = Faults(options.noise, options.drops, options.late, options.seed)
    robot = scenario.build_robot()
    folder = Path(options.out)
    make_folder(folder, "--out")
    name, tracker = _tracked(scenario, recording, options)
    people = replace(scenario.people or People(), who=None)
    replanner = Replanner(robot, scenario.scene, {name: tracker}, people=people, tick=options.tick)
    return Live(scenario, replanner, name, Playback(recording, tracker, options.faster), faults, options)


@dataclass(frozen=True)
class Live:
    """The job of `safe-ompl live`."""

    scenario: Scenario
    replanner: Replanner
    name: str
    mover: Playback
    faults: Faults
    options: argparse.Namespace

    def __call__(self) -> int:
        """Plan, simulate, and write what happened."""
        options, folder = self.options, Path(self.options.out)
        ways = self._trajectories()
        if ways is None:
            return 1
        simulation = Simulation(self.replanner, ways, {self.name: self.mover}, faults=self.faults)
        write_ticks(folder / "ticks.jsonl", _with_progress(simulation, options.seconds, options.tick))
        summary = simulation.summary
        (folder / "summary.json").write_text(json_line(summary.as_dict()) + "\n", encoding="utf-8")
        output_console().print(told(summary))
        error_console().print(f"ticks and summary in {folder}")
        return 0

    def _trajectories(self) -> list[Trajectory] | None:
        scenario, robot = self.scenario, self.replanner.robot
        setup = setup_scenario(replace(scenario, scene=self.replanner.still, people=None), robot)
        result = setup.plan(
            _PLANNER,
            time=self.options.time or scenario.time,
            seed=self.options.seed,
            parameters=scenario.planners.get(_PLANNER, {}),
            simplify=self.options.simplify,
        )
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


def told(summary: Summary) -> str:
    """Return what came of a simulation in a few words."""
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


def _tracked(scenario: Scenario, recording: Recording, options: argparse.Namespace) -> tuple[str, Tracker]:
    """Return who plays the recording, and how she is tracked."""
    persons = [obstacle for obstacle in scenario.scene if isinstance(obstacle.shape, Person)]
    shape = persons[0].shape if persons else Person()
    assert isinstance(shape, Person)
    body = TrackedBody(shape.height)
    if options.place is not None:
        place = options.place
    elif persons:
        place = _instead_of(persons[0].pose, recording, body)
    else:
        raise InputError("the scenario has no person whose place she could take: say where", "--place")
    return (persons[0].name if persons else _SOMEBODY), Tracker(
        recording.skeleton, body, place, options.noise
    )


def _instead_of(pose: Pose, recording: Recording, body: TrackedBody) -> Pose:
    """Return where a recording must be so that she stands in the first frame where a person does, and as she faces."""
    points, _ = body.completed(recording.skeleton.keypoints(recording.frames[0]))
    turn = pose.se3.rotation @ facing(points).T
    hips = pose.se3.act(body.height * PELVIS)
    return Pose.of(pin.SE3(turn, hips - turn @ body.pelvis(points)))


def _place(text: str) -> Pose:
    parts = text.split(",")
    try:
        x, y, z, yaw = (float(part) for part in parts)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} must be four numbers X,Y,Z,YAW") from None
    return Pose((x, y, z), (0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2))))
