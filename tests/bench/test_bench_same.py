"""`same` names each run whose paths differ from what was recorded, and is silent where none does."""

import json

from bench import same
from bench._harness import run


def test_the_same_code_gives_the_same_paths_and_a_change_is_named(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(same, "OURS", ["SafeRRTConnect"])
    monkeypatch.setattr(same, "PRINTED", ["PaperRRTConnect"])
    file = tmp_path / "before.json"
    assert run(["same", "--record", str(file), "--only", "planar2"]) == 0
    recorded = json.loads(file.read_text())
    assert [set(hashes) for hashes in recorded.values()] == [
        *({"planned", "simplified"}, {"planned", "timed"}, {"planned"}, {"planned"})
    ]
    assert run(["same", "--against", str(file), "--only", "planar2"]) == 0
    recorded["planar2 SafeRRTConnect 1"]["timed"] = recorded.pop("planar2 PaperRRTConnect 0")["planned"]
    file.write_text(json.dumps(recorded))
    capsys.readouterr()
    assert run(["same", "--against", str(file), "--only", "planar2"]) == 1
    said = capsys.readouterr().out
    assert [words in said for words in ("planar2 SafeRRTConnect 1", "timed", "was not there")] == [True] * 3


def test_a_path_one_bit_off_has_another_hash():
    path = same.np.ones((2, 3))
    other = path.copy()
    other[1, 2] = same.np.nextafter(1.0, 2.0)
    assert same.digest(path) == same.digest(path.copy()) != same.digest(other)
    assert same.digest(path) != same.digest(path.reshape(3, 2))
