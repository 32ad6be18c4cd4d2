"""Noise of another law, or effects: which of the two a log shows.

Tails, and errors that go with those before, look like causes where noise is taken to be normal and independent;
and a cause looks like tails to a noise that may have them.  So both are tried: effects beside normal noise, and
effects beside the noise whose laws explain the log best without any.  Of each, machine and set-up at their priors,
the log evidence of what it leaves is taken, the price of its effects' freedom paid; the larger decides.
"""

from collections import Counter
from collections.abc import Mapping

import numpy as np

from stepdiag_ros.effects.base import Effect
from stepdiag_ros.gap.alternatives.unmodelled import NAME as UNKNOWN
from stepdiag_ros.gap.constants import SUSPICION
from stepdiag_ros.gap.inference.candidates import Screen
from stepdiag_ros.gap.inference.joint import Joint, fit_jointly, freed, refitted, size_of, unexplained
from stepdiag_ros.gap.inference.search import EffectSet, log_prior
from stepdiag_ros.gap.inference.select_effects import noise_of, settle
from stepdiag_ros.gap.noise.arrival_law import as_it_is, log_evidence, suspicion
from stepdiag_ros.gap.preprocess.observe import Observation, sane_fit

FAR = 1.5
"""Times the evidence by which tails are suspected that one effect must explain, to be no matter of tails."""
Settled = tuple[Joint, Joint, list[EffectSet], Screen]


def settle_in_noise(observation: Observation, effects: Mapping[str, Effect]) -> Settled:
    """The fit of the machine alone, and what :func:`settle` finds from there, in the noise that explains more."""
    tidy = noise_of(observation)
    alone = fit_jointly(observation, [], tidy)
    plain: Settled = alone, *settle(alone, effects)
    hint = suspicion(observation, tidy, observation.table)
    if not hint or _settles(plain, hint):
        return plain
    noise, gain = as_it_is(observation, tidy, observation.table)
    if gain < SUSPICION:
        return plain
    observation = refitted(observation, sane_fit(observation.log, observation.table, observation.fit.theta, noise))
    alone = fit_jointly(observation, [], noise)
    other: Settled = alone, *settle(alone, effects)
    if not plain[1].active:
        return other
    return max(other, plain, key=lambda found: total_evidence(*found[1:]))


def _settles(plain: Settled, hint: float) -> bool:
    """Whether a single effect explains far more than tails could, ``hint``, and leaves none."""
    _, joint, sets, _ = plain
    return len(sets[0].key) == 1 and bool(joint.active) and sets[0].log_bayes > FAR * hint \
        and not suspicion(joint.observation, joint.noise, freed(joint.observation.table, joint.active))


def total_evidence(joint: Joint, sets: list[EffectSet], screen: Screen) -> float:
    """Log evidence, but for a constant of the log, of a joint fit: its noise and its effects.

    The noise is given tails beside the effects too, where they leave any.
    """
    observation, space = joint.observation, joint.parity
    table = freed(observation.table, joint.active) if joint.active else observation.table
    stops = log_evidence(observation, joint.noise, table)
    if joint.noise.tidy:
        stops += as_it_is(observation, joint.noise, table)[1]
    inside = unexplained(space, joint.active)[space.stops:]
    loud = float(np.sum(np.log(space.bin_scale[space.channel[space.stops:]])))
    return stops - 0.5 * float(inside @ inside) - loud - (_price(joint, sets[0], screen) if joint.active else 0.0)


def _price(joint: Joint, best: EffectSet, screen: Screen) -> float:
    """What the effects' freedom costs: ½ ln|1 + s²ZᵀZ| of their forms, and the ways to choose these."""
    columns = np.concatenate([joint.parity.project(a.form) * size_of(a.form) for a in joint.active], axis=1)
    _, volume = np.linalg.slogdet(np.eye(columns.shape[1]) + columns.T @ columns)
    forms = Counter(candidate.effect for candidate in screen.candidates)
    ways = sum(np.log(max(forms[a.effect.name or UNKNOWN], 1)) for a in joint.active)
    among = len(forms)
    return 0.5 * float(volume) + float(ways) + log_prior(EffectSet((), 0.0), among) - log_prior(best, among)
