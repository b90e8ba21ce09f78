"""The command line as a function."""

import shutil

import pytest

from safe_ompl.apps import main
from safe_ompl.scene import find_scenario


@pytest.fixture(scope="session")
def copied():
    """Return a function that copies a scenario of the package and its robots to a folder, and returns its text."""

    def copy(name, folder):
        source = find_scenario(name).resolve()
        shutil.copytree(source.parent / "robots", folder / "robots")
        shutil.copy(source, folder)
        return source.read_text()

    return copy


@pytest.fixture
def call(capfd):
    """Return a function that runs the command line and returns status, output and errors."""

    def run(*arguments):
        capfd.readouterr()
        status = main([str(argument) for argument in arguments])
        return (status, *capfd.readouterr())

    return run


@pytest.fixture
def says(call):
    """Return a function that runs a command line, asserts its status and words of its output, and returns that.

    `notes` are words on standard error, where lines may be broken anywhere.
    """

    def check(line, *words, status=0, notes=()):
        found, out, err = call(*(line.split() if isinstance(line, str) else line))
        assert found == status, err
        for word in words:
            assert word in out
        for note in notes:
            assert note in " ".join(err.split())
        return out

    return check


@pytest.fixture
def refuses(call):
    """Return a function that fails unless a command line is refused, in one line that holds all of some words."""

    def check(line, *words, status=2):
        found, out, err = call(*(line.split() if isinstance(line, str) else line))
        assert (found, out) == (status, ""), err
        assert len(err.splitlines()) == 1, err
        assert err.startswith("safe-ompl: ")
        for word in words:
            assert word in err

    return check
