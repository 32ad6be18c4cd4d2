"""The sheet of one axis after ISO 230-2: A, E, R, B, M with uncertainties, the plot with its bands of ± 2 s."""

from dataclasses import replace
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from stepdiag_ros.estimate.evaluate import Evaluation
from stepdiag_ros.estimate.iso230_2 import AxisResult, LinearTest
from stepdiag_ros.estimate.iso_rules import shortfalls
from stepdiag_ros.estimate.method_budget import Readings, with_cell_budget
from stepdiag_ros.estimate.methods import linear_test
from stepdiag_ros.estimate.readings import CellReadings
from stepdiag_ros.model.description import path_of
from stepdiag_ros.model.log import CalibrationLog
from stepdiag_ros.report.legends import legend_outside
from stepdiag_ros.report.plots import AFTER, BEFORE, INK, SOFT
from stepdiag_ros.report.sheets.record import conditions
from stepdiag_ros.report.sheets.sheet import Grid, Sheet, micro
from stepdiag_ros.report.words import setup_words

FIGURES = (('A', 'accuracy, bidirectional'), ('A_up', 'accuracy, forward'), ('A_down', 'accuracy, backward'),
           ('E', 'systematic deviation, bidirectional'), ('E_up', 'systematic deviation, forward'),
           ('E_down', 'systematic deviation, backward'), ('R', 'repeatability, bidirectional'),
           ('R_up', 'repeatability, forward'), ('R_down', 'repeatability, backward'),
           ('B', 'reversal'), ('mean_reversal', 'mean reversal'), ('M', 'range of the mean bidirectional deviation'))
NO_OVERRUN = ('no overrun is stated in the log; without one each end target is approached from one side only, and its '
              'reversal does not show.')
SYMBOLS = {'A_up': 'A↑', 'A_down': 'A↓', 'E_up': 'E↑', 'E_down': 'E↓', 'R_up': 'R↑', 'R_down': 'R↓',
           'mean_reversal': 'B mean'}


def linear_sheets(log: CalibrationLog, readings: Readings, source: str) -> list[Sheet]:
    """A sheet for every linear setup that was run both ways; none where there is none."""
    own = linear_test(readings.measured)
    if not own.axes:
        return []
    # The figures of one direction get an uncertainty too.
    wanted = tuple(figure for figure, _ in FIGURES)
    test = with_cell_budget(lambda cell: replace(linear_test(cell), wanted=wanted), readings)
    return [_sheet(name, test, log, readings.evaluation, readings.measured, source) for name in test.axes]


def _sheet(name: str, test: LinearTest, log: CalibrationLog, evaluation: Evaluation, cell: CellReadings,
           source: str) -> Sheet:
    axis = test.axes[name]
    letter = test.letter(name)
    rows = [(SYMBOLS.get(figure, figure), words, micro(getattr(axis, figure)),
             micro(None if f'{figure} {name}' not in test.sigma_m else 2.0 * test.sigma_m[f'{figure} {name}']))
            for figure, words in FIGURES]
    results = Grid(f'Axis {letter}: {axis.target_m.size} targets, {axis.runs} cycles',
                   ('', 'figure of ISO 230-2', '>value [µm]', '>U (k = 2) [µm]'), rows)
    sigma = cell.setups[name].displacement_sigma_m
    again = [other for other in cell.setups if path_of(other) == name and other != name]
    notes = [f'Not in this sheet: {", ".join(again)}, the same line mounted once more.'] if again else []
    where = '' if log.description.setups[name].way is None else f', {setup_words(log.description.setups[name])}'
    return Sheet(f'Positioning of axis {letter}{where}', 'ISO 230-2', results,
                 conditions(log, evaluation, [name], source),
                 [*shortfalls(name, axis.target_m, axis.runs),
                  *([] if log.description.setups[name].overrun else [f'{name}: {NO_OVERRUN}'])],
                 partial(draw, axis, letter),
                 'Mean deviations of each direction with bands of ± 2 s, their mean dashed (mean bidirectional '
                 'deviation); dotted the limits whose distance is A (E where one cycle was run).',
                 [_targets(axis, float(sigma.max()))], notes)


def _targets(axis: AxisResult, sigma: float) -> Grid:
    def column(values: np.ndarray | None, factor: float = 1.0) -> list[str]:
        return ['–'] * axis.target_m.size if values is None else [micro(factor * v) for v in values]
    middle = (axis.mean_up + axis.mean_down) / 2.0
    columns = [[f'{1e3 * v:.3f}' for v in axis.target_m], column(axis.mean_up), column(axis.mean_down),
               column(middle), column(axis.reversal), column(axis.s_up), column(axis.s_down), column(axis.s_up, 4.0),
               column(axis.s_down, 4.0)]
    return Grid('Targets', ('>target [mm]', '>x̄↑ [µm]', '>x̄↓ [µm]', '>x̄ [µm]', '>B [µm]', '>s↑ [µm]', '>s↓ [µm]',
                            '>R↑ [µm]', '>R↓ [µm]'), list(zip(*columns, strict=True)),
                f'U of a mean by repeats alone: {micro(2.0 * sigma)} µm (k = 2).'
                + ('' if axis.runs < 2 else f' A standard deviation from {axis.runs} cycles is itself uncertain by '
                   f'{100.0 * 2.0 / np.sqrt(2.0 * (axis.runs - 1)):.0f} % (k = 2).'))


def draw(axis: AxisResult, letter: str) -> Figure:
    """The plot of ISO 230-2 of one axis."""
    figure = Figure(figsize=(9.5, 4.2), layout='constrained')
    ax = figure.subplots()
    place, handles, labels = 1e3 * axis.target_m, [], []
    for mean, spread, colour, mark, words in ((axis.mean_up, axis.s_up, AFTER, '>', 'forward ↑'),
                                              (axis.mean_down, axis.s_down, BEFORE, '<', 'backward ↓')):
        handles += ax.plot(place, 1e6 * mean, f'-{mark}', color=colour, markersize=5, linewidth=1.4)
        labels.append(f'{words}, mean')
        if spread is not None:
            handles.append(ax.fill_between(place, 1e6 * (mean - 2.0 * spread), 1e6 * (mean + 2.0 * spread),
                                           color=colour, alpha=0.16, linewidth=0))
            labels.append('± 2 s')
    handles += ax.plot(place, 5e5 * (axis.mean_up + axis.mean_down), '--', color=INK, linewidth=1.0)
    labels.append('mean bidirectional deviation')
    both = np.array([axis.mean_up, axis.mean_down])
    spread = 0.0 if axis.s_up is None else 2.0 * np.array([axis.s_up, axis.s_down])
    limits = float(np.min(both - spread)), float(np.max(both + spread))
    for limit in limits:
        ax.axhline(1e6 * limit, color=SOFT, linewidth=0.8, linestyle=':')
    size, said = (axis.E, 'E') if axis.A is None else (axis.A, 'A')
    ax.annotate(f'{said} = {micro(size)} µm', (1.0, 1e6 * limits[1]), xycoords=('axes fraction', 'data'), ha='right',
                va='bottom', fontsize=8.5, xytext=(0, 2), textcoords='offset points')
    ax.set_xlabel(f'target position of {letter} [mm]')
    ax.set_ylabel('deviation [µm]')
    ax.margins(y=0.12)
    legend_outside(figure, handles, labels, 'upper left', ncols=5, fontsize=8.5)
    return figure
