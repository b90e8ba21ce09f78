"""What verifies certificates runs no code of what plans, proves motions, or issues certificates."""

import ast
from importlib.util import find_spec
from pathlib import Path

import pytest

CERTIFICATE = "safe_ompl.certificates"
VERIFIER = Path(find_spec(f"{CERTIFICATE}.verifier").origin).parent
PROVERS = (
    "certificates.issue",
    "collision",
    "danger",
    "paths",
    "people",
    "planning",
    "trajectories",
    "view",
    "apps",
)


def imported(module):
    """Return the modules of the package that a module imports when it runs, type checking aside."""
    tree = ast.parse(Path(find_spec(module).origin).read_text(encoding="utf-8"))
    nodes = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    found = {f"{node.module}.{name.name}" for node in nodes for name in node.names}
    return {name for name in found if name.startswith("safe_ompl.")}


@pytest.mark.parametrize(
    "module",
    [
        *("certificates.claims", "certificates.terms"),
        *(f"io.{module}" for module in ("form", "schema", "robot_document", "scene_document")),
        *(f"certificates.verifier.{file.stem}" for file in VERIFIER.glob("[a-z]*.py")),
    ],
)
def test_the_verifier_imports_no_prover(module):
    names = imported(f"safe_ompl.{module}")
    assert names
    assert not [name for name in names if name.startswith(tuple(f"safe_ompl.{room}" for room in PROVERS))]


def test_what_issues_does():
    names = imported(f"{CERTIFICATE}.issue")
    assert any(name.startswith("safe_ompl.danger") for name in names)
    assert not any(name.startswith(f"{CERTIFICATE}.verifier") for name in names)
