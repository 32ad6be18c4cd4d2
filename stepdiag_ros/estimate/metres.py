"""Readings in metres, and at 20 °C: the index of air and the expansion of the scales taken out, stop by stop.

A laser counts optical lengths: with the index of air n the distance D counts as n·D.  An instrument that divided by
one index n_d (1.0: none) and was reset at the distance D_r in air of n_r reports

    L = (n D − n_r D_r) / n_d        so that        D − D_r = (n_d L + n_r D_r) / n − D_r

D_r is the standoff and the way along the nominal path to the stop of the reset: the dead path.  An instrument whose
index follows the air within its runs is left as it is; it knows its own dead path.

Scales that are warm by T − 20 °C read too little: what their expansion adds to a positioning error,
``expansion · (T − 20 °C) · x``, is taken off along the axes.

The gap diagnosis looks at readings as recorded: it takes :func:`with_one_index` alone, which leaves in what the air
does during the log.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from stepdiag_ros.estimate.conditions import NO_AIR, PLAUSIBLE, UNSEEN_VARIATION, Conditions
from stepdiag_ros.estimate.reduce import StopTable, stops_of
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.estimate.traceability import (
    CELL,
    CONSTANT,
    INSTRUMENT,
    NOBODY,
    REFERENCE_TEMPERATURE,
    TOPICS,
    WORDS,
    Traceability,
)
from stepdiag_ros.estimate.workpiece import CELL as BY_CELL
from stepdiag_ros.estimate.workpiece import TOPIC as BY_TOPIC
from stepdiag_ros.estimate.workpiece import PartExpansion, part_expansion
from stepdiag_ros.model.air import CO2, WAVELENGTH, refractive_index
from stepdiag_ros.model.description import Description
from stepdiag_ros.model.log import CalibrationLog, ScalarSeries
from stepdiag_ros.model.machine import AXES
from stepdiag_ros.model.sensor import nominal_sight
from stepdiag_ros.model.surroundings import LIMITS, QUANTITIES, AirValues, Expansion

VACUUM = 1.0e-9
"""An index nearer to 1 than this was not divided out."""
FOLLOWS = 1.0e-11
"""An index that changes by more within a run follows the air."""
SILENT_NS = 900_000_000_000
"""A topic tells of a stop no further than this from its nearest reading [ns]."""
APART = 3.0
"""Standard uncertainties between two indices above which they contradict each other."""
WORKPIECE = 'scale_temperature/workpiece'
NOT_TOLD = (f'{WORDS[NOBODY]}: the samples are vacuum lengths (refractive_index 1.0), and neither environment topics '
            'nor air: in the cell description say what the index of air was; record the topics or give air:')
TOPIC = {'temperature': 'air_temperature', 'pressure': 'air_pressure', 'humidity': 'humidity'}


@dataclass(frozen=True)
class Metres:
    """A log's stops in metres.

    ``table``: lengths corrected; ``conditions``: what was known; ``air``: who took the index out (see
    :data:`~stepdiag_ros.estimate.traceability.WORDS`); ``index``: mean index that counts; ``measured_at``: mean scale
    temperatures [°C] by axis letter; ``remarks``: a sentence each.  ``workpiece``: its material,
    ``workpiece_C``: its mean temperature [°C] where the topic tells it.
    """

    table: StopTable
    conditions: Conditions
    air: str
    index: float
    measured_at: Mapping[str, float] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    workpiece: Expansion | None = None
    workpiece_C: float | None = None

    def parts(self, solution: Solution, sensor_sigma: float) -> PartExpansion | str:
        """What the workpiece's temperature does to parts, or what is not known of it; ``sensor_sigma`` [K]: standard
        uncertainty of a temperature that a topic tells."""
        material, conditions = self.workpiece, self.conditions
        if material is None:
            return 'the expansion of the workpiece is unknown' if self.workpiece_C is not None else \
                'temperature and expansion of the workpiece are unknown'
        stated = material.temperature
        if self.workpiece_C is None and stated is None:
            return 'the temperature of the workpiece is unknown'
        told = (self.workpiece_C, sensor_sigma, BY_TOPIC) if self.workpiece_C is not None else \
            (stated, material.temperature_sigma, BY_CELL)
        scales = {name: (conditions.scales[axis], max(sensor_sigma, conditions.scale_sigma[axis]),
                         conditions.expansion[axis], conditions.expansion_sigma[axis])
                  for axis, name in enumerate(f'E{letter}{letter}' for letter in AXES)
                  if conditions.referred[axis] and solution.has(name) and len(solution.positions[name]) > 1}
        return part_expansion(*told, (material.expansion, material.sigma), scales, solution.positions)

    def correction(self, positions: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """What referring to 20 °C added to each positioning error (k,) [m], at the mean temperature of its scale."""
        return {name: -self.conditions.expansion[axis] * (self.conditions.scales[axis] - REFERENCE_TEMPERATURE)
                * np.asarray(positions[name]) for axis, name in enumerate(f'E{letter}{letter}' for letter in AXES)
                if self.conditions.referred[axis] and name in positions}

    def correction_sigma(self, positions: Mapping[str, np.ndarray], sensor_sigma: float) -> dict[str, np.ndarray]:
        """Standard uncertainty (k,) [m] of :meth:`correction`, by temperature and coefficient of the scale."""
        given = self.conditions
        return {name: float(np.hypot(given.expansion[axis] * max(sensor_sigma, given.scale_sigma[axis]),
                                     given.expansion_sigma[axis] * (given.scales[axis] - REFERENCE_TEMPERATURE)))
                * np.asarray(positions[name]) for axis, name in enumerate(f'E{letter}{letter}' for letter in AXES)
                if given.referred[axis] and name in positions}

    def traceability(self, solution: Solution, index_sigma: float, budget: str, sensor_sigma: float) -> Traceability:
        """What the result says of itself; ``solution`` names the axes that were measured, ``sensor_sigma`` [K] is of
        temperatures that topics tell."""
        moved = [axis for axis, letter in enumerate(AXES)
                 if solution.has(f'E{letter}{letter}') and len(solution.positions[f'E{letter}{letter}']) > 1]
        referred = bool(moved) and all(self.conditions.referred[axis] for axis in moved)
        shown = {name: values for name, values in self.correction(solution.positions).items() if solution.has(name)}
        return Traceability(self.air, self.index, index_sigma, REFERENCE_TEMPERATURE if referred else None,
                            self.measured_at, shown, self.remarks, budget, self.parts(solution, sensor_sigma),
                            self.correction_sigma(solution.positions, sensor_sigma))


def in_metres(log: CalibrationLog, table: StopTable | None = None) -> Metres:
    """The stops of ``log`` with the index of air and the expansion of the scales taken out."""
    table = stops_of(log) if table is None else table
    corrected, conditions, air, index, remarks = _air(log, table)
    corrected, conditions, measured, of_scales = _referred(log, corrected, conditions)
    part, of_part = _recorded(log.environment.get(WORKPIECE), log, (table.dwell_ns + table.done_ns) // 2,
                        LIMITS['temperature'])
    remarks += of_scales + ([f'environment/{WORKPIECE}: {of_part}'] if of_part else [])
    return Metres(corrected, conditions, air, index, measured, tuple(remarks), log.description.workpiece,
                  None if part is None else float(part.mean()))


def with_one_index(log: CalibrationLog, table: StopTable) -> StopTable:
    """Vacuum lengths of ``table`` over the index of air when the log began; what it did then stays in.

    That is how an instrument that divides by a constant would have recorded them.
    """
    vacuum = np.abs(table.refractive_index - 1.0) < VACUUM
    known = _Known.of(log, table)
    if not vacuum.any() or not known.enough:
        return table
    first = int(np.argmin(table.dwell_ns))
    index = np.where(vacuum, known.index[first], 1.0)
    return replace(table, displacement=table.displacement / index[:, None],
                   refractive_index=table.refractive_index * index)


def untold(log: CalibrationLog, table: StopTable) -> str:
    """That the lengths of ``table`` are no metres, vacuum lengths of which nobody tells the air, in words; else ''."""
    vacuum = np.abs(table.refractive_index - 1.0) < VACUUM
    return NOT_TOLD if vacuum.any() and not _Known.of(log, table).enough else ''


@dataclass(frozen=True)
class _Known:
    """What is known of the air at the stops: ``values`` (3, n), by what (``topic``, ``cell``, ``nobody``), the
    uncertainty beyond a sensor's (3,), and what is wrong with what was logged."""

    values: np.ndarray
    source: tuple[str, str, str]
    air_sigma: np.ndarray
    wavelength: float
    co2: float
    remarks: tuple[str, ...]

    @property
    def enough(self) -> bool:
        """Temperature or pressure is recorded: without both, there is no index to speak of."""
        return self.source[:2] != ('nobody', 'nobody')

    @property
    def by_topics(self) -> bool:
        return self.source[:2] == ('topic', 'topic')

    @property
    def index(self) -> np.ndarray:
        return refractive_index(*self.values, self.wavelength, self.co2)

    @classmethod
    def of(cls, log: CalibrationLog, table: StopTable) -> '_Known':
        cell = log.description.air or AirValues()
        middle = (table.dwell_ns + table.done_ns) // 2
        values, source, air_sigma, remarks = [], [], [], []
        for quantity in QUANTITIES:
            series, said = log.environment.get(TOPIC[quantity]), getattr(cell, quantity)
            recorded, why = _recorded(series, log, middle, LIMITS[quantity])
            if why:
                remarks.append(f'environment/{TOPIC[quantity]}: {why}')
            if recorded is not None:
                values.append(recorded)
                source.append('topic')
                air_sigma.append(0.0)
                continue
            plausible, width = PLAUSIBLE[quantity]
            values.append(np.full(len(table), plausible if said is None else said))
            source.append('nobody' if said is None else 'cell')
            air_sigma.append(width if said is None else cell.sigma.get(quantity, width))
        return cls(np.array(values), tuple(source), np.array(air_sigma),
                   WAVELENGTH if cell.wavelength is None else cell.wavelength,
                   CO2 if cell.co2 is None else cell.co2, tuple(remarks))


def unusable(series: ScalarSeries, limits: tuple[float, float]) -> str:
    """Why a topic's readings cannot be its quantity in its unit, which lies within ``limits``; '' where they can."""
    value = series.value[np.isfinite(series.value)]
    if not len(value):
        return 'holds no number; it is left out'
    typical = float(np.median(value))
    if not limits[0] <= typical <= limits[1]:
        return (f'reads about {typical:g}, outside {limits[0]:g} to {limits[1]:g}; it is left out, '
                'check its unit (°C, Pa, 0 to 1)')
    if len(value) > 1 and not value.any():
        return f'reads 0 each of {len(value)} times; it is left out, check that its sensor is connected'
    return ''


def _recorded(series: ScalarSeries | None, log: CalibrationLog, middle: np.ndarray,
          limits: tuple[float, float]) -> tuple[np.ndarray | None, str]:
    """A topic's quantity at the stops (n,), None where it does not tell; and what is wrong with it.

    Only readings between the log's first and last step count: a live log and its bag differ beyond them.
    """
    if series is None or not len(series.value):
        return None, ''
    inside = (series.time_ns >= log.steps.time_ns[0]) & (series.time_ns <= log.steps.time_ns[-1])
    if inside.any():
        series = ScalarSeries(series.time_ns[inside], series.value[inside], series.variance[inside])
    if why := unusable(series, limits):
        return None, why
    time = series.time_ns[np.isfinite(series.value)]
    after = np.clip(np.searchsorted(time, middle), 1, max(len(time) - 1, 1))
    away = np.minimum(np.abs(middle - time[np.minimum(after, len(time) - 1)]), np.abs(middle - time[after - 1]))
    if np.max(away) > SILENT_NS:
        return None, (f'is silent for {np.max(away) / 6e10:.0f} min about a stop; it is left out, '
                      'record it during the whole log')
    return series.at(middle), ''


def _air(log: CalibrationLog, table: StopTable) -> tuple[StopTable, Conditions, str, float, list[str]]:
    """Corrected stops, conditions, who corrected, the mean index, remarks."""
    known = _Known.of(log, table)
    remarks, divided = list(known.remarks), table.refractive_index
    conditions = Conditions(*(float(v) for v in known.values.mean(axis=1)), wavelength=known.wavelength, co2=known.co2)
    spread = conditions.index_sigma(*known.air_sigma)
    vacuum = np.abs(divided - 1.0) < VACUUM
    if not vacuum.any():
        if _follows(table):
            index, unknown = float(divided.mean()), 0.0
            if known.by_topics:
                unknown = _contradiction(conditions, index - conditions.index, remarks)
            return table, replace(conditions, unknown=unknown), INSTRUMENT, index, remarks
        if not known.by_topics:
            unseen = min(spread, UNSEEN_VARIATION) if (log.description.air or AirValues()).sigma else UNSEEN_VARIATION
            remarks.append(f'{WORDS[CONSTANT]}; record environment/air_temperature and '
                           'environment/air_pressure')
            return (table, replace(conditions, unknown=unseen, variation=unseen), CONSTANT, float(divided.mean()),
                    remarks)
    elif not known.enough:
        remarks.append(NOT_TOLD)
        return (table, replace(conditions, unknown=NO_AIR, variation=UNSEEN_VARIATION), NOBODY, 1.0, remarks)
    for quantity, source in zip(QUANTITIES, known.source, strict=True):
        if source == 'nobody':
            value, width = PLAUSIBLE[quantity]
            remarks.append(f'the {quantity} of the air is reported neither by environment/'
                           f'{TOPIC[quantity]} nor by air.{quantity}; {value:g} with a standard uncertainty of '
                           f'{width:.2g} counts')
    recorded = 'topic' in known.source[:2]
    if not recorded:
        remarks.append(f'{WORDS[CELL]}, for the whole log alike')
    # What is known to a few kelvins does not change by as many: no more than air of which nothing is known.
    variation = 0.0 if known.by_topics else min(spread, UNSEEN_VARIATION)
    corrected = divided_by(log.description, table, known.index)
    return (corrected, replace(conditions, air_sigma=tuple(known.air_sigma), variation=variation),
            TOPICS if recorded else CELL,
            float(known.index.mean()), remarks)


def _follows(table: StopTable) -> bool:
    """Whether the index that the instrument divided out changes within a run."""
    return any(np.ptp(table.refractive_index[table.run == run]) > FOLLOWS for run in np.unique(table.run))


def _contradiction(conditions: Conditions, apart: float, remarks: list[str]) -> float:
    """How much an instrument that follows the air and the topics contradict each other [1]; 0 where they agree."""
    agreed = np.hypot(conditions.index_sigma(0.1, 30.0, 0.03), 3.0e-8)
    if abs(apart) <= APART * agreed:
        return 0.0
    remarks.append(f'the instrument divided by an index that is {apart * 1e6:+.2f}e-6 from the one of '
                   f'the environment topics (at {conditions.wavelength * 1e6:.3g} µm); the difference counts as '
                   'uncertainty, check the sensors and air.wavelength')
    return abs(apart)


def divided_by(description: Description, table: StopTable, index: np.ndarray) -> StopTable:
    """The stops with the instrument's own index taken back and ``index`` (n,) divided out, dead path included."""
    lengths = table.displacement.copy()
    paths, _ = _sights(description, table)
    for run in np.unique(table.run):
        rows = np.flatnonzero(table.run == run)
        reset = rows[np.argmin(table.dwell_ns[rows])]
        ratio = (table.refractive_index[rows] / index[rows])[:, None]
        lengths[rows] = lengths[rows] * ratio + (paths[reset] * (index[reset] / index[rows] - 1.0))[:, None]
    return replace(table, displacement=lengths, refractive_index=np.asarray(index, float))


def _sights(description: Description, table: StopTable) -> tuple[np.ndarray, np.ndarray]:
    """Nominal distance (n,) [m] and direction (n, 3) of the beam at each stop."""
    paths, directions = np.empty(len(table)), np.empty((len(table), 3))
    for number, name in enumerate(table.setup_names):
        rows = table.setup == number
        paths[rows], directions[rows] = nominal_sight(description.machine, description.setups[name],
                                                      table.commanded[rows])
    return paths, directions


def _referred(log: CalibrationLog, table: StopTable,
              conditions: Conditions) -> tuple[StopTable, Conditions, dict[str, float], list[str]]:
    """The stops with the scales' expansion taken off where it is known; mean scale temperatures by axis; remarks."""
    description, middle = log.description, (table.dwell_ns + table.done_ns) // 2
    _, directions = _sights(description, table)
    excess, referred = np.zeros(len(table)), [False] * 3
    scales, measured, stated = list(conditions.scales), {}, [0.0] * 3
    expansion, sigma, away = list(conditions.expansion), list(conditions.expansion_sigma), [np.nan] * 3
    remarks = []
    for axis, letter in enumerate('xyz'):
        topic = f'scale_temperature/{letter}'
        recorded, why = _recorded(log.environment.get(topic), log, middle, LIMITS['temperature'])
        if why:
            remarks.append(f'environment/{topic}: {why}')
        material = description.scales.get(letter)
        if recorded is None and material is not None and material.temperature is not None:
            recorded, stated[axis] = np.full(len(table), material.temperature), material.temperature_sigma
        if recorded is not None:
            scales[axis] = measured[letter] = float(recorded.mean())
            away[axis] = float(np.sqrt(np.mean((recorded - REFERENCE_TEMPERATURE)**2)))
        if material is not None:
            expansion[axis], sigma[axis] = material.expansion, material.sigma
        if recorded is not None and material is not None:
            referred[axis] = True
            excess += directions[:, axis] * material.expansion * (recorded - REFERENCE_TEMPERATURE) \
                * table.commanded[:, axis]
    conditions = replace(conditions, scales=tuple(scales), expansion=tuple(expansion), expansion_sigma=tuple(sigma),
                         referred=tuple(referred), away=tuple(away), scale_sigma=tuple(stated))
    if not any(referred):
        return table, conditions, measured, remarks
    lengths = table.displacement.copy()
    for run in np.unique(table.run):
        rows = np.flatnonzero(table.run == run)
        reset = rows[np.argmin(table.dwell_ns[rows])]
        lengths[rows] -= (excess[rows] - excess[reset])[:, None]
    return replace(table, displacement=lengths), conditions, measured, remarks


