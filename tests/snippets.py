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


def commands_of(text: str) -> list[list[str]]:
    """Return the words of the commands that a page shows, from `safe-ompl` or `python examples/…` on."""
    lines = re.findall(r"^(?:    |\$ )(.*)$", text, re.MULTILINE)
    parts = (part.strip() for line in lines for part in line.partition("  #")[0].split("&&"))
    shown = r"(?:\.venv/bin/)?(safe-ompl .*|python examples/.*)"
    return [shlex.split(found[1]) for part in parts if (found := re.fullmatch(shown, part))]
