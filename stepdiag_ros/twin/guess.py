"""Where to begin: rough parameters of an effect's physical face, from the forms that a log was fitted with.

A form is what an effect leaves in a log, to first order and broad; the physical face is narrow on purpose.  These are
first guesses, refined along the log's own moves (:mod:`stepdiag_ros.twin.physical`).
"""

from collections.abc import Callable

import numpy as np

from stepdiag_ros.gap.diagnosis import Diagnosis
from stepdiag_ros.gap.inference.joint import Active
from stepdiag_ros.model.air import refractive_index
from stepdiag_ros.model.machine import CURVES, SQUARENESS

Values = dict[str, object]
TAUS = np.geomspace(0.02, 50.0, 60)
"""Time constants tried, in lengths of the log; the longest is a straight line."""
GLASS = 8e-6
"""Expansion of a glass scale [1/K], by which a growth is said as a temperature."""


def guess(diagnosis: Diagnosis, active: list[Active]) -> Values:
    """Parameters by name, as far as the forms tell them; those of an effect of the user's own are left to the fit."""
    rule = _RULES.get(active[0].effect.name)
    return rule(diagnosis, active) if rule else {}


def _sum(active: list[Active]) -> np.ndarray:
    return sum(a.contribution for a in active)


def _values(a: Active) -> dict[str, float]:
    return {n: float(v) for n, v in zip(a.form.names, a.coefficients, strict=True)}


def _fitted(columns: np.ndarray, diagnosis: Diagnosis, target: np.ndarray) -> tuple[np.ndarray, float]:
    """Coefficients (k,) of ``columns`` (k, n, c) that come nearest to ``target`` (n, c) in parity space, and
    the share of the target's square there that they miss."""
    space = diagnosis.joint.parity
    design, wanted = space.stop_part(columns), space.stop_part(target[None])[:, 0]
    scale = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    coefficients = np.linalg.lstsq(design / scale, wanted, rcond=1e-10)[0] / scale
    left = wanted - design @ coefficients
    return coefficients, float(left @ left / max(wanted @ wanted, 1e-300))


# ---- machine --------------------------------------------------------------------------------------

def _backlash(diagnosis: Diagnosis, active: list[Active]) -> Values:
    values = _values(active[0])
    return {'B': [max(values.get(axis, 0.0), 0.0) for axis in 'XYZ']}


def _settling(diagnosis: Diagnosis, active: list[Active]) -> Values:
    values, shape = _values(active[0]), active[0].form.shape
    sizes = [values[a] for a in ('all', *'XYZ') if a in values]
    return {'amp': float(np.mean(sizes)), 'tau': shape['tau_s']} if sizes and 'tau_s' in shape else {}


def _coupling(diagnosis: Diagnosis, active: list[Active]) -> Values:
    """One error motion by one other axis: the pair that comes nearest."""
    view, whole = diagnosis.nominal.view, _sum(active)
    share = view.commanded / np.array(view.description.machine.volume)
    best: tuple[float, Values] = (np.inf, {})
    for motion, name in enumerate(CURVES):
        own = motion // 6
        for other in (k for k in range(3) if k != own):
            for power in (1.0, 2.0):
                product = share[:, own] * share[:, other]**power
                size, missed = _fitted((product[:, None] * view.by_motion[motion])[None], diagnosis, whole)
                if missed < best[0] - 1e-9:
                    best = missed, {'motion': name, 'by': 'XYZ'[other], 'amp': float(size[0]), 'power': power}
    return best[1]


# ---- mirror and detector --------------------------------------------------------------------------

def _mirror(diagnosis: Diagnosis, active: list[Active]) -> Values:
    view, effect = diagnosis.joint.observation.view, active[0].effect
    u, v = view.strike[..., 0], view.strike[..., 1]
    columns = np.stack([effect._column(view, 0.5 * (u * u + v * v), u, v),
                        effect._column(view, 0.5 * (u * u - v * v), u, -v)])
    if active[0].form.names == ('curvature',):
        columns = columns[:1]
    sizes = _fitted(columns, diagnosis, _sum(active))[0]
    mean, apart = sizes[0], sizes[1] if len(sizes) > 1 else 0.0
    return {'radius': float(1.0 / mean), 'astigmatism': float(apart / mean)} if mean else {}


def _zero(diagnosis: Diagnosis, active: list[Active]) -> Values:
    columns = diagnosis.nominal.view.zeros(2)
    beams = diagnosis.nominal.view.beams
    columns[0, :, beams] = columns[1, :, beams + 1] = 1.0
    return dict(zip('xy', _fitted(columns, diagnosis, _sum(active))[0].tolist(), strict=True))


def _gain(diagnosis: Diagnosis, active: list[Active]) -> Values:
    view = diagnosis.joint.observation.view
    columns = view.zeros(2)
    columns[0, :, view.beams], columns[1, :, view.beams + 1] = view.spot_model.T
    return dict(zip('xy', _fitted(columns, diagnosis, _sum(active))[0].tolist(), strict=True))


def _bend(diagnosis: Diagnosis, active: list[Active]) -> Values:
    view = diagnosis.joint.observation.view
    x, y = view.spot_model.T
    columns = view.zeros(2)
    columns[0, :, view.beams], columns[0, :, view.beams + 1] = x * (x * x + y * y), y * (x * x + y * y)
    columns[1, :, view.beams], columns[1, :, view.beams + 1] = -x * y * y, -y * x * x
    k3, crossed = _fitted(columns, diagnosis, _sum(active))[0]
    return {'k3': float(k3), 'cross': float(crossed / k3) if k3 else 0.0}


def _rotation(diagnosis: Diagnosis, active: list[Active]) -> Values:
    return {'angle': float(active[0].coefficients[0])}


# ---- laser ----------------------------------------------------------------------------------------

def _slip(diagnosis: Diagnosis, active: list[Active]) -> Values:
    """The simulator counts moves: one at power-up, one for each mounting, one for each stop."""
    table, shape = diagnosis.nominal.table, active[0].form.shape
    stop = int(np.flatnonzero((table.run == shape['run']) & (table.index == shape['index']))[0])
    mountings = 1 + int(np.sum(np.diff(table.setup[:stop + 1]) != 0))
    return {'jump': float(active[0].coefficients[0]), 'arrival': float(stop + mountings + 1)}


# ---- what follows the clock -----------------------------------------------------------------------

def _exponential(diagnosis: Diagnosis, active: list[Active], signature: np.ndarray,
                 since: np.ndarray) -> tuple[np.ndarray, float]:
    """Amounts (m,) of 1 − exp(−t/τ) times ``signature`` (m, n, c), reached in the end; τ [s]."""
    whole = _sum(active)

    def tried(tau: float) -> tuple[float, np.ndarray]:
        grown = 1.0 - np.exp(-since / tau)
        sizes, missed = _fitted(grown[None, :, None] * signature, diagnosis, whole)
        return missed, sizes

    shape = active[0].form.shape
    span = max(float(since.max()), 1.0)
    tau = float(shape['tau_s']) if len(active) == 1 and 'tau_s' in shape else \
        min((tried(span * f)[0], span * f) for f in TAUS)[1]
    return tried(tau)[1], float(tau)


def _course(diagnosis: Diagnosis, active: list[Active], signature: np.ndarray) -> Values:
    """An effect with the parameters ``amp`` and ``tau``."""
    time = diagnosis.nominal.view.time
    sizes, tau = _exponential(diagnosis, active, signature, time - time.min())
    return {'amp': sizes.tolist(), 'tau': tau}


def _structure(diagnosis: Diagnosis, active: list[Active]) -> Values:
    return _course(diagnosis, active, diagnosis.joint.observation.view.by_shift)


def _pointing(diagnosis: Diagnosis, active: list[Active]) -> Values:
    return _course(diagnosis, active, diagnosis.joint.observation.view.by_laser)


def _squareness(diagnosis: Diagnosis, active: list[Active]) -> Values:
    view = diagnosis.joint.observation.view
    return _course(diagnosis, active, np.stack([active[0].effect._column(view, name) for name in SQUARENESS]))


def _creep(diagnosis: Diagnosis, active: list[Active]) -> Values:
    view = diagnosis.joint.observation.view
    sizes, tau = _exponential(diagnosis, active, view.by_mirror, view.mount_time)
    return {'amp': sizes.tolist(), 'tau': tau, 'spread': 0.0}


def _scales(diagnosis: Diagnosis, active: list[Active]) -> Values:
    view = diagnosis.joint.observation.view
    growth = view.commanded.T[:, :, None] * view.by_shift
    sizes, tau = _exponential(diagnosis, active, growth, view.time - view.time.min())
    return {'alpha': [GLASS] * 3, 'dT': (sizes / GLASS).tolist(), 'tau': tau}


def _air(diagnosis: Diagnosis, active: list[Active]) -> Values:
    view = diagnosis.joint.observation.view
    signature = view.zeros(1)
    signature[0, :, :view.beams] = view.distance
    sizes, tau = _exponential(diagnosis, active, signature, view.time - view.time.min())
    kelvin = (refractive_index(21.0, 101325.0, 0.5) / refractive_index(20.0, 101325.0, 0.5)) - 1.0
    return {'dT': float(sizes[0] / kelvin), 'dP': 0.0, 'tau': tau}


_RULES: dict[str, Callable[[Diagnosis, list[Active]], Values]] = {
    'backlash': _backlash, 'servo_settling': _settling, 'non_rigid_coupling': _coupling,
    'mirror_curvature': _mirror, 'psd_zero_offset': _zero, 'psd_gain': _gain, 'psd_nonlinearity': _bend,
    'psd_rotation': _rotation, 'count_slip': _slip,
    'structural_thermal_drift': _structure, 'beam_pointing_drift': _pointing, 'mirror_mount_creep': _creep,
    'scale_thermal_expansion': _scales, 'squareness_drift': _squareness, 'air_refraction_drift': _air}
