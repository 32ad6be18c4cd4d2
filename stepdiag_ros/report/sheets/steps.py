"""The sheet of a step diagonal: the errors that its steps tell, how mirrors and lasers stood, the single steps.

No standard has a form for it; the conditions are those that ISO 230-6 asks for.  What the stops on the diagonal say
after ISO 230-6 is on a sheet of its own (:mod:`stepdiag_ros.report.sheets.diagonals`).
"""

from functools import partial

import numpy as np
from matplotlib.figure import Figure

from stepdiag_ros.estimate.evaluate import Evaluation
from stepdiag_ros.estimate.readings import CellReadings, SetupReadings
from stepdiag_ros.model.description import Description
from stepdiag_ros.model.log import CalibrationLog
from stepdiag_ros.model.machine import AXES
from stepdiag_ros.report.legends import legend_outside
from stepdiag_ros.report.plots import INK
from stepdiag_ros.report.sheets.errors import errors_grid, open_note
from stepdiag_ros.report.sheets.record import conditions
from stepdiag_ros.report.sheets.sheet import Grid, Sheet, micro
from stepdiag_ros.report.words import setup_words

PUBLISHED = 'Dahlem et al. 2018'
KINDS = {'body step diagonal': ('Step diagonals of the body', 4, 'four diagonals'),
         'face step diagonal': ('Step diagonals of faces', 3, 'three faces, or both diagonals of one')}
JOINT = ('The errors are those of the joint estimate of the whole log; what each kind of setup contributed to it the '
         'evaluation says under parts.')
ASKEW = ('A mirror that is not square to its beam lengthens the steps of one axis and shortens those of another: the '
         'angles below were found together with the errors, and their effect is taken out of them.')


def step_sheets(log: CalibrationLog, evaluation: Evaluation, cell: CellReadings, source: str) -> list[Sheet]:
    """A sheet for the step diagonals of the body and one for those of faces, where the log holds them."""
    found = []
    for kind, (title, wanted, words) in KINDS.items():
        names = [name for name in cell.setups if log.description.setups[name].kind == kind]
        if not names:
            continue
        solution = evaluation.solution
        found.append(Sheet(
            title, PUBLISHED, errors_grid(solution), conditions(log, evaluation, names, source),
            _short(log.description, names, wanted, words), partial(draw, {name: cell.setups[name] for name in names}),
            'Deviation from the commanded length after each move, means of all runs; a mark says which axis moved.',
            [_angles(evaluation, names)], [ASKEW, JOINT, *open_note(solution)],
            'Diagonals, detectors and lines of the axes are as many as the method needs.'))
    return found


def _short(description: Description, names: list[str], wanted: int, words: str) -> list[str]:
    short = [] if len(names) >= wanted else [f'{len(names)} step diagonal{"" if len(names) == 1 else "s"}; {words}.']
    blind = [name for name in names if not description.setups[name].sees_tilt
             and len(description.setups[name].beams) < 3]
    if blind:
        short.append(f'{", ".join(blind)}: no detector and fewer than three beams; angular errors of the axes appear '
                     'as errors of translation.')
    lines = {setup.axes[0] for setup in description.setups.values() if setup.is_line}
    moved = {axis for name in names for axis in description.setups[name].axes}
    if missing := sorted(moved - lines):
        short.append(f'no line along {", ".join(AXES[axis] for axis in missing)}: slopes of positioning are not told '
                     'from mirrors that stand askew.')
    return short


def _angles(evaluation: Evaluation, names: list[str]) -> Grid:
    solution, rows = evaluation.solution, []
    for name in names:
        own, sigma = solution.misalignments.get(name), solution.misalignment_sigma.get(name)
        if own is None:
            continue
        cells = []
        for part in ('laser', 'mirror'):
            known = getattr(sigma, part) if sigma is not None else (None, None)
            cells += [f'{1e6 * value:.1f}' + ('' if u is None else f' ± {2e6 * u:.1f}')
                      for value, u in zip(getattr(own, part), known, strict=True)]
        rows.append((name, setup_words(evaluation.setting.description.setups[name]), *cells))
    head = ('', 'step diagonal', '>laser u [µrad]', '>laser v [µrad]', '>mirror u [µrad]', '>mirror v [µrad]')
    return Grid('How lasers and mirrors stood', head, rows, 'U (k = 2). Turning all of them together with the machine '
                'changes no reading to first order: a common turn is held to 100 µrad.')


def draw(setups: dict[str, SetupReadings]) -> Figure:
    """A panel for each step diagonal, one scale for all."""
    rows = (len(setups) + 1) // 2
    figure = Figure(figsize=(9.5, 2.5 * rows + 0.6), layout='constrained')
    axes, handles = np.ravel(figure.subplots(rows, 2, sharey=True, squeeze=False)), {}
    for ax, (name, setup) in zip(axes, setups.items(), strict=False):
        sight = setup.sight
        along = (sight.positions - sight.positions[0]) @ sight.direction
        deviation = 1e6 * (setup.displacement_m[:, 0] - along)
        ax.plot(np.arange(len(along)), deviation, color=INK, linewidth=0.7)
        for axis, mark in enumerate('os^'):
            own = np.flatnonzero(sight.axis == axis)
            if len(own):
                handles[f'{AXES[axis]} moved'], = ax.plot(own, deviation[own], mark, color=f'C{axis}', markersize=4)
        ax.set_title(f'{name}: {micro(float(np.ptp(deviation)) * 1e-6)} µm from lowest to highest')
        ax.set_xlabel('stop')
        ax.set_ylabel('deviation [µm]')
        ax.label_outer()
        ax.xaxis.label.set_visible(True)
    for ax in axes[len(setups):]:
        ax.set_axis_off()
    legend_outside(figure, list(handles.values()), list(handles), 'upper left', ncols=3, fontsize=8.5)
    return figure
