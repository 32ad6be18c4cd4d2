"""A picture of what tables do: the size of the deviation before and after, in planes of the volume or along lines."""

from collections.abc import Mapping
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from stepdiag_ros.compensate.compensation import Compensation, K
from stepdiag_ros.estimate.prediction import Prediction
from stepdiag_ros.model.machine import AXES
from stepdiag_ros.report.map_figure import COLOURS
from stepdiag_ros.report.space import FAINT, INK

BEFORE, AFTER = '#c2572f', '#17688a'
MOST_NAMED = 10


def draw_compensation(found: Compensation, path: Path) -> None:
    """Write the picture (format by the file's name)."""
    matplotlib.rcParams['svg.hashsalt'] = 'stepdiag'
    figure = Figure(figsize=(13.5, 7.4), dpi=120)
    figure.text(0.03, 0.955, f'{found.place.machine.name}: what the tables for {found.control.title} do',
                fontsize=15, color=INK, weight='bold', va='center')
    now, then = found.worst_before, found.worst_after
    figure.text(0.03, 0.915, f'largest deviation {1e6 * now[0]:.1f} µm (U = {1e6 * now[1]:.1f}) → predicted '
                f'{1e6 * then[0]:.1f} µm (U = {1e6 * then[1]:.1f}), 95 %; tool '
                f'({", ".join(f"{1e3 * c:.0f}" for c in found.point.tool)}) mm', fontsize=10, color=FAINT, va='center')
    if found.whole_volume:
        draw_planes(figure, {'before': found.before, 'after': found.after}, 0.69, found.point.line)
    else:
        _lines(figure, found)
    _left(figure.add_axes((0.80, 0.10, 0.17, 0.70)), found)
    figure.savefig(path, facecolor='white')


def draw_planes(figure: Figure, fields: Mapping[str, Prediction], right: float, line: np.ndarray | None = None) -> None:
    """Two fields over each other, by title, in three planes of the volume; one scale of colours at ``right``.

    A white cross marks the reference ``line`` (3,) [m].
    """
    points = next(iter(fields.values())).points * 1e3
    axes = [np.unique(points[:, axis]) for axis in range(3)]
    shape = tuple(len(a) for a in axes)
    norm = Normalize(0.0, max(float(field.size_m.max()) for field in fields.values()) * 1e6)
    levels = sorted({0, (shape[2] - 1) // 2, shape[2] - 1})
    width = (right - 0.05) / 3.0
    for row, (title, prediction) in enumerate(fields.items()):
        size = prediction.size_m.reshape(shape) * 1e6
        for column, level in enumerate(levels):
            panel = figure.add_axes((0.05 + width * column, 0.50 - 0.42 * row, width - 0.025, 0.34))
            panel.pcolormesh(axes[0], axes[1], size[:, :, level].T, norm=norm, cmap=COLOURS, shading='gouraud',
                             rasterized=True)
            panel.set_aspect('equal', adjustable='box')
            panel.set_title(f'{title}, z = {axes[2][level]:.0f} mm', fontsize=10, color=INK, loc='left')
            panel.tick_params(labelsize=8, colors=FAINT)
            if line is not None:
                panel.plot(line[0] * 1e3, line[1] * 1e3, '+', color='white', markersize=9)
            if column == 0:
                panel.set_ylabel('y / mm', fontsize=8, color=INK)
            if row == len(fields) - 1:
                panel.set_xlabel('x / mm', fontsize=8, color=INK)
    bar = figure.colorbar(ScalarMappable(norm, COLOURS), cax=figure.add_axes((right + 0.005, 0.10, 0.012, 0.74)))
    bar.set_label('size of the deviation / µm', fontsize=9, color=INK)
    bar.ax.tick_params(labelsize=8, colors=FAINT)
    bar.outline.set_visible(False)


def _lines(figure: Figure, found: Compensation) -> None:
    panel = figure.add_axes((0.06, 0.10, 0.62, 0.74))
    for prediction, colour, title in ((found.before, BEFORE, 'before'), (found.after, AFTER, 'after, predicted')):
        _along(panel, prediction, colour, title)
    panel.set_xlabel('position / mm', fontsize=9, color=INK)
    panel.set_ylabel('deviation along the axis / µm, band U (k = 2)', fontsize=9, color=INK)
    panel.legend(frameon=False, fontsize=9)
    panel.axhline(0.0, color=FAINT, linewidth=0.6)


def _along(panel: Axes, prediction: Prediction, colour: str, title: str) -> None:
    moving = [axis for axis in range(3) if np.ptp(prediction.points[:, axis]) > 0.0]
    for axis in moving:
        rows = np.flatnonzero(np.all(np.delete(prediction.points - prediction.points[0], axis, 1) == 0.0, axis=1))
        rows = rows[np.argsort(prediction.points[rows, axis])]
        place, value = prediction.points[rows, axis] * 1e3, prediction.deviation_m[rows, axis] * 1e6
        spread = K * prediction.sigma_m[rows, axis] * 1e6
        panel.plot(place, value, color=colour, label=f'{AXES[axis]}, {title}')
        panel.fill_between(place, value - spread, value + spread, color=colour, alpha=0.15, linewidth=0)


def _left(panel: Axes, found: Compensation) -> None:
    """Bars: what this kind of table leaves of each error."""
    rest = sorted(((v, n) for n, v in found.not_carried.items() if v > 1e-8), reverse=True)[:MOST_NAMED]
    panel.set_title('not carried by this kind of table', fontsize=10, color=INK, loc='left')
    if not rest:
        panel.text(0.0, 0.95, 'nothing', fontsize=9, color=FAINT, va='top', transform=panel.transAxes)
        panel.set_axis_off()
        return
    panel.barh([n for _, n in rest][::-1], [1e6 * v for v, _ in rest][::-1], color=AFTER, ecolor=FAINT, capsize=2,
               xerr=[1e6 * found.not_carried_spread[n] for _, n in rest][::-1])
    panel.set_xlabel('largest in the volume, U (k = 2) / µm', fontsize=8, color=INK)
    panel.tick_params(labelsize=8, colors=FAINT)
    for side in ('top', 'right'):
        panel.spines[side].set_visible(False)
