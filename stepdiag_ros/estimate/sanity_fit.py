"""Mistakes of commissioning that only a bad fit shows: how the detector is mounted, tool, standoff, beam offsets.

A fit with residuals larger than noise (:mod:`stepdiag_ros.estimate.status`) is made again with what each mistake
would have done to the readings or to the description taken back.  Angles reach the distances over the machine's
levers, so that mirrored, exchanged or scaled spots contradict them.  A mistake is recognised where taking it back
turns the bad fit into one that noise explains, and no other mistake does so as well: a healthy log has no bad fit,
and an effect of the machine is not undone by mirroring a detector.

Tool and standoffs act in proportion: they are estimated beside the fit's unknowns from the derivatives of the
readings, and must be off by more than :data:`CERTAIN` standard deviations and :data:`LEAST_M`, be plausible, and
bring the fit back to noise when they are put right.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.enhanced import Fit, fit, readings_of
from stepdiag_ros.estimate.finding import Finding
from stepdiag_ros.estimate.forward import ForwardModel
from stepdiag_ros.estimate.noise import NoiseModel
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.estimate.sanity import check_readings
from stepdiag_ros.estimate.status import chi2_limit
from stepdiag_ros.model.description import Description

ENOUGH = 10.0
"""Fall of χ² [1] below which a fit is not worth a further step: what is looked for makes it fall by thousands."""
FALLS = 10.0
"""How many times χ² must fall …"""
ALONE = 3.0
"""… and how many times less than by any other mistake."""
CERTAIN = 20.0
LEAST_M = 0.01
MOST_M = 2.0
STEP_M = 1e-4
SPOTS = (
    ('psd sign', ((-1, 0), (0, -1)), 'x and y are turned in sign', 'turn the sign of both spot coordinates, or the '
     'detector by 180°'),
    ('psd x', ((-1, 0), (0, 1)), 'x is inverted', 'turn the sign of spot x'),
    ('psd y', ((1, 0), (0, -1)), 'y is inverted', 'turn the sign of spot y'),
    ('psd swapped', ((0, 1), (1, 0)), 'x and y are exchanged', 'exchange the detector\'s x and y'),
    ('psd turned', ((0, -1), (1, 0)), 'the detector is turned by a quarter', 'exchange x and y and turn the sign of '
     'one: x along u, y along v'),
    ('psd turned', ((0, 1), (-1, 0)), 'the detector is turned by a quarter', 'exchange x and y and turn the sign of '
     'one: x along u, y along v'),
    ('psd swapped', ((0, -1), (-1, 0)), 'x and y are exchanged and turned in sign', 'exchange x and y and turn both '
     'signs'),
    ('psd unit', ((1e3, 0), (0, 1e3)), 'spots are a thousandth of what they should be', 'give spots in metres'),
    ('psd unit', ((1e6, 0), (0, 1e6)), 'spots are a millionth of what they should be', 'give spots in metres'),
    ('psd unit', ((1e-3, 0), (0, 1e-3)), 'spots are 1000 times what they should be', 'give spots in metres'),
    ('psd unit', ((0.5, 0), (0, 0.5)), 'spots are twice what they should be', 'halve the detector\'s scale (its length '
     'is the whole side, not half of it)'),
    ('psd unit', ((2, 0), (0, 2)), 'spots are half what they should be', 'double the detector\'s scale (its length is '
     'the whole side, not half of it)'))
"""Name, what takes the mistake back (spot → spot), what was found, what to change."""


def check(description: Description, table: StopTable, result: Fit | None = None) -> list[Finding]:
    """All recognised mistakes of a log; empty for a sane one.

    ``result`` is the enhanced method's fit of ``table``; it is made where it is not given.  The one function to ask
    before any diagnosis.
    """
    found = check_readings(description, table)
    if found:
        return found
    if result is None:
        result = fit(description, table)
    return check_fit(description, table, result)


def check_fit(description: Description, table: StopTable, result: Fit) -> list[Finding]:
    """Mistakes that explain why ``result`` fits badly; empty where it fits, or where none explains it."""
    if result.dof < 1 or result.chi2 <= chi2_limit(result) * result.dof:
        return []
    part, noise = _part(table, result.noise)
    bad, limit = _reduced(description, part, noise), chi2_limit(result)
    if bad is None or bad <= limit:
        return []   # what shows only between directions or repeats is no mistake of this kind
    tried: list[tuple[float, Finding]] = []
    if np.isfinite(part.spot).all(axis=1).sum() >= 4:
        for name, back, words, change in SPOTS:
            factor = abs(np.linalg.det(np.array(back, float)))**0.5
            other = replace(part, spot=part.spot @ np.array(back, float).T)
            quieter = replace(noise, angle=noise.angle * factor, sensor=np.concatenate(
                [noise.sensor[:, :-2], noise.sensor[:, -2:] * factor], axis=1))
            reduced = _reduced(description, other, quieter)
            if reduced is not None:
                tried.append((reduced, Finding(name, _sentence('psd/spot', words, bad, reduced), change)))
    for name, value, there, changed in _described(description, part, result, noise):
        reduced = _reduced(changed, part, noise)
        if reduced is not None:
            tried.append((reduced, Finding(name, _sentence(f'the readings contradict {there}', f'they fit {value}', bad,
                                                           reduced), f'measure it again and set {there}: {value}')))
    tried.sort(key=lambda entry: entry[0])
    if not tried or tried[0][0] > min(limit, bad / FALLS):
        return []
    best, finding = tried[0]
    rivals = [other.found.split(' (')[0] for reduced, other in tried[1:]
              if reduced < ALONE * best and other.name != finding.name]
    if rivals:
        finding = replace(finding, change=f'{finding.change}; or: {"; or: ".join(rivals)}')
    return [finding]


def _sentence(what: str, words: str, before: float, after: float) -> str:
    return f'{what}: {words} (reduced χ² falls from {before:.4g} to {after:.3g} when it is taken back)'


def _part(table: StopTable, noise: NoiseModel) -> tuple[StopTable, NoiseModel]:
    """The first run of each setup: enough to recognise a mistake, and soon fitted a dozen times."""
    first = {int(table.setup[np.flatnonzero(table.run == run)[0]]): run for run in np.unique(table.run)[::-1]}
    rows = np.flatnonzero(np.isin(table.run, list(first.values())))
    return table.select(rows), replace(noise, sensor=noise.sensor[rows])


def _reduced(description: Description, table: StopTable, noise: NoiseModel) -> float | None:
    """Reduced χ² of a fit; None where there is none."""
    try:
        result = fit(description, table, noise, settled=ENOUGH)
    except (StepdiagError, ValueError, FloatingPointError, np.linalg.LinAlgError):
        return None
    return result.chi2 / result.dof if result.dof > 0 and np.isfinite(result.chi2) else None


def _described(description: Description, table: StopTable, whole: Fit,
               noise: NoiseModel) -> Iterator[tuple[str, str, str, Description]]:
    """Descriptions whose tool or standoffs fit better: name, value in words, key, description."""
    result = fit(description, table, noise, settled=ENOUGH)
    keys = [('tool', ('machine.tool',), k) for k in range(3)]
    keys += [('standoff', (name,), 0) for name in result.parameters.setups]
    columns = np.stack([_derivative(description, table, result, kind, names, k) for kind, names, k in keys], axis=1)
    weighted = [np.concatenate([w(column) for w in result.whiteners]) for column in columns.T]
    design = np.stack(weighted, axis=1)
    jacobian = np.concatenate([w(result.jacobian.toarray()) for w in result.whiteners])
    rest = np.concatenate([w(np.where(result.present, result.residual, 0.0).ravel()) for w in result.whiteners])
    for kind in ('tool', 'standoff'):
        own = [i for i, key in enumerate(keys) if key[0] == kind]
        free = design[:, own] - jacobian @ (result.covariance @ (jacobian.T @ design[:, own]))
        normal = free.T @ free
        scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        value, vectors = np.linalg.eigh(normal / np.outer(scale, scale))
        inverse = (vectors / np.maximum(value, 1e-9)) @ vectors.T / np.outer(scale, scale)
        shift = inverse @ (free.T @ rest)
        sure = np.abs(shift) > np.maximum(CERTAIN * np.sqrt(np.diag(inverse)), LEAST_M)
        if not sure.any() or np.abs(shift[sure]).max() > MOST_M:
            continue
        shift = np.where(sure, shift, 0.0)
        changed, there, words = description, [], []
        if kind == 'tool':
            tool = np.array(description.machine.tool) + shift
            changed = replace(description, machine=replace(description.machine, tool=tuple(tool)))
            there, words = ['machine.tool'], ['[' + ', '.join(f'{v:.3f}' for v in tool) + '] m']
        else:
            setups = dict(description.setups)
            for i, delta in zip(own, shift, strict=True):
                name = keys[i][1][0]
                if delta and description.setups[name].standoff + delta > 0.0:
                    setups[name] = replace(setups[name], standoff=description.setups[name].standoff + delta)
                    there.append(f'setups.{name}.standoff')
                    words.append(f'{setups[name].standoff:.3f} m')
            changed = replace(description, setups=setups)
        if there:
            yield kind, ', '.join(words), ', '.join(there), changed


def _derivative(description: Description, table: StopTable, result: Fit, kind: str, names: tuple[str, ...],
                k: int) -> np.ndarray:
    """Change (n·c,) of the readings per metre of one key of the description, zero where absent."""
    if kind == 'tool':
        tool = np.array(description.machine.tool)
        tool[k] += STEP_M
        moved = replace(description, machine=replace(description.machine, tool=tuple(tool)))
    else:
        own = description.setups[names[0]]
        moved = replace(description, setups={**description.setups,
                                             names[0]: replace(own, standoff=own.standoff + STEP_M)})
    after = ForwardModel(moved, table, result.parameters).predict(result.theta)
    readings = readings_of(table)
    change = (after - (readings - result.residual)) / STEP_M
    return np.where(result.present, change, 0.0).ravel()
