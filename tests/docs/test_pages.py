"""The pages in docs/: their Python runs, their links lead somewhere, and all of them are in the site."""

from __future__ import annotations

import contextlib
import io
import pydoc
import re
import subprocess
import sys

import pytest
import yaml
from snippets import PAGES, ROOT, commands_of, python_of

import safe_ompl
from safe_ompl.apps.cli.program import command_line

LINK = re.compile(r"\]\(([^)\s]+)\)")


@pytest.mark.parametrize("page", [page for page in PAGES[1:] if python_of(page)], ids=lambda page: page.stem)
def test_the_python_of_a_page_runs_from_top_to_bottom(page, monkeypatch, tmp_path):
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)  # what a page writes, such as OMPL's console file, stays there
    names: dict = {}
    with contextlib.redirect_stdout(io.StringIO()):
        exec(compile(python_of(page), page.name, "exec"), names)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_lead_somewhere(page):
    for link in LINK.findall(page.read_text(encoding="utf-8")):
        if link.startswith("https://"):
            continue
        name, _, anchor = link.partition("#")
        target = page.parent / name if name else page
        assert target.exists(), f"{page.name}: {link}"
        if anchor:
            headings = re.findall(r"^#+ (.*)$", target.read_text(encoding="utf-8"), re.MULTILINE)
            assert anchor in {anchor_of(heading) for heading in headings}, f"{page.name}: {link}"


def anchor_of(heading):
    """Return the anchor that the site gives to a heading."""
    return re.sub(r"[\s-]+", "-", re.sub(r"[^\w\s-]", "", heading.lower()).strip())


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_files_and_modules_that_a_page_names_exist(page):
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for name in re.findall(r"`((?!resources/)(?:\w+/)+(?:\w+\.py)?)`", text):  # resources/: of another repository
        known = (ROOT / name).exists() or any((ROOT / "safe_ompl").rglob(name))
        assert known, f"{page.name}: {name}"
    for name in re.findall(r"\bsafe_ompl(?:\.\w+)+", text):
        assert pydoc.locate(name) is not None, f"{page.name}: {name}"


def test_the_architecture_page_has_the_packages_in_order_of_their_layers():
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    table = text.split("| package |")[1].split("\n\n")[0]
    packages = [name.replace("/", ".") for name in re.findall(r"^\| ([\w/]+) \|", table, re.MULTILINE)]
    layers = (ROOT / "tests" / "test_architecture.py").read_text(encoding="utf-8").split("LAYERS = (")[1].split(")")[0]
    assert packages == re.findall(r'^    "([\w.]+)",$', layers, re.MULTILINE)


def test_all_pages_are_in_the_site():
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    listed = set(re.findall(r"[\w-]+\.md", str(yaml.safe_load(text)["nav"])))
    assert listed == {page.name for page in PAGES} - {"README.md"}


def test_the_api_page_has_all_that_is_exported():
    listed = re.findall(r"^::: safe_ompl\.(\w+)$", (ROOT / "docs" / "api.md").read_text(), re.MULTILINE)
    assert sorted(listed) == sorted(safe_ompl.__all__)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_commands_on_a_page_can_be_read(page):
    for program, *words in commands_of(page.read_text(encoding="utf-8")):
        if program == "safe-ompl":
            command_line().parse_args(words)


def test_the_site_is_built_without_a_warning(tmp_path):
    pytest.importorskip("mkdocstrings")
    pytest.importorskip("material")
    # With --quiet the site is built in spite of warnings.
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    assert "SafeSetup" in (tmp_path / "api" / "index.html").read_text(encoding="utf-8")
