"""Scatter that the noise of the log does not explain: a cause without a pattern.

Something may shake a reading now and then or make one channel, axis or stretch of the log noisier than
the repeats foretell, without any form to fit.  What the diagnosis leaves is compared with its noise, group
by group, and its tails with those of the normal distribution.
"""

import numpy as np
from scipy import stats

from stepdiag_ros.gap.joint import Joint, unexplained

TAIL = 4.5
"""Standard deviations beyond which a white residual is counted as an outlier."""
LEAST = 24
"""Fewest residuals of a group that is judged."""


def excess_scatter(joint: Joint) -> tuple[float, str]:
    """Log evidence for more scatter than noise in the worst group, and that group in words."""
    space, table = joint.parity, joint.observation.table
    rest = unexplained(space, joint.active)
    beams = joint.fit.model.beams
    worst: list[tuple[float, str]] = [(0.0, '')]
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
