"""Options that several commands share, and functions that read values from text."""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar, get_args

from safe_ompl.apps.cli import output
from safe_ompl.common import InputError, UnknownNameError, documents as document
from safe_ompl.planning.planners import planner_names
from safe_ompl.robot import CollisionSource, NamedPackage, PackageDir
from safe_ompl.scene import Scenario, ToolConstraint

_Number = TypeVar("_Number", int, float)

PLANNER = "SafeRRTConnect"  # default planner
_BOOLEANS = {"true": True, "yes": True, "on": True, "false": False, "no": False, "off": False}


def add_parser(
    commands: Any,
    name: str,
    prepare: Callable[[argparse.Namespace], Callable[[], int]],
    summary: str,
    description: str | None = None,
) -> argparse.ArgumentParser:
    """Add a command to `commands`, which `add_subparsers` returned, and return the parser of the command.

    `prepare` validates the options, raises InputError for bad input, and returns a function without arguments that runs
    the command and returns the exit status. `summary` is shown in the list of commands. `description` is shown in the
    help of the command; by default it is the summary.
    """
    parser: argparse.ArgumentParser = commands.add_parser(
        name, help=summary, description=description or f"{summary[0].upper()}{summary[1:]}."
    )
    parser.set_defaults(prepare=prepare)
    return parser


def option(
    parser: argparse._ActionsContainer,
    form: str,
    words: str = "",
    read: Callable[[str], Any] = str,
    default: Any = None,
    **more: Any,
) -> None:
    """Add an option to a parser or an argument group; `form` is the option as the help shows it: `-o, --out FILE`.

    An option without a value is a switch. An option whose default is an empty list may be repeated. A form without a
    dash is a positional argument. The default is appended to the help text `words`, unless `words` mention it. `more`
    are further arguments of `add_argument`.
    """
    *others, last = form.split(", ")
    name, _, metavar = last.partition(" ")
    if metavar:
        more |= {"metavar": metavar, "type": read, "default": default}
        more |= {"action": "append"} if default == [] else {}
    else:
        more["action"] = "store_true"
    names_default = "default" in words or isinstance(default, bool)
    if not names_default and isinstance(default, (str, int, float, tuple, Path)):
        kind = "g" if isinstance(default, float) else "s"
        words = f"{words}; default: %(default){kind}".removeprefix("; ")
    parser.add_argument(*others, name, help=words, **more)


def add_force(parser: argparse.ArgumentParser) -> None:
    """Add --force, which allows to replace files. `command_line` adds it to all commands that write files."""
    option(parser, "--force", "replace files that exist")


def refuse(options: argparse.Namespace, names: Iterable[str], why: str) -> None:
    """Raise InputError, with the reason `why`, if the user gave one of the named options."""
    for name in names:
        if getattr(options, name) not in (None, [], False, 0.0):
            raise InputError(why, f"--{name.replace('_', '-')}")


def add_scenario(parser: argparse.ArgumentParser) -> None:
    """Add the scenario as the first positional argument."""
    option(parser, "scenario SCENARIO", "name or YAML file, see `safe-ompl list`")


def add_mcap(parser: argparse.ArgumentParser) -> None:
    """Add --mcap, which writes a log for Foxglove."""
    option(parser, "--mcap FILE", "also write a log that Foxglove opens (.mcap)", output.LOG)


def add_planner_options(parser: argparse.ArgumentParser, usual_time: str) -> None:
    """Add the options for planner, parameters, time limit, seed and simplification."""
    option(parser, "--planner NAME", "", default=PLANNER)
    option(parser, "--param KEY=VALUE", "parameter of the planner: alpha=2 (repeatable)", parameter, [])
    add_run_options(parser, usual_time)


def add_run_options(parser: argparse.ArgumentParser, usual_time: str, *, simplify: bool = False) -> None:
    """Add the options for time limit, seed and simplification."""
    option(parser, "--time SECONDS", f"time limit of a run (default: {usual_time})", seconds)
    option(parser, "--seed N", "random seed (default: 0)", random_seed, 0)
    option(
        parser,
        "--simplify SECONDS",
        "make paths shorter and safer; without SECONDS: until no step improves them"
        + (" (this is the default)" if simplify else ""),
        seconds,
        simplify,
        nargs="?",
        const=True,
    )


def add_workers(parser: argparse.ArgumentParser, what: str) -> None:
    """Add --workers, the number of processes. `what` names the tasks that the processes share."""
    option(
        parser,
        "--workers N",
        f"processes that share the {what} (default: 1, which gives the most accurate times)",
        count,
    )


def run_options(options: argparse.Namespace, scenario: Scenario, planner: str) -> dict[str, Any]:
    """Return the arguments of `SafeSetup.plan` for a planner. Options take precedence over the scenario."""
    return {
        "time": options.time or scenario.time,
        "seed": options.seed,
        "parameters": {**scenario.planners.get(planner, {}), **given_parameters(options)},
        "simplify": options.simplify,
    }


def add_xacro_args(parser: argparse._ActionsContainer) -> None:
    """Add --xacro-arg, which sets arguments of a xacro file."""
    option(parser, "--xacro-arg NAME:=VALUE", "argument of a URDF with xacro macros (repeatable)", _xacro_arg, [])


def _xacro_arg(text: str) -> tuple[str, str]:
    name, assigned, value = text.partition(":=")
    if not name or not assigned:
        raise argparse.ArgumentTypeError(f"must be NAME:=VALUE, not {text!r}")
    return name, value


def xacro_args(options: argparse.Namespace) -> dict[str, str]:
    """Return the values of xacro arguments that the options set."""
    return _once("--xacro-arg", options.xacro_arg)


def add_collision_option(parser: argparse._ActionsContainer) -> None:
    """Add --collision, which sets how links without collision shapes are treated."""
    parser.add_argument(
        "--collision",
        choices=get_args(CollisionSource),
        help="required (default): refuse a robot without any collision shape; "
        "visual: links without collision shapes collide with their visual shapes",
    )


def add_package_dirs(parser: argparse._ActionsContainer) -> None:
    """Add the options for package folders, which all commands that load a robot or a saved file have."""
    option(parser, "--package-dir DIR", "folder with packages that the URDF names (repeatable)", _folder, [])
    words = "folder of the package NAME that a URDF names (repeatable)"
    option(parser, "--package NAME=DIR", words, _package, [], dest="package_dir")


def _folder(text: str) -> Path:
    if not Path(text).is_dir():
        raise argparse.ArgumentTypeError(f"package folder {text!r} does not exist")
    return Path(text).resolve()


def _package(text: str) -> NamedPackage:
    name, folder = _assignment(text, "NAME=DIR")
    return NamedPackage(name, _folder(folder))


def given_parameters(options: argparse.Namespace) -> dict[str, Any]:
    """Return the planner parameters that the options set. A command without --param has none."""
    return _once("--param", vars(options).get("param", ()))


def _once(option: str, pairs: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in pairs:
        if name in found:
            raise InputError(f"{name!r} is given twice: {found[name]!r} and {value!r}", option)
        found[name] = value
    return found


def add_limit_options(parser: argparse.ArgumentParser) -> None:
    """Add the options for limits that every path must satisfy."""
    group = parser.add_argument_group("limits, proven along whole motions")
    option(group, "--max-danger X", "largest danger of any configuration", limit)
    option(group, "--min-clearance D", "keep D metres from people and from all obstacles with a danger weight", limit)
    option(
        group,
        "--keep-upright DEG",
        "the axis of the tool that points up at the start stays within DEG degrees of upright",
        degrees,
    )


def with_limits(scenario: Scenario, options: argparse.Namespace) -> Scenario:
    """Return the scenario with the limits of the options, which replace the scenario's limits."""
    keys = ("max_danger", "min_clearance")
    given: dict[str, Any] = {key: getattr(options, key) for key in keys if getattr(options, key)}
    if options.keep_upright:
        given["tool"] = ToolConstraint(options.keep_upright)
    return dataclasses.replace(scenario, limits=dataclasses.replace(scenario.limits, **given))


def load_scenario(name_or_file: str, package_dirs: Sequence[PackageDir] = (), *, goal: bool = False) -> Scenario:
    """Load a scenario. Raise InputError if the scenario sets parameters of an unknown planner.

    With `goal`, a scenario with a program instead of a goal is refused.
    """
    scenario = Scenario.load(name_or_file)
    if goal and scenario.goal is None:
        raise InputError("missing: the scenario has a program instead; use `safe-ompl plan`", f"{scenario.file}: goal")
    for planner in scenario.planners:
        if planner not in planner_names():
            raise UnknownNameError("planner", planner, planner_names(), f"{scenario.file}: planners")
    if not package_dirs:
        return scenario
    with document.within("--", separator=""):
        return dataclasses.replace(scenario, robot=scenario.robot.with_package_dirs(package_dirs))


# ------------------------------------------------------------------------------------------------- values


def _reader(kind: Callable[[str], _Number], fits: Callable[[_Number], bool], what: str) -> Callable[[str], _Number]:
    """Return a function that reads a number from text. `what` describes the allowed numbers in error messages."""

    def read(text: str) -> _Number:
        with suppress(ValueError):
            value = kind(text)
            if fits(value):
                return value
        raise argparse.ArgumentTypeError(f"must be {what}, not {text!r}")

    return read


seconds = _reader(float, lambda value: 0 < value < math.inf, "a positive number of seconds")
limit = _reader(float, lambda value: 0 < value < math.inf, "a positive number")
finite = _reader(float, math.isfinite, "a finite number")
noise = _reader(float, lambda value: 0 <= value < math.inf, "a finite number >= 0")
share = _reader(float, lambda value: 0 <= value <= 1, "a share in [0, 1]")
count = _reader(int, lambda value: value >= 1, "a whole number of at least 1")
random_seed = _reader(int, lambda value: 0 <= value < 2**32, "a whole number in [0, 2**32)")
port = _reader(int, lambda value: 1 <= value < 2**16, "a port in [1, 65535]")
_angle = _reader(float, lambda value: 0 < value <= 180, "an angle in (0, 180] degrees")


def degrees(text: str) -> float:
    """Read an angle in degrees; return it in radians."""
    return math.radians(_angle(text))


def names(text: str) -> tuple[str, ...]:
    """Read names with commas between them."""
    found = tuple(name.strip() for name in text.split(","))
    if not all(found):
        raise argparse.ArgumentTypeError(f"must be names separated by commas, not {text!r}")
    return found


def parameter(text: str) -> tuple[str, Any]:
    """Read ``name=value``. The value is a number, a bool (true, yes, on, false, no, off), or else text."""
    name, value = _assignment(text, "name=value")
    for kind in (int, float):
        with suppress(ValueError):
            return name, kind(value)
    return name, _BOOLEANS.get(value.lower(), value)


def by_joint(text: str) -> float | dict[str, float]:
    """Read one number > 0 for all joints, or ``joint=number`` for each, with commas between them."""
    if "=" not in text:
        return limit(text)
    found: dict[str, float] = {}
    for part in text.split(","):
        name, value = _assignment(part, "JOINT=NUMBER[,JOINT=NUMBER…]")
        if name in found:
            raise argparse.ArgumentTypeError(f"{name!r} is given twice")
        found[name] = noise(value)
    return found


def _assignment(text: str, form: str) -> tuple[str, str]:
    name, equals, value = (part.strip() for part in text.partition("="))
    if not (name and equals and value):
        raise argparse.ArgumentTypeError(f"must have the form {form}, not {text!r}")
    return name, value
