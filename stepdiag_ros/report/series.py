"""What the pictures of a diagnosis show: readings before and after, the effects' part, noise, by stop."""

from dataclasses import dataclass, replace

import numpy as np

from stepdiag_ros.estimate.enhanced import readings_of
from stepdiag_ros.estimate.noise import whiteners
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.gap.diagnosis import Diagnosis
from stepdiag_ros.gap.noise.coherent_lines import Spectrum, spectrum
from stepdiag_ros.gap.noise.dwell_spectrum import dwells_by_channel


@dataclass(frozen=True)
class Series:
    """One row a visited stop (n,), channels ``c`` = length (first beam), spot x, spot y.

    ``before`` (n, 3) [m]: log minus the simulator without the causes, both fitted; ``after``: with them;
    ``real`` (n, 3) [m]: log minus the fitted rigid machine, causes left in; ``simulated`` (n, 3): what the
    causes make of it in the simulator; ``sigma`` (n, 3) [m]: noise of one reading.
    """

    before: np.ndarray
    after: np.ndarray
    real: np.ndarray
    simulated: np.ndarray
    sigma: np.ndarray


def series(diagnosis: Diagnosis) -> Series:
    """Lay out a diagnosis; ``real`` and ``simulated`` are counted from their mean in each run."""
    joint, table = diagnosis.joint, diagnosis.nominal.table
    beams = table.displacement.shape[1]
    keep = [0, beams, beams + 1]
    simulated = sum((a.contribution for a in joint.active), np.zeros_like(readings_of(table)))
    after = joint.fit.residual
    real = after + simulated
    mean = _mean_of_runs(simulated, table)
    variance = np.full(real.size, np.nan)
    for white in whiteners(table, joint.noise, joint.fit.arrival, joint.fit.present):
        variance[white.rows] = np.sum(white.factor**2, axis=1)
    sigma = np.sqrt(variance).reshape(real.shape)
    return Series(*(part[:, keep] for part in (diagnosis.nominal.fit.residual, after, real - mean,
                                               simulated - mean, sigma)))


def _mean_of_runs(values: np.ndarray, table: StopTable) -> np.ndarray:
    """Mean (n, c) of the lengths in the run of each stop; 0 for the spot, which no reset counts from."""
    beams, mean = table.displacement.shape[1], np.zeros_like(values)
    for run in np.unique(table.run):
        rows = table.run == run
        mean[rows, :beams] = values[rows, :beams].mean(axis=0)
    return mean


def replayed(diagnosis: Diagnosis, made: np.ndarray, left: np.ndarray) -> Series:
    """The same of a simulator that was run along the moves of the log: what its effects ``made`` there and what of the
    log it ``left`` (n, c) [m]."""
    table, shown = diagnosis.nominal.table, series(diagnosis)
    beams = table.displacement.shape[1]
    mean = _mean_of_runs(made, table)
    keep = [0, beams, beams + 1]
    left = np.where(diagnosis.joint.fit.present, left, np.nan)
    return replace(shown, after=left[:, keep], real=(left + made - mean)[:, keep], simulated=(made - mean)[:, keep])


def reach(diagnosis: Diagnosis, name: str) -> tuple[float, float]:
    """How far a cause moves the length (from the run's reset) and the spot, at most [m]."""
    table = diagnosis.nominal.table
    beams = table.displacement.shape[1]
    total = sum((a.contribution for a in diagnosis.joint.active if a.effect.name == name),
                np.zeros((len(table), beams + 2)))
    length = 0.0
    for run in np.unique(table.run):
        part = total[table.run == run, :beams]
        length = max(length, float(np.ptp(part, axis=0).max()))
    return length, float(np.abs(total[:, beams:]).max())


@dataclass(frozen=True)
class Inside:
    """What moves while the machine stands still; channels as in :class:`Series`.

    ``rate``, ``simulated_rate`` (n, 3) [m/s]; by axis moved: ``time`` (b,) [s] after the stop began,
    ``profile`` and ``simulated_profile`` (3 axes, b, 3) [m] about their mean, backward runs turned round.
    """

    rate: np.ndarray
    simulated_rate: np.ndarray
    time: np.ndarray
    profile: np.ndarray
    simulated_profile: np.ndarray


def inside(diagnosis: Diagnosis) -> Inside:
    """Reduce the bins of the dwells to what can be looked at."""
    seen, view, table = diagnosis.joint.observation, diagnosis.nominal.view, diagnosis.nominal.table
    beams = table.displacement.shape[1]
    keep = [0, beams, beams + 1]
    real = seen.bins[:, :, keep]
    modelled = sum((a.inside for a in diagnosis.joint.active), np.zeros_like(seen.bins))[:, :, keep]
    away = view.bin_time - view.bin_time.mean(axis=1, keepdims=True)
    weight = away / np.maximum(np.sum(away**2, axis=1, keepdims=True), 1e-30)
    profiles = np.full((2, 3, real.shape[1], 3), np.nan)
    for axis in range(3):
        rows = (table.axis == axis) & np.isfinite(real).all(axis=(1, 2))
        # Forward is away from the laser for every axis and setup: turned so, creep points one way.
        sign = table.direction[rows][:, None, None]
        if rows.any():
            profiles[0, axis] = np.mean(real[rows] * sign, axis=0)
            profiles[1, axis] = np.mean(modelled[rows] * sign, axis=0)
    return Inside(np.einsum('nb,nbc->nc', weight, real), np.einsum('nb,nbc->nc', weight, modelled),
                  np.median(view.bin_time, axis=0), *profiles)


def spectra(diagnosis: Diagnosis) -> dict[int, Spectrum]:
    """Spectra of the dwells by channel, of the channels in which lines were seen."""
    seen = diagnosis.joint.observation
    if seen.swings is None:
        return {}
    found = {channel: spectrum(dwells, seen.table.run[dwells.rows])
             for channel, dwells in enumerate(dwells_by_channel(seen.log, seen.table).values())
             if dwells is not None and seen.swings[:, channel].any()}
    return {channel: one for channel, one in found.items() if one is not None}
