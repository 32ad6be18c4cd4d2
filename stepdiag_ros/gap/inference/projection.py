"""What the unknowns of a fit can imitate, taken out of white readings.

White readings z = W r of a model with the Jacobian J, and priors P = HᵀH of its unknowns: these imitate the columns of
A = [W J; H], below the readings the unknowns' own departures.  Orthonormal directions B = A R⁻¹, where A = QR, would be
a dense matrix that grows with the square of an axis's steps.  Only R is kept, for

    Bᵀz = R⁻ᵀ (Jᵀ Wᵀz + Hᵀz′),

z′ the own rows of z: J is sparse, and W there run by run.  Rounding errors grow by the condition of R, its columns of
one length: 10⁴ to 10⁵, priors included.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import chain

import numpy as np
from scipy import sparse

from stepdiag_ros.estimate.dense import block_of
from stepdiag_ros.estimate.enhanced import Fit
from stepdiag_ros.estimate.noise import NoiseModel, Whitener, whiteners
from stepdiag_ros.estimate.noise_law import Errors, Latent, errors_of, latents
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.estimate.triangular import backward, forward

ROWS_AT_A_TIME = 4096
"""Rows that are triangulated at a time, if they are more than twice the unknowns."""


@dataclass(frozen=True)
class Freed(Whitener):
    """A run's whitener that takes out what the run's own unknowns, the resets of its beams, can imitate: orthonormal
    white directions ``free`` (m, k).  They reach no other run: among those of the whole log they would be a matrix
    that grows with the square of the runs."""

    free: np.ndarray

    def forward(self, right: np.ndarray) -> np.ndarray:
        return self.without(self.solve(right))

    def backward(self, directions: np.ndarray) -> np.ndarray:
        """White directions (m, k) as the readings' whose products with columns are those of the white ones."""
        return self.solve_back(self.without(directions))

    def without(self, white: np.ndarray) -> np.ndarray:
        """White rows (m, …) without what the resets can do."""
        return white - self.free @ (self.free.T @ white)


@dataclass(frozen=True)
class Projection:
    """The projection at one ``fit`` of a ``table`` in one ``noise``.

    ``white``: whiteners, one a run, that take out its resets: a reset may be anything, its prior of metres is left out.
    ``volume``: −½ ln|C| − ½ ln|JᵀC⁻¹J + P|, the logarithm of what noise and unknowns leave open.
    """

    table: StopTable
    fit: Fit
    noise: NoiseModel
    white: list[Freed]
    volume: float
    _jacobian: sparse.csr_array
    _held: np.ndarray
    _factor: np.ndarray

    @classmethod
    def of(cls, table: StopTable, result: Fit, noise: NoiseModel) -> 'Projection':
        shared = result.parameters.offset_first
        own, resets, white, volume = result.jacobian[:, :shared], result.jacobian[:, shared:], [], 0.0
        for one in whiteners(table, noise, result.arrival, result.present):
            free, triangle = np.linalg.qr(one.forward(block_of(resets, one.rows)[1]))
            white.append(Freed(one.rows, one.triangle, free))
            volume -= float(np.sum(np.log(one.triangle.diagonal)) + np.sum(np.log(np.abs(np.diag(triangle)))))
        # The unknowns are held to their priors as in the fit: else errors of metres, along directions that the
        # readings hardly tell, would imitate what no machine does.
        held = np.linalg.cholesky(result.precision[:shared, :shared]).T
        jacobian = own[np.concatenate([w.rows for w in white])]
        triangle = _triangle(chain((_white_rows(one, own, one.rows) for one in white), [held]))
        volume -= float(np.sum(np.log(np.abs(np.diag(triangle)))))
        return cls(table, result, noise, white, volume, jacobian, held, np.asfortranarray(triangle.T))

    def in_noise(self, noise: NoiseModel) -> 'Projection':
        """The projection at the same fit in another noise."""
        return Projection.of(self.table, self.fit, noise)

    @property
    def size(self) -> int:
        """White rows, those of the unknowns' own departures included."""
        return self.readings + len(self._held)

    @property
    def readings(self) -> int:
        """White rows of readings."""
        return self._jacobian.shape[0]

    @cached_property
    def runs(self) -> list[slice]:
        """Where the white rows of each run lie."""
        ends = np.cumsum([len(white.rows) for white in self.white]).tolist()
        return [slice(begin, end) for begin, end in zip([0, *ends], ends, strict=False)]

    @property
    def freedom(self) -> int:
        """Degrees of freedom that the unknowns leave of the readings.  Machines are far better than the priors: the
        unknowns' own departures count for nothing."""
        resets = sum(w.free.shape[1] for w in self.white)
        own = float(np.sum(forward(self._factor, self._held.T)**2))
        return round(self.readings - resets - (len(self._held) - own))

    def data(self, readings: np.ndarray) -> np.ndarray:
        """White ``readings`` (n, c) without the fit's prediction and what the unknowns can imitate (size,)."""
        result = self.fit
        # What the fit has put into its residual is gone already; only the rest is left to look at.
        residual = np.where(result.present, readings - result.model.predict(result.theta), 0.0).ravel()
        own = -self._held @ result.theta[:len(self._held)]
        return self.projected(np.concatenate([*(w(residual) for w in self.white), own])[:, None])[:, 0]

    def absorbed(self, white: np.ndarray, run: int | None = None) -> np.ndarray:
        """Coordinates (r, k) of white columns (size, k), or of those (m, k) of one ``run`` alone, in what can be
        imitated."""
        if run is not None:
            return self.coordinates(self.along(white, run))
        back = np.zeros((self.readings, white.shape[1]))
        for one, rows in zip(self.white, self.runs, strict=True):
            there = np.flatnonzero(white[rows].any(axis=0))
            back[rows, there] = one.backward(white[rows, there])
        products, own = self._jacobian.T @ back, white[self.readings:]
        return self.coordinates(products + self._held.T @ own if own.any() else products)

    def along(self, white: np.ndarray, run: int) -> np.ndarray:
        """Products (r, k) of the unknowns' columns with white ones (m, k) of one run."""
        return self._by_run[run] @ self.white[run].backward(white)

    def coordinates(self, along: np.ndarray) -> np.ndarray:
        """Coordinates (r, k) in what can be imitated of what has these products with the unknowns' columns."""
        return forward(self._factor, along)

    def projected(self, white: np.ndarray) -> np.ndarray:
        """White columns (size, k) without what can be imitated."""
        unknowns = backward(self._factor, self.absorbed(white))
        taken, result = self._jacobian @ unknowns, white.copy()
        for one, rows in zip(self.white, self.runs, strict=True):
            result[rows] -= one.forward(taken[rows])
        result[self.readings:] -= self._held @ unknowns
        return result

    def latents(self) -> Iterator[tuple[Latent, np.ndarray]]:
        """The errors of the arrivals, run by run, and coordinates (r, m) of their columns in what can be imitated."""
        for run, latent in enumerate(latents(self.table, self.noise, self.fit.arrival, self.white)):
            yield latent, self.absorbed(latent.columns, run)

    def errors(self, data: np.ndarray) -> Iterator[Errors]:
        """The same errors given ``data`` (size,)."""
        return (errors_of(latent, lost.T, data) for latent, lost in self.latents())

    def directions(self, run: int) -> np.ndarray:
        """What can be imitated (m, r) in one run: its rows of orthonormal directions."""
        rows = self.runs[run]
        white = _white_rows(self.white[run], self._jacobian, np.arange(rows.start, rows.stop))
        return forward(self._factor, np.asfortranarray(white.T)).T

    @cached_property
    def _by_run(self) -> list[sparse.csr_array]:
        """Transposed Jacobians (r, m) of the runs."""
        return [self._jacobian[rows].T.tocsr() for rows in self.runs]


def _white_rows(one: Freed, jacobian: sparse.csr_array, rows: np.ndarray) -> np.ndarray:
    """White version (m, r) of some ``rows`` (m,) of a Jacobian, those of one run."""
    columns, part = block_of(jacobian, rows)
    white = np.zeros((len(part), jacobian.shape[1]))
    white[:, columns] = one.forward(part)
    return white


def _triangle(parts: Iterable[np.ndarray]) -> np.ndarray:
    """``R`` (r, r) of the QR decomposition of all parts (m, r) below each other, some rows at a time."""
    waiting: list[np.ndarray] = []
    for part in parts:
        waiting.append(part)
        if sum(map(len, waiting)) >= max(ROWS_AT_A_TIME, 3 * part.shape[1]):
            waiting = [np.linalg.qr(np.concatenate(waiting), mode='r')]
    return np.linalg.qr(np.concatenate(waiting), mode='r')
