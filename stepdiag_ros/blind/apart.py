"""Could another effect of the vocabulary stand for the true one?  Judged without noise.

Of a log with one effect the same world is made again with and without it.  The change, in the
parity space of the undisturbed log and with the true noise, is fitted by every form in which each
competing effect may appear; what the best form leaves is what is there to tell the two apart, in
standard deviations.  Where some of them leaves less than a few, no diagnosis could be sure, and the
log does not count among the separable ones.
"""

import numpy as np

from stepdiag_ros.blind.world import SealedWorld
from stepdiag_ros.effects import all_effects
from stepdiag_ros.effects.base import Form
from stepdiag_ros.estimate.enhanced import readings_of
from stepdiag_ros.estimate.noise import NoiseModel, sensor_noise
from stepdiag_ros.gap.inference.parity import parity
from stepdiag_ros.gap.preprocess.observe import Observation, observe
from stepdiag_ros.model.description import Noise
from stepdiag_ros.twin.effect_check import left_by


def apart(made: SealedWorld, bare: Observation) -> dict[str, float]:
    """σ that the best form of each effect of the vocabulary leaves of the one that acts; ``bare``: without it."""
    changed = observe(made.smooth)
    true = Noise(**made.truth['noise'])
    noise = NoiseModel(true.position_repeatability, true.angle_repeatability,
                       sensor_noise(bare.table, true), 'belief')
    space = parity(bare, bare.fit, noise, readings_of(bare.table))
    change = Form('truth', np.nan_to_num(readings_of(changed.table) - readings_of(bare.table))[None],
                  ('size',), np.ones(1), inside=np.nan_to_num(changed.bins - bare.bins)[None])
    target = space.project(change)[:, 0]
    left = {}
    for name, kind in all_effects().items():
        rests = [left_by(target, space.project(form)) for form in kind().appearance(bare.view)]
        left[name] = float(min(rests, default=np.linalg.norm(target)))
    return left
