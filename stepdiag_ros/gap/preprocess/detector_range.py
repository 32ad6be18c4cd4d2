"""Spots beyond the range in which a bending detector can be read.

A detector whose response bends, ``read = s (1 + k₁ s₁² + k₂ s₂²)`` in each axis, grows ever less with the spot
until it turns back: two spots then read alike, and a fit that does not know it takes the nearer one.  No
small correction at the fit mends that.  Along a run the true spot of a mirror that hangs askew moves on a straight
line, evenly with the distance; where lines seen through one bent detector follow the readings of all diagonals and
lines alone do not, the detector is known well enough to leave out what it read where it was bent hard.  What it was
bent by is found afterwards, as for any other log, from the readings that are kept.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stepdiag_ros.gap.constants import LARGE_RESIDUAL
from stepdiag_ros.gap.preprocess.observe import Observation, sane_fit, view_of

UNIT = 1e-3
"""Spots are reckoned in this [m]."""
HARDEST = 0.03
"""Bending at one unit from the centre that no detector exceeds (the range of psd_nonlinearity)."""
TRIED = 16
"""Bendings that the search begins at, from a hundredth of the hardest on."""
STRAIGHTER = 0.25
"""Lines through a bent detector must leave less than this share of what lines alone leave."""
HARD = 0.4
"""By how much the slope of the response may differ from that at the centre, to be read."""
SHARES = (0.15, 0.3, 0.6, 1.0)
"""Shares of a setup's readings, from either end, through which a line is begun."""
LEAST_PLACES = 6
"""Places of a setup from which a line and a bending can be distinguished."""


@dataclass(frozen=True)
class Bent:
    """A detector's response: each axis bends with its own square by ``own``, with the other's by ``cross`` [1/mm²];
    ``spots`` (n, 2) [mm]: where the beam truly lay by the lines through it, NaN in setups without a line."""

    own: float
    cross: float
    spots: np.ndarray

    @property
    def reach(self) -> float:
        """Distance from the centre [mm] at which the slope has changed by ``HARD``."""
        return float(np.sqrt(HARD / (3.0 * max(abs(self.own), abs(self.cross)))))


def within_range(observation: Observation) -> tuple[Observation, str]:
    """The observation without spots that were read where the detector is bent hard, and words that say so.

    The same observation and '' where the fit leaves nothing large, or what it leaves is no such detector's.
    """
    table, fit = observation.table, observation.fit
    left = fit.residual[:, -2:] / fit.noise.sensor[:, -2:]
    if np.isnan(left).all() or np.sqrt(np.nanmean(left**2)) <= LARGE_RESIDUAL:
        return observation, ''
    bent = bent_by(table.setup, observation.view.distance.mean(axis=1), table.spot / UNIT)
    if bent is None:
        return observation, ''
    out = _beyond(bent, table.setup, table.spot / UNIT)
    if not out.any():
        return observation, ''
    table = replace(table, spot=np.where(out[:, None], np.nan, table.spot))
    bins = observation.bins.copy()
    bins[out, :, -2:] = np.nan
    result = sane_fit(observation.log, table)
    view = view_of(observation.log, table, result, observation.view.bin_time)
    words = (f'the spot of {out.sum()} of {len(out)} stops is left out: it lay more than {bent.reach:.2g} mm from the '
             'centre of the position sensor, where its reading bends so hard that it no longer tells where')
    return replace(observation, table=table, fit=result, view=view, bins=bins), words


def bent_by(setup: np.ndarray, distance: np.ndarray, read: np.ndarray) -> Bent | None:
    """The bent detector through which the spots ``read`` (n, 2) [mm] lie on a line in each setup, evenly with the
    ``distance`` (n,) [m]; None where lines alone follow them nearly as well."""
    good = np.isfinite(read).all(axis=1)
    groups = [rows for s in np.unique(setup) if len(rows := np.flatnonzero((setup == s) & good))
              and len(np.unique(np.round(distance[rows], 2))) >= LEAST_PLACES]
    if not groups:
        return None
    used = np.concatenate(groups)
    bases = [np.column_stack([np.ones(len(rows)), distance[rows] - distance[rows].mean()]) for rows in groups]

    def spots(lines: np.ndarray) -> np.ndarray:
        return np.concatenate([basis @ line for basis, line in zip(bases, lines.reshape(-1, 2, 2), strict=True)])

    def left(unknowns: np.ndarray) -> np.ndarray:
        return (_response(spots(unknowns[2:]), *unknowns[:2] * HARDEST) - read[used]).ravel()

    def slopes(unknowns: np.ndarray) -> np.ndarray:
        own, cross = unknowns[:2] * HARDEST
        lay = spots(unknowns[2:])
        result = np.zeros((*read[used].shape, len(unknowns)))
        result[:, :, 0], result[:, :, 1] = lay**3 * HARDEST, lay * lay[:, ::-1] ** 2 * HARDEST
        start = 0
        for k, basis in enumerate(bases):
            rows = slice(start, start + len(basis))
            start = rows.stop
            result[rows, :, 2 + 4 * k:6 + 4 * k] = _slopes(basis, lay[rows], own, cross)
        return result.reshape(-1, len(unknowns))

    lines = [np.linalg.lstsq(basis, read[rows], rcond=None)[0] for basis, rows in zip(bases, groups, strict=True)]
    straight = np.sum(left(np.concatenate([[0.0, 0.0], np.ravel(lines)]))**2)
    # A line through any such detector reads as a cubic in the distance: no bending leaves less than cubics do.
    if _cubics(distance, read, groups) > STRAIGHTER**2 * straight:
        return None
    best = None
    for size in -np.geomspace(0.01, 1.0, TRIED):
        begin = [_line(basis, read[rows], size * HARDEST) for basis, rows in zip(bases, groups, strict=True)]
        found = _fit(left, np.concatenate([[size, size], np.ravel(begin)]), slopes, 200)
        if -1.0 <= found.x[0] < 0.0 and abs(found.x[1]) <= 1.0 and (best is None or found.cost < best.cost):
            best = found
    if best is None or 2.0 * best.cost > STRAIGHTER**2 * straight:
        return None
    lay = np.full(read.shape, np.nan)
    lay[used] = spots(best.x[2:])
    return Bent(*(float(k) for k in best.x[:2] * HARDEST), lay)


def _cubics(distance: np.ndarray, read: np.ndarray, groups: list[np.ndarray]) -> float:
    """What is left, squared, of the ``read`` spots (n, 2) of all groups by cubics in the ``distance`` (n,) of each."""
    total = 0.0
    for rows in groups:
        far = distance[rows] - distance[rows].mean()
        basis, _ = np.linalg.qr(np.vander(far / max(np.abs(far).max(), 1e-12), 4))
        total += float(np.sum((read[rows] - basis @ (basis.T @ read[rows]))**2))
    return total


def _response(spot: np.ndarray, own: float, cross: float) -> np.ndarray:
    """What the detector reads (n, 2) of spots (n, 2) [mm]."""
    square = spot**2
    return spot * (1.0 + own * square + cross * square[:, ::-1])


def _slopes(basis: np.ndarray, spot: np.ndarray, own: float, cross: float) -> np.ndarray:
    """Derivatives (n, 2, 4) of what is read of spots (n, 2) by the line (2, 2) on ``basis`` (n, 2) that they lie on."""
    square = spot**2
    by_spot = np.zeros((len(spot), 2, 2))
    for k in (0, 1):
        by_spot[:, k, k] = 1.0 + 3.0 * own * square[:, k] + cross * square[:, 1 - k]
        by_spot[:, k, 1 - k] = 2.0 * cross * spot[:, 0] * spot[:, 1]
    return np.einsum('nkx,nb->nkbx', by_spot, basis).reshape(len(spot), 2, 4)


def _line(basis: np.ndarray, read: np.ndarray, bending: float) -> np.ndarray:
    """The line (2, 2) of spots that follows the readings of a setup best through a detector bent by ``bending``.

    Begun through the readings next to either end, few or many, as if they lay before the turn.
    """
    radius = np.linalg.norm(read, axis=1)
    curve = np.linspace(0.0, 1.0 / np.sqrt(3.0 * abs(bending)), 200)
    unbent = np.interp(radius, curve * (1.0 + bending * curve**2), curve)
    near = read * (unbent / np.maximum(radius, 1e-12))[:, None]

    def left(line: np.ndarray) -> np.ndarray:
        return (_response(basis @ line.reshape(2, 2), bending, bending) - read).ravel()

    def slopes(line: np.ndarray) -> np.ndarray:
        return _slopes(basis, basis @ line.reshape(2, 2), bending, bending).reshape(-1, 4)

    order, found = np.argsort(basis[:, 1]), []
    for share in SHARES:
        count = max(round(share * len(read)), 2)
        for rows in (order[:count], order[-count:]):
            line = np.linalg.lstsq(basis[rows], near[rows], rcond=None)[0]
            found.append(_fit(left, line.ravel(), slopes, 50))
    return min(found, key=lambda one: one.cost).x.reshape(2, 2)


def _beyond(bent: Bent, setup: np.ndarray, read: np.ndarray) -> np.ndarray:
    """Whether each stop's spot (n,) lies where the detector is bent hard.

    In a setup without a line a reading far out casts doubt on all: nothing says on which branch they are.
    """
    far = np.linalg.norm(bent.spots, axis=1) > bent.reach
    limit = bent.reach * (1.0 - HARD / 3.0)
    for s in np.unique(setup):
        rows = setup == s
        if np.isnan(bent.spots[rows]).all():
            far[rows] = np.any(np.linalg.norm(read[rows], axis=1) > limit)
    return far & np.isfinite(read).all(axis=1)


def _fit(left: Callable[[np.ndarray], np.ndarray], begin: np.ndarray, slopes: Callable[[np.ndarray], np.ndarray],
         most: int) -> Any:
    """Least squares of ``left`` from ``begin`` on, by Levenberg and Marquardt, with at most so many evaluations."""
    from scipy.optimize import least_squares  # slow to import, and most logs have nothing to fit here
    return least_squares(left, begin, slopes, method='lm', max_nfev=most)
