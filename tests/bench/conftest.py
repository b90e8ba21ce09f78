"""Benches silence what the package logs, for their process; here that ends with the test."""

import logging

import pytest


@pytest.fixture(autouse=True)
def _logging_goes_on():
    before = logging.root.manager.disable
    yield
    logging.disable(before)
