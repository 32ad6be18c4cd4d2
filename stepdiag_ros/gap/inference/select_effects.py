"""Search and joint fit take turns until the set of effects stands.

The search weighs sets of effects in the space that one linearisation leaves free; the fit, machine and effects
together, gives the next linearisation.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from stepdiag_ros.effects.base import Effect, Form
from stepdiag_ros.effects.tuning import tune
from stepdiag_ros.estimate.enhanced import readings_of
from stepdiag_ros.estimate.noise import NoiseModel, estimate_noise
from stepdiag_ros.gap.alternatives.known_physics import beyond_families
from stepdiag_ros.gap.alternatives.unmodelled import LEAN, inconsistent_forms, unknown_families
from stepdiag_ros.gap.alternatives.unmodelled import NAME as UNKNOWN
from stepdiag_ros.gap.constants import BEYOND_PENALTY, LARGE_RESIDUAL, LEAN_PENALTY, SUSPICION, UNKNOWN_PENALTY
from stepdiag_ros.gap.inference.candidates import Candidate, Screen
from stepdiag_ros.gap.inference.discrepancy import modulations
from stepdiag_ros.gap.inference.evidence import prior_sigma_of
from stepdiag_ros.gap.inference.initialisation import misfit, place_to_begin
from stepdiag_ros.gap.inference.joint import Joint, fit_jointly, solve, unexplained
from stepdiag_ros.gap.inference.parity import parity
from stepdiag_ros.gap.inference.search import EffectSet, search
from stepdiag_ros.gap.noise.scatter import outliers
from stepdiag_ros.gap.preprocess.observe import Observation

ROUNDS = 4
TUNED = 4
"""Leading effects whose shape parameters are tuned before sets are formed, besides the best form of each family of
known physics without a name."""


def settle(nominal: Joint, effects: Mapping[str, Effect], tails: bool = False) -> tuple[Joint, list[EffectSet], Screen]:
    """From the fit of the machine alone, search and fit in turns until the chosen set stays the same; where errors of
    arrivals have ``tails``, one that is far off is one of them, and nothing that does no more is looked for."""
    joint = place_to_begin(nominal, effects)
    previous: tuple = ()
    stood: tuple[list[EffectSet], Screen] | None = None
    for _ in range(ROUNDS):
        screen = _screen(joint, effects, tails)
        screen = _sharpened(screen)
        sets = search(screen)
        controls = [Candidate(UNKNOWN, name, form, negative_control=True)
                  for name in sorted(sets[0].key & set(effects))
                  for form in effects[name].negative_controls(joint.observation.view)]
        if controls:
            screen = screen.extended(controls)
            sets = search(screen)
        best = sets[0] if sets[0].log_bayes > SUSPICION else EffectSet((), 0.0)
        chosen: list[tuple[Effect, Form]] = []
        for member in best.members:
            form = screen.candidates[member.candidate].form
            chosen.append((effects.get(member.effect, Effect()), form))
        identity = tuple(sorted((e.name, f.tuned_from or f.label) for e, f in chosen))
        if identity == previous:
            break
        previous = identity
        fitted = fit_jointly(joint.observation, chosen, joint.noise) if chosen else nominal
        if joint.active and misfit(fitted) > max(LARGE_RESIDUAL, misfit(joint)):
            # The search predicted from its place what the joint fit does not hold: what did hold is kept.
            screen = Screen(joint.parity,
                            [Candidate(a.effect.name or UNKNOWN, a.form.family, a.form) for a in joint.active],
                            float(sum(joint.noise.dof)), modulations=modulations(joint.observation.view))
            return joint, search(screen), screen
        if stood and best.log_bayes - _short(joint, chosen, fitted) < _evidence(sets, joint) - SUSPICION:
            return joint, *stood
        joint, stood = fitted, (sets, screen)
        if not chosen:
            break
    return joint, sets, screen


def _short(joint: Joint, chosen: list[tuple[Effect, Form]], fitted: Joint) -> float:
    """Log evidence by which ``chosen`` falls short, once ``fitted``, of what its search predicted at ``joint``.

    A beam's cosine only shortens: at a fit that an effect has freed a small step may seem to lengthen what the machine
    alone can never fit, and what was found seems not to be needed.
    """
    predicted = unexplained(joint.parity, solve(joint.parity, chosen))[:joint.parity.stops]
    observation = fitted.observation
    space = parity(observation, observation.fit, joint.noise, readings_of(observation.table))
    left = unexplained(space, solve(space, [(a.effect, a.form) for a in fitted.active]))[:space.stops]
    return 0.5 * float(left @ left - predicted @ predicted)


def _evidence(sets: list[EffectSet], joint: Joint) -> float:
    """Log evidence of the effects of a joint fit among sets searched there."""
    names = {a.effect.name or UNKNOWN for a in joint.active}
    return next((s.log_bayes for s in sets if s.key == names), 0.0)


def noise_of(observation: Observation) -> NoiseModel:
    """The noise that the log's repeats show."""
    return estimate_noise(observation.table, observation.log.description.noise,
                          observation.fit.arrival)


def _screen(joint: Joint, effects: Mapping[str, Effect], tails: bool) -> Screen:
    view = joint.observation.view
    candidates = []
    for effect in effects.values():
        if effect.needs_dwells and not joint.parity.dof[1]:
            continue
        candidates += [Candidate(effect.name, form.family, form) for form in effect.appearance(view)]
    tuned = [a for a in joint.active if a.form.tuned_from]
    candidates += [Candidate(a.effect.name, a.form.family, a.form) for a in tuned if a.effect.name]
    for family, forms in unknown_families(view).items():
        penalty = LEAN_PENALTY if family in LEAN else UNKNOWN_PENALTY
        candidates += [Candidate(UNKNOWN, family, form, penalty) for form in forms]
    for family, forms in beyond_families(view).items():
        # A form that was tuned from one of a family is one more of that, not a way of its own.
        labels = {form.label for form in forms}
        forms += [a.form for a in tuned if a.form.tuned_from in labels]
        candidates += [Candidate(UNKNOWN, family, form, BEYOND_PENALTY, own=True) for form in forms]
    outlier = outliers(joint)
    if outlier:
        form, ways = outlier
        candidates.append(Candidate(UNKNOWN, 'outliers', form, LEAN_PENALTY + ways))
    named = [a for a in joint.active if a.effect.name]
    if named:
        candidates += [Candidate(UNKNOWN, 'inconsistent', form, UNKNOWN_PENALTY)
                       for form in inconsistent_forms(view, [a.form for a in named])]
    if tails:
        candidates = [c for c in candidates if not c.form.of_one_arrival]
    repeatable = frozenset(e.name for e in effects.values() if e.repeatable)
    return Screen(joint.parity, candidates, float(sum(joint.noise.dof)), repeatable, modulations(view), effects)


def _sharpened(screen: Screen) -> Screen:
    """The screen with the best forms of the leading effects, and of all known physics without a name, tuned: a coarse
    net of time constants must not make a mixture of two look better than the right one, nor a name."""
    named = [member for member in screen.by_cause().values() if not member.own]
    leading = sorted(named, key=lambda m: -m.log_bayes)[:TUNED] + screen.beyond()
    data, added = screen.parity.data, []
    for member in leading:
        candidate = screen.candidates[member.candidate]
        if member.log_bayes < SUSPICION or candidate.form.retune is None:
            continue

        def explained(form: Form) -> float:
            columns = screen.parity.project(form)
            along = columns.T @ data
            normal = columns.T @ columns + np.eye(columns.shape[1]) / prior_sigma_of(form) ** 2
            return float(along @ np.linalg.solve(normal, along))

        form = tune(candidate.form, explained, close=0.01)
        if form is not candidate.form:
            added.append(replace(candidate, form=form))
    return screen.extended(added) if added else screen
