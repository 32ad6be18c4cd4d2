"""A log as the machine would have given it without the volumetric compensation that was in force.

A machine under volumetric compensation is no rigid-body machine with 21 errors: its rotations are what they were,
and their effect on the tool point is gone everywhere.  The compensation itself is known exactly, so it is put back into
the lengths before anything is evaluated: with ``c(x)`` taken off at axis position x, a base unit that looks along ``d``
would have read ``d·(c(x) − c(x₀))`` more at a stop than it did, x₀ being where its run was zeroed.  What is then found
are the machine's own errors; less what is taken off they are what remains (:func:`remaining`).  Spots do not change: a
flat mirror that is shifted by micrometres sends the light back as before.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from stepdiag_ros.compensate.taken import Taken, as_measured, errors_of, left_of, nothing
from stepdiag_ros.estimate.prediction import compensated_command
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.model.description import Machine
from stepdiag_ros.model.log import DONE, DWELL, CalibrationLog
from stepdiag_ros.model.path import setup_direction

TakenOff = Callable[[np.ndarray], np.ndarray]
"""Axis positions (n, 3) [m] in the volume to what the compensation takes off there (n, 3) [m]."""


def taken_off(taken: Taken, machine: Machine) -> TakenOff:
    """What a control that computes the whole model takes off, axes less joints, for the machine's own tool."""
    errors = errors_of(taken)
    return lambda axes: np.atleast_2d(axes) - compensated_command(errors, machine, axes)


def bare(log: CalibrationLog, taken: Taken) -> CalibrationLog:
    """The log as without a compensation of the whole model that takes ``taken`` off; itself where that is nothing."""
    return log if nothing(taken) else without_applied(log, taken_off(taken, log.description.machine))


def without_applied(log: CalibrationLog, off: TakenOff) -> CalibrationLog:
    """The log with the compensation put back into every dwell's lengths."""
    steps, samples = log.steps, log.displacement
    values = samples.values.copy()
    taken = off(steps.commanded)
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


def remaining(solution: Solution, taken: Taken) -> Solution:
    """What the tool point keeps of the machine's own errors under a compensation, from its own reference lines; the
    solution itself where nothing is taken off.

    The covariance is that of the errors: the compensation is known exactly.
    """
    if nothing(taken):
        return solution
    left = as_measured(left_of(solution.errors, {name: trim for name, trim in taken.items() if solution.has(name)}),
                       solution.positions)
    value = np.array([left.square[name] if knot < 0 else float(left.curves[name].value[knot])
                      for name, knot in solution.names])
    return replace(solution, value=value)
