"""How far the gap closes on runs that took no part in the fit.

All repeats but one are fitted, with and without the effects, and that one is foretold; each repeat has
its turn, for what one repeat's noise leaves open of a small gap the others settle.  A log of one run, as a table of
cycles is, is split in time: its last repeats are foretold from those before.  Fits are linear at the joint fit.
A forecast is judged with its own uncertainty: the noise of the runs foretold and that of what was fitted.  The reset
of a run that was not fitted is not known and is given free.  Beside that each setup is foretold from the others, with
the misalignments of its own no better known than before the log.
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from stepdiag_ros.gap.inference.joint import Joint, inverse, widths

RESET_WIDTH_M = 1e-4


@dataclass(frozen=True)
class Closing:
    """Reduced χ² of the forecast without and with the effects, over ``count`` readings, in units of a noise known to
    ``noise_dof`` degrees of freedom; in words which part was ``held_out``; the same as distances [m] by the noise
    floor."""

    before: float
    after: float
    count: int
    noise_dof: float
    held_out: str
    before_m: float
    after_m: float
    floor_m: float

    def to_json_dict(self) -> dict:
        return {'before_m': self.before_m, 'after_m': self.after_m, 'noise_floor_m': self.floor_m,
                'held_out': self.held_out, 'reduced_chi2_before': self.before, 'reduced_chi2_after': self.after}

    @property
    def left(self) -> float:
        """Share of the excess χ² before that is there after; 0 where chance alone may leave it (five σ)."""
        beyond_chance = self.after > 1.0 + 5.0 * np.sqrt(2.0 / max(self.count, 1) + 2.0 / max(self.noise_dof, 1.0))
        return (self.after - 1.0) / (self.before - 1.0) if beyond_chance and self.before > self.after else 0.0


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


def closing(joint: Joint, alone: Joint | None = None) -> Closing:
    """Fit on all repeats but one and foretell that one, each in turn.

    ``alone``: the fit of the machine without effects.  Where it leaves more than seems to be left at the joint fit, a
    linear step from there does what the machine cannot, and the gap before is that at ``alone``.
    """
    place = alone if alone is not None and _left(alone) > _left(joint) else joint
    return _closing(joint, place, *_held_out(joint.observation.table))


def closing_over_setups(joint: Joint) -> Closing | None:
    """Fit on all setups but one and foretell that one, each in turn; None where there is but one."""
    setup = joint.observation.table.setup
    parts = [setup == s for s in np.unique(setup)]
    return _closing(joint, joint, parts, 'each setup in turn, foretold from the others') if len(parts) > 1 else None


def _closing(joint: Joint, place: Joint, parts: list[np.ndarray], name: str) -> Closing:
    """``place``: the fit at which the gap before is taken; ``parts``: masks (n,) of the stops held out in turn."""
    after, count, freedom = _foretold(joint, parts, with_effects=True)
    before = _foretold(place, parts, with_effects=False)[0] if joint.active else after
    before, after = before / max(freedom, 1), after / max(freedom, 1)
    floor = noise_floor(joint)
    return Closing(before, after, count, float(sum(joint.noise.dof)), name,
                   floor * np.sqrt(before), floor * np.sqrt(after), floor)


def _left(joint: Joint) -> float:
    """Squares that the machine alone leaves of the stops, linear at a joint fit."""
    data = joint.parity.data[:joint.parity.stops]
    return float(data @ data)


def _foretold(joint: Joint, parts: list[np.ndarray], with_effects: bool) -> tuple[float, int, int]:
    """χ² of all that is held out, number of readings and degrees of freedom."""
    table = joint.observation.table
    # Whiteners are one a run: rows of a run stay together on either side.
    white = joint.parity._white
    channels = joint.fit.residual.shape[1]
    readings = np.concatenate([table.displacement, table.spot], axis=1)
    residual = np.where(joint.fit.present, readings - joint.fit.model.predict(joint.fit.theta), 0.0).ravel()
    stop = np.concatenate([w.rows for w in white]) // channels
    design, precision = joint.jacobian, joint.fit.precision.copy()
    offsets = np.arange(joint.fit.parameters.offset_first, joint.fit.parameters.size)
    precision[offsets, offsets] = RESET_WIDTH_M**-2.0
    if with_effects and joint.active:
        columns = np.concatenate([a.form.columns.reshape(len(a.form.columns), -1).T * a.form.scale
                                  for a in joint.active], axis=1)
        design = np.concatenate([design, np.concatenate([w(columns) for w in white])], axis=1)
        precision = linalg.block_diag(precision, np.diag(widths(a.form for a in joint.active) ** -2.0))
    residual = np.concatenate([w(residual) for w in white])
    total, freedom, count = 0.0, 0, 0
    for held in parts:
        flag = held[stop]
        resets = len(np.setdiff1d(table.run[held], table.run[~held])) * joint.fit.model.beams
        resets = resets if np.isfinite(table.displacement[held]).any() else 0
        total += _forecast(design, residual, flag, precision)
        freedom += int(flag.sum()) - resets
        count += int(flag.sum())
    return total, count, freedom


def excess_forecast(how_far: Closing) -> tuple[float, str]:
    """Log evidence that the part held out is foretold worse than noise allows, and that in words.

    A log may be fitted to the noise by errors that are not those of the machine, bent until they follow
    whatever disturbs it; then they do not foretell.  Of forecasts made in turn from each other only half are counted
    as independent.
    """
    ratio, count = how_far.after, 1.0 / (2.0 / max(how_far.count, 1) + 1.0 / max(how_far.noise_dof, 1.0))
    gain = 0.5 * count * (ratio - 1.0 - np.log(ratio)) if ratio > 1.0 else 0.0
    return gain, f'{how_far.held_out} is foretold {np.sqrt(max(ratio, 0.0)):.2f} times worse than noise allows'


def _held_out(table) -> tuple[list[np.ndarray], str]:
    """Masks (n,) of the stops held out in turn, whole runs or the end of the only one; and their name."""
    repeats, runs = np.unique(table.repeat), np.unique(table.run)
    if len(repeats) > 1:
        whole = all(len(np.unique(table.repeat[table.run == run])) == 1 for run in runs)
        if whole:
            return [table.repeat == repeat for repeat in repeats], 'each repeat in turn, foretold from the others'
        if len(runs) == 1:
            # White rows of a run are what is new at each stop given those before: those at its end are a forecast.
            last = len(repeats) // 2
            return [table.repeat >= repeats[-last]], (
                f'the last {last} of {len(repeats)} repeats, foretold from those before')
    if len(runs) > 1:
        chosen = runs[len(runs) // 2:][::2] if len(runs) > 3 else runs[-1:]
        return [np.isin(table.run, chosen)], 'runs ' + ', '.join(table.run_ids[r] for r in chosen)
    return [np.ones(len(table), bool)], 'none: the log is one run'


def _forecast(design: np.ndarray, residual: np.ndarray, held: np.ndarray,
              precision: np.ndarray) -> float:
    """χ² of the held-out rows foretold from the others."""
    train = ~held
    normal = design[train].T @ design[train] + precision
    covariance = inverse(normal)
    left = residual[held] - design[held] @ (covariance @ (design[train].T @ residual[train]))
    predicted = np.eye(held.sum()) + design[held] @ covariance @ design[held].T
    white = linalg.solve_triangular(linalg.cholesky(predicted, lower=True), left, lower=True)
    return float(white @ white)
