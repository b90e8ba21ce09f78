"""Benches silence what the package logs, for their process; here that ends with the test."""

from __future__ import annotations

import logging
from collections.abc import Iterator

import pytest


@pytest.fixture(autouse=True)
def _logging_goes_on() -> Iterator[None]:
    before = logging.root.manager.disable
    yield
    logging.disable(before)
