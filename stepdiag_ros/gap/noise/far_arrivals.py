"""Arrivals that are far off where errors have tails: how far tails can reach, and what they cannot be.

A law with tails takes whatever is off for noise.  Of errors with 2.5 degrees of freedom, the wildest that count as
noise, one in three thousand is thirty times as far off as they scatter, and one in ten million seven hundred times:
where more are that far off, or farther, than chance would have it, something is off and the law only says how far.
"""

from collections.abc import Iterator

import numpy as np
from scipy import special

from stepdiag_ros.estimate.enhanced import readings_of
from stepdiag_ros.gap.inference.joint import Joint, freed
from stepdiag_ros.gap.noise.arrival_law import DOFS

ALONE = 30.0
"""Times what arrivals scatter from which one that is off is spoken of."""
MOST_ALONE = 3
LEAST_CHANCE = 1e-300


def alone(joint: Joint) -> Iterator[str]:
    """What there is to say of single arrivals that are taken for tails, the farthest first."""
    if not joint.noise.has_tails:
        return
    times, source, stop = _far_off(joint)
    for k in np.flatnonzero(times > ALONE)[:MOST_ALONE]:
        yield (f'noise: {_where(joint, times[k], source[k], stop[k])}, {times[k]:.0f} times as far as arrivals '
               'scatter; it is weighed as one of their tails, and a lost count or a knock at that stop would look the '
               'same')


def beyond_tails(joint: Joint) -> tuple[float, str]:
    """By how many powers of e it is unlikely that tails reach so far so often, and which arrivals are off, in words.

    The k farthest of n beyond what the k-th of them is, for the k that says most, those that could say it counted.
    """
    if not joint.noise.has_tails:
        return 0.0, ''
    times, source, stop = _far_off(joint)
    number = np.arange(1, np.count_nonzero(times > ALONE) + 1)
    if not len(number):
        return 0.0, ''
    chance = 2.0 * special.stdtr(min(DOFS), -times[:len(number)])
    surprise = -np.log(np.maximum(special.bdtrc(number - 1, len(times), chance), LEAST_CHANCE))
    return (float(surprise.max() - np.log(len(number))),
            f'{len(number)} of {len(times)} arrivals are off by more than {ALONE:.0f} times what arrivals scatter, '
            f'which no noise does; the farthest: {_where(joint, times[0], source[0], stop[0])}')


def _far_off(joint: Joint) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How far (m,) arrivals are off, beyond what goes on from those before, in times of what they scatter; the farthest
    first; with their source and stop."""
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
    return times[order], source[order].astype(int), stop[order].astype(int)


def _where(joint: Joint, times: float, source: int, stop: int) -> str:
    table, noise = joint.observation.table, joint.noise
    what, size, unit = ('the mirror', noise.angle, 'µrad') if source < 2 else ('XYZ'[source - 2], noise.position, 'µm')
    return (f'{what} is off by {1e6 * times * size:.3g} {unit} at {table.run_ids[table.run[stop]]} stop '
            f'{table.index[stop]}')
