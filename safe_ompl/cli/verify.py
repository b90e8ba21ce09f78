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
from safe_ompl.paths.certificate.format import check_form
from safe_ompl.paths.certificate.issue import certificate
from safe_ompl.paths.certificate.portable import built_robot
from safe_ompl.paths.certificate.verify import Verified, verify
from safe_ompl.robot.robot import Robot
from safe_ompl.robot.spec import RobotSpec
from safe_ompl.scenario.scenario import Scenario
from safe_ompl.setup.problem import danger_field
from safe_ompl.setup.result import PlanResult
from safe_ompl.setup.safe_setup import SafeSetup
from safe_ompl.trajectories.trajectory import Trajectory

REFUSED = 1


def add_command(commands: Any) -> None:
    """Add `verify` to the commands."""
    parser = commands.add_parser(
        "verify",
        help="check the certificate of a path",
        description="Check a certificate that `plan --certificate` wrote: that intervals cover every edge of the "
        "path, and, pair by pair, that in each of them nothing can touch. Robot and scene are those of the scenario "
        "that it names, or, where that is not here, those that it carries. The exit status is 0 if it holds.",
    )
    parser.add_argument("file", metavar="FILE", help="the certificate")
    parser.add_argument(
        "scenario", metavar="SCENARIO", nargs="?", help="robot and scene; default: what the file names"
    )
    parser.add_argument(
        "--carried",
        action="store_true",
        help="take robot and scene that the certificate carries, though the scenario that it names is here",
    )
    parser.add_argument("--urdf", metavar="FILE", help="URDF of a carried robot whose meshes are not found")
    parser.add_argument(
        "--package-dir",
        action="append",
        default=[],
        metavar="DIR",
        help="folder that holds packages which the URDF names (repeatable)",
    )
    parser.set_defaults(prepare=prepare)


def prepare(options: argparse.Namespace) -> Callable[[], int]:
    """Read the certificate and what it is about, and return the job."""
    if options.carried and options.scenario:
        raise InputError(f"either, or the scenario {options.scenario!r}", "--carried")
    content = _read_certificate(options.file)
    with document.within(options.file, ": "):
        scenario, spec = _named(content, Path(options.file).parent, options)
    if options.scenario:
        scenario = load_scenario(options.scenario)
    if scenario is not None:
        if options.urdf or options.package_dir:
            raise InputError(
                "is for robots that a certificate carries: add --carried", "--urdf or --package-dir"
            )
        robot = scenario.build_robot() if spec is None else spec.build()
        return Verify(options.file, content, robot, scenario)
    with document.within(f"{options.file}: robot"):
        urdf = None if options.urdf is None else Path(options.urdf)
        folders = [Path(folder) for folder in options.package_dir]
        robot = built_robot(content["robot"], urdf=urdf, package_dirs=folders)
    return Verify(options.file, content, robot, None)


def _named(
    content: Mapping[str, Any], folder: Path, options: argparse.Namespace
) -> tuple[Scenario | None, RobotSpec | None]:
    """Return the scenario that a certificate names, where it is here, and its robot where that is another one."""
    source = document.mapping("source", content["source"])
    with document.within("source"):
        document.check_keys(source, ("scenario", "robot"))
        name = source.get("scenario")
        file = None if name is None else folder / document.text("scenario", name)
        here = file is not None and file.is_file()
        if options.carried or not (here or options.scenario):
            return None, None
        robot = source.get("robot")
        spec = None if robot is None else RobotSpec.from_mapping(robot, folder)
    return None if options.scenario else load_scenario(str(file)), spec


@dataclass(frozen=True)
class Verify:
    """The job of `safe-ompl verify`; without a scenario robot and scene are those that the certificate carries."""

    file: str
    content: Mapping[str, Any]
    robot: Robot
    scenario: Scenario | None

    def __call__(self) -> int:
        """Check, and say what holds, what is not claimed, or what does not hold."""
        try:
            found = self._verified()
        except CertificateError as error:
            error_console().print(f"safe-ompl: {self.file}: {error}")
            return REFUSED
        for line in self._lines(found):
            output_console().print(f"{self.file}: {line}", markup=False, soft_wrap=True)
        return 0

    def _verified(self) -> Verified:
        if self.scenario is None:
            with document.within(self.file, ": "):
                return verify(self.content, self.robot)
        scene, danger = self.scenario.scene, self.scenario.danger
        claimed = self.content["danger"] is not None and any(obstacle.weight > 0 for obstacle in scene)
        field = danger_field(self.robot, scene, danger) if claimed else None
        return verify(self.content, self.robot, scene, field=field, spacing=danger.get("spacing"))

    def _lines(self, found: Verified) -> list[str]:
        free, *others = found.claims
        work = f"{found.edges} edges, {found.intervals} intervals, {found.distances} distances"
        names = [obstacle["name"] for obstacle in self.content["scene"]["content"]["obstacles"]]
        where = "that it carries" if self.scenario is None else f"of {self.scenario.file}"
        lines = [
            "; ".join([f"{free}: {work}", *others]),
            f"robot {self.robot.name} and scene {where}: {', '.join(names) or 'no obstacle'}",
        ]
        if found.not_claimed:
            lines.append(f"not claimed: {', '.join(found.not_claimed)}")
        if found.not_covered:
            lines.append(f"not covered: {'; '.join(found.not_covered)}")
        return lines


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
    result: PlanResult,
    setup: SafeSetup,
    scenario: Scenario,
    spec: RobotSpec,
    file: str,
    trajectory: Trajectory | None = None,
) -> dict[str, Any]:
    """Return the certificate of a solved plan, and of its trajectory, for `file`: names in it are relative to that."""
    assert result.path is not None
    folder, wanted = Path(file).parent, setup.getMinClearance()
    speeds, time = setup.getMovingObstacles()
    assert scenario.file is not None
    return certificate(
        result.path,
        setup.robot,
        setup.scene,
        field=setup.field,
        spacing=scenario.danger.get("spacing"),
        max_danger=scenario.limits.max_danger or None,
        clearance=None if wanted is None else wanted.as_dict(),
        moving_obstacles={"speeds": speeds, "time": time} if speeds else None,
        tool=setup.tool_claim(),
        trajectory=trajectory,
        source={
            "scenario": document.file_name(scenario.file.resolve(), folder),
            "robot": None if spec is scenario.robot else spec.to_mapping(folder),
        },
    )
