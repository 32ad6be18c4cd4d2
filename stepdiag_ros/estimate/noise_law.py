"""How the errors of arrivals are distributed: heavy tails and correlation, estimated from the log.

Real arrivals are not drawn from one normal distribution: now and then one is far off, and a stop may err as the one
before it did.  Each error is taken to be normal with a variance of its own, ``σ²/w``, ``w`` from a gamma distribution
of mean one, which makes it Student's t of ν degrees of freedom (Lange, Little & Taylor, J. Am. Stat. Assoc. 84, 1989);
neighbours are correlated by ρ.  Whatever is a cause stays outside of this: a tail is symmetric, has no memory and
does not come back in the next repeat.  So σ, ν and ρ are estimated from what differs between the repeats of a setup,
of each run a parabola in time taken off.

With the derivatives A of the readings by the errors, of unit size and correlation R, and white nuisances B,

    C = A D R D Aᵀ + S = LLᵀ,      ε = R Uᵀz,      V = R − R Uᵀ(1 − BBᵀ) U R,      U = L⁻¹AD,

are the errors' means and covariance given the data z.  With all others held, the data say of one error m ± √v; its
weight w is averaged over with N(m; 0, v + σ²/w) and its gamma distribution, exactly.  A step sets the variance of
each to σ²/E w and σ² to the mean of E wε²; what those averages are above the normal density with the variance that
each was taken to have is what tails add to the log evidence (as expectation propagation has it, Minka 2001).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy import linalg, special

from stepdiag_ros.estimate.noise import FLOOR_M, NoiseModel, Whitener, arrivals, moves, whiteners
from stepdiag_ros.estimate.reduce import StopTable

SWEEPS = 4
"""Steps of the EM algorithm for each law tried."""
LEAST_SPREAD, MOST_SPREAD = 0.5, 300.0
WEIGHTS = np.geomspace(1e-5, 30.0, 60)
"""Weights of single errors over which is summed."""


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
        whole = one.forward(np.concatenate(columns, axis=1))
        yield Latent(whole, linalg.block_diag(*blocks), np.concatenate(source), stops,
                     slice(start, start + len(one.rows)))
        start += len(one.rows)


@dataclass(frozen=True)
class Errors:
    """Errors of arrivals given the data, those of one run: ``latent``; ``mean`` (m,) and ``variance`` (m,) in units of
    what they were taken to be."""

    latent: Latent
    mean: np.ndarray
    variance: np.ndarray


def errors_of(latent: Latent, lost: np.ndarray, data: np.ndarray) -> Errors:
    """A run's errors given ``data`` (N,); ``lost`` (m, r): coordinates of its columns in what is projected out."""
    seen, lost = latent.prior @ latent.columns.T, latent.prior @ lost
    return Errors(latent, seen @ data[latent.at],
                  np.clip(1.0 - np.sum(seen**2, axis=1) + np.sum(lost**2, axis=1), 1e-9, 1.0))


def weighed(noise: NoiseModel, found: Sequence[Errors], stops: int,
            turn: int) -> tuple[NoiseModel, float, np.ndarray, np.ndarray]:
    """The noise with what each of the ``stops`` is wider by, given the errors; the log evidence that the tails bring
    beyond normal errors of the sizes that they were taken to have; and the errors' mean squares (m,) with their
    ``source`` (m,), in squares of the noise's sizes, each counted by its weight.

    All but one error held, the data say of that one m ± √v: 1/v = 1/V − 1, m = v ε/V.  Neighbours that one reading
    shows take turns, by ``turn`` (0, 1, 0, …): at once each would leave what is far off to the other, or both take it.
    """
    evidence, squares = 0.0, []
    spread = np.ones((5, stops)) if noise.spread is None else noise.spread.copy()
    for errors in found:
        latent = errors.latent
        square = errors.mean**2 + errors.variance
        for kind in range(5):
            law = noise.angle_law if kind < 2 else noise.position_law
            mine = np.flatnonzero(latent.source == kind)
            if np.isinf(law.dof) or not len(mine):
                continue
            first = np.array([latent.stops[k][0] for k in mine])
            before = np.ones(len(mine)) if noise.spread is None else noise.spread[kind, first]
            learnt = np.maximum(1.0 - errors.variance[mine], 1e-6)
            middle, wide = errors.mean[mine] / learnt * before, errors.variance[mine] / learnt * before**2
            total = wide[:, None] + 1.0 / WEIGHTS
            logs = _log_share(law.dof) - 0.5 * np.log(total) - 0.5 * middle[:, None]**2 / total
            peak = logs.max(axis=1)
            share = np.exp(logs - peak[:, None])
            whole = share.sum(axis=1)
            share, top = share / whole[:, None], peak + np.log(whole)
            plain = wide + before**2
            evidence += float(np.sum(top + 0.5 * np.log(plain) + 0.5 * middle**2 / plain))
            own = 1.0 / (WEIGHTS + 1.0 / wide[:, None])
            square[mine] = np.sum(share * WEIGHTS * (own + (own * (middle / wide)[:, None])**2), axis=1)
            now = np.clip(1.0 / np.sqrt(share @ WEIGHTS), LEAST_SPREAD, MOST_SPREAD)
            for k, size in zip(mine, now, strict=True):
                if latent.stops[k][0] % 2 == turn % 2:
                    spread[kind, latent.stops[k]] = size
        squares.append(square)
    return (replace(noise, spread=spread if noise.has_tails else None), evidence, np.concatenate(squares),
            np.concatenate([errors.latent.source for errors in found]))


@lru_cache
def _log_share(dof: float) -> np.ndarray:
    """Logarithm of the share (k,) of errors that have each of ``WEIGHTS``: the gamma distribution on that grid."""
    logs = 0.5 * dof * np.log(WEIGHTS) - 0.5 * dof * WEIGHTS
    return logs - special.logsumexp(logs)


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

    def held_against(self, noise: NoiseModel, turn: int) -> _Tried:
        """The noise held against the repeats; what single errors are wider by is found beside it, in ``turn``."""
        sources, squares, spread = [], [], np.ones((5, self._arrival.shape[1]))
        for table, rows, readings, shared in self._setups:
            own = replace(noise, sensor=noise.sensor[rows],
                          spread=None if noise.spread is None else noise.spread[:, rows])
            present, arrival = np.isfinite(readings), self._arrival[:, rows]
            white = whiteners(table, own, arrival, present)
            if not white:
                continue
            filled = np.where(present, readings, 0.0).ravel()
            open_ = np.concatenate([w(shared) for w in white])
            basis, _ = linalg.qr(open_, mode='economic', check_finite=False)
            data = np.concatenate([w(filled) for w in white])
            data = data - basis @ (basis.T @ data)
            found = [errors_of(latent, latent.columns.T @ basis[latent.at], data)
                     for latent in latents(table, own, arrival, white)]
            now, _, square, source = weighed(own, found, len(rows), turn)
            sources.append(source)
            squares.append(square)
            if now.spread is not None:
                spread[:, rows] = now.spread
        return _Tried(replace(noise, spread=None if noise.tidy else spread), np.concatenate(sources),
                      np.concatenate(squares))


def _shared(table: StopTable) -> np.ndarray:
    """Columns (n·c, k): what each channel shares at a stop in one direction, and a parabola in time of each pass."""
    channels = table.displacement.shape[1] + 2
    place = np.unique(np.stack([table.direction, table.index]), axis=1, return_inverse=True)[1].ravel()
    pass_ = np.unique(np.stack([table.run, table.direction, table.repeat]), axis=1, return_inverse=True)[1].ravel()
    time = np.zeros(len(table))
    for number in np.unique(pass_):
        mine = pass_ == number
        since = table.time_s[mine]
        time[mine] = (since - since[0]) / max(float(np.ptp(since)), 1e-9)
    same = (place[:, None] == np.unique(place)).astype(float)
    passes = (pass_[:, None] == np.unique(pass_)).astype(float)
    # A constant in each traverse is one in each place once too often: the first traverse of a direction goes without.
    columns = np.concatenate([same, *(passes * (time**power)[:, None] for power in range(3))], axis=1)
    return np.kron(columns, np.eye(channels))


def sized(noise: NoiseModel, repeats: Repeats) -> NoiseModel:
    """The noise with the sizes that the repeats show under its laws."""
    noise = replace(noise, spread=None)
    for turn in range(SWEEPS):
        noise = repeats.held_against(noise, turn).scaled()
    return replace(noise, spread=None)
