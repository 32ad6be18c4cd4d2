"""From a log to its diagnosis: where the gap lies, which effect causes it, how far it closes.

The steps, each in a file of its own: :mod:`observe` (reduce, fit), :mod:`inside` (samples: vibration,
clocks), :mod:`parity` and :mod:`search` (evidence for sets of effects), :mod:`joint` (machine and
effects together), :mod:`closing` (the part held out), :mod:`where` (shares).  Search and joint fit
take turns until the set of effects stands.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from stepdiag_ros.effects.base import Effect, Form
from stepdiag_ros.effects.tuning import tune
from stepdiag_ros.estimate.noise import estimate_noise
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.gap.beyond import beyond_families
from stepdiag_ros.gap.closing import Closing, closing, excess_forecast
from stepdiag_ros.gap.evidence import SIZES
from stepdiag_ros.gap.inside import Timing, Vibration, steps, timing, vibration
from stepdiag_ros.gap.joint import Joint, fit_jointly, freed_solution, unexplained
from stepdiag_ros.gap.next_measurement import advise
from stepdiag_ros.gap.observe import Observation, observe
from stepdiag_ros.gap.scatter import excess_scatter
from stepdiag_ros.gap.search import Candidate, EffectSet, Screen, probabilities, search
from stepdiag_ros.gap.thresholds import (
    ALARM,
    BEYOND_DOUBT,
    CLOCK_SIGMAS,
    CONFUSED,
    LEAN_DOUBT,
    LEAST_CLOCK_S,
    MISFIT,
    MISFIT_MOST,
    SCATTER_ALARM,
    TEMPER,
    UNKNOWN_DOUBT,
    VIBRATION_ALARM,
)
from stepdiag_ros.gap.unknown import LEAN, inconsistent_forms, unknown_families
from stepdiag_ros.gap.unknown import NAME as UNKNOWN
from stepdiag_ros.gap.where import Share, shares
from stepdiag_ros.model.log import CalibrationLog, Samples

ROUNDS = 4
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
            'unknown': self.leftover or None,
            'ranking': dict(sorted(self.ranking.items(), key=lambda item: -item[1])),
            'sets': [{'names': list(names), 'probability': p} for names, p in self.sets],
            'errors': self.solution.to_json_dict()['errors'],
            'noise': {'position_repeatability_m': self.joint.noise.position,
                      'angle_repeatability_rad': self.joint.noise.angle,
                      'source': self.joint.noise.source},
            'warnings': list(self.warnings)}

    @property
    def solution(self) -> Solution:
        """The 21 errors with the effects taken out, their uncertainty included."""
        return freed_solution(self.joint)


def diagnose(log: CalibrationLog, effects: Iterable[Effect]) -> Diagnosis:
    """Diagnose one log against ``effects`` (one instance of each class)."""
    effects = {effect.name: effect for effect in effects}
    observation = observe(log)
    log, observation, clocks, late = _set_clocks(log, observation)
    shaking = vibration(log, observation.table)
    joint, sets, screen = _settle(observation, effects)
    best = sets[0] if sets[0].log_bayes > ALARM else EffectSet((), 0.0)
    names, nothing, weights = probabilities(sets, len(effects) + 1, TEMPER)
    if not best.members:
        # Below the alarm nothing is claimed, whatever the odds between the sets say.
        joint = fit_jointly(observation, [], _noise(observation))
    how_far = closing(joint)
    found = [_found(name, effects[name], names.get(name, 0.0), joint)
             for name in dict.fromkeys(a.effect.name for a in joint.active) if name]
    if late:
        found += late
        names = {**names, 'clock_skew': late[0].probability}
    if shaking and shaking.log_bayes > VIBRATION_ALARM:
        found.append(_shaking(effects, shaking))
        names = {**names, 'vibration': found[-1].probability}
    found = sorted(found, key=lambda f: -f.probability)
    # Of several patterns the first explains the most.
    leftover = next((screen.candidates[m.candidate].form.label for m in best.members if m.effect == UNKNOWN), '')
    leftover = leftover or _coarse(joint)
    if not leftover and not (shaking and shaking.log_bayes > VIBRATION_ALARM):
        evidence, words = excess_scatter(joint)
        allowed = SCATTER_ALARM + min(MISFIT * best.log_bayes, MISFIT_MOST)
        leftover = words if evidence > allowed else ''
        if not leftover and not found:
            evidence, words = excess_forecast(how_far, float(sum(joint.noise.dof)))
            leftover = words if evidence > SCATTER_ALARM else ''
    verdict = _verdict(found, leftover)
    groups = _confused(sets, best)
    forms = {m.effect: screen.candidates[m.candidate].form for s in sets for m in s.members}
    return Diagnosis(log, verdict, how_far, shares(joint, observation, found), tuple(found),
                     {**names, 'nothing': nothing},
                     tuple((s.names, w) for s, w in zip(sets, weights, strict=True))[:20],
                     groups, observation, joint, clocks, shaking, leftover,
                     log.warnings + observation.table.warnings, sets, screen,
                     advise(joint, groups, effects, forms, bool(leftover)))


def _noise(observation: Observation):
    return estimate_noise(observation.table, observation.log.description.noise,
                          observation.fit.arrival)


def _settle(observation: Observation,
            effects: Mapping[str, Effect]) -> tuple[Joint, list[EffectSet], Screen]:
    """Search and fit in turns until the chosen set stays the same."""
    joint = fit_jointly(observation, [], _noise(observation))
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
        start = joint.observation
        joint = fit_jointly(start, chosen, joint.noise)
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
    for a in joint.active:
        if a.form.tuned_from:
            candidates.append(Candidate(a.effect.name, '', a.form) if a.effect.name
                              else Candidate(UNKNOWN, 'tuned', a.form, BEYOND_DOUBT))
    for family, forms in unknown_families(view).items():
        doubt = LEAN_DOUBT if family in LEAN else UNKNOWN_DOUBT
        candidates += [Candidate(UNKNOWN, family, form, doubt) for form in forms]
    for family, forms in beyond_families(view).items():
        candidates += [Candidate(UNKNOWN, family, form, BEYOND_DOUBT) for form in forms]
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
            normal = columns.T @ columns + np.eye(columns.shape[1]) / SIZES[-1] ** 2
            return float(along @ np.linalg.solve(normal, along))

        form = tune(candidate.form, explained, close=0.01)
        if form is not candidate.form:
            added.append(Candidate(candidate.effect, candidate.family, form))
    return screen.extended(added) if added else screen


# ---- the clocks -----------------------------------------------------------------------------------

def _set_clocks(log: CalibrationLog, observation: Observation):
    """Put right a sensor whose stamps are off; what was found out about both."""
    clocks = {'interferometer': timing(log.displacement, observation.table,
                                       observation.table.displacement),
              'psd': timing(log.spot, observation.table, observation.table.spot)}
    late = []
    skew = _skew(clocks)
    for sensor, (offset, sigma, probability) in skew.items():
        shift = int(round(offset * 1e9))
        if sensor == 'psd':
            log = replace(log, spot=_shifted(log.spot, shift))
        else:
            log = replace(log, displacement=_shifted(log.displacement, shift))
        late.append(Found('clock_skew', "A sensor's time stamps do not agree with the sequencer's.",
                          probability, {f'{sensor}_s': offset}, {f'{sensor}_s': sigma}, 's',
                          'constant offset', 1.0,
                          'Let all computers take their time from one source (PTP or NTP).'))
    if skew:
        observation = observe(log)
    return log, observation, clocks, late


def _skew(clocks: Mapping[str, Timing | None]) -> dict[str, tuple[float, float, float]]:
    """Sensors whose stamps are provably off: offset, its σ [s], probability.

    A move's middle may be seen off by half of what the control takes to start and to report in
    position; what a sensor sees before the command or after the report cannot be explained so.
    """
    found = {}
    both = [t for t in clocks.values() if t is not None]
    for sensor, seen in clocks.items():
        if seen is None:
            continue
        significant = abs(seen.offset) > max(CLOCK_SIGMAS * seen.sigma, LEAST_CLOCK_S)
        acausal = seen.before > 0.2 if seen.offset < 0 else seen.after > 0.2
        others = [t for t in both if t is not seen]
        apart = bool(others) and abs(seen.offset - others[0].offset) > max(
            CLOCK_SIGMAS * np.hypot(seen.sigma, others[0].sigma), LEAST_CLOCK_S) and \
            abs(seen.offset) > abs(others[0].offset)
        if significant and (acausal or apart):
            found[sensor] = (seen.offset, seen.sigma, 0.99 if acausal and apart else 0.95)
    return found


def _shifted(samples: Samples, shift_ns: int) -> Samples:
    return replace(samples, time_ns=samples.time_ns - shift_ns)


def _coarse(joint: Joint) -> str:
    """Readings that move in steps so large that they matter against the noise of a stop; in words."""
    log, table, space = joint.observation.log, joint.observation.table, joint.parity
    beams = joint.fit.model.beams
    widths = np.concatenate([steps(log.displacement, table, table.displacement_rows),
                             steps(log.spot, table, table.spot_rows)])
    variance = np.full(joint.fit.residual.size, np.nan)
    for white in space._white:
        variance[white.rows] = np.sum(white.factor**2, axis=1)
    variance = variance.reshape(joint.fit.residual.shape)
    for k, width in enumerate(widths):
        own = variance[np.isfinite(variance[:, k]), k]
        share = width**2 / 12.0 / np.median(own) if width and len(own) else 0.0
        if len(table) / 4.0 * share**2 > ALARM:
            channel = 'displacement' if k < beams else ('spot_x', 'spot_y')[k - beams]
            return f'{channel}: readings move in steps of {width * 1e6:.3g} µm'
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
        widest = 0.99 * SIZES[-1] * active.form.scale
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
    probability = float(1.0 / (1.0 + np.exp(-(seen.log_bayes - VIBRATION_ALARM))))
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


def _confused(sets: list[EffectSet], best: EffectSet) -> tuple[tuple[str, ...], ...]:
    """Groups of effects that may stand for each other: sets nearly as good with one member exchanged."""
    groups = []
    for other in sets:
        if len(other.key) != len(best.key) or other.key == best.key or UNKNOWN in other.key:
            continue
        away, instead = best.key - other.key, other.key - best.key
        if len(away) == len(instead) == 1 and best.log_bayes - other.log_bayes < CONFUSED:
            groups.append(tuple(sorted((*away, *instead))))
    merged: dict[str, set] = {}
    for group in groups:
        for member in best.key & set(group):
            merged.setdefault(member, set()).update(group)
    return tuple(tuple(sorted(g)) for g in merged.values())
