"""Which clock is wrong, from when the sensors see the moves; and stamps put right."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from stepdiag_ros.gap.constants import (
    CLOCK_SIGMAS,
    DRIFT_SIGMAS,
    LEAST_CLOCK_S,
    LEAST_DRIFT_S,
    LEAST_SOONER_S,
)
from stepdiag_ros.gap.preprocess.observe import Observation, observe
from stepdiag_ros.gap.preprocess.timing import Timing, apart, timing, well_timed
from stepdiag_ros.model.log import CalibrationLog, Samples

ALONE = 0.25
"""Share of the difference of two clocks below which the nearer one is taken for right."""
MOST_KNOWN = 0.9
"""Share of the samples whose time is known better than what a sensor's latency is taken to be."""
MOST_OUTSIDE = 0.2
"""Share of the moves that may seem to go on outside their time on one side more than on the other: a clock that is off
moves all of them to one side, noise shows them on both."""
WORSE = 4.0
"""Mean square of a channel's residuals at the stops by which clocks put right may leave more than they found."""


@dataclass(frozen=True)
class Late:
    """A sensor's stamps are late (early: negative) by ``offset`` ± ``sigma`` [s] on average over the log,
    and by ``drift`` ± ``drift_sigma`` [s] more at its end than at its beginning."""

    offset: float
    sigma: float
    drift: float
    drift_sigma: float
    probability: float


def set_clocks(log: CalibrationLog, observation: Observation
               ) -> tuple[CalibrationLog, Observation, dict[str, Timing | None], dict[str, Late]]:
    """The log with stamps put right, observed anew; when each sensor sees the moves; the sensors that were late."""
    table = observation.table
    sure = replace(log, displacement=well_timed(log.displacement), spot=well_timed(log.spot))
    clocks = {'interferometer': timing(sure.displacement, table, table.displacement),
              'psd': timing(sure.spot, table, table.spot)}
    late = late_clocks(clocks, apart(sure, table), known_latency(sure), log.clocks)
    before = _left(observation)
    for tried in (late, _by_middle(late, clocks)):
        if not tried:
            continue
        stamped = log
        for sensor, by in tried.items():
            channel = 'spot' if sensor == 'psd' else 'displacement'
            stamped = replace(stamped, **{channel: put_right(getattr(stamped, channel), by, table.dwell_ns)})
        again = observe(stamped)
        # Else motion has come into the dwells: no clock was off by this.
        if np.all(_left(again) <= WORSE * before):
            return stamped, again, clocks, tried
    return log, observation, clocks, {}


def _left(observation: Observation) -> np.ndarray:
    """Mean squares (c,) of the channels' residuals [m²], 0 of one without readings."""
    residual, present = observation.fit.residual, observation.fit.present
    return np.sum(np.where(present, residual, 0.0)**2, axis=0) / np.maximum(present.sum(axis=0), 1)


def _by_middle(late: Mapping[str, Late], clocks: Mapping[str, Timing | None]) -> dict[str, Late]:
    """The sensors whose clocks run wrong, late by the middle of the moves: a control that begins them long after the
    command makes their beginning seem late."""
    return {sensor: replace(by, offset=clock.offset) for sensor, by in late.items()
            if by.drift and (clock := clocks[sensor]) is not None}


def known_latency(log: CalibrationLog) -> dict[str, float]:
    """By how much [s] each sensor's stamps are off at most, as its driver says; 0 where it does not."""
    return {sensor: float(np.quantile(samples.uncertainty_ns[samples.uncertainty_ns >= 0], MOST_KNOWN)) * 1e-9
            for sensor, samples in (('interferometer', log.displacement), ('psd', log.spot))
            if samples.uncertainty_ns is not None and np.any(samples.uncertainty_ns >= 0)}


def late_clocks(clocks: Mapping[str, Timing | None], between: tuple[float, float] | None,
                latency: Mapping[str, float] | None = None, names: Mapping[str, str] | None = None) -> dict[str, Late]:
    """Sensors whose stamps are provably off; ``between``: delay of the spot against the displacement, its σ [s].

    ``latency``: what the stamps of each sensor are known to be uncertain by [s]; ``names``: the clocks that stamped the
    sequencer's and the sensors' messages.  What is claimed exceeds both: clocks of one name cannot run apart, so there
    a change of the offset by less than any latency may change is none of the clock.

    What a control takes to start and to report in position moves what a sensor sees of a move, so an
    offset alone proves nothing.  Three things do: motion seen before the command or long after the
    report; two sensors that see the same moves at different times; and an offset that changes in the
    course of the log, for a control treats equal moves alike.
    """
    latency, names = latency or {}, names or {}
    seen = {name: clock for name, clock in clocks.items() if clock is not None}
    found: dict[str, Late] = {}
    for name, clock in seen.items():
        own = latency.get(name, 0.0)
        one = name in names and names[name] == names.get('sequencer')
        least_drift = (LEAST_CLOCK_S if one else LEAST_DRIFT_S) + own
        drifts = abs(clock.drift) > max(DRIFT_SIGMAS * clock.drift_sigma, least_drift)
        significant = abs(clock.offset) > max(CLOCK_SIGMAS * clock.sigma, LEAST_CLOCK_S + own)
        acausal = significant and (clock.sooner > LEAST_SOONER_S + own or (
            (clock.before - clock.after) * -np.sign(clock.offset) > MOST_OUTSIDE))
        if drifts or acausal:
            # Where the drift alone is proof, a control that begins its moves late may have made the rest.
            sigma = clock.sigma if acausal else float(np.hypot(clock.sigma, clock.onset - clock.offset))
            found[name] = Late(_start(clock), sigma, clock.drift if drifts else 0.0, clock.drift_sigma,
                               0.99 if drifts and acausal else 0.95)
    if between is None or 'interferometer' not in seen:
        return found
    sharp, other = 'interferometer', 'psd'
    (delay, sigma) = between
    limit = CLOCK_SIGMAS * sigma
    if abs(delay) > max(limit, LEAST_CLOCK_S + sum(latency.values())):
        if not found:
            # One of the two is right: the one that sees the moves begin with the command, not before.
            start = _start(seen[sharp])
            wrong = other if abs(start) < abs(start + delay) else sharp
            offset = delay if wrong == other else -delay
            found[wrong] = Late(offset, sigma, 0.0, seen[sharp].drift_sigma, 0.95)
        elif sharp in found:
            late = found[sharp]
            start = late.offset + delay
            if abs(start) < ALONE * abs(delay):
                # The other sees the moves begin with the command: it is right, and the better mark.
                found[sharp] = replace(late, offset=-delay, sigma=sigma, probability=0.99)
                found.pop(other, None)
            else:
                found[other] = replace(late, offset=start, probability=0.99)
    elif sharp in found and limit < abs(found[sharp].offset):
        # Both see the same: it is the sequencer that differs from both.
        found[other] = found[sharp]
    return found


def _start(clock: Timing) -> float:
    """Offset of the stamps by the beginning of the moves, where it is seen; by their middle elsewhere."""
    return clock.onset if clock.sharp else clock.offset


def put_right(samples: Samples, late: Late, dwell_ns: np.ndarray) -> Samples:
    """Samples with stamps put right; the drift is straight between the first and the last dwell."""
    span = max(int(dwell_ns[-1] - dwell_ns[0]), 1)
    place = (samples.time_ns - dwell_ns[0]) / span
    shift = np.rint(1e9 * (late.offset + late.drift * (np.clip(place, 0.0, 1.0) - 0.5)))
    return replace(samples, time_ns=np.maximum.accumulate(samples.time_ns - shift.astype(np.int64)))
