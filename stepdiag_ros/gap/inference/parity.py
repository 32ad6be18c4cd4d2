"""Parity space: what the fitted model leaves free, in units of the noise.

Readings are whitened with the noise of the log and everything that a change of the 21 errors, the
misalignments or a reset can imitate, within the priors that the fit gives them, is projected out.
What an effect adds to the log is seen here and only here; judged on plain residuals it would be
mistaken for what the fit made of it.
The bins of the dwells, which the rigid-body model does not touch, are appended as contrasts.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from stepdiag_ros.effects.base import Form
from stepdiag_ros.effects.made import Split
from stepdiag_ros.estimate.correlated import SLOPE_AND_BEND, contrasts
from stepdiag_ros.estimate.enhanced import Fit
from stepdiag_ros.estimate.noise import NoiseModel, loudness
from stepdiag_ros.gap.inference.projection import Projection
from stepdiag_ros.gap.preprocess.observe import Observation
from stepdiag_ros.model.log import STOOD

DISCREPANCY = 0.3
"""What happens inside the dwells is seen to nanometres; no form describes it to better than this share."""
CLIP = 6.0
"""Robust standard deviations to which contrasts of bins are held."""
ALONE = 10.0
"""A dwell whose contrasts exceed those of the dwells before and after it so many times, and what they are held to
``BY_FAR`` times, is one in which something happened once: a slip, a knock."""
BY_FAR = 3.0
FOLDED = 1e-3
"""Growth of a length with its reading below which no counter could have counted it."""
ROUNDING = 1e-9
"""Share of the largest contrast, of a column or among those of a course, below which it is rounding."""
LEAST_DIFFERENCES = 8
"""Differences of slopes that tell nothing yet of how rough these are."""
LEAST_ALIKE = 3
"""Fewest dwells of one kind from which their typical size is estimated: the median of three stands one that errs."""


@dataclass(frozen=True)
class Parity:
    """The projection for one linearisation.

    ``data`` (N,): white residuals, stops first (``stops`` of them, the unknowns' own departures from what they
    are held to at the end), then bins.  ``dof``: of the stops'
    part and of the bins' part.  ``channel`` (N,): channel of each row (0 … beams + 1), ``row`` (N,): its
    stop.  ``bin_scale`` (c,): factor by which a channel's bins were found noisier than their samples.
    ``projection``: of the stops' part.
    """

    data: np.ndarray
    stops: int
    dof: tuple[int, int]
    channel: np.ndarray
    row: np.ndarray
    bin_scale: np.ndarray
    projection: Projection
    _contrast: np.ndarray
    _bin_sigma: np.ndarray
    _bin_present: np.ndarray

    @property
    def size(self) -> int:
        return len(self.data)

    @cached_property
    def quiet(self) -> float:
        """What the squared data of the bins lack of their number.  Bins are held to be noisier than they are, for no
        form describes well what goes on in a dwell: that says nothing of how noisy the stops are."""
        inside = self.data[self.stops:]
        return max(len(inside) - float(inside @ inside), 0.0)

    @property
    def of_spot(self) -> np.ndarray:
        """Which rows (N,) are of the spot, not of a length."""
        return self.channel >= self._bin_present.shape[-1] - 2

    def white_part(self, columns: np.ndarray, resets: bool = False) -> np.ndarray:
        """White columns, not yet projected: (k, n, c) → (stops, k); nothing at the unknowns' own rows.  ``resets``:
        with what the resets can imitate."""
        # Laid out column by column, as they come and as the triangular solver takes them.
        result = np.zeros((self.stops, len(columns)), order='F')
        for rows, there, part in self.white_runs(columns, resets):
            result[rows, there] = part
        return result

    @cached_property
    def run_of_stop(self) -> np.ndarray:
        """Numbers (n,) among :attr:`Projection.runs` of the stops' runs; −1 where no reading is there."""
        run = np.full(len(self._bin_present), -1)
        for number, white in enumerate(self.projection.white):
            run[white.rows // self._bin_present.shape[2]] = number
        return run

    def white_runs(self, columns: np.ndarray,
                   resets: bool = False) -> Iterator[tuple[slice, np.ndarray, np.ndarray]]:
        """Run by run, what of :meth:`white_part` is not zero: its rows, the numbers (m,) of its columns, the values."""
        for number in range(len(self.projection.white)):
            yield self.white_run(columns, number, resets)

    def white_run(self, columns: np.ndarray, number: int,
                  resets: bool = False) -> tuple[slice, np.ndarray, np.ndarray]:
        """The same of one run, the ``number`` of :attr:`run_of_stop`."""
        white = self.projection.white[number]
        there, part = self._read(columns, white.rows)
        doing = part.any(axis=0)
        solve = white.solve if resets else white.forward
        return self.projection.runs[number], there[doing], solve(part[:, doing])

    def _read(self, columns: np.ndarray | Split, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What columns (k, n, c) do in some ``rows`` (r,) of all readings: the numbers (m,) of those that may do
        something, and (r, m) of it."""
        if not isinstance(columns, Split):
            # A run's rows lie side by side in every column: gathered so, they are read in order.
            return np.arange(len(columns)), columns.reshape(len(columns), -1)[:, rows].T
        stop, channel = np.divmod(rows, self._bin_present.shape[2])
        stops, place = np.unique(stop, return_inverse=True)
        there, part = columns.at(stops)
        return there, part[:, np.ravel(place), channel].T

    def white_at(self, stops: np.ndarray, values: np.ndarray) -> sparse.csc_array:
        """White columns (stops, m), not yet projected, of what happens at one of ``stops`` (m,) each, ``values`` (m, c)
        there: a column reaches no further than its run."""
        channels, run = self._bin_present.shape[2], self.run_of_stop[stops]
        rows, columns, parts = [], [], []
        for number, white in enumerate(self.projection.white):
            mine = np.flatnonzero(run == number)
            stop, channel = np.divmod(white.rows, channels)
            part = white.forward((stop[:, None] == stops[mine]) * values[mine][:, channel].T)
            at = self.projection.runs[number]
            rows.append(np.repeat(np.arange(at.start, at.stop), len(mine)))
            columns.append(np.tile(mine, at.stop - at.start))
            parts.append(part.ravel())
        return sparse.csc_array((np.concatenate(parts), (np.concatenate(rows), np.concatenate(columns))),
                                shape=(self.stops, len(stops)))

    def stop_part(self, columns: np.ndarray) -> np.ndarray:
        """White, projected columns: (k, n, c) → (stops, k)."""
        return self.projection.projected(self.white_part(columns))

    def bin_part(self, inside: np.ndarray) -> np.ndarray:
        """White contrasts of bins: (k, n, b, c) → (N − stops, k)."""
        white = (self._contrast @ inside) * self._bin_weight
        return white.reshape(len(inside), -1)[:, self._bin_places].T

    def stops_back(self, directions: np.ndarray) -> np.ndarray:
        """Directions (stops, r) as the readings' whose products with columns are those of the white ones: (n, c, r)."""
        n, c = len(self._bin_present), self._bin_present.shape[2]
        result = np.zeros((n * c, directions.shape[1]))
        for rows, white in zip(self.projection.runs, self.projection.white, strict=True):
            result[white.rows] = white.backward(directions[rows])
        return result.reshape(n, c, directions.shape[1])

    def dwells_by(self, course: np.ndarray) -> sparse.csr_array:
        """Sums (n·c, N − stops) that bring directions of the contrasts back to what goes on inside the dwells by one
        ``course`` (n, b), the same in all channels: its white contrasts, but for rounding."""
        contrast = (self._contrast @ course[:, :, None])[:, :, 0]
        contrast = np.where(np.abs(contrast) > ROUNDING * np.abs(contrast).max(initial=0.0), contrast, 0.0)
        white = (contrast[:, :, None] * self._bin_weight).ravel()[self._bin_places]
        there = np.flatnonzero(white)
        n, _, c = self._bin_present.shape
        stop, _, channel = np.unravel_index(self._bin_places[there], self._bin_present.shape)
        return sparse.csr_array((white[there], (stop * c + channel, there)), shape=(n * c, len(white)))

    @cached_property
    def _bin_places(self) -> np.ndarray:
        """Flat places of the contrasts (n, h, c) that are there."""
        return np.flatnonzero(self._bin_present)

    @cached_property
    def bends(self) -> np.ndarray:
        """Which contrasts (N − stops,) are of higher degree than a slope."""
        return np.unravel_index(self._bin_places, self._bin_present.shape)[1] > 0

    @cached_property
    def _bin_weight(self) -> np.ndarray:
        return 1.0 / (self.bin_scale * self._bin_sigma)

    @property
    def own_share(self) -> np.ndarray:
        """Share (n·c,) of each reading's own noise that is left here after the fit; 0 for what is absent.

        Where beams side by side share their noise it is the diagonal of an oblique projection, which need be no share.
        """
        return self._shares[0]

    @cached_property
    def _shares(self) -> tuple[np.ndarray, np.ndarray]:
        """:attr:`own_share`, and the share (m,) of each white row of readings that can be imitated."""
        share, imitated = np.zeros(len(self._bin_present) * self._bin_present.shape[2]), []
        for number, white in enumerate(self.projection.white):
            basis = np.concatenate([white.free, self.projection.directions(number)], axis=1)
            taken = np.sum((white.factor @ basis) * white.solve_back(basis), axis=1)
            share[white.rows] = np.clip(1.0 - taken, 0.0, 1.0)
            imitated.append(np.sum(basis**2, axis=1))
        return share, np.concatenate(imitated)

    def own_rows(self, form: Form) -> np.ndarray:
        """The Jacobian correction of columns made of readings, as rows (m, k) beside those of the data, against
        ``own_data`` (m,), per unit of the form's ``scale``.

        Data z = r − model − a·c(r) have the density of the noise times |∂z/∂r| = Π(1 − a·c′(r)); the
        logarithm of that, −Σ a·c′ − ½ Σ (a·c′)², is, but for a constant, −½ Σ (a·c′ + 1)²: as if each reading had been
        read once more, as −1.  So two forms made of the same readings are corrected once, not each for itself.
        Against data with less noise than was taken for granted (where there is turbulence or a mode hop it is an
        upper bound) it counts by that much less.
        """
        result = np.zeros((len(self.own_data), len(form.columns)))
        for rows in self.own_runs:
            there, part = self.own_rows_at(form, rows)
            result[np.ix_(rows, there)] = part
        return result

    def own_rows_at(self, form: Form, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Some ``rows`` (m,) of these: the numbers (k,) of the columns that may stand there, and (m, k) of them."""
        reading, root = self._own
        there, slopes = self._read(form.by_reading, reading[rows])
        return there, slopes * root[rows, None] * form.scale[there]

    def log_jacobian(self, slopes: np.ndarray) -> float:
        """ln |∂z/∂r| = Σ ln(1 − a·c′), whole, of data from which columns made of readings were taken; ``slopes``
        (n, c): a·c′, by how much what was taken grows with each reading."""
        reading, root = self._own
        return float(root**2 @ np.log(np.maximum(1.0 - slopes.ravel()[reading], FOLDED)))

    def beyond_rows(self, slopes: np.ndarray) -> float:
        """What of :meth:`log_jacobian` the rows of :meth:`own_rows` leave out: all beyond the second order."""
        reading, root = self._own
        grown = slopes.ravel()[reading]
        return self.log_jacobian(slopes) + float(root**2 @ (grown + 0.5 * grown**2))

    @property
    def own_data(self) -> np.ndarray:
        """The data (m,) of :meth:`own_rows`."""
        return -self._own[1]

    @cached_property
    def _own(self) -> tuple[np.ndarray, np.ndarray]:
        """Readings (m,) of all n·c that are there, and the root of what their own noise counts (m,)."""
        reading = np.flatnonzero(self.own_share > 0.0)
        return reading, np.sqrt(self.level * self.own_share[reading])

    @property
    def inside_runs(self) -> list[np.ndarray]:
        """Those of the contrasts (N − stops) that belong to each run, slopes apart from bends."""
        kind = 2 * self.run_of_stop[self.row[self.stops:]] + self.bends
        return [np.flatnonzero(kind == k) for k in np.unique(kind)]

    @cached_property
    def own_runs(self) -> list[np.ndarray]:
        """Those of :meth:`own_rows` that belong to each run."""
        run = self.run_of_stop[self._own[0] // self._bin_present.shape[2]]
        return [np.flatnonzero(run == number) for number in range(len(self.projection.white))]

    @cached_property
    def level(self) -> float:
        """Mean square of the lengths' data where it is below what is expected of noise, as a share of that; else 1."""
        mine = np.flatnonzero((self.channel >= 0)[:self.stops] & ~self.of_spot[:self.stops])
        expected = len(mine) - float(np.sum(self._shares[1][mine]))
        return min(1.0, float(np.sum(self.data[mine]**2)) / expected) if len(mine) else 1.0

    def project(self, form: Form) -> np.ndarray:
        """What a form looks like here, per unit of its ``scale``: (N, k)."""
        result = np.zeros((self.size, len(form.columns)))
        result[:self.stops] = self.stop_part(form.columns)
        if form.inside is not None:
            result[self.stops:] = self.bin_part(form.inside)
        return result * form.scale


def slopes_of(forms: Sequence[Form], sizes: Callable[[int], np.ndarray]) -> np.ndarray | None:
    """By how much what some forms take from the readings grows with these (n, c); ``sizes``: the coefficients (k,) of a
    form by its number.  None where no columns are made of readings."""
    grown = [np.tensordot(sizes(number), np.asarray(form.by_reading), axes=1)
             for number, form in enumerate(forms) if form.by_reading is not None]
    return np.sum(grown, axis=0) if grown else None


def parity(observation: Observation, result: Fit, noise: NoiseModel,
           readings: np.ndarray, freed: np.ndarray | None = None) -> Parity:
    """Set up the projection at ``result`` with ``noise``; data are ``readings`` minus its prediction.

    ``freed`` (n, b, c): the bins freed of effects, which say how noisy they are; else the bins themselves.
    """
    space = Projection.of(observation.table, result, noise)
    data, shared = space.data(readings), space.size - space.readings
    channels = observation.bins.shape[2]
    contrast = contrasts(observation.view.bin_time)
    values, rough, limit = _inside(observation, observation.bins, contrast)
    calm, size, most = (values, rough, limit) if freed is None else _inside(observation, freed, contrast)
    scale = _loudness(np.clip(calm, -most, most))
    # One dwell in which something happened must not speak for all of its kind.
    happened = _once(np.abs(values / limit).max(axis=1), observation.table.run)
    values = np.where(happened[:, None, :], np.nan, np.clip(values, -limit, limit))
    bin_present = np.isfinite(values)
    inside = (values / scale)[bin_present]
    rows = np.concatenate([w.rows for w in space.white])
    stop, _, channel = np.nonzero(bin_present)
    return Parity(np.concatenate([data, inside]), len(data), (space.freedom, len(inside)),
                  np.concatenate([rows % channels, np.full(shared, -1), channel]),
                  np.concatenate([rows // channels, np.full(shared, -1), stop]), scale, space, contrast,
                  observation.bin_sigma[:, None, :] * rough, bin_present)


def _inside(observation: Observation, bins: np.ndarray,
            contrast: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Contrasts (n, h, c) of ``bins``, white but for a common factor; what they were divided by beside the samples'
    noise; and what they are held to."""
    values = contrast @ bins / observation.bin_sigma[:, None, :]
    rough = np.ones(values.shape[1:])
    loud = _loudness(values)   # by that all contrasts are divided besides
    for degree in range(SLOPE_AND_BEND):
        rough[degree] = np.maximum(_roughness(values[:, degree], observation) / loud, 1.0)
    typical = _typical(values, observation)
    rough = np.hypot(rough, DISCREPANCY * typical)
    return values / rough, rough, CLIP * np.maximum(typical.max(axis=1, keepdims=True) / rough, 1.0)


def _loudness(values: np.ndarray) -> np.ndarray:
    """Factor (c,), at least one, by which contrasts (n, h, c) are larger than white samples of the log would make them.

    Neighbouring samples may be alike, and their tails heavy.  What creeps shows in the first contrasts, so the level
    is taken from the others.
    """
    return np.array([loudness(values[:, SLOPE_AND_BEND:, c]) for c in range(values.shape[2])])


def _typical(values: np.ndarray, observation: Observation) -> np.ndarray:
    """Sizes (n, h, c) typical of white contrasts in the dwells that one axis led to in one setup.

    What settles does so after moves of its axis, and seen by a setup's beam: a size typical of all dwells
    would say that it hardly happens.  The first piece of a watch is of the watch's kind: many times as long as a dwell
    before a run, it shows as much more of a drift.
    """
    table, size = observation.table, np.abs(values) / 0.6745
    kinds = table.axis.copy()
    for watch in observation.view.watches:
        kinds[watch] = STOOD
    typical = np.empty_like(size)
    for setup in np.unique(table.setup):
        for kind in np.unique(kinds):
            mine = (table.setup == setup) & (kinds == kind)
            few = np.isfinite(size[mine]).any(axis=(1, 2)).sum() < LEAST_ALIKE
            typical[mine] = _median(size if few else size[mine])
    return typical


def _once(excess: np.ndarray, run: np.ndarray) -> np.ndarray:
    """Dwells (n, c) in which something happened that neither a drift nor what each move leaves can do: their contrasts,
    ``excess`` (n, c) in units of what they are held to, stand alone among those of a ``run`` (n,)."""
    size = np.nan_to_num(excess)
    beside = np.zeros_like(size)
    follows = (run[1:] == run[:-1])[:, None]
    beside[1:] = np.where(follows, size[:-1], 0.0)
    beside[:-1] = np.maximum(beside[:-1], np.where(follows, size[1:], 0.0))
    return size > np.maximum(BY_FAR, ALONE * beside)


def _median(values: np.ndarray) -> np.ndarray:
    """Median over the first axis of what is there; 0 where nothing is (a channel that was not measured)."""
    absent = np.isnan(values).all(axis=0)
    return np.where(absent, 0.0, np.nanmedian(np.where(absent, 0.0, values), axis=0))


def _roughness(values: np.ndarray, observation: Observation) -> np.ndarray:
    """Factor (c,) by which the dwells' slopes or bends (n, c) scatter above the sensors' noise.

    A drift that wanders changes its rate from stop to stop: a form with a smooth profile predicts the
    slopes only so well, whatever the sensor could see; and samples that go with those before them slope and bend
    more than those beyond a bend tell.  Taken from second differences between stops
    that the same axis led to, in which smooth profiles and settling cancel.
    """
    table = observation.table
    parts = [np.empty((0, values.shape[1]))]
    for run in np.unique(table.run):
        for axis in range(3):
            mine = values[(table.run == run) & (table.axis == axis)]
            if len(mine) >= 4:
                parts.append(np.diff(mine, n=2, axis=0) / np.sqrt(6.0))
    second = np.concatenate(parts)
    enough = np.isfinite(second).sum(axis=0) > LEAST_DIFFERENCES
    return np.array([loudness(mine) if told else 1.0 for mine, told in zip(second.T, enough, strict=True)])
