"""`safe-ompl completion`: the lines that make a shell complete commands and options."""

from __future__ import annotations

import argparse
from typing import Any

import argcomplete

_SHELLS = ("bash", "zsh", "fish")


def add_command(commands: Any) -> None:
    """Add `completion` to the commands."""
    parser = commands.add_parser(
        "completion",
        help="make a shell complete commands and options",
        description='Print what makes a shell complete commands and options: add `eval "$(safe-ompl completion bash)"` '
        "to ~/.bashrc, the same with zsh to ~/.zshrc, or `safe-ompl completion fish | source` to config.fish.",
    )
    parser.add_argument("shell", choices=_SHELLS, help="which shell")
    parser.set_defaults(prepare=lambda options: lambda: _show(options))


def _show(options: argparse.Namespace) -> int:
    print(argcomplete.shellcode(["safe-ompl"], shell=options.shell))
    return 0
