"""Counts that the laser lost, for a simulator: once between two stops by the number of the move, all else in time.

A slip in a dwell leaves that dwell to the diagnosis as if it had lasted without it, and so it has to be held against
the log; the samples are as they were, and for them the cell has the time between the two at which it happened.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stepdiag_ros.effects.base import Effect
from stepdiag_ros.effects.course import Course
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.gap.diagnosis import Diagnosis
from stepdiag_ros.gap.inference.joint import Active
from stepdiag_ros.gap.noise.slips_at_rest import SlipAtRest
from stepdiag_ros.guard import limits
from stepdiag_ros.twin.guess import Values
from stepdiag_ros.twin.twin import Twin

AT_ONCE_S = 2e-6
"""Time that a slip takes in a course."""


@dataclass(frozen=True)
class _Slip:
    """What is lost between the stop of row ``before`` and the next one, of row ``after`` (−1: none follows in its run),
    ``jump`` (beams,) [m]; ``at_rest``: as it was seen in the dwell before, None where the axes moved."""

    before: int
    after: int
    jump: np.ndarray
    at_rest: SlipAtRest | None


def lost_counts(diagnosis: Diagnosis, effect: type[Effect], active: Sequence[Active],
                twin: Twin) -> tuple[Values, Effect]:
    """Parameters of the cell's effect, and the effect as it acts on the stops of the diagnosis."""
    table = diagnosis.joint.observation.table
    slips = [_as_fitted(a, table, diagnosis.slips) for a in active] if active else \
        [_as_seen(slip, table) for slip in diagnosis.slips]
    if len(slips) == 1 and slips[0].at_rest is None:
        # The simulator counts moves: one at power-up, one for each mounting, one for each stop.
        mountings = 1 + int(np.sum(np.diff(table.setup[:slips[0].after + 1]) != 0))
        values: Values = {'jump': slips[0].jump.tolist(), 'arrival': float(slips[0].after + mountings + 1)}
        return values, effect(**values)
    moving = [_between(slip, table) for slip in slips]
    true = [_in_dwell(slip.at_rest, diagnosis, table) if slip.at_rest else time
            for slip, time in zip(slips, moving, strict=True)]
    in_cell, at_stops = (_course(twin.since_began(np.array(times)), [slip.jump for slip in slips])
                         for times in (true, moving))
    return {'course': in_cell.to_mapping()}, effect(course=at_stops)


def _as_fitted(active: Active, table: StopTable, seen: Sequence[SlipAtRest]) -> _Slip:
    shape = active.form.shape
    after = int(np.flatnonzero((table.run == shape['run']) & (table.index == shape['index']))[0])
    mine = np.flatnonzero((table.run == table.run[after]) & (table.time_s < table.time_s[after]))
    before = int(mine[np.argmax(table.time_s[mine])])
    slipped = active.contribution[after, :-2]
    jump = np.zeros(limits.BEAMS)
    jump[:len(slipped)] = slipped
    at_rest = [slip for slip in seen if slip.row == before and slipped[slip.beam] != 0.0]
    return _Slip(before, after, jump, at_rest[0] if at_rest else None)


def _as_seen(slip: SlipAtRest, table: StopTable) -> _Slip:
    jump = np.zeros(limits.BEAMS)
    jump[slip.beam] = slip.jump
    later = np.flatnonzero((table.run == table.run[slip.row]) & (table.time_s > table.time_s[slip.row]))
    return _Slip(slip.row, int(later[np.argmin(table.time_s[later])]) if len(later) else -1, jump, slip)


def _between(slip: _Slip, table: StopTable) -> int:
    """When [ns] the axes moved from the stop before it to the next."""
    done = int(table.done_ns[slip.before])
    return done + 1_000_000 if slip.after < 0 else (done + int(table.dwell_ns[slip.after])) // 2


def _in_dwell(slip: SlipAtRest, diagnosis: Diagnosis, table: StopTable) -> int:
    """When [ns] it happened: between the last sample before it and the first behind it."""
    samples, (first, last) = diagnosis.log.displacement, table.displacement_rows[slip.row]
    read = first + np.flatnonzero(np.isfinite(samples.values[first:last, slip.beam]))
    behind = round((1.0 - slip.behind) * len(read))
    return int(samples.time_ns[read[behind - 1:behind + 1]].mean())


def _course(seconds: np.ndarray, jumps: Sequence[np.ndarray]) -> Course:
    """What has been lost since the log began: each slip stays, as the resets that follow take it off."""
    order = np.argsort(seconds)
    times, values, lost = [], [], np.zeros(limits.BEAMS)
    for k in order:
        # What several beams lose at once is one step.
        if not times or seconds[k] - times[-1] > AT_ONCE_S:
            times += [seconds[k], seconds[k] + AT_ONCE_S]
            values += [lost, lost]
        lost = lost + jumps[k]
        values[-1] = lost
    return Course(np.array(times), np.array(values))
