"""From a log to its diagnosis: where the gap lies, which effect causes it, how far it closes.

The steps, each in a file of its own: :mod:`observe` (reduce, fit), :mod:`inside`, :mod:`clocks`, :mod:`lines`
and :mod:`hops` (samples: stamps, vibration, a unit that hops), :mod:`gross` (where to begin), :mod:`parity`,
:mod:`screen` and :mod:`search` (evidence for sets of effects), :mod:`joint` (machine and effects together),
:mod:`scatter` (what has no pattern), :mod:`closing` (the part held out), :mod:`where` (shares), :mod:`averaged`
(the 21 errors).  Search and joint fit take turns until the set of effects stands.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from stepdiag_ros.effects.base import Effect, Form
from stepdiag_ros.effects.tuning import tune
from stepdiag_ros.estimate.noise import estimate_noise
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.gap.averaged import averaged_solution
from stepdiag_ros.gap.beyond import Beyond, beyond_families
from stepdiag_ros.gap.clocks import late_clocks, put_right
from stepdiag_ros.gap.closing import Closing, closing, excess_forecast
from stepdiag_ros.gap.evidence import width_of
from stepdiag_ros.gap.gross import GROSS, misfit, place_to_begin
from stepdiag_ros.gap.hops import Hops, hops
from stepdiag_ros.gap.inside import Timing, apart, step_noise, steps, timing
from stepdiag_ros.gap.joint import Joint, fit_jointly, unexplained
from stepdiag_ros.gap.lines import Unrest, Vibration, unrest
from stepdiag_ros.gap.next_measurement import advise
from stepdiag_ros.gap.next_run import NextRun, Ways, kind
from stepdiag_ros.gap.observe import Observation, observe
from stepdiag_ros.gap.scatter import excess_scatter, strays
from stepdiag_ros.gap.screen import Candidate, Screen
from stepdiag_ros.gap.search import EffectSet, probabilities, search
from stepdiag_ros.gap.thresholds import (
    ALARM,
    BEYOND_DOUBT,
    CONFUSED,
    FORM_ERROR,
    LEAN_DOUBT,
    LEAST_LEFT,
    MISFIT,
    MISFIT_MOST,
    SCATTER_ALARM,
    TEMPER,
    UNKNOWN_DOUBT,
)
from stepdiag_ros.gap.unknown import LEAN, inconsistent_forms, unknown_families
from stepdiag_ros.gap.unknown import NAME as UNKNOWN
from stepdiag_ros.gap.where import Share, shares
from stepdiag_ros.model.log import CalibrationLog

ROUNDS = 4
BEYOND_PATTERNS = 0.95
"""Probability that something else acts where scatter, hops or coarse readings say so, each far beyond its alarm."""
OTHER_WAYS = 2
LEAST_WAY = 0.05
"""Most further forms of an effect in which a set of effects is foretold, and the least share of one."""
BEYOND_LOG = 0.3
"""Power of a form's odds beyond the log: the form that suits best there need not be that in which things go on."""
WORSE = 4.0
"""Mean square of a channel's residuals at the stops by which clocks put right may leave more than they found."""
TUNED = 4
"""Leading effects whose shape parameters are tuned before sets are formed."""


@dataclass(frozen=True)
class Found:
    """An effect of the diagnosis: name, probability, parameters with σ by name, share of the gap closed."""

    name: str
    title: str
    probability: float
    parameters: Mapping[str, float]
    sigma: Mapping[str, float]
    units: str
    form: str
    closes: float
    remedy: str


@dataclass(frozen=True)
class Diagnosis:
    """Everything that a report needs.

    ``verdict`` as in the contract; ``effects`` what the diagnosis would add to the simulator;
    ``ranking`` probabilities of all effects, ``unknown`` and ``nothing``; ``sets`` the sets thought of with
    their probabilities.
    """

    log: CalibrationLog
    verdict: str
    closing: Closing
    shares: tuple[Share, ...]
    effects: tuple[Found, ...]
    ranking: Mapping[str, float]
    sets: tuple[tuple[tuple[str, ...], float], ...]
    indistinguishable: tuple[tuple[str, ...], ...]
    nominal: Observation
    joint: Joint
    clocks: Mapping[str, Timing | None]
    shaking: Vibration | None
    leftover: str
    warnings: tuple[str, ...]
    raw: list[EffectSet]
    screen: Screen
    next_measurement: str | None = None
    next_run: NextRun | None = None

    def to_json_dict(self) -> dict:
        """``gap.json`` of the contract, and more beside it."""
        return {
            'verdict': self.verdict,
            'gap': {'before_m': self.closing.before_m, 'after_m': self.closing.after_m,
                    'noise_floor_m': self.closing.floor_m, 'held_out': self.closing.held_out,
                    'reduced_chi2_before': self.closing.before,
                    'reduced_chi2_after': self.closing.after},
            'where': [share.to_json_dict() for share in self.shares],
            'effects': [{'name': f.name, 'probability': f.probability, 'parameters': dict(f.parameters),
                         'sigma': dict(f.sigma), 'units': f.units, 'form': f.form, 'closes': f.closes,
                         'what': f.title, 'remedy': f.remedy} for f in self.effects],
            'indistinguishable': [list(group) for group in self.indistinguishable],
            'next_measurement': self.next_measurement,
            'next_run': self.next_run.to_json_dict() if self.next_run else None,
            'unknown': self.leftover or None,
            'ranking': dict(sorted(self.ranking.items(), key=lambda item: -item[1])),
            'sets': [{'names': list(names), 'probability': p} for names, p in self.sets],
            'errors': self.solution.to_json_dict()['errors'],
            'noise': {'position_repeatability_m': self.joint.noise.position,
                      'angle_repeatability_rad': self.joint.noise.angle,
                      'source': self.joint.noise.source},
            'warnings': list(self.warnings)}

    @cached_property
    def solution(self) -> Solution:
        """The 21 errors with the effects taken out, their uncertainty included."""
        return averaged_solution(self.joint, self.screen, self.raw[0])


def diagnose(log: CalibrationLog, effects: Iterable[Effect]) -> Diagnosis:
    """Diagnose one log against ``effects`` (one instance of each class)."""
    effects = {effect.name: effect for effect in effects}
    observation = observe(log)
    log, observation, clocks, late = _set_clocks(log, observation)
    distance = observation.view.distance.mean(axis=1)
    samples = unrest(log, observation.table, distance)
    coarse = np.concatenate([steps(log.displacement, observation.table, observation.table.displacement_rows),
                             steps(log.spot, observation.table, observation.table.spot_rows)])
    if coarse.any():
        observation = _with_steps(observation, coarse)
    observation = _with_unrest(observation, samples)
    hopping = hops(log.displacement, observation.table, distance)
    if hopping:
        observation = _with_hops(observation, hopping)
    joint, sets, screen = _settle(observation, effects)
    best = sets[0] if sets[0].log_bayes > ALARM else EffectSet((), 0.0)
    names, nothing, weights = probabilities(sets, len(effects) + 1, TEMPER)
    if not best.members:
        # Below the alarm nothing is claimed, whatever the odds between the sets say.
        joint = fit_jointly(observation, [], _noise(observation))
    how_far = closing(joint)
    found = [_found(name, effects[name], names.get(name, 0.0), joint)
             for name in dict.fromkeys(a.effect.name for a in joint.active) if name in best.key]
    beside = [*late, *([_shaking(effects, samples.displacement)] if samples.shakes else [])]
    outside = {f.name: f.probability for f in beside}
    found = sorted([*found, *beside], key=lambda f: -f.probability)
    # Of several patterns the first explains the most.
    leftover = next((screen.candidates[m.candidate].form.label for m in best.members if m.effect == UNKNOWN), '')
    leftover = (hopping.words if hopping else '') or _coarse(joint, coarse) or leftover or _restless(samples, names)
    if not leftover and not samples.shakes:
        evidence, words = excess_scatter(joint)
        allowed = SCATTER_ALARM + min(MISFIT * best.log_bayes, MISFIT_MOST)
        leftover = words if evidence > allowed and not _form_error(joint) else ''
        if not leftover and not found:
            evidence, words = excess_forecast(how_far, float(sum(joint.noise.dof)))
            leftover = words if evidence > SCATTER_ALARM else ''
    if leftover and UNKNOWN not in best.key:
        outside[UNKNOWN] = BEYOND_PATTERNS
    if found and not leftover and (how_far.left > LEAST_LEFT or how_far.after > GROSS**2):
        leftover = (f'{100.0 * how_far.left:.2g} % of the gap does not follow the forms known of what was named '
                    f'({np.sqrt(how_far.after):.2g} times the noise is left)')
    verdict = _verdict(found, leftover)
    groups = _confused(sets, best)
    known = {**effects, UNKNOWN: Beyond()}
    rivals = [_ways(screen, known, found, groups)
              for found in (best, *_stand_ins(sets, best)) if _foretells(screen, found)]
    words, run = advise(joint, rivals, groups, bool(leftover))
    return Diagnosis(log, verdict, how_far, shares(joint, found, bool(leftover)), tuple(found),
                     {**names, **outside, 'nothing': nothing * float(np.prod([1.0 - p for p in outside.values()]))},
                     tuple((tuple(sorted((*s.names, *outside))), w) for s, w in zip(sets, weights, strict=True))[:20],
                     groups, observation, joint, clocks, samples.displacement, leftover,
                     log.warnings + observation.table.warnings, sets, screen,
                     words, run)


def _noise(observation: Observation):
    return estimate_noise(observation.table, observation.log.description.noise,
                          observation.fit.arrival)


def _with_steps(observation: Observation, width: np.ndarray) -> Observation:
    """The observation with what readings that move in steps of ``width`` (c,) [m] round off as noise.

    Neighbours in time are mostly equal and tell nothing of the bins' noise: their whole scatter is taken for it.
    """
    log, table, beams = observation.log, observation.table, observation.fit.model.beams
    variance = np.concatenate([step_noise(log.displacement, table.displacement_rows, width[:beams]),
                               step_noise(log.spot, table.spot_rows, width[beams:])])
    scatter = np.sqrt(np.nanmean(observation.bins**2, axis=(0, 1)))
    return replace(observation, table=replace(table, disturbed=np.tile(variance, (len(table), 1))),
                   bin_sigma=np.where(width > 0.0, np.maximum(observation.bin_sigma, scatter), observation.bin_sigma))


def _with_unrest(observation: Observation, samples: Unrest) -> Observation:
    """The observation with what shakes or boils as noise of the displacement: else effects would be fitted
    to it.  Shaking hardly moves a dwell's mean; moving air does, and wanders from stop to stop."""
    table, beams = observation.table, observation.fit.model.beams
    if samples.boils:
        table = replace(table, wander=samples.power)
        # A part of a dwell has that of the e-folds between its length and the dwell's besides.
        more = samples.power[:, None] * np.log(observation.bins.shape[1])
    elif samples.shakes:
        length = float(np.median(table.done_ns - table.dwell_ns)) * 1e-9
        bins = observation.bins.shape[1]
        # A line fills no more than two of the bins' contrasts, with all its power.
        more = samples.displacement.variance(length / bins) * bins / 2.0
    else:
        return observation
    sigma = observation.bin_sigma.copy()
    sigma[:, :beams] = np.sqrt(sigma[:, :beams] ** 2 + more)
    return replace(observation, bin_sigma=sigma, table=table)


def _with_hops(observation: Observation, seen: Hops) -> Observation:
    """The observation with the unit of length as noise: in which unit a stop was read is not known.  Dwells
    with a step inside say nothing else."""
    table, beams = observation.table, observation.fit.model.beams
    bins, sigma = observation.bins.copy(), observation.bin_sigma.copy()
    bins[seen.rows, :, :beams] = np.nan
    sigma[:, :beams] = np.sqrt(sigma[:, :beams] ** 2 + seen.inside[:, None])
    return replace(observation, bins=bins, bin_sigma=sigma,
                   table=replace(table, hop=seen.step, hops_per_s=seen.per_s))


def _settle(observation: Observation,
            effects: Mapping[str, Effect]) -> tuple[Joint, list[EffectSet], Screen]:
    """Search and fit in turns until the chosen set stays the same."""
    joint = place_to_begin(fit_jointly(observation, [], _noise(observation)), effects)
    previous: tuple = ()
    for _ in range(ROUNDS):
        screen = _screen(joint, effects)
        screen = _sharpened(screen)
        sets = search(screen)
        decoys = [Candidate(UNKNOWN, name, form, decoy=True)
                  for name in sorted(sets[0].key & set(effects))
                  for form in effects[name].decoys(joint.observation.view)]
        if decoys:
            screen = screen.extended(decoys)
            sets = search(screen)
        best = sets[0] if sets[0].log_bayes > ALARM else EffectSet((), 0.0)
        chosen: list[tuple[Effect, Form]] = []
        for member in best.members:
            form = screen.candidates[member.candidate].form
            chosen.append((effects.get(member.effect, Effect()), form))
        identity = tuple(sorted((e.name, f.tuned_from or f.label) for e, f in chosen))
        if identity == previous:
            break
        previous = identity
        fitted = fit_jointly(joint.observation, chosen, joint.noise)
        if joint.active and misfit(fitted) > max(GROSS, misfit(joint)):
            # The search foretold from its place what the joint fit does not hold: what did hold is kept.
            screen = Screen(joint.parity, [Candidate(a.effect.name or UNKNOWN, '', a.form) for a in joint.active],
                            float(sum(joint.noise.dof)))
            return joint, search(screen), screen
        joint = fitted
        if not chosen:
            break
    return joint, sets, screen


def _screen(joint: Joint, effects: Mapping[str, Effect]) -> Screen:
    view = joint.observation.view
    candidates = []
    for effect in effects.values():
        if effect.needs_dwells and not joint.parity.dof[1]:
            continue
        candidates += [Candidate(effect.name, '', form) for form in effect.appearance(view)]
    tuned = [a for a in joint.active if a.form.tuned_from]
    candidates += [Candidate(a.effect.name, '', a.form) for a in tuned if a.effect.name]
    for family, forms in unknown_families(view).items():
        doubt = LEAN_DOUBT if family in LEAN else UNKNOWN_DOUBT
        candidates += [Candidate(UNKNOWN, family, form, doubt) for form in forms]
    for family, forms in beyond_families(view).items():
        # A form that was tuned from one of a family is one more of that, not a way of its own.
        labels = {form.label for form in forms}
        forms += [a.form for a in tuned if a.form.tuned_from in labels]
        candidates += [Candidate(UNKNOWN, family, form, BEYOND_DOUBT, own=True) for form in forms]
    stray = strays(joint)
    if stray:
        form, ways = stray
        candidates.append(Candidate(UNKNOWN, 'strays', form, LEAN_DOUBT + ways))
    named = [a for a in joint.active if a.effect.name]
    if named:
        candidates += [Candidate(UNKNOWN, 'inconsistent', form, UNKNOWN_DOUBT)
                       for form in inconsistent_forms(view, [a.form for a in named])]
    repeatable = frozenset(e.name for e in effects.values() if e.repeatable)
    in_dwells = frozenset(e.name for e in effects.values() if e.needs_dwells)
    return Screen(joint.parity, candidates, float(sum(joint.noise.dof)), repeatable, in_dwells)


def _sharpened(screen: Screen) -> Screen:
    """The screen with the best forms of the leading effects tuned: a coarse net of time constants must not
    make a mixture of two look better than the right one."""
    first = screen.by_effect()
    if not first:
        return screen
    leading = sorted(first.values(), key=lambda m: -m.log_bayes)[:TUNED]
    data, added = screen.parity.data, []
    for member in leading:
        candidate = screen.candidates[member.candidate]
        if member.log_bayes < ALARM or candidate.form.retune is None:
            continue

        def explained(form: Form) -> float:
            columns = screen.parity.project(form)
            along = columns.T @ data
            normal = columns.T @ columns + np.eye(columns.shape[1]) / width_of(form) ** 2
            return float(along @ np.linalg.solve(normal, along))

        form = tune(candidate.form, explained, close=0.01)
        if form is not candidate.form:
            added.append(replace(candidate, form=form))
    return screen.extended(added) if added else screen


def _form_error(joint: Joint) -> bool:
    """Whether what the effects leave is so small a part of what they explain that their forms may be to blame."""
    data, rest = joint.parity.data, unexplained(joint.parity, joint.active)
    left = float(rest @ rest) - sum(joint.parity.dof)
    return left < FORM_ERROR * float(data @ data - rest @ rest) and bool(joint.active)


# ---- the clocks -----------------------------------------------------------------------------------

def _set_clocks(log: CalibrationLog, observation: Observation):
    """Put right a sensor whose stamps are off; what was found out about both."""
    table = observation.table
    clocks = {'interferometer': timing(log.displacement, table, table.displacement, table.displacement_rows),
              'psd': timing(log.spot, table, table.spot, table.spot_rows)}
    skew = late_clocks(clocks, apart(log, table))
    if not skew:
        return log, observation, clocks, []
    parameters: dict[str, float] = {}
    sigma: dict[str, float] = {}
    stamped = log
    for sensor, late in skew.items():
        channel = 'spot' if sensor == 'psd' else 'displacement'
        stamped = replace(stamped, **{channel: put_right(getattr(stamped, channel), late, table.dwell_ns)})
        parameters[f'{sensor}_s'], sigma[f'{sensor}_s'] = late.offset, late.sigma
        if late.drift:
            parameters[f'{sensor}_drift_s'] = late.drift
    again = observe(stamped)
    before, after = (np.nanmean(o.fit.residual**2, axis=0) for o in (observation, again))
    if np.any(after > WORSE * before):
        return log, observation, clocks, []  # motion has come into the dwells: no clock was off by this
    found = Found('clock_skew', "A sensor's time stamps do not agree with the sequencer's.",
                  max(late.probability for late in skew.values()), parameters, sigma, 's',
                  'offset and drift' if any(late.drift for late in skew.values()) else 'constant offset',
                  1.0, 'Let all computers take their time from one source (PTP or NTP).')
    return stamped, again, clocks, [found]


def _coarse(joint: Joint, widths: np.ndarray) -> str:
    """Readings that move in steps so large that they matter against the noise of a stop; in words."""
    table, space, beams = joint.observation.table, joint.parity, joint.fit.model.beams
    variance = np.full(joint.fit.residual.size, np.nan)
    for white in space._white:
        variance[white.rows] = np.sum(white.factor**2, axis=1)
    variance = variance.reshape(joint.fit.residual.shape)
    if table.disturbed is not None:
        variance = variance - table.disturbed  # what they add is no noise to measure them by
    for k, width in enumerate(widths):
        own = variance[np.isfinite(variance[:, k]), k]
        share = width**2 / 12.0 / np.median(own) if width and len(own) else 0.0
        if len(table) / 4.0 * share**2 > ALARM:
            channel = 'displacement' if k < beams else ('spot_x', 'spot_y')[k - beams]
            return f'{channel}: readings move in steps of {width * 1e6:.3g} µm'
    return ''


def _restless(samples: Unrest, names: Mapping[str, float]) -> str:
    """Unrest inside the dwells that is no shaking of the tool point, in words."""
    if samples.boils:
        return ('displacement: slow random noise inside the dwells that grows with the path '
                f'(its power as path^{samples.growth:.1f}), as of moving air')
    if samples.hums and names.get('ambient_light', 0.0) < 0.5:
        return (f'spot: swings at {samples.spot.frequency:.3g} Hz (as sampled) inside the dwells, '
                'the displacement does not')
    return ''


# ---- what is said ---------------------------------------------------------------------------------

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
        widest = 0.99 * width_of(active.form) * active.form.scale
        for n, value, s, wide in zip(active.form.names, active.coefficients, sigma, widest, strict=True):
            if s < wide:
                parameters[n + suffix], spread[n + suffix] = float(value), float(s)
        parameters |= {k + suffix: float(v) for k, v in active.form.shape.items()}
        spread |= {k + suffix: float(v) for k, v in active.shape_sigma.items()}
    rest = unexplained(joint.parity, joint.active)
    without, left = float(np.sum((rest + sum(parts)) ** 2)), float(np.sum(rest**2))
    dof = float(sum(joint.parity.dof))
    # Within its own scatter the rest is noise; beyond, the floor is what noise alone would leave.
    floor = left if abs(left - dof) < 3.0 * np.sqrt(2.0 * dof) else min(dof, left)
    return Found(name, effect.title, probability, parameters, spread, mine[order[0]].form.units,
                 ' and '.join(mine[k].form.label for k in order),
                 float(np.clip((without - left) / max(without - floor, 1e-12), 0.0, 1.0)),
                 effect.remedy)


def _shaking(effects: Mapping[str, Effect], seen: Vibration) -> Found:
    effect = effects.get('vibration', Effect())
    probability = float(1.0 / (1.0 + np.exp(-min(seen.log_bayes, 30.0))))
    return Found('vibration', effect.title, probability,
                 {'frequency_Hz': seen.frequency, 'amplitude_m': seen.amplitude},
                 {'amplitude_m': seen.sigma}, 'm', 'a line in the spectrum of the dwells', seen.share,
                 effect.remedy)


def _verdict(found: list[Found], leftover: str) -> str:
    if not found and not leftover:
        return 'no_gap'
    if not found:
        return 'unexplained'
    return 'partly_explained' if leftover else 'explained'


def _stand_ins(sets: list[EffectSet], best: EffectSet) -> list[EffectSet]:
    """Sets nearly as good as the best with one member exchanged."""
    return [other for other in sets
            if len(other.key) == len(best.key) and len(best.key - other.key) == 1
            and UNKNOWN not in other.key and best.log_bayes - other.log_bayes < CONFUSED]


def _foretells(screen: Screen, found: EffectSet) -> bool:
    """Whether it is known what a set would do in a further run: a shapeless pattern's is not."""
    return all(m.effect != UNKNOWN or screen.candidates[m.candidate].own for m in found.members)


def _ways(screen: Screen, effects: Mapping[str, Effect], found: EffectSet,
          groups: Iterable[Iterable[str]]) -> Ways:
    """A set with the forms that the member which another may stand for can take nearly as well."""
    forms = [(effects[m.effect], screen.candidates[m.candidate].form) for m in found.members]
    doubtful = {name for group in groups for name in group}
    ways = [(found.log_bayes, forms)]
    for k, member in enumerate(found.members):
        rest = found.members[:k] + found.members[k + 1:]
        if member.effect not in doubtful or any(m.effect == member.effect for m in rest):
            continue
        numbers = [i for i, c in enumerate(screen.candidates) if c.effect == member.effect]
        judged = screen.judge_all(rest, numbers)
        # Of each kind of form one: time constants next to each other say the same.
        kinds = {kind(screen.candidates[i].form): i for i in sorted(numbers, key=lambda i: judged[i].log_bayes)}
        others = [i for name, i in reversed(kinds.items()) if name != kind(forms[k][1])]
        ways += [(found.log_bayes + judged[i].log_bayes - judged[member.candidate].log_bayes,
                  [*forms[:k], (effects[member.effect], screen.candidates[i].form), *forms[k + 1:]])
                 for i in others[:OTHER_WAYS]]
    shares = np.exp([BEYOND_LOG * (log - max(log for log, _ in ways)) for log, _ in ways])
    shares[shares < LEAST_WAY * shares.sum()] = 0.0
    return [(float(share), members) for share, (_, members) in zip(shares / shares.sum(), ways, strict=True) if share]


def _confused(sets: list[EffectSet], best: EffectSet) -> tuple[tuple[str, ...], ...]:
    """Groups of effects that may stand for each other."""
    merged: dict[str, set] = {}
    for other in _stand_ins(sets, best):
        for member in best.key - other.key:
            merged.setdefault(member, {member}).update(other.key - best.key)
    return tuple(tuple(sorted(g)) for g in merged.values())
