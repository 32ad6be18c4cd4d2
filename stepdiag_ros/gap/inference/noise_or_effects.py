"""Noise of another law, or effects: which of the two a log shows.

Tails, and errors that go with those before, look like causes where noise is taken to be normal and independent;
and a cause looks like tails to a noise that may have them.  So effects are searched in three noises: a normal one, that
whose laws explain the log best without any effect, and that whose laws explain best what the names found in the first
leave.  Of each, machine and set-up at their priors, the log evidence of what it leaves is taken, the price of its
effects' freedom paid; the largest decides.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from stepdiag_ros.effects.base import Effect
from stepdiag_ros.estimate.noise import NoiseModel
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.gap.alternatives.unmodelled import NAME as UNKNOWN
from stepdiag_ros.gap.constants import SUSPICION
from stepdiag_ros.gap.inference.candidates import Screen
from stepdiag_ros.gap.inference.discrepancy import Likeliest
from stepdiag_ros.gap.inference.joint import Active, Joint, fit_jointly, freed, refitted, size_of, unexplained
from stepdiag_ros.gap.inference.parity import slopes_of
from stepdiag_ros.gap.inference.search import EffectSet, log_prior, ranked
from stepdiag_ros.gap.inference.select_effects import noise_of, settle
from stepdiag_ros.gap.noise.arrival_law import as_it_is, evidence_of_best_law, log_evidence, suspicion
from stepdiag_ros.gap.preprocess.observe import Observation, sane_fit

ONE_ARRIVAL = 'no more than one arrival is off, and errors of arrivals have tails or go with those before them'
FAR = 1.5
"""Times the evidence by which tails are suspected that one effect must explain, to be no matter of tails."""


@dataclass(frozen=True)
class Settled:
    """What a log holds where its noise is taken for one law: the fit without effects and that with those found."""

    alone: Joint
    joint: Joint
    sets: list[EffectSet]
    screen: Screen

    @cached_property
    def evidence(self) -> float:
        return total_evidence(self.joint, self.sets, self.screen)

    @cached_property
    def without_effects(self) -> float:
        """The same of the fit without effects."""
        return total_evidence(self.alone, [EffectSet((), 0.0)], self.screen)


def settle_in_noise(observation: Observation, effects: Mapping[str, Effect]) -> Settled:
    """The fit of the machine alone, and what :func:`settle` finds from there, in the noise that explains more; the log
    evidence of the sets is that against nothing in whatever noise explains the log best without any effect."""
    tidy = noise_of(observation)
    alone = fit_jointly(observation, [], tidy)
    plain = Settled(alone, *settle(alone, effects))
    hint = suspicion(alone.parity.projection, observation.table)
    if not hint or _settles(plain, hint):
        return plain
    noise, gain = as_it_is(alone.parity.projection, observation.table)
    if gain < SUSPICION:
        return plain
    if noise.has_tails and len(_patterns(plain)) < len(plain.joint.active):
        plain = Settled(alone, *settle(alone, effects, tails=True))
    # Of these noises only that of the machine alone is settled at what it leaves without an effect.
    nothing, own = _settled_in(noise, observation, effects), plain
    if _patterns(plain):
        joint = _without_outliers(plain.joint)
        noise, gain = as_it_is(joint.parity.projection.in_noise(tidy), left(joint))
        if gain >= SUSPICION:
            # What was found in a noise that its own rest refutes is held to what that rest shows.
            again = _settled_in(noise, observation, effects)
            own = again if _patterns(again) else plain
    acting = [one for one in (own, nothing) if _patterns(one)]
    return _against(nothing, max(acting, key=lambda one: one.evidence)) if acting else _of_the_law(nothing)


def _patterns(one: Settled) -> list[Active]:
    """What was found beyond an error of one arrival: where errors have tails, one that is far off is one of them."""
    return [a for a in one.joint.active if not a.form.of_one_arrival]


def _of_the_law(nothing: Settled) -> Settled:
    """The same without what an error of one arrival does."""
    sets = [replace(s, refused=s.refused or ONE_ARRIVAL) if s.members and all(
        nothing.screen.candidates[m.candidate].form.of_one_arrival for m in s.members) else s for s in nothing.sets]
    return replace(nothing, joint=nothing.alone, sets=sorted(sets, key=lambda s: bool(s.refused)))


def _against(nothing: Settled, acting: Settled) -> Settled:
    """Effects against nothing, each in the noise that suits it, after their total log evidence.

    Of an outlier that a law of tails takes nearly as well as a slip the data do not decide, however many standard
    deviations of a normal noise it is large.
    """
    ahead, sets = _ahead(nothing, acting)
    if ahead < SUSPICION:     # then that noise explains more than any effect in any of the noises, its own included
        if nothing.joint.active:
            _, sets = _ahead(nothing, nothing)
            return replace(nothing, joint=nothing.alone, sets=sets)
        return nothing
    return replace(acting, alone=acting.alone if sets[0].log_bayes > sets[0].claimed_from else nothing.alone, sets=sets)


def _ahead(nothing: Settled, acting: Settled) -> tuple[float, list[EffectSet]]:
    """By how much in log evidence effects are ahead of nothing, and their sets with no more than that."""
    among, sets = len({candidate.effect for candidate in nothing.screen.candidates}), acting.sets
    ahead = acting.evidence - log_prior(sets[0], among) - nothing.without_effects \
        + log_prior(EffectSet((), 0.0), among)
    behind = max(sets[0].log_bayes - ahead, 0.0)
    return ahead, ranked((replace(s, log_bayes=s.log_bayes - behind) if s.members else s for s in sets), among)


def _without_outliers(joint: Joint) -> Joint:
    """The joint fit of its names alone, or of its largest pattern where it has none: what else was found beside them in
    normal noise may be its tails."""
    kept = [a for a in joint.active if a.effect.name] or [max(joint.active, key=lambda a: np.sum(a.contribution**2))]
    return joint if len(kept) == len(joint.active) else fit_jointly(
        joint.observation, [(a.effect, a.form) for a in kept], joint.noise)


def _settled_in(noise: NoiseModel, observation: Observation, effects: Mapping[str, Effect]) -> Settled:
    """The fit of the machine alone, and what is found from there, in one noise."""
    fit = sane_fit(observation.log, observation.table, observation.fit.theta, noise)
    alone = fit_jointly(refitted(observation, fit), [], noise)
    return Settled(alone, *settle(alone, effects, noise.has_tails))


def _settles(plain: Settled, hint: float) -> bool:
    """Whether a single effect explains far more than tails could, ``hint``, and leaves none."""
    joint, best = plain.joint, plain.sets[0]
    return len(best.key) == 1 and bool(joint.active) and best.log_bayes > FAR * hint \
        and not suspicion(joint.parity.projection, left(joint))


def left(joint: Joint, beside: Likeliest | None = None) -> StopTable:
    """The stops with the effects taken off their readings, and what the discrepancies of their forms are likeliest to
    do, ``beside``: a law of the noise, too, is right beside forms that are not quite."""
    table, added = freed(joint.observation.table, joint.active), (beside or Likeliest.of(joint)).added
    return replace(table, displacement=table.displacement - added[:, :-2], spot=table.spot - added[:, -2:])


def total_evidence(joint: Joint, sets: list[EffectSet], screen: Screen) -> float:
    """Log evidence, but for a constant of the log, of a joint fit: its noise and its effects.

    The noise is given tails beside the effects too, where they leave any.
    """
    space = joint.parity
    beside = Likeliest.of(joint)
    table = left(joint, beside)
    stops = (evidence_of_best_law if joint.noise.tidy else log_evidence)(space.projection, table)
    inside = (unexplained(space, joint.active) - beside.white)[space.stops:]
    loud = float(np.sum(np.log(space.bin_scale[space.channel[space.stops:]])))
    slopes = slopes_of([a.form for a in joint.active], lambda number: joint.active[number].coefficients)
    made = 0.0 if slopes is None else space.log_jacobian(slopes)
    price = _price(joint, sets[0], screen) if joint.active else 0.0
    return stops - 0.5 * float(inside @ inside) - loud + made - price - beside.price


def _price(joint: Joint, best: EffectSet, screen: Screen) -> float:
    """What the effects' freedom costs: ½ ln|1 + s²ZᵀZ| + ½ aᵀa/s² of their forms of size s, and the ways to choose
    these."""
    columns = np.concatenate([joint.parity.project(a.form) * size_of(a.form) for a in joint.active], axis=1)
    _, volume = np.linalg.slogdet(np.eye(columns.shape[1]) + columns.T @ columns)
    far = sum(float(np.sum((a.coefficients / (a.form.scale * size_of(a.form)))**2)) for a in joint.active)
    forms = Counter(candidate.effect for candidate in screen.candidates)
    ways = sum(np.log(max(forms[a.effect.name or UNKNOWN], 1)) for a in joint.active)
    among = len(forms)
    return 0.5 * (float(volume) + far) + float(ways) + log_prior(EffectSet((), 0.0), among) - log_prior(best, among)
