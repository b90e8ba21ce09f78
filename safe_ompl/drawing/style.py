"""Colours and line styles of planners, speed limits and danger levels, which are the same in all pictures."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import cycle
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from safe_ompl.common import FloatArray
from safe_ompl.io import ACCELERATION

Colour = tuple[float, float, float]
"""Red, green and blue of sRGB, each in [0, 1]."""


class PlannerStyle(NamedTuple):
    """The colour and line style of a planner."""

    # The colour of its curves, boxes and robots.
    colour: Colour
    # The lengths of dashes and gaps of its lines, in line widths. Empty means a solid line.
    dashes: tuple[float, ...]
    # Whether it is a safe planner, which is drawn stronger.
    strong: bool


# Safe planners, and below their classical counterparts in a pale tone of it (distinct to the colour-blind).
_FAMILIES: dict[str, tuple[str, str]] = {
    "RRTConnect": ("#0b62b4", "#7d9fc4"),
    "PRM": ("#00876a", "#84b8a6"),
    "JTRRT": ("#b87a00", "#d3b577"),
    "Bubble": ("#7d2f91", "#b795c2"),
}
# Their lines, and whether they are strong; "PaperSafe" is looked for before "Paper".
_KINDS: dict[str, tuple[tuple[float, ...], bool]] = {
    "Safe": ((), True),
    "Classic": ((3.0, 1.2), False),
    "PaperSafe": ((1.0, 1.2), True),
    "Paper": ((3.0, 1.2, 1.0, 1.2), False),
}
# The baseline in comparisons. Colour-blind people can distinguish it from the safe planners, too.
_BASELINE = "#c8452b"
_SOLID: tuple[float, ...] = ()
_OTHERS = ("#596675", "#8b96a1", "#3a444f", "#aab2ba")
_OTHER_DASHES: tuple[tuple[float, ...], ...] = ((4.0, 1.5), (1.2, 1.2), (6.0, 1.5, 1.2, 1.5), (2.5, 1.0))


def planner_styles(names: Iterable[str]) -> dict[str, PlannerStyle]:
    """Return the colours and line styles of planners by name.

    Safe planners get a strong colour and a solid line, "Classic…" ones a pale tone of the same hue and dashes, those as
    printed ("Paper…") the same colours with dots, the baseline ("OMPL …") a red, and all others slate greys in
    their order.
    """
    styles: dict[str, PlannerStyle] = {}
    others = cycle(zip(_OTHERS, _OTHER_DASHES, strict=True))
    for name in names:
        # The name without a seed or options.
        planner = name.partition(",")[0]
        family = next((key for key in _FAMILIES if planner.endswith((key, f"{key}Planner"))), None)
        kind = next((kind for kind in _KINDS if name.startswith(kind)), None)
        if kind is None and family is not None and name.startswith(f"{family}Planner"):
            kind = "Safe"
        if name.startswith("OMPL "):
            colour, dashes, strong = _BASELINE, _SOLID, True
        elif family is None or kind is None:
            (colour, dashes), strong = next(others), False
        else:
            dashes, strong = _KINDS[kind]
            colour = _FAMILIES[family][0 if strong else 1]
        styles[name] = PlannerStyle(_from_hex(colour), dashes, strong)
    return styles


# What bounds speeds; states of a robot that is driven beside people; what was found of a motion; steps of programs.
_BY_COLOUR = {
    "#8b96a1": (ACCELERATION, "done"),
    "#0b62b4": ("joint velocity", "moving", "proven", "move"),
    "#3aa0c9": ("blends beside people",),
    "#c8452b": ("separation", "braking", "not proven"),
    "#d98a1f": ("contact", "gripper"),
    "#a3562a": ("clamping",),
    "#7d2f91": ("danger", "retreating", "seam"),
    "#00876a": ("tool speed", "line"),
    "#b87a00": ("link speed", "slowed"),
    "#3a444f": ("standing", "wait"),
}
_CAPS = {name: code for code, names in _BY_COLOUR.items() for name in names}
_OTHER_CAPS = ("#596675", "#3a444f", "#aab2ba")


def cap_colours(names: Iterable[str]) -> dict[str, Colour]:
    """Return the colours of speed limits by name. The acceleration limit is always included."""
    others = cycle(_OTHER_CAPS)
    colours = {ACCELERATION: _from_hex(_CAPS[ACCELERATION])}
    for name in dict.fromkeys(names):
        colours[name] = _from_hex(_CAPS.get(name) or next(others))
    return colours


def _from_hex(code: str) -> Colour:
    red, green, blue = (int(code[k : k + 2], 16) / 255 for k in (1, 3, 5))
    return red, green, blue


_SHADES = np.array([_from_hex(code) for code in ("#c8452b", "#e0a030", "#2f9e8f", "#0b62b4")])


def shades(count: int) -> list[Colour]:
    """Return colours of paths from the most to the least dangerous one."""
    places, stops = np.linspace(0.0, 1.0, count), np.linspace(0.0, 1.0, len(_SHADES))
    red, green, blue = (np.interp(places, stops, channel).tolist() for channel in _SHADES.T)
    return list(zip(red, green, blue, strict=True))


Bytes = NDArray[np.uint8]

NEUTRAL: Colour = (0.82, 0.83, 0.85)
START_COLOUR: Colour = (0.55, 0.56, 0.58)
_LEVELS = np.array([(1.0, 0.96, 0.80), (0.99, 0.80, 0.42), (0.94, 0.45, 0.24), (0.72, 0.12, 0.16), (0.36, 0.02, 0.13)])


def level_colours(levels: FloatArray, most: float) -> Bytes:
    """Return colours (M, 3) of levels of danger (M,): pale at 0, darkest at `most` and above."""
    shares = np.clip(levels / most, 0.0, 1.0) if most > 0 else np.zeros(len(levels))
    stops = np.linspace(0.0, 1.0, len(_LEVELS))
    return as_bytes(np.column_stack([np.interp(shares, stops, channel) for channel in _LEVELS.T]))


def as_bytes(colours: FloatArray | Colour) -> Bytes:
    """Convert colours from [0, 1] to whole numbers from 0 to 255."""
    return np.asarray(np.rint(255.0 * np.clip(colours, 0.0, 1.0)), dtype=np.uint8)


def mixed(colour: Colour, other: Colour, share: float) -> Colour:
    """Return a colour with a share of another one in it."""
    red, green, blue = ((1.0 - share) * a + share * b for a, b in zip(colour, other, strict=True))
    return red, green, blue


def rgb(colour: Colour) -> tuple[int, int, int]:
    """Return a colour as three whole numbers from 0 to 255."""
    red, green, blue = (int(value) for value in as_bytes(colour))
    return red, green, blue
