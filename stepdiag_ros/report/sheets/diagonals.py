"""The sheets of body and face diagonals after ISO 230-6: E and B of each diagonal, Ed and Bd, the plots."""

from collections.abc import Callable
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from stepdiag_ros.estimate.body_diagonal import DiagonalTest
from stepdiag_ros.estimate.evaluate import Evaluation
from stepdiag_ros.estimate.iso_rules import shortfalls
from stepdiag_ros.estimate.method_budget import Readings, with_cell_budget
from stepdiag_ros.estimate.methods import body_diagonal_test, corner_deviations, diagonal_displacement
from stepdiag_ros.estimate.of_ways import of_kind
from stepdiag_ros.estimate.readings import CellReadings
from stepdiag_ros.model.description import DIAGONALS, Description, path_of
from stepdiag_ros.model.log import CalibrationLog
from stepdiag_ros.report.legends import legend_outside
from stepdiag_ros.report.plots import AFTER, BEFORE
from stepdiag_ros.report.sheets.record import conditions
from stepdiag_ros.report.sheets.sheet import Grid, Sheet, micro
from stepdiag_ros.report.words import setup_words

BLIND = ('Errors of two axes that are opposite leave a body diagonal as long as it was: a small Ed says nothing of the '
         'volume by itself. ASME B5.54-2005 asks for linear tests of each axis besides.')
BLIND_FACE = ('Errors of two axes that are opposite leave a face diagonal as long as it was; the third axis and what '
              'leaves the plane are not seen.')
STEPPED = ('The diagonals were measured by a step diagonal with a flat mirror: the deviations are those of the stops '
           'that lie on the diagonal, reached by one axis after the other and not along the diagonal as ISO 230-6 has '
           'it.')


def diagonal_sheets(log: CalibrationLog, readings: Readings, source: str) -> list[Sheet]:
    """A sheet for the diagonals of each kind that a log holds: in one motion or stepped, of the body or of faces."""
    cell = readings.measured
    asked: list[tuple[str, list[str], Callable[[CellReadings], DiagonalTest]]] = []
    if short := [name for name in DIAGONALS if name in cell.setups]:
        asked.append(('body step diagonal', short, body_diagonal_test))
    for kind in ('body diagonal', 'body step diagonal', 'face diagonal', 'face step diagonal'):
        if names := of_kind(cell, kind):
            asked.append((kind, names, partial(diagonal_displacement, method=kind, kinds=(kind,))))
    return [_sheet(kind, names, with_cell_budget(test, readings), log, readings.evaluation, cell, source)
            for kind, names, test in asked]


def _sheet(kind: str, measured: list[str], test: DiagonalTest, log: CalibrationLog, evaluation: Evaluation,
           cell: CellReadings, source: str) -> Sheet:
    names = [name for name in measured if name in test.diagonals]
    runs = {name: corner_deviations(cell.setups[name]) for name in names}
    short = [sentence for name, (along, forward, backward) in runs.items()
             for sentence in shortfalls(name, along, min(len(forward), len(backward)) or len(forward), diagonal=True)]
    short += [f'{name}: run in one direction only; B is not given.' for name, (_, _, backward) in runs.items()
              if not len(backward)]
    body = kind.startswith('body')
    if body and len(names) < len(DIAGONALS):
        short.append(f'{len(names)} of the four body diagonals were measured.')
    sigma = max(float(cell.setups[name].displacement_sigma_m.max()) for name in names)
    again = [name for name in cell.setups if path_of(name) in names and name not in names]
    notes = ([STEPPED] if 'step' in kind else []) + [BLIND if body else BLIND_FACE]
    notes += [f'Not in this sheet: {", ".join(again)}, mounted once more.'] if again else []
    what = f'{"Body" if body else "Face"} diagonals'
    return Sheet(what if 'step' in kind else f'{what} in one motion', 'ISO 230-6',
                 _results(test, runs, log.description), conditions(log, evaluation, names, source), short,
                 partial(draw, test, runs),
                 'Deviation from the commanded length of each diagonal: means of the forward and the backward runs, '
                 'single runs thin.',
                 [_targets(name, test, sigma) for name in names], notes)


def _results(test: DiagonalTest, runs: dict[str, tuple[np.ndarray, ...]], description: Description) -> Grid:
    def cells(key: str, value: float | None) -> tuple[str, str]:
        return micro(value), micro(None if key not in test.sigma_m else 2.0 * test.sigma_m[key])
    rows = [(name, setup_words(description.setups[name]), f'{runs[name][0].size}',
             f'{len(runs[name][1])} / {len(runs[name][2])}', *cells(f'E {name}', own.E), *cells(f'B {name}', own.B))
            for name, own in test.diagonals.items()]
    rows.append(('Ed, Bd', 'the largest of all diagonals', '', '', *cells('Ed', test.Ed), *cells('Bd', test.Bd)))
    return Grid('Bidirectional systematic deviation E and reversal B',
                ('', 'diagonal', '>targets', '>runs ↑ / ↓', '>E [µm]', '>U (k = 2)', '>B [µm]', '>U (k = 2)'), rows)


def _targets(name: str, test: DiagonalTest, sigma: float) -> Grid:
    own = test.diagonals[name]
    backward, reversal = (None if v is None else list(v) for v in (own.backward_m, own.reversal_m))
    rows = [(f'{1e3 * place:.3f}', micro(own.forward_m[i]), micro(None if backward is None else backward[i]),
             micro(None if reversal is None else reversal[i])) for i, place in enumerate(own.position_m)]
    return Grid(f'Targets of {name}', ('>along the diagonal [mm]', '>x̄↑ [µm]', '>x̄↓ [µm]', '>B [µm]'), rows,
                f'U of a mean by repeats alone: {micro(2.0 * sigma)} µm (k = 2).')


def draw(test: DiagonalTest, runs: dict[str, tuple[np.ndarray, ...]]) -> Figure:
    """A panel for each diagonal, one scale for all."""
    count = len(test.diagonals)
    figure = Figure(figsize=(9.5, 2.5 * ((count + 1) // 2) + 0.6), layout='constrained')
    axes = np.ravel(figure.subplots((count + 1) // 2, 2, sharey=True, squeeze=False))
    handles = {}
    for ax, (name, own) in zip(axes, test.diagonals.items(), strict=False):
        _, forward, backward = runs[name]
        for single, mean, colour, mark, words in ((forward, own.forward_m, AFTER, '>', 'forward ↑, mean'),
                                                  (backward, own.backward_m, BEFORE, '<', 'backward ↓, mean')):
            for run in single:
                ax.plot(1e3 * own.position_m, 1e6 * run, color=colour, alpha=0.35, linewidth=0.7)
            if mean is not None:
                handles[words], = ax.plot(1e3 * own.position_m, 1e6 * mean, f'-{mark}', color=colour, markersize=4.5,
                                          linewidth=1.3)
        ax.set_title(f'{name}: E = {micro(own.E)} µm, B = {micro(own.B)}{" µm" if own.B is not None else ""}')
        ax.set_xlabel('along the diagonal [mm]')
        ax.set_ylabel('deviation [µm]')
        ax.label_outer()
        ax.xaxis.label.set_visible(True)
    for ax in axes[count:]:
        ax.set_axis_off()
    legend_outside(figure, list(handles.values()), list(handles), 'upper left', ncols=2, fontsize=8.5)
    return figure
