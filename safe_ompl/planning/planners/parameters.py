"""Parameters of planners, declared once as data: default, bounds, unit and meaning."""

from __future__ import annotations

import inspect
import re
import textwrap
from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter
from typing import Any, Generic, TypeVar, cast, overload

from safe_ompl.common import UnknownNameError, flag, number, whole_number

T = TypeVar("T", bool, int, float, str)
_WIDTH = 100  # of generated docstrings


@dataclass(eq=False)
class Parameter(Generic[T]):
    """A parameter of a planner, declared as an attribute of its class.

    >>> class Planner(SafePlanner):  # doctest: +SKIP
    ...     goal_bias = Parameter(0.05, "Share of the extensions towards a goal.", at_most=1)

    The declaration gives `Planner` the methods `setGoalBias` and `getGoalBias`, the keyword argument ``goal_bias`` and
    an entry in its docstring; `planner.goal_bias` is the value. What is set is checked.

    Attributes
    ----------
    default : bool, int, float or str
        The default, always allowed. Its type is the parameter's: flag, whole number, number or text.
    doc, unit : str
        What it means, and its unit, such as "rad".
    at_least, above, at_most, choices
        Bounds of a number, at least 0 unless it is to be above something; and the values that a text may have.
    kept_in : str
        The path of an attribute of one of the planner's parts, such as "_danger.alpha", that keeps the value.
    """

    default: T
    doc: str
    unit: str = ""
    at_least: float = 0.0
    above: float | None = None
    at_most: float | None = None
    choices: Collection[str] = ()
    kept_in: str = ""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name
        self._part, _, self._attribute = self.kept_in.rpartition(".")
        for method in self._methods():
            if method.__name__ not in vars(owner):
                method.__qualname__ = f"{owner.__qualname__}.{method.__name__}"
                setattr(owner, method.__name__, method)

    @overload
    def __get__(self, planner: None, owner: type) -> Parameter[T]: ...
    @overload
    def __get__(self, planner: object, owner: type) -> T: ...
    def __get__(self, planner: object | None, owner: type) -> Parameter[T] | T:
        if planner is None:
            return self
        if self.kept_in:
            return cast(T, attrgetter(self.kept_in)(planner))
        return cast(T, planner.__dict__[self.name])

    def __set__(self, planner: object, value: T) -> None:
        checked = self.checked(value)
        if self.kept_in:
            setattr(attrgetter(self._part)(planner), self._attribute, checked)
        else:
            planner.__dict__[self.name] = checked

    def checked(self, value: Any) -> T:
        """Return a value as the parameter's type, or raise an InputError that says what would be right."""
        kind, found, least = type(self.default), value, self.at_least
        if kind is str:
            if value not in tuple(self.choices):
                raise UnknownNameError(self.name, value, self.choices)
        elif kind is bool:
            found = flag(self.name, value)
        elif kind is int:
            found = whole_number(self.name, value, at_least=int(least))
        elif self.above is not None:
            is_default = isinstance(value, float) and value == self.default  # which may be infinite
            found = value if is_default else number(self.name, value, above=self.above)
        else:
            found = number(self.name, value, at_least=least, at_most=self.at_most)
        return cast(T, found)

    @cached_property
    def entry(self) -> str:
        """The parameter as an entry of a NumPy-style docstring."""
        kind = type(self.default).__name__
        if self.choices:
            kind = "{" + ", ".join(map(repr, self.choices)) + "}"
        elif kind != "bool":
            kind += f" >= {self.at_least:g}" if self.above is None else f" > {self.above:g}"
            kind += "" if self.at_most is None else f", <= {self.at_most:g}"
        unit = f" [{self.unit}]" if self.unit else ""
        words = textwrap.fill(" ".join(self.doc.split()), _WIDTH, initial_indent="    ", subsequent_indent="    ")
        return f"{self.name} : {kind}, default {self.default!r}{unit}\n{words}"

    def _methods(self) -> tuple[Any, Any]:
        def setter(planner: Any, value: Any) -> None:
            setattr(planner, self.name, value)

        def getter(planner: Any) -> Any:
            return getattr(planner, self.name)

        for method, verb in ((setter, "Set"), (getter, "Get")):
            method.__name__ = f"{verb.lower()}{camel_case(self.name)}"
            method.__doc__ = f"{verb} the parameter `{self.name}`.\n\n{self.entry}"
        return setter, getter


def parameters_of(kind: type) -> dict[str, Parameter[Any]]:
    """Return the parameters that a class of planners declares, its own before those of its base."""
    found: dict[str, Parameter[Any]] = {}
    for owner in kind.__mro__:
        for name, value in vars(owner).items():
            if isinstance(value, Parameter):
                found.setdefault(name, value)
    return found


_ARGUMENTS = """Parameters
----------
si : ob.SpaceInformation
    What the planner plans in.
name : str
    Name in logs and benchmarks; by default that of the class.
"""


def describe(kind: type) -> None:
    """Put the parameters of a class of planners into its docstring, before notes and references, and its signature."""
    declared = parameters_of(kind)
    section = _ARGUMENTS + "\n".join(parameter.entry for parameter in declared.values()) + "\n"
    text = inspect.cleandoc(kind.__doc__ or kind.__name__)
    cut = re.search(r"^(Notes|References)\n-+$", text, re.MULTILINE)
    end = cut.start() if cut else len(text)
    kind.__doc__ = f"{text[:end].rstrip()}\n\n{section}\n{text[end:]}"
    usual = inspect.Parameter
    arguments = [usual("si", usual.POSITIONAL_OR_KEYWORD)]
    arguments.append(usual("name", usual.POSITIONAL_OR_KEYWORD, default=kind.__name__))
    arguments += [usual(name, usual.KEYWORD_ONLY, default=each.default) for name, each in declared.items()]
    kind.__signature__ = inspect.Signature(arguments)  # type: ignore[attr-defined]


def camel_case(name: str) -> str:
    """Return goal_bias as GoalBias."""
    return "".join(word.capitalize() for word in name.split("_"))


def snake_case(name: str) -> str:
    """Return GoalBias as goal_bias."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()
