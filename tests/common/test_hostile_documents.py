"""Broken and hostile documents of every form are refused in one line, soon, by every reader."""

import json
from itertools import product
from time import perf_counter

import numpy as np
import pytest

from safe_ompl import InputError, Scenario, Scene, load, read_motion
from safe_ompl.io import read_ticks
from safe_ompl.live import Recording
from safe_ompl.scene import MbmFile

DEEP = 30_000
LONG = DEEP * "x"
TOO_DEEP = "nested deeper than 100 levels|exceeded maximum nesting depth"  # PyYAML has a bound of its own since 6.0.4
LEVELS = "\n".join(["a0: &a0 {k: 1}", *(f"a{k}: &a{k} {{<<: [*a{k - 1}, *a{k - 1}]}}" for k in range(1, 29))])
LISTS = "\n".join(["a0: &a0 [1]", *(f"a{k}: &a{k} [*a{k - 1}, *a{k - 1}]" for k in range(1, 29))])
YAML = {
    "# a line before\n" + "[" * DEEP: TOO_DEEP,
    "# a line before\n" + "[" * DEEP + "]" * DEEP: TOO_DEEP,
    "a: " + "{b: " * DEEP: "nested deeper than 100 levels",
    "- " * DEEP: "nested deeper than 100 levels",
    "\n".join(" " * k + "a:" for k in range(500)): "nested deeper than 100 levels",
    "\n".join(["a0: &a0 [1]", *(f"a{k}: &a{k} [*a{k - 1}]" for k in range(1, 200))]): "nested deeper than 100",
    "a:\n" + "- " * 90 + "1\nb: [": r":(| line )\d+: malformed YAML: (?!nested)",
    LEVELS: "aliases stand for more than 100000 nodes",
    LISTS: "aliases stand for more than 100000 nodes",
    "a: &a [*a]": r"\*a is part of itself",
    "name: 2026-13-45": r":(| line )1: malformed YAML: no timestamp, to be quoted if it is text: '2026-13-45'",
    "name: 0x_": "no int, .*'0x_'",
    "name: " + 5000 * "1": "no int, .*1…",
    "name: 0x" + 5000 * "f": "no int, .*f…",
    "name: !!float abc": "no float, .*'abc'",
    "name: !!bool maybe": "no bool, .*'maybe'",
    "? !!set {a}\n: 1": "a key must be text",
}
JSON = {
    "[" * DEEP + "]" * DEEP: "malformed JSON: nested too deeply",
    "\n{": r"line \d: malformed JSON",
    '{"name": ' + 5000 * "1" + "}": "malformed JSON: Exceeds the limit",
    '{"name": 1, "name": 2}': "'name': is there twice",
    json.dumps({LONG: LONG}): "must be|must hold|missing",
    json.dumps({"format": "safe-ompl", "version": 2, "kind": LONG}): "unknown kind|format: must be|problems: missing",
    "\xff": "cannot be read|is not text in UTF-8|malformed JSON",
}
CSV = {
    f"a,b\n1,{LONG}": "must be numbers, got 'xxx",
    f"{LONG}\n{LONG}": "must name the joints|must be numbers|two at least",
    ",".join(map(str, range(9_000))): "the first line: must name the joints, got 0, 1",
    "a,b\n" + 3_000 * "0.1,0.2\n" + "0.1,nan\n": "way points: must be finite",
}
READERS = {
    ".csv": (read_motion,),
    ".yaml": (Scene.from_file, Scenario.load, read_motion),
    ".json": (load, read_motion, read_ticks, MbmFile.load),
}


@pytest.mark.parametrize(
    ("reader", "ending", "content", "words"),
    [
        (reader, ending, *row)
        for ending, rows in ((".yaml", YAML), (".json", JSON), (".csv", CSV))
        for reader, row in product(READERS[ending], rows.items())
    ],
)
def test_text(tmp_path, reader, ending, content, words):
    file, begin = tmp_path / f"x{ending}", perf_counter()
    file.write_text(content, encoding="latin-1")
    with pytest.raises(InputError, match=words) as refused:
        reader(file)
    said = str(refused.value)
    assert said.startswith(str(file))
    assert len(said.removeprefix(str(file))) < 500
    assert "\n" not in said
    assert perf_counter() - begin < 5


@pytest.mark.parametrize("reader", [read_motion, Recording.load])
@pytest.mark.parametrize(
    ("place", "value"), [(6, 1), (6, 0x41), (8, 99), (8, 8)], ids=["locked", "strong", "method", "not packed"]
)
def test_archives_with_flags(tmp_path, reader, place, value):
    """They say that they are locked with a password, or packed in a way that nobody knows."""
    file = tmp_path / "x.npz"
    np.savez(file, positions=np.zeros((2, 2)), names=np.array(["a"]))
    content = bytearray(file.read_bytes())
    for mark, shift in ((b"PK\3\4", 0), (b"PK\1\2", 2)):
        at = content.find(mark)
        while at >= 0:
            content[at + place + shift] = value
            at = content.find(mark, at + 4)
    file.write_bytes(content)
    with pytest.raises(InputError, match=r"x\.npz: is not an NPZ archive of arrays"):
        reader(file)


@pytest.mark.parametrize("change", [{"clearance": 3}, {"counts": {"x": 1}}, {"seed": "x"}, {"clearance": []}])
def test_documents_that_lack_what_code_expects(tmp_path, change):
    result = {"status": "x", "path": [[0.0]], "planner": "y", "seed": 1, "joint_names": ["a"], "planning_time": 0}
    file = tmp_path / "x.json"
    file.write_text(json.dumps({"format": "safe-ompl", "version": 2, "kind": "result", **result, **change}))
    with pytest.raises(InputError, match=r"x\.json: (is malformed \(|clearance)"):
        load(file)
