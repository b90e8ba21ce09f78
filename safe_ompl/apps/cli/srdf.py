"""`safe-ompl srdf`: write the SRDF that a URDF lacks."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from safe_ompl.apps.cli.arguments import add_collision_option, add_package_dirs
from safe_ompl.apps.cli.console import error_console
from safe_ompl.apps.cli.files import STANDARD_OUTPUT, check_writable, opened
from safe_ompl.apps.cli.values import count
from safe_ompl.robot.loading import UrdfFile, disabled_links, srdf_text


def add_command(commands: Any) -> None:
    """Add `srdf` to the commands."""
    parser = commands.add_parser(
        "srdf",
        help="write an SRDF for a URDF",
        description="Write an SRDF that disables the collisions of adjacent links and of links that touch in more "
        "than 95 % of sampled configurations. Links that merely were never seen in contact stay enabled.",
    )
    parser.add_argument("urdf", metavar="URDF", help="the robot's URDF")
    parser.add_argument(
        "-o", "--output", metavar="FILE", default=STANDARD_OUTPUT, help="default: standard output"
    )
    parser.add_argument(
        "--samples", type=count, default=1000, metavar="N", help="configurations (default: %(default)s)"
    )
    add_package_dirs(parser)
    add_collision_option(parser)
    parser.set_defaults(prepare=prepare)


def prepare(options: argparse.Namespace) -> Callable[[], int]:
    """Read the URDF, and return the job."""
    urdf = UrdfFile(options.urdf, options.package_dir)
    check_writable(options.output, "--output")
    return WriteSrdf(urdf, options.output, options.samples, options.collision or "required")


@dataclass(frozen=True)
class WriteSrdf:
    """The job of `safe-ompl srdf`."""

    urdf: UrdfFile
    output: str
    samples: int
    collision: str

    def __call__(self) -> int:
        """Sample, write, and say what was found."""
        pairs = disabled_links(self.urdf, self.samples, self.collision)
        text = srdf_text(self.urdf.build_model().name, pairs, self.samples)
        with opened(self.output) as stream:
            stream.write(text)
        reasons = [pair.reason for pair in pairs]
        error_console().print(
            f"safe-ompl: {self.samples} samples: {reasons.count('Always')} pairs of links always touch, "
            f"{reasons.count('Adjacent')} are adjacent",
            markup=False,
        )
        return 0
