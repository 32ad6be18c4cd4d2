"""What a test sheet says of the conditions of a test; what the log does not hold is not stated."""

from datetime import UTC, datetime

import numpy as np

from stepdiag_ros.estimate.evaluate import Evaluation
from stepdiag_ros.estimate.reduce import StopTable
from stepdiag_ros.estimate.traceability import WORDS
from stepdiag_ros.model.description import Description
from stepdiag_ros.model.log import CalibrationLog
from stepdiag_ros.model.path import stops
from stepdiag_ros.model.surroundings import Expansion

NOT_STATED = 'not stated'
Row = tuple[str, str]
ENVIRONMENT = (('air temperature', 'air_temperature', 'temperature', 1.0, '°C', 2),
               ('air pressure', 'air_pressure', 'pressure', 1e-2, 'hPa', 1),
               ('relative humidity', 'humidity', 'humidity', 1e2, '%', 1))
"""What is stated, the log's series, the cell's value, factor, unit, digits."""


def conditions(log: CalibrationLog, evaluation: Evaluation, names: list[str], source: str) -> list[Row]:
    """Conditions (what, value) of the test in setups ``names``, in the order of the standards' sheets."""
    table = evaluation.metres.table
    mine = table.select(np.isin(table.setup, [table.setup_names.index(n) for n in names]))
    return [*_identity(log, mine, source), *_instrument(log, names), *_positions(log, names),
            *_motion(mine, log.description.timed, _overrun(log.description, names), _feeds(log.description, names)),
            *_surroundings(log, mine, names), *_corrections(evaluation, _axes(log, names)),
            ('compensation active in the control', _said(log, 'compensation'))]


def _said(log: CalibrationLog, key: str) -> str:
    """What the cell's owner states."""
    return log.description.statement.said.get(key, NOT_STATED)


def moment(time_ns: int) -> str:
    """A time of the log as UTC, to the second."""
    return datetime.fromtimestamp(time_ns * 1e-9, UTC).strftime('%Y-%m-%d %H:%M:%S UTC')


def _identity(log: CalibrationLog, table: StopTable, source: str) -> list[Row]:
    machine = log.description.machine
    when = f'{moment(int(table.dwell_ns.min()))} to {moment(int(table.done_ns.max()))}'
    return [('machine', f'{machine.name}; kinematic chain {machine.chain}; volume '
             + ' × '.join(f'{1e3 * v:.0f}' for v in machine.volume) + ' mm'),
            ('make and serial number of the machine', _said(log, 'machine')),
            ('date of test', when if log.description.timed else f'{NOT_STATED} (the times of the log are made up)'),
            ('log', source), ('place', _said(log, 'place')), ('person', _said(log, 'person')),
            ('warm-up before the test', _said(log, 'warm_up'))]


def _instrument(log: CalibrationLog, names: list[str]) -> list[Row]:
    wavelength = None if log.description.air is None else log.description.air.wavelength
    said = f'wavelength in vacuum {1e9 * wavelength:.3f} nm' if wavelength else f'wavelength {NOT_STATED}'
    if not log.description.timed:
        return [('instrument', f'{NOT_STATED} (the log was made from a table)')]
    stated = f'laser interferometer; make, serial number, calibration: {_said(log, "instrument")}; {said}'
    rows = [('instrument', stated)]
    if any(log.description.setups[name].sees_spot for name in names):
        rows.append(('detector', f'position sensitive; make, serial number, calibration: {_said(log, "detector")}'))
    return rows


def _positions(log: CalibrationLog, names: list[str]) -> list[Row]:
    tool = log.description.machine.tool
    rows = [('offset of the measured point from the tool reference (X/Y/Z)', '/'.join(f'{1e3 * v:.1f}' for v in tool)
             + ' mm' if any(tool) else f'{NOT_STATED}, or zero')]
    for name in names:
        setup, place = log.description.setups[name], stops(log.description, name).positions
        ends = ' to '.join('(' + ', '.join(f'{1e3 * v:.1f}' for v in end) + ')' for end in (place[0], place[-1]))
        if setup.follows:
            start, end, station, tool = ('(' + ', '.join(f'{1e3 * v:.1f}' for v in part) + ') mm' for part in (
                setup.way.start, setup.way.end, setup.station, setup.tool_of(log.description.machine)))
            rows.append((f'targets of {name}', f'{setup.way.moves} from {start} to {end} in X, Y, Z; station about '
                         f'{station}; retroreflector {tool} from the tool reference'))
            continue
        beside = '({}) mm'.format(', '.join(f'{1e3 * v:.1f}' for v in setup.beams[0]))
        dead = f'{1e3 * setup.standoff:.1f} mm' if setup.standoff else f'{NOT_STATED}, or 0 mm,'
        rows.append((f'measured line {name}', f'{ends} mm in X, Y, Z; {dead} from laser to mirror at the first '
                     f'stop; beam {beside} beside the line in u, v'))
    return rows


def _overrun(description: Description, names: list[str]) -> str:
    """From how far beyond the end targets were approached."""
    said = {name: description.setups[name].overrun for name in names}
    if not any(said.values()):
        return NOT_STATED
    return ', '.join(f'{name} {1e3 * value:g} mm' if value else f'{name} none' for name, value in said.items())


def _feeds(description: Description, names: list[str]) -> str:
    """Feeds that were commanded [mm/min]."""
    usual = description.statement.feed
    own = {name: feed for name in names if (feed := description.setups[name].feed or usual) is not None}
    said = [f'{6e4 * min(own[name], usual or own[name]):.0f} mm/min' for name in own]
    if not said:
        return NOT_STATED
    if len(said) == len(names) and len(set(said)) == 1:
        return f'commanded {said[0]}'
    return 'commanded ' + ', '.join(f'{name} {feed}' for name, feed in zip(own, said, strict=True))


def _motion(table: StopTable, timed: bool, overrun: str, feed: str) -> list[Row]:
    zero = ('zero of the readings', _resets(table))
    if not timed:
        return [('feed', feed), ('dwell at a target', NOT_STATED),
                ('overrun before the end targets', overrun), zero]
    moved = np.flatnonzero((np.diff(table.run) == 0) & (table.move_ns[1:] > 0)) + 1
    if moved.size:
        way = np.linalg.norm(table.commanded[moved] - table.commanded[moved - 1], axis=1)
        speed = way / ((table.dwell_ns[moved] - table.move_ns[moved]) * 1e-9)
        feed += (f'; mean speed from start to in position, from the log: {6e4 * np.median(speed):.0f} mm/min (median '
                 f'of {moved.size} moves)')
    dwell = (table.done_ns - table.dwell_ns) * 1e-9
    return [('feed', feed),
            ('dwell at a target', f'{np.median(dwell):.3f} s ({dwell.min():.3f} s to {dwell.max():.3f} s), '
             f'{int(np.median(table.displacement_count))} samples averaged (median)'),
            ('overrun before the end targets', overrun), zero]


def _resets(table: StopTable) -> str:
    forward, backward = (set(table.run[table.direction == way].tolist()) for way in (1, -1))
    cycles = np.unique(np.stack([table.setup, table.repeat], axis=1), axis=0)
    runs = np.unique(np.stack([table.setup, table.run], axis=1), axis=0)
    if len(runs) < len(cycles):
        return 'set at the first stop of a run; several cycles share it'
    text = 'set at the first stop of every run; cycles are shifted to agree on average, and s made good for it'
    if not backward:
        return text + '; no backward run'
    if backward <= forward:
        return text + '; forward and backward share the zero'
    return text + ('; a backward run of its own is joined to the end of its forward run, so that the reversal at the '
                   'last stop is zero by construction')


def _surroundings(log: CalibrationLog, table: StopTable, names: list[str]) -> list[Row]:
    ends = np.array([table.dwell_ns.min(), table.done_ns.max()])
    rows = []
    for what, topic, key, factor, unit, digits in ENVIRONMENT:
        said = None if log.description.air is None else getattr(log.description.air, key)
        value = _course(log, topic, ends, factor, unit, digits)
        if value is None and said is not None:
            value = f'{factor * said:.{digits}f} {unit} (the cell file\'s value, not measured)'
        rows.append((what, value or NOT_STATED))
    for axis in _axes(log, names):
        rows.append((f'temperature of scale {axis.upper()}',
                     _material(log, axis, ends, log.description.scales.get(axis))))
    part = log.description.workpiece
    rows.append(('temperature of the workpiece', _material(log, 'workpiece', ends, part)))
    if part is not None:
        rows.append(('expansion coefficient of the workpiece', _coefficient(part)))
    return [*rows, ('temperature of the machine bed', _said(log, 'bed_temperature'))]


def _material(log: CalibrationLog, name: str, ends: np.ndarray, described: Expansion | None) -> str:
    """The temperature of a scale or the workpiece: as measured, else as the cell states it."""
    measured = _course(log, f'scale_temperature/{name}', ends, 1.0, '°C', 2)
    if measured is not None or described is None or described.temperature is None:
        return measured or NOT_STATED
    return (f'{described.temperature:.2f} ± {2.0 * described.temperature_sigma:.2f} °C (k = 2; the cell file\'s value, '
            'not measured)')


def _coefficient(material: Expansion) -> str:
    return f'{1e6 * material.expansion:.2f} ± {2e6 * material.sigma:.2f} µm/(m·K) (k = 2)'


def _course(log: CalibrationLog, topic: str, ends: np.ndarray, factor: float, unit: str, digits: int) -> str | None:
    """A measured quantity at begin and end of the test; None where the log has no reading of it."""
    series = log.environment.get(topic)
    if series is None or not np.isfinite(series.value).any():
        return None
    first, last = factor * series.at(ends)
    variance = np.median(series.variance)
    known = f', U {2.0 * factor * np.sqrt(variance):.{digits}f} {unit} (k = 2) as the sensor says' if variance > 0.0 \
        else ', U of the sensor ' + NOT_STATED
    return f'{first:.{digits}f} {unit} at the beginning, {last:.{digits}f} {unit} at the end{known}'


def _axes(log: CalibrationLog, names: list[str]) -> str:
    """Letters of the axes that move in the setups."""
    moved = {axis for name in names for axis in log.description.setups[name].axes}
    return ''.join('xyz'[axis] for axis in sorted(moved))


def _corrections(evaluation: Evaluation, axes: str) -> list[Row]:
    tied, known, scales = evaluation.solution.traceability, evaluation.metres.conditions, []
    described = evaluation.setting.description.scales
    for axis in axes:
        place = 'xyz'.index(axis)
        coefficient = _coefficient(described[axis]) if axis in described else NOT_STATED
        scales.append((f'expansion coefficient of scale {axis.upper()}', coefficient))
        scales.append((f'readings along {axis.upper()} referred to 20 °C', 'yes, at the temperature of its scale above'
                       if known.referred[place] and np.isfinite(known.expansion[place]) else 'no'))
    air = [] if tied is None else [
        ('correction for air', f'{WORDS[tied.air]}; mean index {tied.index:.7f}'),
        ('U of the unit of length', f'{2e6 * tied.index_sigma:.2g} µm/m (k = 2)'),
        ('budget of uncertainty', 'the cell\'s own' if tied.budget == 'cell' else 'the standard budget')]
    part = [] if tied is None else [('parts', tied.workpiece_words)]
    return [*air, *scales, *part]
