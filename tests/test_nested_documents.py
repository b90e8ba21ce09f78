"""Documents that are nested too deeply are refused: their parsers would overrun the stack, and end the process."""

from pathlib import Path

import pytest

from safe_ompl import InputError
from safe_ompl.common.documents import reading
from safe_ompl.io import read_json, read_ticks
from safe_ompl.scene import MbmFile

DEEP = 30_000


def read_yaml(path: Path) -> None:
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
def test_yaml(tmp_path: Path, content: str) -> None:
    file = tmp_path / "deep.yaml"
    file.write_text("# a line before\n" + content)
    with pytest.raises(InputError, match=r"deep\.yaml:\d+: malformed YAML: nested deeper than 100 levels"):
        read_yaml(file)


def test_an_error_in_a_document_that_is_no_deeper_names_its_line(tmp_path: Path) -> None:
    file = tmp_path / "flat.yaml"
    file.write_text("a:\n" + "".join("- " * 90 + "1\n" for _ in range(3)) + "b: [")
    with pytest.raises(InputError, match=r"flat\.yaml:\d+: malformed YAML: (?!nested)"):
        read_yaml(file)


@pytest.mark.parametrize("read", [read_json, read_ticks, MbmFile.load])
def test_json(tmp_path: Path, read) -> None:
    file = tmp_path / "deep.json"
    file.write_text("[" * DEEP + "]" * DEEP)
    with pytest.raises(InputError, match=r"deep\.json"):
        read(file)
