"""The program `safe-ompl`: commands, their options and the exit status."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from typing import NoReturn

import argcomplete

from safe_ompl.apps.cli import compare, info, live, mbm, new, plan, verify, view
from safe_ompl.apps.cli.output import error_console, ompl_messages, shown_log
from safe_ompl.common import InputError, SafeOmplError
from safe_ompl.version import __version__

BAD_INPUT, INTERRUPTED, BROKEN_PIPE = 2, 130, 141

_FIRST = (
    "first steps: safe-ompl view panda_shelf; for your own robot: safe-ompl new arm.urdf -o scenario.yaml, "
    "then safe-ompl view scenario.yaml. "
)
_EPILOG = "exit status: 0 solved, 1 not solved, 2 bad input"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `safe-ompl`.

    Parameters
    ----------
    arguments : sequence of str, optional
        The words after the program's name; those of the process by default.

    Returns
    -------
    int
        0 solved, 1 not solved, 2 bad input, 130 interrupted.
    """
    console = error_console()
    try:
        parser = command_line()
        argcomplete.autocomplete(parser)
        words = sys.argv[1:] if arguments is None else arguments
        options = parser.parse_args(words or ["--help"])
        with ompl_messages(options.verbose), shown_log(console, options.verbose) as log:
            job = options.prepare(options)
            log.release()
            return int(job())
    except (SafeOmplError, OSError) as error:
        if isinstance(error, BrokenPipeError):
            return _broken_pipe()
        console.print(f"safe-ompl: {_one_line(error)}")
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
    for add_command in (
        plan.add_command,
        view.add_command,
        verify.add_command,
        live.add_command,
        compare.add_command,
        mbm.add_command,
        new.add_commands,
        info.add_commands,
    ):
        add_command(commands)
    for command in commands.choices.values():
        command.add_argument("-v", "--verbose", action="store_true", help="show what is being done")
        command.epilog = _EPILOG
    return parser


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def _broken_pipe() -> int:
    """End without a message, as programs in a pipe do; Python would else report an error when it closes stdout."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return BROKEN_PIPE
