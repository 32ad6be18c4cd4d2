"""The noise of a log, taken from the log: repeats and the samples inside each dwell.

Three sources act (contract, section Topics).  An axis errs at each arrival by
``position`` [m] and keeps that error until it moves again, so that errors at
neighbouring stops are correlated.  The mirror's attitude errs by ``angle`` [rad],
anew at each arrival.  The sensors add noise, whose size at a stop is the scatter
inside the dwell divided by the root of the number of samples; by more where
neighbouring samples are alike.

``position`` and ``angle`` are estimated from contrasts between repeats of the same
run: what repeats cancels, errors of the machine and backlash included.  Of each
contrast a parabola in time is taken off first, so that a slow drift does not
count as noise; the squares are winsorised at two standard deviations, so that
a single jump does not either.  A log without repeats falls back on what its maker
believes, and says so.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.correlated import SLOW, not_rounding, of_mean
from stepdiag_ros.estimate.reduce import MOVED_M, StopTable
from stepdiag_ros.estimate.triangular import Banded, Full, kept
from stepdiag_ros.model.description import Noise
from stepdiag_ros.model.log import NONE, STOOD

FLOOR_M = 1e-11
"""Nothing is believed to be quieter than ten picometres: it keeps noise-free data solvable.  The rounding
of metres in doubles comes to no more than 1e-4 of this, while the priors of the unknowns stay visible."""
WINSOR = 2.0
WINSOR_MEAN = 0.9205369
"""Mean of min(z², 4) of a standard normal z: 1 − P − 4 φ(2) + 4 P with P = P(|z| > 2).
Up to a fifth of the contrasts may be outliers before the estimate follows them."""
LEAST_STOPS, FEWEST_STOPS = 7, 5
"""Stops of a contrast of which a parabola leaves enough; where no repeat has as many (a table of five targets), those
that it leaves something of at all."""
MAX_SWEEPS = 12
FASTEST = 3.0
"""Times over a dwell's length up to which frequencies count: a mean over the dwell leaves nothing of faster ones."""
WAVES = 120
"""Frequencies for which those of noise as 1/f stand."""
LOUDEST, MEDIAN_SQUARE = 16.0, 0.4549
"""Squares are held to so many times the quiet majority's; the median of χ² of one degree of freedom."""
LEAST_ALIKE = 4
"""Fewest dwells after moves of one kind from which what these leave can be told from noise."""
LEAST_SHARE = 0.02
"""Share of the variance below which a source's size is only felt for with short steps."""


@dataclass(frozen=True)
class Law:
    """How errors of arrivals are distributed: Student's t with ``dof`` degrees of freedom (infinite: normal), each with
    the ``correlation`` to the one before it, as of an AR(1) process."""

    dof: float = np.inf
    correlation: float = 0.0

    @property
    def tidy(self) -> bool:
        """Whether they are normal and independent."""
        return np.isinf(self.dof) and not self.correlation


@dataclass(frozen=True)
class NoiseModel:
    """Noise of the stops of one table.

    ``position`` [m], ``angle`` [rad]: arrival errors.  ``sensor`` (n, beams + 2) [m]: standard
    deviation of a dwell's mean by sensor noise alone.  ``source`` is ``repeats`` or ``belief``;
    ``dof`` (2,): degrees of freedom behind position and angle.  ``position_law``, ``angle_law``: how arrival errors
    are distributed; of Student's t, ``position`` and ``angle`` are the scale, and ``spread`` (5, n) is by how much each
    stop's turns about u, v and errors of X, Y, Z are wider than that (None: by nothing).
    """

    position: float
    angle: float
    sensor: np.ndarray
    source: str
    dof: tuple[int, int] = (0, 0)
    position_law: Law = Law()
    angle_law: Law = Law()
    spread: np.ndarray | None = None

    @property
    def tidy(self) -> bool:
        """Whether all arrival errors are normal and independent."""
        return self.position_law.tidy and self.angle_law.tidy

    @property
    def has_tails(self) -> bool:
        """Whether arrivals are now and then far off: errors of Student's t."""
        return bool(np.isfinite([self.position_law.dof, self.angle_law.dof]).any())

    def spread_of(self, arrival: np.ndarray) -> np.ndarray:
        """Derivatives ``arrival`` (5, n, c) by arrival errors, each times what it is wider by."""
        return arrival if self.spread is None else arrival * self.spread[:, :, None]

    def scaled(self, factor: float) -> 'NoiseModel':
        """All of it ``factor`` times as large."""
        return replace(self, position=self.position * factor, angle=self.angle * factor, sensor=self.sensor * factor)


@dataclass(frozen=True)
class Whitener:
    """Lower Cholesky factor of the covariance of the readings ``rows`` (flat [stop, channel]) of one run."""

    rows: np.ndarray
    triangle: Full | Banded

    @classmethod
    def of(cls, rows: np.ndarray, factor: np.ndarray) -> 'Whitener':
        """The whitener of ``rows`` (k,) by a factor (k, k) that is written out."""
        return cls(rows, kept(factor))

    @property
    def factor(self) -> np.ndarray:
        """The factor (k, k), written out."""
        return self.triangle.factor

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """White version of the readings or Jacobian rows, all of the log's given: (N, …) → (k, …)."""
        return self.forward(values[self.rows])

    def forward(self, right: np.ndarray) -> np.ndarray:
        """White version of the run's own rows (k, …)."""
        return self.solve(right)

    def solve(self, right: np.ndarray) -> np.ndarray:
        """``L⁻¹ b`` of the factor for ``right`` (k, …)."""
        return self.triangle.forward(right)

    def solve_back(self, right: np.ndarray) -> np.ndarray:
        """``L⁻ᵀ b`` for ``right`` (k, m)."""
        return self.triangle.backward(right)

    def weighted(self, right: np.ndarray) -> np.ndarray:
        """``Σ⁻¹ b`` for ``right`` (k, …), Σ the covariance of its rows."""
        return self.solve_back(self.solve(right))


def sensor_noise(table: StopTable, belief: Noise) -> np.ndarray:
    """Standard deviation of a dwell's mean by sensor noise (n, beams + 2) [m].

    The scatter is pooled by channel and setup (median of the variances): one dwell's own is too
    uncertain to weigh with.  Neighbouring samples may be alike: a mean over the dwell is then less certain than the
    root of their number says, by what follows from how much more means over parts of the dwells scatter
    (:mod:`stepdiag_ros.estimate.correlated`).  What disturbs the means besides is added stop by stop.
    """
    beams = table.displacement.shape[1]
    result = np.empty((len(table), beams + 2))
    for scatter, count, parts, columns, believed in (
            (table.displacement_scatter, table.displacement_count, table.displacement_parts, slice(0, beams),
             belief.displacement),
            (table.spot_scatter, table.spot_count, table.spot_parts, slice(beams, None), belief.spot)):
        pooled = np.full(scatter.shape, believed)
        for setup in np.unique(table.setup):
            rows = table.setup == setup
            for k in range(scatter.shape[1]):
                own = np.flatnonzero(rows & np.isfinite(scatter[:, k]))
                if len(own) > 2:
                    pooled[rows, k] = np.median(scatter[own, k]) / _of_median(float(np.median(count[own])))
        if parts is not None:
            slow, fast = _loud(parts / np.maximum(pooled, FLOOR_M)[:, :, None], table)
            own = not_rounding(np.median(pooled, axis=0), np.array(table.quanta or np.zeros(beams + 2))[columns])
            # Beams of one instrument, the two axes of one detector, are alike in this.
            pooled *= of_mean(slow, fast, count, np.isfinite(parts[:, :, :SLOW]).sum(),
                              float(np.mean(own)))
        result[:, columns] = pooled / np.sqrt(np.maximum(count, 1))[:, None]
    if table.disturbed is not None:
        result = np.sqrt(result**2 + table.disturbed)
    return np.maximum(result, FLOOR_M)


def _of_median(count: float) -> float:
    """What the median of the scatters of dwells of ``count`` samples is of their root mean square: as of χ² (E. B.
    Wilson and M. M. Hilferty, PNAS 17, 1931) with the freedom that differences of independent neighbours have."""
    freedom = 2.0 * (count - 1.0)**2 / (3.0 * count - 4.0)
    return (1.0 - 2.0 / (9.0 * freedom))**1.5


def _loud(parts: np.ndarray, table: StopTable) -> list[float]:
    """Factors by which the slow and the fast ones of ``parts`` (n, c, p), in units of a sample's noise, scatter more
    than those of independent samples; what moves of one kind leave in all their dwells is no noise."""
    kind = np.unique(np.stack([table.setup, table.axis, table.direction]), axis=1, return_inverse=True)[1].ravel()
    rest = np.full(parts.shape, np.nan)
    for number in np.unique(kind):
        rows = np.flatnonzero((kind == number) & np.isfinite(parts).all(axis=(1, 2)))
        if len(rows) >= LEAST_ALIKE:
            rest[rows] = (parts[rows] - parts[rows].mean(axis=0)) * np.sqrt(len(rows) / (len(rows) - 1.0))
    return [float(np.sqrt(np.mean([loudness(rest[:, c, some], 0.0)**2 for c in range(parts.shape[1])])))
            for some in (slice(SLOW), slice(SLOW, None))]


def loudness(values: np.ndarray, least: float = 1.0) -> float:
    """Factor, at ``least`` so much, by which ``values``, NaN where there is none, are larger than normal ones of size
    one; squares are held to ``LOUDEST`` times the quiet majority's."""
    square = values[np.isfinite(values)]**2
    if not square.any():
        return 1.0
    quiet = float(np.median(square)) / MEDIAN_SQUARE
    return max(least, float(np.sqrt(np.mean(np.minimum(square, LOUDEST * quiet)))))


def arrivals(table: StopTable) -> np.ndarray:
    """Number of the arrival that each axis rests on at each stop (n, 3), counted by the run's moves of any axis."""
    numbers = np.empty((len(table), 3), np.intp)
    for run in np.unique(table.run):
        rows = np.flatnonzero(table.run == run)
        index = table.index[rows].astype(int)
        fresh = (table.axis[rows, None] == np.arange(3)) | (table.axis[rows, None] == NONE)
        # Where several axes moved together their commanded positions say which.
        change = np.abs(np.diff(table.commanded[rows], axis=0)) > MOVED_M
        together = (table.axis[rows[1:]] == NONE) & change.any(axis=1)
        fresh[1:][together] = change[together]
        # A stop left out hides which axes moved meanwhile; one that is come back to from beyond says it.
        turned = (np.diff(index) == 0) & (np.diff(table.direction[rows].astype(int)) != 0)
        fresh[1:][(np.abs(np.diff(index)) != 1) & ~turned & (table.axis[rows[1:]] != STOOD)] = True
        fresh[0] = True
        move = np.cumsum(fresh.any(axis=1))
        numbers[rows] = np.maximum.accumulate(np.where(fresh, move[:, None], 0)) + 4 * len(table) * (run + 1)
    return numbers


def lasting(table: StopTable, rows: np.ndarray, as_steps: bool = False) -> np.ndarray:
    """Covariance (k, k) [m²] of the lengths at the stops ``rows``, alike in all beams, by what lasts from stop to stop.

    Of means over dwells of T at times τ apart: √(wᵢwⱼ) ∫ sinc²(fT) cos(2πfτ) df/f, from once a log on, for what
    wanders as 1/f; ¼ hᵢhⱼ e^(−2λτ) for what hops between two states λ times a second (Rice, random telegraph).
    ``as_steps``: so much larger that a normal distribution grants each hop what its rarity grants it: a step of h
    between two stops costs some four units of log likelihood, not 1/8λτ times as many.
    """
    total = np.zeros((len(rows), len(rows)))
    if table.hop is None and table.wander is None:
        return total
    time = table.time_s
    if table.hop is not None:
        apart = np.abs(np.subtract.outer(time[rows], time[rows]))
        between = table.hops_per_s * float(np.median(np.diff(time)))
        more = max(1.0, 0.125 / between) if as_steps else 1.0
        total += 0.25 * more * np.outer(table.hop[rows], table.hop[rows]) * np.exp(-2.0 * table.hops_per_s * apart)
    if table.wander is None:
        return total
    length = float(np.median(table.done_ns - table.dwell_ns)) * 1e-9
    edges = np.geomspace(1.0 / max(float(np.ptp(time)), 2.0 * length), FASTEST / length, WAVES + 1)
    frequency = np.sqrt(edges[1:] * edges[:-1])
    size = np.sqrt(np.log(edges[1] / edges[0])) * np.sinc(frequency * length) * np.sqrt(table.wander[rows])[:, None]
    turn = 2.0 * np.pi * frequency * time[rows][:, None]
    waves = np.concatenate([size * np.cos(turn), size * np.sin(turn)], axis=1)
    return total + waves @ waves.T


def as_noise(table: StopTable) -> np.ndarray | None:
    """Variance (n, c) [m²] that disturbances add to the readings' means; None without any."""
    if table.disturbed is None and table.wander is None and table.hop is None:
        return None
    beams = table.displacement.shape[1]
    result = np.zeros((len(table), beams + 2)) if table.disturbed is None else table.disturbed.copy()
    result[:, :beams] += np.diag(lasting(table, np.arange(len(table))))[:, None]
    return result


def moves(numbers: np.ndarray) -> np.ndarray:
    """Number (k,) of moves before each of the stops whose axes rest on the arrivals ``numbers`` (k, 3)."""
    return np.concatenate([[0], np.cumsum(np.any(np.diff(numbers, axis=0) != 0, axis=1))])


def run_covariance(rows: np.ndarray, position: float, angle: float, sensor: np.ndarray,
                   arrival: np.ndarray, numbers: np.ndarray,
                   correlation: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """Covariance of all readings of the stops ``rows`` of a run (k·c, k·c) [m²], order [stop, channel].

    ``arrival`` (5, n, c): derivatives by a turn about u, v and by a shift along X, Y, Z; ``correlation`` of an
    axis's error and of a turn with the one before.
    """
    k, channels = len(rows), sensor.shape[1]
    total = np.zeros((k, channels, k, channels))
    for axis in range(3) if position else ():
        alike = correlation[0] ** np.abs(np.subtract.outer(numbers[rows, axis], numbers[rows, axis]))
        effect = position * arrival[2 + axis][rows]
        total += (effect[:, :, None, None] * effect) * alike[:, None, :, None]
    # Anew at each stop, but alike as long as nothing moves.
    turns = moves(numbers[rows])
    alike = correlation[1] ** np.abs(np.subtract.outer(turns, turns))
    one, other = np.nonzero(alike)
    for turn in range(2):
        effect = arrival[turn][rows]
        total[one, :, other] += (angle**2 * alike[one, other])[:, None, None] * (
            effect[one][:, :, None] * effect[other][:, None, :])
    total = total.reshape(k * channels, k * channels)
    total[np.diag_indices(k * channels)] += sensor[rows].ravel()**2
    return total


def whiteners(table: StopTable, noise: NoiseModel, arrival: np.ndarray,
              present: np.ndarray) -> list[Whitener]:
    """One whitener a run; ``present`` (n, c) masks the readings that exist."""
    numbers, arrival = arrivals(table), noise.spread_of(arrival)
    channels = present.shape[1]
    correlation = noise.position_law.correlation, noise.angle_law.correlation
    result = []
    for run in np.unique(table.run):
        rows = np.flatnonzero(table.run == run)
        keep = present[rows].ravel()
        if not keep.any():
            continue
        covariance = run_covariance(rows, noise.position, noise.angle, noise.sensor, arrival, numbers, correlation)
        _add_to_lengths(covariance, lasting(table, rows, as_steps=True), channels)
        flat = (rows[:, None] * channels + np.arange(channels)).ravel()[keep]
        result.append(Whitener.of(flat, _root(covariance[np.ix_(keep, keep)], table, int(run))))
    return result


def _root(covariance: np.ndarray, table: StopTable, run: int) -> np.ndarray:
    """The lower Cholesky factor; :class:`StepdiagError` where a run's readings are so absurd that there is none."""
    try:
        return linalg.cholesky(covariance, lower=True)
    except (ValueError, linalg.LinAlgError):
        raise StepdiagError(f'run {run + 1} of the log: the scatter of its readings is no number that noise could '
                            'have; look at its samples with: stepdiag info BAG') from None


def _add_to_lengths(covariance: np.ndarray, more: np.ndarray, channels: int) -> None:
    """Add ``more`` (k, k) to every pair of lengths in ``covariance`` (k·c, k·c)."""
    k, beams = len(more), channels - 2
    covariance.reshape(k, channels, k, channels)[:, :beams, :, :beams] += more[:, None, :, None]


def estimate_noise(table: StopTable, belief: Noise, arrival: np.ndarray) -> NoiseModel:
    """Arrival errors from the repeats of ``table``; the maker's belief where there are none."""
    sensor = sensor_noise(table, belief)
    beams = sensor.shape[1] - 2
    readings = np.concatenate([table.displacement, table.spot], axis=1)
    numbers = arrivals(table)
    contrasts = list(_contrasts(table, readings))
    least = LEAST_STOPS if any(len(rows) >= LEAST_STOPS for rows, _, _ in contrasts) else FEWEST_STOPS
    sigma = {}
    dof = {}
    # The angle first: it reaches the distance through the arm beside the beam.
    for what, columns, believed in (('angle', [beams, beams + 1], belief.angle_repeatability),
                                    ('position', [0], belief.position_repeatability)):
        # A covariance is that of the other sources and, times its variance, that of the one in question.
        unit, rest = ((1.0, 0.0), (0.0, sigma['angle'])) if what == 'position' else ((0.0, 1.0), (0.0, 0.0))
        parts = []
        for rows, values, time in contrasts:
            for column in columns:
                good = np.isfinite(values[:, column])
                if good.sum() >= least:
                    own, of_one = rows[good], arrival[:, :, [column]]
                    fixed = run_covariance(own, *rest, sensor[:, [column]], of_one, numbers)
                    if column < beams:
                        fixed = fixed + lasting(table, own)
                    parts.append((fixed,
                                  run_covariance(own, *unit, np.zeros_like(sensor[:, [column]]), of_one, numbers),
                                  values[good, column], time[good]))
        dof[what] = sum(len(value) - 3 for *_, value, _ in parts)
        sigma[what] = believed
        if dof[what] < 8:
            continue
        known = max(believed, FLOOR_M)
        for _ in range(MAX_SWEEPS):
            total = other = 0.0
            for fixed, growing, value, time in parts:
                factor = linalg.cholesky(fixed + known**2 * growing, lower=True)
                white = _white_without_parabola(factor, value, time)
                total += np.sum(np.minimum(white**2, WINSOR**2)) / WINSOR_MEAN
                other += np.trace(linalg.cho_solve((factor, True), fixed)) / len(value) * len(white)
            # Scoring: what is not this source's share of the variance does not grow with it.
            share = max(1.0 - other / dof[what], LEAST_SHARE)
            change = 1.0 + (total / dof[what] - 1.0) / share
            updated = max(known * float(np.sqrt(max(change, 0.0))), FLOOR_M)
            settled = abs(updated / known - 1.0) < 1e-3
            known = updated
            if settled:
                break
        sigma[what] = known
    source = 'repeats' if dof['position'] >= 8 or dof['angle'] >= 8 else 'belief'
    return NoiseModel(sigma['position'], sigma['angle'], sensor, source,
                      (dof['position'], dof['angle']))


def _contrasts(table: StopTable, readings: np.ndarray):
    """Orthonormal contrasts between repeats: rows of the first repeat, values, time [s] in the run."""
    groups: dict[tuple, list[np.ndarray]] = {}
    for run in np.unique(table.run):
        for direction in np.unique(table.direction[table.run == run]):
            for repeat in np.unique(table.repeat[(table.run == run)
                                                 & (table.direction == direction)]):
                rows = np.flatnonzero((table.run == run) & (table.direction == direction)
                                      & (table.repeat == repeat) & (table.axis != STOOD))
                # Whatever a run's direction is called: only stops that came in the same order repeat each other.
                order = int(np.sign(int(table.index[rows[-1]]) - int(table.index[rows[0]])))
                groups.setdefault((int(table.setup[rows[0]]), int(direction), order), []).append(rows)
    for runs in groups.values():
        common = set.intersection(*(set(table.index[rows].tolist()) for rows in runs))
        runs = [rows[np.isin(table.index[rows], list(common))] for rows in runs]
        values = np.array([readings[rows] for rows in runs])
        time = (table.dwell_ns[runs[0]] - table.dwell_ns[runs[0][0]]) * 1e-9 if common else None
        for r in range(1, len(runs)):
            if common:
                yield runs[0], (values[:r].sum(0) - r * values[r]) / np.sqrt(r * (r + 1)), time


def _white_without_parabola(factor: np.ndarray, value: np.ndarray, time: np.ndarray) -> np.ndarray:
    """White residuals (k − 3,) of ``value`` about its best parabola in time; ``factor`` of its covariance."""
    scaled = time / max(time[-1], 1e-9) if len(time) else time
    trend = np.stack([np.ones_like(scaled), scaled, scaled**2], axis=1)
    white = linalg.solve_triangular(factor, np.column_stack([trend, value]), lower=True)
    basis, _ = linalg.qr(white[:, :3], mode='full')
    return basis[:, 3:].T @ white[:, 3]
