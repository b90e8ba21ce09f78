"""The reference of the API: every public name is on its page, and the examples of the docstrings run."""

import doctest
import inspect
import logging

import pytest

import safe_ompl

PUBLIC = {name: getattr(safe_ompl, name) for name in safe_ompl.__all__}
CLASSES = sorted(name for name, found in PUBLIC.items() if inspect.isclass(found))
WITH_EXAMPLES = sorted(name for name, found in PUBLIC.items() if ">>>" in (found.__doc__ or ""))


@pytest.mark.parametrize("name", CLASSES)
def test_every_public_class_has_an_example_that_runs(name):
    assert ">>>" in (PUBLIC[name].__doc__ or "")
    assert "+SKIP" not in PUBLIC[name].__doc__


@pytest.mark.parametrize("name", WITH_EXAMPLES)
def test_examples_of_docstrings_run(name, caplog):
    """As a user would run them who has imported the public names."""
    caplog.set_level(logging.CRITICAL)
    examples = doctest.DocTestParser().get_doctest(inspect.getdoc(PUBLIC[name]), dict(PUBLIC), name, None, None)
    found: list[str] = []
    doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE).run(examples, out=found.append)
    assert not found, "".join(found)
