"""Lines that keep their phase from dwell to dwell: a pump, a fan or the mains, far below the noise of one dwell.

All dwells of a stretch are transformed together, in the time of the log, and give the power |z|² at
frequencies as fine as the stretch is long.  Its floor is measured beside each frequency, in the band that
one dwell resolves: no form of the background is supposed.  Over the floor the powers of pure noise follow
an exponential law; with a line whose amplitude is another in each stretch (the beam sees it from another
side) they have the mean 1 + ρ, so that the evidence is

    ln L = Σ [ p ρ/(1 + ρ) − ln(1 + ρ) ],      p = |z|²/floor.

How long a machine's frequency stays the same is not known: stretches are whole runs or a few dwells.
What shakes the tool is as large near the mirror as far from it; a swing of the air or of the laser's frequency
grows with the path.  The same powers with each dwell weighted by its path tell the one from the other.
"""

from dataclasses import dataclass

import numpy as np
from scipy import fft

from stepdiag_ros.gap.noise.incoherent_lines import MOST_LINES, Vibration
from stepdiag_ros.gap.preprocess.dwells import Dwells

FEW = 8
"""Dwells of a short stretch."""
LEAST = 4
"""Dwells that a stretch must have, and a kind of dwells whose common pattern is taken away."""
FINER = 8
"""Steps of the grid of times in a sample's period."""
BAND = 0.5
"""Width of the band in which the floor is measured, in one over the dwell's length."""
SEEN = 0.1
"""Share of a line's power that a dwell must have left."""
SIZES = np.logspace(-3.0, 4.0, 29)
"""Powers of a line in one dwell against the floor that are tried."""


@dataclass(frozen=True)
class Spectrum:
    """Powers (s, f) |z|² of s stretches of ``counts`` (s,) dwells at ``hertz`` (f,), in units of each stretch's own
    ``level`` (s, 1) [m²]; their ``floor`` (f,); what a dwell has left, ``seen`` (f,), of a line's sum of squares;
    ``width`` [Hz] that a dwell resolves."""

    hertz: np.ndarray
    power: np.ndarray
    level: np.ndarray
    floor: np.ndarray
    seen: np.ndarray
    counts: np.ndarray
    width: float

    @property
    def over_median(self) -> np.ndarray:
        """Power (f,) over that of most frequencies, mean of the stretches."""
        mean = self.power.mean(axis=0)
        return mean / np.median(mean)

    @property
    def strongest(self) -> int:
        """Number of the frequency at which a line stands out of the noise beside it most."""
        return self.peak(int(np.argmax(self.power.mean(axis=0) / self.floor)))

    def peak(self, k: int) -> int:
        """Number of the frequency of the line that is seen at number ``k``.

        At the pace of the stops a line has shadows, and a strong one lifts the floor beside it.  Its own power is
        the largest of all that it makes: |⟨e′, e⟩|² ≤ ⟨e′, e′⟩⟨e, e⟩ in what the dwells have left.
        """
        near = np.flatnonzero(np.abs(self.hertz - self.hertz[k]) < self.width)
        return int(near[np.argmax(np.sum(self.level * self.power[:, near], axis=0))])


def find_coherent_lines(dwells: Dwells, run: np.ndarray, path: np.ndarray, alarm: float) -> Vibration | None:
    """Lines in ``dwells`` of K stops that belong to ``run`` (K,) and lie ``path`` (K,) [m] from the mirror; None
    where no stretch is long enough.  Lines beside the strongest are reported above the evidence ``alarm``."""
    samples = _samples(dwells)
    found = [_lines(dwells, samples, path, stretches, alarm) for stretches in _stretches(run)]
    return max((f for f in found if f is not None), key=lambda f: f.log_bayes, default=None)


def spectrum(dwells: Dwells, run: np.ndarray) -> Spectrum | None:
    """That of the whole runs, ``run`` (K,), to look at; None where no run is long enough."""
    return _spectrum(dwells, _samples(dwells), _stretches(run)[0])


def _samples(dwells: Dwells) -> np.ndarray:
    """The dwells' samples (K, n), without what their kind of move leaves: that has the moves' own rhythm."""
    samples = dwells.values @ dwells.basis.T
    for number in np.unique(dwells.kind):
        mine = dwells.kind == number
        if mine.sum() >= LEAST:
            samples[mine] -= samples[mine].mean(axis=0)
    return samples


def _stretches(run: np.ndarray) -> list[list[np.ndarray]]:
    """Rows of dwells, as lists of whole runs and of a few neighbours."""
    runs = [np.flatnonzero(run == r) for r in np.unique(run)]
    few = [part for rows in runs for part in np.array_split(rows, max(len(rows) // FEW, 1))]
    return [[rows for rows in rows_of if len(rows) >= LEAST] for rows_of in (runs, few)]


def _places(dwells: Dwells) -> np.ndarray:
    """Places (K, n) of the samples on a grid of times, in steps of a sample's period by FINER."""
    return np.rint(FINER * (dwells.first_s[:, None] / dwells.period + np.arange(len(dwells.basis)))).astype(np.int64)


def _spectrum(dwells: Dwells, samples: np.ndarray, stretches: list[np.ndarray]) -> Spectrum | None:
    """That of one choice of stretches; None where none is long enough."""
    if not stretches:
        return None
    place, step = _places(dwells), dwells.period / FINER
    longest = max(int(place[rows[-1], -1] - place[rows[0], 0]) + 1 for rows in stretches)
    size = fft.next_fast_len(2 * longest, real=True)
    hertz = np.arange(size // (2 * FINER)) / (size * step)
    seen = _seen(dwells, hertz)
    usable = np.flatnonzero(seen > SEEN * samples.shape[1])
    block = max(int(BAND / dwells.length * size * step), 8)
    if len(usable) < 4 * block:
        return None
    hertz, seen = hertz[usable], seen[usable]
    power, counts = np.empty((len(stretches), len(usable))), np.array([len(rows) for rows in stretches])
    for p, rows in zip(power, stretches, strict=True):
        at = place[rows].ravel()
        curve = np.bincount(at - at.min(), samples[rows].ravel(), size)
        p[:] = np.abs(fft.rfft(curve)[usable]) ** 2 / (len(rows) * seen)
    level = np.median(power, axis=1, keepdims=True)  # the farther the mirror, the more air
    power /= level
    return Spectrum(hertz, power, level, _floor(power.mean(axis=0), block, len(stretches)), seen, counts,
                    1.0 / dwells.length)


def _lines(dwells: Dwells, samples: np.ndarray, path: np.ndarray, stretches: list[np.ndarray],
           alarm: float) -> Vibration | None:
    """The lines of one choice of stretches."""
    found = _spectrum(dwells, samples, stretches)
    if found is None:
        return None
    hertz, counts = found.hertz, found.counts
    evidence = _evidence(found.power / found.floor, counts) - np.log(len(hertz) / 2.0) - 1.0
    best, chosen = -np.inf, []
    free = np.ones(len(hertz), bool)
    while len(chosen) < MOST_LINES and free.any():
        k = int(np.argmax(np.where(free, evidence, -np.inf)))
        if chosen and evidence[k] < alarm:
            break
        best = max(best, float(evidence[k]))
        chosen.append(found.peak(k))
        free &= np.minimum(np.abs(hertz - hertz[k]), np.abs(hertz - hertz[chosen[-1]])) > found.width
    noise = found.level * found.floor[chosen]
    over = found.level * found.power[:, chosen] - noise
    weight = counts.sum() * found.seen[chosen] / 2.0
    strength = np.maximum(over.sum(axis=0), 0.0) / weight
    spread = np.sqrt(np.sum(noise**2 + 2.0 * noise * np.maximum(over, 0.0), axis=0)) / weight
    amplitude = float(np.sqrt(2.0 * strength[0]))
    by_dwell = np.zeros(len(samples))
    for rows, excess, count in zip(stretches, over[:, 0], counts, strict=True):
        by_dwell[rows] = excess / count
    return Vibration(float(hertz[chosen[0]]), amplitude, float(spread[0]) / max(amplitude, 1e-300),
                     min(best, 1e4),
                     float(min(strength.sum() * samples.size / max(np.sum(dwells.values**2), 1e-300), 1.0)),
                     tuple(hertz[chosen].tolist()), tuple(strength.tolist()), True,
                     _growth(dwells, samples, path, stretches, found, chosen[0]), by_dwell, 1.0 / dwells.period)


def _growth(dwells: Dwells, samples: np.ndarray, path: np.ndarray, stretches: list[np.ndarray], found: Spectrum,
            k: int) -> float:
    """Log evidence that the swing at ``found.hertz[k]`` grows with the path against one that does not."""
    wave = np.exp(-2j * np.pi * found.hertz[k] * dwells.period / FINER * _places(dwells))
    swing, far = np.sum(samples * wave, axis=1), np.where(np.isfinite(path), path, 0.0)
    weighted = np.array([abs(far[rows] @ swing[rows]) ** 2 / max(far[rows] @ far[rows], 1e-300) for rows in stretches])
    weighted /= found.level[:, 0] * found.floor[k] * found.seen[k]
    alike = _evidence(found.power[:, k:k + 1] / found.floor[k], found.counts)
    return float((_evidence(weighted[:, None], found.counts) - alike)[0])


def _evidence(power: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """ln L (f,) of lines over noise from ``power`` (s, f) over the floor, in stretches of ``counts`` (s,) dwells."""
    best = np.full(power.shape[1], -np.inf)
    for height in SIZES:
        more = (height * counts)[:, None]
        best = np.maximum(best, np.sum(power * (more / (1.0 + more)) - np.log1p(more), axis=0))
    return best


def _seen(dwells: Dwells, hertz: np.ndarray) -> np.ndarray:
    """What a dwell has left (f,) of the sum of squares of exp(iωt), of n before."""
    size = len(dwells.basis)
    cycles = np.linspace(0.0, size / 2.0, 8 * size)
    wave = np.exp(2j * np.pi * np.outer(np.arange(size), cycles) / size)
    return np.interp(hertz * dwells.length, cycles, np.sum(np.abs(dwells.basis.T @ wave) ** 2, axis=0))


def _floor(mean: np.ndarray, block: int, count: int) -> np.ndarray:
    """What noise alone has near each frequency: the median over a ``block`` of ``mean`` (f,) over ``count`` powers."""
    parts = np.array_split(np.arange(len(mean)), len(mean) // block)
    level = np.array([np.median(mean[p]) for p in parts]) / (1.0 - 1.0 / (9.0 * count)) ** 3  # median of a χ²
    middle = np.array([p.mean() for p in parts])
    return np.exp(np.interp(np.arange(len(mean)), middle, np.log(np.maximum(level, 1e-300))))
