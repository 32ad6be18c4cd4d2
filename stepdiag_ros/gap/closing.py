"""How far the gap closes on runs that took no part in the fit.

All but the last repeat are fitted, with and without the effects; the last repeat is foretold.  Both
are linear at the joint fit.  A forecast is judged with its own uncertainty: the noise of the runs
foretold and that of what was fitted.  The reset of a run that was not fitted is not known and is
given free.
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from stepdiag_ros.gap.evidence import SIZES
from stepdiag_ros.gap.joint import Joint

RESET_WIDTH_M = 1e-4


@dataclass(frozen=True)
class Closing:
    """Reduced χ² of the forecast without and with the effects, over ``count`` readings; in words
    which part was ``held_out``; the same as distances [m] by the noise floor."""

    before: float
    after: float
    count: int
    held_out: str
    before_m: float
    after_m: float
    floor_m: float


def noise_floor(joint: Joint) -> float:
    """Root mean square [m] of the noise of one stop's displacement."""
    beams = joint.fit.model.beams
    squares = []
    for white in joint.parity._white:
        variance = np.sum(white.factor**2, axis=1)
        channel = white.rows % (beams + 2)
        squares.append(variance[channel < beams])
    values = np.concatenate(squares)
    if not len(values):
        values = np.concatenate([np.sum(w.factor**2, axis=1) for w in joint.parity._white])
    return float(np.sqrt(np.mean(values)))


def closing(joint: Joint) -> Closing:
    """Fit on the earlier repeats, foretell the last."""
    table = joint.observation.table
    held, name = _held_out(table)
    # Whiteners are one a run: rows of a run stay together on either side.
    white, flags = joint.parity._white, []
    channels = joint.fit.residual.shape[1]
    jacobian_all = joint.fit.jacobian.toarray()
    readings = np.concatenate([table.displacement, table.spot], axis=1)
    residual_all = np.where(joint.fit.present, readings - joint.fit.model.predict(joint.fit.theta),
                            0.0).ravel()
    effects = [a.form.columns.reshape(len(a.form.columns), -1).T * a.form.scale
               for a in joint.active]
    columns_all = np.concatenate(effects, axis=1) if effects else np.zeros((len(residual_all), 0))
    parts = []
    for w in white:
        flags.append(np.full(len(w.rows), held[w.rows[0] // channels]))
        parts.append((w(jacobian_all), w(residual_all), w(columns_all)))
    flag = np.concatenate(flags)
    jacobian, residual, columns = (np.concatenate(p) for p in zip(*parts, strict=True))
    precision = joint.fit.precision.copy()
    offsets = np.arange(joint.fit.parameters.offset_first, joint.fit.parameters.size)
    precision[offsets, offsets] = RESET_WIDTH_M**-2.0
    resets = len(np.unique(table.run[held])) * joint.fit.model.beams
    resets = resets if np.isfinite(table.displacement[held]).any() else 0
    before = _forecast(jacobian, residual, flag, precision, resets)
    if columns.shape[1]:
        both = np.concatenate([jacobian, columns], axis=1)
        wide = linalg.block_diag(precision, np.eye(columns.shape[1]) / SIZES[-1] ** 2)
        after = _forecast(both, residual, flag, wide, resets)
    else:
        after = before
    floor = noise_floor(joint)
    return Closing(before, after, int(flag.sum()), name,
                   floor * np.sqrt(before), floor * np.sqrt(after), floor)


def excess_forecast(how_far: Closing, noise_dof: float) -> tuple[float, str]:
    """Log evidence that the part held out is foretold worse than noise allows, and that in words.

    A log may be fitted to the noise by errors that are not those of the machine, bent until they follow
    whatever disturbs it; then they do not foretell.  The noise is known to ``noise_dof`` degrees of freedom.
    """
    ratio, count = how_far.after, 1.0 / (1.0 / max(how_far.count, 1) + 1.0 / max(noise_dof, 1.0))
    gain = 0.5 * count * (ratio - 1.0 - np.log(ratio)) if ratio > 1.0 else 0.0
    return gain, f'{how_far.held_out} is foretold {np.sqrt(max(ratio, 0.0)):.2f} times worse than noise allows'


def _held_out(table) -> tuple[np.ndarray, str]:
    """Mask (n,) of the stops held out, whole runs; and their name."""
    last = table.repeat.max()
    if last > table.repeat.min():
        held = table.repeat == last
        # One run may hold several repeats (an imported log): it cannot be split.
        whole = all(len(np.unique(held[table.run == run])) == 1 for run in np.unique(table.run))
        if whole:
            return held, f'repeat {int(last)} of every setup'
    runs = np.unique(table.run)
    if len(runs) > 1:
        chosen = runs[len(runs) // 2:][::2] if len(runs) > 3 else runs[-1:]
        return np.isin(table.run, chosen), 'runs ' + ', '.join(table.run_ids[r] for r in chosen)
    return np.ones(len(table), bool), 'none: the log is one run'


def _forecast(design: np.ndarray, residual: np.ndarray, held: np.ndarray,
              precision: np.ndarray, resets: int) -> float:
    """Reduced χ² of the held-out rows foretold from the others; each of their resets takes one freedom."""
    train = ~held
    normal = design[train].T @ design[train] + precision
    scale = 1.0 / np.sqrt(np.diag(normal))
    factor = linalg.cho_factor(normal * np.outer(scale, scale), lower=True)
    mean = scale * linalg.cho_solve(factor, scale * (design[train].T @ residual[train]))
    left = residual[held] - design[held] @ mean
    spread = design[held] * scale
    predicted = np.eye(held.sum()) + spread @ linalg.cho_solve(factor, spread.T)
    white = linalg.solve_triangular(linalg.cholesky(predicted, lower=True), left, lower=True)
    return float(white @ white / max(int(held.sum()) - resets, 1))
