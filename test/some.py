"""Parameters of which a change waits for some, and a release for all."""

from collections.abc import Iterable
from typing import Any

import pytest


def some(*now: Any, later: Iterable[Any]) -> list[Any]:
    """``now``, and for ``make test-long`` alone what else is in ``later``; a tuple is a set of arguments."""
    return [*now, *(pytest.param(*(value if isinstance(value, tuple) else (value,)), marks=pytest.mark.long)
                    for value in later if value not in now)]
