"""`safe-ompl verify`: check the certificate of a path again, by other means than it was made."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from safe_ompl import document
from safe_ompl.cli.arguments import load_scenario
from safe_ompl.cli.console import error_console, output_console
from safe_ompl.errors import CertificateError, InputError
from safe_ompl.paths.certificate.certificate import certificate
from safe_ompl.paths.certificate.verify import Verified, check_form, verify
from safe_ompl.robot.robot import Robot
from safe_ompl.robot.spec import RobotSpec
from safe_ompl.scenario.scenario import Scenario
from safe_ompl.setup.problem import danger_field
from safe_ompl.setup.safe_setup import PlanResult, SafeSetup

REFUSED = 1


def add_command(commands: Any) -> None:
    """Add `verify` to the commands."""
    parser = commands.add_parser(
        "verify",
        help="check the certificate of a path",
        description="Check a certificate that `plan --certificate` wrote: that intervals cover every edge of the "
        "path, and, pair by pair, that in each of them nothing can touch. The exit status is 0 if it holds.",
    )
    parser.add_argument("file", metavar="FILE", help="the certificate")
    parser.add_argument(
        "scenario", metavar="SCENARIO", nargs="?", help="robot and scene; default: what the file names"
    )
    parser.set_defaults(prepare=prepare)


def prepare(options: argparse.Namespace) -> Callable[[], int]:
    """Read the certificate and what it is about, and return the job."""
    content = _read_certificate(options.file)
    folder, source = Path(options.file).parent, content["source"]
    with document.within(options.file, ": "):
        named = document.text("scenario", document.require(document.mapping("source", source), "scenario"))
        spec = source.get("robot") and RobotSpec.from_mapping(source["robot"], folder)
    beside = folder / named
    scenario = load_scenario(options.scenario or (str(beside) if beside.is_file() else named))
    robot = scenario.build_robot() if spec is None else spec.build()
    return Verify(options.file, content, robot, scenario)


@dataclass(frozen=True)
class Verify:
    """The job of `safe-ompl verify`."""

    file: str
    content: Mapping[str, Any]
    robot: Robot
    scenario: Scenario

    def __call__(self) -> int:
        """Check, and say in one line what holds or what does not."""
        scene, danger = self.scenario.scene, self.scenario.danger
        claimed = self.content["danger"] is not None and any(obstacle.weight > 0 for obstacle in scene)
        field = danger_field(self.robot, scene, danger) if claimed else None
        try:
            found = verify(self.content, self.robot, scene, field=field, spacing=danger.get("spacing"))
        except CertificateError as error:
            error_console().print(f"safe-ompl: {self.file}: {error}")
            return REFUSED
        line = f"{self.file}: {_claims(self.content, found)}"
        output_console().print(line, markup=False, soft_wrap=True)
        return 0


def _claims(content: Mapping[str, Any], found: Verified) -> str:
    danger, clearance = content["danger"], content["clearance"]
    said = [
        f"every motion is free: {found.edges} edges, {found.intervals} intervals, {found.distances} distances"
    ]
    if danger is not None:
        points = f"points {danger['spacing']:g} m apart"
        kind = f"{danger['aggregate']}, {danger['weighting']}, k1 {danger['k1']:g}, {points}"
        said.append(f"danger at most {danger['bound']:.3f} ({kind})")
    if clearance is not None:
        exempt = ", ".join(f"{link} from {obstacle}" for link, obstacle in clearance["exempt"])
        said.append(
            f"at least {1e3 * clearance['distance']:.1f} mm from {', '.join(clearance['obstacles'])}"
            + (f", except {exempt}" if exempt else "")
        )
    return "; ".join(said)


def _read_certificate(file: str) -> Mapping[str, Any]:
    try:
        content = json.loads(Path(file).read_text(encoding="utf-8"))
    except (OSError, RecursionError, ValueError) as error:
        raise InputError(f"cannot be read as a certificate: {error}", file) from None
    with document.within(file, ": "):
        check_form(content)
    checked: Mapping[str, Any] = content
    return checked


def certificate_of(
    result: PlanResult, setup: SafeSetup, scenario: Scenario, spec: RobotSpec, file: str
) -> dict[str, Any]:
    """Return the certificate of a solved plan, for `file`: files that it names are relative to that."""
    assert result.path is not None
    folder, wanted = Path(file).parent, setup.getMinClearance()
    assert scenario.file is not None
    return certificate(
        result.path,
        setup.robot,
        setup.scene,
        field=setup.field,
        spacing=scenario.danger.get("spacing"),
        max_danger=scenario.limits.max_danger or None,
        clearance=None if wanted is None else wanted.as_dict(),
        source={
            "scenario": document.file_name(scenario.file.resolve(), folder),
            "robot": None if spec is scenario.robot else spec.to_mapping(folder),
        },
    )
