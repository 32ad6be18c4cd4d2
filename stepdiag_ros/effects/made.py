"""Arrays that are made anew each time they are looked at.

A log of n stops has thousands of forms, most of them products of a few functions of time and place.  Kept as factors
they take next to nothing; written out, (k, n, c) each, they would take more memory than all else together.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin


class Made(NDArrayOperatorsMixin):
    """``build(*parts)`` as an array of a known ``shape``, which NumPy takes wherever it takes an array; nothing but the
    parts is kept."""

    def __init__(self, shape: tuple[int, ...], build: Callable[..., np.ndarray], *parts: Any):
        self.shape, self._build, self._parts = shape, build, parts

    @property
    def ndim(self) -> int:
        return len(self.shape)

    def __len__(self) -> int:
        return self.shape[0]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.asarray(self._build(*self._parts), dtype)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        return getattr(ufunc, method)(*(np.asarray(x) if isinstance(x, Made) else x for x in inputs), **options)

    def __getitem__(self, key: Any) -> np.ndarray:
        return np.asarray(self)[key]

    def __getattr__(self, name: str) -> Any:
        if name.startswith('_'):   # how NumPy asks what this is
            raise AttributeError(name)
        return getattr(np.asarray(self), name)

    def same(self, other: object) -> bool:
        """Whether ``other`` is made in the same way of the same parts."""
        return isinstance(other, Made) and self.shape == other.shape and self._build is other._build and all(
            a is b or (isinstance(a, np.ndarray) and isinstance(b, np.ndarray) and np.array_equal(a, b))
            for a, b in zip(self._parts, other._parts, strict=True))


class Product(Made):
    """Functions (p, n) of stops or times times a signature (m, n, c), each with each: (p·m, n, c); with a ``course``
    (n, b) of each besides, (p·m, n, b, c)."""

    def __init__(self, functions: np.ndarray, signature: np.ndarray, course: np.ndarray | None = None):
        n, c = signature.shape[1:]
        inner = (n, c) if course is None else (n, course.shape[1], c)
        super().__init__((len(functions) * len(signature), *inner), _product, functions, signature, course)
        self.functions, self.signature, self.course = functions, signature, course


def _product(functions: np.ndarray, signature: np.ndarray, course: np.ndarray | None) -> np.ndarray:
    whole = np.einsum('tn,anc->tanc', functions, signature).reshape(-1, *signature.shape[1:])
    return whole if course is None else whole[:, :, None, :] * course[None, :, :, None]


class Split(Made):
    """Columns (p, n, c) split by the ``group`` (n,) of the stops, for those of ``numbers`` (g,), and by ``channels``
    (q, c), which say where each is: (g·q·p, n, c).  With a group for each run, of thousands of columns some two or
    three do something at a stop: those can be had alone."""

    def __init__(self, columns: np.ndarray, group: np.ndarray, numbers: np.ndarray, channels: np.ndarray):
        n, c = columns.shape[1:]
        super().__init__((len(numbers) * len(channels) * len(columns), n, c), _split, columns, group, numbers, channels)
        self.columns, self.group, self.numbers, self.channels = columns, group, numbers, channels

    def at(self, stops: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Numbers (m,) of the columns that do something at some ``stops`` (s,), rising, and what they do (m, s, c)."""
        each = len(self.channels) * len(self.columns)
        there = np.flatnonzero(np.isin(self.numbers, self.group[stops]))
        parts = _split(self.columns[:, stops], self.group[stops], self.numbers[there], self.channels)
        return (there[:, None] * each + np.arange(each)).ravel(), parts

    def begins_in(self, other: 'Split') -> int | None:
        """The column of ``other`` from which on its columns are these; None where they are not among them."""
        if any(mine is not theirs for mine, theirs in ((self.columns, other.columns), (self.group, other.group),
                                                       (self.channels, other.channels))):
            return None
        first = int(np.searchsorted(other.numbers, self.numbers[0]))
        if not np.array_equal(other.numbers[first:first + len(self.numbers)], self.numbers):
            return None
        return first * len(self.channels) * len(self.columns)


def _split(columns: np.ndarray, group: np.ndarray, numbers: np.ndarray, channels: np.ndarray) -> np.ndarray:
    mine = (group == numbers[:, None])[:, None, :, None] & channels[:, None]
    return (columns * mine[:, :, None]).reshape(-1, *columns.shape[1:])


def joined(parts: Sequence[Any]) -> Made:
    """Arrays, one behind the other along their first axis."""
    return Made((sum(len(part) for part in parts), *parts[0].shape[1:]), lambda *given: np.concatenate(given), *parts)
