"""What a contributor of a budget does to the readings of a log: one column for each of its independent variates."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from stepdiag_ros.estimate.conditions import Conditions
from stepdiag_ros.estimate.enhanced import Fit, readings_of
from stepdiag_ros.estimate.forward import ForwardModel
from stepdiag_ros.estimate.noise import NoiseModel, arrivals
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.model.budget import Contributor
from stepdiag_ros.model.description import Description
from stepdiag_ros.model.sensor import nominal_sight

STEP_M = 1.0e-4
"""By how much a length of the description is moved to see what it does [m]."""


@dataclass(frozen=True)
class Setting:
    """What the causes are computed from: description, stops, arrival derivatives, noise, conditions.

    ``readings`` (n, c) [m] and ``arrival`` (5, n, c) as in the fit; ``model`` and ``theta``: where it ended.
    """

    description: Description
    table: StopTable
    readings: np.ndarray
    arrival: np.ndarray
    noise: NoiseModel
    conditions: Conditions
    model: ForwardModel
    theta: np.ndarray

    @classmethod
    def of_fit(cls, description: Description, table: StopTable, result: Fit,
               conditions: Conditions | None = None) -> 'Setting':
        return cls(description, table, readings_of(table), result.arrival, result.noise,
                   conditions or Conditions(), result.model, result.theta)

    @property
    def paths(self) -> np.ndarray:
        """Distance (n,) [m] from base unit to mirror at each stop, nominally."""
        machine, out = self.description.machine, np.empty(len(self.table))
        for number, name in enumerate(self.table.setup_names):
            rows = self.table.setup == number
            out[rows], _ = nominal_sight(machine, self.description.setups[name], self.table.commanded[rows])
        return out

    @property
    def mirrored(self) -> np.ndarray:
        """1 at stops (n,) whose beams meet a mirror, 0 where they follow a retroreflector."""
        meets = [not self.description.setups[name].follows for name in self.table.setup_names]
        return np.array(meets, float)[self.table.setup]


def systematic(kind: str, contributor: Contributor, setting: Setting) -> np.ndarray:
    """Effects (k, n, c) on the readings per unit of the contributor's quantity."""
    readings, table = np.nan_to_num(setting.readings), setting.table
    beams = readings.shape[1] - 2
    length, spot = np.zeros_like(readings), np.zeros_like(readings)
    length[:, :beams], spot[:, beams:] = readings[:, :beams], readings[:, beams:]
    if kind in ('scale', 'index_formula'):
        return length[None]
    if kind in ('air_temperature', 'air_pressure', 'humidity'):
        return length[None] * -setting.conditions.index_slope(kind)
    if kind in ('dead_path', 'air_variation'):
        return _in_runs(kind, setting, length)
    if kind == 'cosine':
        straight = [i for i, n in enumerate(table.setup_names) if setting.description.setups[n].is_straight]
        # L ε² E with E exponential; the value squares, the standard uncertainty is taken off outside.
        effects = [-contributor.standard * np.where((table.setup == i)[:, None], length, 0.0) for i in straight]
        return np.array(effects) if effects else np.zeros((1, *readings.shape))
    if kind == 'psd_gain':
        return np.stack([np.where(np.arange(beams + 2) == beams + k, spot, 0.0) for k in range(2)])
    if kind == 'psd_rotation':
        turned = np.zeros_like(readings)
        turned[:, beams], turned[:, beams + 1] = -spot[:, beams + 1], spot[:, beams]
        return turned[None]
    if kind in ('tool', 'beam_offset', 'standoff'):
        return _of_description(kind, setting)
    zero = [np.where((table.setup == i)[:, None] & (np.arange(beams + 2) == beams + k), 1.0, 0.0)
            for i in np.unique(table.setup) for k in range(2)]
    return np.array(zero)


def _in_runs(kind: str, setting: Setting, length: np.ndarray) -> np.ndarray:
    """Effects (k, n, c) of an index that changes within each run by 1, and (``air_variation``) from run to run."""
    table, beams, effects = setting.table, length.shape[1] - 2, []
    standoff = np.array([setting.description.setups[n].standoff for n in table.setup_names])[table.setup]
    path = setting.paths
    if kind == 'dead_path':
        first = np.array([np.flatnonzero(table.run == run)[0] for run in range(int(table.run.max()) + 1)
                          if np.any(table.run == run)])
        at_reset = dict(zip(table.run[first].tolist(), path[first], strict=True))
        path = np.where(setting.mirrored > 0.0, standoff, np.array([at_reset[run] for run in table.run.tolist()]))
    for run in np.unique(table.run):
        rows = np.flatnonzero(table.run == run)
        # The index goes on changing through the run; the reset was at its first stop.
        effect = np.zeros_like(length)
        effect[rows, :beams] = (np.linspace(0.0, 1.0, len(rows)) * path[rows])[:, None]
        effects.append(effect)
        if kind == 'air_variation':
            effects.append(np.where((table.run == run)[:, None], length, 0.0))
    return np.array(effects)


def _of_description(kind: str, setting: Setting) -> np.ndarray:
    """Effects (k, n, c) per metre of an error in the tool vector, the beams' offsets or the standoffs.

    Differences of the full model at the solution; what such an error does to an ideal machine that nobody
    misaligned is a constant, which the resets take out.
    """
    description, table, model = setting.description, setting.table, setting.model
    moved: list[Description] = []
    if kind == 'tool':
        moved = [_with_tool_moved(description, STEP_M * np.eye(3)[k]) for k in range(3)]
    for number in np.unique(table.setup) if kind != 'tool' else ():
        name = table.setup_names[number]
        setup = description.setups[name]
        if kind == 'standoff':
            changed = [replace(setup, standoff=setup.standoff + STEP_M)]
        else:
            steps = STEP_M * np.eye(2)
            changed = [replace(setup, psd_offset=tuple(np.array(setup.psd_offset) + step)) for step in steps]
            changed += [replace(setup, beams=tuple(
                tuple(np.array(beam) + (step if own == k else 0.0)) for own, beam in enumerate(setup.beams)))
                for k in range(len(setup.beams)) for step in steps]
        moved += [replace(description, setups=description.setups | {name: one}) for one in changed]
    nominal = model.predict(setting.theta)
    return np.array([(ForwardModel(one, table, model.parameters).predict(setting.theta) - nominal) / STEP_M
                     for one in moved])


def _with_tool_moved(description: Description, by: np.ndarray) -> Description:
    """The description with its tool, and the tools of its stations, elsewhere by (3,) [m]."""
    machine = replace(description.machine, tool=tuple(np.array(description.machine.tool) + by))
    return replace(description, machine=machine, setups={
        name: setup if setup.tool is None else replace(setup, tool=tuple(np.array(setup.tool) + by))
        for name, setup in description.setups.items()})


def _cyclic_columns(setting: Setting) -> sparse.csr_array:
    """Effect (n·c, n) of a unit swing of the lengths at each stop."""
    n, channels = setting.readings.shape
    rows = (np.arange(n)[:, None] * channels + np.arange(channels - 2)).ravel()
    return sparse.csr_array((np.ones(len(rows)), (rows, np.repeat(np.arange(n), channels - 2))), (n * channels, n))


def _places(setting: Setting) -> tuple[np.ndarray, int]:
    """Number of the place where each stop's beams strike (n,): one for each stop of each setup."""
    _, place = np.unique(np.stack([setting.table.setup, setting.table.index], axis=1), axis=0, return_inverse=True)
    return np.ravel(place), int(place.max()) + 1


def _flatness_columns(setting: Setting) -> sparse.csr_array:
    """Effect (n·c, places) of a unit height of the mirror at each place."""
    n, channels = setting.readings.shape
    place, count = _places(setting)
    rows = (np.arange(n)[:, None] * channels + np.arange(channels - 2)).ravel()
    return sparse.csr_array((np.repeat(setting.mirrored, channels - 2), (rows, np.repeat(place, channels - 2))),
                            (n * channels, count))


def _slope_columns(setting: Setting) -> sparse.csr_array:
    """Effect (n·c, 2 places) of a unit slope of the mirror at each place, about u and about v: (−2Lβ, 2Lα)."""
    n, channels = setting.readings.shape
    place, count = _places(setting)
    first, twice = np.arange(n) * channels + channels - 2, 2.0 * setting.paths
    return sparse.csr_array((np.concatenate([twice, -twice]),
                             (np.concatenate([first + 1, first]), np.concatenate([place, count + place]))),
                            (n * channels, 2 * count))


STOPWISE: dict[str, Callable[[Setting], sparse.csr_array]] = {
    'cyclic': _cyclic_columns, 'mirror_flatness': _flatness_columns, 'mirror_slope': _slope_columns}
"""Contributors with a variate for each stop or place."""


def stop_columns(kind: str, setting: Setting) -> sparse.csr_array:
    """Effect (n·c, k) of a stopwise contributor of unit size as the weights take it: anew at each visit.

    What V visits to one place share is, to the mean of V alike, what errors √V as large are that differ from visit to
    visit.  These keep the readings' covariance in blocks, one for each run.
    """
    if kind == 'cyclic':
        return _cyclic_columns(setting)
    place, count = _places(setting)
    visits = np.bincount(place, minlength=count)[place]
    each = replace(setting, table=replace(setting.table, index=np.arange(len(setting.table))))
    weight = np.sqrt(np.repeat(visits, setting.readings.shape[1]))
    return sparse.csr_array(STOPWISE[kind](each).multiply(weight[:, None]))


def arrival_columns(setting: Setting) -> sparse.csr_array:
    """Effect (n·c, arrivals) of a unit error at each arrival of each axis."""
    numbers, channels = arrivals(setting.table), setting.readings.shape[1]
    rows, columns, values, first = [], [], [], 0
    flat = np.arange(len(setting.table))[:, None] * channels + np.arange(channels)
    for axis in range(3):
        _, own = np.unique(numbers[:, axis], return_inverse=True)
        rows.append(flat.ravel())
        columns.append(first + np.repeat(np.ravel(own), channels))
        values.append(setting.arrival[2 + axis].ravel())
        first += int(own.max()) + 1
    return sparse.csr_array((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))),
                            (setting.readings.size, first))


def turn_columns(setting: Setting) -> sparse.csr_array:
    """Effect (n·c, 2 n) of a unit turn of the mirror at each stop."""
    n, channels = setting.readings.shape
    flat = (np.arange(n)[:, None] * channels + np.arange(channels)).ravel()
    values = np.concatenate([setting.arrival[k].ravel() for k in range(2)])
    columns = np.concatenate([np.repeat(np.arange(n) + k * n, channels) for k in range(2)])
    return sparse.csr_array((values, (np.tile(flat, 2), columns)), (n * channels, 2 * n))
