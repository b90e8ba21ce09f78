"""The paper's two studies: planners in pairs, scenarios, and the printed numbers."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from safe_ompl.planning.planners.registry import planner_names


class Effort(NamedTuple):
    """A row of the paper's tables: means over the runs; `field` is NaN for planners without danger."""

    time: float
    nodes: float
    checks: float
    field: float


@dataclass(frozen=True)
class Pair:
    """A safe planner and its classical counterpart, both as printed or both in the form that is meant for use.

    Attributes
    ----------
    label : str
        What the paper calls the family.
    safe, classic : str
        Names of the planners.
    deterministic : bool
        Whether one run says it all, as in the paper.
    as_printed : bool
        Whether the two are as the papers print them.
    against_print : bool
        Whether the safe planner is ours and the classical one as printed: the baseline that nothing handicaps.
    """

    label: str
    safe: str
    classic: str
    deterministic: bool = False
    as_printed: bool = False
    against_print: bool = False

    @property
    def title(self) -> str:
        """The family, and which form of it."""
        form = "as printed" if self.as_printed else "ours / printed" if self.against_print else "ours"
        return f"{self.label} {form}"

    @property
    def planners(self) -> tuple[str, str]:
        """The names of both, the classical one first."""
        return self.classic, self.safe


@dataclass(frozen=True)
class Study:
    """One of the paper's case studies.

    Attributes
    ----------
    number : int
        1 or 2.
    scenario : str
        Name of the scenario file that stands for it.
    printed : mapping of str to (Effort, Effort)
        Label of each pair → what the paper prints for the classical and the safe planner.
    """

    number: int
    scenario: str
    printed: Mapping[str, tuple[Effort, Effort]]


PAIRS = (
    Pair("Bubbles", "PaperSafeBubble", "PaperBubble", deterministic=True, as_printed=True),
    Pair("Bubbles", "BubblePlanner", "ClassicBubble", deterministic=True),
    Pair("PRM", "PaperSafePRM", "PaperPRM", as_printed=True),
    Pair("PRM", "SafePRM", "ClassicPRM"),
    Pair("RRT-Connect", "PaperSafeRRTConnect", "PaperRRTConnect", as_printed=True),
    Pair("RRT-Connect", "SafeRRTConnect", "ClassicRRTConnect"),
    Pair("JT-RRT", "PaperSafeJTRRT", "PaperJTRRT", as_printed=True),
    Pair("JT-RRT", "SafeJTRRT", "ClassicJTRRT"),
)

_NONE = float("nan")
STUDIES = (
    Study(
        1,
        "paper_1",
        {  # Table I
            "Bubbles": (Effort(3.1668, 545, 5268, _NONE), Effort(0.2808, 181, 550, 206)),
            "PRM": (Effort(0.8076, 106, 1545, _NONE), Effort(0.8427, 90, 1597, 268)),
            "RRT-Connect": (Effort(0.1387, 28, 359, _NONE), Effort(0.1636, 19, 379, 46)),
            "JT-RRT": (Effort(0.1604, 103, 328, _NONE), Effort(0.1583, 40, 309, 63)),
        },
    ),
    Study(
        2,
        "paper_2",
        {  # Table II
            "Bubbles": (Effort(1.6640, 474, 2093, _NONE), Effort(1.4040, 436, 1778, 454)),
            "PRM": (Effort(2.3915, 86, 6599, _NONE), Effort(1.8768, 90, 6259, 265)),
            "RRT-Connect": (Effort(0.7296, 54, 2526, _NONE), Effort(0.6280, 39, 2427, 84)),
            "JT-RRT": (Effort(0.7221, 127, 2071, _NONE), Effort(0.4267, 37, 1124, 47)),
        },
    ),
)


def with_crossed(pairs: Sequence[Pair]) -> list[Pair]:
    """Return pairs, and after those of a family the one of our safe planner and the classical one as printed."""
    found = []
    for label in dict.fromkeys(pair.label for pair in pairs):
        family = [pair for pair in pairs if pair.label == label]
        printed, ours = (next((p for p in family if p.as_printed is form), None) for form in (True, False))
        found += family
        if printed and ours:
            found.append(replace(ours, classic=printed.classic, against_print=True))
    return found


def chosen_pairs(planners: Collection[str] = ()) -> tuple[Pair, ...]:
    """Return the pairs of planners that exist and, if any are named, of which one is named."""
    known = planner_names()
    exist = (pair for pair in PAIRS if pair.safe in known and pair.classic in known)
    return tuple(pair for pair in exist if not planners or set(pair.planners) & set(planners))
