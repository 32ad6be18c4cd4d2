"""Arrivals that come to one of two states: a loose mirror that leans to either side, an axis with two rests.

Errors of arrivals have one middle, however heavy their tails and whatever goes on from one to the next.  Where they
gather about two, something snaps to and fro, at random and so without a pattern.  The errors' scores, white and one for
each arrival, are held against a mixture of two normal distributions of one width.
"""

from dataclasses import replace

import numpy as np

from stepdiag_ros.estimate.eigen import eigen
from stepdiag_ros.estimate.enhanced import readings_of
from stepdiag_ros.estimate.noise import Law
from stepdiag_ros.estimate.noise_law import latents
from stepdiag_ros.gap.inference.joint import Joint, freed
from stepdiag_ros.gap.inference.parity import projection
from stepdiag_ros.gap.noise.scatter import LEAST

SEEN = 0.05
"""Share of an arrival's error that the fit must leave, for it to count."""
SWEEPS = 60
"""Steps of the EM algorithm."""
WHAT = ("the mirror's angle", "an axis's error of X", "an axis's error of Y", "an axis's error of Z")


def two_states(joint: Joint) -> tuple[float, str]:
    """Log evidence that arrivals come to two states, and of what, in words."""
    observation = joint.observation
    noise = replace(joint.noise, position_law=Law(), angle_law=Law(), spread=None)
    white, basis, data, _ = projection(observation, observation.fit, noise,
                                       readings_of(freed(observation.table, joint.active)))
    turns, axes = [], {axis: [] for axis in range(3)}
    for latent in latents(observation.table, noise, observation.fit.arrival, white):
        lost = latent.columns.T @ basis[latent.at]
        seen = np.maximum(np.sum(latent.columns**2, axis=0) - np.sum(lost**2, axis=1), 1e-12)
        score = np.where(seen > SEEN, latent.columns.T @ data[latent.at] / np.sqrt(seen), np.nan)
        turns.append(np.stack([score[latent.source == 0], score[latent.source == 1]], axis=1))
        for axis, own in axes.items():
            own.append(score[latent.source == 2 + axis])
    both = np.concatenate(turns)
    both = both[np.isfinite(both).all(axis=1)]
    # What leans does so about one line in the mirror's mount.
    along = both @ eigen(both.T @ both)[1][:, -1] if len(both) else np.zeros(0)
    found = [along, *(np.concatenate(own) for own in axes.values())]
    evidence = [_two_rather_than_one(score[np.isfinite(score)]) for score in found]
    best = int(np.argmax(evidence))
    return evidence[best] - float(np.log(len(WHAT))), f'{WHAT[best]} at each arrival is one of two, at random'


def _two_rather_than_one(score: np.ndarray) -> float:
    """Log evidence of two middles against one: by the likelihoods, less half the logarithm of their number for each of
    two further parameters."""
    if len(score) < LEAST:
        return 0.0
    spread = float(np.std(score))
    if spread == 0.0:
        return 0.0
    z = (score - score.mean()) / spread
    one = -0.5 * float(z @ z)
    share, low, high, width = 0.5, -0.8, 0.8, 0.6
    for _ in range(SWEEPS):
        first = np.log(share) - 0.5 * ((z - low) / width)**2
        second = np.log(1.0 - share) - 0.5 * ((z - high) / width)**2
        both = np.logaddexp(first, second)
        mine = np.exp(first - both)
        share = float(np.clip(mine.mean(), 0.02, 0.98))
        low, high = (float(w @ z / w.sum()) for w in (mine, 1.0 - mine))
        width = max(float(np.sqrt(np.mean(mine * (z - low)**2 + (1.0 - mine) * (z - high)**2))), 0.05)
    return float(np.sum(both)) - len(z) * float(np.log(width)) - one - float(np.log(len(z)))
