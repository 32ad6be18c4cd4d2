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

import numpy as np
from scipy import fft

from stepdiag_ros.gap.dwells import Dwells
from stepdiag_ros.gap.lines import Vibration

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
MOST_LINES = 3


def steady_lines(dwells: Dwells, run: np.ndarray, path: np.ndarray, alarm: float) -> Vibration | None:
    """Lines in ``dwells`` of K stops that belong to ``run`` (K,) and lie ``path`` (K,) [m] from the mirror; None
    where no stretch is long enough.  Lines beside the strongest are told above the evidence ``alarm``."""
    samples = dwells.values @ dwells.basis.T
    for number in np.unique(dwells.kind):
        mine = dwells.kind == number
        if mine.sum() >= LEAST:
            samples[mine] -= samples[mine].mean(axis=0)  # what each such move leaves has the moves' own rhythm
    found = [_lines(dwells, samples, path, stretches, alarm) for stretches in _stretches(run)]
    return max((f for f in found if f is not None), key=lambda f: f.log_bayes, default=None)


def _stretches(run: np.ndarray) -> list[list[np.ndarray]]:
    """Rows of dwells, as lists of whole runs and of a few neighbours."""
    runs = [np.flatnonzero(run == r) for r in np.unique(run)]
    few = [part for rows in runs for part in np.array_split(rows, max(len(rows) // FEW, 1))]
    return [[rows for rows in rows_of if len(rows) >= LEAST] for rows_of in (runs, few)]


def _lines(dwells: Dwells, samples: np.ndarray, path: np.ndarray, stretches: list[np.ndarray],
           alarm: float) -> Vibration | None:
    """The lines of one choice of stretches."""
    if not stretches:
        return None
    step = dwells.period / FINER
    place = np.rint((dwells.first_s[:, None] + dwells.period * np.arange(samples.shape[1])) / step).astype(np.int64)
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
        course = np.bincount(at - at.min(), samples[rows].ravel(), size)
        p[:] = np.abs(fft.rfft(course)[usable]) ** 2 / (len(rows) * seen)
    level = np.median(power, axis=1, keepdims=True)  # the farther the mirror, the more air
    power /= level
    floor = _floor(power.mean(axis=0), block, len(stretches))
    evidence = _evidence(power / floor, counts) - np.log(len(usable) / 2.0) - 1.0
    chosen: list[int] = []
    free = np.ones(len(usable), bool)
    while len(chosen) < MOST_LINES and free.any():
        k = int(np.argmax(np.where(free, evidence, -np.inf)))
        if chosen and evidence[k] < alarm:
            break
        chosen.append(k)
        free &= np.abs(hertz - hertz[k]) > 1.0 / dwells.length  # nearer ones are the same line's side lobes
    noise = level * floor[chosen]
    over = level * power[:, chosen] - noise
    weight = counts.sum() * seen[chosen] / 2.0
    strength = np.maximum(over.sum(axis=0), 0.0) / weight
    spread = np.sqrt(np.sum(noise**2 + 2.0 * noise * np.maximum(over, 0.0), axis=0)) / weight
    amplitude = float(np.sqrt(2.0 * strength[0]))
    wave = np.exp(-2j * np.pi * hertz[chosen[0]] * step * place)
    swing, far = np.sum(samples * wave, axis=1), np.where(np.isfinite(path), path, 0.0)
    weighted = np.array([abs(far[rows] @ swing[rows]) ** 2 / max(far[rows] @ far[rows], 1e-300) for rows in stretches])
    weighted /= level[:, 0] * floor[chosen[0]] * seen[chosen[0]]
    alike = _evidence(power[:, chosen[:1]] / floor[chosen[0]], counts)
    grown = _evidence(weighted[:, None], counts)
    by_dwell = np.zeros(len(samples))
    for rows, excess, count in zip(stretches, over[:, 0], counts, strict=True):
        by_dwell[rows] = excess / count
    return Vibration(float(hertz[chosen[0]]), amplitude, float(spread[0]) / max(amplitude, 1e-300),
                     float(min(evidence[chosen[0]], 1e4)),
                     float(min(strength.sum() * samples.size / max(np.sum(dwells.values**2), 1e-300), 1.0)),
                     tuple(hertz[chosen].tolist()), tuple(strength.tolist()), True, float((grown - alike)[0]), by_dwell,
                     1.0 / dwells.period)


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
