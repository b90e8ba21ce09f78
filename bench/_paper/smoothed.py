"""Statistics of safety after smoothing: the same runs before and after, safe planners against classical ones."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import exp, hypot, inf, isnan, nan, sqrt
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from _paper.evidence import Evidence, quotient
from _paper.smoothing import Smoothing
from _paper.studies import Pair, Study
from safe_ompl.apps.benchmark.campaign import Summary
from safe_ompl.apps.benchmark.runs import Run
from safe_ompl.common import FloatArray
from safe_ompl.paths.measures import DangerReport
from safe_ompl.paths.report import PathReport
from safe_ompl.planning.result import PlanResult

_NORMAL = 1.96  # standard errors on each side of a mean that make its 95 % interval
_LEFT = (  # share of the gap between safe and classical that smoothing leaves, at most: what becomes of the gap
    (0.05, "closes"),
    (1 / 3, "nearly closes"),
    (0.8, "narrows"),
    (1.2, "stays as it was"),
    (inf, "widens"),
)


class Quantity(NamedTuple):
    """Something that is measured of every run: its name, how many decimals are of interest, and its unit."""

    name: str
    of: Callable[[PlanResult, PathReport], float]
    digits: int
    unit: str = ""

    @property
    def heading(self) -> str:
        """What stands above its column."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


def _danger(report: PathReport) -> DangerReport:
    assert report.danger is not None  # both studies are planned with danger
    return report.danger


MEAN = Quantity("mean danger", lambda result, report: _danger(report).mean, 2)
PEAK = Quantity("peak", lambda result, report: _danger(report).max, 2)
INTEGRAL = Quantity("integral", lambda result, report: _danger(report).integral, 1)
AVOIDABLE = Quantity("avoidable", lambda result, report: _danger(report).avoidable, 2)
CLEARANCE = Quantity("min clearance", lambda result, report: 1e3 * report.clearance.min, 1, "mm")
LENGTH = Quantity("length", lambda result, report: report.length, 2, "rad")
TIME = Quantity("time", lambda result, _: 1e3 * (result.planning_time + result.simplification_time), 0, "ms")
QUANTITIES = (MEAN, PEAK, INTEGRAL, AVOIDABLE, CLEARANCE, LENGTH, TIME)


class Ratio(NamedTuple):
    """A ratio of means, and its 95 % interval."""

    value: float
    low: float
    high: float

    @classmethod
    def of(cls, above: FloatArray, below: FloatArray, *, exact: bool = False) -> Ratio:
        """Return mean(above)/mean(below), both positive; `exact` samples say it all, of others one says nothing."""
        value = float(above.mean() / below.mean())
        error = 0.0 if exact else hypot(_relative_error(above), _relative_error(below))
        return cls(value, value * exp(-_NORMAL * error), value * exp(_NORMAL * error))


def _relative_error(values: FloatArray) -> float:
    """Return the standard error of a mean, divided by the mean."""
    spread = float(values.std(ddof=1)) if len(values) > 1 else inf
    return spread / (sqrt(len(values)) * float(values.mean()))


@dataclass(frozen=True)
class Smoothed:
    """The runs of one study, with their paths as planned and smoothed.

    Attributes
    ----------
    study : Study
        Which one.
    pairs : tuple of Pair
        Those of which both planners solved a run.
    evidence : mapping of Smoothing to Evidence
        What was done with the paths → what they show. The runs are the same.
    """

    study: Study
    pairs: tuple[Pair, ...]
    evidence: Mapping[Smoothing, Evidence]

    @classmethod
    def of(
        cls, study: Study, pairs: Sequence[Pair], results: Mapping[Smoothing, Sequence[PlanResult]]
    ) -> Smoothed:
        """Look at the runs whose paths were simplified, and at the same ones otherwise."""
        done = {_run(result) for result in results[Smoothing.SIMPLIFIED]}
        evidence = {
            kind: Evidence.of(study, pairs, [one for one in own if _run(one) in done])
            for kind, own in results.items()
        }
        both = set(evidence[Smoothing.PLANNED].pairs) & set(evidence[Smoothing.SIMPLIFIED].pairs)
        return cls(study, tuple(pair for pair in pairs if pair in both), evidence)

    def of_form(self, *, as_printed: bool) -> Smoothed:
        """Return the study with the pairs as printed only, or with ours only."""
        return replace(self, pairs=tuple(pair for pair in self.pairs if pair.as_printed == as_printed))

    def values(self, quantity: Quantity, planner: str, smoothing: Smoothing) -> FloatArray:
        """Return a quantity for every solved run of a planner."""
        own = self.evidence[smoothing].results.get(planner, ())
        return np.array([quantity.of(one, one.report) for one in own if one.report is not None])

    def mean(self, quantity: Quantity, planner: str, smoothing: Smoothing) -> float:
        """Return the mean over the solved runs; NaN if there are none."""
        values = self.values(quantity, planner, smoothing)
        return float(values.mean()) if len(values) else nan

    def ratio(self, quantity: Quantity, pair: Pair, smoothing: Smoothing) -> float:
        """Return safe divided by classical; NaN where the classical mean is zero."""
        classic, safe = (self.mean(quantity, name, smoothing) for name in pair.planners)
        return quotient(safe, classic)

    def danger_ratio(self, pair: Pair, smoothing: Smoothing) -> Ratio:
        """Return safe divided by classical of the mean danger."""
        classic, safe = (self.values(MEAN, name, smoothing) for name in pair.planners)
        return Ratio.of(safe, classic, exact=pair.deterministic)

    def summary(self, planner: str, smoothing: Smoothing) -> Summary:
        """Return the summary of a planner's runs."""
        return self.evidence[smoothing].summaries[planner]


def _run(result: PlanResult) -> Run:
    return Run(result.planner, result.seed)


# ----------------------------------------------------------------------------------------------- the answer

_CLASSIC, _SAFE = attrgetter("classic"), attrgetter("safe")
_Cases = Sequence[tuple[Smoothed, Pair]]


def answer(studies: Sequence[Smoothed]) -> str:
    """Return in words whether safe planning still wins after smoothing, and what is left of it."""
    cases = [(study, pair) for study in studies for pair in study.pairs]
    if not cases:
        return "Not measured: there is no pair of planners that both solved a run."
    return f"{_verdict(cases)}\n\n- {_remains(cases)}\n- {_usual(cases)}"


def _verdict(cases: _Cases) -> str:
    before, after = (
        [study.danger_ratio(pair, kind) for study, pair in cases]
        for kind in (Smoothing.PLANNED, Smoothing.SIMPLIFIED)
    )
    wins, losses = sum(ratio.high < 1.0 for ratio in after), sum(ratio.low > 1.0 for ratio in after)
    if not wins:
        word = "No" if losses else "No difference beyond chance"
    else:
        word = "Yes" if wins == len(after) else "In part"
    return (
        f"**{word}{_gap(before, after)}: after danger-aware simplification the mean danger of safe planners' paths is "
        f"{_span(a.value for a in after)} × that of their classical counterparts', as planned it is "
        f"{_span(b.value for b in before)} ×.** By more than chance explains (95 %) it is lower in {wins} of "
        f"{len(after)} comparisons, higher in {losses or 'none'}."
    )


def _gap(before: Sequence[Ratio], after: Sequence[Ratio]) -> str:
    """Return what smoothing makes of the gap, in the median of the comparisons in which there was one."""
    left = [(1.0 - a.value) / (1.0 - b.value) for b, a in zip(before, after, strict=True) if b.value < 1.0]
    if not left:
        return ""
    share = float(np.median(left))
    words = next(words for most, words in _LEFT if share <= most)
    return f"; the gap {words} ({100 * share:.0f} % of it is left)"


def _remains(cases: _Cases) -> str:
    changes = ", ".join(_change(quantity, cases) for quantity in (PEAK, INTEGRAL, CLEARANCE, LENGTH, TIME))
    classic, safe = (
        _span(study.mean(AVOIDABLE, planner(pair), Smoothing.SIMPLIFIED) for study, pair in cases)
        for planner in (_CLASSIC, _SAFE)
    )
    return (
        f"Safe / classical, simplified (as planned): {changes}. Avoidable danger, simplified: {safe} against "
        f"{classic}; {_success(cases)}."
    )


def _change(quantity: Quantity, cases: _Cases) -> str:
    planned, simplified = (
        _span(study.ratio(quantity, pair, kind) for study, pair in cases)
        for kind in (Smoothing.PLANNED, Smoothing.SIMPLIFIED)
    )
    return f"{quantity.name} {simplified} ({planned})"


def _success(cases: _Cases) -> str:
    shares = []
    for planner in (_CLASSIC, _SAFE):
        found = [study.summary(planner(pair), Smoothing.SIMPLIFIED) for study, pair in cases]
        shares.append(sum(summary.solved for summary in found) / sum(summary.runs for summary in found))
    if min(shares) == 1.0:
        return "every run solved"
    return f"solved {100 * shares[1]:.1f} % against {100 * shares[0]:.1f} %"


def _usual(cases: _Cases) -> str:
    """Return what smoothing makes of classical paths: as is usual, and with danger in mind."""
    usual, aware = (_times(cases, kind, _CLASSIC) for kind in (Smoothing.SHORTENED, Smoothing.SIMPLIFIED))
    clearance = _span((s.mean(CLEARANCE, pair.classic, Smoothing.SHORTENED) for s, pair in cases), 1)
    return (
        f"Classical paths alone: OMPL's simplifier, as is usual, makes their mean danger {usual} × what it was (and "
        f"leaves a clearance of {clearance} mm), danger-aware simplification {aware} ×. That is "
        f"{_times(cases, Smoothing.SIMPLIFIED, _SAFE)} × what safe planners' paths have as planned."
    )


def _times(cases: _Cases, smoothing: Smoothing, planner: Callable[[Pair], str]) -> str:
    """Return the mean danger of smoothed classical paths, divided by that of a planner's paths as planned."""
    return _span(
        study.mean(MEAN, pair.classic, smoothing) / study.mean(MEAN, planner(pair), Smoothing.PLANNED)
        for study, pair in cases
    )


def _span(values: Iterable[float], digits: int = 2) -> str:
    """Write the range of values, without those that are not there."""
    known = [value for value in values if not isnan(value)]
    if not known:
        return "–"
    return "–".join(dict.fromkeys(f"{value:.{digits}f}" for value in (min(known), max(known))))
