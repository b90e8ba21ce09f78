"""Tables I and II of the paper in Markdown: our numbers, and the ratios safe/classic beside the paper's."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import isnan

from _paper.evidence import Evidence
from _paper.studies import Effort, Pair, with_crossed

_HEAD = ("", "solved", "time [ms]", "nodes", "checks", "field evaluations", "mean danger")
_RATIOS = ("safe / classic", "time", "nodes", "checks", "mean danger", "15–85 %")


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown, numbers to the right."""
    lines = [header, ["---"] + ["---:"] * (len(header) - 1), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def effort_table(evidence: Evidence) -> str:
    """Return the study's table: what each planner needed, and how dangerous its paths are."""
    return markdown_table(_HEAD, [_effort_row(evidence, name) for name in evidence.summaries])


def printed_table(evidence: Evidence) -> str:
    """Return what the paper prints, in the same columns."""
    header = ("", "time [ms]", "nodes", "checks", "field evaluations")
    rows = []
    for label in dict.fromkeys(pair.label for pair in evidence.pairs):
        for role, effort in zip(("classical", "safe"), evidence.study.printed[label], strict=True):
            rows.append((f"{label}, {role}", *_effort_cells(effort)))
    return markdown_table(header, rows)


def ratio_table(evidence: Evidence) -> str:
    """Return the ratios safe/classic, the paper's in brackets; ours also against the classical one as printed."""
    return markdown_table(_RATIOS, [_ratio_row(evidence, pair) for pair in with_crossed(evidence.pairs)])


def _effort_row(evidence: Evidence, name: str) -> tuple[str, ...]:
    summary = evidence.summaries[name]
    solved = f"{summary.solved}/{summary.runs}"
    if not summary.solved:
        return name, solved, *["–"] * (len(_HEAD) - 2)
    return name, solved, *_effort_cells(evidence.effort(name)), f"{evidence.danger(name):.2f}"


def _effort_cells(effort: Effort) -> tuple[str, ...]:
    field = "–" if isnan(effort.field) or not effort.field else f"{effort.field:.0f}"
    return f"{1e3 * effort.time:.1f}", f"{effort.nodes:.0f}", f"{effort.checks:.0f}", field


def _ratio_row(evidence: Evidence, pair: Pair) -> tuple[str, ...]:
    ours, printed = evidence.effort_ratio(pair), evidence.printed_ratio(pair)
    low, high = evidence.danger_ratio_band(pair)
    return (
        pair.title,
        *(f"{mine:.2f} ({theirs:.2f})" for mine, theirs in zip(ours[:3], printed[:3], strict=True)),
        f"{evidence.danger_ratio(pair):.2f}",
        f"{low:.2f}–{high:.2f}",
    )
