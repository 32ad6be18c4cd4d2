"""Lost motion in a volumetric figure: a place of the volume is reached from either side by each axis.

The 21 errors are the mean of both directions of approach.  With lost motion b of an axis the tool stands half of it to
one side or the other, so that the deviation d of a place is d + Σ ± b/2 along the axes, and its size that of the worst
of all these: the length of (|d_x| + |b_x|/2, |d_y| + |b_y|/2, |d_z| + |b_z|/2).
"""

from collections.abc import Mapping
from itertools import product

import numpy as np

from stepdiag_ros.model.machine import AXES

Reversal = Mapping[str, tuple[float, float]]
"""Lost motion and its U (k = 2) [m] by the axis's letter."""
NONE: Reversal = {}


def standing_out(reversal: Reversal) -> Reversal:
    """Those that are larger than their U."""
    return {axis: (value, spread) for axis, (value, spread) in reversal.items() if abs(value) > spread}


def half(reversal: Reversal) -> np.ndarray:
    """Half the lost motion of X, Y, Z (3,) [m], never negative."""
    return np.array([0.5 * abs(reversal.get(letter, (0.0, 0.0))[0]) for letter in AXES])


def half_drawn(reversal: Reversal, normals: np.ndarray) -> np.ndarray:
    """The same for lost motions drawn from what is known of them, by standard normals (3, n)."""
    known = np.array([reversal.get(letter, (0.0, 0.0)) for letter in AXES])
    return 0.5 * np.abs(known[:, :1] + 0.5 * known[:, 1:] * normals)


def sizes(deviation: np.ndarray, reversal: Reversal) -> np.ndarray:
    """Size of deviations (n, 3) [m] from the worst side (n,) [m]."""
    return np.linalg.norm(np.abs(deviation) + half(reversal), axis=1)


def sides(reversal: Reversal) -> np.ndarray:
    """All sums of half lost motions (sides, 3) [m] by which a place may be missed; one of zeros where there is none."""
    return np.array(list(product(*((own, -own) if own else (0.0,) for own in half(reversal)))))
