"""Scatter that the noise of the log does not explain: a cause without a pattern.

Something may shake a reading now and then or make one channel, axis or stretch of the log noisier than
the repeats foretell, without any form to fit.  What the diagnosis leaves is compared with its noise, group
by group, and its tails with those of the normal distribution.
"""

import numpy as np
from scipy import stats

from stepdiag_ros.gap.evidence import log_mean
from stepdiag_ros.gap.joint import Joint, unexplained

TAIL = 4.5
"""Standard deviations beyond which a white residual is counted as an outlier."""
LEAST = 24
"""Fewest residuals of a group that is judged."""


SHARES = np.array([0.01, 0.03, 0.1, 0.3])
"""Shares of arrivals that may be off, all others being as good as the noise says …"""
SPREADS = np.logspace(0.3, 3.0, 12)
"""… and sizes, in standard deviations of an arrival, of what is off."""


def stray_arrivals(joint: Joint, rest: np.ndarray | None = None) -> tuple[float, str]:
    """Log evidence that a share of an axis's arrivals is off by a random amount, and the axis in words.

    Such an arrival has no pattern from stop to stop: each stop of the axis is one more unknown.  Its
    score in parity space is a standard normal, or for a share ``q`` of the stops one that is ``s`` times as
    wide; that mixture, one-sided or not, is weighed against noise alone, averaged over q and s.
    ``rest`` (N,): white residuals to judge, else what the active effects leave.
    """
    space, view = joint.parity, joint.observation.view
    rest = unexplained(space, joint.active) if rest is None else rest
    data = rest[:space.stops]
    worst = (0.0, '')
    for axis, letter in enumerate('XYZ'):
        mine = np.flatnonzero((view.axis == axis) & (view.approach[:, axis] != 0))
        if len(mine) < LEAST:
            continue
        columns = np.zeros((len(mine), *view.reading.shape))
        columns[np.arange(len(mine)), mine] = \
            view.by_shift[axis][mine] * view.approach[mine, axis, None]
        # Of one stop only: where the fit or a neighbour could have done it as well, it counts less.
        projected = space.stop_part(columns)
        norm = np.linalg.norm(projected, axis=0)
        seen = norm > 0.3 * np.linalg.norm(space.white_part(columns), axis=0)
        if seen.sum() < LEAST:
            continue
        score = projected[:, seen].T @ data / norm[seen]
        # The level of the quiet majority is the noise: what is off must stand out from it.
        score = score / max(1.0, float(np.median(np.abs(score))) / 0.6745)
        for side, words in ((0.0, 'either way'), (-1.0, 'short'), (1.0, 'too far')):
            evidence = _mixture(score, side)
            worst = max(worst, (evidence - np.log(9.0),
                                f'arrivals of {letter} are now and then {words} by a random amount'))
    return worst


def _mixture(score: np.ndarray, side: float) -> float:
    """Log evidence of a wide part in normal scores, two-sided (0) or of one sign."""
    wide = SPREADS**2
    ratio = -0.5 * np.log1p(wide)[:, None] + 0.5 * (wide / (1.0 + wide))[:, None] * score**2
    if side:
        ratio = ratio + np.log(2.0) + stats.norm.logcdf(
            side * score * np.sqrt(wide / (1.0 + wide))[:, None])
    logs = np.logaddexp(np.log1p(-SHARES)[:, None, None], np.log(SHARES)[:, None, None] + ratio)
    return log_mean(logs.sum(axis=2).ravel())


def excess_scatter(joint: Joint) -> tuple[float, str]:
    """Log evidence for more scatter than noise in the worst group, and that group in words."""
    space, table = joint.parity, joint.observation.table
    rest = unexplained(space, joint.active)
    beams = joint.fit.model.beams
    worst: list[tuple[float, str]] = [(0.0, ''), stray_arrivals(joint, rest)]
    for part, what, dof in ((slice(0, space.stops), 'the stops', space.dof[0]),
                            (slice(space.stops, None), 'the samples inside the dwells', space.dof[1])):
        values, channel, row = rest[part], space.channel[part], space.row[part]
        if len(values) < LEAST:
            continue
        free = dof / len(values)
        groups = {}
        for c in range(beams + 2):
            name = 'displacement' if c < beams else ('spot_x', 'spot_y')[c - beams]
            mine = channel == c
            groups[f'{name} at {what}'] = mine
            for setup, label in enumerate(table.setup_names):
                groups[f'{name} at {what} of {label}'] = mine & (table.setup[row] == setup)
            for axis, label in enumerate('XYZ'):
                groups[f'{name} at {what} after moves of {label}'] = mine & (table.axis[row] == axis)
            for direction, label in ((1, 'forward'), (-1, 'backward')):
                groups[f'{name} at {what} going {label}'] = mine & (table.direction[row] == direction)
        price = np.log(len(groups))
        for label, mine in groups.items():
            count = float(mine.sum())
            if count < LEAST:
                continue
            square = float(np.sum(values[mine] ** 2))
            ratio = square / (count * min(free, 1.0))
            gain = 0.5 * count * free * (ratio - 1.0 - np.log(ratio)) if ratio > 1.0 else 0.0
            worst.append((gain - price, f'{label} scatter {np.sqrt(ratio):.2f} times as much as noise'))
            outliers = float(np.sum(np.abs(values[mine]) > TAIL))
            expected = max(2.0 * stats.norm.sf(TAIL) * count, 0.05)
            if outliers > expected:
                worst.append((outliers * np.log(outliers / expected) - (outliers - expected) - price,
                              f'{label}: {int(outliers)} of {int(count)} lie beyond {TAIL} σ'))
    return max(worst)
