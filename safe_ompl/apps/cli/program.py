"""The program `safe-ompl`: its commands and exit status; what it offers and needs: `scenarios`, `robots`, `doctor`."""

from __future__ import annotations

import argparse
import gc
import os
import platform
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import PackageNotFoundError, metadata, requires, version
from time import perf_counter
from typing import Any, NoReturn

import argcomplete
from rich.markup import escape
from rich.table import Table

from safe_ompl.apps.cli import (
    arguments,
    check,
    compare,
    judge,
    live,
    mbm,
    new,
    output,
    people,
    plan,
    ros,
    verify,
    view,
)
from safe_ompl.apps.cli.arguments import option
from safe_ompl.apps.cli.kernels import compile_all
from safe_ompl.common import InputError, SafeOmplError
from safe_ompl.planning import setup_scenario
from safe_ompl.robot import frame_index
from safe_ompl.robot.loading import EXAMPLES, ExampleRobot, UrdfFile, robots_folder
from safe_ompl.scene import Scenario, list_scenarios
from safe_ompl.version import __version__

BAD_INPUT, INTERRUPTED, BROKEN_PIPE = 2, 130, 141

_FIRST = (
    "first steps: safe-ompl view panda_shelf; for your own robot: safe-ompl new arm.urdf -o scenario.yaml, "
    "then safe-ompl view scenario.yaml. "
)
_EPILOG = "exit status: 0 solved, 1 not solved, 2 bad input"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `safe-ompl` with the words after its name, by default those of the process, and return the exit status.

    That is 0 if solved, 1 if not, 2 on bad input, 130 if interrupted.
    """
    console = output.error_console()
    try:
        parser = command_line()
        argcomplete.autocomplete(parser)
        words = sys.argv[1:] if arguments is None else arguments
        options = parser.parse_args(words or ["--help"])
        if arguments is None:
            gc.freeze()  # this process is ours: what is imported stays, and need not be searched for garbage
        with output.ompl_messages(options.verbose), output.shown_log(console, options.verbose) as log:
            job = options.prepare(options)
            log.show()
            return int(job())
    except (SafeOmplError, OSError) as error:
        if isinstance(error, BrokenPipeError):
            return _broken_pipe()
        console.print(f"safe-ompl: {' '.join(str(error).split())}")
        return BAD_INPUT
    except (KeyboardInterrupt, SystemError) as error:
        # Numba turns a Ctrl-C that comes while it looks a kernel up into a SystemError.
        if isinstance(error, SystemError) and not isinstance(error.__cause__, KeyboardInterrupt):
            raise
        console.print("safe-ompl: interrupted")
        return INTERRUPTED


class _Parser(argparse.ArgumentParser):
    """A parser that raises InputError for bad arguments."""

    def error(self, message: str) -> NoReturn:
        raise InputError(message)


def command_line() -> argparse.ArgumentParser:
    """Return the parser; `prepare` of its options is the one of the command, see `add_parser`."""
    parser = _Parser(
        prog="safe-ompl",
        description="Safety-oriented motion planning for robot arms.",
        epilog=_FIRST + _EPILOG,
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for command in (plan, check, view, verify, live, people, ros, compare, mbm, judge, new):
        command.add_commands(commands)
    add_commands(commands)
    for own in commands.choices.values():
        option(own, "-v, --verbose", "show what is being done")
        own.epilog = _EPILOG
    return parser


def _broken_pipe() -> int:
    """End without a message, as programs in a pipe do; Python would else report an error when it closes stdout."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return BROKEN_PIPE


_SCENARIO, _PLANNER, _TIME = "planar2", "SafeRRTConnect", 10.0
_EXTRAS = ("plots", "viewer", "cluster", "mcap")
_SHELLS = ("bash", "zsh", "fish")


def add_commands(commands: Any) -> None:
    """Add `scenarios`, `robots`, `doctor` and `completion` to the commands."""
    arguments.add_parser(commands, "scenarios", lambda _: _printed(scenarios_table), "list the scenarios")
    arguments.add_parser(commands, "robots", lambda _: _printed(robots_table), "list the example robots")
    arguments.add_parser(
        commands,
        "doctor",
        lambda _: examine,
        "show versions and what is missing, and try a small plan",
        "Show which versions are installed, and which are missing or do not fit, compile what is not compiled "
        "yet, and plan once. The exit status is 1 if something needed is missing or the plan fails.",
    )
    parser = arguments.add_parser(
        commands,
        "completion",
        lambda options: partial(_complete, options.shell),
        "make a shell complete commands and options",
        'Print what makes a shell complete commands and options: add `eval "$(safe-ompl completion bash)"` '
        "to ~/.bashrc, the same with zsh to ~/.zshrc, or `safe-ompl completion fish | source` to config.fish.",
    )
    parser.add_argument("shell", choices=_SHELLS, help="which shell")


def _printed(table: Callable[[], Table]) -> Callable[[], int]:
    def job() -> int:
        output.console().print(table())
        return 0

    return job


def _complete(shell: str) -> int:
    print(argcomplete.shellcode(["safe-ompl"], shell=shell))
    return 0


def scenarios_table() -> Table:
    """Return the scenarios by name: robot, obstacles, and what happens in them."""
    table = output.plain_table("scenario", "robot", "obstacles", "description")
    for name, file in list_scenarios().items():
        try:
            scenario = Scenario.load(file)
        except InputError as error:
            table.add_row(name, "", "", f"cannot be used: {error}")
            continue
        robot = scenario.robot.example or (scenario.robot.urdf.stem if scenario.robot.urdf else "")
        words = " ".join(scenario.description.split())
        table.add_row(name, robot, str(len(scenario.scene.obstacles)), words)
    return table


def robots_table() -> Table:
    """Return the example robots by name: how many joints move, the tip, what is locked, what has no collision shape."""
    table = output.plain_table("robot", "joints", "tip", "locked", "not checked")
    for name, example in sorted(EXAMPLES.items()):
        locked = ", ".join(f"{joint} = {value:g}" for joint, value in example.locked.items())
        urdf = UrdfFile(robots_folder() / example.urdf)
        moving = str(_moving_joints(urdf, example))
        table.add_row(name, moving, example.tip, locked, ", ".join(_bare_links(urdf)))
    table.caption = "not checked: links that have visual shapes but no collision shapes"
    return table


def _bare_links(urdf: UrdfFile) -> list[str]:
    """Return the moving links that have visual shapes only, in the URDF's order."""
    bare = urdf.links_with_visuals_only()
    return [frame.name for frame in urdf.build_model().frames if frame.name in bare and frame.parentJoint]


def _moving_joints(urdf: UrdfFile, example: ExampleRobot) -> int:
    """Return how many joints move the tip; the meshes, which take long, are not read."""
    model = urdf.build_model()
    chain = model.supports[model.frames[frame_index(model, example.tip)].parentJoint]
    return sum(model.names[joint] not in example.locked for joint in list(chain)[1:])


@dataclass(frozen=True)
class Requirement:
    """A package by its name on PyPI, versions that fit (">=2.0,<3"), and the extra that requires it, if any."""

    name: str
    bounds: str
    extra: str

    @property
    def found(self) -> str | None:
        """The version that is installed, or None."""
        try:
            return version(self.name)
        except PackageNotFoundError:
            return None

    @property
    def fits(self) -> bool:
        """Whether a version is installed that fits."""
        found = self.found
        return found is not None and all(
            _within(found, bound) for bound in filter(None, self.bounds.split(","))
        )


def examine() -> int:
    """Show what is installed beside what is supported, and plan once; return 0 if all that is needed works."""
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_row("safe-ompl", __version__, "")
    python = metadata("safe-ompl")["Requires-Python"] or ""
    table.add_row("Python", platform.python_version(), f"{python}, {platform.system()} {platform.machine()}")
    healthy = True
    for requirement in requirements():
        said = requirement.found or "missing"
        wanted = f"needs {requirement.bounds}" if requirement.bounds else ""
        advice = f"pip install 'safe-ompl[{requirement.extra}]'" if requirement.extra else ""
        words = requirement.bounds if requirement.fits else "; ".join(filter(None, [wanted, advice]))
        table.add_row(requirement.name, said, escape(words))
        healthy &= requirement.fits or bool(requirement.extra)
    output.console().print(table)
    compile_all()
    return 0 if _plans() and healthy else 1


def requirements() -> Iterator[Requirement]:
    """Yield the requirements of the installed package and of its extras."""
    for line in requires("safe-ompl") or ():
        found = re.match(r"""([\w.-]+)(?:\[.*?\])?\s*([^;]*?)\s*(?:;.*extra == ['"](\w+)['"].*)?$""", line)
        if found and (found[3] or "") in ("", *_EXTRAS):
            yield Requirement(found[1], found[2].replace(" ", ""), found[3] or "")


def _plans() -> bool:
    scenario = arguments.load_scenario(_SCENARIO)
    begin = perf_counter()
    setup = setup_scenario(scenario)
    built = perf_counter()
    result = setup.plan(_PLANNER, time=_TIME, seed=0)
    words = f"{len(result.path)} way points, proven" if result.path is not None else result.status
    output.console().print(
        f"{_PLANNER} in {_SCENARIO}: {words}; {1e3 * (built - begin):.0f} ms to set up, "
        f"{1e3 * result.planning_time:.1f} ms to plan"
    )
    return bool(result)


def _within(found: str, bound: str) -> bool:
    """Return whether a version keeps to a bound such as ">=2.0" or "<3"."""
    sign, wanted = re.match(r"([<>=!~]+)(.*)", bound).groups()  # type: ignore[union-attr]
    this, that = _numbers(found), _numbers(wanted)
    length = max(len(this), len(that))
    this, that = (numbers + (0,) * (length - len(numbers)) for numbers in (this, that))
    return {">=": this >= that, "<": this < that, "==": this == that, "!=": this != that}.get(sign, True)


def _numbers(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", text))
