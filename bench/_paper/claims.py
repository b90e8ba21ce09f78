"""The claims of the paper, each with a verdict of our runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import isnan
from operator import attrgetter

from _paper.evidence import Evidence, quotient
from _paper.studies import Pair

_ALIKE = (
    1.25  # ratio of mean times up to which they show "no substantial difference"; the paper's largest is 1.18
)
_CLASSIC, _SAFE = attrgetter("classic"), attrgetter("safe")


@dataclass(frozen=True)
class Finding:
    """One measurement that a claim rests on.

    Attributes
    ----------
    subject : str
        Study and planners.
    number : str
        What was measured, in words.
    holds : bool
        Whether it bears the claim out.
    as_printed : bool
        Whether it is of the planners as printed.
    """

    subject: str
    number: str
    holds: bool
    as_printed: bool = False


@dataclass(frozen=True)
class Claim:
    """A sentence of the paper that can be checked.

    Attributes
    ----------
    text : str
        What it says.
    place : str
        Where the paper says it.
    figure : str
        Picture that shows it: the end of a file name in the folder of each study.
    findings : callable
        From the evidence of one study to what bears on the claim.
    """

    text: str
    place: str
    figure: str
    findings: Callable[[Evidence], Iterator[Finding]]

    def verdict(self, evidence: Sequence[Evidence], *, as_printed: bool) -> tuple[str, list[Finding]]:
        """Return "confirmed", "refuted", "in part" or "not measured", and what that rests on, for one form."""
        every = (finding for study in evidence for finding in self.findings(study))
        found = [finding for finding in every if finding.as_printed == as_printed]
        held = sum(finding.holds for finding in found)
        if not found:
            return "not measured", found
        return "confirmed" if held == len(
            found
        ) else "refuted" if not held else f"in part ({held} of {len(found)})", found


def _compared(
    measure: Callable[[Evidence, Pair], float],
    words: str,
    limit: float = 1.0,
    studies: Sequence[int] = (1, 2),
    random_only: bool = False,
) -> Callable[[Evidence], Iterator[Finding]]:
    """Return findings on a ratio safe/classic of every pair, which should be below a limit."""

    def findings(evidence: Evidence) -> Iterator[Finding]:
        for pair in evidence.pairs:
            concerned = evidence.study.number in studies and not (random_only and pair.deterministic)
            if concerned and not isnan(ratio := measure(evidence, pair)):  # one run has no spread
                subject = f"study {evidence.study.number}, {pair.title}"
                yield Finding(subject, f"{words} {ratio:.2f}", ratio < limit, pair.as_printed)

    return findings


def _band_ratio(evidence: Evidence, pair: Pair) -> float:
    return quotient(evidence.band_width(pair.safe), evidence.band_width(pair.classic))


def _spread_ratio(evidence: Evidence, pair: Pair) -> float:
    return quotient(evidence.time_spread(pair.safe), evidence.time_spread(pair.classic))


def _bubbles_safest(evidence: Evidence) -> Iterator[Finding]:
    for as_printed in (True, False):
        safe = {pair.safe: pair.label for pair in evidence.pairs if pair.as_printed == as_printed}
        if "Bubbles" in safe.values() and len(safe) > 1:
            ranked = sorted(safe, key=evidence.danger)
            words = ", ".join(f"{name} {evidence.danger(name):.2f}" for name in ranked)
            yield Finding(f"study {evidence.study.number}", words, safe[ranked[0]] == "Bubbles", as_printed)


def _faster(quick: str, slow: str, role: Callable[[Pair], str]) -> Callable[[Evidence], Iterator[Finding]]:
    """Return findings on the mean times of two families, of which one should be quicker, in each of their forms."""

    def findings(evidence: Evidence) -> Iterator[Finding]:
        for as_printed in (True, False):
            names = {pair.label: role(pair) for pair in evidence.pairs if pair.as_printed == as_printed}
            if {quick, slow} <= set(names):
                one, other = names[quick], names[slow]
                times = [float(evidence.times(name).mean()) for name in (one, other)]
                words = f"{one} {1e3 * times[0]:.1f} ms, {other} {1e3 * times[1]:.1f} ms"
                yield Finding(f"study {evidence.study.number}", words, times[0] < times[1], as_printed)

    return findings


def _each(*parts: Callable[[Evidence], Iterator[Finding]]) -> Callable[[Evidence], Iterator[Finding]]:
    def findings(evidence: Evidence) -> Iterator[Finding]:
        for part in parts:
            yield from part(evidence)

    return findings


CLAIMS = (
    Claim(
        "Safe planners yield less dangerous paths than their classical counterparts.",
        "Figs. 7, 11",
        "profiles.png",
        _compared(Evidence.danger_ratio, "mean danger ×"),
    ),
    Claim(
        "The danger profiles of safe planners deviate less from run to run.",
        "Figs. 8, 12",
        "bands.png",
        _compared(_band_ratio, "15–85 % band ×", random_only=True),
    ),
    Claim(
        "The safe bubble planner yields the safest path of all.",
        "Figs. 7, 11; §5.1",
        "profiles.png",
        _bubbles_safest,
    ),
    Claim(
        "In study 1 the times of safe and classical planners do not differ substantially.",
        "Fig. 9",
        "times.png",
        _compared(lambda e, pair: e.effort_ratio(pair).time, "mean time ×", _ALIKE, (1,), random_only=True),
    ),
    Claim(
        "In study 2 safe planners need less time.",
        "Fig. 13, Table II",
        "times.png",
        _compared(lambda e, pair: e.effort_ratio(pair).time, "mean time ×", studies=(2,)),
    ),
    Claim(
        "In study 2 the times of safe planners deviate less.",
        "Fig. 13",
        "times.png",
        _compared(_spread_ratio, "interquartile range ×", studies=(2,), random_only=True),
    ),
    Claim(
        "Safe planners need fewer nodes: they explore where it is less cluttered.",
        "§5.1, Tables I, II",
        "times.png",
        _compared(lambda e, pair: e.effort_ratio(pair).nodes, "nodes ×"),
    ),
    Claim(
        "Safe planners need fewer collision checks or distance computations.",
        "§5.1, Tables I, II",
        "times.png",
        _compared(lambda e, pair: e.effort_ratio(pair).checks, "checks ×"),
    ),
    Claim(
        "The planners based on RRTs are faster than those based on PRMs.",
        "§5.1",
        "times.png",
        _each(
            _faster("RRT-Connect", "PRM", _CLASSIC),
            _faster("RRT-Connect", "PRM", _SAFE),
            _faster("JT-RRT", "PRM", _SAFE),
        ),
    ),
    Claim(
        "SAFE_RRT-Connect and SAFE_JT-RRT are faster than the safe bubble planner.",
        "§5.1",
        "times.png",
        _each(_faster("RRT-Connect", "Bubbles", _SAFE), _faster("JT-RRT", "Bubbles", _SAFE)),
    ),
)
