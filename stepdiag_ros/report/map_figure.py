"""A picture of the predicted volumetric error: arrows in the volume, and its size in three planes."""

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from stepdiag_ros.estimate.prediction import VolumetricMap
from stepdiag_ros.model.description import Machine
from stepdiag_ros.report.space import FAINT, INK, Camera, draw_box

COLOURS = 'viridis_r'
ARROWS = 6
"""Arrows an axis at most."""


def draw_map(chart: VolumetricMap, machine: Machine, path: Path, title: str) -> None:
    """Write the picture (format by the file's name)."""
    matplotlib.rcParams['svg.hashsalt'] = 'stepdiag'
    prediction = chart.prediction
    norm = Normalize(0.0, max(float(prediction.size_m.max()) * 1e6, 1e-9))
    figure = Figure(figsize=(13.5, 7.6), dpi=130)
    scale = _arrows(figure.add_axes((0.01, 0.03, 0.60, 0.86)), chart, machine, norm)
    size = prediction.size_m.reshape(chart.shape) * 1e6
    levels = (len(chart.axes[2]) - 1, (len(chart.axes[2]) - 1) // 2, 0)
    for row, level in enumerate(dict.fromkeys(levels)):
        axes = figure.add_axes((0.665, 0.665 - 0.295 * row, 0.23, 0.225))
        _plane(axes, chart, size[:, :, level], norm, f'z = {chart.axes[2][level] * 1e3:.0f} mm')
        if row < 2:
            axes.set_xlabel('')
            axes.set_xticklabels([])
    bar = figure.colorbar(ScalarMappable(norm, COLOURS), cax=figure.add_axes((0.925, 0.075, 0.014, 0.815)))
    bar.set_label('size of the deviation / µm', fontsize=9, color=INK)
    bar.ax.tick_params(labelsize=8, colors=FAINT)
    bar.outline.set_visible(False)
    worst = chart.worst
    figure.text(0.02, 0.955, title, fontsize=15, color=INK, weight='bold', va='center')
    at = ', '.join(f'{c * 1e3:.0f}' for c in prediction.points[worst])
    spread = ' / '.join(f'{r * 1e6:.1f}' for r in chart.ranges_m)
    largest, sigma = prediction.size_m[worst] * 1e6, prediction.size_sigma_m[worst] * 1e6
    figure.text(0.02, 0.915, f'largest {largest:.1f} ± {2 * sigma:.1f} µm (k = 2) at ({at}) mm; '
                f'range in x / y / z {spread} µm; arrows drawn {scale:,.0f} times as long',
                fontsize=10, color=FAINT, va='center')
    figure.savefig(path, facecolor='white')


def _arrows(axes: Axes, chart: VolumetricMap, machine: Machine, norm: Normalize) -> float:
    """Deviations as arrows from where the tool should be; returns how much they are enlarged."""
    volume = np.array(machine.volume)
    camera = Camera(np.array([0.8, 0.6, 0.5]))
    draw_box(axes, camera, np.zeros(3), volume, 1.0, behind=True)
    kept = [np.unique(np.linspace(0, n - 1, min(n, ARROWS)).round().astype(int)) for n in chart.shape]
    rows = np.ravel_multi_index(np.meshgrid(*kept, indexing='ij'), chart.shape).ravel()
    point, deviation = chart.prediction.points[rows], chart.prediction.deviation_m[rows]
    largest = np.linalg.norm(deviation, axis=1).max()
    scale = _round_down(0.9 * volume.min() / ARROWS / largest) if largest > 0.0 else 1.0
    order = np.argsort(point @ camera.eye)
    start, arrow = camera(point[order]), camera(scale * deviation[order])
    size = np.linalg.norm(deviation[order], axis=1) * 1e6
    colours = matplotlib.colormaps[COLOURS](norm(size))
    axes.quiver(*start.T, *arrow.T, color=colours, angles='xy', scale_units='xy', scale=1.0, width=0.0026,
                headwidth=4.5, headlength=5.5, zorder=3)
    axes.scatter(*start.T, s=5, color=colours, zorder=4, linewidth=0)
    draw_box(axes, camera, np.zeros(3), volume, 1.0, behind=False)
    axes.set_aspect('equal', adjustable='datalim')
    axes.margins(0.06)
    axes.set_axis_off()
    return scale


def _round_down(value: float) -> float:
    """The next number of the form 1, 2 or 5 times a power of ten at or below ``value``."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in (1.0, 2.0, 5.0) if step * power <= value * (1 + 1e-12)) * power)


def _plane(axes: Axes, chart: VolumetricMap, size: np.ndarray, norm: Normalize, name: str) -> None:
    x, y = chart.axes[0] * 1e3, chart.axes[1] * 1e3
    axes.pcolormesh(x, y, size.T, norm=norm, cmap=COLOURS, shading='gouraud', rasterized=True)
    axes.set_aspect('equal', adjustable='box')
    axes.set_title(name, fontsize=10, color=INK, loc='left')
    axes.set_xlabel('x / mm', fontsize=8, color=INK, labelpad=1)
    axes.set_ylabel('y / mm', fontsize=8, color=INK)
    axes.tick_params(labelsize=8, colors=FAINT)
    for side in axes.spines.values():
        side.set_visible(False)
