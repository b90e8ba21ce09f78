"""The command line as a function."""

import pytest

from safe_ompl.apps import main


@pytest.fixture
def call(capfd):
    """Return a function that runs the command line and returns status, output and errors."""

    def run(*arguments):
        capfd.readouterr()
        status = main([str(argument) for argument in arguments])
        return (status, *capfd.readouterr())

    return run
