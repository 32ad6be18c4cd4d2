"""A plan before it is measured: its stops as a table, what a machine would read there, and the noise.

Lets uncertainty be asked for before a machine is stopped for an hour, and gives Monte Carlo its draws.
Readings come either from the contract's closed forms, through the forward model that the estimator
itself uses, or from anybody's sensor (:data:`Sensor`), such as the traced scene.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.model.cycle import cycle
from stepdiag_ros.model.description import Description
from stepdiag_ros.model.machine import GeometricErrors, tool_pose
from stepdiag_ros.model.sensor import Misalignment, measure

Sensor = Callable[[str, Misalignment, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""``sensor(setup, misalignment, point (n, 3), attitude (n, 3, 3))``: distances (n, beams), spots (n, 2) [m]."""

STOP_NS = 1_000_000_000


def planned_table(description: Description, setups: Sequence[str] | None = None,
                  directions: Sequence[int] = (1, -1), samples: int = 100) -> StopTable:
    """All visits of the plan in order, without readings, run by run of each setup's cycles.

    ``samples``: how many samples of either sensor a dwell will hold.
    """
    names = tuple(setups or description.setups)
    columns: dict[str, list[np.ndarray]] = {key: [] for key in (
        'run', 'setup', 'repeat', 'direction', 'index', 'axis', 'commanded')}
    run_ids = []
    for number, name in enumerate(names):
        for repeat in range(description.repeats_of(name)):
            for part in cycle(description, name):
                visits = [visit for visit in part.visits if visit.direction in directions]
                if not visits:
                    continue
                count = len(visits)
                for key, value in {'run': len(run_ids), 'setup': number, 'repeat': repeat}.items():
                    columns[key].append(np.full(count, value))
                for key, values in (('direction', [v.direction for v in visits]), ('index', [v.index for v in visits]),
                                    ('axis', [v.axis for v in visits]), ('commanded', [v.position for v in visits])):
                    columns[key].append(np.array(values))
                run_ids.append(f'{name}/{repeat}/{part.name}')
    c = {key: np.concatenate(parts) for key, parts in columns.items()}
    n, beams = len(c['run']), max(len(description.setups[name].beams) for name in names)
    begin = np.arange(n, dtype=np.int64) * 2 * STOP_NS
    nothing = np.zeros((n, 2), np.intp)
    return StopTable(
        tuple(run_ids), names, c['run'], c['setup'], c['repeat'], c['direction'], c['index'], c['axis'],
        c['commanded'], begin, begin + STOP_NS // 2, begin + STOP_NS,
        np.full((n, beams), np.nan), np.full((n, beams), np.nan), np.full(n, samples), nothing,
        np.full((n, 2), np.nan), np.full((n, 2), np.nan), np.full(n, samples), nothing,
        np.ones(n), np.ones(n))


def closed_form(description: Description) -> Sensor:
    """The contract's sensor of every setup."""
    def sensor(setup: str, misalignment: Misalignment, point: np.ndarray,
               attitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return measure(description.machine, description.setups[setup], misalignment, point, attitude)
    return sensor


def observe(description: Description, table: StopTable, errors: GeometricErrors,
            misalignments: Mapping[str, Misalignment] | None = None, sensor: Sensor | None = None,
            shift: np.ndarray | None = None, turn: np.ndarray | None = None) -> np.ndarray:
    """Readings (…, n, beams + 2) [m] of a known machine at the table's stops, zero at each run's first.

    ``shift`` (…, n, 3) [m] and ``turn`` (…, n, 3) [rad] move the mirror at each stop besides its errors, in
    the machine frame: errors of arrival, whose leading axes (draws) the readings take over.
    """
    sensor = sensor or closed_form(description)
    n, beams = table.displacement.shape
    tool = np.array([description.setups[name].tool_of(description.machine) for name in table.setup_names])[table.setup]
    point, attitude = tool_pose(errors, table.commanded, tool, description.machine.chain)
    if shift is not None:
        point = point + shift
    if turn is not None:
        attitude = attitude + np.cross(turn[..., None], attitude, axisa=-2, axisb=-2, axisc=-2)
    lead = np.broadcast_shapes(point.shape[:-2], attitude.shape[:-3])
    point = np.broadcast_to(point, (*lead, n, 3))
    attitude = np.broadcast_to(attitude, (*lead, n, 3, 3))
    readings = np.full((*lead, n, beams + 2), np.nan)
    for number, name in enumerate(table.setup_names):
        rows = np.flatnonzero(table.setup == number)
        if len(rows):
            length, spot = sensor(name, (misalignments or {}).get(name, Misalignment()),
                                  point[..., rows, :].reshape(-1, 3), attitude[..., rows, :, :].reshape(-1, 3, 3))
            width = length.shape[1]
            readings[..., rows, :width] = length.reshape(*lead, len(rows), width)
            readings[..., rows, beams:] = spot.reshape(*lead, len(rows), 2)
    for run in np.unique(table.run):
        rows = np.flatnonzero(table.run == run)
        readings[..., rows, :beams] -= readings[..., rows[:1], :beams]
    return readings


def filled(table: StopTable, readings: np.ndarray) -> StopTable:
    """The table with ``readings`` (n, beams + 2) [m] in it."""
    beams = table.displacement.shape[1]
    return replace(table, displacement=readings[:, :beams], spot=readings[:, beams:])
