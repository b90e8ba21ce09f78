"""What `import safe_ompl` offers, and what it leaves for later."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from snippets import PAGES, supported_versions

import safe_ompl

ROOT = Path(__file__).parent.parent


def test_every_public_name_is_there():
    for name in safe_ompl.__all__:
        assert getattr(safe_ompl, name).__name__.removeprefix("safe_ompl.") == name
        assert name in dir(safe_ompl)


def test_unknown_names_are_no_attributes():
    with pytest.raises(AttributeError, match="SafeOMPL"):
        safe_ompl.SafeOMPL  # noqa: B018


def printed(program):
    """Return what a program prints in a process of its own."""
    return subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True).stdout


def loaded_by(program):
    """Return the names of the modules that a program has imported at its end."""
    return set(printed(f"import sys; {program}; print(*sys.modules)").split())


def test_packages_that_planning_does_not_need_are_imported_later():
    later = {f"safe_ompl.{name}" for name in ("apps.benchmark", "live.replanning", "io", "drawing")}
    assert not loaded_by("import safe_ompl") & later
    assert "safe_ompl.live.replanning" in loaded_by("from safe_ompl import Benchmark, Replanner")


WITHOUT_OMPL = """
import sys
from pathlib import Path
from importlib import import_module
from pkgutil import walk_packages

class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "ompl":
            raise ModuleNotFoundError("No module named 'ompl'", name="ompl")

sys.meta_path.insert(0, Missing())
for room in "common geometry robot scene collision danger motions certificates live io".split():
    for module in walk_packages(import_module(f"safe_ompl.{room}").__path__, f"safe_ompl.{room}."):
        if not module.name.startswith(("safe_ompl.robot.states", "safe_ompl.live.ros")):  # of OMPL, of extras
            import_module(module.name)

import safe_ompl
scenario = safe_ompl.Scenario.load("planar2")
robot = scenario.build_robot()
start = scenario.start_configuration(robot)
assert safe_ompl.check([start, start + 0.01], robot, scenario.scene)
try:
    safe_ompl.SafeSetup
except ModuleNotFoundError as error:
    print(error)
"""


def test_proofs_need_no_ompl():
    assert printed(WITHOUT_OMPL) == "No module named 'ompl'\n"


def test_commands_need_no_extra_to_be_there():
    extras = "matplotlib PIL viser mcap rosbags mujoco xacro rclpy scipy"
    program = f"import sys; sys.modules.update(dict.fromkeys({extras.split()})); "
    printed(program + "from safe_ompl.apps.cli.program import command_line; command_line()")


def test_a_command_imports_nothing_of_others():
    program = "from safe_ompl.apps.cli.program import command_line; "
    loaded = loaded_by(program + "command_line('plan').parse_args(['plan', 'planar2'])")
    assert "safe_ompl.apps.cli.plan" in loaded
    assert not loaded & {"safe_ompl.apps.cli.live", "safe_ompl.drawing.plots", "safe_ompl.tasks.programs"}
    assert not loaded & {"safe_ompl.certificates.claims", "rich.console", "importlib.metadata", "concurrent.futures"}


def test_who_plans_imports_nothing_of_motions_in_time_or_of_people():
    """Each takes some ms of every start."""
    loaded = loaded_by("from safe_ompl import SafeSetup")
    assert "safe_ompl.planning.safe_setup" in loaded
    packages = ("motions", "live", "certificates", "drawing", "tasks")
    others = {name for name in loaded if name.startswith(tuple(f"safe_ompl.{package}." for package in packages))}
    assert others == {"safe_ompl.motions.constraints"}
    assert not loaded & {"multiprocessing", "concurrent.futures", "difflib", "statistics"}


def test_all_files_have_the_supported_versions_of_one_table():
    python, *packages = supported_versions().items()
    text = {name: (ROOT / name).read_text(encoding="utf-8") for name in ("pyproject.toml", "recipe/recipe.yaml")}
    low, below = python[1]
    assert f'requires-python = ">={low},<{below}"' in text["pyproject.toml"]
    minors = [f"3.{minor}" for minor in range(int(low[2:]), int(below[2:]))]
    workflow = (ROOT / ".github" / "workflows" / "tests.yml").read_text(encoding="utf-8")
    assert set(re.findall(r"python: (\[.*\])", workflow)) == {str(minors).replace("'", '"')}
    assert " ".join(f"cp{minor.replace('.', '')}-*" for minor in minors) in text["pyproject.toml"]
    assert re.findall(r'"Programming Language :: Python :: (3\.\d+)"', text["pyproject.toml"]) == minors
    for page in PAGES:
        named = re.findall(r"Python (3\.\d+) to (3\.\d+)", page.read_text(encoding="utf-8"))
        assert set(named) <= {(minors[0], minors[-1])}, page
    assert [name for name, _ in packages] == ["numpy", "ompl", "pin", "coal", "cython"]
    for name, (low, below) in packages:
        bounds = f">={low}" + (f",<{below}" if below else "")
        assert re.search(rf'"{name}{bounds}"', text["pyproject.toml"], re.IGNORECASE)
        assert f"- {'pinocchio' if name == 'pin' else name} {bounds}\n" in text["recipe/recipe.yaml"]
