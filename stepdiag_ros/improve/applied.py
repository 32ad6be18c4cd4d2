"""A log as the machine would have given it without the volumetric compensation that was in force.

A machine under volumetric compensation is no rigid-body machine with 21 errors: its angles are what they
were, and their effect on the tool point is gone everywhere.  The compensation itself is known exactly, so it
is put back into the lengths before anything is evaluated: with ``c(x)`` taken off at axis position x, a base
unit that looks along ``d`` would have read ``d·(c(x) − c(x₀))`` more at a stop than it did, x₀ being where
its run was zeroed.  What is then found are the machine's own errors; less ``c`` they are what remains.
Spots do not change: a flat mirror that is shifted by micrometres sends the light back as before.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from stepdiag_ros.model.log import DONE, DWELL, CalibrationLog
from stepdiag_ros.model.path import setup_direction

TakenOff = Callable[[np.ndarray], np.ndarray]
"""Axis positions (n, 3) [m] in the volume to what the compensation takes off there (n, 3) [m]."""


def without_applied(log: CalibrationLog, taken_off: TakenOff) -> CalibrationLog:
    """The log with the compensation put back into every dwell's lengths."""
    steps, samples = log.steps, log.displacement
    values = samples.values.copy()
    taken = taken_off(steps.commanded)
    directions = {name: setup_direction(log.description.machine, log.description.setups[name])
                  for name in steps.setup_names}
    zero: dict[tuple[int, int, int], np.ndarray] = {}
    begun: dict[tuple[int, int, int], int] = {}
    for row in range(len(steps)):
        key = (int(steps.run[row]), int(steps.repeat[row]), int(steps.direction[row]))
        if steps.phase[row] == DWELL:
            zero.setdefault(key, taken[row])
            begun[key] = int(steps.time_ns[row])
        elif steps.phase[row] == DONE and key in begun:
            name = steps.setup_names[steps.setup[row]]
            first, last = np.searchsorted(samples.time_ns, [begun.pop(key), int(steps.time_ns[row])])
            mine = np.zeros(last - first, bool)
            if name in samples.setup_names:
                mine = samples.setup[first:last] == samples.setup_names.index(name)
            values[first:last][mine] += directions[name] @ (taken[row] - zero[key])
    return replace(log, displacement=replace(samples, values=values))
