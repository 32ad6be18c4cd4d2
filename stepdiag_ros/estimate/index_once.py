"""Whether lengths were divided by the index of air once: twice, or never, all positioning errors grow by n − 1 alike.

Readings of which an instrument has taken the index out, while its messages say 1.0, are divided again; one that takes
none out, while its messages bear the index, is believed.  A machine whose scales are all wrong by the same 2.7e-4 in X,
Y and Z is as good as none; a warm one (24 K on steel) is possible, so that this is a remark and no verdict.
"""

import numpy as np

from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.model.machine import AXES

NEAR = 0.25
"""Share of n − 1 within which every axis must come to it: machines are right to some 50 µm/m."""


def divided_otherwise(solution: Solution, index: float) -> list[str]:
    """A remark where the positioning errors of two or three axes all grow by about ±(``index`` − 1); none elsewhere."""
    excess, slopes = index - 1.0, []
    for letter in AXES:
        name = f'E{letter}{letter}'
        if not solution.has(name) or len(solution.positions[name]) < 2:
            continue
        place, value, sigma = solution.curve(name)
        way = place[-1] - place[0]
        if sigma[-1] > NEAR / 2.0 * excess * way:
            return []
        slopes.append((value[-1] - value[0]) / way)
    if len(slopes) < 2 or excess <= 0.0:
        return []
    mean = float(np.mean(slopes))
    if np.max(np.abs(np.array(slopes) - np.copysign(excess, mean))) > NEAR * excess:
        return []
    how = 'not divided out' if mean > 0.0 else 'divided out twice'
    return [f'positioning grows by {1e6 * mean:+.0f} µm/m along all axes alike, as it would were the index of air '
            f'({1e6 * excess:.0f}e-6) {how}: check that refractive_index of interferometer/displacement is what the '
            'instrument divides by (1.0: by nothing)']
