"""A cell file from a diagnosis: the simulator that reproduces the log.

What was fitted is put into the words of the virtual cell: the errors as they were fitted (straightness
slopes of the carried axes counted as squareness, which is the same machine), misalignments, noise, the
times of the plan, and each effect with the parameters of its physical face
(:mod:`stepdiag_ros.twin.physical`).  A given cell is the base: whatever the log does not tell stays as
it is there.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import yaml

from stepdiag_ros.effects.base import Effect
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.enhanced import Fit
from stepdiag_ros.estimate.gauge import slope_weights
from stepdiag_ros.estimate.parameters import STATION
from stepdiag_ros.gap.diagnosis import Diagnosis, Found
from stepdiag_ros.gap.inference.averaged import averaged_fit
from stepdiag_ros.gap.inference.joint import inverse
from stepdiag_ros.gap.preprocess.observe import sane_fit
from stepdiag_ros.model.machine import CURVES
from stepdiag_ros.twin.formula import together
from stepdiag_ros.twin.physical import Physical, physical
from stepdiag_ros.twin.twin import Twin
from stepdiag_ros.virtual.cell import Cell, parse_cell

SQUARE_OF = {'EXY': ('EC0Y', -1.0), 'EXZ': ('EB0Z', 1.0), 'EYZ': ('EA0Z', -1.0)}
"""Straightness curve whose slope is a squareness error, and its sign."""
CLOSED = 1.05
"""Times the noise up to which an adopted simulator closes the gap."""
ROUNDS = 6
"""Turns of machine and effects at most."""
STEADY = 0.98
"""Turns end when the reduced χ² of what is left does not shrink below this share."""
RESET_S = 0.02
"""The simulator's time between in position and the first dwell of a run."""
FAST = 1000.0
"""Jerk [m/s³] high enough not to matter: a log tells how long moves take, hardly how they begin."""


class Adopted(NamedTuple):
    """The ``cell`` as a mapping for YAML; ``notes``: one line for all that has no counterpart there; run along the
    moves of the log: what the effects ``made`` there and what of the log is ``left`` (n, c) [m]."""

    cell: dict[str, Any]
    notes: tuple[str, ...]
    made: np.ndarray
    left: np.ndarray


def adopt(diagnosis: Diagnosis, base: Mapping[str, Any] | None = None) -> Adopted:
    """The simulator that gives the log again.

    ``base``: the cell file that the log was held against, as parsed.
    """
    log = diagnosis.log
    cell = dict(base) if base is not None else yaml.safe_load(log.description.to_yaml())
    cell.setdefault('schema', 1)
    cell.setdefault('seed', 1)
    # The plan runs the setups in the order in which the log did.
    order = list(dict.fromkeys(diagnosis.nominal.table.setup_names))
    cell['setups'] = {name: cell['setups'][name] for name in order if name in cell['setups']}
    cell['noise'] = _noise(diagnosis)
    if base is None:
        cell['motion'] = _motion(diagnosis)
        cell['air'] = _air(diagnosis)
        cell['sampling'] = _sampling(diagnosis)
    effects = dict(cell.get('effects') or {})
    for found in diagnosis.effects:
        if found.name in effects:
            raise StepdiagError(f'the cell has {found.name} already; take it out of the file that --cell '
                                'names, the diagnosis finds its whole size')
    fit, said, left, chi2 = _in_turn(diagnosis, cell, base)
    notes = [f'{name}: {one.note}' for name, one in said.items() if one.note]
    cell['effects'] = effects | {name: one.values for name, one in said.items() if one.values}
    cell['geometry'] = _geometry(fit)
    cell['misalignments'] = {'given': _misalignments(fit, base)}
    twin = Twin(diagnosis, _bare(cell, fit, base))
    times = float(np.sqrt(chi2))
    notes.append(f'run along the moves of the log this simulator leaves {times:.2f} times its noise at the '
                 f'stops (reduced chi2 {chi2:.2f})' + (
                     '; the gap is not closed by it: what is found is more than the simulator can be given'
                     if times > CLOSED else ''))
    if diagnosis.unmodelled:
        notes.append(f'not adopted, for it is unmodelled structure: {diagnosis.unmodelled}')
    if diagnosis.solution.unidentifiable:
        notes.append('directions that the log leaves open are held near zero: '
                     + ', '.join(sorted({n for u in diagnosis.solution.unidentifiable for n in u.names})[:8]))
    made = twin.adds(*_acting(said, diagnosis.effects)).mean(axis=1)
    return Adopted(cell, tuple(notes), made, left)


def _in_turn(diagnosis: Diagnosis, cell: Mapping[str, Any],
             base: Mapping[str, Any] | None) -> tuple[Fit, dict[str, Physical], np.ndarray, float]:
    """The machine, each effect in physical terms, and what they leave of the log (n, c) [m], with its reduced χ².

    What an effect does to a spot depends on where the spot is, and so on the misalignments: a large effect, or one of
    which a part was taken for a misalignment, moves these far, and machine and effects are found in turn until no less
    is left.
    """
    active = diagnosis.joint.active
    unnamed = sum(a.contribution for a in active if not a.effect.name)
    stated = averaged_fit(diagnosis.joint, diagnosis.screen, diagnosis.raw[0])[0]
    fit, best, said, first = diagnosis.joint.fit, None, {}, None
    for _ in range(ROUNDS):
        twin = Twin(diagnosis, _bare(cell, fit, base))
        if first is None:
            first = twin
            said = {name: Physical({}, '', np.zeros(twin.bare[:, 0].shape), effect, formula)
                    for name, (formula, effect) in together(diagnosis, twin).items()}
        for number, found in enumerate(diagnosis.effects):
            before, behind = (_acting(said, diagnosis.effects[part])
                              for part in (slice(number), slice(number + 1, None)))
            among = twin.beside(before, behind)
            others = {effect.name for effect in (*before, *behind)}
            by_forms = sum(a.contribution[:, None] + a.inside for a in active if a.effect.name in others)
            said[found.name] = physical(diagnosis, found, among, first.bare + by_forms - among.bare,
                                        said.get(found.name))
        acting = _acting(said, diagnosis.effects)
        taken = unnamed + twin.adds(*acting).mean(axis=1) + sum(one.besides for one in said.values())
        # Where tilts that hardly show move by milliradians, the machine as the forms had it does better.
        machines = (_machine_without(diagnosis, taken, stated), diagnosis.joint.fit)
        left, chi2, fit = min(((*Twin(diagnosis, _bare(cell, machine, base)).left(acting), machine)
                               for machine in machines), key=lambda turn: turn[1])
        earlier, best = best, min((fit, dict(said), left, chi2), best or (fit, dict(said), left, chi2),
                                  key=lambda turn: turn[3])
        if chi2 < 1.0 or (earlier is not None and chi2 > STEADY * earlier[3]):
            break
    return best


def _acting(said: Mapping[str, Physical], effects: Sequence[Found]) -> list[Effect]:
    acting = (said[found.name].effect for found in effects if found.name in said)
    return [effect for effect in acting if effect is not None]


def _bare(cell: Mapping[str, Any], fit: Fit, base: Mapping[str, Any] | None) -> Cell:
    """The simulator with the machine of a fit and without effects."""
    return parse_cell(yaml.safe_dump({**cell, 'effects': {}, 'geometry': _geometry(fit),
                                      'misalignments': {'given': _misalignments(fit, base)}}), 'adopted')


def _noise(diagnosis: Diagnosis) -> dict[str, float]:
    table, noise = diagnosis.nominal.table, diagnosis.joint.noise
    sample = {'displacement': table.displacement_scatter, 'spot': table.spot_scatter}
    believed = diagnosis.log.description.noise
    result = {name: float(np.sqrt(np.nanmean(v**2))) if np.isfinite(v).any() else getattr(believed, name)
              for name, v in sample.items()}
    return result | {'position_repeatability': float(noise.position),
                     'angle_repeatability': float(noise.angle)}


def _machine_without(diagnosis: Diagnosis, taken: np.ndarray, stated: Fit) -> Fit:
    """The machine fitted to the log less what the adopted effects will add, its 21 errors held to what the diagnosis
    has ``stated`` of them within their uncertainty.

    What a form and its physical counterpart differ by, in what a machine can imitate, must not be counted twice; nor
    may the machine be bent to make up for a counterpart that does less than the form: along directions that the log
    hardly settles that would be hundreds of micrometres.  With the data's normal matrix H about its own optimum θ
    and the stated errors e of covariance S the adopted unknowns are (H + S⁻¹)⁻¹ (H θ + S⁻¹ e).
    """
    joint, table = diagnosis.joint, diagnosis.joint.observation.table
    freed = replace(table, displacement=table.displacement - taken[:, :-2], spot=table.spot - taken[:, -2:])
    free = sane_fit(joint.observation.log, freed, joint.fit.theta, joint.noise)
    errors = slice(0, min(free.parameters.setup_first.values()))
    held = np.zeros_like(joint.normal)
    held[errors, errors] = inverse(stated.covariance[errors, errors])
    step = np.linalg.solve(joint.normal + held, held @ (stated.theta - free.theta))
    return replace(free, theta=free.theta + step)


def _geometry(fit: Fit) -> dict[str, Any]:
    """The fitted curves as they are; only slopes that are squareness by another name are counted there."""
    curves, square = {}, {}
    for name in CURVES:
        position = np.asarray(fit.parameters.knots[name])
        value = np.concatenate([[0.0], fit.theta[fit.parameters.slice(name)]])
        if name in SQUARE_OF:
            slope = float(slope_weights(position) @ value)
            value = value - slope * position
            error, sign = SQUARE_OF[name]
            square[error] = sign * slope
        if len(position) > 1:
            curves[name] = {'position': [float(p) for p in position], 'value': [float(v) for v in value]}
    return {'curves': curves, 'squareness': square}


def _misalignments(fit: Fit, base: Mapping[str, Any] | None) -> dict[str, Any]:
    known = ((base or {}).get('misalignments') or {}).get('given') or {}
    result = {}
    for name, first in fit.parameters.setup_first.items():
        if fit.parameters.unknowns[name] == STATION:
            result[name] = {'station': fit.model.station(fit.theta, fit.covariance, name)[0].tolist()}
            continue
        found = [float(a) for a in fit.theta[first:first + len(fit.parameters.unknowns[name])]]
        result[name] = {'laser': found[:2], 'mirror': found[2:]}
        if 'psd_zero' in known.get(name, {}):
            result[name]['psd_zero'] = known[name]['psd_zero']
    return result


def _motion(diagnosis: Diagnosis) -> dict[str, float]:
    """Dwell, feed and change of setup from the log's own times."""
    table = diagnosis.nominal.table
    dwell = float(np.median(table.done_ns - table.dwell_ns)) * 1e-9
    distance = np.linalg.norm(np.diff(table.commanded, axis=0), axis=1)
    within = (np.diff(table.run) == 0) & (distance > 0.0)
    took = (table.dwell_ns[1:] - table.done_ns[:-1])[within] * 1e-9
    feed, acceleration = _pace(distance[within], took)
    moves = distance / feed + feed / acceleration
    changes = np.flatnonzero(np.diff(table.setup) != 0)
    pause = (table.dwell_ns[changes + 1] - table.done_ns[changes]) * 1e-9 - moves[changes] - RESET_S
    return {'feed': feed, 'acceleration': acceleration, 'jerk': FAST, 'dwell': dwell,
            'in_position': 5.0e-8, 'settling': 0.0,
            'mount': max(0.0, float(np.median(pause))) if len(pause) else 0.0}


def _pace(distance: np.ndarray, took: np.ndarray) -> tuple[float, float]:
    """Feed [m/s] and acceleration [m/s²] of trapezoidal moves that take about as long: T = d/f + f/a."""
    if not len(took) or np.median(took) <= 0.0:
        return 0.1, 1.0
    # No move may take less than its distance at twice its mean speed: that is a triangle.
    design = np.column_stack([distance, np.ones_like(distance)])
    slope, rest = np.linalg.lstsq(design, took, rcond=None)[0]
    fastest = 1.9 * float(np.min(distance / took))
    feed = float(np.clip(1.0 / slope if slope > 0.0 else np.inf, 1.05 * np.max(distance / took) / 2.0, fastest)) \
        if fastest > 1.05 * np.max(distance / took) / 2.0 else fastest
    rest = max(float(np.mean(took - distance / feed)), 1e-3)
    return feed, feed / rest


def _air(diagnosis: Diagnosis) -> dict[str, Any]:
    """Air at the start and the sensors that there were; the instrument takes out what the log's did."""
    environment = diagnosis.log.environment
    result: dict[str, Any] = {'compensated': True, 'sensors': [], 'drift': {}}
    for key, topic, low, high in (('temperature', 'air_temperature', -20.0, 60.0),
                                  ('pressure', 'air_pressure', 5e4, 1.2e5), ('humidity', 'humidity', 0.0, 1.0)):
        series = environment.get(topic)
        if series is not None and len(series.value):
            result['sensors'].append(key)
            result[key] = float(np.clip(np.median(series.value[:9]), low, high))
    scales = [environment.get(f'scale_temperature/{axis}') for axis in 'xyz']
    if all(s is not None and len(s.value) for s in scales):
        result['sensors'].append('scale')
        result['scale_temperature'] = [float(np.median(s.value[:9])) for s in scales]
    return result


def _sampling(diagnosis: Diagnosis) -> dict[str, Any]:
    result: dict[str, Any] = {}
    log, table = diagnosis.log, diagnosis.nominal.table
    for key, samples in (('interferometer', log.displacement), ('psd', log.spot)):
        if len(samples) > 1:
            period = float(np.median(np.diff(samples.time_ns))) * 1e-9
            result[key] = float(np.clip(1.0 / max(period, 1e-6), 1.0, 50_000.0))
    inside = int(np.sum(table.displacement_rows[:, 1] - table.displacement_rows[:, 0]))
    result['in_motion'] = bool(len(log.displacement) > 1.2 * inside)
    return result
