"""A clock that goes on when the test says so."""

import pytest

from .clock import Clock


@pytest.fixture
def clock() -> Clock:
    return Clock()
