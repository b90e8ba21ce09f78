"""Colours and lines of planners: a planner looks the same in every picture."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from safe_ompl.exchange.timed_motion import ACCELERATION

Colour = tuple[float, float, float]
"""Red, green and blue of sRGB, each in [0, 1]."""


class PlannerStyle(NamedTuple):
    """Looks of a planner.

    Attributes
    ----------
    colour : Colour
        Of its curves, boxes and robots.
    dashes : tuple of float
        On and off lengths of its lines, in line widths; empty for a solid line.
    strong : bool
        Whether it is a safe planner, which stands out.
    """

    colour: Colour
    dashes: tuple[float, ...]
    strong: bool


# Safe planners, and below their classical counterparts in a pale tone of it (distinct to the colour-blind).
_FAMILIES: dict[str, tuple[str, str]] = {
    "RRTConnect": ("#0b62b4", "#7d9fc4"),
    "PRM": ("#00876a", "#84b8a6"),
    "JTRRT": ("#b87a00", "#d3b577"),
    "Bubble": ("#7d2f91", "#b795c2"),
}
_OTHERS = ("#596675", "#8b96a1", "#3a444f", "#aab2ba")
_OTHER_DASHES = ((4.0, 1.5), (1.2, 1.2), (6.0, 1.5, 1.2, 1.5), (2.5, 1.0))


def planner_styles(names: Iterable[str]) -> dict[str, PlannerStyle]:
    """Return the looks of planners by name.

    Safe planners get a strong colour and a solid line, "Classic…" ones a pale tone of the same hue and
    dashes, those as printed ("Paper…") the same colours with dots, and all others slate greys in their order.
    """
    styles: dict[str, PlannerStyle] = {}
    others = 0
    for name in names:
        family = next((key for key in _FAMILIES if name.endswith((key, f"{key}Planner"))), None)
        if family and name.startswith(("Safe", family + "Planner")):
            styles[name] = PlannerStyle(_from_hex(_FAMILIES[family][0]), (), strong=True)
        elif family and name.startswith("Classic"):
            styles[name] = PlannerStyle(_from_hex(_FAMILIES[family][1]), (3.0, 1.2), strong=False)
        elif family and name.startswith("Paper"):
            strong = name.startswith("PaperSafe")
            tone = _from_hex(_FAMILIES[family][0 if strong else 1])
            styles[name] = PlannerStyle(tone, (1.0, 1.2) if strong else (3.0, 1.2, 1.0, 1.2), strong)
        else:
            colour, dashes = (table[others % len(_OTHERS)] for table in (_OTHERS, _OTHER_DASHES))
            styles[name] = PlannerStyle(_from_hex(str(colour)), tuple(map(float, dashes)), strong=False)
            others += 1
    return styles


_CAPS = {
    ACCELERATION: "#8b96a1",
    "joint velocity": "#0b62b4",
    "separation": "#c8452b",
    "separation or contact": "#c8452b",
    "danger": "#7d2f91",
    "tool speed": "#00876a",
    "link speed": "#b87a00",
    "moving": "#0b62b4",  # and the states of a robot that is driven beside people
    "slowed": "#b87a00",
    "braking": "#c8452b",
    "standing": "#3a444f",
    "done": "#8b96a1",
}
_OTHER_CAPS = ("#596675", "#3a444f", "#aab2ba")


def cap_colours(names: Iterable[str]) -> dict[str, Colour]:
    """Return the colours of what bounds the speed of a motion, by name; that of accelerations among them."""
    others = 0
    colours = {ACCELERATION: _from_hex(_CAPS[ACCELERATION])}
    for name in dict.fromkeys(names):
        code = _CAPS.get(name)
        if code is None:
            code = _OTHER_CAPS[others % len(_OTHER_CAPS)]
            others += 1
        colours[name] = _from_hex(code)
    return colours


def _from_hex(code: str) -> Colour:
    red, green, blue = (int(code[k : k + 2], 16) / 255 for k in (1, 3, 5))
    return red, green, blue


def grid_columns(count: int) -> int:
    """Return in how many columns to set so many pictures: three or four from five on, whichever fills the lines."""
    return count if count <= 3 else 2 if count == 4 else min((4, 3), key=lambda columns: -count % columns)
