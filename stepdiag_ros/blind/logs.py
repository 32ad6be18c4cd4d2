"""From a drawn cell and its hidden effects to a log."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from stepdiag_ros.blind.cells import Conditions
from stepdiag_ros.blind.hidden import Hidden, Stage
from stepdiag_ros.model.description import Noise
from stepdiag_ros.model.log import DONE, DWELL, CalibrationLog, ScalarSeries
from stepdiag_ros.virtual.cell import Cell
from stepdiag_ros.virtual.draw import normals
from stepdiag_ros.virtual.offline import Visit, simulate_log

AIR_TOPICS = ('air_temperature', 'air_pressure', 'humidity')


def measure(cell: Cell, conditions: Conditions, effects: Sequence[Hidden] = (),
            visits: Mapping[str, Visit] | None = None) -> CalibrationLog:
    """The log of the cell with the effects acting, as its maker would have recorded it; ``visits`` as in
    :func:`~stepdiag_ros.virtual.offline.simulate_log`."""
    log = simulate_log(cell, start_ns=conditions.start_ns, effects=list(effects), visits=visits)
    for effect in effects:
        log = effect.spoil(log)
    health = log.displacement.health / 96.0 * conditions.quality \
        + conditions.quality_sigma * normals(cell.seed, 'quality', 0, len(log.displacement))[:, 0]
    intensity = log.spot.health \
        + conditions.intensity_sigma * normals(cell.seed, 'intensity', 0, len(log.spot))[:, 0]
    truth = log.description.noise
    believed = Noise(*(float(f'{value * factor:.2g}') for value, factor in zip(
        (truth.displacement, truth.spot, truth.position_repeatability, truth.angle_repeatability),
        conditions.belief, strict=True)))
    return replace(
        log, description=replace(log.description, noise=believed),
        displacement=replace(log.displacement, health=np.where(
            log.displacement.health > 0.0, np.clip(np.rint(health), 1.0, 100.0), 0.0)),
        spot=replace(log.spot, health=intensity),
        environment=_environment(log, effects, conditions.start_ns), source=cell.source)


def stage_of(cell: Cell, log: CalibrationLog, start_ns: int, wide: bool = False) -> Stage:
    """When the runs of ``log``, made of ``cell``, took place; ``wide`` as in :class:`Stage`."""
    events = log.steps
    begin, end = events.phase == DWELL, events.phase == DONE
    count = len(events.run_ids)
    seconds = (events.time_ns - start_ns) * 1e-9
    runs = np.array([[seconds[begin & (events.run == r)].min(), seconds[end & (events.run == r)].max()]
                     for r in range(count)])
    setup = np.array([events.setup[events.run == r][0] for r in range(count)])
    return Stage(cell, float(seconds.max()), runs, setup, wide)


def _environment(log: CalibrationLog, effects: Sequence[Hidden],
                 start_ns: int) -> dict[str, ScalarSeries]:
    """The topics with what the effects do to weather and scales: sensors tell the truth."""
    series = dict(log.environment)
    for effect in effects:
        for name, one in series.items():
            seconds = (one.time_ns - start_ns) * 1e-9
            if name in AIR_TOPICS:
                change = effect.weather(seconds)
                if change is not None:
                    series[name] = replace(one, value=one.value + change[AIR_TOPICS.index(name)])
            elif (warming := effect.warming(seconds)) is not None:
                series[name] = replace(one, value=one.value + warming[:, 'xyz'.index(name[-1])])
    return series
