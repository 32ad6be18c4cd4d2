"""From the forms that a log was fitted with to the parameters of an effect's physical face.

A form is what an effect leaves in a log, to first order and broad; the physical face is narrow on
purpose.  Where a fitted form says more than the physical face can hold, the nearest parameters are taken
and a note says what is lost; where nothing fits, the note says so and nothing is adopted.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stepdiag_ros.gap.diagnosis import Diagnosis, Found
from stepdiag_ros.gap.joint import Active
from stepdiag_ros.model.air import refractive_index
from stepdiag_ros.model.machine import CURVES, SQUARENESS

Values = dict[str, object]
LOSS = 0.05
"""Share of a fitted course or shape beyond which its loss is told."""


@dataclass(frozen=True)
class Physical:
    """Physical parameters of an effect (empty: not adopted), a note (empty: nothing is lost), and what the
    simulator will make of it at the log's stops (n, c) [m], to first order."""

    values: Values
    note: str
    contribution: np.ndarray


def physical(diagnosis: Diagnosis, found: Found, lead_s: float) -> Physical:
    """One effect in physical terms.

    ``lead_s``: seconds from the simulator's start, and from each mounting, to the first stop.
    """
    nothing = np.zeros(diagnosis.nominal.view.reading.shape)
    if found.name == 'clock_skew':
        values = {sensor: found.parameters.get(f'{sensor}_s', 0.0) for sensor in ('interferometer', 'psd')}
        drifts = any(name.endswith('_drift_s') for name in found.parameters)
        return Physical(values, 'its drift in the course of the log is not adopted' if drifts else '', nothing)
    if found.name == 'vibration':
        amplitude = found.parameters['amplitude_m']
        return Physical({'amp': [amplitude] * 3, 'frequency': found.parameters['frequency_Hz'],
                         'amp2': [0.0] * 3, 'frequency2': 10.0},
                        'the laser sees the shaking along its beam only; taken as alike along X, Y, Z', nothing)
    active = [a for a in diagnosis.joint.active if a.effect.name == found.name]
    if not active:
        return Physical({}, 'it was not fitted to the stops, so there is nothing to adopt', nothing)
    convert = _CONVERT.get(found.name)
    if convert is None:
        values, note = _by_name(active)
        return Physical(values, note, _sum(active))
    return convert(diagnosis, active, lead_s)


def _sum(active: list[Active]) -> np.ndarray:
    return sum(a.contribution for a in active)


def _values(a: Active) -> dict[str, float]:
    return {n: float(v) for n, v in zip(a.form.names, a.coefficients, strict=True)}


def _left_out(active: list[Active], why: str) -> Physical:
    return Physical({}, f'{why}; not adopted', _sum(active))


def _fitted(columns: np.ndarray, diagnosis: Diagnosis, target: np.ndarray) -> tuple[np.ndarray, float]:
    """Coefficients (k,) of ``columns`` (k, n, c) that come nearest to ``target`` (n, c) in parity space, and
    the share of the target's square there that they miss."""
    space = diagnosis.joint.parity
    design, wanted = space.stop_part(columns), space.stop_part(target[None])[:, 0]
    scale = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    coefficients = np.linalg.lstsq(design / scale, wanted, rcond=1e-10)[0] / scale
    left = wanted - design @ coefficients
    return coefficients, float(left @ left / max(wanted @ wanted, 1e-300))


def _lost(share: float, what: str) -> str:
    return f'{what}; {100 * share:.0f} % of what was fitted is lost' if share > LOSS else ''


def _by_name(active: list[Active]) -> tuple[Values, str]:
    """An effect of the user's own: parameters of equal name."""
    known = {p.name: p for p in active[0].effect.parameters}
    given = {n: v for a in active for n, v in (_values(a) | dict(a.form.shape)).items()}
    values = {n: v for n, v in given.items() if n in known and known[n].size == 1}
    if set(values) != set(known):
        return {}, (f'its form gives {", ".join(given)}, its physical face wants {", ".join(known)}; '
                    'there is no rule to turn one into the other; not adopted')
    return values, ''


# ---- machine --------------------------------------------------------------------------------------

def _backlash(diagnosis: Diagnosis, active: list[Active], lead_s: float) -> Physical:
    form, values = active[0].form, _values(active[0])
    # Where an axis stood before the log's first moves is the log's own story, not a parameter.
    starts = [i for i, n in enumerate(form.names) if 'at the start' in n]
    before = np.tensordot(active[0].coefficients[starts], form.columns[starts], axes=1)
    constant = np.tensordot(active[0].coefficients[:3], form.columns[:3], axes=1)
    whole = _sum(active) - before
    share = _fitted(constant[None], diagnosis, whole)[1]
    return Physical({'B': [values.get(axis, 0.0) for axis in 'XYZ']}, _lost(
        share, 'a reversal error that changes along the axis has no counterpart, the simulator\'s is '
        'the same everywhere'), constant + before)


def _settling(diagnosis: Diagnosis, active: list[Active], lead_s: float) -> Physical:
    values, shape = _values(active[0]), active[0].form.shape
    if 'tau_s' not in shape:
        return _left_out(active, 'several time constants at once have no counterpart')
    if 'all' in values:
        return Physical({'amp': values['all'], 'tau': shape['tau_s']}, '', _sum(active))
    return Physical({'amp': float(np.mean([values[a] for a in 'XYZ'])), 'tau': shape['tau_s']},
                    'the axes creep by different amounts; the simulator knows one, their mean was taken',
                    _sum(active))


def _coupling(diagnosis: Diagnosis, active: list[Active], lead_s: float) -> Physical:
    """One error motion by one other axis: the pair that comes nearest."""
    view, whole = diagnosis.nominal.view, _sum(active)
    share = view.commanded / np.array(view.description.machine.volume)
    best: tuple[float, Values, np.ndarray] = (np.inf, {}, whole)
    for motion, name in enumerate(CURVES):
        own = motion // 6
        for other in (k for k in range(3) if k != own):
            for power in (1.0, 2.0):
                product = share[:, own] * share[:, other]**power
                column = product[:, None] * view.by_motion[motion]
                size, missed = _fitted(column[None], diagnosis, whole)
                if missed < best[0] - 1e-9:
                    best = (missed, {'motion': name, 'by': 'XYZ'[other], 'amp': float(size[0]),
                                     'power': power}, size[0] * column)
    return Physical(best[1], _lost(best[0], 'the simulator bends one error motion by one other axis'), best[2])


# ---- mirror and detector --------------------------------------------------------------------------

def _nearest(diagnosis: Diagnosis, active: list[Active], columns: np.ndarray,
             note: str) -> tuple[np.ndarray, str, np.ndarray]:
    """Coefficients of physical ``columns``, what is lost, and what they add."""
    sizes, share = _fitted(columns, diagnosis, _sum(active))
    return sizes, _lost(share, note), np.tensordot(sizes, columns, axes=1)


def _mirror(diagnosis: Diagnosis, active: list[Active], lead_s: float) -> Physical:
    view, effect = diagnosis.joint.observation.view, active[0].effect
    u, v = view.strike[..., 0], view.strike[..., 1]
    columns = np.stack([effect._column(view, 0.5 * (u * u + v * v), u, v),
                        effect._column(view, 0.5 * (u * u - v * v), u, -v)])
    if active[0].form.names == ('curvature',):
        columns = columns[:1]
    sizes, note, added = _nearest(diagnosis, active, columns,
                                  'the simulator\'s mirror has a radius and an astigmatism along u and v only')
    mean, apart = sizes[0], sizes[1] if len(sizes) > 1 else 0.0
    if mean == 0.0:
        return _left_out(active, 'the fitted shape has no mean curvature')
    return Physical({'radius': float(1.0 / mean), 'astigmatism': float(apart / mean)}, note, added)


def _zero(diagnosis: Diagnosis, active: list[Active], lead_s: float) -> Physical:
    columns = diagnosis.nominal.view.zeros(2)
    beams = diagnosis.nominal.view.beams
    columns[0, :, beams] = columns[1, :, beams + 1] = 1.0
    (x, y), note, added = _nearest(diagnosis, active, columns,
                                   'the zero differs from setup to setup; one for all was taken')
    return Physical({'x': float(x), 'y': float(y)}, note, added)


def _gain(diagnosis: Diagnosis, active: list[Active], lead_s: float) -> Physical:
    view = diagnosis.joint.observation.view
    columns = view.zeros(2)
    columns[0, :, view.beams], columns[1, :, view.beams + 1] = view.spot_model.T
    (x, y), note, added = _nearest(diagnosis, active, columns, 'a gain that changes has no counterpart')
    return Physical({'x': float(x), 'y': float(y)}, note, added)


def _bend(diagnosis: Diagnosis, active: list[Active], lead_s: float) -> Physical:
    view = diagnosis.joint.observation.view
    x, y = view.spot_model.T
    columns = view.zeros(2)
    columns[0, :, view.beams], columns[0, :, view.beams + 1] = x * (x * x + y * y), y * (x * x + y * y)
    columns[1, :, view.beams], columns[1, :, view.beams + 1] = -x * y * y, -y * x * x
    (k3, crossed), note, added = _nearest(diagnosis, active, columns,
                                          'the simulator\'s detector bends with the third power alone')
    return Physical({'k3': float(k3), 'cross': float(crossed / k3) if k3 else 0.0}, note, added)


def _rotation(diagnosis: Diagnosis, active: list[Active], lead_s: float) -> Physical:
    view, angle = diagnosis.joint.observation.view, float(active[0].coefficients[0])
    # The form is a turn to first order; the simulator's is a whole one.
    added = view.zeros(1)[0]
    cosine, sine = np.cos(angle), np.sin(angle)
    added[:, view.beams:] = view.spot_model @ np.array([[cosine - 1.0, sine], [-sine, cosine - 1.0]])
    return Physical({'angle': angle}, '', added)


# ---- laser ----------------------------------------------------------------------------------------

def _swing(diagnosis: Diagnosis, active: list[Active], lead_s: float) -> Physical:
    return _left_out(active, 'its phase is counted from each run\'s reset, which the simulator places elsewhere')


def _slip(diagnosis: Diagnosis, active: list[Active], lead_s: float) -> Physical:
    """The simulator counts moves: one at power-up, one for each mounting, one for each stop."""
    if len(active) > 1:
        return _left_out(active, 'the laser lost count more than once, the simulator knows one slip')
    table, shape = diagnosis.nominal.table, active[0].form.shape
    stop = int(np.flatnonzero((table.run == shape['run']) & (table.index == shape['index']))[0])
    mountings = 1 + int(np.sum(np.diff(table.setup[:stop + 1]) != 0))
    return Physical({'jump': float(active[0].coefficients[0]), 'arrival': float(stop + mountings + 1)}, '',
                    _sum(active))


# ---- what follows the clock -----------------------------------------------------------------------

TAUS = np.geomspace(0.02, 50.0, 60)
"""Time constants tried, in lengths of the log; the longest is a straight line."""
GLASS = 8e-6
"""Expansion of a glass scale [1/K], by which a growth is said as a temperature."""


def _exponential(diagnosis: Diagnosis, active: list[Active], signature: np.ndarray, since: np.ndarray,
                 lead_s: float) -> tuple[np.ndarray, float, float, np.ndarray]:
    """Amounts (m,) of 1 − exp(−t/τ) times ``signature`` (m, n, c), reached in the end and counted from the
    simulator's start; τ [s]; share missed; what it adds, its beginning before the first stop included."""
    whole = _sum(active)

    def tried(tau: float) -> tuple[float, np.ndarray]:
        grown = 1.0 - np.exp(-since / tau)
        sizes, missed = _fitted(grown[None, :, None] * signature, diagnosis, whole)
        return missed, sizes

    shape = active[0].form.shape
    if len(active) == 1 and 'tau_s' in shape:
        tau = float(shape['tau_s'])
    else:
        span = max(float(since.max()), 1.0)
        tau = min((tried(span * f)[0], span * f) for f in TAUS)[1]
    missed, sizes = tried(tau)
    # In the simulator the course began lead_s before the first stop; what came before is a constant there.
    sizes = sizes * np.exp(lead_s / tau)
    grown = 1.0 - np.exp(-(since + lead_s) / tau)
    return sizes, float(tau), missed, np.tensordot(sizes, grown[None, :, None] * signature, axes=1)


def _course(diagnosis: Diagnosis, active: list[Active], signature: np.ndarray, lead_s: float) -> Physical:
    """An effect with the parameters ``amp`` and ``tau``."""
    time = diagnosis.nominal.view.time
    sizes, tau, share, added = _exponential(diagnosis, active, signature, time - time.min(), lead_s)
    return Physical({'amp': sizes.tolist(), 'tau': tau}, _lost(share, ONE_COURSE), added)


ONE_COURSE = 'the simulator\'s course is one exponential'


def _structure(diagnosis: Diagnosis, active: list[Active], lead_s: float) -> Physical:
    return _course(diagnosis, active, diagnosis.joint.observation.view.by_shift, lead_s)


def _pointing(diagnosis: Diagnosis, active: list[Active], lead_s: float) -> Physical:
    return _course(diagnosis, active, diagnosis.joint.observation.view.by_laser, lead_s)


def _squareness(diagnosis: Diagnosis, active: list[Active], lead_s: float) -> Physical:
    view = diagnosis.joint.observation.view
    signature = np.stack([active[0].effect._column(view, name) for name in SQUARENESS])
    return _course(diagnosis, active, signature, lead_s)


def _creep(diagnosis: Diagnosis, active: list[Active], lead_s: float) -> Physical:
    view = diagnosis.joint.observation.view
    sizes, tau, share, added = _exponential(diagnosis, active, view.by_mirror, view.mount_time, lead_s)
    return Physical({'amp': sizes.tolist(), 'tau': tau, 'spread': 0.0}, _lost(
        share, 'the simulator\'s mount creeps alike after each mounting, along one exponential'), added)


def _scales(diagnosis: Diagnosis, active: list[Active], lead_s: float) -> Physical:
    view = diagnosis.joint.observation.view
    growth = view.commanded.T[:, :, None] * view.by_shift
    sizes, tau, share, added = _exponential(diagnosis, active, growth, view.time - view.time.min(), lead_s)
    return Physical({'alpha': [GLASS] * 3, 'dT': (sizes / GLASS).tolist(), 'tau': tau},
                    _lost(share, ONE_COURSE + ', from each axis\'s zero'), added)


def _air(diagnosis: Diagnosis, active: list[Active], lead_s: float) -> Physical:
    view = diagnosis.joint.observation.view
    signature = view.zeros(1)
    signature[0, :, :view.beams] = view.distance
    sizes, tau, share, added = _exponential(diagnosis, active, signature, view.time - view.time.min(), lead_s)
    kelvin = (refractive_index(21.0, 101325.0, 0.5) / refractive_index(20.0, 101325.0, 0.5)) - 1.0
    return Physical({'dT': float(sizes[0] / kelvin), 'dP': 0.0, 'tau': tau},
                    _lost(share, ONE_COURSE + ', all of it said as a temperature'), added)


def _light(diagnosis: Diagnosis, active: list[Active], lead_s: float) -> Physical:
    return _left_out(active, 'its course in time is free in the fit and a slow sine in the simulator')


_CONVERT: dict[str, Callable[[Diagnosis, list[Active], float], Physical]] = {
    'backlash': _backlash, 'servo_settling': _settling, 'non_rigid_coupling': _coupling,
    'mirror_curvature': _mirror, 'psd_zero_offset': _zero, 'psd_gain': _gain, 'psd_nonlinearity': _bend,
    'psd_rotation': _rotation, 'cyclic_nonlinearity': _swing, 'count_slip': _slip,
    'structural_thermal_drift': _structure, 'beam_pointing_drift': _pointing, 'mirror_mount_creep': _creep,
    'scale_thermal_expansion': _scales, 'squareness_drift': _squareness, 'air_refraction_drift': _air,
    'ambient_light': _light}
