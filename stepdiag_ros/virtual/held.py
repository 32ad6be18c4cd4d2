"""The loop that holds a beam on the retroreflector, on a virtual clock.

As the detector's node does it live (:mod:`stepdiag_ros.nodes.beam_loop`): once a period a command from the spot, in
effect a little later.  The spot is that of the beam alone: sensor noise is far below the mirrors' smallest step, and
what an effect does to the detector does not act back on the beam here.
"""

from collections.abc import Callable, Sequence

import numpy as np

from stepdiag_ros.model.regulation import DEADBAND, PERIOD_S, Regulator, aim_of, steered
from stepdiag_ros.virtual.steering import SteeringHistory
from stepdiag_ros.virtual.world import World

PART_NS = round(1000 * PERIOD_S * 1e9)
"""Between two words of progress: whole periods."""
EFFECT_NS = 6_000_000
"""From the end of a period to the effect of its command: a packet's way, the loop's, and the mirrors'."""


def hold_beams(world: World, runs: Sequence[tuple[str, int, int]],
               held: Callable[[int], None] = lambda _ns: None) -> None:
    """Give ``world`` the beam's angles during ``runs`` (setup, begin and end [ns]) in order of time, all of setups that
    regulate their beam; without any it stays as it is.  ``held(ns)`` is told now and then what has been done since."""
    if not runs:
        return
    world.steering, regulators = SteeringHistory(), {}
    for setup, begin, end in runs:
        if setup not in regulators:
            regulators = {setup: _regulator(world, setup)}   # mounted anew
            world.steering.command(begin - EFFECT_NS, _taken(world, regulators[setup].command))
        for part in range(begin, end, PART_NS):
            _hold(world, setup, regulators[setup], part, min(part + PART_NS, end))
            held(min(PART_NS, end - part))


def _regulator(world: World, setup: str) -> Regulator:
    detector = world.cell.instruments.detector
    return Regulator(aim_of(world.cell.description, setup), DEADBAND * detector.steering.step_rad,
                     0.5 * detector.length)


def _taken(world: World, command: np.ndarray) -> np.ndarray:
    mirrors = world.cell.instruments.detector.steering
    return mirrors.commanded(mirrors.command_volts(command))


def _hold(world: World, setup: str, regulator: Regulator, begin: int, end: int) -> None:
    times = np.arange(begin, end, round(PERIOD_S * 1e9))
    arms, frame = world.arm(times, setup), world.frame(setup)
    zero, edge = np.array(world.cell.psd_zero[setup]), 0.5 * world.cell.instruments.detector.length
    commanded = None
    for time, arm in zip(times, arms, strict=True):
        spot = steered(frame, world.steering.angles(time[None]), arm[None])[1][0] + zero
        taken = _taken(world, regulator.next(spot if np.abs(spot).max() <= edge else None))
        if commanded is None or (taken != commanded).any():
            world.steering.command(int(time) + EFFECT_NS, taken)
            commanded = taken
