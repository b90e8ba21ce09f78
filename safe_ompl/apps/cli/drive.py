"""`safe-ompl drive`: plan from where a robot stands, prove, drive, and prove again with the errors that it made."""

from __future__ import annotations

import argparse
import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from safe_ompl.apps.cli import arguments, output
from safe_ompl.apps.cli.arguments import option
from safe_ompl.apps.cli.check import show_tubes, without_ends
from safe_ompl.apps.cli.plan import describe_timing, timed
from safe_ompl.apps.exchange import DRY, DriveLog, Driver, open_driver
from safe_ompl.common import FloatArray, files
from safe_ompl.motions import FACTOR, Motion, measured_tube, tube_of
from safe_ompl.people.replanning import Command
from safe_ompl.people.simulation import Simulation
from safe_ompl.planning import setup_scenario
from safe_ompl.robot import Robot
from safe_ompl.scene import Scenario
from safe_ompl.trajectories import RateLimits

_REHEARSED = 3.0  # [s]
LOG = "drive.npz"  # of `live`, in its folder


def add_commands(commands: Any) -> None:
    """Add `drive` to the commands."""
    parser = arguments.add_parser(
        commands,
        "drive",
        prepare,
        "drive a robot to the goal of a scenario, and measure its tube",
        "Plan from where the robot stands to the goal, within the limits of the scenario and of the robot's maker, "
        "prove it, and drive. Then measure how far the joints were from where they should have been, and prove the "
        "motion again for every robot that is so near. The exit status is 0 if that is proven.",
    )
    arguments.add_scenario(parser)
    add_robot(parser, required=True)
    option(
        parser,
        "--log FILE",
        "write what was commanded and measured, for `safe-ompl tube` (.csv, .npz)",
        output.output_file(".csv", ".npz"),
    )
    arguments.add_planner_options(parser, usual_time="the scenario's")


def add_robot(parser: argparse.ArgumentParser, *, required: bool = False) -> None:
    """Add the robot."""
    words = f"franka://HOST or ur://HOST; the host {DRY}: no robot, but its rate and limits"
    option(parser, "--robot ROBOT", words, required=required)


def robot_driver(options: argparse.Namespace, scenario: Scenario, robot: Robot) -> tuple[Driver, Scenario]:
    """Return the driver of the robot that the options name, and the scenario from where it stands."""
    kind, _, host = options.robot.partition("://")
    if kind in output.EXTRAS and host != DRY:
        output.need_extra(kind, "--robot")
    driver = open_driver(options.robot, scenario.start_configuration(robot))
    return driver, replace(scenario, start=tuple(driver.start.tolist()))


def prepare(options: argparse.Namespace) -> Callable[[], int]:
    """Check what the options name, look where the robot stands, and return the job."""
    scenario = arguments.load_scenario(options.scenario, options.package_dir, goal=True)
    robot = scenario.build_robot()
    driver, scenario = robot_driver(options, scenario, robot)
    return partial(_drive, scenario, robot, driver, options)


def _drive(scenario: Scenario, robot: Robot, driver: Driver, options: argparse.Namespace) -> int:
    """Plan, drive, and prove the motion again."""
    setup = setup_scenario(scenario, robot)
    result = setup.plan(options.planner, **arguments.run_options(options, scenario, options.planner))
    if result.path is None:
        output.error_console().print(f"safe-ompl: {options.planner} found no path: {result.status}")
        return 1
    scenario = scenario_within(driver, scenario, robot, result.path)
    limits = RateLimits.of(robot, scenario.motion.velocity, scenario.motion.acceleration, scenario.motion.jerk)
    trajectory = timed(result, scenario, limits)
    output.console().print(describe_timing(trajectory))
    cycles = np.arange(np.ceil(trajectory.duration * driver.rates.rate) + 1) / driver.rates.rate
    why = driver.follow(0.0, trajectory.at(cycles).q)
    if why:
        output.error_console().print(f"safe-ompl: {options.robot} is not driven: {why}")
        return 1
    try:
        driver.wait(float(cycles[-1]))
    except KeyboardInterrupt:
        driver.halt(lambda times: trajectory.at(times).q)
        raise
    finally:
        log = driver.close()
        write_log(log, robot, options.log)
    tube = tube_of(measured(log, robot), robot)
    motion, checked = Motion.of(trajectory), without_ends(scenario, robot, tube)
    # Stops with a limit of the jerk are proven of the trajectory alone.
    found = checked.check(motion, limits, scenario.people if limits.jerk is None else None)
    nearer = 1e3 * found.separation.swing(found.proof.checker)
    lost = round(log.times[-1] * driver.rates.rate) + 1 - len(log.times)
    output.say(f"{len(log.times)} cycles, {lost} lost; in that tube the robot is within {nearer:.1f} mm of its motion")
    output.say(str(found))
    return 0 if found else 1


def scenario_within(driver: Driver, scenario: Scenario, robot: Robot, way: FloatArray) -> Scenario:
    """Return the scenario with limits that keep to those of the robot's maker along a way, too."""
    own, published = scenario.motion, driver.rates
    said = own.acceleration is not None or robot.accelerations or np.isinf(published.acceleration).any()
    accelerations = own.acceleration if said else published.acceleration
    limits = published.within(RateLimits.of(robot, own.velocity, accelerations, own.jerk), way)
    kept: dict[str, Any] = {**limits.as_dict()}
    return replace(scenario, motion=replace(own, **kept))


def rehearse(simulation: Simulation) -> None:
    """Simulate for a while: that compiles, or loads, all that a tick calls."""
    simulation.follow = lambda command: "" if len(rows(command, 1e3)) else "nothing"
    simulation.run(_REHEARSED)


@contextmanager
def driven(simulation: Simulation, driver: Driver, log: Path) -> Iterator[tuple[Simulation, Callable[[], FloatArray]]]:
    """Let a robot follow the commands of a simulation, on its own clock; give that, and what waits for a tick's end."""
    tick, ticks = simulation.replanner.tick, count(1)
    simulation.follow = lambda command: driver.follow(command.time, rows(command, driver.rates.rate))
    gc.collect()
    gc.freeze()  # looking through all that is there already would take a tick
    try:
        yield simulation, lambda: driver.wait(next(ticks) * tick)
    finally:
        gc.unfreeze()
        found = driver.close()
        write_log(found, simulation.replanner.robot, str(log))
        measured(found, simulation.replanner.robot)


def rows(command: Command, rate: float) -> FloatArray:
    """Return where the joints (K, n) are to be at each cycle of a command, at a rate [Hz]."""
    cycles = np.arange(np.ceil(command.time * rate - 1e-6), np.ceil(command.standstill * rate) + 1)
    return command.positions(cycles / rate)


def write_log(log: DriveLog, robot: Robot, file: str | None) -> None:
    """Write what a robot did to a file, if there is one."""
    if file is None:
        return
    columns = {"time": log.times}
    for kind, rows in (("commanded", log.commanded), ("measured", log.measured)):
        columns |= {f"{name}_{kind}": rows[:, k] for k, name in enumerate(robot.joint_names)}
    if Path(file).suffix == ".npz":
        np.savez(file, **columns)  # type: ignore[arg-type]  # names of columns are no options
    else:
        files.write(file, files.table(list(columns), np.column_stack(list(columns.values())).tolist()))


def measured(log: DriveLog, robot: Robot) -> dict[str, float]:
    """Say how wide the tube of a robot was, and return that by joint."""
    told, found = (Motion.hermite(log.times, rows, names=robot.joint_names) for rows in (log.commanded, log.measured))
    return show_tubes({"log": measured_tube(told, found, FACTOR, robot.continuous)}, FACTOR)
