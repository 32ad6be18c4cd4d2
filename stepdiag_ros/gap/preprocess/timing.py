"""What only the single samples show: clocks that disagree, and readings that move in steps.

A sensor whose stamps are off sees the moves at the wrong time: a move's middle is found where the
reading is half-way, which for a jerk-limited move is half-way in time.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.estimate.samples import quantum
from stepdiag_ros.model.log import CalibrationLog, Samples

ONSET_SIGMAS = 8.0
"""Standard deviations of a reading at rest beyond which it moves."""
SURE_NS = 1_000_000
"""A sample whose time is known worse than this tells nothing of a clock."""
LEAST_MOVES = 24
"""Fewest moves from which the delay between two sensors is estimated."""
LEAST_STRETCHES = 6
"""Fewest stretches by which those moves must agree."""
LONGER = 4
"""Times a delay between the sensors is sought again, once what was found of it is taken off."""
MOST_NOISE = 0.5
"""Noise over step of a move, above which it says next to nothing of a delay; hundreds of faint moves together do."""
MOST_GAP = 2.5
"""Periods between two samples of a move, above which it tells nothing of a delay."""
FAINT = 1e-5
"""Noise over step, above which a jerk-limited move is well under way before it is seen."""


@dataclass(frozen=True)
class Timing:
    """When a sensor sees the moves: ``offset`` [s] of their middles against the sequencer's, its
    ``sigma``; ``onset`` [s] after the command at which motion is first seen (``sharp``: so well that
    samples resolve it); ``before`` and ``after``:
    share of moves seen to go on outside MOVE … DWELL; ``sooner`` [s]: how long before the command motion
    is seen for certain, in the clearest few moves; ``drift`` [s] of the middles from the log's
    beginning to its end, moves of a kind compared with each other, and ``drift_sigma``; ``moves``;
    ``period`` [s] of the samples."""

    offset: float
    sigma: float
    onset: float
    sharp: bool
    before: float
    after: float
    sooner: float
    drift: float
    drift_sigma: float
    moves: int
    period: float


def well_timed(samples: Samples) -> Samples:
    """The samples whose time of taking is known, or of which the log does not say how well it is."""
    if samples.uncertainty_ns is None:
        return samples
    sure = samples.uncertainty_ns <= SURE_NS
    if sure.all() or sure.sum() < 0.2 * len(sure):
        return samples
    return replace(samples, **{name: value[sure] for name, value in vars(samples).items()
                               if isinstance(value, np.ndarray) and len(value) == len(sure)})


def timing(samples: Samples, table: StopTable, columns: np.ndarray) -> Timing | None:
    """Timing of one sensor; ``columns`` (n, k) [m] are the readings' dwell means at the stops."""
    offsets, kinds, times, firsts, onsets, faint, periods = [], [], [], [], [], [], []
    before = after = moves = 0
    rest = _rests(samples, table)
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
        there = lo + np.flatnonzero(np.isfinite(samples.values[lo:hi, k]))
        time = (samples.time_ns[there] - table.move_ns[i]) * 1e-9
        inside = (time > 0.0) & (time < duration * 1e-9)
        if inside.sum() < 4:
            continue
        level, goal = rest(i - 1, k), rest(i, k)
        if level is None or goal is None or goal[0] == level[0]:
            continue
        values = samples.values[there, k]
        progress = (values - level[0]) / (goal[0] - level[0])
        moving = progress[(progress > 0.05) & (progress < 0.95)]
        if len(np.unique(moving)) < max(3, 0.8 * len(moving)):
            continue  # a reading that moves in steps tells no time
        noise = max(level[1], goal[1]) / abs(goal[0] - level[0])
        # Readings in steps hide their noise where a dwell sees one step only.
        levels = np.unique(values[~inside])
        if noise < 1e-11 and len(levels) < 4:
            noise = np.inf
        if noise > 0.01:
            continue
        cross = np.flatnonzero((progress[:-1] < 0.5) & (progress[1:] >= 0.5))
        if len(cross) != 1:
            continue
        c = cross[0]
        part = (0.5 - progress[c]) / (progress[c + 1] - progress[c])
        offsets.append(time[c] + part * (time[c + 1] - time[c]) - 0.5e-9 * duration)
        kinds.append((table.setup[i], table.axis[i], table.direction[i], round(duration * 1e-6)))
        times.append(table.dwell_ns[i])
        # Real motion, not creep: beyond a thousandth of the step and far outside the noise.
        level_of_motion = max(1e-3, 8.0 * noise)
        before += bool(np.any(progress[time < 0.0] > level_of_motion))
        after += bool(np.any(progress[time > duration * 1e-9] < 1.0 - level_of_motion))
        # Before the command the tool has rested for a dwell: there the noise alone is the limit.
        # The last sample at rest, from the middle backwards, leaves motion that never pauses.
        first = c + 1
        while first > 0 and ONSET_SIGMAS * noise < progress[first - 1] < progress[first]:
            first -= 1
        firsts.append(time[first])
        faint.append(noise)
        if first < c:
            # A jerk-limited move begins with the cube of time.
            ratio = np.cbrt(progress[first] / progress[first + 1])
            begin = (time[first] - ratio * time[first + 1]) / (1.0 - ratio)
            onsets.append(np.clip(begin, time[first - 1] if first else -np.inf, time[first]))
        periods.append(np.median(np.diff(time)))
        moves += 1
    if moves < 8:
        return None
    offsets = np.array(offsets)
    middle = float(np.median(offsets))
    spread = float(np.median(np.abs(offsets - middle))) / 0.6745
    drift, drift_sigma = _drift(offsets, np.array(times), kinds)
    clear = np.sort(firsts)[max(3, int(np.ceil(0.03 * moves))) - 1]
    # Where noise hides the first part of a move, its beginning is not seen.
    sharp = len(onsets) >= 8 and float(np.median(faint)) < FAINT
    return Timing(middle, max(1.2533 * spread / np.sqrt(moves), 1e-5),
                  float(np.median(onsets)) if len(onsets) else middle, sharp, before / moves,
                  after / moves, max(0.0, -float(clear)), drift, drift_sigma, moves,
                  float(np.median(periods)))


def apart(log: CalibrationLog, table: StopTable) -> tuple[float, float] | None:
    """How much later [s] the spot sees the moves than the displacement, and its σ; None with too few moves.

    In each move the spot's progress p is the displacement's, later by τ and bent by the guides:
    p_spot − p = −τ dp/dt + κ p (1 − p), over all samples of the move.  A bend changes its sign with the
    direction of motion, a delay does not: the moves to and fro over one stretch share a bend, which by one of
    them alone is hardly distinguished from a delay.  That is so of a delay that is short against the moves; a longer
    one is taken off and the rest sought again.
    """
    about, found = 0.0, _apart(log, table, 0.0)
    for _ in range(LONGER):
        if found is None or abs(found[0]) < found[1]:
            break
        about += found[0]
        found = _apart(log, table, about)
    return None if found is None else (about + found[0], found[1])


def _apart(log: CalibrationLog, table: StopTable, about: float) -> tuple[float, float] | None:
    """:func:`apart` of a spot whose samples were stamped ``about`` [s] earlier."""
    stretches: dict[tuple, list[np.ndarray]] = {}
    rests = [_rests(samples, table) for samples in (log.displacement, log.spot)]
    for i in range(1, len(table)):
        if table.move_ns[i] < 0 or table.run[i] != table.run[i - 1]:
            continue
        one = _progress(log.displacement, table, table.displacement, i, rests[0])
        two = _progress(log.spot, table, table.spot, i, rests[1])
        if one is None or two is None:
            continue
        (time, curve, _), (seen, spot, noise) = one, two
        seen = seen - about
        place = np.interp(seen, time, curve)
        rate = np.interp(seen, time, np.gradient(curve, time))
        inside = (place > 0.02) & (place < 0.98)
        if inside.sum() < 4 or len(np.unique(spot[inside])) < 0.8 * inside.sum():
            continue
        ends = tuple(np.round(table.commanded[i - 1], 9)), tuple(np.round(table.commanded[i], 9))
        forth = 1.0 if ends[0] < ends[1] else -1.0
        rows = np.column_stack([rate, forth * place * (1.0 - place), spot - place])[inside] / noise
        stretches.setdefault((table.setup[i], *sorted(ends)), []).append(rows)
    delays, sigmas, moves = [], [], 0
    for alike in stretches.values():
        rows = np.concatenate(alike)
        size = np.linalg.norm(rows[:, :2], axis=0)
        columns = rows[:, :2] / size
        normal = columns.T @ columns
        if np.linalg.cond(normal) > 1e8:
            continue
        spread = np.linalg.inv(normal)
        delays.append(-float((spread @ (columns.T @ rows[:, 2]))[0] / size[0]))
        sigmas.append(float(np.sqrt(spread[0, 0])) / size[0])
        moves += len(alike)
    if moves < LEAST_MOVES or len(delays) < LEAST_STRETCHES:
        return None
    delay, sigma = np.array(delays), np.array(sigmas)
    more, middle = 0.0, float(np.median(delay))
    for _ in range(8):
        weight = 1.0 / (sigma**2 + more)
        kept = (delay - middle) ** 2 * weight < 25.0
        if kept.sum() < LEAST_STRETCHES:
            kept[:] = True
        middle = float(np.sum((weight * delay)[kept]) / weight[kept].sum())
        excess = float(np.median((delay - middle) ** 2 * weight)) / 0.455 - 1.0
        more = max(0.0, more + excess / float(np.median(weight)))
    misfit = max(1.0, float(np.mean(((delay - middle) ** 2 * weight)[kept])))
    return middle, float(np.sqrt(misfit / weight[kept].sum()))


def _progress(samples: Samples, table: StopTable, columns: np.ndarray, i: int,
              rest: Callable[[int, int], tuple[float, float] | None]) -> tuple[np.ndarray, np.ndarray, float] | None:
    """Times [s] after the command, progress from rest to rest, and its noise, in the move to stop i; ``rest``
    as :func:`_rest` of the stop and the column."""
    step = columns[i] - columns[i - 1]
    k = int(np.argmax(np.abs(np.nan_to_num(step))))
    if not np.isfinite(step[k]) or step[k] == 0.0:
        return None
    pad = (table.done_ns[i] - table.dwell_ns[i]) // 2
    lo, hi = np.searchsorted(samples.time_ns, [table.move_ns[i] - pad, table.dwell_ns[i] + pad])
    level, goal = rest(i - 1, k), rest(i, k)
    if hi - lo < 8 or level is None or goal is None or goal[0] == level[0]:
        return None
    noise = max(level[1], goal[1]) / abs(goal[0] - level[0])
    time, values = (samples.time_ns[lo:hi] - table.move_ns[i]) * 1e-9, samples.values[lo:hi, k]
    there = np.isfinite(values)
    step_s = np.diff(time)
    # Between two samples one may be missing, as where it was no reading; over more the way is not known.
    if noise > MOST_NOISE or np.any(step_s <= 0.0) or not there.any() \
            or np.max(np.diff(time[there]), initial=0.0) > MOST_GAP * np.median(step_s):
        return None
    return time[there], (values[there] - level[0]) / (goal[0] - level[0]), noise


def _drift(offsets: np.ndarray, times: np.ndarray, kinds: list[tuple]) -> tuple[float, float]:
    """Change [s] of the moves' offsets over the log, and its σ, from moves of one kind compared.

    What a control takes to start and to report depends on the move and not on the hour; a clock
    that runs wrong does the opposite.
    """
    place = (times - times.min()) / max(float(np.ptp(times)), 1.0)
    _, group = np.unique(np.array(kinds), axis=0, return_inverse=True)
    group = group.ravel()
    kept = np.ones(len(offsets), bool)
    slope, sigma = 0.0, np.inf
    for _ in range(4):
        number = np.maximum(np.bincount(group[kept], minlength=group.max() + 1), 1)
        x = place - (np.bincount(group[kept], place[kept], len(number)) / number)[group]
        y = offsets - (np.bincount(group[kept], offsets[kept], len(number)) / number)[group]
        free = int(kept.sum() - np.count_nonzero(np.bincount(group[kept]))) - 1
        power = float(np.sum(x[kept] ** 2))
        if free < 8 or power < 1e-6:
            return 0.0, np.inf
        slope = float(np.sum(x[kept] * y[kept])) / power
        rest = y - slope * x
        sigma = float(np.sqrt(np.sum(rest[kept] ** 2) / free / power))
        kept = np.abs(rest) < 5.0 * max(float(np.median(np.abs(rest))) / 0.6745, 1e-7)
    return slope, sigma


def step_noise(samples: Samples, rows: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Variance (k,) [m²] of a dwell's mean by readings that move in steps of ``width`` (k,) [m].

    What a converter rounds off is a sawtooth of the level; noise σ of the samples smooths its k-th harmonic,
    of variance w²/2π²k², by exp(−4π²k²σ²/w²) (Widrow & Kollár, Quantization Noise, 2008).  Over all levels neighbours
    differ by the mean as much as they would unrounded, by 2σ/√π.
    """
    harmonic = np.arange(1, 50)
    result = np.zeros(len(width))
    for k in np.flatnonzero(width):
        differences = np.concatenate([np.abs(np.diff(samples.values[lo:hi, k])) for lo, hi in rows if hi - lo > 1])
        sigma = np.sqrt(np.pi) / 2.0 * float(np.nanmean(differences))
        power = np.exp(-4.0 * (np.pi * harmonic * sigma / width[k]) ** 2) / harmonic**2
        result[k] = width[k] ** 2 / (2.0 * np.pi**2) * float(power.sum())
    return result


def least_noise(samples: Samples, rows: np.ndarray, run: np.ndarray) -> np.ndarray:
    """Noise (columns,) [m] that a sample of any dwell has at least: what neighbours in the middle half of a typical
    dwell differ by, and what the step leaves open in which readings move; ``rows`` and ``run`` as for :func:`quantum`.

    A few samples of a reading in steps are alike now and then, as if they had no noise at all.
    """
    quarter = (rows[:, 1] - rows[:, 0]) // 4
    inner = zip(rows[:, 0] + quarter, rows[:, 1] - quarter, strict=True)
    sizes = [np.abs(np.diff(samples.values[lo:hi], axis=0)).mean(axis=0) for lo, hi in inner if hi - lo > 2]
    result = quantum(samples, rows, run) / np.sqrt(12.0)
    for k in range(len(result)):
        there = [size[k] for size in sizes if np.isfinite(size[k])]
        if there:
            result[k] = max(result[k], np.sqrt(np.pi) / 2.0 * float(np.median(there)))
    return result


def _rests(samples: Samples, table: StopTable) -> Callable[[int, int], tuple[float, float] | None]:
    """:func:`_rest` by stop and column, each worked out once: where one move ends, the next begins."""
    # Not the table's rows: samples of which the time is not known well may have been left out since.
    rows = np.searchsorted(samples.time_ns, np.stack([table.dwell_ns, table.done_ns], axis=1))
    return cache(partial(_rest, samples, table, least_noise(samples, rows, table.run)))


def _rest(samples: Samples, table: StopTable, least: np.ndarray, i: int, k: int) -> tuple[float, float] | None:
    """Level and noise of one column in the middle half of a dwell: neither end may still move; ``least`` as
    :func:`least_noise` gives it."""
    length = table.done_ns[i] - table.dwell_ns[i]
    lo, hi = np.searchsorted(samples.time_ns, [table.dwell_ns[i] + length // 4,
                                               table.done_ns[i] - length // 4])
    values = samples.values[lo:hi, k]
    values = values[np.isfinite(values)]
    if len(values) < 3:
        return None
    middle = _median(values)
    noise = _median(np.abs(values - middle)) / 0.6745 + 1e-12
    return middle, max(noise, float(least[k]))


def _median(values: np.ndarray) -> float:
    """Median of a few finite values; numpy's own spends most of its time on what may be odd about them."""
    ordered = np.sort(values)
    return float(ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2.0
