"""How the errors of arrivals are distributed: heavy tails and correlation, estimated from the log.

Real arrivals are not drawn from one normal distribution: now and then one is far off, and a stop may err as the one
before it did.  Each error is taken to be normal with a variance of its own, ``σ²/w``, ``w`` from a gamma distribution of
mean one, which makes it Student's t of ν degrees of freedom (Lange, Little & Taylor, J. Am. Stat. Assoc. 84, 1989);
neighbours are correlated by ρ.  Whatever is a cause stays outside of this: a tail is symmetric, has no memory and
does not come back in the next repeat.  So σ, ν and ρ are estimated from what differs between the repeats of a setup,
of each run a parabola in time taken off.

With the derivatives A of the readings by the errors, of unit size and correlation R, and white nuisances B,

    C = A D R D Aᵀ + S = LLᵀ,      ε = R Uᵀz,      V = R − R Uᵀ(1 − BBᵀ) U R,      U = L⁻¹AD,

are the errors' means and covariance given the data z; with q = ε² + diag V a step of the variational EM algorithm is
w = (ν + 1)/(ν + q/w₀), σ² ← σ² mean q.  Its lower bound of the log evidence, beyond that of the normal
distribution with those variances, is Σ ½(E ln w − ln E w) − KL(w ‖ prior).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, special

from stepdiag_ros.estimate.noise import FLOOR_M, Law, NoiseModel, Whitener, arrivals, moves, whiteners
from stepdiag_ros.estimate.reduce import StopTable

SWEEPS = 4
"""Steps of the EM algorithm for each law tried."""
LEAST_SPREAD, MOST_SPREAD = 0.7, 100.0


@dataclass(frozen=True)
class Latent:
    """The errors of one run's arrivals: ``columns`` (k, m) white readings by each, of unit size; ``prior`` (m, m) their
    correlations; ``source`` (m,): turn u, v, X, Y, Z; ``stops``: those (m lists) that rest on each; ``at`` slice of the
    white rows."""

    columns: np.ndarray
    prior: np.ndarray
    source: np.ndarray
    stops: list[np.ndarray]
    at: slice


def latents(table: StopTable, noise: NoiseModel, arrival: np.ndarray, white: Sequence[Whitener]) -> Iterator[Latent]:
    """The errors of arrivals, run by run, of readings whitened by ``white``; ``arrival`` (5, n, c) derivatives."""
    numbers, channels, start = arrivals(table), arrival.shape[2], 0
    shaped = noise.spread_of(arrival)
    for one in white:
        rows = np.unique(one.rows // channels)
        place = np.searchsorted(rows, one.rows // channels)
        columns, source, stops, blocks = [], [], [], []
        turn = moves(numbers[rows])
        for kind in range(5):
            own = turn if kind < 2 else numbers[rows, kind - 2]
            size, law = (noise.angle, noise.angle_law) if kind < 2 else (noise.position, noise.position_law)
            values, inverse = np.unique(own, return_inverse=True)
            part = np.zeros((len(one.rows), len(values)))
            part[np.arange(len(place)), np.ravel(inverse)[place]] = \
                size * shaped[kind].ravel()[one.rows]
            columns.append(part)
            source.append(np.full(len(values), kind))
            stops += [rows[np.ravel(inverse) == k] for k in range(len(values))]
            blocks.append(law.correlation ** np.abs(np.subtract.outer(values, values)))
        whole = linalg.solve_triangular(one.factor, np.concatenate(columns, axis=1), lower=True, check_finite=False)
        yield Latent(whole, linalg.block_diag(*blocks), np.concatenate(source), stops,
                     slice(start, start + len(one.rows)))
        start += len(one.rows)


def second_moments(latent: Latent, basis: np.ndarray, data: np.ndarray) -> np.ndarray:
    """Mean squares (m,) of a run's errors given ``data`` (N,), of which ``basis`` (N, r) is projected out, in units of
    what they were taken to be."""
    seen = latent.prior @ latent.columns.T
    lost = seen @ basis[latent.at]
    return (seen @ data[latent.at])**2 + 1.0 - np.sum(seen**2, axis=1) + np.sum(lost**2, axis=1)


def law_of(noise: NoiseModel, source: np.ndarray) -> np.ndarray:
    """Degrees of freedom (m,) of errors by their ``source``."""
    return np.where(source < 2, noise.angle_law.dof, noise.position_law.dof)


def wider(noise: NoiseModel, found: Sequence[Latent], moments: Sequence[np.ndarray], stops: int) -> tuple[NoiseModel, float]:
    """The noise with what each of the ``stops`` is wider by, given the errors' mean squares, and the log evidence that
    the tails bring beyond the normal distribution with those widths."""
    spread, evidence = np.ones((5, stops)), 0.0
    for latent, square in zip(found, moments, strict=True):
        dof = law_of(noise, latent.source)
        heavy = np.isfinite(dof)
        if not heavy.any():
            continue
        before = np.ones(len(square)) if noise.spread is None else np.array(
            [noise.spread[kind, rows[0]] for kind, rows in zip(latent.source, latent.stops, strict=True)])
        shape, rate = 0.5 * (dof[heavy] + 1.0), 0.5 * (dof[heavy] + square[heavy] * before[heavy]**2)
        mean, prior = shape / rate, 0.5 * dof[heavy]
        log = special.digamma(shape) - np.log(rate)
        # ½(E ln w − ln E w) − KL(Gamma(shape, rate) ‖ Gamma(prior, prior))
        evidence += float(np.sum(
            0.5 * (log - np.log(mean)) - (shape - prior) * special.digamma(shape) + special.gammaln(shape)
            - special.gammaln(prior) - prior * (np.log(rate) - np.log(prior)) - shape * (prior - rate) / rate))
        now = np.clip(1.0 / np.sqrt(mean), LEAST_SPREAD, MOST_SPREAD)
        for kind, rows, size in zip(latent.source[heavy], [latent.stops[k] for k in np.flatnonzero(heavy)], now,
                                    strict=True):
            spread[kind, rows] = size
    return replace(noise, spread=spread if not noise.tidy and np.any(spread != 1.0) else None), evidence


@dataclass(frozen=True)
class _Tried:
    """A noise model, held against the repeats, and the errors' mean squares."""

    noise: NoiseModel
    source: np.ndarray
    squares: np.ndarray

    def scaled(self) -> NoiseModel:
        """The noise with the sizes that the mean squares show."""
        factor = [float(np.sqrt(np.mean(self.squares[mine]))) if mine.any() else 1.0
                  for mine in (self.source >= 2, self.source < 2)]
        return replace(self.noise, position=max(self.noise.position * factor[0], FLOOR_M),
                       angle=max(self.noise.angle * factor[1], FLOOR_M))


class Repeats:
    """What differs between the repeats of each setup: all that they share, and a parabola in time of each, is open."""

    def __init__(self, table: StopTable, arrival: np.ndarray):
        self._arrival, self._setups = arrival, []
        readings = np.concatenate([table.displacement, table.spot], axis=1)
        for setup in np.unique(table.setup):
            rows = np.flatnonzero(table.setup == setup)
            own = table.select(rows)
            if len(np.unique(own.repeat)) > 1:
                present = np.isfinite(readings[rows]).ravel()
                shared = _shared(own) * present[:, None]
                left, size, _ = np.linalg.svd(shared, full_matrices=False)
                self._setups.append((own, rows, readings[rows], left[:, size > 1e-9 * max(size[0], 1e-300)]))

    def __bool__(self) -> bool:
        return bool(self._setups)

    def held_against(self, noise: NoiseModel) -> _Tried:
        """The noise held against the repeats; what single errors are wider by is found beside it."""
        sources, squares, spread = [], [], np.ones((5, self._arrival.shape[1]))
        for table, rows, readings, shared in self._setups:
            own = replace(noise, sensor=noise.sensor[rows], spread=None if noise.spread is None else noise.spread[:, rows])
            present, arrival = np.isfinite(readings), self._arrival[:, rows]
            white = whiteners(table, own, arrival, present)
            if not white:
                continue
            filled = np.where(present, readings, 0.0).ravel()
            open_ = np.concatenate([w(shared) for w in white])
            basis, _ = linalg.qr(open_, mode='economic', check_finite=False)
            data = np.concatenate([w(filled) for w in white])
            data = data - basis @ (basis.T @ data)
            found = list(latents(table, own, arrival, white))
            moments = [second_moments(latent, basis, data) for latent in found]
            now, _ = wider(own, found, moments, len(rows))
            sources += [latent.source for latent in found]
            squares += moments
            if now.spread is not None:
                spread[:, rows] = now.spread
        return _Tried(replace(noise, spread=None if noise.tidy else spread), np.concatenate(sources),
                      np.concatenate(squares))


def _shared(table: StopTable) -> np.ndarray:
    """Columns (n·c, k): what each channel shares at a stop in one direction, and a parabola in time of each traverse."""
    channels = table.displacement.shape[1] + 2
    place = np.unique(np.stack([table.direction, table.index]), axis=1, return_inverse=True)[1].ravel()
    pass_ = np.unique(np.stack([table.run, table.direction, table.repeat]), axis=1, return_inverse=True)[1].ravel()
    time = np.zeros(len(table))
    for number in np.unique(pass_):
        mine = pass_ == number
        course = table.time_s[mine]
        time[mine] = (course - course[0]) / max(float(np.ptp(course)), 1e-9)
    same = (place[:, None] == np.unique(place)).astype(float)
    passes = (pass_[:, None] == np.unique(pass_)).astype(float)
    # A constant in each traverse is one in each place once too often: the first traverse of a direction goes without.
    columns = np.concatenate([same, *(passes * (time**power)[:, None] for power in range(3))], axis=1)
    return np.kron(columns, np.eye(channels))


def sized(noise: NoiseModel, repeats: Repeats) -> NoiseModel:
    """The noise with the sizes that the repeats show under its laws."""
    noise = replace(noise, spread=None)
    for _ in range(SWEEPS):
        noise = repeats.held_against(noise).scaled()
    return replace(noise, spread=None)
