"""What pages and notebooks show: Python, and commands; for the tests, and for `.ci/environments`."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

ROOT = Path(__file__).parent.parent
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))


def python_of(file: Path) -> str:
    """Return the Python of a page or a notebook, from top to bottom."""
    text = file.read_text(encoding="utf-8")
    if file.suffix == ".ipynb":
        cells = json.loads(text)["cells"]
        return "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    return "\n".join(re.findall(r"```python\n(.*?)```", text, re.DOTALL))


def supported_versions() -> dict[str, tuple[str, str]]:
    """Return the table of supported versions in CONTRIBUTING.md: of each package the oldest, and the first too new."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\w+).*? \| ([\d.]+) \| ([\d.]*) ?\| (?:`(\w+)` )?\|$", text, re.MULTILINE)
    return {(package or name).lower(): (low, below) for name, low, below, package in rows}


def commands_of(text: str) -> list[list[str]]:
    """Return the words of the commands that a page shows, from `safe-ompl` or `python examples/…` on."""
    lines = re.findall(r"^(?:    |\$ )(.*)$", text, re.MULTILINE)
    parts = (part.strip() for line in lines for part in line.partition("  #")[0].split("&&"))
    shown = r"(?:\.venv/bin/)?(safe-ompl .*|python examples/.*)"
    return [shlex.split(found[1]) for part in parts if (found := re.fullmatch(shown, part))]
