"""Noise as it is: the law of the arrivals' errors that explains a log best, given the effects.

The noise that the repeats show is normal and independent until the log says otherwise: an arrival that is far off now
and then, or errs as the one before it did, is noise of another law (:mod:`~stepdiag_ros.estimate.noise_law`) as
much as it may be a cause.  Which of the two it is the evidence says: that of a law and that of effects are weighed
against each other in the same data, in parity space, with the noise's sizes as the repeats show them under each law.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from stepdiag_ros.estimate.enhanced import readings_of
from stepdiag_ros.estimate.noise import Law, NoiseModel
from stepdiag_ros.estimate.noise_law import Repeats, sized, weighed
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.gap.inference.projection import Projection
from stepdiag_ros.gap.preprocess.observe import Observation

DOFS = (12.0, 7.0, 5.0, 4.0, 3.0, 2.5)
"""Degrees of freedom that are tried, from mild tails on.  What errs more wildly than the last has hardly a variance and
is no noise: it is a cause without a pattern."""
CORRELATIONS = (0.25, 0.45, 0.6, 0.75, 0.85)
SWEEPS = 12
"""Most steps in which sizes and spread settle …"""
STEADY = 0.3
"""… until two change the log evidence by less than this."""
HASTE = 1.0
"""Power of the mean square by which a size moves in a step: ½ would be the EM algorithm, which creeps."""
PATIENCE = 6.0
"""Log evidence by which a value may fall behind the best before no further one is tried."""
WORTH = 4.0
"""Log evidence that one more parameter of a law must bring: half the logarithm of some thousand readings."""
HINT = 3.0
"""Log evidence, by the errors' scores alone, from which a law is tried."""
LEAST_DOF = 8
"""Degrees of freedom of the repeats below which no law can be estimated."""


@dataclass(frozen=True)
class _Held:
    """A noise model held against a log: its log evidence; ``weighed``: with what single arrivals are wider by; the
    ``source`` (m,) and mean squares (m,) of the errors, in units of what they were taken to be."""

    noise: NoiseModel
    evidence: float
    weighed: NoiseModel
    source: np.ndarray
    squares: np.ndarray

    def next_within(self, largest: NoiseModel) -> NoiseModel:
        """The noise with the sizes and spread that the errors show, the sizes none above those of ``largest``: the
        repeats have shown how large noise is, a law how it is distributed."""
        factor = [float(np.mean(self.squares[mine])) ** HASTE if mine.any() else 1.0
                  for mine in (self.source >= 2, self.source < 2)]
        return replace(self.weighed, position=min(self.noise.position * factor[0], largest.position),
                       angle=min(self.noise.angle * factor[1], largest.angle))


def as_it_is(space: Projection, table: StopTable) -> tuple[NoiseModel, float]:
    """The noise of a projection with the laws that explain best what is read in ``table``, the stops freed of all
    effects, and the log evidence that the laws bring beyond normal, independent errors (0 where these do)."""
    if min(space.noise.dof) < LEAST_DOF:
        return tidied(space.noise), 0.0
    space, readings = made_tidy(space), readings_of(table)
    suspected = [hint for hint in _hints(space, readings) if hint.evidence > HINT]
    if not suspected:
        return space.noise, 0.0
    best = plain = _held(space, readings)
    repeats, largest = Repeats(table, space.fit.arrival), space.noise
    for hint in suspected:
        begin = tried = best
        for value in hint.values:
            law = replace(getattr(tried.noise, hint.law), **{hint.parameter: value})
            given = replace(tried.noise, **{hint.law: law})
            if hint.parameter == 'correlation':
                # A parabola in time takes more of what is correlated: the repeats are asked anew.
                largest = given = sized(given, repeats)
            tried = _settled(space, given, readings, largest)
            if tried.evidence < best.evidence - PATIENCE:
                break
            if tried.evidence > max(best.evidence, begin.evidence + WORTH):
                best = tried
    return best.noise, best.evidence - plain.evidence


def suspicion(space: Projection, table: StopTable) -> float:
    """Log evidence, by the single errors' scores alone, that the arrivals' noise has another law than a tidy one; 0
    where nothing speaks for one.  ``table``: the stops freed of all effects."""
    if min(space.noise.dof) < LEAST_DOF:
        return 0.0
    return sum(hint.evidence for hint in _hints(made_tidy(space), readings_of(table)) if hint.evidence > HINT)


def tidied(noise: NoiseModel) -> NoiseModel:
    """A noise with normal, independent errors of arrivals."""
    return replace(noise, position_law=Law(), angle_law=Law(), spread=None)


def made_tidy(space: Projection) -> Projection:
    """The projection in its noise with normal, independent errors of arrivals."""
    return space if space.noise.tidy else space.in_noise(tidied(space.noise))


def reweighed(observation: Observation, noise: NoiseModel, table: StopTable) -> NoiseModel:
    """The noise with its sizes, none above what it has, and with what single arrivals are wider by, as ``table``, the
    stops freed of all effects, shows them under its laws."""
    space = Projection.of(observation.table, observation.fit, noise)
    return _settled(space, noise, readings_of(table), noise).noise


def log_evidence(space: Projection, table: StopTable) -> float:
    """Log evidence of a projection's noise, but for a constant of the log, for ``table``, the stops freed of all
    effects."""
    return _held(space, readings_of(table)).evidence


def evidence_of_best_law(space: Projection, table: StopTable) -> float:
    """The same of the noise whose laws explain best what is in ``table``, for a projection in tidy noise."""
    return log_evidence(space, table) + as_it_is(space, table)[1]


def _settled(space: Projection, noise: NoiseModel, readings: np.ndarray, largest: NoiseModel) -> _Held:
    """The noise with sizes and spread settled under its laws, at the fit of a projection."""
    held, moved = _held(space if space.noise is noise else space.in_noise(noise), readings), np.inf
    for turn in range(1, SWEEPS):
        before, last = held.evidence, moved
        held = _held(space.in_noise(held.next_within(largest)), readings, turn)
        moved = abs(held.evidence - before)
        if max(moved, last) < STEADY:
            break
    return held


def _held(space: Projection, readings: np.ndarray, turn: int = 0) -> _Held:
    data = space.data(readings)
    wider, tails, squares, source = weighed(space.noise, list(space.errors(data)), len(space.table), turn)
    return _Held(space.noise, space.volume - 0.5 * float(data @ data) + tails, wider, source, squares)


@dataclass(frozen=True)
class _Hint:
    """A ``parameter`` of a ``law`` and the values to try; ``evidence`` for it by the errors' scores alone."""

    law: str
    parameter: str
    values: tuple[float, ...]
    evidence: float


def _hints(space: Projection, readings: np.ndarray) -> list[_Hint]:
    """What the errors' scores say for each parameter of each law."""
    data = space.data(readings)
    scores: dict[str, list] = {'angle_law': [], 'position_law': []}
    pairs: dict[str, list] = {'angle_law': [], 'position_law': []}
    for latent, lost in space.latents():
        along = latent.columns.T @ data[latent.at]
        spread = latent.columns.T @ latent.columns - lost.T @ lost
        seen = np.maximum(np.diag(spread), 1e-12)
        score = along / np.sqrt(seen)
        for name, mine in (('angle_law', latent.source < 2), ('position_law', latent.source >= 2)):
            scores[name].append(score[mine & (seen > 0.05)])
            next_ = np.flatnonzero(mine[:-1] & (latent.source[1:] == latent.source[:-1])
                                   & (seen[:-1] > 0.05) & (seen[1:] > 0.05))
            share = spread[next_, next_ + 1] / np.sqrt(seen[next_] * seen[next_ + 1])
            pairs[name].append(np.stack([score[next_] * score[next_ + 1] - share, 1.0 + share**2]))
    found = []
    for name in scores:
        product, variance = np.concatenate(pairs[name], axis=1)
        alike = float(np.sum(product) / np.sqrt(max(np.sum(variance), 1.0)))
        found.append(_Hint(name, 'correlation', CORRELATIONS, 0.5 * max(alike, 0.0)**2))
    return found + [_Hint(name, 'dof', DOFS, _tails(np.concatenate(scores[name]))) for name in scores]


def _tails(score: np.ndarray) -> float:
    """Log likelihood of Student's t beyond that of the normal distribution, each of the size that suits best."""
    if len(score) < LEAST_DOF:
        return 0.0
    normal = -0.5 * len(score) * (1.0 + np.log(2.0 * np.pi * np.mean(score**2)))
    middle = np.median(np.abs(score)) / 0.6745
    return max(_student(score, dof, middle * factor) for dof in DOFS[1:] for factor in (0.8, 0.9, 1.0)) - float(normal)


def _student(score: np.ndarray, dof: float, size: float) -> float:
    """Log likelihood of Student's t of a size."""
    each = special.gammaln(0.5 * (dof + 1.0)) - special.gammaln(0.5 * dof) - 0.5 * np.log(dof * np.pi) - np.log(size)
    return float(len(score) * each - 0.5 * (dof + 1.0) * np.sum(np.log1p((score / size)**2 / dof)))
