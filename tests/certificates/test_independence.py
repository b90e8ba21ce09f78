"""What verifies certificates runs no code of what plans, proves motions, or issues certificates."""

import subprocess
import sys

PROVERS = ("collision", "danger", "planning", "paths", "trajectories", "certificates.issue")
LOADED = "import sys, {module}; print(*(name for name in sys.modules if name.startswith('safe_ompl.')))"


def provers_loaded_by(module):
    """Return the modules of provers that importing a module loads, in a new process."""
    command = [sys.executable, "-c", LOADED.format(module=module)]
    loaded = subprocess.run(command, check=True, capture_output=True, text=True, timeout=120).stdout.split()
    assert module in loaded
    rooms = tuple(f"safe_ompl.{room}." for room in PROVERS)
    return [name for name in loaded if f"{name}.".startswith(rooms)]


def test_the_verifier_loads_no_prover():
    assert not provers_loaded_by("safe_ompl.certificates.verifier.verify")


def test_what_issues_does():
    assert provers_loaded_by("safe_ompl.certificates.issue")
