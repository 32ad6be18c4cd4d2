"""Tests band by band: by channel and by frequency, along the path and in time.

One global χ² hides what is narrow and calls many small things one.  Each octave of half waves is a test of its
own: cosines along the path of each setup, alike or opposite in the two directions, and cosines in the time of the
log, brought into parity space, so that what machine, set-up and resets can imitate counts for nothing.  With columns Z
of rank k of one band, in data z that are white where nothing is wrong,

    Q = zᵀZ (ZᵀZ)⁺ Zᵀz,      Q/k ~ F(k, ν),

ν the degrees of freedom by which the repeats tell the noise.  The same of what the effects named leave says
in which bands they do their work.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from stepdiag_ros.estimate.eigen import eigen
from stepdiag_ros.gap.inference.joint import Joint, unexplained
from stepdiag_ros.gap.preprocess.observe import channels

MOST_WAVES = 256
"""Half waves in the time of a log up to which its bands go: in a log of more than 500 stops what is faster is scatter
from stop to stop, which is tested as such."""
ALPHA = 1e-3
"""Probability that any band of a log without a gap stands out, divided over all of them."""
SEEN = 1e-4
"""Directions of which less than this share of the variance is left beside the fit are no test."""


@dataclass(frozen=True)
class Band:
    """``channel`` along a ``setting``, 'path' [m], 'reversal' [m] (of the path, opposite in the two directions) or
    'time' [s]: periods from ``shortest`` to ``longest``; mean squares of ``count`` directions ``before`` and ``after``
    the effects, 1: noise; ``p`` that noise alone makes so much before, ``stands_out`` among all bands."""

    channel: str
    setting: str
    shortest: float
    longest: float
    count: int
    before: float
    after: float
    p: float
    stands_out: bool = False

    @property
    def unit(self) -> str:
        """Unit of the periods."""
        return 's' if self.setting == 'time' else 'm'

    def to_json_dict(self) -> dict:
        return {'channel': self.channel, 'along': self.setting, f'period_from_{self.unit}': self.shortest,
                f'period_to_{self.unit}': self.longest, 'directions': self.count, 'mean_square_before': self.before,
                'mean_square_after': self.after, 'p': self.p, 'stands_out': self.stands_out}


def bands(joint: Joint) -> tuple[Band, ...]:
    """Every band of a joint fit that the log can show."""
    space = joint.parity
    data, rest = space.data[:space.stops], unexplained(space, joint.active)[:space.stops]
    found = []
    for setting, shortest, longest, waves in (*_along_the_path(joint), *_in_time(joint)):
        for channel, columns in channels(joint.fit.model.beams).items():
            patterns = joint.observation.view.zeros(len(waves))
            patterns[:, :, columns] = waves[:, :, None]
            patterns = np.where(joint.fit.present, patterns, 0.0)
            white = space.white_part(patterns, resets=True)
            white /= np.maximum(np.linalg.norm(white, axis=0), 1e-300)
            for one, rows in zip(space.projection.white, space.projection.runs, strict=True):
                white[rows] = one.without(white[rows])
            absorbed = space.projection.absorbed(white)
            value, vector = eigen(white.T @ white - absorbed.T @ absorbed)
            keep = value > SEEN
            count = int(keep.sum())
            if not count:
                continue
            # The data are projected, so are products with them.
            before, after = (float(np.mean((vector[:, keep].T @ (white.T @ z))**2 / value[keep])) for z in (data, rest))
            freedom = joint.noise.dof[0 if channel == 'displacement' else 1]
            p = special.fdtrc(count, freedom, before) if freedom else special.chdtrc(count, before * count)
            found.append(Band(channel, setting, shortest, longest, count, before, after, float(p)))
    return tuple(replace(band, stands_out=band.p * len(found) < ALPHA) for band in found)


def _octaves(most: int) -> Iterator[np.ndarray]:
    """Numbers of half waves up to ``most``, octave by octave."""
    first = 1
    while first <= most:
        yield np.arange(first, min(2 * first, most + 1))
        first *= 2


def _along_the_path(joint: Joint) -> Iterator[tuple[str, float, float, np.ndarray]]:
    """Cosines along each setup's path, the same in all its passes or opposite in the two directions, there from a
    constant on: shortest and longest period [m], waves (k, n)."""
    view = joint.observation.view
    length, stops = 0.0, {}
    for setup in np.unique(view.setup):
        mine = view.setup == setup
        stops[setup] = len(np.unique(view.index[mine]))
        length = max(length, float(np.ptp(view.distance[mine, 0])))
    settings = [('path', np.ones(len(view.setup)), ())]
    if np.ptp(view.direction) > 0:
        settings.append(('reversal', view.direction, (0,)))
    for setting, sign, slowest in settings:
        for numbers in _octaves(max(stops.values()) - 1):
            waves = []
            for setup, count in stops.items():
                mine = view.setup == setup
                place = (view.index - view.index[mine].min() + 0.5) / count
                waves += [np.cos(np.pi * number * place) * sign * mine
                          for number in (*(slowest if numbers[0] == 1 else ()), *numbers) if number < count]
            yield setting, 2.0 * length / float(numbers[-1]), 2.0 * length / float(numbers[0]), np.array(waves)


def _in_time(joint: Joint) -> Iterator[tuple[str, float, float, np.ndarray]]:
    """Cosines in the time of the log: shortest and longest period [s], waves (k, n)."""
    view = joint.observation.view
    span = max(float(np.ptp(view.time)), 1e-9)
    share = (view.time - view.time.min()) / span
    for numbers in _octaves(min(len(share) // 2, MOST_WAVES)):
        yield ('time', 2.0 * span / float(numbers[-1]), 2.0 * span / float(numbers[0]),
               np.cos(np.pi * numbers[:, None] * share))
