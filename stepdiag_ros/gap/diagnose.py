"""The diagnosis of a log: where the gap lies, which effect causes it, how far it closes.

The steps, each in a package of its own:

:mod:`preprocess`         put stamps right, reduce samples to stops, fit the rigid-body model, leave out spots beyond
                          the detector's range
:mod:`noise`              disturbances inside the dwells: spectra, lines, mode hops; scatter beyond the noise
:mod:`inference`          evidence for sets of effects in parity space, search, joint fit, averaged errors
:mod:`alternatives`       what competes with the named effects: physics without a name, unmodelled structure
:mod:`summary`            where, at which frequencies, with what it correlates, the held-out gap
:mod:`experiment_design`  what the log leaves open and the run that separates it
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from stepdiag_ros.effects.base import Effect
from stepdiag_ros.estimate.metres import untold
from stepdiag_ros.estimate.on_centre import on_centre
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.estimate.samples import clean
from stepdiag_ros.gap.alternatives.unmodelled import NAME as UNKNOWN
from stepdiag_ros.gap.constants import (
    ALARM,
    LARGE_RESIDUAL,
    LEAST_LEFT,
    SCATTER_ALARM,
)
from stepdiag_ros.gap.diagnosis import AXIS_LIKE, COUNTS, STAMPS, Diagnosis, Found
from stepdiag_ros.gap.experiment_design.advice import advise
from stepdiag_ros.gap.experiment_design.competing_models import competing_models, confused, separations
from stepdiag_ros.gap.inference.candidates import Candidate
from stepdiag_ros.gap.inference.discrepancy import residual
from stepdiag_ros.gap.inference.evidence import prior_sigma_of
from stepdiag_ros.gap.inference.joint import Joint, unexplained
from stepdiag_ros.gap.inference.noise_or_effects import left, settle_in_noise
from stepdiag_ros.gap.inference.search import NOTHING, EffectSet, probabilities
from stepdiag_ros.gap.inference.select_effects import noise_of
from stepdiag_ros.gap.noise.disturbances import disturbed
from stepdiag_ros.gap.noise.far_arrivals import FarArrivals
from stepdiag_ros.gap.noise.incoherent_lines import Vibration
from stepdiag_ros.gap.noise.scatter import excess_scatter
from stepdiag_ros.gap.noise.slips_at_rest import SlipAtRest, place_of, staying
from stepdiag_ros.gap.noise.slips_at_rest import words as slip_words
from stepdiag_ros.gap.noise.stated import noisier, stated
from stepdiag_ros.gap.noise.two_states import two_states
from stepdiag_ros.gap.preprocess.clocks import Late, set_clocks
from stepdiag_ros.gap.preprocess.detector_range import within_range
from stepdiag_ros.gap.preprocess.observe import Observation, observe
from stepdiag_ros.gap.preprocess.timing import Timing
from stepdiag_ros.gap.summary.cross_validation import CrossValidation, cross_validated, excess_forecast
from stepdiag_ros.gap.summary.hint import hint_of
from stepdiag_ros.gap.summary.where import shares
from stepdiag_ros.model.log import CalibrationLog

BEYOND_PATTERNS = 0.95
"""Probability that something else acts where scatter, hops or coarse readings say so, each far beyond its alarm."""


UNTIMED = ('the readings drift in the order in which they were taken; the times of this table are made up, so that no '
           'thermal cause and no time constant can be named')


def diagnose(log: CalibrationLog, effects: Iterable[Effect]) -> Diagnosis:
    """Diagnose one log against ``effects`` (one instance of each class)."""
    effects = {effect.name: effect for effect in effects}
    log, unlit = on_centre(log)
    log, observation, clocks, late, left_out = _well_timed(log)
    observation, beyond_range = within_range(observation)
    observation, disturbances = disturbed(log, observation)
    found = settle_in_noise(observation, effects)
    alone, joint, sets, screen = found.alone, found.joint, found.sets, found.screen
    best = sets[0] if sets[0].log_bayes > sets[0].claimed_from else EffectSet((), 0.0)
    names, nothing, weights = probabilities(sets, len(effects) + 1)
    if not best.members:
        # Below the alarm nothing is claimed, whatever the odds between the sets say.
        joint = alone
    how_far, shakes = cross_validated(joint, alone), disturbances.dwell_spectrum.shakes
    far = FarArrivals.of(joint)
    found = [_found(name, effects[name], names.get(name, 0.0), joint)
             for name in dict.fromkeys(a.effect.name for a in joint.active) if name in best.key]
    untimed = set() if log.description.timed else {f.name for f in found if effects[f.name].needs_times}
    found = [f for f in found if f.name not in untimed]
    if untimed:
        names = {**{n: p for n, p in names.items() if n not in untimed}, UNKNOWN: max(names[n] for n in untimed)}
    stayed = _stayed(disturbances.slips, joint) if COUNTS in effects and COUNTS not in best.key else []
    beside = [*([_late(late)] if late else []),
              *([_slipped(effects[COUNTS], stayed, observation.table)] if stayed else []),
              *([_shaking(effects, disturbances.dwell_spectrum.displacement)] if shakes else [])]
    outside = {f.name: f.probability for f in beside}
    found = sorted([*found, *beside], key=lambda f: -f.probability)
    patterns = [(m.log_bayes, screen.candidates[m.candidate]) for m in best.members if m.effect == UNKNOWN]
    # What does as an effect does, beside a pattern, is the smaller news.
    unmodelled = _pattern(max(patterns, key=lambda p: (p[1].effect == UNKNOWN, p[0]))[1], effects) if patterns else ''
    unmodelled = unmodelled or (UNTIMED if untimed else '')
    before, instead = disturbances.words({name: names.get(name, 0.0) for name in best.key})
    unmodelled = before or unmodelled or instead
    if not unmodelled and not shakes:
        # Stamps make no arrival noisier.
        at_rest = any(f.name != STAMPS for f in found)
        unmodelled = _without_pattern(joint, far, how_far, bool(found)) \
            or noisier(_freed_of_discrepancies(joint) if at_rest else joint)
    if unmodelled and UNKNOWN not in best.key and not untimed:
        outside[UNKNOWN] = BEYOND_PATTERNS
    if found and not unmodelled and (how_far.left > LEAST_LEFT and how_far.beyond_chance
                                     or how_far.after > LARGE_RESIDUAL**2):
        unmodelled = (f'{100.0 * how_far.left:.2g} % of the gap does not follow the forms known of what was named '
                    f'({np.sqrt(how_far.after):.2g} times the noise is left)')
    hint = None if best.members or unmodelled else hint_of(sets, len(effects) + 1, screen)
    doubtful = hint.found if hint else best
    groups = tuple(group for group in confused(sets, doubtful) if not untimed & set(group))
    words, run = advise(joint, competing_models(screen, effects, sets, doubtful, groups, hint is not None), groups,
                        bool(unmodelled), hint.settles if hint else None)
    no_metres = untold(log, observation.table)
    return Diagnosis(
        log, _verdict(found, unmodelled), how_far, shares(joint, found, bool(unmodelled)), tuple(found),
        {**names, **outside, NOTHING: nothing * float(np.prod([1.0 - p for p in outside.values()]))},
        tuple((tuple(sorted({*(UNKNOWN if n in untimed else n for n in s.names), *outside})), w)
              for s, w in zip(sets, weights, strict=True))[:20],
        groups, observation, joint, clocks, disturbances.dwell_spectrum.displacement, unmodelled,
        log.warnings + observation.table.warnings + ((beyond_range,) if beyond_range else ()) + left_out + tuple(unlit)
        + tuple(slip_words(observation.table, slip) for slip in disturbances.slips)
        + stated(joint, far, disturbances.quanta) + ((no_metres,) if no_metres else ()), sets, screen, words, run,
        separations(sets, doubtful), hint, len(effects) + 1, no_metres,
        disturbances.slips if COUNTS in best.key else tuple(slip for _, slip in stayed))


def _pattern(candidate: Candidate, effects: Mapping[str, Effect]) -> str:
    """What has no name, in words; where it does what an effect does, but of another size, as what does so."""
    imitated = effects[candidate.effect].imitated_by + ': ' if candidate.effect in effects else ''
    return imitated + candidate.form.label


def _well_timed(log: CalibrationLog) -> tuple[CalibrationLog, Observation, Mapping[str, Timing | None],
                                              Mapping[str, Late], tuple[str, ...]]:
    """The log with stamps put right and without what is no reading, observed; its clocks; what was left out, in words.

    The sample at the end of a dwell that a wrong clock takes for one at rest is the first of the next move: what it
    tells of the clock is read before it may count as a spike.
    """
    kept, _ = clean(log, ends=False)
    stamped, observation, clocks, late = set_clocks(kept, observe(kept))
    log, left_out = clean(replace(log, displacement=replace(log.displacement, time_ns=stamped.displacement.time_ns),
                                  spot=replace(log.spot, time_ns=stamped.spot.time_ns)))
    same = all(np.array_equal(a.values, b.values, equal_nan=True)
               for a, b in ((log.displacement, stamped.displacement), (log.spot, stamped.spot)))
    return log, observation if same else observe(log), clocks, late, left_out


def _freed_of_discrepancies(joint: Joint) -> Joint:
    """The fit with the noise of what its effects leave beside their discrepancies: a share of a large one is none."""
    return replace(joint, noise=noise_of(replace(joint.observation, table=left(joint))))


def _without_pattern(joint: Joint, far: FarArrivals, how_far: CrossValidation, found: bool) -> str:
    """Scatter beyond the noise and the discrepancies of the forms, arrivals with two states or farther off than tails
    reach, or runs predicted worse than noise, in words; '' where there is none."""
    rest = residual(joint)
    evidence, words = excess_scatter(joint, rest)
    if evidence > SCATTER_ALARM:
        return words
    for evidence, words in (two_states(joint), far.beyond_tails()):
        if evidence > SCATTER_ALARM:
            return words
    evidence, words = excess_forecast(how_far)
    return words if evidence > SCATTER_ALARM and not found else ''


def _found(name: str, effect: Effect, probability: float, joint: Joint) -> Found:
    """One effect in all its forms; the form that does most names the parameters."""
    mine = [a for a in joint.active if a.effect.name == name]
    parts = [joint.parity.project(a.form) @ (a.coefficients / a.form.scale) for a in mine]
    order = np.argsort([-np.sum(p**2) for p in parts])
    parameters: dict[str, float] = {}
    spread: dict[str, float] = {}
    for rank, k in enumerate(order):
        active, suffix = mine[k], '' if rank == 0 else f' ({rank + 1})'
        sigma = np.sqrt(np.diag(active.covariance))
        # A coefficient as wide as it was before the log is not of this log: an axis that never moved.
        widest = 0.99 * prior_sigma_of(active.form) * active.form.scale
        for n, value, s, wide in zip(active.form.names, active.coefficients, sigma, widest, strict=True):
            if s < wide:
                # Along an axis there is one size: what one form says of it the next takes back in part.
                label = n if len(n) < AXIS_LIKE else n + suffix
                parameters[label] = parameters.get(label, 0.0) + float(value)
                spread[label] = float(np.hypot(spread.get(label, 0.0), s))
        parameters |= {k + suffix: float(v) for k, v in active.form.shape.items()}
        spread |= {k + suffix: float(v) for k, v in active.shape_sigma.items()}
    data, rest = joint.parity.data, unexplained(joint.parity, joint.active)
    without, left = float(np.sum((rest + sum(parts)) ** 2)), float(rest @ rest)
    # Noise may be less than the freedom says, where it was taken for granted: then it is what is left.
    floor = min(float(sum(joint.parity.dof)), left)
    return Found(name, effect.title, probability, parameters, spread, mine[order[0]].form.units,
                 ' and '.join(mine[k].form.label for k in order),
                 float(np.clip((without - left) / max(float(data @ data) - floor, 1e-12), 0.0, 1.0)),
                 effect.remedy)


def _late(late: Mapping[str, Late]) -> Found:
    parameters: dict[str, float] = {}
    sigma: dict[str, float] = {}
    for sensor, by in late.items():
        parameters[f'{sensor}_s'], sigma[f'{sensor}_s'] = by.offset, by.sigma
        if by.drift:
            parameters[f'{sensor}_drift_s'], sigma[f'{sensor}_drift_s'] = by.drift, by.drift_sigma
    return Found('clock_skew', "A sensor's time stamps do not agree with the sequencer's.",
                 max(by.probability for by in late.values()), parameters, sigma, 's',
                 'offset and drift' if any(by.drift for by in late.values()) else 'constant offset',
                 1.0, 'Let all computers take their time from one source (PTP or NTP).')


def _stayed(slips: tuple[SlipAtRest, ...], joint: Joint) -> list[tuple[float, SlipAtRest]]:
    """Counts lost in dwells that the stops miss from there on, whatever law the errors of arrivals follow, each with
    its log evidence."""
    if not slips:
        return []
    evidence = staying(slips, joint.parity.projection, left(joint))
    return [(one, slip) for one, slip in zip(evidence, slips, strict=True) if one > ALARM]


def _slipped(effect: Effect, stayed: list[tuple[float, SlipAtRest]], table: StopTable) -> Found:
    labels = ['jump' if k == 0 else f'jump ({k + 1})' for k in range(len(stayed))]
    return Found(COUNTS, effect.title, _probability(max(one for one, _ in stayed)),
                 {label: slip.jump for label, (_, slip) in zip(labels, stayed, strict=True)},
                 {label: slip.sigma for label, (_, slip) in zip(labels, stayed, strict=True)}, 'm',
                 'seen in the dwell of ' + ' and '.join(place_of(table, slip) for _, slip in stayed), 1.0,
                 effect.remedy)


def _probability(log_bayes: float) -> float:
    """Of what is seen beside the search, at even odds before."""
    return float(1.0 / (1.0 + np.exp(-min(log_bayes, 30.0))))


def _shaking(effects: Mapping[str, Effect], seen: Vibration) -> Found:
    effect = effects.get('vibration', Effect())
    line = 'a line in the spectrum of the dwells' + (', of one phase through many' if seen.coherent else '')
    alike = ' and '.join(f'{hertz:.3g} Hz' for hertz in seen.aliases)
    return Found('vibration', effect.title, _probability(seen.log_bayes),
                 {'frequency_Hz': seen.frequency, 'amplitude_m': seen.amplitude},
                 {'amplitude_m': seen.sigma}, 'm', line, seen.share,
                 f'{effect.remedy} Sampled at {seen.rate:.3g} Hz, {alike} look the same.'.lstrip())


def _verdict(found: list[Found], unmodelled: str) -> str:
    if not found and not unmodelled:
        return 'no_gap'
    if not found:
        return 'unexplained'
    return 'partly_explained' if unmodelled else 'explained'
