"""Command `verify`: check a certificate with methods that differ from those that made it."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

# `plan` and `check` import this module, and need these packages only if they write a certificate. The packages load
# their modules on first attribute access.
import safe_ompl.certificates as certificates
import safe_ompl.io as io
import safe_ompl.motions as motions
import safe_ompl.tasks as tasks
from safe_ompl.apps.cli import arguments, output
from safe_ompl.apps.cli.arguments import option
from safe_ompl.collision import TipBounds, ToolOrientation
from safe_ompl.common import CertificateError, InputError, documents as document, files
from safe_ompl.planning import PlanResult, SafeSetup
from safe_ompl.robot import robot_hash
from safe_ompl.scene import Scenario

REFUSED = 1
_MOST_BYTES = 1_000_000_000  # of a certificate


def add_commands(commands: Any) -> None:
    """Add `verify` to the commands."""
    parser = arguments.add_parser(
        commands,
        "verify",
        prepare,
        "check the certificate of a path",
        "Check a certificate that `plan --certificate` wrote: no pair of bodies collides on the whole "
        "motion, and its other claims hold. If a scenario is given, everything else is taken from "
        "it: robot, scene, people, options of the danger and limits of the motion; the file must agree. "
        "Else robot and scene are those recorded in the file, and the output says so. "
        "The exit status is 0 if all claims hold.",
    )
    option(parser, "file FILE", "the certificate")
    option(
        parser,
        "scenario SCENARIO",
        "scenario of the certificate; default: robot and scene recorded in the file",
        nargs="?",
    )
    option(
        parser,
        "--time SECONDS",
        "time limit; what is not verified by then counts as undecided",
        arguments.seconds,
        certificates.TIME,
    )


def prepare(options: argparse.Namespace) -> Callable[[], int]:
    """Read the certificate and the scenario, and return a function that verifies the certificate."""
    content = _read_certificate(options.file)
    if options.scenario is None:
        carried = partial(certificates.verify, content, package_dirs=tuple(options.package_dir), time=options.time)
        return partial(_verify, options.file, carried, " and scene are the file's own, compared with no scenario")
    scenario = arguments.load_scenario(options.scenario, options.package_dir)

    def against_scenario() -> certificates.Verified:
        claims, robot = certificates.Certificate.read(content), scenario.build_robot()
        if scenario.program is not None and claims.robot.hash != robot_hash(robot):
            robot = tasks.program_robot(scenario)
        terms = certificates.terms_of(scenario, robot, timed=claims.rated)
        return certificates.verify(content, robot, scenario.scene, terms=terms, time=options.time)

    return partial(_verify, options.file, against_scenario, f" and scene of {scenario.file}")


def _verify(file: str, check: Callable[[], certificates.Verified], source: str) -> int:
    """Check a certificate. Print the verified claims and the claims that are missing, or the failure."""
    try:
        with document.within(file, ": "):
            found = check()
    except CertificateError as error:
        output.error_console().print(f"safe-ompl: {file}: {error}")
        return REFUSED
    free, *others = found.claims
    work = f"{found.edges} edges, {found.intervals} intervals, {found.distances} distances"
    lines = [
        "; ".join([f"{free}: {work}", *others]),
        f"robot {found.robot}{source}: {', '.join(found.obstacles) or 'no obstacle'}",
    ]
    if found.not_claimed:
        lines.append(f"not claimed: {', '.join(found.not_claimed)}")
    if found.not_covered:
        lines.append(f"not covered: {'; '.join(found.not_covered)}")
    for line in lines:
        output.say(f"{file}: {line}")
    return 0


def _read_certificate(file: str) -> Mapping[str, Any]:
    try:
        if Path(file).stat().st_size > _MOST_BYTES:
            raise InputError(f"has more than {_MOST_BYTES} bytes", file)
        written = Path(file).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read as a certificate: {error}", file) from None
    with document.within(file, ": "):
        content = files.parse_json(written, finite=True)
        io.schema.check_form(content)
    checked: Mapping[str, Any] = content
    return checked


def certificate_of(
    result: PlanResult, setup: SafeSetup, scenario: Scenario, file: str, trajectory: motions.Trajectory | None = None
) -> dict[str, Any]:
    """Return the certificate of a solved plan and its trajectory. File names in it are relative to `file`."""
    assert result.path is not None
    constraints = setup.getConstraints()
    separation = constraints.separation
    tool = {"orientation": constraints.tool_limit(ToolOrientation), "position": constraints.tool_limit(TipBounds)}
    claims = {
        "clearance": certificates.clearance_claim(separation.min_clearance, setup.scene),
        "moving_obstacles": {"speeds": separation.speeds, "time": separation.time} if separation.speeds else None,
        "tool": {name: limit.as_dict() for name, limit in tool.items() if limit is not None} or None,
        "tube": separation.tube or None,
        "spacing": scenario.danger.get("spacing"),
        "max_danger": scenario.limits.max_danger or None,
    }
    return certificates.certificate(
        result.path,
        setup.robot,
        setup.scene,
        claims,
        field=setup.field,
        trajectory=trajectory,
        source=source_of(scenario, file),
    )


def source_of(scenario: Scenario, file: str) -> dict[str, str]:
    """Return the key `scenario` of a certificate: the path of the scenario relative to the certificate's folder."""
    assert scenario.file is not None
    return {"scenario": document.file_name(scenario.file.resolve(), Path(file).parent)}
