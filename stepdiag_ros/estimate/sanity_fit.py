"""Mistakes of commissioning that only a bad fit shows: how the detector is mounted, a wrong standoff.

A fit with residuals larger than noise (:mod:`stepdiag_ros.estimate.status`) is made again with what each mistake
would have done to the readings or to the description taken back.  One inverted, or two exchanged coordinates of the
spot contradict each other from diagonal to diagonal, and so do spots that are many times too large; a wrong standoff,
of one setup or of all alike, shows as tilts that grow with the distance.
A mistake is recognised where taking it back turns the bad fit into one that noise explains: a healthy log has no bad
fit, and an effect of the machine is not undone by mirroring a detector.

What no log contradicts cannot be found.  Both coordinates of the spot inverted, or scaled by no more than two, are
mostly other angles of the axes, which positioning and straightness take up; the same holds for the tool, whose
arm turns with an axis's angles as a curve of that axis, and for the offset of the PSD's beam.
"""

from dataclasses import replace

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.enhanced import Fit, fit
from stepdiag_ros.estimate.finding import Finding
from stepdiag_ros.estimate.forward import ForwardModel
from stepdiag_ros.estimate.metres import in_metres
from stepdiag_ros.estimate.noise import NoiseModel
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.estimate.sanity import check_readings
from stepdiag_ros.estimate.status import chi2_limit
from stepdiag_ros.model.description import Description
from stepdiag_ros.model.log import CalibrationLog

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
LEAST_SCALE, LARGEST_SCALE = 1.0, 5.0
"""Logarithm of the scale of the spots from which it is recognised, and up to which."""
LEAST_SCALE_OF_ONE = 0.4
"""The same of one setup against the others; light from elsewhere or a bent scale change it by a tenth."""
STEP_M = 1e-4
SWEEPS = 6
SETTLED = 0.03
"""Change of that logarithm that is worth no further step."""
SPOTS = (
    ('psd x', ((-1, 0), (0, 1)), 'x is inverted', 'turn the sign of spot x'),
    ('psd y', ((1, 0), (0, -1)), 'y is inverted', 'turn the sign of spot y'),
    ('psd both', ((-1, 0), (0, -1)), 'x and y are inverted', 'turn the signs of both'),
    ('psd swapped', ((0, 1), (1, 0)), 'x and y are exchanged', 'exchange the detector\'s x and y'),
    ('psd turned', ((0, -1), (1, 0)), 'the detector is turned by a quarter', 'exchange x and y and turn the sign of '
     'one, so that x lies along u and y along v'))
"""Name, what takes the mistake back (spot → spot, or its opposite), what was found, what to change."""


def check(description: Description, table: StopTable, result: Fit | None = None) -> list[Finding]:
    """All recognised mistakes of a log; empty for a sane one.

    ``result`` is the enhanced method's fit of ``table``; it is made where it is not given.
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


def mistakes(log: CalibrationLog) -> list[Finding]:
    """All recognised mistakes of a log; the one function to ask before any diagnosis."""
    return check(log.description, in_metres(log).table)


def must_be_sane(log: CalibrationLog) -> None:
    """:class:`StepdiagError` where a log shows a mistake of commissioning: a diagnosis would blame the machine."""
    if found := mistakes(log):
        raise StepdiagError(f'{log.source}: the log is not sane; nothing is diagnosed before this is put right: '
                            f'{"; ".join(map(str, found))}')


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
        tried += _scales(description, part, begin)
        tried += _of_one_setup(description, part, begin, limit)
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


def _fitted(description: Description, table: StopTable, noise: NoiseModel,
            theta: np.ndarray | None = None) -> Fit | None:
    """A fit, begun at ``theta``, near enough for a decision; None where there is none."""
    try:
        return fit(description, table, noise, theta=theta, settled=ENOUGH, share=SHARE)
    except (StepdiagError, ValueError, FloatingPointError, np.linalg.LinAlgError):
        return None


def _reduced(result: Fit | None) -> float:
    """Reduced χ² of a fit; infinite where there is none."""
    return result.chi2 / result.dof if result and result.dof > 0 and np.isfinite(result.chi2) else np.inf


def _of_one_setup(description: Description, table: StopTable, result: Fit, limit: float) -> list[tuple[float, Finding]]:
    """Reduced χ² with the detector of the worst setup mounted otherwise, and its finding.

    What the other setups say of the machine predicts its spots, up to the mirror's tilt; the linear map from there to
    the spots that were read says how.  Empty where the other setups do not fit either.
    """
    bad, noise = _reduced(result), result.noise
    square = np.nansum(np.where(result.present, result.residual, 0.0)[:, -2:]**2, axis=1)
    worst = int(np.argmax(np.bincount(table.setup, square)))
    rows, setup = np.flatnonzero(table.setup == worst), table.setup_names[worst]
    without = table.spot.copy()
    without[rows] = np.nan
    others = _fitted(description, replace(table, spot=without), noise)
    if len(table.setup_names) < 2 or _reduced(others) > limit:
        return []
    expected = ForwardModel(description, table, others.parameters).predict(others.theta)[rows, -2:]
    design = np.column_stack([expected, np.ones(len(rows)), table.displacement[rows, 0]])
    good = np.isfinite(table.spot[rows]).all(axis=1) & np.isfinite(design).all(axis=1)
    if good.sum() < 8:
        return []
    seen = np.linalg.lstsq(design[good], table.spot[rows][good], rcond=None)[0][:2].T
    name, back, words, change = min(SPOTS, key=lambda spot: np.linalg.norm(seen - np.linalg.inv(spot[1])))
    scale = float(np.trace(seen)) / 2.0
    if np.linalg.norm(seen - np.linalg.inv(back)) > np.linalg.norm(seen - scale * np.eye(2)):
        if scale <= 0.0 or abs(np.log(scale)) < LEAST_SCALE_OF_ONE:
            return []
        name, back, words, change = (
            'psd scale', np.eye(2) / scale, f'the spots are some {scale:.2g} times as large as the other setups make '
            'them', "check the unit of the spots and the detector's length")
    spot = table.spot.copy()
    spot[rows] = spot[rows] @ np.array(back, float).T
    reduced = _reduced(_fitted(description, replace(table, spot=spot), noise))
    return [(reduced, Finding(name, _sentence(f'psd/spot of setup {setup}', words, bad, reduced),
                              f'in setup {setup} {change}'))]


def _standoffs(description: Description, table: StopTable, result: Fit) -> list[tuple[float, Finding]]:
    """Reduced χ² with the one standoff put right that makes it fall most, or all of them by the same, and its finding;
    empty without any.

    ``result``: the fit before.
    """
    bad = _reduced(result)
    setups = [name for name in result.parameters.setups if not description.setups[name].follows]
    groups = [(name,) for name in setups] + ([tuple(setups)] if len(setups) > 1 else [])
    if not groups:
        return []
    falls = [fall for *_, fall in _by_standoffs(description, table, result, groups)]
    names = groups[int(np.argmax(falls))]
    least, total, changed = min(description.setups[name].standoff for name in names), 0.0, description
    for sweep in range(SWEEPS):
        [(shift, sigma, _)] = _by_standoffs(changed, table, result, [names])
        # Misalignments have taken part of it up, which makes the first steps about twice as long as needed.
        total += (0.5 if sweep < 2 else 1.0) * shift
        if not -least < total < MOST_M:
            return []
        changed = _moved(description, names, total)
        result = _fitted(changed, table, result.noise, result.theta)
        if result is None:
            return []
    if abs(total) < max(LEAST_M, CERTAIN * sigma) or result.dof < 1:
        return []
    reduced = _reduced(result)
    if len(names) > 1:
        return [(reduced, Finding('standoff', _sentence('the readings contradict the standoffs of all setups alike',
                                                        f'they fit those of the cell and {total:+.3f} ± '
                                                        f'{2.0 * sigma:.2g} m (k = 2)', bad, reduced),
                                  'measure them again, from the base unit to the mirror\'s reference point at stop 0, '
                                  'and set setups.*.standoff'))]
    [name], known = names, least
    what = f'the readings contradict setups.{name}.standoff'
    words = f'they fit {known + total:.3f} ± {2.0 * sigma:.2g} m (k = 2), the cell says {known:g} m'
    return [(reduced, Finding('standoff', _sentence(what, words, bad, reduced),
                              f'measure it again and set setups.{name}.standoff'))]


def _moved(description: Description, names: tuple[str, ...], by_m: float) -> Description:
    return replace(description, setups={name: replace(setup, standoff=setup.standoff + by_m) if name in names else setup
                                        for name, setup in description.setups.items()})


def _by_standoffs(description: Description, table: StopTable, result: Fit,
                  groups: list[tuple[str, ...]]) -> list[tuple[float, float, float]]:
    """Change of the standoffs of each group of setups alike [m], σ [m] and fall of χ², of :func:`_asked`."""
    def predicted(of: Description) -> np.ndarray:
        return ForwardModel(of, table, result.parameters).predict(result.theta)
    before = predicted(description)
    return _asked(result, [(predicted(_moved(description, names, STEP_M)) - before) / STEP_M for names in groups])


def _scales(description: Description, table: StopTable, result: Fit) -> list[tuple[float, Finding]]:
    """Reduced χ² with the spots taken as readings of another scale, and the finding; empty where that is near 1."""
    bad, logarithm, noise = _reduced(result), 0.0, result.noise
    for _ in range(2 * SWEEPS):
        spots = ForwardModel(description, table, result.parameters).predict(result.theta)
        spots[:, :-2] = 0.0
        [(step, *_)] = _asked(result, [spots])
        if abs(step) < SETTLED:
            break
        logarithm += float(np.clip(step, -1.0, 1.0))
        if not LEAST_SCALE / 2.0 < abs(logarithm) < LARGEST_SCALE:
            return []   # by far too little for the first step, which is at most one, or too much
        scale = float(np.exp(logarithm))
        # Their noise was read from them: left as it is, spots that are shrunk to nothing would explain everything.
        sensor = noise.sensor / np.r_[np.ones(noise.sensor.shape[1] - 2), scale, scale]
        result = _fitted(description, replace(table, spot=table.spot / scale),
                         replace(noise, sensor=sensor, angle=noise.angle / scale), result.theta)
        if result is None:
            return []
    if abs(logarithm) < LEAST_SCALE or result.dof < 1:
        return []
    reduced = _reduced(result)
    words = f'the spots are some {scale:.2g} times as large as the tilts make them'
    return [(reduced, Finding('psd scale', _sentence('psd/spot', words, bad, reduced),
                              'check the unit of the spots, the length of the detector and the direction of its beam'))]


def _asked(result: Fit, changes: list[np.ndarray]) -> list[tuple[float, float, float]]:
    """How much of each change of the readings (n, c) the residuals ask for by itself, its σ and by how much χ² falls,
    to first order."""
    # Orthogonal to what the fit's own unknowns can do, their priors as further readings: normal equations would
    # lose it, since mirror and laser take nearly all of it up.
    held = np.linalg.cholesky(result.precision).T
    jacobian = result.jacobian.toarray()
    design = np.concatenate([*(w(jacobian) for w in result.whiteners), held])
    basis, _ = np.linalg.qr(design / np.linalg.norm(design, axis=0))

    def white(readings: np.ndarray) -> list[np.ndarray]:
        flat = np.where(result.present, readings, 0.0).ravel()
        return [w(flat) for w in result.whiteners]
    left, asked = np.concatenate([*white(result.residual), -held @ result.theta]), []
    for change in changes:
        along = np.concatenate([*white(change), np.zeros(len(held))])
        free = along - basis @ (basis.T @ along)
        square, pull = float(free @ free), float(free @ left)
        asked.append((pull / square, square**-0.5, pull**2 / square))
    return asked
