"""The normal equations of the enhanced method as a narrow band with a border.

Two facts make them cheap.  A stop meets only the knots it stands on, and going along a diagonal those
are neighbours; and the errors of arrival, which tie the stops of a run together, are themselves a chain:
each lasts until its axis moves again.  With one more unknown for each arrival, of known variance, all
readings of different stops become independent, and ordered along the diagonals, folded in their middle,
curves and arrivals form a band of some hundred columns, whatever the number of steps.  Misalignments and offsets, which
meet every stop of a setup, form a border of a few dozen columns; so do the rows that hold the
frame, in the form ``[[B, w], [wᵀ, −σ²]]`` of ``B + w wᵀ/σ²``.

Eliminating the arrivals returns the dense equations exactly.  Rounding costs more digits here, above all where
the border decides; the steps serve to get there, the last one is taken from the dense equations.
"""

import numpy as np
from scipy import linalg, sparse
from scipy.sparse import csgraph

from stepdiag_ros.estimate.noise import NoiseModel, arrivals
from stepdiag_ros.estimate.reduce import StopTable

USUAL_BAND = 120
"""Columns of the band, as counted for its cost."""


class BandedNormal:
    """Normal equations of one log, set up once for all iterations.

    ``arrival`` (5, n, c) as in :meth:`~stepdiag_ros.estimate.forward.ForwardModel.jacobian`, ``present``
    (n, c); ``sigma`` (size,) of the unknowns; ``frame``: rows (k, size) held at zero with
    deviation ``frame_sigma``; ``border``: the first column that belongs to the border.
    """

    def __init__(self, table: StopTable, noise: NoiseModel, arrival: np.ndarray, present: np.ndarray,
                 sigma: np.ndarray, frame: np.ndarray, frame_sigma: float, border: int):
        n, channels = present.shape
        self.size, self.border = len(sigma), border
        self.frame, self.frame_sigma = frame, frame_sigma
        # What correlates from arrival to arrival is left to the dense equations, which have the last word.
        arrival = noise.spread_of(arrival)
        self._whitener = _stop_whitener(noise, arrival, present)
        numbers, first = arrivals(table), 0
        rows, columns, values = [], [], []
        flat = (np.arange(n)[:, None] * channels + np.arange(channels)).ravel()
        for axis in range(3):
            _, own = np.unique(numbers[:, axis], return_inverse=True)
            rows.append(flat)
            columns.append(first + np.repeat(np.ravel(own), channels))
            values.append(noise.position * arrival[2 + axis].ravel())
            first += int(own.max()) + 1
        shape = (n * channels, first)
        # An arrival's unknown is counted in its own deviations: its prior is one.
        self._arrivals = self._whitener @ sparse.csr_array(
            (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape)
        self._prior = np.concatenate([sigma[:border]**-2.0, np.ones(first)])
        self._border_prior = sigma[border:]**-2.0
        # Factor, edge and corner; the band itself is known only once it is made, and is much alike in all logs.
        inside, edge = len(self._prior), self.size - border + len(frame)
        self.operations = float(inside * (USUAL_BAND**2 + 4.0 * USUAL_BAND * edge + 2.0 * edge**2))
        self._order: np.ndarray | None = None
        # Diagonals run up and down: folded in the middle of each axis they all pass the same levels together.
        travel = np.ptp(table.commanded, axis=0)
        share = (table.commanded - table.commanded.min(axis=0)) / np.where(travel > 0.0, travel, 1.0)
        self._level = np.repeat(np.minimum(share, 1.0 - share).mean(axis=1), channels)

    def solve(self, jacobian: sparse.csr_array, residual: np.ndarray, pull: np.ndarray,
              damping: float = 0.0) -> np.ndarray:
        """Step (size,): ``(JᵀC⁻¹J + (1 + λ)P)⁻¹ (JᵀC⁻¹ r − pull)``; ``pull = P (θ − θ₀)`` (size,), λ the ``damping``.

        ``residual`` (n·c,) with zeros where absent.  Raises ``LinAlgError`` where rounding makes the
        matrix indefinite.
        """
        white = (self._whitener @ jacobian).tocsc()
        rest = self._whitener @ residual
        # SciPy before 1.12 stacks arrays to a matrix, whose sums and products have other shapes.
        inner = sparse.csc_array(sparse.hstack([white[:, :self.border], self._arrivals], format='csc'))
        outer = white[:, self.border:]
        matrix = (inner.T @ inner).tocoo()
        if self._order is None:
            self._order = self._narrowest(inner, matrix)
        place = self._order
        right = inner.T @ rest
        right[:self.border] -= pull[:self.border]
        edge = np.zeros((len(place), outer.shape[1] + len(self.frame)))
        edge[place, :outer.shape[1]] = (inner.T @ outer).toarray()
        edge[place[:self.border], outer.shape[1]:] = self.frame[:, :self.border].T
        corner = np.zeros((edge.shape[1],) * 2)
        corner[:outer.shape[1], :outer.shape[1]] = (outer.T @ outer).toarray()
        corner[np.diag_indices(outer.shape[1])] += (1.0 + damping) * self._border_prior
        for k in range(len(self.frame)):
            corner[outer.shape[1] + k, outer.shape[1] + k] = -self.frame_sigma**2 / (1.0 + damping)
        down = np.zeros(edge.shape[1])
        down[:outer.shape[1]] = outer.T @ rest - pull[self.border:]

        row, column = place[matrix.row], place[matrix.col]
        keep = row >= column
        offset = (row - column)[keep]
        band = np.zeros((int(offset.max()) + 1, len(place)))
        band[offset, column[keep]] = matrix.data[keep]
        prior = self._prior.copy()
        prior[:self.border] *= 1.0 + damping
        band[0, place] += prior
        scale = 1.0 / np.sqrt(band[0])
        self.bandwidth = len(band)
        for k in range(len(band)):
            band[k, :len(place) - k] *= scale[k:] * scale[:len(place) - k]
        factor = linalg.cholesky_banded(band, overwrite_ab=True, lower=True, check_finite=False)
        sides = np.column_stack([edge, np.zeros(len(place))])
        sides[place, -1] = right
        solved = scale[:, None] * linalg.cho_solve_banded((factor, True), scale[:, None] * sides,
                                                          check_finite=False)
        inside, plain = solved[:, :-1], solved[:, -1]
        schur = corner - edge.T @ inside
        border = np.linalg.solve(schur, down - edge.T @ plain)
        step = np.empty(self.size)
        step[:self.border] = (plain - inside @ border)[place[:self.border]]
        step[self.border:] = border[:self.size - self.border]
        return step


    def _narrowest(self, inner: sparse.csc_array, matrix: sparse.coo_array) -> np.ndarray:
        """Place of each inner column in the narrower of two orders: along the folded diagonals, or by graph."""
        touched = abs(inner.sign())
        count = np.maximum(touched.sum(axis=0), 1)
        along = touched.T @ self._level / count
        found = []
        for order in (np.argsort(along, kind='stable'),
                      csgraph.reverse_cuthill_mckee(matrix.tocsr(), symmetric_mode=True)):
            place = np.empty(len(order), np.intp)
            place[order] = np.arange(len(order))
            found.append((int(np.abs(place[matrix.row] - place[matrix.col]).max()), place))
        return min(found, key=lambda pair: pair[0])[1]


def _stop_whitener(noise: NoiseModel, arrival: np.ndarray, present: np.ndarray) -> sparse.csr_array:
    """Block-diagonal (n·c, n·c): what makes sensor noise and turns of the mirror white; zero where absent."""
    n, channels = present.shape
    turn = np.where(present, arrival[:2] * noise.angle, 0.0)
    covariance = np.einsum('knc,knd->ncd', turn, turn)
    stop = np.arange(channels)
    covariance[:, stop, stop] += np.where(present, noise.sensor**2, 1.0)
    inverse = np.linalg.inv(np.linalg.cholesky(covariance))
    inverse[:, stop, stop] *= present
    return sparse.csr_array(
        sparse.bsr_array((inverse, np.arange(n), np.arange(n + 1)), shape=(n * channels, n * channels)))
