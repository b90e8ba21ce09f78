"""What `import safe_ompl` offers, and what it leaves for later."""

import subprocess
import sys

import pytest

import safe_ompl


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
        "later = ('safe_ompl.benchmark', 'safe_ompl.people.replanning', 'safe_ompl.exchange', 'safe_ompl.view')\n"
        "assert not set(later) & set(sys.modules), set(later) & set(sys.modules)\n"
        "from safe_ompl import Benchmark, Replanner\n"
        "assert 'safe_ompl.people.replanning' in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
