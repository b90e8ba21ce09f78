"""What verifies certificates runs no code of what plans, proves motions, or issues certificates."""

import ast
from importlib.util import find_spec
from pathlib import Path

import pytest

CERTIFICATE = "safe_ompl.paths.certificate"
PROVERS = (
    "collision",
    "danger",
    "maths",
    "planners",
    "plugins",
    "setup",
    "paths.simplify",
    "paths.certificate.issue",
    "paths.certificate.issue_trajectory",
    "trajectories",
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
        *("verify", "claims", "danger_claims", "trajectory_claims", "format", "portable"),
        *("plain_curve", "plain_danger", "plain_distances", "plain_moving_danger", "plain_phases"),
        *("plain_speeds", "plain_tool", "plain_trajectory"),
    ],
)
def test_the_verifier_imports_no_prover(module):
    names = imported(f"{CERTIFICATE}.{module}")
    assert names
    assert not [name for name in names if name.startswith(tuple(f"safe_ompl.{room}" for room in PROVERS))]


def test_what_issues_does():
    names = imported(f"{CERTIFICATE}.issue")
    assert any(name.startswith("safe_ompl.danger") for name in names)
    assert not any(name.startswith(f"{CERTIFICATE}.plain") for name in names)
