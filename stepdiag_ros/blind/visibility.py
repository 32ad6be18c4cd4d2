"""How well an effect can be seen in a log: its norm in parity space, in standard deviations.

Let δ be the change of the stops' means that the effect brings, the same noise acting with and
without it.  Whitened with the true noise and freed of all that the 21 errors, the set-up and the
resets can imitate, its norm is the root of the non-central χ² by which the best possible test sees the effect:

    visibility² = min over θ of |W(f(θ₀) + δ − f(θ))|² + (θ − θ₀)ᵀP(θ − θ₀),

f the enhanced method's model, θ₀ the truth, P the priors of its unknowns (:mod:`stepdiag_ros.estimate.imitation`).
Where the model is straight this is

    δᵀWᵀWδ − δᵀWᵀWJ (JᵀWᵀWJ + P)⁻¹ JᵀWᵀWδ.

An effect that strikes at random (other phases in each dwell, now and then a stop) has no fixed
pattern to look for, only power: of a sum λ of squares over k degrees of freedom the best test sees
λ/√(2k) standard deviations, and that is counted.

Effects that act only inside the dwells (settling, clock skew, vibration) are seen there as well,
against the sensors' noise alone, and the two are added in squares.  Where all dwells look alike, a
dwell's samples minus their mean, averaged in bins, give a norm as above.  Where they do not, it is the
mean spectrum of the dwells that tells: its departure from a white one, in standard deviations,
because more of white noise would only count as noise.  Other effects move a little during a dwell
too; that is reported, but not counted.

Wrong stamps change no sample, only where it counts to.  Their change is that of logs without the sensors' noise:
a noisy sample that goes to another bin would bring an exchange of noise, which is no sign of anything.  And
they are seen in motion, where a reading r that is late by τ is off by −ṙτ.  How long a control takes over a
kind of move is not known, so that of the interferometer's τ only differences between equal moves are seen; of
the spot's, differences to the interferometer's (how guides bend a move turns with its direction, a delay does not):

    visibility² += Σ (τᵢ − τ̄ᵢ)² / (1/wᵢ + j²) + Σ (τₛ − τᵢ)² / (1/wₛ + j²),     w = Σ (ṙ/σ)²,

summed over the moves, j what equal moves of a control repeat to.
"""

from dataclasses import dataclass

import numpy as np

from stepdiag_ros.estimate.dense import normal_equations
from stepdiag_ros.estimate.enhanced import prior_precision, readings_of
from stepdiag_ros.estimate.forward import ForwardModel
from stepdiag_ros.estimate.imitation import what_is_left
from stepdiag_ros.estimate.noise import NoiseModel, sensor_noise, whiteners
from stepdiag_ros.estimate.parameters import Parameters, parameters_of
from stepdiag_ros.estimate.reduce import StopTable, reduce_log
from stepdiag_ros.model.log import CalibrationLog, Samples
from stepdiag_ros.model.machine import AXES
from stepdiag_ros.virtual.cell import Cell

BINS = 8
JITTER_S = 1e-4
"""What a control's equal moves repeat to in time."""


@dataclass(frozen=True)
class Visibility:
    """``stops``: seen in the stops' means; ``inside``: within the dwells; ``total``: what counts.

    All in standard deviations.
    """

    stops: float
    inside: float
    total: float


class Yardstick:
    """The undisturbed log of a cell: what every effect in that cell is measured by.

    The Jacobian is that at the truth; nothing has to be fitted for it.  ``still``: the same log without the
    sensors' noise, against which wrong stamps are held.
    """

    def __init__(self, cell: Cell, log: CalibrationLog, still: CalibrationLog | None = None):
        self.log, self.still, self.noise = log, still, cell.description.noise
        self.table = table = reduce_log(log)
        parameters = parameters_of(log.description, table)
        self._theta = true_parameters(cell, parameters)
        _, jacobian, self._arrival = ForwardModel(log.description, table, parameters).jacobian(self._theta)
        self._noise = NoiseModel(self.noise.position_repeatability, self.noise.angle_repeatability,
                                 sensor_noise(table, self.noise), 'belief')
        self._readings = readings_of(table)
        self._present = np.isfinite(self._readings)
        self.white = whiteners(table, self._noise, self._arrival, self._present)
        data = normal_equations(jacobian, self.white)
        scale = 1.0 / np.sqrt(np.diag(data + prior_precision(parameters)))
        self.parameters = parameters
        self._dof = int(self._present.sum()) - np.linalg.matrix_rank(
            data * scale[:, None] * scale, tol=1e-9, hermitian=True)

    def change(self, log: CalibrationLog, before: CalibrationLog | None = None) -> np.ndarray:
        """Change of the stops' means (n, c) [m] against the undisturbed log or ``before``, 0 where absent."""
        delta = self._stops(log) - (self._readings if before is None else self._stops(before))
        return np.where(self._present & np.isfinite(delta), delta, 0.0)

    def _stops(self, log: CalibrationLog) -> np.ndarray:
        beams = self.table.displacement.shape[1]
        return np.concatenate([
            _means(log.displacement, _rows(log.displacement, self.table), beams),
            _means(log.spot, _rows(log.spot, self.table), 2)], axis=1)

    def left(self, delta: np.ndarray) -> tuple[np.ndarray, float]:
        """What of ``delta`` (n, c) [m] the fit leaves (n, c) [m], and its power."""
        return what_is_left(self.log.description, self.table, self._noise, self._theta, delta)

    def visibility(self, log: CalibrationLog, random: bool = False,
                   inside: str | None = None) -> Visibility:
        """Of the effect that makes ``log`` of the undisturbed one.

        ``random``: it strikes at random; ``inside``: ``'coherent'`` or ``'random'`` for one that acts
        inside the dwells, ``'stamps'`` for wrong stamps, of which ``log`` is without the sensors' noise.
        """
        before = self.still if inside == 'stamps' else self.log
        _, power = self.left(self.change(log, self.still if inside == 'stamps' else None))
        seen = power / np.sqrt(2.0 * self._dof) if random else float(np.sqrt(power))
        within = self._spectral(log) if inside == 'random' else self._patterns(log, before)
        if inside == 'stamps':
            within = float(np.hypot(within, self._in_motion(log)))
        return Visibility(seen, within, float(np.hypot(seen, within)) if inside else seen)

    def shares(self, delta: np.ndarray) -> list[dict]:
        """Where the change lies that the fit leaves: variance by channel, setup, axis, direction.

        ``share``: of the sum of squares in units of each reading's own standard deviation (noise of
        arrivals included); ``share_m2``: of the sum of squares in metres.
        """
        (left, _), table = self.left(delta), self.table
        sigma = self._sigma()
        in_sigma, in_metres = (left / sigma) ** 2, left ** 2
        beams = left.shape[1] - 2
        entries: dict[tuple, np.ndarray] = {}
        for setup in np.unique(table.setup):
            for axis in np.unique(table.axis):
                for sign in (1, -1):
                    rows = (table.setup == setup) & (table.axis == axis) & (table.direction == sign)
                    for channel, columns in (('displacement', slice(0, beams)),
                                             ('spot_x', slice(beams, beams + 1)),
                                             ('spot_y', slice(beams + 1, None))):
                        key = (channel, table.setup_names[setup], int(axis), sign)
                        entries[key] = np.array([in_sigma[rows, columns].sum(),
                                                 in_metres[rows, columns].sum()])
        total = np.maximum(sum(entries.values()), 1e-300)
        return [{'channel': key[0], 'setup': key[1], 'axis': 'XYZ'[key[2]] if key[2] < 3 else None,
                 'direction': key[3], 'share': float(part[0] / total[0]),
                 'share_m2': float(part[1] / total[1])} for key, part in entries.items()]

    def _sigma(self) -> np.ndarray:
        """Standard deviation (n, c) [m] of each reading by itself."""
        arrival, noise = self._arrival, self._noise
        variance = noise.sensor ** 2 + noise.angle ** 2 * np.sum(arrival[:2] ** 2, axis=0) \
            + noise.position ** 2 * np.sum(arrival[2:] ** 2, axis=0)
        return np.sqrt(variance)

    def _channels(self, log: CalibrationLog, before: CalibrationLog):
        """Samples and dwells now and before, and the noise of a sample, of both sensors."""
        yield (log.displacement, _rows(log.displacement, self.table), before.displacement,
               self.table.displacement_rows, self.noise.displacement)
        yield (log.spot, _rows(log.spot, self.table), before.spot, self.table.spot_rows,
               self.noise.spot)

    def _patterns(self, log: CalibrationLog, undisturbed: CalibrationLog) -> float:
        """Norm of the change of the dwells' bins."""
        power = 0.0
        for now, rows, before, rows_before, sigma in self._channels(log, undisturbed):
            mean, number = _bins(now, rows, self.table)
            mean_before, number_before = _bins(before, rows_before, self.table)
            weight = np.minimum(number, number_before).astype(float)
            change = np.where((weight > 0.0)[..., None], mean - mean_before, 0.0)
            middle = np.sum(weight[..., None] * change, axis=1) \
                / np.maximum(weight.sum(axis=1), 1.0)[:, None]
            power += float(np.nansum(weight[..., None] * ((change - middle[:, None]) / sigma) ** 2))
        return float(np.sqrt(power))

    def _spectral(self, log: CalibrationLog) -> float:
        """Departure of the dwells' mean spectrum from a white one."""
        power = 0.0
        for now, rows, before, rows_before, sigma in self._channels(log, self.log):
            size = int(min((rows[:, 1] - rows[:, 0]).min(), (rows_before[:, 1] - rows_before[:, 0]).min()))
            if size < 4:
                continue
            change = now.values[rows[:, :1] + np.arange(size)] \
                - before.values[rows_before[:, :1] + np.arange(size)]
            spectrum = np.abs(np.fft.rfft(change, axis=1)[:, 1:]) ** 2 / (size * sigma ** 2)
            # A line of white noise has mean 1 and variance 1; so has each of the n that are summed.
            excess = np.nansum(spectrum, axis=0) / np.sqrt(len(rows))
            power += float(np.sum((excess - excess.mean(axis=0)) ** 2))
        return float(np.sqrt(power))


    def _in_motion(self, log: CalibrationLog) -> float:
        """How well wrong stamps are seen while the axes move, in standard deviations."""
        table, late, known = self.table, [], []
        moves = np.flatnonzero((table.move_ns >= 0) & (np.diff(table.run, prepend=-1) == 0))
        for now, before, sigma in ((log.displacement, self.still.displacement, self.noise.displacement),
                                   (log.spot, self.still.spot, self.noise.spot)):
            offset = (now.time_ns - before.time_ns) * 1e-9
            lo, hi = np.searchsorted(before.time_ns, [table.move_ns[moves], table.dwell_ns[moves]])
            late.append([offset[a:b].mean() if b > a else 0.0 for a, b in zip(lo, hi, strict=True)])
            known.append([_timed(before, a, b, sigma) for a, b in zip(lo, hi, strict=True)])
        (length, spot), (sharp, dull) = np.array(late), 1.0 / (1.0 / np.maximum(known, 1e-9) + JITTER_S**2)
        kinds = np.stack([table.setup, table.axis, table.direction], axis=1)[moves]
        _, kind = np.unique(kinds, axis=0, return_inverse=True)
        kind = kind.ravel()
        middle = (np.bincount(kind, sharp * length) / np.bincount(kind, sharp))[kind]
        return float(np.sqrt(np.sum(sharp * (length - middle) ** 2) + np.sum(dull * (spot - length) ** 2)))


def true_parameters(cell: Cell, parameters: Parameters) -> np.ndarray:
    """The truth of a cell as the unknowns of the enhanced method (size,); resets are left at zero."""
    theta = np.zeros(parameters.size)
    for name, knots in parameters.knots.items():
        axis = AXES.index(name[2])
        if name[1] in AXES:
            at = np.zeros((len(knots), 3))
            at[:, axis] = knots
            shift, _ = cell.geometry.motions(axis, knots)
            value = shift[:, AXES.index(name[1])] - at[:, AXES.index(name[1])]
        else:
            value = cell.geometry.motions(axis, knots)[1][:, 'ABC'.index(name[1])]
        theta[parameters.slice(name)] = (value - value[0])[1:]
    for setup in parameters.setups:
        first, turns = parameters.setup_first[setup], cell.misalignments[setup]
        theta[first:first + 4] = *turns.laser, *turns.mirror
    return theta


def _timed(samples: Samples, lo: int, hi: int, sigma: float) -> float:
    """Fisher information [1/s²] of a move's samples ``lo … hi`` about when it took place."""
    if hi - lo < 4:
        return 0.0
    time = (samples.time_ns[lo:hi] - samples.time_ns[lo]) * 1e-9
    # Samples that were lost tell nothing.
    return float(np.nansum(np.gradient(samples.values[lo:hi], time, axis=0) ** 2)) / sigma**2


def _rows(samples: Samples, table: StopTable) -> np.ndarray:
    """First and last (n, 2) of the samples that carry a dwell's time."""
    return np.stack([np.searchsorted(samples.time_ns, table.dwell_ns),
                     np.searchsorted(samples.time_ns, table.done_ns)], axis=1)


def _means(samples: Samples, rows: np.ndarray, columns: int) -> np.ndarray:
    """Means (n, columns) of the dwells' samples, NaN where there is none."""
    counts = rows[:, 1] - rows[:, 0]
    index = np.concatenate([np.arange(lo, hi) for lo, hi in rows])
    first = samples.values[np.minimum(rows[:, 0], len(samples) - 1), :columns]
    stop = np.repeat(np.arange(len(rows)), counts)
    apart = samples.values[index, :columns] - first[stop]
    sums = np.stack([np.bincount(stop, apart[:, k], minlength=len(rows)) for k in range(columns)], axis=1)
    return np.where(counts[:, None] > 0, first + sums / np.maximum(counts, 1)[:, None], np.nan)


def _bins(samples: Samples, rows: np.ndarray, table: StopTable) -> tuple[np.ndarray, np.ndarray]:
    """Means (n, BINS, k) and numbers (n, BINS) of a dwell's samples in equal parts of its time."""
    n, columns = len(rows), samples.values.shape[1]
    counts = rows[:, 1] - rows[:, 0]
    stop = np.repeat(np.arange(n), counts)
    index = np.concatenate([np.arange(lo, hi) for lo, hi in rows]) if n else np.zeros(0, int)
    share = (samples.time_ns[index] - table.dwell_ns[stop]) \
        / np.maximum(table.done_ns - table.dwell_ns, 1)[stop]
    cell = stop * BINS + np.clip((share * BINS).astype(int), 0, BINS - 1)
    number = np.bincount(cell, minlength=n * BINS)
    sums = np.stack([np.bincount(cell, samples.values[index, k], minlength=n * BINS)
                     for k in range(columns)], axis=1)
    mean = sums / np.maximum(number, 1)[:, None]
    return mean.reshape(n, BINS, columns), number.reshape(n, BINS)
