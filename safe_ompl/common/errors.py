"""Exception classes, parts of their messages, and warnings that are logged once per process."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterable
from functools import cache
from typing import Any

# A message shows at most this many characters of a value.
_SHOWN = 200


def cut(text: str) -> str:
    """Return `text` on one line, cut after 200 characters, so that no message quotes a whole file."""
    line = re.sub(r"\s*\n\s*", " ", text)
    return line if len(line) <= _SHOWN else f"{line[:_SHOWN]}…"


def shown(value: Any) -> str:
    """Return the `repr` of a value for a message, on one line, cut after 200 characters."""
    return cut(repr(value))


def listed(names: Iterable[object]) -> str:
    """Return names separated by commas, cut after 200 characters."""
    return cut(", ".join(map(str, names)))


def told_apart(value: float, *others: float) -> tuple[str, ...]:
    """Format numbers for a message with as many digits as distinguish the first number from the others."""
    for digits in range(6, 18):
        digits_of = tuple(f"{number:.{digits}g}" for number in (value, *others))
        if digits_of[0] not in digits_of[1:]:
            break
    return digits_of


class SafeOmplError(Exception):
    """Base class of all errors that safe_ompl raises on purpose.

    Examples
    --------
    >>> try:
    ...     Robot.from_example("pandas")
    ... except SafeOmplError as error:
    ...     print(type(error).__name__)
    UnknownNameError
    """


class InputError(SafeOmplError, ValueError):
    """A value given by the user cannot be used.

    The message names the wrong value and says what would be right. `source`, the file or key of the value, is put
    before the message.

    Examples
    --------
    >>> Box([0.8, -0.5, 0.03])
    Traceback (most recent call last):
    safe_ompl.common.errors.InputError: size: must be a finite number in (0, 10000], got -0.5
    """

    def __init__(self, message: str, source: str | None = None) -> None:
        super().__init__(f"{source}: {message}" if source else message)


class UnknownNameError(InputError):
    """No object of this `kind` ("joint") has this `name`; the message lists the `known` names.

    `source` is as in `InputError`.

    Examples
    --------
    >>> Robot.from_example("pandas")
    Traceback (most recent call last):
    safe_ompl.common.errors.UnknownNameError: unknown example robot 'pandas'; did you mean 'panda'? known: ...
    """

    def __init__(self, kind: str, name: object, known: Iterable[str], source: str | None = None) -> None:
        known = tuple(known)
        hint = did_you_mean(name, known)
        super().__init__(f"unknown {kind} {shown(name)}; {hint}known: {', '.join(known) or '(none)'}", source)
        self._arguments = (kind, name, known, source)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), self._arguments


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Return "did you mean …? " with the most similar known name, ignoring case; empty if no name is similar."""
    # Only error messages need this module, so it is imported here.
    import difflib

    folded = {other.casefold(): other for other in known}
    close = difflib.get_close_matches(str(name).casefold(), folded, n=1)
    return f"did you mean {folded[close[0]]!r}? " if close else ""


class CollisionError(InputError):
    """A start or goal configuration is in collision, or its clearance or danger exceeds a limit.

    The message names the links and obstacles.

    Examples
    --------
    >>> block = Obstacle("block", Box([0.2, 0.2, 2.0]), Pose([0.4, 0.1, 0.0]))
    >>> setup = SafeSetup(Robot.from_example("ur5"), Scene([block]))
    >>> setup.setStartConfiguration([0.0, -1.2, 1.4, -1.8, -1.57, 0.0])
    Traceback (most recent call last):
    safe_ompl.common.errors.CollisionError: start is in collision: 'forearm_link' touches 'block'
    """


class StaleSceneError(SafeOmplError):
    """An object was made for earlier poses of obstacles and cannot be updated. The message says what to create again.

    Examples
    --------
    >>> ball = Obstacle("ball", Sphere(0.1), Pose([0.5, 0.1, 0.9]))
    >>> setup = SafeSetup(Robot.from_example("ur5"), Scene([ball]), movable=["ball"])
    >>> setup.setConfigurations([0.9, -1.2, 1.4, -1.8, -1.57, 0.0], [1.2, -1.2, 1.4, -1.8, -1.57, 0.0])
    >>> result = setup.plan(seed=0)
    >>> setup.moveObstacle("ball", Pose([0.5, 0.2, 0.9]))
    >>> result.timed(RateLimits.of(setup.robot, acceleration=8.0))
    Traceback (most recent call last):
    safe_ompl.common.errors.StaleSceneError: obstacles have moved since this was planned: ...
    """


class PlanningError(SafeOmplError):
    """A planner violated its contract, for example by returning a path that the validator refuses.

    Examples
    --------
    >>> ball = Scene([Obstacle("ball", Sphere(0.1), Pose([0.5, 0.1, 0.5]))])
    >>> path = [[0.9, -1.2, 1.4, -1.8, -1.57, 0.0], [-0.9, -1.2, 1.4, -1.8, -1.57, 0.0]]
    >>> certificate(path, Robot.from_example("ur5"), ball)
    Traceback (most recent call last):
    safe_ompl.common.errors.PlanningError: it cannot be certified by plain means: 'wrist_1_link' and 'ball' ...
    """


class CertificateError(SafeOmplError):
    """A certificate does not hold; the message says where and why.

    Examples
    --------
    >>> result = plan("planar2", seed=0)
    >>> proof = certificate(result.path, result.robot, result.scene)
    >>> verify({**proof, "digest": 64 * "0"})
    Traceback (most recent call last):
    safe_ompl.common.errors.CertificateError: every claim holds, but the file is not as it was written: ...
    """


@cache
def warn_once(log: logging.Logger, message: str) -> None:
    """Log a warning, unless `log` has logged the same message before; `warn_once.cache_clear()` resets this."""
    log.warning("%s", message, extra={"once": True})


def pass_on(record: logging.LogRecord) -> None:
    """Log a record of another process. A warning of `warn_once` is logged once for all processes."""
    log = logging.getLogger(record.name)
    if getattr(record, "once", False):
        warn_once(log, record.getMessage())
    else:
        log.handle(record)
