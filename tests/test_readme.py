"""The examples of the README run as they stand, and the table of commands is complete."""

from __future__ import annotations

import json
import pickle
import re
from difflib import ndiff
from typing import Any

import pytest
from snippets import ROOT, python_of

from safe_ompl import UnknownNameError
from safe_ompl.apps.cli.program import command_line

README = ROOT / "README.md"
COMMANDS = (ROOT / "docs" / "index.md").read_text(encoding="utf-8").split("## Commands")[1]


def test_the_python_of_the_readme_runs_from_top_to_bottom(capsys):
    names: dict[str, Any] = {}
    exec(python_of(README), names)
    assert names["result"].report.certified
    assert names["fixed"]


def test_three_lines_change_and_the_diff_is_that_of_the_two_scripts():
    before, after = ((ROOT / f"tests/examples/{name}.py").read_text(encoding="utf-8") for name in ("plain", "safe"))
    shown = re.findall(r"```diff\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)[0].splitlines()
    changes = [line for line in ndiff(before.splitlines(), after.splitlines()) if line[0] in "+-"]
    assert sorted(shown) == sorted(line[0] + line[2:] for line in changes)
    assert sorted(line[0] for line in changes) == 3 * ["+"] + 3 * ["-"]


def test_commands_of_the_table_exist(capsys):
    rows = COMMANDS.split("\n\n")[1].splitlines()[2:]
    command = ""
    for row in rows:
        known = re.match(r"\| `safe-ompl ([a-z]+)", row)
        command = known[1] if known else command
        with pytest.raises(SystemExit):
            command_line().parse_args([*command.split(), "--help"])
        words = capsys.readouterr().out
        assert all(option in words for option in re.findall(r"--[a-z-]+", row)), row


def test_the_table_names_all_commands_and_the_readme_planners_that_exist():
    from safe_ompl import planner_names

    text = README.read_text(encoding="utf-8")
    assert len(text.split()) <= 900
    commands = re.findall(r"^    (\w+)(?: |$)", command_line().format_help(), re.MULTILINE)
    assert len(commands) > 12
    assert set(commands) <= set(re.findall(r"`(?:safe-ompl )?(\w+)", COMMANDS))
    named = re.findall(r"`((?:Safe|Classic|Bubble)(?!Setup)\w+)`", text)
    assert len(named) > 3
    assert set(named) <= set(planner_names())


def test_no_measured_path_has_a_contact_after_proof_and_repair():
    assert "after which no path has a contact" in " ".join(README.read_text(encoding="utf-8").split())
    table = json.loads((ROOT / "docs" / "measured" / "peers.json").read_text(encoding="utf-8"))["tables"][0]
    column = table["header"].index("contacts")
    contacts = {row[0]: row[column] for row in table["rows"] if row[0].endswith(" + our proof and repair")}
    assert {f"{row[0]} + our proof and repair" for row in table["rows"] if row[column]} <= set(contacts)
    assert set(contacts.values()) == {0}


def test_errors_reach_other_processes():
    error = UnknownNameError("joint", "elbow", ("hip", "knee"), "arm.urdf")
    assert str(pickle.loads(pickle.dumps(error))) == str(error)
