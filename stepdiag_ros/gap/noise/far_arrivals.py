"""Arrivals that are far off where errors have tails: how far tails can reach, and what they cannot be.

A law with tails takes whatever is off for noise.  Of errors with 2.5 degrees of freedom, the wildest that count as
noise, one in three thousand is thirty times as far off as they scatter, and one in ten million seven hundred times:
where more are that far off, or farther, than chance would have it, something is off and the law only says how far.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import special

from stepdiag_ros.estimate.enhanced import readings_of
from stepdiag_ros.gap.inference.joint import Joint, freed
from stepdiag_ros.gap.noise.arrival_law import DOFS

ALONE = 30.0
"""Times what arrivals scatter from which one that is off is spoken of."""
MOST_ALONE = 3
LEAST_CHANCE = 1e-300


@dataclass(frozen=True)
class FarArrivals:
    """Arrivals of a joint fit by how far they are off, beyond what goes on from those before, in ``times`` (m,) of what
    they scatter, the farthest first, with their ``source`` and ``stop`` (m,); none where errors have no tails."""

    joint: Joint
    times: np.ndarray
    source: np.ndarray
    stop: np.ndarray

    @classmethod
    def of(cls, joint: Joint) -> 'FarArrivals':
        if not joint.noise.has_tails:
            return cls(joint, np.zeros(0), np.zeros(0, int), np.zeros(0, int))
        table, noise, space = joint.observation.table, joint.noise, joint.parity.projection
        rows = []
        for errors in space.errors(space.data(readings_of(freed(table, joint.active)))):
            source = errors.latent.source
            stop = np.array([stops[0] for stops in errors.latent.stops], int)
            own = errors.mean * (1.0 if noise.spread is None else noise.spread[source, stop])
            correlation = np.where(source < 2, noise.angle_law.correlation, noise.position_law.correlation)
            follows = np.concatenate([[False], source[1:] == source[:-1]])
            before = np.where(follows, correlation * np.roll(own, 1), 0.0)
            fresh = (own - before) / np.sqrt(np.where(follows, 1.0 - correlation**2, 1.0))
            rows.append(np.stack([np.abs(fresh), source, stop]))
        times, source, stop = np.concatenate(rows, axis=1)
        order = np.argsort(-times)
        return cls(joint, times[order], source[order].astype(int), stop[order].astype(int))

    def alone(self) -> Iterator[str]:
        """What there is to say of single ones that are taken for tails."""
        for k in np.flatnonzero(self.times > ALONE)[:MOST_ALONE]:
            yield (f'noise: {self._where(k)}, {self.times[k]:.0f} times as far as arrivals scatter; it is weighed as '
                   'one of their tails, and a lost count or a knock at that stop would look the same')

    def beyond_tails(self) -> tuple[float, str]:
        """By how many powers of e it is unlikely that tails reach so far so often, and which are off, in words.

        The k farthest of n beyond what the k-th of them is, for the k that says most, those that could say it counted.
        """
        number = np.arange(1, np.count_nonzero(self.times > ALONE) + 1)
        if not len(number):
            return 0.0, ''
        chance = 2.0 * special.stdtr(min(DOFS), -self.times[:len(number)])
        surprise = -np.log(np.maximum(special.bdtrc(number - 1, len(self.times), chance), LEAST_CHANCE))
        return (float(surprise.max() - np.log(len(number))),
                f'{len(number)} of {len(self.times)} arrivals are off by more than {ALONE:.0f} times what arrivals '
                f'scatter, which no noise does; the farthest: {self._where(0)}')

    def _where(self, k: int) -> str:
        table, noise, stop = self.joint.observation.table, self.joint.noise, self.stop[k]
        what, size, unit = ('the mirror', noise.angle, 'µrad') if self.source[k] < 2 \
            else ('XYZ'[self.source[k] - 2], noise.position, 'µm')
        return (f'{what} is off by {1e6 * self.times[k] * size:.3g} {unit} at {table.run_ids[table.run[stop]]} stop '
                f'{table.index[stop]}')
