"""Closures of a log: by how much the reading at a cycle's first stop differs when the machine comes back to it.

A cycle goes from the first stop of a setup forward to the last one and back.  Where forward and backward share a run,
no reset lies between, and the closure of the length is ``L_back(0) − L_forward(0)``.  Where each is a run of its own,
the interferometer was reset while the machine stood at the last stop, and the two runs are joined there,

    (L_forward(N) − L_forward(0)) + (L_back(0) − L_back(N)),

which holds nothing of what drifted between the two readings of the last stop.  The detector is never reset: the
closure of the spot is the difference of its two readings.

The uncertainty is that of the readings and of two arrivals at the first stop: each axis arrives there twice with
independent errors of ``position``, which along a unit vector come to √2 ``position``, and the attitude twice with
``angle``, which moves the spot by twice the standoff times it.  What exceeds it is drift (of air that nobody
corrected, of beam, mirror, structure) or a reversal error, where the first stop was approached from another side.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stepdiag_ros.estimate.noise import Law, NoiseModel
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.model.log import CalibrationLog

TEMPERATURES = {'air': 'air_temperature', **{f'scale {a}': f'scale_temperature/{a}' for a in 'xyz'}}


@dataclass(frozen=True)
class Closure:
    """One cycle: ``length_m`` and its standard uncertainty [m], NaN where a reading is missing.

    ``runs``: ids of the forward and the backward run; ``time_ns``: middle of the two dwells at the first stop;
    ``reset_between``: the runs were joined at the last stop, ``unseen_s`` [s] passed there unseen.
    ``spot_m``, ``spot_sigma_m`` (2,) [m]; ``temperature``: at both times [°C], by what was logged.
    ``timed``: False where the times of the log are made up and say nothing.
    """

    setup: str
    repeat: int
    runs: tuple[str, str]
    time_ns: tuple[int, int]
    start_s: float
    reset_between: bool
    unseen_s: float
    length_m: float
    length_sigma_m: float
    spot_m: np.ndarray
    spot_sigma_m: np.ndarray
    timed: bool = True
    temperature: dict[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def duration_s(self) -> float:
        return (self.time_ns[1] - self.time_ns[0]) * 1e-9

    @property
    def closes(self) -> bool | None:
        """Whether the length comes back within U (k = 2); None where it was not measured."""
        return None if not np.isfinite(self.length_m) else abs(self.length_m) <= 2.0 * self.length_sigma_m

    def to_json_dict(self) -> dict[str, Any]:
        return {'setup': self.setup, 'repeat': self.repeat, 'runs': list(self.runs),
                'time_ns': list(self.time_ns) if self.timed else None,
                'duration_s': self.duration_s if self.timed else None,
                'reset_between': self.reset_between, 'unseen_s': self.unseen_s if self.timed else None,
                'length_m': _number(self.length_m), 'length_sigma_m': _number(self.length_sigma_m),
                'spot_m': [_number(v) for v in self.spot_m], 'spot_sigma_m': [_number(v) for v in self.spot_sigma_m],
                'closes': self.closes, 'temperature_C': {name: list(pair) for name, pair in self.temperature.items()}}


def closures(log: CalibrationLog, table: StopTable, noise: NoiseModel) -> tuple[Closure, ...]:
    """Closures of every cycle of ``table`` that goes from a setup's first stop forward and back to it, by time."""
    found = []
    cycles = np.unique(np.stack([table.setup, table.repeat], axis=1), axis=0)
    for setup, repeat in cycles:
        mine = (table.setup == setup) & (table.repeat == repeat)
        forward, backward = (np.flatnonzero(mine & (np.sign(table.direction) == way)) for way in (1, -1))
        ends = _ends(table, forward, backward)
        if ends is not None:
            found.append(_closure(log, table, noise, *ends))
    return tuple(sorted(found, key=lambda one: one.time_ns))


def said(found: Sequence[Closure]) -> str:
    """In a sentence how many cycles close, and of how many that is not known; empty where there are none."""
    measured = [one for one in found if one.closes is not None]
    open_ = [f'{one.setup}, repeat {one.repeat}' for one in found if one.closes is None]
    unread = (f'{len(open_)} of {len(found)} cycles have no reading at their first stop or where they turn, and so no '
              f'closure ({open_[0]}{", …" if len(open_) > 1 else ""}); give the dwells more time than the beam and the '
              'axes take to settle' if open_ else '')
    if not measured:
        return unread
    worst = max(measured, key=lambda one: abs(one.length_m))
    closing = sum(bool(one.closes) for one in measured)
    joined = any(one.reset_between for one in measured)
    unseen = '; a reset lies between forward and backward run, what drifted meanwhile is not in it' if joined else ''
    return (f'{closing} of {len(measured)} cycles return to their zero within U (k = 2); the largest closure is '
            f'{1e6 * worst.length_m:+.3f} ± {2e6 * worst.length_sigma_m:.3f} µm (k = 2; '
            f'{worst.setup}, repeat {worst.repeat})'
            + unseen + (f'; {unread}' if unread else ''))


def _ends(table: StopTable, forward: np.ndarray, backward: np.ndarray) -> tuple[int, int, int, int] | None:
    """Rows of a cycle: first stop, turn forward, turn backward, first stop again; None where it is not whole."""
    if not forward.size or not backward.size:
        return None
    first, turn = forward[np.argmin(table.index[forward])], forward[np.argmax(table.index[forward])]
    back, last = backward[np.argmax(table.index[backward])], backward[np.argmin(table.index[backward])]
    whole = table.index[first] == table.index[last] == 0 and table.index[turn] == table.index[back]
    in_order = table.dwell_ns[first] < table.dwell_ns[turn] <= table.dwell_ns[back] < table.dwell_ns[last]
    return (int(first), int(turn), int(back), int(last)) if whole and in_order else None


def _closure(log: CalibrationLog, table: StopTable, noise: NoiseModel, first: int, turn: int, back: int,
             last: int) -> Closure:
    length, sensor, beams = table.displacement[:, 0], noise.sensor, table.displacement.shape[1]
    joined = table.run[first] != table.run[last]
    value, read = length[last] - length[first], [first, last]
    if joined:
        value, read = value + length[turn] - length[back], [first, turn, back, last]
    arrival = 2.0 * (noise.position * _wider(noise.position_law))**2
    sigma = np.sqrt(np.sum(sensor[read, 0]**2) + arrival)
    name = table.setup_names[table.setup[first]]
    lever = 2.0 * log.description.setups[name].standoff * noise.angle * _wider(noise.angle_law)
    spot_sigma = np.sqrt(np.sum(sensor[[first, last], beams:]**2, axis=0) + 2.0 * lever**2)
    middle = (table.dwell_ns[[first, last]] + table.done_ns[[first, last]]) // 2
    temperature = {what: tuple(float(v) for v in log.environment[topic].at(middle))
                   for what, topic in TEMPERATURES.items()
                   if topic in log.environment and np.isfinite(log.environment[topic].value).any()}
    return Closure(name, int(table.repeat[first]), (table.run_ids[table.run[first]], table.run_ids[table.run[last]]),
                   (int(middle[0]), int(middle[1])), float(table.time_s[first]), bool(joined),
                   float(max(table.dwell_ns[back] - table.done_ns[turn], 0) * 1e-9) if joined else 0.0,
                   float(value), float(sigma), table.spot[last] - table.spot[first], spot_sigma,
                   log.description.timed, temperature)


def _wider(law: Law) -> float:
    """Standard deviation of a law of unit scale."""
    return 1.0 if not np.isfinite(law.dof) or law.dof <= 2.0 else float(np.sqrt(law.dof / (law.dof - 2.0)))


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
