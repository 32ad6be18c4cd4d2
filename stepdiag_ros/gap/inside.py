"""What only the single samples show: shaking inside a dwell, and clocks that disagree.

Vibration has no fixed phase and leaves the means alone; it is looked for as a line in the mean power
spectrum of all dwells.  A sensor whose stamps are off sees the moves at the wrong time: a move's
middle is found where the reading is half-way, which for a jerk-limited move is half-way in time.
"""

from dataclasses import dataclass

import numpy as np

from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.model.log import CalibrationLog, Samples

TREND = 4
"""Polynomial terms taken off each dwell before its spectrum: drift and creep are not vibration."""
CREEP = np.array([0.08, 0.2, 0.5, 1.2])
"""Time constants, in half dwells, of the exponentials taken off as well."""
LEAST_SAMPLES = 20
PADDING = 4
NEIGHBOURS = 5
HELD = 12.0
"""Powers of single dwells are held to this many medians."""


@dataclass(frozen=True)
class Vibration:
    """A line in the spectrum: ``frequency`` [Hz] (as sampled: it may be an alias), ``amplitude`` and its
    ``sigma`` [m], ``log_bayes`` against none, ``share`` of the dwells' variance."""

    frequency: float
    amplitude: float
    sigma: float
    log_bayes: float
    share: float


@dataclass(frozen=True)
class Timing:
    """When a sensor sees the moves: ``offset`` [s] of their middles against the sequencer's, its
    ``sigma``; ``before`` and ``after``: share of moves seen to go on outside MOVE … DWELL; ``moves``;
    ``period`` [s] of the samples."""

    offset: float
    sigma: float
    before: float
    after: float
    moves: int
    period: float


def vibration(log: CalibrationLog, table: StopTable) -> Vibration | None:
    """The strongest line in the dwells' displacement, or None where dwells are too short to tell."""
    samples = log.displacement
    parts: dict[int, list[np.ndarray]] = {}
    periods = []
    for lo, hi in table.displacement_rows:
        values = samples.values[lo:hi, 0]
        if len(values) < LEAST_SAMPLES or not np.isfinite(values).all():
            continue
        periods.append(np.median(np.diff(samples.time_ns[lo:hi])) * 1e-9)
        parts.setdefault(len(values), []).append(values - values[0])
    if not parts:
        return None
    count = max(parts, key=lambda n: len(parts[n]))
    dwells, period = np.array(parts[count]), float(np.median(periods))
    if len(dwells) < 8 or period <= 0.0:
        return None
    time = np.linspace(-1.0, 1.0, count)
    creep = np.exp(-(time[:, None] + 1.0) / CREEP)
    basis, _ = np.linalg.qr(np.column_stack([np.vander(time, TREND), creep]))
    dwells = dwells - (dwells @ basis) @ basis.T
    spectrum = np.abs(np.fft.rfft(dwells, PADDING * count, axis=1)) ** 2 / count
    # A window of zero trend lets less through at low frequencies: count in units of white noise.
    passed = np.abs(np.fft.rfft(np.eye(count) - basis @ basis.T, PADDING * count, axis=1)) ** 2
    passed = passed.sum(axis=0) / count
    frequency = np.fft.rfftfreq(PADDING * count, period)
    usable = (passed > 0.3) & (frequency > 0.0)
    frequency, spectrum = frequency[usable], spectrum[:, usable] / passed[usable]
    # A few dwells that jump must not look like a line: powers are held to a multiple of the median.
    typical = np.minimum(spectrum, HELD * np.median(spectrum, axis=0)).mean(axis=0)
    background = np.array([np.median(np.delete(
        typical[max(0, i - NEIGHBOURS * PADDING):i + NEIGHBOURS * PADDING + 1],
        slice(max(0, min(i, NEIGHBOURS * PADDING) - PADDING),
              min(i, NEIGHBOURS * PADDING) + PADDING + 1))) for i in range(len(typical))])
    ratio = typical / background
    best = int(np.argmax(ratio))
    excess = float(max(ratio[best], 1.0))
    effective = float(len(dwells))
    # A mean of n exponentials: its likelihood ratio against the neighbours' level.
    log_bayes = effective * (excess - 1.0 - np.log(excess)) - np.log(len(ratio) / PADDING) - 3.0
    power = max(typical[best] - background[best], 0.0)
    amplitude = float(np.sqrt(4.0 * power / count))
    sigma = float(amplitude / np.sqrt(2.0 * effective) * excess / max(excess - 1.0, 1e-6) / 2.0)
    total = float(np.mean(dwells**2))
    return Vibration(float(frequency[best]), amplitude, sigma, float(min(log_bayes, 1e4)),
                     float(min(amplitude**2 / 2.0 / max(total, 1e-300), 1.0)))


def timing(samples: Samples, table: StopTable, columns: np.ndarray) -> Timing | None:
    """Timing of one sensor; ``columns`` (n, k) [m] are the readings' dwell means at the stops."""
    offsets, weights, before, after, periods = [], [], 0, 0, []
    moves = 0
    for i in range(1, len(table)):
        if table.move_ns[i] < 0 or table.run[i] != table.run[i - 1]:
            continue
        step = columns[i] - columns[i - 1]
        k = int(np.argmax(np.abs(np.nan_to_num(step))))
        if not np.isfinite(step[k]) or step[k] == 0.0:
            continue
        duration = table.dwell_ns[i] - table.move_ns[i]
        pad = (table.done_ns[i] - table.dwell_ns[i]) // 2
        lo, hi = np.searchsorted(samples.time_ns, [table.move_ns[i] - pad, table.dwell_ns[i] + pad])
        time = (samples.time_ns[lo:hi] - table.move_ns[i]) * 1e-9
        inside = (time > 0.0) & (time < duration * 1e-9)
        if inside.sum() < 4:
            continue
        level, goal = _rest(samples, table, i - 1, k), _rest(samples, table, i, k)
        if level is None or goal is None or goal[0] == level[0]:
            continue
        progress = (samples.values[lo:hi, k] - level[0]) / (goal[0] - level[0])
        moving = progress[(progress > 0.05) & (progress < 0.95)]
        if len(np.unique(moving)) < max(3, 0.8 * len(moving)):
            continue  # a reading that moves in steps tells no time
        noise = max(level[1], goal[1]) / abs(goal[0] - level[0])
        if noise > 0.01:
            continue
        cross = np.flatnonzero((progress[:-1] < 0.5) & (progress[1:] >= 0.5))
        if len(cross) != 1:
            continue
        c = cross[0]
        part = (0.5 - progress[c]) / (progress[c + 1] - progress[c])
        rate = (progress[c + 1] - progress[c]) / (time[c + 1] - time[c])
        offsets.append(time[c] + part * (time[c + 1] - time[c]) - 0.5e-9 * duration)
        weights.append(max(noise / rate, 1e-5) ** -2.0)
        # Real motion, not creep: beyond a thousandth of the step and far outside the noise.
        level_of_motion = max(1e-3, 8.0 * noise)
        before += bool(np.any(progress[time < 0.0] > level_of_motion))
        after += bool(np.any(progress[time > duration * 1e-9] < 1.0 - level_of_motion))
        periods.append(np.median(np.diff(time)))
        moves += 1
    if moves < 8:
        return None
    offsets = np.array(offsets)
    middle = float(np.median(offsets))
    spread = float(np.median(np.abs(offsets - middle))) / 0.6745
    return Timing(middle, max(1.2533 * spread / np.sqrt(moves), 1e-5), before / moves,
                  after / moves, moves, float(np.median(periods)))


def steps(samples: Samples, table: StopTable, rows: np.ndarray) -> np.ndarray:
    """Step [m] in which each column of a sensor's readings moves (k,); 0 where its noise hides any.

    A reading moves in steps where most neighbours in a dwell are equal to the last bit and the others
    differ by whole multiples of the least difference.
    """
    columns = samples.values.shape[1]
    result = np.zeros(columns)
    for k in range(columns):
        differences = [np.diff(samples.values[lo:hi, k]) for lo, hi in rows if hi - lo > 2]
        if not differences:
            continue
        flat = np.abs(np.concatenate(differences))
        flat = flat[np.isfinite(flat)]
        levels = np.concatenate([samples.values[lo:lo + 1, k] for lo, hi in rows if hi > lo])
        apart = np.diff(np.unique(levels))
        if not len(flat) or np.mean(flat == 0.0) < 0.5 or not len(apart):
            continue
        apart = apart[apart > 1e-12]
        if len(apart):
            least = float(apart.min())
            ratio = apart / least
            if np.mean(np.abs(ratio - np.rint(ratio)) < 0.05) > 0.8:
                result[k] = least
    return result


def _rest(samples: Samples, table: StopTable, i: int, k: int) -> tuple[float, float] | None:
    """Level and noise of one column in the middle half of a dwell: neither end may still move."""
    length = table.done_ns[i] - table.dwell_ns[i]
    lo, hi = np.searchsorted(samples.time_ns, [table.dwell_ns[i] + length // 4,
                                               table.done_ns[i] - length // 4])
    values = samples.values[lo:hi, k]
    values = values[np.isfinite(values)]
    if len(values) < 3:
        return None
    middle = float(np.median(values))
    return middle, float(np.median(np.abs(values - middle))) / 0.6745 + 1e-12
