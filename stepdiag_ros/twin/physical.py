"""From what a log was fitted with to the parameters of an effect's physical face, along the log's own moves.

The simulator is made to move as the log did (:class:`~stepdiag_ros.twin.twin.Twin`), and the parameters are
those with which the effect does there, in parity space, what was fitted: stops' means and what changes inside the
stops.  So every effect is taken over alike, one of the user's own too.  The physical face is narrower than the forms;
what is lost is reported.
"""

from dataclasses import dataclass, field

import numpy as np

from stepdiag_ros.effects import all_effects
from stepdiag_ros.effects.base import Effect, Parameter
from stepdiag_ros.gap.diagnosis import COUNTS, STAMPS, Diagnosis, Found
from stepdiag_ros.gap.inference.joint import Active
from stepdiag_ros.twin.by_course import by_course
from stepdiag_ros.twin.formula import LOSS, SHOWS, Wanted, first_values, formula_of
from stepdiag_ros.twin.guess import Values
from stepdiag_ros.twin.lost_counts import lost_counts
from stepdiag_ros.twin.story import started, unknown_starts
from stepdiag_ros.twin.twin import Twin

LEAST_DONE = 0.1
"""Share of what was fitted that must be kept for an effect to be adopted."""


@dataclass(frozen=True)
class Physical:
    """Physical parameters of an effect (empty: not adopted), a note (empty: nothing is lost), what the log has of it at
    the stops ``besides`` (n, c) [m] what the simulator makes, the effect with these parameters where it acts there, and
    those of its formula, where another fit may begin."""

    values: Values
    note: str
    besides: np.ndarray
    effect: Effect | None = None
    formula: Values = field(default_factory=dict)


def physical(diagnosis: Diagnosis, found: Found, twin: Twin, moved: np.ndarray,
             near: Physical | None = None) -> Physical:
    """One effect in physical terms; ``moved`` (n, b, c) [m]: by how much less the twin makes of the log than the
    diagnosis' machine and its forms of other effects do; ``near``: the same as it was found in a twin that hardly
    differs."""
    nothing = np.zeros(diagnosis.nominal.view.reading.shape)
    if found.name == STAMPS:
        values = {sensor: found.parameters.get(f'{sensor}_s', 0.0) for sensor in ('interferometer', 'psd')}
        drifts = any(name.endswith('_drift_s') for name in found.parameters)
        return Physical(values, 'its drift in the course of the log is not adopted' if drifts else '', nothing)
    if found.name == 'vibration':
        amplitude = found.parameters['amplitude_m']
        return Physical({'amp': [amplitude] * 3, 'frequency': found.parameters['frequency_Hz'],
                         'amp2': [0.0] * 3, 'frequency2': 10.0},
                        'the laser sees the shaking along its beam only; taken as alike along X, Y, Z', nothing)
    active = [a for a in diagnosis.joint.active if a.effect.name == found.name]
    if found.name == COUNTS:
        values, effect = lost_counts(diagnosis, all_effects()[COUNTS], active, twin)
        return Physical(values, 'when it was lost is taken over, so that along other moves it is lost elsewhere'
                        if effect.course is not None else '', nothing, effect)
    if not active:
        return Physical({}, 'it was not fitted to the stops, so there is nothing to adopt', nothing)
    whole = sum(a.contribution for a in active)
    if active[0].effect.not_adopted:
        return Physical({}, active[0].effect.not_adopted, whole)
    return _fitted(diagnosis, active, twin, moved, near)


def _fitted(diagnosis: Diagnosis, active: list[Active], twin: Twin, moved: np.ndarray,
            near: Physical | None) -> Physical:
    space, effect = diagnosis.joint.parity, type(active[0].effect)
    wanted = Wanted.of(diagnosis, active, twin, moved)
    formula, left = formula_of(wanted, diagnosis, active, near.formula if near is not None else None)
    details = {p.name for p in effect.parameters if p.detail and not np.any(formula[p.name])}
    best, fitted = {name: value for name, value in formula.items() if name not in details}, effect(**formula)
    # Sizes that no such effect has are what a time constant needs to imitate another course.
    strange = not all(_plausible(p, formula[p.name]) for p in effect.parameters)
    if effect.course_of and (strange or left - wanted.noise > SHOWS**2):
        first = first_values(diagnosis, active)
        kept = {name: first[name] for name in effect.course_keeps}
        following = by_course(diagnosis.joint.observation, effect(**kept), twin, wanted.told(wanted.own), wanted.basis,
                              sum(a.contribution for a in active),
                              near.effect.course if near is not None and near.effect is not None else None)
        missing = wanted.missed(following)
        if missing @ missing < left + strange * SHOWS**2:
            best, fitted, left = kept | {'course': following.course.to_mapping()}, following, float(missing @ missing)
    done = 1.0 - (left - wanted.noise) / wanted.power
    if done < LEAST_DONE:
        return Physical({}, f'its physical face can do {100 * max(done, 0.0):.0f} % of what was fitted; not adopted',
                        sum(a.contribution for a in active))
    notes = [f'the simulator knows a simpler form of it; {100 * (1 - done):.0f} % of what was fitted is lost'] \
        if done < 1.0 - LOSS else []
    if fitted.course is not None:
        notes.append('it follows no formula; its course in time is taken over as a table')
    added = twin.adds(fitted)
    # Where it is the story that differs, the machine must not be made to imitate it.
    apart = sum(a.contribution for a in active) + (moved - added).mean(axis=1)
    before = started(unknown_starts(diagnosis.joint.observation.view), space, apart)
    seen = wanted.basis.T @ (wanted.rest + wanted.own - twin.projected(added[None])[:, 0])
    if seen @ seen > LOSS * float(wanted.target @ wanted.target):
        notes.append('how the axes came to the first stop of a setup is the log\'s own story: until each has moved '
                     'the simulator differs')
    notes += [f'{p.name} of {", ".join(f"{v:.3g}" for v in np.atleast_1d(best[p.name]))} {p.unit} is beyond what is '
              f'plausible ({p.low:g} … {p.high:g})'
              for p in effect.parameters if p.name in best and not _plausible(p, best[p.name])]
    return Physical({'file': effect.file, **best} if effect.file else best, '; '.join(notes), before, fitted, formula)


def _plausible(parameter: Parameter, value: object) -> bool:
    if isinstance(value, str):
        return True
    size = np.abs(np.asarray(value, float))
    if parameter.unit == 'm' and parameter.low > 0.0:    # a radius: the larger, the less is there
        return bool(np.all(1.5 * size >= parameter.low))
    return bool(np.all(size <= 1.5 * max(abs(parameter.low), abs(parameter.high))))
