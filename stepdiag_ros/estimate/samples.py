"""The samples of a log without those that say nothing of where the machine is.

A sample without signal, one that repeats the reading before it because the instrument was asked too soon, one that a
driver drew as a straight line between others, and a lone spike are no readings: they become NaN, which all that follows
leaves out.  How many there were is stated.
"""

from dataclasses import dataclass, replace

import numpy as np

from stepdiag_ros.model.log import DWELL, NONE, CalibrationLog, Samples

DARK = 0.1
"""Share of the light of most samples below which a detector tells no place."""
SPIKE = 7.0
"""Standard deviations by which a spike stands out of both its neighbours, to one side."""
ABRUPT = 2.0
"""Times the smaller of the next steps to both sides that a spike stands out: the crest of a swing of up to a quarter of
the sampling rate, that dies away to 1/e in five samples or more, stands out 1.5 times at most."""
ALONE = 5.0
"""Times the larger of the next two steps that a spike at a dwell's end is off: of such a swing it is 3, or 4.5 where it
dies away."""
AGAIN = 1e-3
"""Share of readings equal to the last but one above which readings move in steps: equal neighbours then say nothing."""
STANDING = 0.3
"""Share of neighbours in the dwells that are equal to the last bit, from which readings may move in steps, and none is
a repetition."""
WHOLE = 0.8
"""Share of the differences between readings that are whole steps."""
UNDER_WAY = 5.0
"""Times the mean step between samples at rest, of noise 4 of its standard deviations, that a machine under way goes
from sample to sample."""
COUNTED = 1e4
"""Most steps that are counted in a difference of readings: over the way between two stops, millions of steps, not even
the seventh digit of the step tells a whole number."""
LEAST_TOLD = 0.005
"""Share of the samples below which what is left out is not spoken of …"""
HUNG = 10
"""… but for rows of so many repetitions: an instrument that is asked too soon repeats a reading once or twice."""
STRAIGHT = 1e-4
"""Of what samples at rest are off the line through their neighbours, up to which they are on it …"""
ON_A_LINE = 2
"""… and so many values of them, of samples on end or of one sample: of noise one pair in 10⁸ is."""


@dataclass(frozen=True)
class LeftOut:
    """Shares of one sensor's samples in the dwells: without signal, repeated, on straight lines, spikes; ``hung`` (k,)
    [s]: how long each time for which its driver sent one reading again and again."""

    dark: float
    repeated: float
    straight: float
    spikes: float
    hung: np.ndarray

    def words(self, sensor: str) -> str:
        """What was left out, '' where it is hardly anything."""
        parts = [f'{100.0 * share:.2g} % {what}' for share, what in (
            (self.dark, 'without signal'), (self.repeated, 'repeating the reading before'),
            (self.straight, 'on straight lines, as a driver fills in what it lost'),
            (self.spikes, 'single spikes')) if share >= LEAST_TOLD]
        if len(self.hung):
            parts.append(f'those of {len(self.hung)} times for which it sent one reading again and again, '
                         f'{self.hung.max():.2g} s at most (does its driver hang? see to its cable and its computer)')
        return f'{sensor}: samples left out: {", ".join(parts)}' if parts else ''


def clean(log: CalibrationLog, ends: bool = True) -> tuple[CalibrationLog, tuple[str, ...]]:
    """The log with NaN for samples that are no readings, and what was left out in words; ``ends``: whether a sample at
    the end of a dwell may be a spike, or could be of the next move, as where a clock is off."""
    displacement, first = _clean(log, log.displacement, log.displacement.health <= 0.0, ends)
    spot, second = _clean(log, log.spot, _dark(log.spot.health), ends)
    words = (first.words('interferometer'), second.words('position sensor'))
    return replace(log, displacement=displacement, spot=spot), tuple(w for w in words if w)


def quantum(samples: Samples, rows: np.ndarray, run: np.ndarray) -> np.ndarray:
    """Step [m] in which each column of a sensor's readings moves (k,), 0 where noise hides any; ``rows`` (n, 2): the
    samples of each dwell, ``run`` (n,) its run.

    Each run counts from where it was reset, so only differences within a run are whole multiples of a step.
    """
    result = np.zeros(samples.values.shape[1])
    for k in range(len(result)):
        dwells = [samples.values[lo:hi, k] for lo, hi in rows]
        dwells = [x[np.isfinite(x)] for x in dwells]
        steps = np.abs(np.concatenate([np.zeros(0), *(np.diff(x) for x in dwells)]))
        if not len(steps) or np.mean(steps == 0.0) < STANDING:
            continue
        levels = [np.diff(np.unique(np.concatenate([dwells[i] for i in np.flatnonzero(run == r)])))
                  for r in np.unique(run)]
        apart = np.concatenate([np.zeros(0), *levels])
        apart = apart[apart > 1e-12]
        if not len(apart):
            continue
        least = float(np.median(apart[apart < 1.5 * apart.min()]))
        apart = apart[apart < COUNTED * least]
        if np.mean(np.abs(apart / least - np.rint(apart / least)) < 0.05) > WHOLE:
            result[k] = least
    return result


def _dark(intensity: np.ndarray) -> np.ndarray:
    """Samples (n,) without light; none where no intensity was recorded."""
    lit = intensity[np.isfinite(intensity) & (intensity > 0.0)]
    if 2 * len(lit) < len(intensity) or not len(lit):
        return np.zeros(len(intensity), bool)
    return ~(intensity > DARK * np.median(lit))


def _clean(log: CalibrationLog, samples: Samples, dark: np.ndarray, ends: bool) -> tuple[Samples, LeftOut]:
    used = np.isfinite(samples.values).any(axis=0)
    if not used.any():
        return samples, LeftOut(0.0, 0.0, 0.0, 0.0, np.zeros(0))
    values = np.where(dark[:, None], np.nan, samples.values)
    dwell, way = _dwell_of(log, samples)
    inside = dwell >= 0
    dark = inside & ~np.isfinite(values[:, used]).all(axis=1)
    in_steps = _in_steps(values[:, used], dwell)
    repeated = _repeated(values[:, used], dwell, in_steps) | _carried_over(values[:, used], dwell, samples.setup) \
        | _stood_still(values[:, used], dwell, samples.setup, way)
    straight = np.zeros(len(values), bool) if in_steps else \
        _straight(values[:, used], samples.time_ns, dwell) & ~repeated
    values[repeated | straight] = np.nan
    spikes = _spikes(values[:, used], dwell, samples.setup, ends)
    values[spikes] = np.nan
    count = max(int(inside.sum()), 1)
    return replace(samples, values=values), LeftOut(dark.sum() / count, (repeated & inside).sum() / count,
                                                    (straight & inside).sum() / count, spikes.sum() / count,
                                                    _hung(samples.time_ns, repeated))


def _hung(time_ns: np.ndarray, repeated: np.ndarray) -> np.ndarray:
    """Times [s] (k,) for which one reading was ``repeated`` (n,), ``HUNG`` times and more on end."""
    first, last = _rows(repeated, HUNG)
    return (time_ns[last] - time_ns[first - 1]) * 1e-9


def _rows(which: np.ndarray, least: int) -> tuple[np.ndarray, np.ndarray]:
    """First and last (k,) of each row of at ``least`` so many samples on end of those (n,) ``which`` something is."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], which, [False]]).astype(np.int8)))
    first, last = edges[::2], edges[1::2] - 1
    long = last - first + 1 >= least
    return first[long], last[long]


def _dwell_of(log: CalibrationLog, samples: Samples) -> tuple[np.ndarray, np.ndarray]:
    """Number (n,) of the dwell in which each sample was taken, −1: in none; by setup and axis, a number (m,) for the
    kind of move that led to each, −1: none did."""
    events = log.steps
    order = np.argsort(events.time_ns, kind='stable')
    phase, time = events.phase[order], events.time_ns[order]
    last = np.searchsorted(time, samples.time_ns, side='right') - 1
    resting = (last >= 0) & (phase[np.maximum(last, 0)] == DWELL)
    return np.where(resting, last, -1), np.where(events.axis == NONE, -1, events.setup * NONE + events.axis)[order]


def _in_one_dwell(dwell: np.ndarray) -> np.ndarray:
    """Which samples (n − 1,) are of the same dwell as the one before."""
    return (dwell[1:] >= 0) & (dwell[1:] == dwell[:-1])


def _repeated(values: np.ndarray, dwell: np.ndarray, in_steps: bool) -> np.ndarray:
    """Samples (n,) that repeat the one before to the last bit; where readings move ``in_steps``, of those in motion
    only: a machine at rest is read alike again and again, one that goes on is not."""
    again = np.zeros(len(values), bool)
    if len(values) < 3:
        return again
    same = (values[1:] == values[:-1]).all(axis=1)
    if in_steps:
        same &= _under_way(values, same, dwell)
    # In motion too: there it would be late by the time between two samples, and a clock seem off.
    again[1:] = same
    return again


def _in_steps(values: np.ndarray, dwell: np.ndarray) -> bool:
    """Whether readings (n,) move in steps, or do not say whether: equal neighbours are no repetition then."""
    resting = (dwell[2:] >= 0) & (dwell[2:] == dwell[:-2])
    same = (values[1:] == values[:-1]).all(axis=1)
    returned = (values[2:] == values[:-2]).any(axis=1) & ~same[1:] & ~same[:-1]
    return not resting.any() or bool(np.mean(returned[resting]) > AGAIN or np.mean(same[1:][resting]) > STANDING)


def _straight(values: np.ndarray, time_ns: np.ndarray, dwell: np.ndarray) -> np.ndarray:
    """Samples (n,) of rows that lie on a straight line in time, as no reading with noise does."""
    out = np.zeros(len(values), bool)
    slope = np.diff(values, axis=0) / np.maximum(np.diff(time_ns), 1)[:, None]
    bend = np.abs(np.diff(slope, axis=0))
    resting = bend[(dwell[2:] >= 0) & (dwell[2:] == dwell[:-2]) & np.isfinite(bend).all(axis=1)]
    if not len(resting):
        return out
    on = np.zeros(len(values), bool)
    on[1:-1] = (bend < STRAIGHT * np.median(resting, axis=0)).all(axis=1)
    for first, last in zip(*_rows(on, -(-ON_A_LINE // values.shape[1])), strict=True):
        out[first:last + 1] = True
    return out


def _under_way(values: np.ndarray, same: np.ndarray, dwell: np.ndarray) -> np.ndarray:
    """Which steps (n − 1,) from sample to sample are of a machine that moves on: those before and after the ones that
    are ``same`` go one way, each by far more than where it rests, and no dwell is among them."""
    first = np.flatnonzero(np.append(True, ~same))      # each row of equal samples by its first
    step = np.diff(values[first], axis=0)
    size = np.abs(np.diff(values, axis=0)[_in_one_dwell(dwell)])
    far = UNDER_WAY * np.array([np.mean(one[np.isfinite(one)]) if np.isfinite(one).any() else np.inf for one in size.T])
    on = ~np.logical_or.reduceat(dwell >= 0, first)
    on[[0, -1]] = False
    on[1:-1] &= np.any((step[:-1] * step[1:] > 0.0) & (np.minimum(np.abs(step[:-1]), np.abs(step[1:])) > far), axis=1)
    return np.repeat(on, np.diff(np.append(first, len(values))))[1:]


def _carried_over(values: np.ndarray, dwell: np.ndarray, setup: np.ndarray) -> np.ndarray:
    """Samples (n,) with which a dwell begins and that still are, to the last bit, the reading before it, from where the
    machine was before its move: the next one is as far from them as a spike."""
    out = np.zeros(len(values), bool)
    begins = 1 + np.flatnonzero((dwell[1:] >= 0) & (dwell[1:] != dwell[:-1]))
    same = np.append(False, (values[1:] == values[:-1]).all(axis=1))
    begins = begins[same[begins]]
    if not len(begins):
        return out
    noise = _noises(values, dwell, setup)
    for begin in begins:
        end = begin + int(np.argmin(np.append(same[begin:], False)))
        if end < len(values) and dwell[end] == dwell[begin]:
            out[begin:end] = np.any(np.abs(values[end] - values[begin]) > SPIKE * noise[end])
    return out


def _stood_still(values: np.ndarray, dwell: np.ndarray, setup: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Samples (n,) that are, to the last bit, the reading from before a move, through all of it and on into the dwell
    behind it, where most moves of that kind, ``way`` (m,) by dwell, change it by more than a spike.

    Readings in steps repeat themselves at rest, so that nothing else tells the dwells that were never measured.
    """
    out = np.zeros(len(values), bool)
    kept = np.flatnonzero((dwell >= 0) & np.isfinite(values).all(axis=1))
    if len(kept) < 2:
        return out
    noise = _noises(values, dwell, setup)
    last, first = kept[:-1][np.diff(dwell[kept]) != 0], kept[1:][np.diff(dwell[kept]) != 0]
    kind = way[dwell[first]]
    far = np.nanmax(np.nan_to_num(np.abs(values[first] - values[last]) / noise[first]), axis=1)
    seen = {k: k >= 0 and np.median(far[kind == k]) > SPIKE for k in np.unique(kind).tolist()}
    row = np.cumsum(np.append(True, ~(values[1:] == values[:-1]).all(axis=1)))
    through = (row[last] == row[first]) & np.array([seen[k] for k in kind.tolist()], bool)
    for before, behind in zip(last[through], first[through], strict=True):
        out[before + 1:np.searchsorted(row, row[behind], side='right')] = True
    return out


def _noises(values: np.ndarray, dwell: np.ndarray, setup: np.ndarray) -> np.ndarray:
    """:func:`_noise` of each column (n, k)."""
    return np.stack([_noise(column, dwell, setup) for column in values.T], axis=1)


def _noise(values: np.ndarray, dwell: np.ndarray, setup: np.ndarray) -> np.ndarray:
    """Noise (n,) of single samples by the steps between neighbours of a dwell that differ, of each setup; NaN where
    none do."""
    step = np.where(_in_one_dwell(dwell), np.abs(np.diff(values)), np.nan)
    noise = np.full(len(values), np.nan)
    for s in np.unique(setup):
        mine = step[setup[1:] == s]
        mine = mine[np.isfinite(mine) & (mine > 0.0)]
        if len(mine):
            noise[setup == s] = np.median(mine) / (0.6745 * np.sqrt(2.0))
    return noise


def _spikes(values: np.ndarray, dwell: np.ndarray, setup: np.ndarray, ends: bool) -> np.ndarray:
    """Samples (n,) in a dwell that stand out of both their neighbours to one side, by far more than noise does; at the
    ``ends`` of a dwell of the only one.  One that was read twice is one."""
    out = np.zeros(len(values), bool)
    # Neighbours are those that are left: what is without signal stands between none.
    for k in range(values.shape[1]):
        kept = np.flatnonzero(np.isfinite(values[:, k]) & (dwell >= 0))
        if len(kept) < 3:
            continue
        again = _read_twice(values[kept, k], dwell[kept])
        twice, kept = {int(kept[i - 1]): int(kept[i]) for i in np.flatnonzero(again)}, kept[~again]
        if len(kept) < 3:
            continue
        x, own = values[kept, k], dwell[kept]
        step = np.where(_in_one_dwell(own), np.diff(x), np.nan)
        # What stands out at either end of a dwell has one neighbour; it must leave the next steps far behind, as
        # nothing that settles or swings does.
        before, after = np.append(np.nan, step), np.append(-step, np.nan)
        stands = np.where(before * after > 0.0, np.minimum(np.abs(before), np.abs(after)), 0.0)
        size = np.concatenate([np.full(3, np.nan), np.abs(step), np.full(3, np.nan)])
        back, on, earlier, later = size[1:-4], size[4:-1], size[:-5], size[5:]
        stands = np.where(stands > ABRUPT * np.nan_to_num(np.fmin(back, on)), stands, 0.0)
        first = ends & np.isnan(before) & (size[3:-2] > ALONE * np.fmax(on, later))
        last = ends & np.isnan(after) & (size[2:-3] > ALONE * np.fmax(back, earlier))
        stands = np.where(first, size[3:-2], np.where(last, size[2:-3], stands))
        found = kept[stands > SPIKE * np.nan_to_num(_noise(x, own, setup[kept]), nan=np.inf)]
        out[found] = True
        out[[twice[i] for i in found.tolist() if i in twice]] = True
    return out


def _read_twice(values: np.ndarray, dwell: np.ndarray) -> np.ndarray:
    """Second (n,) of two readings that are equal to the last bit, and no third beside them is."""
    same = np.append(False, (values[1:] == values[:-1]) & _in_one_dwell(dwell))
    return same & ~np.append(False, same[:-1]) & ~np.append(same[1:], False)
