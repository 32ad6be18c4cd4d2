"""Blocks of samples laid end to end: from tables of messages to :class:`Samples`.

A block is one message.  Blocks are put in order of (stamp, sequence, place in the
log); what cannot be a measurement is left out and said.
"""

from dataclasses import dataclass

import numpy as np

from stepdiag_ros.bag.tables import Group, TopicTable
from stepdiag_ros.guard import limits
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


def strangers(names: list[str], inverse: np.ndarray, known: tuple[str, ...]) -> list[tuple[np.ndarray, str]]:
    """Rows (n,) of names that are not ``known`` and the name quoted; after the first few names, all others in one."""
    unknown = [k for k, name in enumerate(names) if name not in known]
    found = [(inverse == k, repr(names[k])) for k in unknown[:limits.NAMES_LISTED]]
    if len(unknown) > limits.NAMES_LISTED:
        rest = unknown[limits.NAMES_LISTED:]
        found.append((np.isin(inverse, rest), f'{names[rest[0]]!r} and {len(rest) - 1} others'))
    return found


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
    """Blocks of one layout: ``columns`` k arrays and ``health`` (n, samples), the rest (n,)."""

    columns: tuple[np.ndarray, ...]
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


def displacement_samples(table: TopicTable, setup_names: tuple[str, ...], timing: TopicTable | None = None
                         ) -> tuple[Samples, list[str]]:
    """Samples of ``interferometer/displacement``, taken when ``timing`` says; beams that a setup lacks are NaN."""
    dropped = _Dropped()
    parts = [part for group in table.groups for part in _displacement_parts(group, dropped)]
    return _assemble(table, parts, setup_names, dropped, timing)


def spot_samples(table: TopicTable, setup_names: tuple[str, ...], timing: TopicTable | None = None
                 ) -> tuple[Samples, list[str]]:
    """Samples of ``psd/spot``: values x, y [m], health the sum signal [V]; taken when ``timing`` says."""
    dropped = _Dropped()
    parts = [part for group in table.groups for part in _spot_parts(group, dropped)]
    return _assemble(table, parts, setup_names, dropped, timing, columns=2)


def _displacement_parts(group: Group, dropped: _Dropped) -> list[_Part]:
    v = group.values
    total, marks = v['displacement'].shape[1], v['quality'].shape[1]
    parts = []
    for beams in np.unique(v['beams']):
        rows = np.flatnonzero(v['beams'] == beams)
        beams = int(beams)
        whole = 0 < beams <= limits.BEAMS and total == marks * beams
        index = v['refractive_index'][rows]
        good = dropped.keep(np.full(len(rows), whole),
                            'whose displacement, beams and quality disagree in length')
        good &= dropped.keep((index >= limits.INDEX[0]) & (index <= limits.INDEX[1]) | ~good,
                             f'with a refractive index that is no number from {limits.INDEX[0]} to '
                             f'{limits.INDEX[1]} (1.0 means: not divided out)')
        if good.any() and marks:
            chosen = slice(None) if good.all() and len(good) == len(group.number) else rows[good]
            lengths = v['displacement'][chosen]
            parts.append(_part(group, chosen, tuple(lengths[:, b::beams] for b in range(beams)),
                               v['quality'][chosen], v['refractive_index'][chosen].astype(float)))
    return parts


def _spot_parts(group: Group, dropped: _Dropped) -> list[_Part]:
    v = group.values
    count = v['x'].shape[1]
    alike = count == v['y'].shape[1] == v['intensity'].shape[1]
    if not dropped.keep(np.full(len(group.number), alike),
                        'whose x, y and intensity disagree in length').all() or not count:
        return []
    return [_part(group, slice(None), (v['x'], v['y']), v['intensity'], np.ones(len(group.number)))]


def _part(group: Group, rows: np.ndarray | slice, columns: tuple[np.ndarray, ...],
          health: np.ndarray, index: np.ndarray) -> _Part:
    v = group.values
    return _Part(columns, health, index, stamps_ns(v)[rows], v['sample_period'][rows].astype(float),
                 v['header.frame_id'][rows], group.number[rows], group.sequence[rows])


def _assemble(table: TopicTable, parts: list[_Part], setup_names: tuple[str, ...],
              dropped: _Dropped, timing: TopicTable | None, columns: int = 1) -> tuple[Samples, list[str]]:
    """Order the blocks of all parts and lay their samples into flat arrays."""
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
    sizes = np.repeat([p.health.shape[1] for p, _ in kept], [len(p.stamp) for p, _ in kept])
    starts = np.empty(len(order), np.intp)
    starts[order] = np.concatenate([[0], np.cumsum(sizes[order])[:-1]])
    total = int(sizes.sum())
    width = max(columns, *(len(p.columns) for p, _ in kept))
    time, health = np.empty(total, np.int64), np.empty(total)
    values = np.empty((total, width))
    begin = 0
    for part, _ in kept:
        count, beams = part.health.shape[1], len(part.columns)
        # Rounded, not cut: 0.02 s times 3 is 0.06 s and not 59 999 999 ns.
        alike = count == 1 or (part.period == part.period[0]).all()
        periods = np.where(count == 1, 0.0, part.period[:1]) if alike else part.period
        offset = np.rint(np.arange(count) * periods[:, None] * SECOND).astype(np.int64)
        for rows, at in _runs(starts[begin:begin + len(part.stamp)], count):
            _put(time, at, part.stamp[rows, None] + (offset if len(offset) == 1 else offset[rows]))
            _put(health, at, part.health[rows])
            for beam, column in enumerate(part.columns):
                _put(values[:, beam], at, column[rows])
            values[at, beams:] = np.nan
        begin += len(part.stamp)
    index = np.repeat(np.concatenate([p.index for p, _ in kept])[order], sizes[order])
    setup = np.repeat(np.concatenate([setup for _, setup in kept])[order], sizes[order])
    known = _timed(time, stamp[order], starts[order], timing) if timing is not None else None
    samples = Samples(time, values, health, index, setup_names, setup,
                      np.repeat(np.arange(len(order)), sizes[order]), known)
    far = limits.DISPLACEMENT_M if columns == 1 else limits.SPOT_M
    return _tidy(samples, _finite(samples, kept, order, sizes, far), table.topic, warnings)


def _timed(time: np.ndarray, stamp: np.ndarray, starts: np.ndarray, timing: TopicTable) -> np.ndarray | None:
    """Put into ``time`` (n,) [ns] when the samples of blocks with such stamps were taken; their uncertainty (n,) [ns].

    ``starts``: where the blocks' samples begin.  A message whose numbers do not fit its block is passed over.
    """
    ends = np.append(starts[1:], len(time))
    place = dict(zip(stamp.tolist(), range(len(stamp)), strict=True))
    known = np.full(len(time), -1, np.int64)
    for group in timing.groups:
        taken, uncertainty = (group.values[key].astype(np.int64) for key in ('taken', 'uncertainty'))
        for row, at in enumerate(stamps_ns(group.values).tolist()):
            if at not in place:
                continue
            begin, end = int(starts[place[at]]), int(ends[place[at]])
            if taken.shape[1] == end - begin and np.all(np.diff(taken[row]) >= 0):
                time[begin:end] = at + taken[row]
            elif taken.shape[1]:
                continue
            if uncertainty.shape[1] in (1, end - begin):
                known[begin:end] = uncertainty[row]
    return known if np.any(known >= 0) else None


def _put(target: np.ndarray, at: slice | np.ndarray, blocks: np.ndarray) -> None:
    """``blocks`` (n, samples) into the flat ``target`` at a stretch or at indices (n, samples)."""
    if isinstance(at, slice):
        # The view of a strided column keeps its stride; a reshape may not copy here.
        stretch = target[at]
        np.lib.stride_tricks.as_strided(
            stretch, blocks.shape, (stretch.strides[0] * blocks.shape[1], stretch.strides[0])
        )[...] = blocks
    else:
        target[at] = blocks


def _runs(starts: np.ndarray, count: int) -> list[tuple[slice | np.ndarray, slice | np.ndarray]]:
    """Where the blocks of a part go: pairs of (rows of the part, samples of the whole).

    Blocks that follow each other go as one slice; where they lie scattered, an index
    array for all of them is cheaper than thousands of slices.
    """
    cuts = np.flatnonzero(np.diff(starts) != count) + 1
    if len(cuts) > max(8, len(starts) // 50):
        return [(slice(None), starts[:, None] + np.arange(count))]
    edges = [0, *cuts.tolist(), len(starts)]
    return [(slice(a, b), slice(int(starts[a]), int(starts[a]) + (b - a) * count))
            for a, b in zip(edges[:-1], edges[1:], strict=True)]


def _finite(samples: Samples, kept: list[tuple[_Part, np.ndarray]], order: np.ndarray,
            sizes: np.ndarray, far: float) -> np.ndarray | None:
    """Mask (n,) of the samples that are numbers and none beyond ``far``; ``None`` if all are.

    Beams that a block does not have are NaN on purpose and do not count.
    """
    alike = len({len(p.columns) for p, _ in kept}) == 1
    with np.errstate(invalid='ignore', over='ignore'):
        # One NaN anywhere makes least and greatest one: passes without a temporary.
        if alike and -far <= samples.values.min() and samples.values.max() <= far \
                and -limits.SIGNAL <= samples.health.min() and samples.health.max() <= limits.SIGNAL:
            return None
    beams = np.repeat([len(p.columns) for p, _ in kept], [len(p.stamp) for p, _ in kept])[order]
    absent = np.arange(samples.values.shape[1]) >= np.repeat(beams, sizes[order])[:, None]
    with np.errstate(invalid='ignore'):
        mask = ((np.abs(samples.values) <= far) | absent).all(axis=1) & (np.abs(samples.health) <= limits.SIGNAL)
    return None if mask.all() else mask


def _usable(part: _Part, setup_names: tuple[str, ...], dropped: _Dropped) -> tuple[_Part, np.ndarray]:
    """``part`` without blocks of unknown setups or periods, and each block's setup index (n,)."""
    names, inverse = text(part.frame)
    setup = np.array([setup_names.index(n) if n in setup_names else -1 for n in names], np.intp)[inverse]
    good = np.ones(len(setup), bool)
    for rows, which in strangers(names, inverse, setup_names):
        good &= dropped.keep(~rows, f'of unknown setup {which} (the description has {", ".join(setup_names)})')
    # Longer than years cannot be meant, and would not fit the nanoseconds.
    timed = (part.period > 0) & (part.period * part.health.shape[1] < 1e9) | (part.health.shape[1] == 1)
    good &= dropped.keep(timed | ~good, 'with a sample period that is no sensible number above 0')
    if good.all():
        return part, setup
    rest = {k: v[good] for k, v in vars(part).items() if k != 'columns'}
    return _Part(columns=tuple(c[good] for c in part.columns), **rest), setup[good]


def _tidy(samples: Samples, finite: np.ndarray | None, topic: str,
          warnings: list[str]) -> tuple[Samples, list[str]]:
    """Leave out samples that are no numbers and blocks sent twice; order overlapping blocks."""
    good = finite
    if finite is not None:
        warnings.append(f'{topic}: left out {int((~finite).sum())} of {len(finite)} samples '
                        'that are NaN, infinite or far beyond any reading')
    twice = _repeated(samples)
    if twice is not None:
        warnings.append(f'{topic}: left out {len(np.unique(samples.block[twice]))} block(s) that '
                        'the log holds twice')
        good = ~twice if good is None else good & ~twice
    if good is not None:
        samples = _take(samples, good)
    falls = int((samples.time_ns[1:] < samples.time_ns[:-1]).sum())
    if falls:
        warnings.append(f'{topic}: blocks overlap in time {falls} time(s); samples put in order of time')
        samples = _take(samples, np.argsort(samples.time_ns, kind='stable'))
    return samples, warnings


def _repeated(samples: Samples) -> np.ndarray | None:
    """Mask (n,) of the samples of blocks that equal the block before them, stamp and all."""
    first = np.flatnonzero(samples.block[1:] != samples.block[:-1]) + 1
    first = np.concatenate([[0], first])
    last = np.append(first[1:], len(samples))
    mask = None
    for k in np.flatnonzero(np.diff(samples.time_ns[first]) == 0):
        a, b = slice(first[k], last[k]), slice(first[k + 1], last[k + 1])
        if a.stop - a.start == b.stop - b.start and samples.setup[a.start] == samples.setup[b.start] \
                and np.array_equal(samples.values[a], samples.values[b], equal_nan=True):
            mask = np.zeros(len(samples), bool) if mask is None else mask
            mask[b] = True
    return mask


def _take(samples: Samples, which: np.ndarray) -> Samples:
    return Samples(samples.time_ns[which], samples.values[which], samples.health[which],
                   samples.refractive_index[which], samples.setup_names, samples.setup[which],
                   samples.block[which],
                   None if samples.uncertainty_ns is None else samples.uncertainty_ns[which])
