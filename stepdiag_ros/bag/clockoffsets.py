"""Clocks that differed while a log was recorded, by how much as its nodes measured, and stamps put onto one clock.

A driver on another computer stamps by that computer's clock.  The log says on ``clock_offset`` by how much it was ahead
of the sequencer's; whoever reads the log takes that off, so that it is a fact of the log and no finding.
"""

from dataclasses import dataclass

import numpy as np

from stepdiag_ros.bag.blocks import SECOND, stamps_ns, text
from stepdiag_ros.bag.clocksteps import set_stamps, shift_ns, steps_of
from stepdiag_ros.bag.schemas import (
    BEAM_ANGLE,
    CLOCK_OFFSET,
    CLOCK_STEP,
    DISPLACEMENT,
    DISPLACEMENT_TIMING,
    SPOT,
    SPOT_TIMING,
    TOPICS,
)
from stepdiag_ros.bag.tables import TopicTable

#: What is stamped by a sensor's clock.
STAMPED = {'interferometer': (DISPLACEMENT, DISPLACEMENT_TIMING, *(t for t in TOPICS if t.startswith('environment/'))),
           'psd': (SPOT, SPOT_TIMING, BEAM_ANGLE)}
LONGEST_S = 1.0e9


@dataclass(frozen=True)
class ClockOffsets:
    """Of one sensor's clock: at ``time_ns`` (n,) by the sequencer's clock it was ``offset_ns`` (n,) ahead, give or take
    ``uncertainty_ns`` (n,) at most; ``same_name``: it bears the name of the sequencer's;
    ``number`` (n,): the messages' places in the log."""

    time_ns: np.ndarray
    offset_ns: np.ndarray
    uncertainty_ns: np.ndarray
    same_name: bool
    number: np.ndarray

    def ahead_ns(self, stamp_ns: np.ndarray) -> np.ndarray:
        """What to take off stamps (k,) of the sensor; before the first and after the last comparison it stays."""
        begin = self.time_ns[0]
        return self._between(stamp_ns - begin, self.time_ns - begin + self.offset_ns, self.offset_ns)

    def uncertainty_at(self, time_ns: np.ndarray) -> np.ndarray:
        """By how much stamps (k,) that were put right can be off at most because of it [ns]."""
        return self._between(time_ns - self.time_ns[0], self.time_ns - self.time_ns[0], self.uncertainty_ns)

    def until(self, end_ns: int) -> 'ClockOffsets':
        """What was known at ``end_ns``; all where nothing was: what comes later changes no evaluation made then."""
        kept = self.time_ns <= end_ns
        return ClockOffsets(self.time_ns[kept], self.offset_ns[kept], self.uncertainty_ns[kept], self.same_name,
                            self.number[kept]) if kept.any() else self

    @property
    def one(self) -> bool:
        """It is the sequencer's own clock, by name and by measurement."""
        return self.same_name and bool((np.abs(self.offset_ns) <= self.uncertainty_ns).all())

    @staticmethod
    def _between(at: np.ndarray, known: np.ndarray, value: np.ndarray) -> np.ndarray:
        return np.rint(np.interp(at, known, value)).astype(np.int64)


def offsets_of(tables: dict[str, TopicTable | None]) -> dict[str, ClockOffsets]:
    """What one machine's tables (by relative topic), as recorded, say of each sensor's clock.

    Steps of either clock are taken off, as they are of the stamps (:mod:`stepdiag_ros.bag.clocksteps`).
    """
    table = tables.get(CLOCK_OFFSET)
    if table is None or not table.groups:
        return {}

    def column(path: str) -> np.ndarray:
        return np.concatenate([group.values[path] for group in table.groups])
    stamp = np.concatenate([stamps_ns(group.values) for group in table.groups])
    number = np.concatenate([group.number for group in table.groups])
    sequence = np.concatenate([group.sequence for group in table.groups])
    offset_s, uncertainty_s = column('offset').astype(float), column('uncertainty').astype(float)
    same = column('clock') == column('reference')
    sane = (np.abs(offset_s) < LONGEST_S) & (uncertainty_s >= 0.0) & (uncertainty_s < LONGEST_S)
    steps = steps_of(tables.get(CLOCK_STEP))
    moved = shift_ns(stamp, sequence, number, [s for s in steps if s.topic == CLOCK_OFFSET])
    names, which = text(column('header.frame_id'))
    found = {}
    for sensor, topics in STAMPED.items():
        if sensor not in names:
            continue
        rows = np.flatnonzero(sane & (which == names.index(sensor)))
        rows = rows[np.argsort(number[rows], kind='stable')]
        offset = np.rint(offset_s[rows] * SECOND).astype(np.int64) - moved[rows]
        straddles = np.zeros(len(rows), bool)
        for step in (s for s in steps if s.topic == topics[0]):
            after = np.flatnonzero(number[rows] > step.number)
            offset[after] -= step.step_ns
            straddles[after[:1]] = True      # what was compared just before the step may be in it
        rows, offset = rows[~straddles], offset[~straddles]
        if len(rows):
            time_ns, order = np.unique((stamp + moved)[rows], return_index=True)
            found[sensor] = ClockOffsets(time_ns, offset[order], np.rint(uncertainty_s[rows][order] * SECOND).astype(
                np.int64), bool(same[rows].all()), number[rows][order])
    return found


def put_on_one_clock(tables: dict[str, TopicTable | None], offsets: dict[str, ClockOffsets]) -> list[str]:
    """Put the sensors' stamps onto the sequencer's clock, in place; what was done, in words."""
    said = []
    for sensor, clock in offsets.items():
        if clock.one:
            continue
        for topic in STAMPED[sensor]:
            table = tables.get(topic)
            if table is not None and table.groups:
                stamp = np.concatenate([stamps_ns(group.values) for group in table.groups])
                set_stamps(table, stamp - clock.ahead_ns(stamp))
        first, last = (clock.offset_ns[k] / 1e6 for k in (0, -1))
        bound = clock.uncertainty_ns.max() / 1e6
        drift = '' if abs(last - first) <= 2.0 * bound else f' at first and {last:+.3f} ms at last'
        said.append(f"{sensor}: its clock was {first:+.3f} ms{drift} ahead of the sequencer's, "
                    f'± {bound:.3f} ms at most, as measured while the log was recorded; '
                    "its stamps are put onto the sequencer's clock")
    return said
