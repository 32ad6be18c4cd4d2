"""Everything that the diagnosis looks at, brought into one shape.

A log is reduced to stops, as recorded: vacuum lengths are divided by one index of air, and what the air does during
the log stays in, for the diagnosis to find.  The rigid-body model is fitted, and what an effect may depend on is laid
beside: times, directions of approach, strikes on the mirror, derivatives, the environment.  Inside each dwell the
samples are averaged in a few bins, so that what creeps or settles is kept.
"""

from dataclasses import dataclass

import numpy as np

from stepdiag_ros.effects.base import StopView
from stepdiag_ros.estimate.enhanced import Fit, fit, readings_of
from stepdiag_ros.estimate.metres import unusable, with_one_index
from stepdiag_ros.estimate.noise import NoiseModel
from stepdiag_ros.estimate.reduce import StopTable, reduce_log
from stepdiag_ros.model.air import refractive_index
from stepdiag_ros.model.description import Description
from stepdiag_ros.model.log import CalibrationLog, ScalarSeries
from stepdiag_ros.model.path import setup_direction
from stepdiag_ros.model.surroundings import LIMITS

BINS = 5
"""Parts of a dwell in which it is looked for what goes on there."""
SETTLED = 1e-2
"""The diagnosis needs a fit to a hundredth of a standard deviation, not to the last digit [χ²]."""
FIRST = 5
"""Readings of an environment sensor that are averaged where the log begins."""
BADLY_FITTED = 4.0
"""Reduced χ² above which the noise is scaled up for the fit, so that a large effect bends it less."""


def channels(beams: int) -> dict[str, slice]:
    """The channels of the readings by name: their columns; all beams measure one displacement."""
    return {'displacement': slice(0, beams), 'spot_x': slice(beams, beams + 1), 'spot_y': slice(beams + 1, beams + 2)}


@dataclass(frozen=True)
class Observation:
    """A log made ready: ``table`` and nominal ``fit``; ``view`` for effects.

    ``bins`` (n, b, c) [m]: means of the dwell's bins minus the dwell's mean, NaN where a bin is empty;
    ``bin_sigma`` (n, c) [m]: noise of one bin's mean.  ``swings`` (n, 3) [m²]: what lines in the spectrum of the
    dwells add to displacement and spot, beyond the noise on average; None where there are none.
    """

    log: CalibrationLog
    table: StopTable
    fit: Fit
    view: StopView
    bins: np.ndarray
    bin_sigma: np.ndarray
    swings: np.ndarray | None = None


def observe(log: CalibrationLog) -> Observation:
    """Reduce, fit and lay out; raises :class:`~stepdiag_ros.errors.StepdiagError` as the reduction does."""
    table = with_one_index(log, reduce_log(log, cut=True))
    nominal = sane_fit(log, table)
    bins, sigma, time = _bins(log, table)
    return Observation(log, table, nominal, view_of(log, table, nominal, time), bins, sigma)


def sane_fit(log: CalibrationLog, table: StopTable, theta: np.ndarray | None = None,
             noise: NoiseModel | None = None) -> Fit:
    """The nominal fit; where the model fails grossly, with the noise scaled up until it does not.

    The priors of the unknowns then hold machine and misalignments to plausible sizes instead of
    letting them explain the gap away.  ``theta`` starts the iteration; ``noise``: if not as the repeats show it.
    """
    result = fit(log.description, table, noise=noise, theta=theta, settled=SETTLED)
    noise, scale = result.noise, 1.0
    for _ in range(6):
        reduced = result.chi2 / max(result.dof, 1)
        if np.isfinite(reduced) and reduced < BADLY_FITTED:
            break
        scale *= np.sqrt(max(reduced, BADLY_FITTED)) if np.isfinite(reduced) else 100.0
        result = fit(log.description, table, noise=noise.scaled(scale), theta=theta, settled=SETTLED)
    return result


def view_of(log: CalibrationLog, table: StopTable, nominal: Fit,
            bin_time: np.ndarray) -> StopView:
    """What effects depend on, at the nominal fit."""
    model = nominal.model
    readings, local, arrival = model.local_derivatives(nominal.theta)
    beams = model.beams
    (air, first_air), (scales, first_scales) = _air(log, table), _scales(log, table)
    offsets = nominal.theta[model._offset_column]
    return StopView(
        log.description, table.run_ids, table.setup_names, table.time_s,
        _since(table.time_s, table.run), _since(table.time_s, table.setup),
        table.run, table.setup, table.repeat, table.direction, table.index, table.axis,
        _approach(log.description, table), table.commanded, readings[:, :beams] - offsets, readings_of(table),
        readings, _strikes(table, nominal), local[:18], local[18:20], local[20:22],
        arrival[2:5], table.intensity, _quality(log, table), table.refractive_index,
        air, scales, bin_time, first_air, first_scales, _lead(log, table))


def _since(time: np.ndarray, group: np.ndarray) -> np.ndarray:
    result = np.empty_like(time)
    for g in np.unique(group):
        rows = group == g
        result[rows] = time[rows] - time[rows].min()
    return result


def _approach(description: Description, table: StopTable) -> np.ndarray:
    """Sign of each axis's last motion at each stop (n, 3), followed from stop to stop in a setup.

    How the machine came to a setup's first stop is not in the log: 0 until an axis has moved.  Where the ends are
    approached from beyond, each stop was come to in the direction of its traverse.
    """
    sign = np.zeros((len(table), 3))
    step = np.sign(np.diff(table.commanded, axis=0, prepend=table.commanded[:1]))
    step[np.concatenate([[True], np.diff(table.setup) != 0])] = 0.0
    for number, name in enumerate(table.setup_names):
        if description.setups[name].overrun:
            mine = table.setup == number
            along = np.sign(np.round(setup_direction(description.machine, description.setups[name]), 9))
            step[mine] = along * np.sign(table.direction[mine, None])
    for i in range(len(table)):
        known = sign[i - 1] if i and table.setup[i] == table.setup[i - 1] else np.zeros(3)
        sign[i] = np.where(step[i] != 0.0, step[i], known)
    return sign


def _strikes(table: StopTable, nominal: Fit) -> np.ndarray:
    """Where beams meet the mirror, from its reference point along (u, v): (n, beams + 1, 2) [m]."""
    model, theta = nominal.model, nominal.theta
    point, attitude, _, _ = model._pose(*model.motions(theta), derivative=False)
    beam, _, mounted, _ = model._directions(theta)
    normal = np.einsum('nij,nj->ni', attitude, mounted)
    result = np.empty((len(table), model.beams + 1, 2))
    for k in range(model.beams + 1):
        origin = model._origin[k]
        length = np.sum((point - origin) * normal, -1) / np.sum(beam * normal, -1)
        strike = origin + length[:, None] * beam - point
        result[:, k] = np.einsum('nki,ni->nk', model._triad[:, :2], strike)
    result[model.follows] = 0.0    # a retroreflector has no places
    return result


def _quality(log: CalibrationLog, table: StopTable) -> np.ndarray:
    health = log.displacement.health
    return np.array([health[lo:hi].mean() if hi > lo else np.nan
                     for lo, hi in table.displacement_rows])


def _interpolate(series: ScalarSeries, table: StopTable) -> np.ndarray:
    """A quantity at the stops."""
    return series.at((table.dwell_ns + table.done_ns) // 2)


def _air(log: CalibrationLog, table: StopTable) -> tuple[np.ndarray | None, float | None]:
    """Index of air at the stops and when the log began, from temperature, pressure and humidity; None
    without the first two."""
    told = [_told(log, topic, quantity) for topic, quantity in (
        ('air_temperature', 'temperature'), ('air_pressure', 'pressure'), ('humidity', 'humidity'))]
    if told[0] is None or told[1] is None:
        return None, None
    quantities = [np.full(len(table) + 1, 0.45) if series is None else
                  np.append(_interpolate(series, table), _first(series)) for series in told]
    index = refractive_index(*quantities)
    return index[:-1], float(index[-1])


def _scales(log: CalibrationLog, table: StopTable) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Temperatures of the scales at the stops (n, 3) and when the log began (3,); None without sensors."""
    found = [_told(log, f'scale_temperature/{axis}', 'temperature') for axis in 'xyz']
    if all(series is None for series in found):
        return None, None
    return (np.stack([np.full(len(table), np.nan) if series is None else _interpolate(series, table)
                      for series in found], axis=1),
            np.array([np.nan if series is None else _first(series) for series in found]))


def _told(log: CalibrationLog, topic: str, quantity: str) -> ScalarSeries | None:
    """The readings of a topic that can be such a quantity in its unit; None where there are none."""
    series = log.environment.get(topic)
    return None if series is None or unusable(series, LIMITS[quantity]) else series


def _first(series: ScalarSeries) -> float:
    """A quantity when the log began, from its first few readings."""
    return float(np.mean(series.value[np.isfinite(series.value)][:FIRST]))


def _lead(log: CalibrationLog, table: StopTable) -> float:
    """Time [s] from the log's first message to the first dwell: what drifts has begun by then."""
    stamps = [series.time_ns for series in (*log.environment.values(), log.displacement, log.spot)]
    first = min((int(stamp[0]) for stamp in stamps if len(stamp)), default=int(table.dwell_ns.min()))
    return max(float(table.dwell_ns.min() - first) * 1e-9, 0.0)


def _bins(log: CalibrationLog, table: StopTable) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Bin means minus dwell means (n, b, c) [m], their noise (n, c) [m], mean times of the bins' samples
    after the dwell began (n, b) [s]."""
    n, beams = len(table), table.displacement.shape[1]
    bins = np.full((n, BINS, beams + 2), np.nan)
    sigma = np.full((n, beams + 2), np.nan)
    length = (table.done_ns - table.dwell_ns) * 1e-9
    time = length[:, None] * (np.arange(BINS) + 0.5) / BINS
    for samples, rows, columns in ((log.displacement, table.displacement_rows, slice(0, beams)),
                                   (log.spot, table.spot_rows, slice(beams, None))):
        # By setup: each has its own distance and its own light.
        differences: dict[int, list[tuple[int, np.ndarray, float]]] = {}
        for i, (lo, hi) in enumerate(rows):
            if hi - lo < BINS or length[i] <= 0.0:
                continue
            good = np.isfinite(samples.values[lo:hi]).all(axis=1)
            values = samples.values[lo:hi][good]
            if len(values) < BINS:
                continue
            values = values - values[0]
            since = samples.time_ns[lo:hi][good] - table.dwell_ns[i]
            # In whole nanoseconds: on a common time grid rounding would put some samples a bin too early.
            place = np.clip(since * BINS // (table.done_ns[i] - table.dwell_ns[i]), 0, BINS - 1)
            count = np.bincount(place, minlength=BINS)
            if np.any(count == 0):
                if len(values) < hi - lo:
                    continue
                # Few samples, and none in the dwell's last part: as many as may be in each.
                place = np.arange(len(values)) * BINS // len(values)
                count = np.bincount(place, minlength=BINS)
            sums = np.stack([np.bincount(place, values[:, k], BINS)
                             for k in range(values.shape[1])], axis=1)
            bins[i, :, columns] = sums / count[:, None] - values.mean(axis=0)
            if columns.start == 0:
                time[i] = np.bincount(place, since * 1e-9, BINS) / count
            differences.setdefault(int(table.setup[i]), []).append(
                (i, np.mean(np.abs(np.diff(values, axis=0)), axis=0), 1.0 / np.mean(1.0 / count)))
        # The noise of one sample from neighbours in time, which creep and slow motion leave alone.
        for alike in differences.values():
            # The mean, not the median: readings in steps of a converter often differ by none at all.
            middle = np.median([d for _, d, _ in alike], axis=0) * np.sqrt(np.pi) / 2.0
            for i, _, count in alike:
                sigma[i, columns] = np.maximum(middle, 1e-12) / np.sqrt(count)
    return bins, sigma, time
