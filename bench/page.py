"""The page of measurements, docs/measured.md, from the files in docs/measured.

    python -m bench page [--check]
    python -m bench NAME ... --json docs/measured/FILE.json    measures a part of the page anew

A file has the command, its date, and what it found: tables and figures, as `--json` writes them. `title`, `about` and
the sentences of `claims` are written by hand, and stay when something is measured anew. What was measured before there
were such files is marked as recorded; its claims have a result in words, it and its tables may have `notes`.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from bench._harness import Report, markdown_table, said

CLAIM = "each figure of docs/measured.md comes from a file that says which command found it, and when"
FOLDER = Path(__file__).parents[1] / "docs" / "measured"
PAGE = FOLDER.with_suffix(".md")
ORDER = (  # of the page; files with claims only have no section
    *(
        "certify",
        "certify_danger",
        "motion",
        "motion_many",
        "motions",
        "motions_time",
        "motions_repair",
        "motions_tubes",
        "stops",
    ),
    *("stops_contact", "stops_motions", "mutations", "timing", "field", "scaling", "scaling_nodes", "scaling_runs"),
    *("setup", "simplify", "hard", "clearances", "paper", "smoothing", "worth", "live", "shield"),
    *("physics", "physics_contact", "physics_live", "tools"),
)
CLAIMS_ONLY = ("motion_many", "hard", "worth", "tools")  # whose tables no other page needs: they stand in the files
INTRODUCTION = """# What was measured

Ratios of two things run in turn in one process, and counts, with the commands that print them again. Times are CPU
times of one core of an AMD EPYC; ranges go from idle to busy. `python -m bench NAME --help` says what a bench backs.
`python -m bench page` makes this page of the files in `docs/measured`, which hold more tables. The mark r says that
the figures were written down by hand, from an earlier run of the command or of the bench that it replaced.
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--check", action="store_true", help="say whether the page is up to date instead")


def main(options: argparse.Namespace, report: Report) -> int:
    """Write or check the page."""
    text = page(FOLDER)
    if options.check:
        if PAGE.read_text(encoding="utf-8") != text:
            print(f"{PAGE} is not up to date: python -m bench page", file=sys.stderr)
            return 1
    else:
        PAGE.write_text(text, encoding="utf-8")
    return 0


def page(folder: Path) -> str:
    """Return the page."""
    contents = [json.loads((folder / f"{name}.json").read_text(encoding="utf-8")) for name in ORDER]
    unknown = {file.stem for file in folder.glob("*.json")} - set(ORDER)
    if unknown:
        raise ValueError(f"bench/page.py does not know the order of {', '.join(sorted(unknown))}")
    claims = "\n".join(
        f"* {row['claim']}: **{row.get('result') or _figures(content)}** "
        f"({_command(content).replace('python -m bench ', '')})"
        for content in contents
        for row in content.get("claims", ())
    )
    parts = [INTRODUCTION, "## Claims", "Each with its `python -m bench …`:", claims]
    for name, content in zip(ORDER, contents, strict=True):
        if name not in CLAIMS_ONLY and (content.get("tables") or content.get("about")):
            parts += _section(content)
    return "\n\n".join(part.strip() for part in parts) + "\n"


def _section(content: dict[str, Any]) -> list[str]:
    title = content.get("title")
    parts = [f"## {title}" if title else "", content.get("about", ""), _command(content)]
    if not content.get("recorded") and not content.get("claims"):
        parts.append(_figures(content))
    for table in content.get("tables", ()):
        parts += [f"**{table['title']}**" if table.get("title") else ""]
        parts += [markdown_table(table["header"], table["rows"]), *table.get("notes", ())]
    return [part for part in (*parts, *content.get("notes", ())) if part]


def _command(content: dict[str, Any]) -> str:
    return f"`{content['command']}`, {content['date']}{', r' if content.get('recorded') else ''}"


def _figures(content: dict[str, Any]) -> str:
    return "; ".join(f"{name}: {said(value)}" for name, value in content.get("figures", {}).items())
