"""Some rows of a linear model predicted from the others, run by run.

No matrix of all rows by all unknowns is written out: it would grow with the square of an axis's steps.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from stepdiag_ros.estimate.noise import Whitener
from stepdiag_ros.gap.inference.joint import inverse


@dataclass(frozen=True)
class Run:
    """Rows of a run: its ``whitener``, its ``jacobian`` (m, r), what is read less what is predicted, ``rest`` (m,)."""

    whitener: Whitener
    jacobian: sparse.csr_array
    rest: np.ndarray

    @cached_property
    def columns(self) -> np.ndarray:
        """Numbers (k,) of the unknowns that the run tells of."""
        return np.unique(self.jacobian.indices)

    def products(self, flag: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Products of those white rows that are flagged (m,): of its columns with each other (k, k) and with the rest
        (k,).  White rows are what is new in each reading given those before."""
        part = self.jacobian[:, self.columns]
        white = self.whitener.forward(np.column_stack([part.toarray(), self.rest]))
        white[~flag] = 0.0
        both = part.T @ self.whitener.solve_back(white)
        return both[:, :-1], both[:, -1]

    def left(self, values: np.ndarray) -> np.ndarray:
        """What the unknowns (r,) leave of the rest (m,)."""
        return self.rest - self.jacobian @ values


@dataclass(frozen=True)
class Part:
    """Products of some rows: ``columns`` (k,) that they reach, and of these with each other and with the rest."""

    columns: np.ndarray
    normal: np.ndarray
    along: np.ndarray

    @classmethod
    def of(cls, runs: Sequence[Run], flags: Sequence[np.ndarray]) -> 'Part':
        """Of those rows of some runs that are flagged (m,)."""
        mine = [(run, flag) for run, flag in zip(runs, flags, strict=True) if flag.any()]
        columns = np.unique(np.concatenate([np.zeros(0, np.intp), *(run.columns for run, _ in mine)]))
        normal, along = np.zeros((len(columns),) * 2), np.zeros(len(columns))
        for run, flag in mine:
            among, right = run.products(flag)
            place = np.searchsorted(columns, run.columns)
            normal[np.ix_(place, place)] += among
            along[place] += right
        return cls(columns, normal, along)

    def onto(self, normal: np.ndarray) -> None:
        """Add the products to those (r, r) of all unknowns."""
        normal[np.ix_(self.columns, self.columns)] += self.normal


class HeldOut:
    """Rows of runs in disjoint ``parts``, masks (m,) for each run, each part predicted from all other rows.

    The parts' products are kept each by itself, those of no part last: so each row is multiplied once, however many
    parts are held out, and nothing is taken off again.
    """

    def __init__(self, runs: Sequence[Run], parts: Sequence[Sequence[np.ndarray]], precision: np.ndarray):
        self._runs, self._flags, self._precision = runs, parts, precision
        others = [~np.any(flags, axis=0) for flags in zip(*parts, strict=True)]
        self._parts = [Part.of(runs, flags) for flags in (*parts, others)]

    def size(self, without: int | None = None) -> np.ndarray:
        """Lengths (r,) of the columns over all white rows, or over all but those of one part."""
        total = np.zeros(len(self._precision))
        for number, part in enumerate(self._parts):
            if number != without:
                total[part.columns] += np.diag(part.normal)
        return np.sqrt(np.maximum(total, 0.0))

    def forecast(self, number: int) -> tuple[float, np.ndarray, np.ndarray]:
        """χ² of a part predicted from the others; what these say of the unknowns (r,), and its covariance (r, r).

        With rows D of the part, d what is left of them and N the normal equations of the others,
        dᵀ(1 + DN⁻¹Dᵀ)⁻¹d is the least of |d − Dx|² + xᵀNx: no matrix of m × m is needed.
        """
        normal, along = self._precision.copy(), np.zeros(len(self._precision))
        for other, part in enumerate(self._parts):
            if other != number:
                part.onto(normal)
                along[part.columns] += part.along
        covariance, mine = inverse(normal), self._parts[number]
        expected = covariance @ along
        right = np.zeros(len(expected))
        right[mine.columns] = mine.along - mine.normal @ expected[mine.columns]
        mine.onto(normal)
        moved = inverse(normal) @ right
        own = moved[mine.columns]
        left = sum(float(np.sum(run.whitener.forward(run.left(expected + moved))[flag]**2))
                   for run, flag in self.rows(number))
        return left + float(moved @ normal @ moved - own @ mine.normal @ own), expected, covariance

    def rows(self, number: int) -> Iterator[tuple[Run, np.ndarray]]:
        """The runs that have rows in a part, and which (m,) these are."""
        return ((run, flag) for run, flag in zip(self._runs, self._flags[number], strict=True) if flag.any())
