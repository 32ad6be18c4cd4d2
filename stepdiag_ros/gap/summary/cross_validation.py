"""How far the gap closes on runs that took no part in the fit.

All repeats but one are fitted, with and without the effects, and that one is predicted; each repeat has
its turn, for what one repeat's noise leaves open of a small gap the others settle.  A log of one run, as a table of
cycles is, is split in time: its last repeats are predicted from those before.  Fits are linear at the joint fit.
The gap is a distance: the root mean square [m] of what is read and was not fitted less what is predicted of it, before
and after, beside what noise alone makes.  Of lengths or of spots, whichever stands out of its noise more.  Beside it
stands how large the error is against what the forecast expected of itself, its noise and the uncertainty of
what was fitted; a forecast so wide that it says nothing is right by that measure and closes nothing by the other.
What a further part will show is said with an interval (:mod:`summary.further_part`).
The reset of a run that was not fitted is not known and is given free.  Beside that each setup is predicted from the
others, with the misalignments of its own no better known than before the log.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import linalg, sparse

from stepdiag_ros.estimate.dense import block_of
from stepdiag_ros.estimate.enhanced import readings_of
from stepdiag_ros.estimate.noise import Whitener
from stepdiag_ros.gap.constants import PRIOR_RESET_M
from stepdiag_ros.gap.inference.joint import Joint, prior_sigmas
from stepdiag_ros.gap.summary.forecast import HeldOut, Run
from stepdiag_ros.gap.summary.further_part import Limits, limits

ONCE = 0.05
"""Share of an effect's columns outside the part held out below which the effect happened in that part alone."""
TOO_WIDE = 0.5
"""A forecast that is uncertain by more than this share of the gap says nothing of how far it closes."""


@dataclass(frozen=True)
class Distance:
    """Root mean squares [m] of held-out readings of one kind: less their forecast ``before`` and ``after`` the effects,
    what noise alone makes, ``floor``, and the forecast's own uncertainty after, ``sigma``; limits [m] of what a further
    part will show with 95 %, ``before_95`` and ``after_95``, None where nothing was held out."""

    before: float
    after: float
    floor: float
    sigma: float = 0.0
    before_95: Limits | None = None
    after_95: Limits | None = None

    @property
    def stands_out(self) -> float:
        """Excess of the mean square before, in units of the noise's."""
        return self.before**2 / self.floor**2 - 1.0 if self.floor > 0.0 else -1.0

    @property
    def left(self) -> float:
        """Share of the mean square before, above noise, that is there after."""
        return self._left_of(self.after)

    @property
    def closed_95(self) -> Limits | None:
        """Share of the mean square before, above noise, that is gone in a further part, with 95 %."""
        return self.after_95 and (1.0 - self._left_of(self.after_95[1]), 1.0 - self._left_of(self.after_95[0]))

    def _left_of(self, after: float) -> float:
        return float(np.clip((after**2 - self.floor**2) / max(self.before**2 - self.floor**2, 1e-300), 0.0, 1.0))

    def to_json_dict(self) -> dict:
        stated = {'before_95_m': self.before_95, 'after_95_m': self.after_95, 'closed_95': self.closed_95}
        return {'before_m': self.before, 'after_m': self.after, 'noise_floor_m': self.floor,
                'forecast_sigma_m': self.sigma, **{key: list(of) for key, of in stated.items() if of}}


@dataclass(frozen=True)
class CrossValidation:
    """How far the gap closes on what was ``held_out``, in words.

    ``before`` and ``after``: reduced χ² of the forecast, in units of what it expects of itself, over ``count`` readings
    and a noise known to ``noise_dof`` degrees of freedom.  ``distances`` [m] by kind, 'displacement' and 'spot'.
    """

    before: float
    after: float
    count: int
    noise_dof: float
    held_out: str
    distances: Mapping[str, Distance]

    @property
    def channel(self) -> str:
        """The kind of reading, 'displacement' or 'spot', whose gap stands out of its noise more."""
        return max(self.distances, key=lambda kind: self.distances[kind].stands_out)

    @property
    def gap(self) -> Distance:
        """The distances of that kind."""
        return self.distances[self.channel]

    @property
    def before_m(self) -> float:
        return self.gap.before

    @property
    def after_m(self) -> float:
        return self.gap.after

    @property
    def floor_m(self) -> float:
        return self.gap.floor

    def to_json_dict(self) -> dict:
        return {**self.gap.to_json_dict(), 'channel': self.channel,
                'by_channel': {kind: distance.to_json_dict() for kind, distance in self.distances.items()},
                'held_out': self.held_out, 'reduced_chi2_before': self.before, 'reduced_chi2_after': self.after}

    @property
    def left(self) -> float:
        """Share of the excess before that is there after; 0 where chance alone may leave it (five σ).

        Where the forecast is as wide as the gap, by the distance that is left.
        """
        if self.gap.sigma > TOO_WIDE * self.gap.before:
            return self.gap.left
        return (self.after - 1.0) / (self.before - 1.0) if self.beyond_chance and self.before > self.after else 0.0

    @property
    def beyond_chance(self) -> bool:
        """Whether more is left than the forecast expects of itself and chance may add (five σ)."""
        return self.after > 1.0 + 5.0 * np.sqrt(2.0 / max(self.count, 1) + 2.0 / max(self.noise_dof, 1.0))


def cross_validated(joint: Joint, alone: Joint | None = None) -> CrossValidation:
    """Fit on all repeats but one and predict that one, each in turn.

    ``alone``: the fit of the machine without effects.  Where it leaves more than seems to be left at the joint fit, a
    linear step from there does what the machine cannot, and the gap before is that at ``alone``.
    """
    place = alone if alone is not None and _left(alone) > _left(joint) else joint
    return _cross_validated(joint, place, *_held_out(joint.observation.table))


def cross_validated_by_setup(joint: Joint) -> CrossValidation | None:
    """Fit on all setups but one and predict that one, each in turn; None where there is but one."""
    setup = joint.observation.table.setup
    parts = [setup == s for s in np.unique(setup)]
    if len(parts) < 2:
        return None
    return _cross_validated(joint, joint, parts, 'each setup in turn, predicted from the others')


def _cross_validated(joint: Joint, place: Joint, parts: list[np.ndarray], name: str) -> CrossValidation:
    """``place``: the fit at which the gap before is taken; ``parts``: masks (n,) of the stops held out in turn."""
    after = _predicted(joint, parts, with_effects=True)
    before = _predicted(place, parts, with_effects=False) if joint.active else after
    freedom = max(after.freedom, 1)
    alone = any(part.all() for part in parts)
    distances = {kind: Distance(before.parts[kind].error, of.error, of.floor, of.sigma,
                                *((None, None) if alone else (before.parts[kind].further, of.further)))
                 for kind, of in after.parts.items()}
    return CrossValidation(before.chi2 / freedom, after.chi2 / freedom, after.count, float(sum(joint.noise.dof)), name,
                   distances)


def _left(joint: Joint) -> float:
    """Squares that the machine alone leaves of the stops, linear at a joint fit."""
    data = joint.parity.data[:joint.parity.stops]
    return float(data @ data)


@dataclass(frozen=True)
class _Parts:
    """Readings of one kind in the parts held out, of the repeats where that is but one.

    ``squares`` (K, 5): sums of squares [m²] of errors, of noise, of what the forecast is uncertain by, their degrees of
    freedom, and the sum of squares [m⁴] of the covariance expected.
    """

    squares: np.ndarray

    def _rms(self, column: int) -> float:
        total = self.squares.sum(axis=0)
        return float(np.sqrt(max(total[column], 0.0) / max(total[3], 1.0)))

    @property
    def error(self) -> float:
        """Root mean square [m] of what is read less what is predicted, …"""
        return self._rms(0)

    @property
    def floor(self) -> float:
        """… of noise alone, …"""
        return self._rms(1)

    @property
    def sigma(self) -> float:
        """… and of what the forecast is uncertain by."""
        return self._rms(2)

    @property
    def further(self) -> Limits:
        """Limits [m] of the root mean square of errors in a further part."""
        error, noise, forecast, count, fourth = self.squares[self.squares[:, 3] > 0.0].T
        expected = noise + forecast
        dof = float(np.sum(expected) ** 2 / max(np.sum(fourth) * len(error), 1e-300))
        # Of a part that errs by s² more than its noise M in each of n readings the square varies by 4 s² M/n: as one of
        # n s²/2M degrees of freedom does.
        dof *= max(1.0, 0.5 * float(np.sum(error) / max(np.sum(expected), 1e-300)))
        low, high = limits(error / count, dof)
        return float(np.sqrt(low)), float(np.sqrt(high))


@dataclass(frozen=True)
class _Forecast:
    """χ² of all that is held out, ``count`` readings with ``freedom`` degrees of freedom; the parts by kind of
    reading."""

    chi2: float
    freedom: int
    count: int
    parts: Mapping[str, _Parts]


def _predicted(joint: Joint, parts: list[np.ndarray], with_effects: bool) -> _Forecast:
    """All that is held out, predicted from the rest."""
    table, result = joint.observation.table, joint.fit
    white, unknown = _with_resets(joint, parts)
    channels, beams = result.residual.shape[1], result.model.beams
    plain = np.where(result.present, readings_of(table) - result.model.predict(result.theta), 0.0).ravel()
    jacobian, precision = result.jacobian[:, unknown], result.precision[np.ix_(unknown, unknown)]
    offsets = np.flatnonzero(unknown >= result.parameters.offset_first)
    precision[offsets, offsets] = PRIOR_RESET_M**-2.0
    sizes = np.zeros(0)
    if with_effects and joint.active:
        columns = np.concatenate([a.form.columns.reshape(len(a.form.columns), -1).T * a.form.scale
                                  for a in joint.active], axis=1)
        jacobian = sparse.hstack([jacobian, sparse.csr_array(columns)], format='csr')
        precision = linalg.block_diag(precision, np.diag(prior_sigmas(a.form for a in joint.active) ** -2.0))
        sizes = np.concatenate([a.coefficients / a.form.scale for a in joint.active])
    runs = [Run(w, jacobian[w.rows], plain[w.rows]) for w in white]
    rest = HeldOut(runs, [[held[run.whitener.rows // channels] for run in runs] for held in parts], precision)
    noise = {int(w.rows[0]): w for w in joint.parity.projection.white}
    total, freedom, count = 0.0, 0, 0
    among = table.repeat if len(parts) == 1 else np.argmax(parts, axis=0)
    sums = {kind: np.zeros((among.max() + 1, 5)) for kind in ('displacement', 'spot')}
    for number, held in enumerate(parts):
        new = np.setdiff1d(table.run[held], table.run[~held])
        chi2, expected, covariance = rest.forecast(number)
        once = np.flatnonzero(rest.size(number) < ONCE * rest.size())
        once = once[once >= len(unknown)]
        # What happened once, in the part held out, nothing can predict: it is taken as the whole log shows it.
        expected[once] = sizes[once - len(unknown)]
        covariance[once], covariance[:, once] = 0.0, 0.0
        total += chi2
        freedom -= len(new) * beams if np.isfinite(table.displacement[held]).any() else 0
        for run, flag in rest.rows(number):
            rows, own = run.whitener.rows, run.left(expected)
            factor = noise[int(rows[0])].factor
            freedom, count = freedom + int(flag.sum()), count + int(flag.sum())
            fresh = bool(table.run[rows[0] // channels] in new)
            part = among[rows // channels]
            for channel, k in np.unique(np.column_stack([rows % channels, part])[flag], axis=0):
                mine = flag & (rows % channels == channel) & (part == k)
                length = channel < beams
                sums['displacement' if length else 'spot'][k] += _squares(
                    own[mine], run.jacobian[mine], covariance, factor[mine], fresh and bool(length))
    return _Forecast(total, freedom, count, {kind: _Parts(of) for kind, of in sums.items() if np.any(of[:, 3] > 0.0)})


def _with_resets(joint: Joint, parts: list[np.ndarray]) -> tuple[list[Whitener], np.ndarray]:
    """Whiteners, one a run, of the noise and of the resets of the runs that no part splits; the numbers (r,) of the
    other unknowns.  So the unknowns do not grow with the runs."""
    result, run = joint.fit, joint.observation.table.run
    split = np.zeros(result.parameters.runs, bool)
    for held in parts:
        split[np.intersect1d(run[held], run[~held])] = True
    first, channels = result.parameters.offset_first, result.residual.shape[1]
    resets, white = result.jacobian[:, first:], []
    for one in joint.parity.projection.white:
        factor = one.factor
        if not split[run[one.rows[0] // channels]]:
            _, shared = block_of(resets, one.rows)
            factor = linalg.cholesky(factor @ factor.T + PRIOR_RESET_M**2 * shared @ shared.T, lower=True)
        white.append(Whitener.of(one.rows, factor))
    apart = np.flatnonzero(np.repeat(split, result.parameters.beams))
    return white, np.concatenate([np.arange(first), first + apart])


def _squares(error: np.ndarray, design: sparse.csr_array, covariance: np.ndarray, factor: np.ndarray,
             fresh: bool) -> np.ndarray:
    """The ``squares`` (5,) of :class:`_Parts` of some rows of a beam in a run: of their ``error`` (m,), of noise, whose
    Cholesky ``factor`` (m, …) has these rows, and of the forecast, with the ``covariance`` of its unknowns.  In a
    ``fresh`` run what all have in common is its reset, and no error."""
    noise, forecast = factor @ factor.T, design @ (design @ covariance).T
    if fresh:
        error, noise, forecast = error - error.mean(), _centred(noise), _centred(forecast)
    return np.array([error @ error, np.trace(noise), np.trace(forecast), len(error) - fresh,
                     np.sum((noise + forecast) ** 2)])


def _centred(covariance: np.ndarray) -> np.ndarray:
    """The covariance (m, m) of readings less their mean."""
    less = covariance - covariance.mean(axis=0)
    return less - less.mean(axis=1, keepdims=True)


def excess_forecast(how_far: CrossValidation) -> tuple[float, str]:
    """Log evidence that the part held out is predicted worse than noise allows, and that in words.

    A log may be fitted to the noise by errors that are not those of the machine, bent until they follow
    whatever disturbs it; then they do not predict.  Of forecasts made in turn from each other only half are counted
    as independent.
    """
    ratio, count = how_far.after, 1.0 / (2.0 / max(how_far.count, 1) + 1.0 / max(how_far.noise_dof, 1.0))
    gain = 0.5 * count * (ratio - 1.0 - np.log(ratio)) if ratio > 1.0 else 0.0
    return gain, f'{how_far.held_out} is predicted {np.sqrt(max(ratio, 0.0)):.2f} times worse than noise allows'


def _held_out(table) -> tuple[list[np.ndarray], str]:
    """Masks (n,) of the stops held out in turn, whole runs or the end of the only one; and their name."""
    repeats, runs = np.unique(table.repeat), np.unique(table.run)
    if len(repeats) > 1:
        whole = all(len(np.unique(table.repeat[table.run == run])) == 1 for run in runs)
        if whole:
            return [table.repeat == repeat for repeat in repeats], 'each repeat in turn, predicted from the others'
        if len(runs) == 1:
            # White rows of a run are what is new at each stop given those before: those at its end are a forecast.
            last = len(repeats) // 2
            return [table.repeat >= repeats[-last]], (
                f'the last {last} of {len(repeats)} repeats, predicted from those before')
    if len(runs) > 1:
        chosen = runs[len(runs) // 2:][::2] if len(runs) > 3 else runs[-1:]
        return [np.isin(table.run, chosen)], 'runs ' + ', '.join(table.run_ids[r] for r in chosen)
    return [np.ones(len(table), bool)], 'none: the log is one run'
