"""Where the gap lies: shares of the excess by channel and setup, with axis and direction where they matter.

The excess is what a user sees after the nominal fit: what the effects add to the readings less
what machine, misalignments and resets take of it, in units of each reading's own noise and freed of the
noise that the effects' coefficients carry.  Parity space would not do: its rows are white mixtures of the
readings of a run.  Where no effect was named, the excess is what the residuals have above their
expectation; where the stops' means show nothing, what happens inside the dwells: the swing of lines in their
spectrum where there are any, else what their parts show.  A cell is split by
the axis that moved or the direction of the run only if nearly all of it lies in one of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stepdiag_ros.estimate.noise import as_noise
from stepdiag_ros.gap.constants import CELL_SIGMAS, LEAST_SHARE, NAMED_CELL_SIGMAS
from stepdiag_ros.gap.inference.joint import Joint, inverse_root, prior_sigmas, unexplained
from stepdiag_ros.gap.preprocess.observe import channels

CONCENTRATED = 0.85
"""Share of a cell in one axis or direction from which it is reported."""

ONE_SIGMA = 1.0
"""Squares at all stops together below which what acts inside the dwells too shows there alone: one σ."""


@dataclass(frozen=True)
class Share:
    """A cell and its share of the excess variance; None: does not matter."""

    channel: str
    setup: str | None
    axis: str | None
    direction: int | None
    share: float

    def to_json_dict(self) -> dict:
        full = {'channel': self.channel, 'setup': self.setup, 'axis': self.axis,
                'direction': self.direction, 'share': self.share}
        return {key: value for key, value in full.items() if value is not None}


def shares(joint: Joint, found: Sequence, unmodelled: bool) -> tuple[Share, ...]:
    """Cells that hold more than noise and at least a few percent of the excess, largest first.

    ``found``: the effects named, ``unmodelled``: whether something without a name is left.
    """
    if not found and not unmodelled and not joint.active:
        return ()
    table, beams = joint.observation.table, joint.fit.model.beams
    axis = np.array([{0: 'X', 1: 'Y', 2: 'Z'}.get(int(a)) for a in table.axis], dtype=object)
    excess = excess_of(joint, unmodelled)
    total = float(excess.sum())
    result = []
    for channel, columns in channels(beams).items():
        for number, setup in enumerate(table.setup_names):
            rows = table.setup == number
            cell = excess[rows, columns].sum(axis=1)
            if cell.sum() > LEAST_SHARE * total:
                result.append(Share(channel, setup, _only(axis[rows], cell),
                                    _only(table.direction[rows], cell), float(cell.sum()) / total))
    return tuple(sorted(result, key=lambda r: -r.share))


def excess_of(joint: Joint, unmodelled: bool = False) -> np.ndarray:
    """Excess variance of each reading (n, c), in units of its own noise; 0 in cells that hold only noise.

    What disturbs without a pattern lies where it adds to the readings' variance.
    """
    excess = _of_effects(joint) if joint.active else np.zeros(joint.fit.residual.shape)
    table = joint.observation.table
    added = as_noise(table)
    if added is not None:
        whole, held = np.nan_to_num(_sigma(joint) ** 2), table.disturbed
        # Of a variance that holds a disturbance, no less than a hundredth is the sensors' and the arrivals'.
        own = whole if held is None else np.maximum(whole - held, 0.01 * whole)
        excess = excess + added / np.maximum(own, 1e-32)
    elif excess.sum() < ONE_SIGMA and any(a.form.inside is not None for a in joint.active):
        return _inside(joint)
    elif unmodelled or not joint.active:
        excess = excess + _of_residuals(joint)
    if excess.any():
        return excess
    return _inside(joint) if joint.observation.swings is None or joint.active else _of_swings(joint)


def _of_effects(joint: Joint) -> np.ndarray:
    """What the effects add and the fit leaves, squared, less the part that their uncertainty makes."""
    space, result, shape = joint.parity, joint.fit, joint.fit.residual.shape
    columns = np.concatenate([a.form.columns * a.form.scale[:, None, None] for a in joint.active])
    seen = np.concatenate([space.project(a.form) for a in joint.active], axis=1)
    factor = inverse_root(seen.T @ seen + np.diag(prior_sigmas(a.form for a in joint.active) ** -2.0))
    # The unknowns follow a change of the coefficients by (JᵀJ + P)⁻¹ JᵀB; what they cannot follow is left.  Small as
    # the coefficients' own uncertainty is, that is straight; what all effects add need not be.
    follow = joint.followed(joint.along(joint.whitened(columns.reshape(len(columns), -1).T)))
    unit = np.where(result.present, 1.0 / _sigma(joint), 0.0).ravel()
    spread = unit[:, None] * (columns.reshape(len(columns), -1).T - result.jacobian @ follow) @ factor
    left = joint.left * unit.reshape(shape)
    excess = left**2 - np.sum(spread**2, axis=1).reshape(shape)

    def scatter(rows: np.ndarray) -> float:
        # Of a sum of squares of what is noise alone: twice the sum of its squared eigenvalues.
        cell = spread[rows]
        return float(np.sqrt(2.0 * np.sum((cell.T @ cell)**2)))

    named = all(a.effect.name for a in joint.active)
    kept = _significant(joint, excess, scatter, NAMED_CELL_SIGMAS if named else CELL_SIGMAS)
    # A swing with a phase of its own in every run may be sure as a whole and in no single cell.
    return left**2 if named and not kept.any() and all(a.form.inside is None for a in joint.active) else kept


def _of_residuals(joint: Joint) -> np.ndarray:
    """What the residuals of the fit have above their expectation."""
    result = joint.fit
    jacobian, sigma = result.jacobian.toarray(), _sigma(joint).ravel()
    taken = np.einsum('rk,kl,rl->r', jacobian, result.covariance, jacobian, optimize=True) / sigma**2
    residual = np.where(result.present, result.residual, 0.0).ravel() / sigma
    expected = np.where(result.present.ravel(), np.clip(1.0 - taken, 0.0, 1.0), 0.0)
    excess = (residual**2 - expected).reshape(result.residual.shape)
    return _significant(joint, excess, lambda rows: float(np.sqrt(2.0 * np.sum(expected[rows]**2))),
                        CELL_SIGMAS)


def _of_swings(joint: Joint) -> np.ndarray:
    """What lines in the spectrum of the dwells add to each channel (n, c), against the sensors' noise in a sample; 0 in
    setups where that comes to no more than nothing."""
    table, beams = joint.observation.table, joint.fit.model.beams
    swings = np.concatenate([np.repeat(joint.observation.swings[:, :1] / beams, beams, axis=1),
                             joint.observation.swings[:, 1:]], axis=1)
    noise = np.nanmedian(np.concatenate([table.displacement_scatter, table.spot_scatter], axis=1), axis=0)
    excess = np.zeros_like(swings)
    for number in range(len(table.setup_names)):
        mine = table.setup == number
        excess[mine] = np.maximum(swings[mine].mean(axis=0), 0.0) / noise**2
    return excess


def _inside(joint: Joint) -> np.ndarray:
    """What the dwells' insides show (n, c): squares of the effects' part, or above noise."""
    space, result = joint.parity, np.zeros(joint.fit.residual.shape)
    rest = unexplained(space, joint.active)[space.stops:]
    seen = space.data[space.stops:] - rest
    np.add.at(result, (space.row[space.stops:], space.channel[space.stops:]),
              seen**2 if seen.any() else np.maximum(rest**2 - 1.0, 0.0))
    return result


def _significant(joint: Joint, excess: np.ndarray, scatter, sigmas: float) -> np.ndarray:
    """The excess (n, c) without the cells (channel, setup) that noise alone could make, within ``sigmas``.

    ``scatter``: standard deviation of a cell's sum by noise alone, from the flat numbers of its readings.
    """
    setup, channels = joint.observation.table.setup, excess.shape[1]
    kept = np.zeros_like(excess)
    for number in np.unique(setup):
        for c in range(channels):
            rows = np.flatnonzero(setup == number)
            if excess[rows, c].sum() > sigmas * scatter(rows * channels + c):
                kept[rows, c] = excess[rows, c]
    return kept


def _sigma(joint: Joint) -> np.ndarray:
    """Standard deviation (n, c) [m] of each reading by itself, arrival errors included."""
    noise, arrival = joint.noise, joint.fit.arrival
    return np.sqrt(noise.sensor**2 + noise.angle**2 * np.sum(arrival[:2]**2, axis=0)
                   + noise.position**2 * np.sum(arrival[2:]**2, axis=0))


def _only(labels: np.ndarray, excess: np.ndarray):
    """The label that holds nearly all of the excess, or None."""
    total = excess.sum()
    for label in sorted(set(labels.tolist()) - {None}):
        if excess[labels == label].sum() > CONCENTRATED * total:
            return int(label) if isinstance(label, int) else label
    return None
