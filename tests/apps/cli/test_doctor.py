"""`safe-ompl doctor`, `python -m safe_ompl`, and the one place of the version."""

import re
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
import yaml

import safe_ompl
from safe_ompl.apps import main
from safe_ompl.apps.cli import doctor, output

ROOT = Path(__file__).parents[3]


def test_the_doctor_says_versions_and_plans(capsys):
    assert main(["doctor"]) == 0
    out = capsys.readouterr().out
    assert re.search(rf"ompl +{re.escape(version('ompl'))}", out)
    assert re.search(r"SafeRRTConnect in planar2: \d+ way points, proven", out)


def test_the_doctor_tells_what_is_missing_or_fails(capsys, monkeypatch, tmp_path):
    def breaks():
        raise ValueError("no\nsuch kernel")

    monkeypatch.setattr(doctor, "requirements", lambda: iter([("no-such-package", ">=2", "")]))
    monkeypatch.setattr(doctor, "_plan", breaks)
    monkeypatch.setitem(output.EXTRAS, "viewer", ("no_such_module", "the viewer"))
    (tmp_path / "damaged.py").write_text("import something_else")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(output.EXTRAS, "plots", ("damaged", "pictures"))
    assert main(["doctor"]) == 1
    out = capsys.readouterr().out
    assert re.search(r"no-such-package +missing +needs >=2", out)
    assert "fails: plan: ValueError: no such kernel\n" in out
    assert re.search(r"^fails: plots: ModuleNotFoundError: .*something_else", out, re.MULTILINE)
    assert "viewer: no_such_module missing; get the viewer with: pip install 'safe-ompl[viewer]'" in " ".join(
        out.split()
    )
    assert not re.search("fails: (?!plan|plots)", out), out


def test_what_is_needed_is_known():
    needed = {name: extra for name, _, extra in doctor.requirements()}
    assert {"numpy", "ompl", "pin", "coal"} <= {name for name, extra in needed.items() if not extra}
    assert needed["matplotlib"] == "plots"
    assert "pytest" not in needed


def test_the_package_is_a_program_that_frees_what_it_made():
    plan = [sys.executable, "-m", "safe_ompl", "plan", "planar2", "--seed", "0"]
    run = subprocess.run(plan, capture_output=True, text=True, check=True, timeout=120)
    assert "leaked" not in run.stderr  # what nanobind says of OMPL's objects that still exist at the end


def test_the_version_is_the_same_everywhere(capsys):
    with pytest.raises(SystemExit):
        main(["--version"])
    assert capsys.readouterr().out == f"safe-ompl {safe_ompl.__version__}\n"
    assert f"\nversion: {safe_ompl.__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"## {safe_ompl.__version__}" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    recipe = yaml.safe_load((ROOT / "recipe" / "recipe.yaml").read_text(encoding="utf-8"))
    assert recipe["context"]["version"] == safe_ompl.__version__


def test_the_recipe_of_conda_forge_needs_what_the_package_needs():
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8").split("\ndependencies = [")[1].split("]")[0]
    needed = re.findall(r'^    "([\w-]+)(.*?)",', text.replace('"pin>', '"pinocchio>'), re.MULTILINE)
    recipe = yaml.safe_load((ROOT / "recipe" / "recipe.yaml").read_text(encoding="utf-8"))
    assert recipe["requirements"]["run"][1:] == [" ".join(parts) for parts in needed]
