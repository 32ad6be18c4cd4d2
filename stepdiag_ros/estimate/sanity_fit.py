"""Mistakes of commissioning that only a bad fit shows: how the detector is mounted, a wrong standoff.

A fit with residuals larger than noise (:mod:`stepdiag_ros.estimate.status`) is made again with what each mistake
would have done to the readings or to the description taken back.  One inverted, or two exchanged coordinates of the
spot contradict each other from diagonal to diagonal, and a wrong standoff shows as tilts that grow with the distance.
A mistake is recognised where taking it back turns the bad fit into one that noise explains: a healthy log has no bad
fit, and an effect of the machine is not undone by mirroring a detector.

What no log contradicts is not looked for.  Both coordinates of the spot inverted or scaled are other angles of the
axes, which positioning and straightness take up (χ² changes by a third at most); the same holds for the tool, whose
arm turns with an axis's angles as a curve of that axis, and for the offset of the PSD's beam.
"""

from dataclasses import replace

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.enhanced import Fit, fit
from stepdiag_ros.estimate.finding import Finding
from stepdiag_ros.estimate.forward import ForwardModel
from stepdiag_ros.estimate.noise import NoiseModel
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.estimate.sanity import check_readings
from stepdiag_ros.estimate.status import chi2_limit
from stepdiag_ros.model.description import Description

ENOUGH, SHARE = 10.0, 1e-3
"""Fall of χ² [1], or in shares of it, below which a fit is not worth a further step: what is looked for makes it fall
tenfold, and a model that is wrong creeps along its valleys for a hundred steps."""
FALLS = 10.0
"""How many times χ² must fall …"""
ALONE = 3.0
"""… and how many times less than by any other mistake."""
LEAST_M, MOST_M = 0.01, 2.0
"""What a standoff may be off by to be recognised …"""
CERTAIN = 20.0
"""… and how many standard deviations that must be at least."""
STEP_M = 1e-4
SWEEPS = 6
SPOTS = (
    ('psd x', ((-1, 0), (0, 1)), 'x is inverted', 'turn the sign of spot x'),
    ('psd y', ((1, 0), (0, -1)), 'y is inverted', 'turn the sign of spot y'),
    ('psd swapped', ((0, 1), (1, 0)), 'x and y are exchanged', 'exchange the detector\'s x and y'),
    ('psd turned', ((0, -1), (1, 0)), 'the detector is turned by a quarter', 'exchange x and y and turn the sign of '
     'one, so that x lies along u and y along v'))
"""Name, what takes the mistake back (spot → spot, or its opposite), what was found, what to change."""


def check(description: Description, table: StopTable, result: Fit | None = None) -> list[Finding]:
    """All recognised mistakes of a log; empty for a sane one.

    ``result`` is the enhanced method's fit of ``table``; it is made where it is not given.  The one function to ask
    before any diagnosis.
    """
    found = check_readings(description, table)
    if found:
        return found
    if result is None:
        try:
            result = fit(description, table)
        except StepdiagError:
            return []   # nothing to solve: whoever goes on will say so
    return check_fit(description, table, result)


def check_fit(description: Description, table: StopTable, result: Fit) -> list[Finding]:
    """Mistakes that explain why ``result`` fits badly; empty where it fits, or where none explains it."""
    if result.dof < 1 or result.chi2 <= chi2_limit(result) * result.dof:
        return []
    part, noise = _part(table, result.noise)
    begin, limit = _fitted(description, part, noise), chi2_limit(result)
    bad = _reduced(begin)
    if begin is None or bad <= limit:
        return []   # what shows only between directions or repeats is no mistake of this kind
    tried: list[tuple[float, Finding]] = []
    if np.isfinite(part.spot).all(axis=1).sum() >= 4:
        for name, back, words, change in SPOTS:
            reduced = _reduced(_fitted(description, replace(part, spot=part.spot @ np.array(back, float).T), noise))
            if np.isfinite(reduced):
                tried.append((reduced, Finding(name, _sentence('psd/spot', words, bad, reduced), change)))
    tried += _standoffs(description, part, begin)
    tried.sort(key=lambda entry: entry[0])
    if not tried or tried[0][0] > min(limit, bad / FALLS):
        return []
    best, finding = tried[0]
    others = [other.found.split(' (')[0] for reduced, other in tried[1:]
              if reduced < ALONE * best and other.name != finding.name]
    if others:
        finding = replace(finding, change=f'{finding.change}; or: {"; or: ".join(others)}')
    return [finding]


def _sentence(what: str, words: str, before: float, after: float) -> str:
    return f'{what}: {words} (reduced χ² falls from {before:.4g} to {after:.3g} when it is taken back)'


def _part(table: StopTable, noise: NoiseModel) -> tuple[StopTable, NoiseModel]:
    """The first run of each setup: enough to recognise a mistake, and soon fitted a dozen times."""
    first = {int(table.setup[np.flatnonzero(table.run == run)[0]]): run for run in np.unique(table.run)[::-1]}
    rows = np.flatnonzero(np.isin(table.run, list(first.values())))
    return table.select(rows), replace(noise, sensor=noise.sensor[rows])


def _fitted(description: Description, table: StopTable, noise: NoiseModel) -> Fit | None:
    """A fit, near enough for a decision; None where there is none."""
    try:
        return fit(description, table, noise, settled=ENOUGH, share=SHARE)
    except (StepdiagError, ValueError, FloatingPointError, np.linalg.LinAlgError):
        return None


def _reduced(result: Fit | None) -> float:
    """Reduced χ² of a fit; infinite where there is none."""
    return result.chi2 / result.dof if result and result.dof > 0 and np.isfinite(result.chi2) else np.inf


def _standoffs(description: Description, table: StopTable, result: Fit) -> list[tuple[float, Finding]]:
    """Reduced χ² with the one standoff put right that makes it fall most, and its finding; empty without any.

    ``result``: the fit before.
    """
    best, bad = None, _reduced(result)
    for setup in result.parameters.setups:
        if description.setups[setup].follows:
            continue
        shift, sigma, fall = _shift(description, table, result, setup)
        if best is None or fall > best[0]:
            best = fall, setup, shift
    if best is None:
        return []
    name = best[1]
    changed, known = description, description.setups[name].standoff
    for sweep in range(SWEEPS):
        shift, sigma, _ = _shift(changed, table, result, name)
        # Misalignments have taken part of it up, which makes the first steps about twice as long as needed.
        value = changed.setups[name].standoff + (0.5 if sweep < 2 else 1.0) * shift
        if not 0.0 < value < known + MOST_M:
            return []
        changed = replace(description, setups={**description.setups,
                                               name: replace(description.setups[name], standoff=value)})
        result = fit(changed, table, result.noise, theta=result.theta, settled=ENOUGH, share=SHARE)
    if abs(value - known) < max(LEAST_M, CERTAIN * sigma) or result.dof < 1:
        return []
    reduced = _reduced(result)
    what = f'the readings contradict setups.{name}.standoff'
    words = f'they fit {value:.3f} ± {2.0 * sigma:.2g} m (k = 2), the cell says {known:g} m'
    return [(reduced, Finding('standoff', _sentence(what, words, bad, reduced),
                              f'measure it again and set setups.{name}.standoff'))]


def _shift(description: Description, table: StopTable, result: Fit, setup: str) -> tuple[float, float, float]:
    """Change of one standoff [m] that the residuals ask for, its σ [m] and by how much χ² falls, to first order."""
    own = description.setups[setup]
    moved = replace(description, setups={**description.setups, setup: replace(own, standoff=own.standoff + STEP_M)})
    after = ForwardModel(moved, table, result.parameters).predict(result.theta)
    before = ForwardModel(description, table, result.parameters).predict(result.theta)
    change = np.where(result.present, (after - before) / STEP_M, 0.0).ravel()
    rest = np.where(result.present, result.residual, 0.0).ravel()
    # Orthogonal to what the fit's own unknowns can do, their priors as further readings: normal equations would
    # lose it, since mirror and laser take nearly all of it up.
    held = np.linalg.cholesky(result.precision).T
    jacobian = result.jacobian.toarray()
    design = np.concatenate([*(w(jacobian) for w in result.whiteners), held])
    basis, _ = np.linalg.qr(design / np.linalg.norm(design, axis=0))
    along = np.concatenate([*(w(change) for w in result.whiteners), np.zeros(len(held))])
    left = np.concatenate([*(w(rest) for w in result.whiteners), -held @ result.theta])
    free = along - basis @ (basis.T @ along)
    square, pull = float(free @ free), float(free @ left)
    return pull / square, square**-0.5, pull**2 / square
