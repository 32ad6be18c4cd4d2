"""From samples to stops: one row for every stop that a log visited.

A dwell's samples are those with a stamp in ``[DWELL, DONE)`` of the sequencer.
Samples without signal (quality 0) and samples that are not numbers are left out
and counted; of a log as it was recorded (:func:`stops_of`) what else is no reading is
too.  Besides the mean the table keeps where a dwell's samples lie, so that what happens
inside a dwell is not lost to the gap diagnosis.
"""

from dataclasses import dataclass, replace

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.correlated import FAST, FEWEST, SLOW, sample_contrasts
from stepdiag_ros.estimate.on_centre import on_centre
from stepdiag_ros.estimate.samples import clean, quantum
from stepdiag_ros.model.log import DONE, DWELL, MOVE, STOOD, CalibrationLog, Samples

MOVED_M = 1e-6
"""An axis moved if it is commanded further than this."""
LONG = 8.0
PIECES = 40
"""A dwell of more than so many usual ones is cut, where that is asked for, into at most so many stops."""


@dataclass(frozen=True)
class StopTable:
    """One row a visited stop, in order of time; ``n`` rows.

    ``run`` (n,) index into ``run_ids``; ``setup`` (n,) index into ``setup_names``, those that were measured;
    ``repeat``, ``direction``, ``index``, ``axis`` (n,) as in the contract's Step, or ``STOOD``;
    ``commanded`` (n, 3) [m]; ``move_ns``, ``dwell_ns``, ``done_ns`` (n,) int64 (−1: no move seen).
    ``displacement`` (n, beams), ``spot`` (n, 2) [m]: means over the dwell, NaN where there is none;
    ``displacement_scatter``, ``spot_scatter`` [m]: standard deviation of one sample against its neighbours;
    ``displacement_count``, ``spot_count`` (n,): samples used.
    ``displacement_parts``, ``spot_parts`` (n, beams or 2, 8) [m]: contrasts of a dwell's samples, slow and fast
    ones, that scatter as single samples do where these are independent; None where no samples are known.
    ``displacement_rows``, ``spot_rows`` (n, 2): the dwell's samples are ``[first, last)`` of the log.
    ``intensity`` (n,) [V] and ``refractive_index`` (n,): means over the dwell.
    ``quanta`` (beams + 2) [m]: steps in which readings of lengths and spots move, 0 where in none; () where not known.
    ``disturbed`` (n, beams + 2) [m²]: variance of the means by what is known to disturb them besides; None: nothing is.
    ``wander`` (n,) [m²]: power per e-fold of frequency of noise as 1/f on the lengths; None: there is none.
    ``hop`` (n,) [m]: by what the lengths hop between two states, ``hops_per_s`` times a second; None: they do not.
    """

    run_ids: tuple[str, ...]
    setup_names: tuple[str, ...]
    run: np.ndarray
    setup: np.ndarray
    repeat: np.ndarray
    direction: np.ndarray
    index: np.ndarray
    axis: np.ndarray
    commanded: np.ndarray
    move_ns: np.ndarray
    dwell_ns: np.ndarray
    done_ns: np.ndarray
    displacement: np.ndarray
    displacement_scatter: np.ndarray
    displacement_count: np.ndarray
    displacement_rows: np.ndarray
    spot: np.ndarray
    spot_scatter: np.ndarray
    spot_count: np.ndarray
    spot_rows: np.ndarray
    intensity: np.ndarray
    refractive_index: np.ndarray
    warnings: tuple[str, ...] = ()
    disturbed: np.ndarray | None = None
    wander: np.ndarray | None = None
    hop: np.ndarray | None = None
    hops_per_s: float = 0.0
    displacement_parts: np.ndarray | None = None
    spot_parts: np.ndarray | None = None
    quanta: tuple[float, ...] = ()

    def __len__(self) -> int:
        return len(self.run)

    @property
    def time_s(self) -> np.ndarray:
        """Middle of each dwell (n,) [s] since the first dwell began."""
        return ((self.dwell_ns - self.dwell_ns[0]) + (self.done_ns - self.dwell_ns) / 2) * 1e-9

    def select(self, rows: np.ndarray) -> 'StopTable':
        """The table with only ``rows`` (mask or indices) of it."""
        n = len(self)
        kept = {key: value[rows] if isinstance(value, np.ndarray) and len(value) == n else value
                for key, value in vars(self).items()}
        return StopTable(**kept)


def stops_of(log: CalibrationLog) -> StopTable:
    """The stops of a log as it was recorded: :func:`reduce_log` of those samples that are readings."""
    log, left_out = clean(log)
    table = reduce_log(log)
    return replace(table, warnings=(*table.warnings, *(f'{log.source}: {words}' for words in left_out)))


def reduce_log(log: CalibrationLog, cut: bool = False) -> StopTable:
    """Average every dwell of ``log``, a long one in pieces where it is to be ``cut``; raises
    :class:`StepdiagError` where nothing is left."""
    log, unlit = on_centre(log)
    events = log.steps
    visits, warnings = _visits(log)
    warnings += unlit
    if not len(visits):
        raise StepdiagError(f'{log.source}: sequencer/step holds no dwell; '
                            'nothing to evaluate, record a whole run')
    dwell_ns, done_ns = events.time_ns[visits[:, 1]], events.time_ns[visits[:, 2]]
    pieces = _pieces(done_ns - dwell_ns) if cut else np.ones(len(visits), np.intp)
    number = np.concatenate([np.arange(count) for count in pieces])
    visits, begin, length, pieces = (np.repeat(part, pieces, axis=0) for part in (
        visits, dwell_ns, done_ns - dwell_ns, pieces))
    dwell_ns, done_ns = begin + length * number // pieces, begin + length * (number + 1) // pieces
    first, stood = visits[:, 1], number > 0
    move_ns = np.where((visits[:, 0] >= 0) & ~stood, events.time_ns[visits[:, 0]], -1)
    names, setups = tuple(events.setup_names), log.description.setups
    lengths = _average(log.displacement, dwell_ns, done_ns, events.setup[first], names,
                       log.displacement.health > 0)
    # What a detector streams in a setup that has none is no reading.
    looks = np.array([name not in setups or setups[name].sees_tilt for name in names], bool)
    spots = _average(log.spot, dwell_ns, done_ns, events.setup[first],
                     tuple(name if looking else '' for name, looking in zip(names, looks, strict=True)),
                     np.ones(len(log.spot), bool))
    for topic, part, samples in (('interferometer/displacement', lengths, log.displacement),
                                 ('psd/spot', spots, log.spot)):
        if part.left_out:
            warnings.append(f'{log.source}: {topic}: {part.left_out} dwell samples without signal '
                            'or not a number were left out')
        expected = looks[events.setup[first]] if samples is log.spot else np.ones(len(visits), bool)
        empty = (part.count == 0) & expected
        if empty.any() and len(samples):
            why = _why_empty(samples, dwell_ns[empty], done_ns[empty], [names[k] for k in events.setup[first][empty]])
            warnings.append(f'{log.source}: {topic}: {empty.sum()} of {len(visits)} dwells hold no usable '
                            f'sample{why}; those stops are left out of this channel')
    axis, mended = _moved_axis(events.run[first], events.index[first], events.axis[first], events.commanded[first])
    if mended:
        warnings.append(f'{log.source}: sequencer/step: {mended} of {len(axis)} stops name another axis than the one '
                        'that their commanded positions moved; the positions count')
    turned = _turned(events.run[first], events.index[first], events.direction[first])
    if turned:
        warnings.append(f'{log.source}: sequencer/step: the stops of {len(turned)} run(s) come against their '
                        f'direction, e.g. of {events.run_ids[turned[0]]}; +1 is along the path, -1 back')
    measured, setup = np.unique(events.setup[first], return_inverse=True)
    table = StopTable(
        events.run_ids, tuple(names[k] for k in measured), events.run[first], setup, events.repeat[first],
        events.direction[first], events.index[first], np.where(stood, STOOD, axis),
        events.commanded[first],
        move_ns, dwell_ns, done_ns,
        lengths.mean, lengths.scatter, lengths.count, lengths.rows,
        spots.mean, spots.scatter, spots.count, spots.rows,
        spots.health, _index_everywhere(lengths, events.run[first]), tuple(warnings),
        displacement_parts=lengths.parts, spot_parts=spots.parts,
        quanta=tuple(step for part, samples in ((lengths, log.displacement), (spots, log.spot))
                     for step in quantum(samples, part.rows, events.run[first]).tolist()))
    if not np.isfinite(table.displacement).any() and not np.isfinite(table.spot).any():
        raise StepdiagError(f'{log.source}: no dwell of sequencer/step holds a sample of '
                            'interferometer/displacement or psd/spot; check the stamps of both')
    return table


def _index_everywhere(lengths: '_Averages', run: np.ndarray) -> np.ndarray:
    """The index of air that was divided out (n,); a stop without a sample has that of its run, else that of the log.

    Such a stop is no vacuum length: one would make those of the whole log be taken for some.
    """
    index, seen = lengths.refractive_index.copy(), lengths.count > 0
    for number in np.unique(run[~seen]):
        known = seen & (run == number) if (seen & (run == number)).any() else seen
        if known.any():
            # The median is one of them where they are alike, to the last bit.
            index[~seen & (run == number)] = np.median(index[known])
    return index


def _why_empty(samples: Samples, dwell_ns: np.ndarray, done_ns: np.ndarray, setups: list[str]) -> str:
    """Why dwells (k,) hold none of ``samples``, as far as stamps and frames say; '' where they do not."""
    begin, end = np.searchsorted(samples.time_ns, dwell_ns), np.searchsorted(samples.time_ns, done_ns)
    if np.all(begin == end):
        apart = samples.time_ns[0] > done_ns[-1] or samples.time_ns[-1] < dwell_ns[0]
        late_s = (samples.time_ns[0] - dwell_ns[0]) * 1e-9
        return f': they begin {abs(late_s):.4g} s {"after" if late_s > 0.0 else "before"} these, set the clocks' \
            if apart else ''
    for row in np.flatnonzero(end > begin):
        other = samples.setup_names[samples.setup[begin[row]]]
        if other != setups[row]:
            return f': e.g. in a dwell of setup {setups[row]} they bear the frame_id {other!r}'
    return ''


def dwell_means(samples: Samples, table: StopTable, setup: str) -> np.ndarray:
    """Means (n, k) of ``samples`` of ``setup`` over the dwells of ``table``, NaN where there are none."""
    names = tuple(name if name == setup else '' for name in table.setup_names)
    return _average(samples, table.dwell_ns, table.done_ns, table.setup, names, np.ones(len(samples), bool)).mean


def _moved_axis(run: np.ndarray, index: np.ndarray, axis: np.ndarray,
                commanded: np.ndarray) -> tuple[np.ndarray, int]:
    """Axis (k,) that moved to each visit, and how many were named otherwise; what cannot be decided stays as named."""
    change = np.abs(np.diff(commanded, axis=0)) > MOVED_M
    follows = (np.diff(run) == 0) & (np.abs(np.diff(index.astype(int))) == 1) & (change.sum(axis=1) == 1)
    wrong = 1 + np.flatnonzero(follows & (axis[1:] != change.argmax(axis=1)))
    mended = axis.copy()
    mended[wrong] = change[wrong - 1].argmax(axis=1)
    return mended, len(wrong)


def _turned(run: np.ndarray, index: np.ndarray, direction: np.ndarray) -> list[int]:
    """Runs of more than two visits (k,) whose stops come one after another against the one direction that they name."""
    found = []
    for number in np.unique(run):
        way, own = np.diff(index[run == number].astype(int)), direction[run == number]
        if len(way) > 1 and np.all(own == own[0]) and np.all(way * own[0] < 0):
            found.append(int(number))
    return found


def _pieces(length_ns: np.ndarray) -> np.ndarray:
    """Into how many stops each dwell of some length (k,) [ns] is cut: a usual one is not."""
    usual = np.maximum(np.median(length_ns), 1.0)
    return np.where(length_ns > LONG * usual, np.minimum(length_ns // usual, PIECES), 1).astype(np.intp)


def _visits(log: CalibrationLog) -> tuple[np.ndarray, list[str]]:
    """Event numbers (move or −1, dwell, done) of each complete visit (k, 3); complaints."""
    events = log.steps
    visits, warnings = [], []
    move = dwell = -1
    seen: dict[tuple[int, int, int, int], int] = {}
    unfinished = repeated = 0

    def key(i: int) -> tuple[int, int, int, int]:
        return (int(events.run[i]), int(events.repeat[i]), int(events.direction[i]),
                int(events.index[i]))

    for i, phase in enumerate(events.phase):
        if phase == MOVE:
            unfinished += dwell >= 0
            move, dwell = i, -1
        elif phase == DWELL:
            unfinished += dwell >= 0
            dwell = i
            if move >= 0 and key(move) != key(i):
                move = -1
        elif phase == DONE and dwell >= 0 and key(dwell) == key(i):
            if key(i) in seen:
                repeated += 1
                visits[seen[key(i)]] = (move, dwell, i)
            else:
                seen[key(i)] = len(visits)
                visits.append((move, dwell, i))
            move = dwell = -1
    unfinished += dwell >= 0
    if unfinished:
        warnings.append(f'{log.source}: sequencer/step: {unfinished} dwells never ended; left out')
    if repeated:
        warnings.append(f'{log.source}: sequencer/step: {repeated} stops came twice in one run; '
                        'the later visit counts')
    rows = np.array(visits, np.intp).reshape(-1, 3)
    return rows[np.argsort(events.time_ns[rows[:, 1]], kind='stable')], warnings


@dataclass(frozen=True)
class _Averages:
    mean: np.ndarray
    scatter: np.ndarray
    parts: np.ndarray
    count: np.ndarray
    rows: np.ndarray
    health: np.ndarray
    refractive_index: np.ndarray
    left_out: int


def _average(samples: Samples, start_ns: np.ndarray, end_ns: np.ndarray, setup: np.ndarray,
             names: tuple[str, ...], usable: np.ndarray) -> _Averages:
    """Means and scatters of the samples in each window that carry the window's setup."""
    n, columns = len(start_ns), samples.values.shape[1]
    mean, scatter = np.full((n, columns), np.nan), np.full((n, columns), np.nan)
    parts = np.full((n, columns, SLOW + FAST), np.nan)
    health, index = np.full(n, np.nan), np.ones(n)
    count = np.zeros(n, np.intp)
    rows = np.stack([np.searchsorted(samples.time_ns, start_ns),
                     np.searchsorted(samples.time_ns, end_ns)], axis=1)
    own = np.array([names.index(s) if s in names else -1 for s in samples.setup_names] + [-2])
    frame = own[samples.setup] if len(samples) else np.zeros(0, int)
    finite = np.isfinite(samples.values).all(axis=1)
    left_out = 0
    for i, (lo, hi) in enumerate(rows):
        mine = frame[lo:hi] == setup[i]
        good = mine & finite[lo:hi] & usable[lo:hi]
        left_out += int(mine.sum() - good.sum())
        count[i] = good.sum()
        if not count[i]:
            continue
        values = samples.values[lo:hi][good]
        # Subtracting the first sample keeps the mean exact to the last bit of a long distance.
        mean[i] = values[0] + (values - values[0]).mean(axis=0)
        if count[i] > 1:
            # From neighbours in time: what creeps or drifts inside a dwell is not sensor noise.
            scatter[i] = np.sqrt(np.mean(np.diff(values, axis=0)**2, axis=0) / 2.0)
        if count[i] >= FEWEST:
            parts[i] = (sample_contrasts(int(count[i])) @ (values - values[0])).T
        health[i] = samples.health[lo:hi][good].mean()
        index[i] = samples.refractive_index[lo:hi][good].mean()
    return _Averages(mean, scatter, parts, count, rows, health, index, left_out)
