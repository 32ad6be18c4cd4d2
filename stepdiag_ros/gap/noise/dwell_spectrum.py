"""The spectrum of the samples inside the dwells: vibration of the machine, turbulence of the air, mains hum."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.gap.constants import (
    BACKGROUND_ALARM,
    COHERENT_ALARM,
    GROWS,
    GROWTH_SIGMAS,
    LEAST_GROWTH,
    MISFIT,
    VIBRATION_ALARM,
)
from stepdiag_ros.gap.noise.coherent_lines import find_coherent_lines
from stepdiag_ros.gap.noise.incoherent_lines import Vibration, find_lines
from stepdiag_ros.gap.preprocess.dwells import LEAST_DWELLS, Dwells, dwells_of
from stepdiag_ros.model.log import CalibrationLog

CALM = 0.8
"""Share of the dwells, the quieter ones, that must show a line too …"""
CALM_SHARE = 0.2
"""… by this share of the log evidence of all: a tool that shakes leaves a half and more there, knocks nothing."""


@dataclass(frozen=True)
class DwellSpectrum:
    """What the samples of the dwells show besides white noise.

    ``displacement`` and ``spot``: lines of each, None where dwells are too short to tell; ``slow``: log
    evidence for a smooth background in the displacement, ``slow_spot`` in the spot; ``growth``: exponent
    with which the power of that of the displacement grows with the path, ``growth_sigma`` (infinite: not seen);
    ``power`` (n,) [m²]: of that background at each stop, per e-fold of frequency; ``swings`` (n, 3) [m²]: what lines
    that were seen add to displacement and spot in the dwells, beyond the noise on average.
    """

    displacement: Vibration | None
    spot: Vibration | None
    slow: float
    slow_spot: float
    growth: float
    growth_sigma: float
    power: np.ndarray
    swings: np.ndarray

    @property
    def shakes(self) -> bool:
        """Whether the tool point shakes: lines that no smooth spectrum explains, alike near and far, in all dwells."""
        return self.has_lines and not (self.grows_with_path or self.displacement.of_few)

    @property
    def swings_in_few(self) -> bool:
        """Whether it does so in a few dwells only, as after knocks."""
        return self.has_lines and not self.grows_with_path and self.displacement.of_few

    @property
    def has_lines(self) -> bool:
        """Whether the displacement swings inside dwells, in whatever way."""
        return _clear(self.displacement, self.slow) and not self.turbulent

    @property
    def grows_with_path(self) -> bool:
        """Whether lines of the displacement grow with the path, as those of air or of the laser do."""
        return self.has_lines and self.displacement.log_growth > GROWS

    @property
    def turbulent(self) -> bool:
        """Whether slow noise grows with the path, as that of moving air does and shaking does not."""
        return self.slow > BACKGROUND_ALARM and self.growth > LEAST_GROWTH \
            and self.growth > GROWTH_SIGMAS * self.growth_sigma

    @property
    def mains_hum(self) -> bool:
        """Whether the spot alone swings: no motion that the displacement sees."""
        return _clear(self.spot, self.slow_spot) and not self.has_lines


def dwell_spectrum(channels: Mapping[str, Dwells | None], run: np.ndarray, distance: np.ndarray) -> DwellSpectrum:
    """What the samples inside the dwells of :func:`dwells_by_channel` show; ``run`` (n,) of the stops and ``distance``
    (n,) [m] to the mirror."""
    dwells_of_all = tuple(channels.values())
    found = [(None, 0.0) if dwells is None else _lines(dwells, run, distance) for dwells in dwells_of_all]
    beams = dwells_of_all[0]
    growth, sigma, power = growth_with(beams, distance) if beams else (0.0, np.inf, np.zeros(len(run)))
    swings = np.zeros((len(run), len(found)))
    for channel, (dwells, (lines, slow)) in enumerate(zip(dwells_of_all, found, strict=True)):
        if _clear(lines, slow):
            swings[dwells.rows, channel] = lines.by_dwell
    (lines, slow), *others = found
    spot, slow_spot = max(others, key=lambda s: _margin(*s))
    return DwellSpectrum(lines, spot, slow, slow_spot, growth, sigma, power, swings)


def dwells_by_channel(log: CalibrationLog, table: StopTable) -> dict[str, Dwells | None]:
    """The dwells' samples of displacement, spot x and spot y; None where they are too few or too short."""
    kind = (table.setup * 256 + table.axis) * 3 + table.direction
    beams, spot = log.displacement, log.spot
    channels = (('displacement', beams, table.displacement_rows, beams.values.mean(axis=1)),
                ('spot x', spot, table.spot_rows, spot.values[:, 0]),
                ('spot y', spot, table.spot_rows, spot.values[:, 1]))
    return {name: dwells_of(values, samples.time_ns, rows, kind, table.dwell_ns)
            for name, samples, rows, values in channels}


def _lines(dwells: Dwells, run: np.ndarray, distance: np.ndarray) -> tuple[Vibration | None, float]:
    """Lines in dwells, and the log evidence for a smooth background; ``run`` (stops,), ``distance`` (stops,) [m].

    Where each dwell by itself shows none, those that keep their phase count, and so do those that grow with the
    path: of which cause lines are, only they say.
    """
    lines, slow = find_lines(dwells)
    coherent = find_coherent_lines(dwells, run[dwells.rows], distance[dwells.rows], COHERENT_ALARM)
    if _clear(coherent, slow) and (not _clear(lines, slow) or coherent.log_growth > GROWS):
        return coherent, slow
    if _clear(coherent, slow) and abs(coherent.frequency - lines.frequency) < 1.0 / dwells.length:
        lines = replace(lines, frequency=coherent.frequency)  # of what a dwell tells to one over its length
    if _clear(lines, slow):
        lines = replace(lines, of_few=_of_few(dwells, lines))
    return lines, slow


def _of_few(dwells: Dwells, lines: Vibration) -> bool:
    """Whether the loudest dwells alone show some lines: what shakes does so in all, and beside quiet dwells a few that
    were knocked have a spectrum that is no smooth one's."""
    power = np.sum(dwells.values**2, axis=1)
    calm, slow = find_lines(replace(dwells, values=dwells.values[power <= np.quantile(power, CALM)]))
    return calm is None or calm.log_bayes - MISFIT * slow < CALM_SHARE * lines.log_bayes


def _clear(lines: Vibration | None, slow: float) -> bool:
    return _margin(lines, slow) > 0.0


def _margin(lines: Vibration | None, slow: float) -> float:
    """Log evidence of lines above what is asked of them."""
    if lines is None:
        return -np.inf
    if lines.coherent:
        return lines.log_bayes - COHERENT_ALARM
    # No smooth form holds to the last part: what it leaves of much noise is not yet a line.
    return lines.log_bayes - VIBRATION_ALARM - MISFIT * slow


def growth_with(dwells: Dwells, distance: np.ndarray) -> tuple[float, float, np.ndarray]:
    """Exponent with which the dwells' smooth background grows with ``distance`` (stops,), its σ, and the background's
    power (stops,) per e-fold of frequency by that law.

    The power of the slow half of the spectrum, above that of the fast half, is fitted as c dᵖ.  Of noise as 1/f the
    k-th half wave has 1/k of what an e-fold has.
    """
    power, rest, slow = dwells.slow_and_fast()
    white = np.median(rest) / max(dwells.basis.shape[1] - slow, 1) * slow
    far = distance[dwells.rows]
    kept = np.isfinite(far) & (far > 0.0)
    if kept.sum() < LEAST_DWELLS or np.ptp(np.log(far[kept])) < 0.3:
        return 0.0, np.inf, np.zeros(len(distance))
    order = np.argsort(far[kept])
    place, excess = np.log(far[kept])[order], (power[kept] - white)[order]
    parts = np.array_split(np.arange(len(order)), 6)
    x = np.array([place[p].mean() for p in parts])
    mean = np.array([excess[p].mean() for p in parts])
    error = np.array([excess[p].std() / np.sqrt(len(p)) for p in parts])
    if (mean > 0.0).sum() < 3 or mean.sum() < 6.0 * np.sqrt(np.sum(error**2)):
        return 0.0, np.inf, np.zeros(len(distance))
    mean = np.maximum(mean, error)
    y, weight = np.log(mean), (mean / np.maximum(error, 1e-300)) ** 2
    middle = float(np.sum(weight * x) / weight.sum())
    x = x - middle
    slope = float(np.sum(weight * x * y) / np.sum(weight * x * x))
    level = float(np.sum(weight * y) / weight.sum())
    misfit = y - level - slope * x
    spread = max(float(np.sum(weight * misfit**2)) / (len(x) - 2), 1.0)
    near = np.log(np.where(np.isfinite(distance) & (distance > 0.0), distance, np.exp(middle))) - middle
    return slope, float(np.sqrt(spread / np.sum(weight * x * x))), \
        np.exp(level + slope * near) / len(dwells.basis) / float(np.sum(1.0 / dwells.slow_waves))
