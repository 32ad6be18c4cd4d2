"""Knocks: a few dwells in which a reading moves far more than in all others, slowly and at no frequency.

Noise, however much its samples are alike, moves in every dwell about as much: the power of a dwell's slow half waves is
that of some degrees of freedom, a gamma distribution whose shape and level the log tells.  A press in the next bay, a
supply that gives way for a second, a door: a share of the dwells has a multiple of that.  The two are weighed against
each other, averaged over what either leaves open.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from stepdiag_ros.gap.constants import KNOCKS_ALARM
from stepdiag_ros.gap.inference.evidence import log_mean
from stepdiag_ros.gap.preprocess.dwells import LEAST_DWELLS, Dwells

SHAPES = np.geomspace(0.5, 60.0, 24)
"""Half the degrees of freedom that the power of a dwell may have."""
LEVELS = np.geomspace(0.5, 1.25, 10)
"""Its level in the other dwells, in times of the median …"""
TIMES = np.array([3.0, 6.0, 12.0, 25.0, 50.0, 100.0])
"""… by how many times more than that knocked ones have …"""
SHARES = np.array([0.01, 0.02, 0.05, 0.1, 0.2, 0.3])
"""… and how many of the dwells these are: what happens in more of them is no knock."""
LEAST_POWER = 1e-3
"""Of the median: in steps, a reading may not move at all."""


@dataclass(frozen=True)
class Knocks:
    """``share`` of the dwells in which the ``channel`` moves by some ``size`` [m], root mean square; ``log_bayes``:
    log evidence against noise that moves alike in all of them."""

    channel: str
    share: float
    size: float
    log_bayes: float

    @property
    def words(self) -> str:
        return (f'{self.channel}: now and then it moves inside a dwell, in about {100.0 * self.share:.0f} % of them '
                f'by some {self.size * 1e6:.2g} µm, as a knock from the floor or a supply that gives way would make it')


def knocks(channels: Mapping[str, Dwells | None], known: Collection[int]) -> Knocks | None:
    """Knocks in the dwells of that of some ``channels`` which shows them best, but for those of the stops ``known`` to
    hold something else; None where noise explains as much."""
    found = []
    for name, dwells in channels.items():
        if dwells is not None:
            # Between samples that are far off a straight line is a slow swing.
            kept = dwells.whole & ~np.isin(dwells.rows, list(known))
            if kept.sum() >= LEAST_DWELLS:
                found.append(_in_channel(name, replace(dwells, values=dwells.values[kept])))
    best = max(found, key=lambda one: one.log_bayes, default=None)
    return best if best is not None and best.log_bayes - np.log(len(channels)) > KNOCKS_ALARM else None


def _in_channel(name: str, dwells: Dwells) -> Knocks:
    power, fast, _ = dwells.slow_and_fast()
    middle = max(float(np.median(power)), 1e-300)
    # Tails of single samples are as loud in the fast half waves.
    power = power / np.maximum(fast / max(float(np.median(fast)), 1e-300), 1.0)
    power = np.maximum(power / middle, LEAST_POWER)
    shape, level = SHAPES[:, None, None], LEVELS[:, None]

    def logs(times: float) -> np.ndarray:
        """ln p (a, l, K) of the dwells' powers, had all of them ``times`` the level."""
        scale = times * level / shape
        return (shape - 1.0) * np.log(power) - power / scale - shape * np.log(scale) - special.gammaln(shape)

    plain, loud = logs(1.0), [logs(times) for times in TIMES]
    mixed = np.array([[np.sum(np.logaddexp(np.log1p(-share) + plain, np.log(share) + one), axis=-1)
                       for share in SHARES] for one in loud])
    times, share, *_ = np.unravel_index(int(np.argmax(mixed)), mixed.shape)
    size = np.sqrt(TIMES[times] * middle / len(dwells.basis))
    return Knocks(name, float(SHARES[share]), float(size),
                  log_mean(mixed.ravel()) - log_mean(np.sum(plain, axis=-1).ravel()))
