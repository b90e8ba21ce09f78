"""The program `safe-ompl`: parser, exit status, and the commands `list` and `doctor`."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any, NoReturn

from safe_ompl.apps.cli import arguments, output
from safe_ompl.apps.cli.arguments import option
from safe_ompl.common import InputError, SafeOmplError
from safe_ompl.robot import EXAMPLES
from safe_ompl.scene import Scenario, list_scenarios
from safe_ompl.version import __version__

if TYPE_CHECKING:
    from rich.table import Table

BAD_INPUT, BROKEN_PIPE = 2, 141
# The modules of this package, by their commands in the order of the help.
_MODULES = {
    "plan": ("plan",),
    "view": ("view",),
    "check": ("check", "tube"),
    "new": ("new", "srdf"),
    "verify": ("verify",),
    "compare": ("compare", "mbm"),
    "live": ("live",),
    "ros": ("ros", "guard"),
}
# Commands that write no file of their own, and those that load neither a robot nor a saved file.
_WITHOUT_FILES = ("list", "doctor", "verify", "tube")
_WITHOUT_ROBOT = ("list", "doctor")

_FIRST = (
    "to begin with: plan, view, check. First steps: safe-ompl view panda_shelf; for your own robot: "
    "safe-ompl new arm.urdf -o scenario.yaml, then safe-ompl view scenario.yaml. "
)
_EPILOG = "exit status: 0 solved, 1 not solved, 2 bad input"


def main(words: Sequence[str] | None = None) -> int:
    """Run `safe-ompl` with arguments, by default those of the process, and return the exit status.

    The status is 0 if solved, 1 if not solved, 2 for bad input, 130 if interrupted, 141 if a pipe was closed.
    """
    try:
        words = (sys.argv[1:] if words is None else words) or ["--help"]
        options = command_line(words[0]).parse_args(words)
        output.check_outputs(options)
        with output.ompl_messages(options.verbose), output.shown_log(options.verbose) as show:
            job = options.prepare(options)
            show()
            return int(job())
    # The reader of the pipe has gone. Nothing is printed, and Python must not complain when it closes stdout.
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except (SafeOmplError, OSError) as error:
        error_text = str(error)
        if isinstance(error, OSError) and error.filename is not None:
            error_text = f"{error.filename}: {error.strerror}"
        output.error_console().print(f"safe-ompl: {' '.join(error_text.split())}")
        return BAD_INPUT
    except KeyboardInterrupt:
        output.error_console().print("safe-ompl: interrupted")
        return output.INTERRUPTED


class _Parser(argparse.ArgumentParser):
    """A parser that raises InputError for bad arguments."""

    def error(self, message: str) -> NoReturn:
        raise InputError(message)


def command_line(command: str | None = None) -> argparse.ArgumentParser:
    """Return the parser; `prepare` of its options is the one of the command, see `add_parser`.

    If the first word is a command of a module, other modules are not imported, and their commands are left out.
    """
    parser = _Parser(
        prog="safe-ompl", description="Safety-oriented motion planning for robot arms.", epilog=_FIRST + _EPILOG
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for module in [module for module, own in _MODULES.items() if command in own] or _MODULES:
        import_module(f"safe_ompl.apps.cli.{module}").add_commands(commands)
    add_commands(commands)
    for name, own in commands.choices.items():
        if name not in _WITHOUT_FILES:
            arguments.add_force(own)
        if name not in _WITHOUT_ROBOT:
            arguments.add_package_dirs(own)
        option(own, "-v, --verbose", "show what is being done")
        own.epilog = _EPILOG
    return parser


def add_commands(commands: Any) -> None:
    """Add `list` and `doctor` to the commands."""
    arguments.add_parser(commands, "list", lambda _: list_all, "list the scenarios and the example robots")
    arguments.add_parser(
        commands,
        "doctor",
        lambda _: examine,
        "show versions, what is missing, and what fails",
        "Show which versions are installed, and which are missing or do not fit, and try what is installed. The exit "
        "status is 1 if something needed is missing, or something installed fails.",
    )


def examine() -> int:
    """Run `doctor`, which imports all that is installed."""
    from safe_ompl.apps.cli.doctor import examine

    return examine()


def list_all() -> int:
    """Print the scenarios and the example robots."""
    output.console().print(scenarios_table(), robots_table(), sep="\n")
    return 0


def scenarios_table() -> Table:
    """Return the scenarios by name: robot, obstacles, and what happens in them."""
    table = output.plain_table("scenario", "robot", "obstacles", "description")
    for name, file in (list_scenarios() | list_scenarios(programs=True)).items():
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
    """Return the example robots by name: the tip, and which joints are locked."""
    table = output.plain_table("robot", "tip", "locked")
    for name, example in sorted(EXAMPLES.items()):
        locked = ", ".join(f"{joint} = {value:g}" for joint, value in example.locked.items())
        table.add_row(name, example.tip, locked)
    return table
