"""One picture of all methods on one log: every curve of every method, and the truth in black."""

from collections.abc import Mapping
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.compare import Comparison
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.model.machine import CURVES, SQUARENESS
from stepdiag_ros.report.legends import legend_outside

COLOURS = ('#1b6ca8', '#d1495b', '#2e9e6b', '#e8a33d', '#7a5195', '#8c6d46')
MARKS = ('o', 's', '^', 'v', 'D', 'P')


def draw(comparison: Comparison, solutions: Mapping[str, Solution], path: Path, title: str) -> None:
    """Six columns (three translations, three rotations) by three axes, squareness below."""
    matplotlib.rcParams['svg.hashsalt'] = 'stepdiag'
    figure = Figure(figsize=(17, 11), layout='constrained')
    upper, lower = figure.subfigures(2, 1, height_ratios=(3.2, 1.0))
    curve_axes, square_axes = upper.subplots(3, 6), lower.subplots(1, 3)
    for place, name in enumerate(CURVES):
        axes = curve_axes[place // 6, place % 6]
        for (method, solution), colour, mark in zip(solutions.items(), COLOURS, MARKS, strict=False):
            if solution.has(name):
                position, value, sigma = solution.curve(name)
                axes.errorbar(position * 1e3, value * 1e6, yerr=2e6 * sigma, color=colour,
                              marker=mark, markersize=3, linewidth=1, elinewidth=0.6,
                              label=method, alpha=0.9)
        if name in comparison.errors.curves:
            curve = comparison.errors.curves[name]
            axes.plot(np.asarray(curve.position) * 1e3, np.asarray(curve.value) * 1e6, 'k--',
                      linewidth=1.4, label=comparison.reference, zorder=9)
        unit = 'µm' if name[1] in 'XYZ' else 'µrad'
        axes.set_title(f'{name}  [{unit}]', fontsize=10)
        axes.tick_params(labelsize=8)
        axes.grid(alpha=0.3)
        if place // 6 == 2:
            axes.set_xlabel('position [mm]', fontsize=9)
    for place, name in enumerate(SQUARENESS):
        axes = square_axes[place]
        shown = {m: s for m, s in solutions.items() if s.has(name)}
        for row, (method, solution) in enumerate(shown.items()):
            value, sigma = solution.squareness(name)
            colour = COLOURS[list(solutions).index(method) % len(COLOURS)]
            axes.errorbar([value * 1e6], [row], xerr=[2e6 * sigma], fmt='o', color=colour)
        if name in comparison.errors.square:
            axes.axvline(comparison.errors.square[name] * 1e6, color='k', linestyle='--')
        axes.set_yticks(range(len(shown)), list(shown), fontsize=8)
        axes.invert_yaxis()
        axes.set_title(f'{name}  [µrad]', fontsize=10)
        axes.grid(alpha=0.3)
    handles, labels = [], []
    for axes in curve_axes.flat:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            if label not in labels:
                handles.append(handle)
                labels.append(label)
    legend_outside(figure, handles, labels, 'upper right', ncols=len(labels), fontsize=9)
    figure.suptitle(f'{title}: every method on one log, bars k = 2', x=0.01, ha='left')
    try:
        figure.savefig(path, dpi=110, metadata={'Date': None} if str(path).endswith('.svg') else None)
    except (OSError, ValueError) as error:
        raise StepdiagError(f'{path}: the picture cannot be written: {error}') from None
