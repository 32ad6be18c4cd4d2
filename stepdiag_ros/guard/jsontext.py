"""JSON as every reader takes it: :func:`to_json`, the one way in which this program writes it.

Python's own writer puts ``NaN`` and ``Infinity`` where a number is missing, which no other language reads.
"""

import json
import math
from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

import numpy as np


def plain(value: Any) -> Any:
    """``value`` in JSON's own types: what is not a finite number is ``None``, arrays are lists."""
    if value is None or isinstance(value, str | bool):
        return value
    if isinstance(value, np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        number = float(value)
        return number if math.isfinite(number) else None
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, PurePath):
        return str(value)
    raise TypeError(f'a {type(value).__name__} has no place in JSON')


def to_json(value: Any, indent: int | None = 1, sort_keys: bool = False) -> str:
    """``value`` as a JSON text; ``null`` for what is not a number.  ``TypeError`` for what is no data."""
    return json.dumps(plain(value), indent=indent, sort_keys=sort_keys, allow_nan=False)
