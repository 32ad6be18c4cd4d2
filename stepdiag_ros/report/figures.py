"""Pictures of an evaluation: the 21 errors with their uncertainty, the truth beside them where it is known."""

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.gauge import to_reference_lines
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.model.machine import CURVES, SQUARENESS, GeometricErrors
from stepdiag_ros.report.legends import legend_outside
from stepdiag_ros.report.plots import AFTER, INK, SOFT, STYLE
from stepdiag_ros.report.words import K

MOTIONS = {'X': 'along X', 'Y': 'along Y', 'Z': 'along Z', 'A': 'turn about X', 'B': 'turn about Y',
           'C': 'turn about Z'}


def calibration_figure(solution: Solution, truth: GeometricErrors | None, path: Path | str) -> Path:
    """Draw ``solution`` into ``path`` (.png, .svg, .pdf): 18 curves with bands of k = 2, three squareness
    errors, ``truth`` dashed where it is given (any gauge: it is brought to the same reference lines).

    Raises :class:`~stepdiag_ros.errors.StepdiagError` where the file cannot be written.
    """
    path = Path(path)
    with matplotlib.rc_context(STYLE):
        figure = _draw(solution, None if truth is None else to_reference_lines(truth))
        try:
            figure.savefig(path, dpi=120, metadata={'Date': None} if path.suffix == '.svg' else None)
        except (OSError, ValueError) as error:
            raise StepdiagError(f'{path}: the picture cannot be written: {error}') from None
    return path


def draw_calibration(solution: Solution, truth: GeometricErrors | None = None, label: str = 'true') -> Figure:
    """As :func:`calibration_figure`, the figure itself, to be put into a page; ``label``: what ``truth`` is."""
    return _draw(solution, truth, heading=False, label=label)


def _draw(solution: Solution, truth: GeometricErrors | None, heading: bool = True, label: str = 'true') -> Figure:
    figure = Figure(figsize=(13.0, 7.8), layout='constrained')
    curves, square = figure.subfigures(1, 2, width_ratios=(6.0, 1.15))
    axes = curves.subplots(3, 6)
    for place, name in enumerate(CURVES):
        ax = axes[place // 6, place % 6]
        unit = 'µm' if name[1] in 'XYZ' else 'µrad'
        ax.set_title(f'{name}  [{unit}]', fontsize=9)
        ax.tick_params(labelsize=7.5)
        if place < 6:
            ax.annotate(MOTIONS[name[1]], (0.5, 1.2), xycoords='axes fraction', ha='center', fontsize=8.5,
                        color=SOFT)
        if place // 6 == 2:
            ax.set_xlabel('position [mm]', fontsize=8)
        if place % 6 == 0:
            ax.set_ylabel(f'moving {name[2]}', fontsize=9)
        if not solution.has(name):
            ax.annotate('not found\nby this log', (0.5, 0.5), xycoords='axes fraction', ha='center', va='center',
                        color=SOFT)
            continue
        position, value, sigma = (np.asarray(v) * f for v, f in zip(solution.curve(name), (1e3, 1e6, 1e6),
                                                                    strict=True))
        ax.fill_between(position, value - K * sigma, value + K * sigma, color=AFTER, alpha=0.2, linewidth=0)
        ax.plot(position, value, '-o', color=AFTER, markersize=2.6, linewidth=1.4)
        if truth is not None and name in truth.curves:
            true = truth.curves[name]
            ax.plot(np.asarray(true.position) * 1e3, np.asarray(true.value) * 1e6, '--', color=INK,
                    linewidth=1.1)
    _squareness(square.subplots(3, 1), solution, truth)
    handles = [matplotlib.lines.Line2D([], [], color=AFTER, marker='o', markersize=3),
               matplotlib.patches.Patch(color=AFTER, alpha=0.2)]
    labels = ['found', 'band of k = 2']
    if truth is not None:
        handles.append(matplotlib.lines.Line2D([], [], color=INK, linestyle='--'))
        labels.append(label)
    legend_outside(figure, handles, labels, 'lower left', ncols=3, fontsize=9)
    if heading:
        figure.suptitle(_title(solution), x=0.01, ha='left', fontsize=12, fontweight='bold')
    return figure


def _squareness(axes: np.ndarray, solution: Solution, truth: GeometricErrors | None) -> None:
    pairs = {'EC0Y': 'Y to X', 'EB0Z': 'Z to X', 'EA0Z': 'Z to Y'}
    for ax, name in zip(axes, SQUARENESS, strict=True):
        ax.set_title(f'{name}  [µrad]', fontsize=9)
        ax.set_xticks([])
        ax.set_xlim(-1.0, 1.0)
        ax.set_xlabel(f'squareness {pairs[name]}', fontsize=8)
        ax.tick_params(labelsize=7.5)
        if solution.has(name):
            value, sigma = (1e6 * v for v in solution.squareness(name))
            ax.bar([0.0], [2 * K * sigma], bottom=[value - K * sigma], width=0.5, color=AFTER, alpha=0.2)
            ax.plot([-0.25, 0.25], [value, value], color=AFTER, linewidth=1.8)
            ax.annotate(f'{value:.2f} ± {K * sigma:.2f}', (0.0, value + K * sigma), ha='center', va='bottom',
                        fontsize=8, xytext=(0, 3), textcoords='offset points')
            reach = max(4.0 * K * sigma, 1e-3)
            true = None if truth is None else truth.square.get(name)
            if true is not None:
                ax.plot([-0.6, 0.6], [true * 1e6] * 2, '--', color=INK, linewidth=1.1)
                reach = max(reach, 1.6 * abs(true * 1e6 - value))
            ax.set_ylim(value - reach, value + reach)


def _title(solution: Solution) -> str:
    parts = ['The 21 geometric errors']
    if solution.reduced_chi2 is not None:
        parts.append(f'reduced χ² {solution.reduced_chi2:.3f}'
                     + (f' over {solution.dof} degrees of freedom' if solution.dof else ''))
    if solution.status != 'ok':
        parts.append(solution.status)
    return ' — '.join(parts)
