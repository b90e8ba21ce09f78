"""`safe-ompl plan` and `verify` of a scenario with a program: one motion through all of its steps, proven as one."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from safe_ompl.apps.cli import arguments, output
from safe_ompl.certificates import Verified, program_certificate, terms_of, verify_program
from safe_ompl.common import InputError, documents as document, files
from safe_ompl.io import motion_content
from safe_ompl.planning import ProgramResult, plan_program, program_robot
from safe_ompl.scene import Scenario

_NOT_FOR_PROGRAMS = ("param", "simplify", "optimise", "plot", "timed", "rate", "timed_plot")


def prepare_plan(options: argparse.Namespace, scenario: Scenario) -> Callable[[], int]:
    """Check what the options name, and return the job."""
    why = "is for a path to a goal; the scenario has a program, whose motion is in time and proven anyway"
    arguments.refuse(options, _NOT_FOR_PROGRAMS, why)
    if options.planner != arguments.PLANNER:
        raise InputError(why, "--planner")
    program_robot(scenario)
    return partial(_plan, options, scenario)


def _plan(options: argparse.Namespace, scenario: Scenario) -> int:
    given = {} if options.time is None else {"time": options.time}
    result = plan_program(scenario, seed=options.seed, **given)
    if options.json:
        output.write_json(options.json, _record(result))
    if options.json != output.STANDARD_OUTPUT:
        output.say(f"{scenario.name}\n{result}")
    if not result:
        return 1
    if options.trajectory:
        content, _ = motion_content(result.motion, options.trajectory)
        files.write(options.trajectory, content)
    if options.certificate:
        assert scenario.file is not None
        source = {"scenario": document.file_name(scenario.file.resolve(), Path(options.certificate).parent)}
        stretches = ((stretch.begin, stretch.check) for stretch in result.stretches)
        steps = _record(result)["steps"]
        names = [steps[stretch.step] for stretch in result.stretches]
        output.write_json(options.certificate, program_certificate(stretches, source, names))
    return 0


def _record(result: ProgramResult) -> dict[str, Any]:
    """Return a result as plain data: what was planned, step by step."""
    stretches = [
        {"step": s.step, "begin": s.begin, "duration": s.motion.duration, "claims": s.check.claims}
        for s in result.stretches
    ]
    steps = [] if result.scenario.program is None else [str(step) for step in result.scenario.program.steps]
    said = {"scenario": result.scenario.name, "solved": bool(result), "why": result.why, "duration": result.duration}
    said |= {"planning_time": result.planning_time, "choices": result.choices, "steps": steps}
    return {**said, "stretches": stretches}


def verified(content: Mapping[str, Any], scenario: Scenario | None, options: argparse.Namespace) -> Verified:
    """Return what holds of the certificate of a program, for a scenario or for what the file carries."""
    if scenario is None:
        return verify_program(content, package_dirs=tuple(options.package_dir), time=options.time)
    robot = program_robot(scenario)
    return verify_program(content, robot, scenario.scene, terms=terms_of(scenario, robot), time=options.time)
