"""The scripts in examples/ are short and run as they stand."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent.parent / "examples"
SCRIPTS = sorted(FOLDER.glob("*.py"))
ADAPTERS = sorted((FOLDER / "adapters").glob("*.py"))


@pytest.mark.parametrize("script", [*SCRIPTS, *ADAPTERS], ids=lambda script: script.stem)
def test_it_is_short_and_runs(script, tmp_path):
    text = script.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 40
    for package in re.findall(r"\(pip install (\w+)\)", text):
        pytest.importorskip(package, reason=f"{script.name} needs {package}, which is not installed here")
    run = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, timeout=120, cwd=tmp_path, check=False
    )
    assert run.returncode == 0, run.stderr
    assert run.stdout
    assert "Traceback" not in run.stderr


def test_the_list_of_examples_is_complete():
    listed = re.findall(r"\]\(([\w/]+\.py)\)", (FOLDER / "README.md").read_text(encoding="utf-8"))
    found = [script.relative_to(FOLDER).as_posix() for script in (*SCRIPTS, *ADAPTERS)]
    assert sorted(listed) == sorted(found)
    assert len(SCRIPTS) == 11
