"""What `import safe_ompl` offers, and what it leaves for later."""

import subprocess
import sys

import pytest

import safe_ompl
from safe_ompl import InputError
from safe_ompl.common.documents import reading
from safe_ompl.io import read_json, read_ticks
from safe_ompl.scene import MbmFile


def test_every_public_name_is_there():
    for name in safe_ompl.__all__:
        assert getattr(safe_ompl, name).__name__.removeprefix("safe_ompl.") == name
        assert name in dir(safe_ompl)


def test_unknown_names_are_no_attributes():
    with pytest.raises(AttributeError, match="SafeOMPL"):
        safe_ompl.SafeOMPL  # noqa: B018


def test_rooms_that_planning_does_without_come_later():
    code = (
        "import sys, safe_ompl\n"
        "later = ('safe_ompl.apps.benchmark', 'safe_ompl.people.replanning', 'safe_ompl.io', 'safe_ompl.view')\n"
        "assert not set(later) & set(sys.modules), set(later) & set(sys.modules)\n"
        "from safe_ompl import Benchmark, Replanner\n"
        "assert 'safe_ompl.people.replanning' in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


# ----------------------------------------------------------------- documents that are nested too deeply are refused


DEEP = 30_000


def read_yaml(path):
    with reading(path):
        pass


@pytest.mark.parametrize(
    "content",
    [
        "[" * DEEP,
        "[" * DEEP + "]" * DEEP,
        "a: " + "{b: " * DEEP,
        "- " * DEEP,
        "\n".join(" " * k + "a:" for k in range(500)),
    ],
)
def test_yaml(tmp_path, content):
    file = tmp_path / "deep.yaml"
    file.write_text("# a line before\n" + content)
    with pytest.raises(InputError, match=r"deep\.yaml:\d+: malformed YAML: nested deeper than 100 levels"):
        read_yaml(file)


def test_an_error_in_a_document_that_is_no_deeper_names_its_line(tmp_path):
    file = tmp_path / "flat.yaml"
    file.write_text("a:\n" + "".join("- " * 90 + "1\n" for _ in range(3)) + "b: [")
    with pytest.raises(InputError, match=r"flat\.yaml:\d+: malformed YAML: (?!nested)"):
        read_yaml(file)


@pytest.mark.parametrize("read", [read_json, read_ticks, MbmFile.load])
def test_json(tmp_path, read):
    file = tmp_path / "deep.json"
    file.write_text("[" * DEEP + "]" * DEEP)
    with pytest.raises(InputError, match=r"deep\.json"):
        read(file)
