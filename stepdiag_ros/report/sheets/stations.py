"""The sheets of multilateration and of rectangular paths: stations, targets, errors, by how much the lengths disagree.

No standard has a form for them; the conditions are those that ISO 230-2 and ISO 230-6 ask for, and the stations.
"""

from functools import partial

import numpy as np
from matplotlib.figure import Figure

from stepdiag_ros.estimate.evaluate import Evaluation
from stepdiag_ros.model.description import Description
from stepdiag_ros.model.log import CalibrationLog
from stepdiag_ros.model.machine import AXES
from stepdiag_ros.model.path import stops
from stepdiag_ros.model.way import AROUND
from stepdiag_ros.report.legends import legend_outside
from stepdiag_ros.report.plots import INK
from stepdiag_ros.report.sheets.errors import errors_grid, open_note
from stepdiag_ros.report.sheets.record import conditions
from stepdiag_ros.report.sheets.sheet import Grid, Sheet, micro

PUBLISHED, PUBLISHED_PATH = 'Ibaraki & Hiruya 2020, section 2.1', 'Ibaraki & Hiruya 2020, section 2.2'
LEAST = {2: 3, 3: 4}
"""Stations that a plane and a space need, by the number of axes that move."""
JOINT = ('The errors are those of the joint estimate of the whole log, to which all its setups contribute; without the '
         'stations they would be less certain, or open, as the evaluation says under parts.')
SEEN = 'Station and dead path were not measured but found together with the errors, from changes of length alone.'


def station_sheets(log: CalibrationLog, evaluation: Evaluation, source: str) -> list[Sheet]:
    """A sheet of the grids that were followed, and one of the rectangular paths; none of what a log does not hold."""
    names = [name for name in evaluation.metres.table.setup_names if log.description.setups[name].follows]
    paths = [name for name in names if log.description.setups[name].way.moves == AROUND]
    grids = [name for name in names if name not in paths]
    found = []
    if grids:
        found.append(_sheet(log, evaluation, grids, source, 'Multilateration', PUBLISHED, _short(log, grids),
                            'Stations and tool vectors are as many as the method needs.'))
    if paths:
        held = any(log.description.setups[name].regulated for name in paths)
        found.append(_sheet(log, evaluation, paths, source,
                            f'Rectangular paths, the beam {"regulated" if held else "follows"}', PUBLISHED_PATH,
                            _short_of_paths(log.description, paths),
                            'Each plane has the lines of its axes, as the method needs.'))
    return found


def _sheet(log: CalibrationLog, evaluation: Evaluation, names: list[str], source: str, title: str, published: str,
           short: list[str], enough: str) -> Sheet:
    solution = evaluation.solution
    left = solution.residuals
    own = {name: left.displacement_m[left.setup == name, 0] for name in names}
    notes = [SEEN] + ([JOINT] if len(names) < len(evaluation.metres.table.setup_names) else [])
    return Sheet(title, published, errors_grid(solution), conditions(log, evaluation, names, source), short,
                 partial(draw, log, names, own),
                 'Left: targets of the retroreflector and stations, seen along Z. Right: lengths less the joint '
                 'estimate, in the order of measuring.', [_stations(log, evaluation, own)],
                 [*notes, *open_note(solution)], enough)


def _short(log: CalibrationLog, names: list[str]) -> list[str]:
    moved = {axis for name in names for axis in log.description.setups[name].axes}
    wanted = LEAST.get(len(moved), 1)
    short = [f'{len(names)} stations; {"space needs four" if wanted == 4 else "a plane needs three"}.'] \
        if len(names) < wanted else []
    tools = {log.description.setups[name].tool_of(log.description.machine) for name in names}
    if len(moved) == 3 and len(tools) < 2:
        short.append('one tool vector in all stations: rotations of the last axis are not seen.')
    return short


def _short_of_paths(description: Description, names: list[str]) -> list[str]:
    """What the rectangular paths of some planes lack: a line along each of their axes."""
    lines = {setup.axes[0] for setup in description.setups.values() if setup.is_line}
    missing = {name: [AXES[axis] for axis in description.setups[name].axes if axis not in lines] for name in names}
    return [f'{name}: no line along {" or ".join(letters)}; the path alone does not tell positioning.'
            for name, letters in missing.items() if letters]


def _stations(log: CalibrationLog, evaluation: Evaluation, own: dict[str, np.ndarray]) -> Grid:
    stations = {name: evaluation.solution.extra['stations'][name] for name in own}
    held, rows = any('beam' in found for found in stations.values()), []
    for name, found in stations.items():
        setup = log.description.setups[name]
        place = [f'{1e3 * x:.4f} ± {2e3 * u:.2g}' for x, u in zip(found['position_m'], found['sigma_m'], strict=True)]
        rows.append((name, ' / '.join(f'{1e3 * v:.1f}' for v in setup.station), *place,
                     f'{1e3 * found["dead_path_m"]:.4f} ± {2e3 * found["dead_path_sigma_m"]:.2g}',
                     str(len(stops(log.description, name))), str(log.description.repeats_of(name)),
                     micro(_rms(own[name])),
                     *((micro(found['beam']['spot_rms_m']), micro(found['beam']['angle_rms_rad'], 1))
                       if 'beam' in found else ('–', '–') if held else ())))
    head = ('', 'stated X / Y / Z', '>X', '>Y', '>Z', '>dead path', '>targets', '>cycles', '>residual rms [µm]')
    return Grid('Stations [mm]', head + (('>spot rms [µm]', '>angle rms [µrad]') if held else ()), rows,
                'U (k = 2) by repeats.')


def _rms(residual: np.ndarray) -> float:
    """Root mean square of what was measured; NaN where nothing was."""
    measured = residual[np.isfinite(residual)]
    return float(np.sqrt(np.mean(measured**2))) if len(measured) else float('nan')


def draw(log: CalibrationLog, names: list[str], own: dict[str, np.ndarray]) -> Figure:
    """Where stations and targets are, and what the estimate leaves of the lengths."""
    figure = Figure(figsize=(9.5, 4.4), layout='constrained')
    above, rest = figure.subplots(1, 2)
    handles, begin = {}, 0
    for number, name in enumerate(names):
        setup = log.description.setups[name]
        colour = f'C{number}'
        place = stops(log.description, name).positions + setup.tool_of(log.description.machine)
        above.plot(1e3 * place[:, 0], 1e3 * place[:, 1], '.', color=colour, markersize=3, alpha=0.5)
        handles[name], = above.plot(1e3 * setup.station[0], 1e3 * setup.station[1], '^', color=colour, markersize=8)
        rest.plot(begin + np.arange(len(own[name])), 1e6 * own[name], '.', color=colour, markersize=3)
        begin += len(own[name])
    above.set_aspect('equal', adjustable='datalim')
    above.set_xlabel('X [mm]')
    above.set_ylabel('Y [mm]')
    rest.axhline(0.0, color=INK, linewidth=0.7)
    rest.set_xlabel('stop, in the order of measuring')
    rest.set_ylabel('length less estimate [µm]')
    legend_outside(figure, list(handles.values()), list(handles), 'upper left', ncols=4, fontsize=8.5)
    return figure
