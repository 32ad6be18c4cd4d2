"""The lengths of a regulated beam as they would be if it always met the retroreflector's centre.

What it misses the centre by shortens a length, and the spot tells by how much (:mod:`stepdiag_ros.model.regulation`).
It is put back sample by sample, before anything is averaged: as a dwell begins the beam still trails, and what dies
out there is neither noise nor a machine that creeps.
"""

from dataclasses import replace

import numpy as np

from stepdiag_ros.model.log import CalibrationLog, Samples
from stepdiag_ros.model.regulation import shortened
from stepdiag_ros.model.sensor import nominal_sight

NEAR_NS = 20_000_000
"""A spot tells of samples that are no farther from it in time."""
HELD_M = 2e-8
"""A beam that shortens its length by more is not held yet."""


def on_centre(log: CalibrationLog) -> tuple[CalibrationLog, list[str]]:
    """``log`` with corrected lengths and without the spots that corrected them, its beams no longer regulated, and what
    was left out, in words; itself where no setup regulates its beam."""
    description = log.description
    regulated = [name for name, setup in description.setups.items() if setup.regulated]
    if not regulated or not len(log.steps):
        return log, []
    values, held, warnings = log.displacement.values.copy(), np.ones(len(log.displacement), bool), []
    event = np.maximum(np.searchsorted(log.steps.time_ns, log.displacement.time_ns, side='right') - 1, 0)
    for name in regulated:
        rows = np.flatnonzero(_of(log.displacement, name))
        seen = _of(log.spot, name) & np.isfinite(log.spot.values).all(axis=1)
        times, squares = log.spot.time_ns[seen], np.sum(log.spot.values[seen] ** 2, axis=1)
        distance, _ = nominal_sight(description.machine, description.setups[name], log.steps.commanded[event[rows]])
        square, near = _between(log.displacement.time_ns[rows], times, squares)
        short = shortened(square, distance)
        values[rows] += short[:, None]
        held[rows] = near & (short <= HELD_M)
        if not near.all():
            warnings.append(f'{log.source}: psd/spot: no light near {int((~near).sum())} of {len(rows)} lengths of the '
                            f'regulated beam of {name}; by how much it missed the retroreflector there is not known, '
                            'and they are left out')
    setups = {name: replace(setup, regulated=False) for name, setup in description.setups.items()}
    return replace(log, description=replace(description, setups=setups),
                   displacement=_kept(replace(log.displacement, values=values), held),
                   spot=_kept(log.spot, ~np.any([_of(log.spot, name) for name in regulated], axis=0))), warnings


def _of(samples: Samples, setup: str) -> np.ndarray:
    """Mask (n,) of the samples of a setup."""
    names = samples.setup_names
    return samples.setup == (names.index(setup) if setup in names else -1)


def _kept(samples: Samples, rows: np.ndarray) -> Samples:
    return replace(samples, **{name: value[rows] for name, value in vars(samples).items()
                               if isinstance(value, np.ndarray)})


def _between(at: np.ndarray, times: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``values`` (k,) at ``at`` (n,), straight between their ``times``, and whether one of them is near."""
    if not len(times):
        return np.zeros(len(at)), np.zeros(len(at), bool)
    after = np.clip(np.searchsorted(times, at), 1, max(len(times) - 1, 1))
    around = np.minimum(np.stack([after - 1, after]), len(times) - 1)
    near = np.abs(times[around] - at).max(axis=0) <= NEAR_NS
    # Before the first and after the last the nearest one counts.
    ends = ((at < times[0]) & (times[0] - at <= NEAR_NS)) | ((at > times[-1]) & (at - times[-1] <= NEAR_NS))
    return np.interp(at - times[0], times - times[0], values), near | ends
