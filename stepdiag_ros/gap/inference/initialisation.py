"""Where to begin when an effect is large.

A large effect bends the nominal fit so far that at it hardly anything looks like itself: forms laid
there and evidence taken there mislead.  Therefore each effect that might be to blame is first fitted
together with the machine, against noise scaled up to the residual, which shrinks as the right one
finds its size.  The one that leaves least gives the place where the search begins.  It says nothing
of what acts: that the search decides, from all candidates, at the noise as it is.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stepdiag_ros.effects.base import Effect, Form
from stepdiag_ros.effects.tuning import same_form
from stepdiag_ros.estimate.enhanced import fit, readings_of
from stepdiag_ros.estimate.noise import NoiseModel
from stepdiag_ros.gap.constants import LARGE_RESIDUAL, SUSPICION
from stepdiag_ros.gap.inference.candidates import Candidate, Screen
from stepdiag_ros.gap.inference.joint import Active, Joint, fit_jointly, freed, refitted, solve, tuned, unexplained
from stepdiag_ros.gap.inference.parity import Parity, parity
from stepdiag_ros.gap.preprocess.observe import SETTLED, Observation

TRIED = 5
"""Effects tried: the first by evidence against scaled-up noise."""
MOST, BEAM = 3, 3
"""Large effects that are sought together, and sets that are carried on."""
ROUNDS = 8
STEADY = 0.95
"""Rounds end when the residual does not shrink below this share."""
NEAR = 1.5
"""Sets that leave more than this factor above the least are not carried on."""
WORTH = 0.8
"""A further effect must leave less than this share."""


@dataclass(frozen=True)
class _Trial:
    """Machine and effects fitted against noise scaled up by ``scale``."""

    observation: Observation
    chosen: tuple[tuple[Effect, Form], ...]
    scale: float


def place_to_begin(joint: Joint, effects: Mapping[str, Effect]) -> Joint:
    """``joint``, or where its residuals are large, the joint fit of what takes most of them away."""
    noise = joint.noise
    best = _Trial(joint.observation, (), _left(joint.parity, joint.parity.data))
    front = [best]
    for _ in range(MOST):
        if best.scale < LARGE_RESIDUAL:
            break
        tried: dict[frozenset, _Trial] = {}
        for trial in front:
            for further in _suspects(trial, effects, noise):
                names = frozenset((*(effect.name for effect, _ in trial.chosen), further[0].name))
                if names not in tried:
                    tried[names] = _fitted(trial, further, noise)
        front = [trial for trial in sorted(tried.values(), key=lambda trial: trial.scale)[:BEAM]
                 if trial.scale < NEAR * min(t.scale for t in tried.values())]
        if not front or front[0].scale > WORTH * best.scale:
            break
        best = front[0]
    return fit_jointly(best.observation, list(best.chosen), noise) if best.chosen else joint


def misfit(joint: Joint) -> float:
    """Root mean square of what the stops leave of a joint fit, in units of the noise."""
    return _left(joint.parity, unexplained(joint.parity, joint.active))


def _suspects(trial: _Trial, effects: Mapping[str, Effect], noise: NoiseModel) -> list[tuple[Effect, Form]]:
    """The effects, each in the form that suits best, that explain most of what the trial leaves."""
    space, active = _solved(trial, noise)
    space = replace(space, data=unexplained(space, active))
    candidates = [Candidate(effect.name, '', form) for effect in effects.values()
                  if not effect.needs_dwells or space.dof[1]
                  for form in effect.appearance(trial.observation.view)]
    screen = Screen(space, candidates, float(sum(noise.dof)))
    taken = {effect.name for effect, _ in trial.chosen}
    found = sorted((m for m in screen.by_cause().values() if m.log_bayes > SUSPICION and m.effect not in taken),
                   key=lambda m: -m.log_bayes)
    return [(effects[m.effect], candidates[m.candidate].form) for m in found[:TRIED]]


def _fitted(trial: _Trial, further: tuple[Effect, Form], noise: NoiseModel) -> _Trial:
    """``trial`` with one effect more, machine and effects in turn until the residual shrinks no more."""
    trial = replace(trial, chosen=(*trial.chosen, further))
    best = replace(trial, scale=np.inf)
    for _ in range(ROUNDS):
        space, active = _solved(trial, noise)
        scale = max(1.0, trial.scale * _left(space, unexplained(space, active)))
        observation = _freed(trial.observation, active, noise.scaled(scale))
        chosen = tuple((a.effect, same_form(a.effect, a.form, observation.view)) for a in active)
        trial = _Trial(observation, chosen, scale)
        steady = trial.scale > STEADY * best.scale
        best = min(best, trial, key=lambda t: t.scale)
        if steady:
            break
    return best


def _solved(trial: _Trial, noise: NoiseModel) -> tuple[Parity, tuple[Active, ...]]:
    """The trial's parity space at its scaled-up noise and its effects' coefficients there."""
    observation = trial.observation
    space = parity(observation, observation.fit, noise.scaled(trial.scale), readings_of(observation.table))
    return space, solve(space, tuned(space, list(trial.chosen)))


def _freed(observation: Observation, active: Sequence[Active], noise: NoiseModel) -> Observation:
    """The observation with the machine fitted to the readings freed of the effects."""
    table = freed(observation.table, active)
    result = fit(observation.log.description, table, noise=noise, theta=observation.fit.theta, settled=SETTLED)
    return refitted(observation, result)


def _left(space: Parity, rest: np.ndarray) -> float:
    """Root mean square of the stops' residuals in units of the noise."""
    return float(np.sqrt(rest[:space.stops] @ rest[:space.stops] / max(space.dof[0], 1)))
