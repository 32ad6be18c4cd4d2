"""Arrivals that come to one of two states: a loose mirror that leans to either side, an axis with two rests.

Errors of arrivals have one middle, however heavy their tails and whatever goes on from one to the next.  Where they
gather about two, something snaps to and fro, at random and so without a pattern.  The errors' scores, white and one for
each arrival, are held against a mixture of two distributions of one width and one kind of tails.  What stays in a state
for a while is blurred by that: a fit takes the mean of each run.  Its steps from one arrival to the next are not, for
they are none, one way, or back: three middles, the outer ones as far to either side.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaln, ndtr

from stepdiag_ros.estimate.eigen import eigen
from stepdiag_ros.estimate.enhanced import readings_of
from stepdiag_ros.gap.constants import SUSPICION
from stepdiag_ros.gap.inference.joint import Joint, freed
from stepdiag_ros.gap.noise.arrival_law import made_tidy
from stepdiag_ros.gap.noise.scatter import LEAST

SEEN = 0.05
"""Share of an arrival's error that the fit must leave, for it to count."""
SWEEPS, SETTLED = 60, 0.01
"""Most steps of the EM algorithm, which ends where one brings less log likelihood."""
LEAST_WIDTH = 0.02
"""Least width of a distribution, in standard deviations of all."""
TAILS = (3.0, 6.0, 12.0, 1e3)
"""Degrees of freedom that tails are tried with."""
FLAT = np.array([0.05, 0.1, 0.2, 0.3, 0.5, 0.7])
"""Blur of the ends of a flat distribution that are tried, in its standard deviation."""
LEAST_SHARE, LEAST_STEPS = 0.1, 0.02
"""A state that is come to more seldom, and steps that are, are outliers."""
START = (2.5, 0.3)
"""The step and the width, in standard deviations of all, from which the likeliest ones are looked for."""
LATTICE = np.arange(-3.0, 4.0)
"""Steps of what comes to rest at multiples of one length, an axis that turns by whole counts: no two states."""
WHAT = ("the mirror's angle", "an axis's error of X", "an axis's error of Y", "an axis's error of Z")


def two_states(joint: Joint) -> tuple[float, str]:
    """Log evidence that arrivals come to two states, and of what, in words."""
    space = made_tidy(joint.parity.projection)
    data = space.data(readings_of(freed(joint.observation.table, joint.active)))
    turns, axes = [], [[] for _ in range(3)]
    for latent, lost in space.latents():
        seen = np.maximum(np.sum(latent.columns**2, axis=0) - np.sum(lost**2, axis=0), 1e-12)
        score = np.where(seen > SEEN, latent.columns.T @ data[latent.at] / np.sqrt(seen), np.nan)
        turns.append(np.stack([score[latent.source == 0], score[latent.source == 1]], axis=1))
        for axis, own in enumerate(axes):
            own.append(score[latent.source == 2 + axis])
    evidence = []
    for runs in (_along(turns), *axes):
        score, steps = np.concatenate(runs), np.concatenate([np.diff(run) for run in runs])
        evidence.append(max(_two_rather_than_one(score[np.isfinite(score)]),
                            _to_and_fro(steps[np.isfinite(steps)])))
    best = int(np.argmax(evidence))
    return evidence[best] - float(np.log(2 * len(WHAT))), f'{WHAT[best]} at each arrival is one of two, at random'


def _along(turns: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Turns (m, 2) of the mirror at the arrivals of each run, about the line about which it turns most: what leans does
    so about one line in its mount."""
    both = np.concatenate(turns)
    both = both[np.isfinite(both).all(axis=1)]
    line = eigen(both.T @ both)[1][:, -1] if len(both) else np.zeros(2)
    return [run @ line for run in turns]


def _two_rather_than_one(score: np.ndarray) -> float:
    """Log evidence of two middles against one: by the likelihoods, less half the logarithm of their number for each of
    two further parameters.  Both with the tails that suit them best: a few arrivals far off are no second state."""
    z = _in_spreads(score)
    if not len(z):
        return 0.0
    z = z - np.median(z)
    two = max(_likelihood(z, dof, (-0.8, 0.8)) for dof in TAILS)
    return two - _of_one_middle(z) - float(np.log(len(z)))


def _to_and_fro(steps: np.ndarray) -> float:
    """Log evidence that steps from one arrival to the next are none, one way or back, against one middle.  Steps that
    have an error in common count as if they had not: of errors of one middle, whatever their tails and their
    correlation, none of the 72 series drawn in ``test_two_states.py`` shows 1."""
    z = _in_spreads(steps)
    if not len(z):
        return 0.0

    def likeliest(middles: ArrayLike) -> float:
        return max(_likelihood(z, dof, middles, START, LEAST_STEPS) for dof in TAILS)

    two = likeliest((-1.0, 0.0, 1.0))
    evidence = two - _of_one_middle(z) - float(np.log(len(z)))
    return 0.0 if evidence > SUSPICION and likeliest(LATTICE) - two > SUSPICION else evidence


def _in_spreads(values: np.ndarray) -> np.ndarray:
    """Values in units of their standard deviation; none where they are few or all alike."""
    spread = float(np.std(values)) if len(values) >= LEAST else 0.0
    return values / spread if spread else values[:0]


def _of_one_middle(z: np.ndarray) -> float:
    """Log likelihood of one middle, with the tails that suit it best or anywhere between two ends."""
    return max(*(_likelihood(z, dof, (0.0,)) for dof in TAILS), _flat_likelihood(z - z.mean()))


def _flat_likelihood(z: np.ndarray) -> float:
    """Log likelihood of what is anywhere between two ends alike, the ends blurred: an axis that rests anywhere within
    what its control takes for in position."""
    blur = FLAT * np.std(z)
    end = np.sqrt(3.0 * (1.0 - FLAT**2)) * np.std(z)
    density = (ndtr((z[:, None] + end) / blur) - ndtr((z[:, None] - end) / blur)) / (2.0 * end)
    return float(np.log(np.maximum(density, 1e-30)).sum(axis=0).max())


def _likelihood(z: np.ndarray, dof: float, middles: ArrayLike, step: tuple[float, float] | None = None,
                least: float = LEAST_SHARE) -> float:
    """Log likelihood of a mixture of Student's distributions of ``dof`` degrees of freedom and one width, by EM;
    ``step``: how far apart the ``middles`` are that keep their proportions, and the width, to begin with."""
    place = np.array(middles, float)
    length, width = step or (1.0, 0.6)
    middle, share, before = length * place, np.full(len(place), 1.0 / len(place)), -np.inf
    for sweep in range(SWEEPS + 1):
        distance = ((z[:, None] - middle) / width)**2
        log_density = np.log(share) - np.log(width) + (
            gammaln(0.5 * dof + 0.5) - gammaln(0.5 * dof) - 0.5 * np.log(np.pi * dof)
            - 0.5 * (dof + 1.0) * np.log1p(distance / dof))
        total = np.logaddexp.reduce(log_density, axis=1)
        reached = float(np.sum(total))
        if sweep == SWEEPS or reached - before < SETTLED:
            break
        before = reached
        mine = np.exp(log_density - total[:, None])
        weight = mine * (dof + 1.0) / (dof + distance)
        share = np.clip(mine.mean(axis=0), least, None)
        share /= share.sum()
        if step:
            middle = place * np.sum(weight * place * z[:, None]) / max(np.sum(weight * place**2), 1e-12)
        else:
            middle = np.sum(weight * z[:, None], axis=0) / np.maximum(weight.sum(axis=0), 1e-12)
        width = max(float(np.sqrt(np.mean(np.sum(weight * (z[:, None] - middle)**2, axis=1)))), LEAST_WIDTH)
    return reached
