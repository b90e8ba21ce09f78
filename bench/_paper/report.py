"""The report of the case studies as a Markdown page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from _paper.claims import CLAIMS, Claim
from _paper.effort import MEASURE, STEP, Hardness
from _paper.evidence import Evidence
from _paper.figures import STUDY_FIGURES
from _paper.random_scenes import RandomStudy, random_section
from _paper.smoothed import Smoothed
from _paper.smoothed_page import smoothing_section
from _paper.tables import effort_table, markdown_table, printed_table, ratio_table
from safe_ompl.scene.scenario import Scenario

_PREAMBLE = """# Safety-oriented path planning for articulated robots: the studies run again

After B. Lacevic, P. Rocco, *Safety-oriented path planning for articulated robots*, Robotica 2013. There are four
columns of planners. "PaperSafe…" and "Paper…" are the safe and the classical planner exactly as printed, held to
literal transcriptions of the pseudocode in the tests; their α, β, K, p_g and gains, which the paper does not give,
stand in the scenario files. The others are ours: the safe planners in the form that is meant for use, and "Classic…",
the same with danger switched off. Numbers are means over the solved runs, as in the paper. Its scenes are not
published: ours were chosen among random variants of two layouts, for the effort of the classical planners and for a
clear effect of safety. They show what can be had, not what is to be expected everywhere: the other scenarios and the
MotionBenchMaker problems do that. A check is one query of the whole robot: boolean, with or without margins (a
certified motion asks a few of them where the paper samples), or of distances (bubbles). Bubble planners are
deterministic and run once.
"""


def write_report(
    file: Path,
    evidence: Sequence[Evidence],
    scenarios: Sequence[Scenario],
    hardness: Sequence[Hardness],
    smoothed: Sequence[Smoothed],
    at_random: RandomStudy,
    ideas: Mapping[str, str],
) -> None:
    """Write the page in Markdown; pictures are named relative to it.

    Parameters
    ----------
    file : path
        Where to.
    evidence : sequence of Evidence
        Of each study; its pictures are in the folder ``study_N``.
    scenarios : sequence of Scenario
        Of each study.
    hardness : sequence of Hardness
        Of each study.
    smoothed : sequence of Smoothed
        Of each study, if paths were smoothed.
    at_random : RandomStudy
        The study of random scenes.
    ideas : mapping of str to str
        Further pictures and their captions.
    """
    parts = [_PREAMBLE, claims_section(evidence), targets_section(evidence)]
    parts += [smoothing_section(smoothed)] if smoothed else []
    parts += [_study_section(*one) for one in zip(evidence, scenarios, hardness, strict=True)]
    parts.append(random_section(at_random))
    if ideas:
        parts.append("## Ideas\n\n" + "\n\n".join(_picture(name, words) for name, words in ideas.items()))
    file.write_text("\n\n".join(part.strip() for part in parts) + "\n", encoding="utf-8")


def claims_section(evidence: Sequence[Evidence]) -> str:
    """Return the list of the paper's claims with verdicts, and below each what it rests on."""
    lines = ["## The paper's claims", ""]
    for k, claim in enumerate(CLAIMS, 1):
        printed, of_printed = claim.verdict(evidence, as_printed=True)
        ours, of_ours = claim.verdict(evidence, as_printed=False)
        verdicts = f"**as printed: {printed}; ours: {ours}**"
        lines.append(f"{k}. {claim.text} *({claim.place})* — {verdicts} {_figures(claim, evidence)}")
        lines += [f"   - {'✓' if f.holds else '✗'} {f.subject}: {f.number}" for f in of_printed + of_ours]
    return "\n".join(lines)


def targets_section(evidence: Sequence[Evidence]) -> str:
    """Return how we compare with the paper's ratios, pair by pair."""
    rows = []
    for study in evidence:
        for pair in study.pairs:
            ours, printed = study.effort_ratio(pair), study.printed_ratio(pair)
            runs = [study.summaries[name] for name in pair.planners]
            rows.append(
                (
                    f"study {study.study.number}, {pair.title}",
                    "/".join(f"{summary.solved / summary.runs:.0%}" for summary in runs),
                    f"{ours.time:.2f}",
                    f"{printed.time:.2f}",
                    f"{study.danger_ratio(pair):.2f}",
                )
            )
    header = ("safe / classic", "solved", "time", "time in the paper", "mean danger")
    return "## Ratios at a glance\n\n" + markdown_table(header, rows)


def _study_section(evidence: Evidence, scenario: Scenario, hardness: Hardness) -> str:
    number = evidence.study.number
    printed = evidence.study.printed["RRT-Connect"][0]
    parts = [
        f"## Study {number}: {scenario.name}",
        scenario.description,
        f"How hard it is: with edges sampled every {STEP} rad, as is usual, {MEASURE} needs "
        f"{hardness.nodes:.0f} nodes and {hardness.checks:.0f} checks here; in the paper {printed.nodes} and "
        f"{printed.checks}. The danger of a configuration costs as much as {hardness.value:.1f} checks here, with its "
        f"gradient {hardness.gradient:.1f}: this is what safe planners have to save.",
        f"Table {'I' * number}, our numbers:",
        effort_table(evidence),
        'Safe divided by classical; in brackets the paper\'s. "Ours / printed" is our safe planner against the '
        "classical one as printed:",
        ratio_table(evidence),
        "The paper prints:",
        printed_table(evidence),
    ]
    for figure in STUDY_FIGURES:
        caption = f"After Fig. {figure.after[number - 1]}: {figure.caption}"
        parts.append(_picture(f"study_{number}/{figure.file}", caption))
    return "\n\n".join(parts)


def _figures(claim: Claim, evidence: Sequence[Evidence]) -> str:
    return " ".join(
        f"[study {e.study.number}](study_{e.study.number}/{claim.figure})"
        for e in evidence
        if any(True for _ in claim.findings(e))
    )


def _picture(file: str, caption: str) -> str:
    return f"![{caption}]({file})\n\n*{caption}.*"
