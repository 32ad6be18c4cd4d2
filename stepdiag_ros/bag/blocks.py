"""Blocks of samples laid end to end: from tables of messages to :class:`Samples`.

A block is one message.  Blocks are put in order of (stamp, sequence, place in the
log); what cannot be a measurement is left out and said.
"""

from dataclasses import dataclass

import numpy as np

from stepdiag_ros.bag.tables import Group, TopicTable
from stepdiag_ros.model.log import Samples

SECOND = 1_000_000_000


def stamps_ns(values: dict[str, np.ndarray]) -> np.ndarray:
    """``header.stamp`` as int64 nanoseconds, (n,)."""
    return (values['header.stamp.sec'].astype(np.int64) * SECOND
            + values['header.stamp.nanosec'].astype(np.int64))


def text(values: np.ndarray) -> tuple[list[str], np.ndarray]:
    """Distinct strings of a bytes array (n,), and for each element its index, (n,)."""
    unique, inverse = np.unique(values, return_inverse=True)
    return [bytes(u).decode('utf-8', 'replace') for u in unique], inverse


def order_of(stamp: np.ndarray, sequence: np.ndarray, number: np.ndarray) -> np.ndarray:
    """Order by (stamp, sequence, place in the log)."""
    return np.lexsort((number, sequence, stamp))


def backwards(stamp: np.ndarray, number: np.ndarray, topic: str) -> list[str]:
    """A warning if stamps fall along the log."""
    along = stamp[np.argsort(number, kind='stable')]
    falls = np.flatnonzero(np.diff(along) < 0)
    if not len(falls):
        return []
    worst = float((along[falls] - along[falls + 1]).max()) / SECOND
    return [f'{topic}: time runs backwards {len(falls)} time(s), by at most {worst:.6g} s; '
            'put in order of stamps']


@dataclass(frozen=True)
class _Part:
    """Blocks of one layout: ``values`` (n, samples, k), ``health`` (n, samples), the rest (n,)."""

    values: np.ndarray
    health: np.ndarray
    index: np.ndarray
    stamp: np.ndarray
    period: np.ndarray
    frame: np.ndarray
    number: np.ndarray
    sequence: np.ndarray


class _Dropped:
    """Counts blocks left out, by reason."""

    def __init__(self):
        self.reasons: dict[str, int] = {}

    def keep(self, good: np.ndarray, reason: str) -> np.ndarray:
        lost = int(len(good) - good.sum())
        if lost:
            self.reasons[reason] = self.reasons.get(reason, 0) + lost
        return good


def displacement_samples(table: TopicTable, setup_names: tuple[str, ...]) -> tuple[Samples, list[str]]:
    """Samples of ``interferometer/displacement``; beams that a setup lacks are NaN."""
    dropped = _Dropped()
    parts = [part for group in table.groups for part in _displacement_parts(group, dropped)]
    samples, warnings = _assemble(table, parts, setup_names, dropped)
    dark = int((samples.health == 0).sum())
    if dark:
        warnings.append(f'{table.topic}: {dark} of {len(samples)} samples have signal quality 0; '
                        'the evaluation leaves them out')
    return samples, warnings


def spot_samples(table: TopicTable, setup_names: tuple[str, ...]) -> tuple[Samples, list[str]]:
    """Samples of ``psd/spot``: values x, y [m], health the sum signal [V]."""
    dropped = _Dropped()
    parts = [part for group in table.groups for part in _spot_parts(group, dropped)]
    return _assemble(table, parts, setup_names, dropped, columns=2)


def _displacement_parts(group: Group, dropped: _Dropped) -> list[_Part]:
    v = group.values
    total, marks = v['displacement'].shape[1], v['quality'].shape[1]
    parts = []
    for beams in np.unique(v['beams']):
        rows = np.flatnonzero(v['beams'] == beams)
        beams = int(beams)
        whole = beams > 0 and total == marks * beams
        index = v['refractive_index'][rows]
        good = dropped.keep(np.full(len(rows), whole),
                            'whose displacement, beams and quality disagree in length')
        good &= dropped.keep(np.isfinite(index) & (index > 0) | ~good,
                             'with a refractive index that is no number above 0 '
                             '(1.0 means: not divided out)')
        rows = rows[good]
        if len(rows) and marks:
            parts.append(_part(group, rows, v['displacement'][rows].reshape(len(rows), marks, beams),
                               v['quality'][rows].astype(float), index[good].astype(float)))
    return parts


def _spot_parts(group: Group, dropped: _Dropped) -> list[_Part]:
    v = group.values
    count = v['x'].shape[1]
    alike = count == v['y'].shape[1] == v['intensity'].shape[1]
    if not dropped.keep(np.full(len(group.number), alike),
                        'whose x, y and intensity disagree in length').all() or not count:
        return []
    rows = np.arange(len(group.number))
    return [_part(group, rows, np.stack([v['x'], v['y']], axis=-1), v['intensity'].astype(float),
                  np.ones(len(rows)))]


def _part(group: Group, rows: np.ndarray, values: np.ndarray, health: np.ndarray,
          index: np.ndarray) -> _Part:
    v = group.values
    return _Part(values, health, index, stamps_ns(v)[rows], v['sample_period'][rows].astype(float),
                 v['header.frame_id'][rows], group.number[rows], group.sequence[rows])


def _assemble(table: TopicTable, parts: list[_Part], setup_names: tuple[str, ...],
              dropped: _Dropped, columns: int = 1) -> tuple[Samples, list[str]]:
    """Order the blocks of all parts and scatter them into flat arrays."""
    if table.malformed:
        dropped.reasons['that do not hold their type'] = table.malformed
    kept = [_usable(part, setup_names, dropped) for part in parts]
    kept = [(part, setup) for part, setup in kept if len(setup)]
    warnings = [f'{table.topic}: left out {count} block(s) {reason}'
                for reason, count in dropped.reasons.items()]
    if not kept:
        return Samples.empty(columns), warnings
    stamp = np.concatenate([p.stamp for p, _ in kept])
    number = np.concatenate([p.number for p, _ in kept])
    order = order_of(stamp, np.concatenate([p.sequence for p, _ in kept]), number)
    warnings += backwards(stamp, number, table.topic)
    sizes = np.concatenate([np.full(len(p.stamp), p.health.shape[1]) for p, _ in kept])
    starts = np.empty(len(order), np.intp)
    starts[order] = np.concatenate([[0], np.cumsum(sizes[order])[:-1]])
    place = np.empty(len(order), np.intp)
    place[order] = np.arange(len(order))
    total = int(sizes.sum())
    width = max(columns, *(p.values.shape[2] for p, _ in kept))
    time = np.empty(total, np.int64)
    values = np.full((total, width), np.nan)
    health, index = np.empty(total), np.empty(total)
    setup, block = np.empty(total, np.intp), np.empty(total, np.intp)
    finite = np.empty(total, bool)
    begin = 0
    for part, names in kept:
        here = slice(begin, begin + len(part.stamp))
        begin = here.stop
        count = part.health.shape[1]
        at = starts[here][:, None] + np.arange(count)
        # Rounded, not cut: 0.02 s times 3 is 0.06 s and not 59 999 999 ns.
        offset = np.rint(np.arange(count) * part.period[:, None] * SECOND).astype(np.int64)
        time[at] = part.stamp[:, None] + offset
        values[at, :part.values.shape[2]] = part.values
        health[at] = part.health
        index[at] = part.index[:, None]
        setup[at] = names[:, None]
        block[at] = place[here][:, None]
        finite[at] = np.isfinite(part.values).all(axis=2) & np.isfinite(part.health)
    samples = Samples(time, values, health, index, setup_names, setup, block)
    return _tidy(samples, finite, table.topic, warnings)


def _usable(part: _Part, setup_names: tuple[str, ...], dropped: _Dropped) -> tuple[_Part, np.ndarray]:
    """``part`` without blocks of unknown setups or periods, and each block's setup index (n,)."""
    names, inverse = text(part.frame)
    setup = np.array([setup_names.index(n) if n in setup_names else -1 for n in names], np.intp)[inverse]
    good = np.ones(len(setup), bool)
    for position, name in enumerate(names):
        if name not in setup_names:
            good &= dropped.keep(inverse != position, f'of unknown setup {name!r} (the description '
                                 f'has {", ".join(setup_names)})')
    timed = (part.period > 0) & np.isfinite(part.period) | (part.health.shape[1] == 1)
    good &= dropped.keep(timed | ~good, 'with a sample period that is no number above 0')
    if good.all():
        return part, setup
    return _Part(*(column[good] for column in vars(part).values())), setup[good]


def _tidy(samples: Samples, finite: np.ndarray, topic: str,
          warnings: list[str]) -> tuple[Samples, list[str]]:
    """Leave out samples that are no numbers and blocks sent twice; order overlapping blocks."""
    bad = int(len(finite) - finite.sum())
    if bad:
        warnings.append(f'{topic}: left out {bad} of {len(finite)} samples that are NaN or infinite')
    twice = _repeated(samples)
    if twice.any():
        warnings.append(f'{topic}: left out {len(np.unique(samples.block[twice]))} block(s) that '
                        'the log holds twice')
    good = finite & ~twice
    if not good.all():
        samples = _take(samples, good)
    falls = int((np.diff(samples.time_ns) < 0).sum())
    if falls:
        warnings.append(f'{topic}: blocks overlap in time {falls} time(s); samples put in order of time')
        samples = _take(samples, np.argsort(samples.time_ns, kind='stable'))
    return samples, warnings


def _repeated(samples: Samples) -> np.ndarray:
    """Mask (n,) of the samples of blocks that equal the block before them, stamp and all."""
    mask = np.zeros(len(samples), bool)
    first = np.flatnonzero(np.diff(samples.block, prepend=-1))
    last = np.append(first[1:], len(samples))
    for k in np.flatnonzero(np.diff(samples.time_ns[first]) == 0):
        a, b = slice(first[k], last[k]), slice(first[k + 1], last[k + 1])
        if a.stop - a.start == b.stop - b.start and samples.setup[a.start] == samples.setup[b.start] \
                and np.array_equal(samples.values[a], samples.values[b], equal_nan=True):
            mask[b] = True
    return mask


def _take(samples: Samples, which: np.ndarray) -> Samples:
    return Samples(samples.time_ns[which], samples.values[which], samples.health[which],
                   samples.refractive_index[which], samples.setup_names, samples.setup[which],
                   samples.block[which])
