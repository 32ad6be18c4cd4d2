"""A picture of one setup: machine volume, path, mirror at the stops, beams, and what the mirror must cover.

The caller traces the beams; this draws them.  Everything is at true scale in the machine frame,
at the mirror's reference point: the box is the working volume moved by the tool vector.  The
projection is that of :mod:`stepdiag_ros.report.space`.
"""

from dataclasses import dataclass
from itertools import product
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon, Rectangle

from stepdiag_ros.report.space import BOX, FAINT, INK, Camera, draw_box

BEAM, PSD, MIRROR, MIRROR_FILL = '#d1304b', '#e08e0b', '#2f7fb5', '#d7e8f4'
AXIS_COLOURS = {0: '#1b6ca8', 1: '#2e9e6b', 2: '#7a5195'}
SHOWN_MIRRORS = 9


@dataclass(frozen=True)
class SetupScene:
    """What is drawn of a setup; lengths [m], machine frame.

    ``path`` (n, 3) the mirror's reference point at the stops; ``axis`` (n,) the axis that moved to
    each (255: none); ``triad`` (3, 3) rows u, v, d; ``origin`` (3,) of the base unit; ``volume`` and
    ``tool`` (3,) of the machine.  ``beams``: per interferometer beam (2, n, 3), start and strike.
    ``psd`` (3, n, 3): start, strike, return, or None.
    """

    name: str
    machine: str
    volume: np.ndarray
    tool: np.ndarray
    path: np.ndarray
    axis: np.ndarray
    triad: np.ndarray
    origin: np.ndarray
    beams: list[np.ndarray]
    psd: np.ndarray | None

    def on_mirror(self, strikes: np.ndarray) -> np.ndarray:
        """Where strikes (n, 3) lie on the mirror, along u and v from its reference point: (n, 2) [m]."""
        return (strikes - self.path) @ self.triad[:2].T

    @property
    def mirror_half(self) -> tuple[np.ndarray, np.ndarray]:
        """Centre and half size (2,) [m] of the smallest mirror that every beam meets, 10 % to spare."""
        lines = [*self.beams, *([] if self.psd is None else [self.psd])]
        met = np.concatenate([self.on_mirror(line[1]) for line in lines])
        low, high = met.min(axis=0), met.max(axis=0)
        return (low + high) / 2.0, np.maximum((high - low) * 0.55, 0.01)


def draw_scene(scenes: list[SetupScene], path: Path) -> None:
    """One scene with its side views, or several beside each other, into a picture file."""
    matplotlib.rcParams['svg.hashsalt'] = 'stepdiag'
    if len(scenes) == 1:
        figure = Figure(figsize=(13.5, 7.6), dpi=130)
        _space(figure.add_axes((0.01, 0.03, 0.68, 0.87)), scenes[0], large=True)
        has_psd = scenes[0].psd is not None
        _mirror_view(figure.add_axes((0.755, 0.545 if has_psd else 0.28, 0.22, 0.35)), scenes[0])
        if has_psd:
            _spot_view(figure.add_axes((0.755, 0.075, 0.22, 0.35)), scenes[0])
        figure.text(0.02, 0.955, f'{scenes[0].machine}: setup {scenes[0].name}', fontsize=15, color=INK,
                    weight='bold', va='center')
        figure.text(0.02, 0.915, _subtitle(scenes[0]), fontsize=10, color=FAINT, va='center')
    else:
        columns = 2 if len(scenes) <= 4 else 3
        rows = -(-len(scenes) // columns)
        figure = Figure(figsize=(6.4 * columns, 4.6 * rows), dpi=110)
        for number, scene in enumerate(scenes):
            left, low = number % columns / columns, 1.0 - (number // columns + 1) / rows
            _space(figure.add_axes((left + 0.02 / columns, low + 0.02 / rows, 0.96 / columns, 0.86 / rows)),
                   scene, large=False)
            figure.text(left + 0.03 / columns, low + 0.94 / rows, scene.name, fontsize=13, color=INK,
                        weight='bold', va='center')
            figure.text(left + 0.13 / columns, low + 0.94 / rows, _subtitle(scene), fontsize=9, color=FAINT,
                        va='center')
    figure.savefig(path, facecolor='white')


def _subtitle(scene: SetupScene) -> str:
    _, half = scene.mirror_half
    return (f'{len(scene.path)} stops, beam {_longest(scene) * 1e3:.0f} mm at most, '
            f'mirror of at least {2e3 * half[0]:.0f} × {2e3 * half[1]:.0f} mm')


def _longest(scene: SetupScene) -> float:
    return float(max(np.linalg.norm(b[1] - b[0], axis=-1).max() for b in scene.beams))


def _space(axes: Axes, scene: SetupScene, large: bool) -> None:
    """The setup in space; what is nearer to the eye is drawn later."""
    camera = Camera(scene.triad[2])
    width = 1.0 if large else 0.75
    draw_box(axes, camera, scene.tool, scene.volume, width, behind=True)

    shown = np.unique(np.linspace(0, len(scene.path) - 1, min(SHOWN_MIRRORS, len(scene.path))).round().astype(int))
    centre, half = scene.mirror_half
    ring = centre + half * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    for i in sorted(shown, key=lambda i: scene.path[i] @ camera.eye):
        axes.add_patch(Polygon(camera(scene.path[i] + ring @ scene.triad[:2]), facecolor=MIRROR_FILL,
                               edgecolor=MIRROR, alpha=0.75, linewidth=0.9 * width, zorder=3))
    for number, colour in AXIS_COLOURS.items():
        steps = [camera(scene.path[i - 1:i + 1]) for i in np.flatnonzero(scene.axis == number) if i > 0]
        axes.add_collection(LineCollection(steps, colors=colour, linewidths=2.0 * width, capstyle='round', zorder=4))
    if scene.psd is not None:
        for i in shown:
            axes.plot(*camera(scene.psd[:, i]).T, color=PSD, linewidth=1.1 * width, zorder=5)
        axes.plot(*camera(scene.psd[1, shown]).T, 'o', color=PSD, markersize=3.2 * width, zorder=6)
    for beam in scene.beams:
        far = np.argmax(np.linalg.norm(beam[1] - beam[0], axis=-1))
        axes.plot(*camera(beam[:, far]).T, color=BEAM, linewidth=1.4 * width, zorder=5)
        axes.plot(*camera(beam[1, shown]).T, 'o', color=BEAM, markersize=3.6 * width, zorder=6)
    _base_unit(axes, camera, scene)
    draw_box(axes, camera, scene.tool, scene.volume, width, behind=False)
    if large:
        _legend(axes, scene)
    axes.set_aspect('equal', adjustable='datalim')
    axes.margins(0.03)
    axes.set_axis_off()


def _base_unit(axes: Axes, camera: Camera, scene: SetupScene) -> None:
    """A box behind the beams' start; only the faces turned to the eye."""
    starts = [line[0, 0] for line in scene.beams] + ([] if scene.psd is None else [scene.psd[0, 0]])
    local = (np.array(starts) - scene.origin) @ scene.triad.T
    size = 0.016 * np.linalg.norm(scene.volume)
    low, high = local.min(0) - [size, size, 3.0 * size], local.max(0) + [size, size, 0.0]
    for axis, end in product(range(3), (0, 1)):
        normal = scene.triad[axis] * (1 if end else -1)
        if normal @ camera.eye <= 0.0:
            continue
        p, q = (axis + 1) % 3, (axis + 2) % 3
        face = np.empty((4, 3))
        face[:, axis] = (low, high)[end][axis]
        face[:, p], face[:, q] = np.array([low, high, high, low])[:, p], np.array([low, low, high, high])[:, q]
        shade = 0.45 + 0.3 * float(normal @ camera.eye)
        axes.add_patch(Polygon(camera(face @ scene.triad + scene.origin), facecolor=(shade * 0.8, shade * 0.9, shade),
                               edgecolor=INK, linewidth=0.7, zorder=4.5))


def _legend(axes: Axes, scene: SetupScene) -> None:
    handles = [Line2D([], [], color=AXIS_COLOURS[n], linewidth=2, label=f'step of {"XYZ"[n]}')
               for n in AXIS_COLOURS if np.any(scene.axis == n)]
    handles += [Patch(facecolor=MIRROR_FILL, edgecolor=MIRROR, label='mirror at some of the stops'),
                Line2D([], [], color=BEAM, marker='o', markersize=4, label='interferometer beam and strikes')]
    if scene.psd is not None:
        handles.append(Line2D([], [], color=PSD, marker='o', markersize=4, label='PSD beam, out and back'))
    # A vertical beam has its base unit in the left corner.
    corner = 'lower right' if abs(scene.triad[2, 2]) > 0.9 else 'lower left'
    axes.legend(handles=handles, loc=corner, frameon=False, fontsize=9, labelcolor=INK)


def _mirror_view(axes: Axes, scene: SetupScene) -> None:
    """Where the beams strike the mirror, seen along the beam."""
    centre, half = scene.mirror_half
    low = (centre - half) * 1e3
    axes.add_patch(Rectangle(tuple(low), *(2e3 * half), facecolor=MIRROR, alpha=0.10,
                                                edgecolor=MIRROR, linewidth=1))
    lines = [(beam, BEAM) for beam in scene.beams] + ([] if scene.psd is None else [(scene.psd, PSD)])
    for line, colour in lines:
        met = scene.on_mirror(line[1]) * 1e3
        axes.plot(*met.T, color=colour, linewidth=0.7, alpha=0.6)
        axes.plot(*met.T, 'o', color=colour, markersize=3)
    axes.plot(0.0, 0.0, '+', color=INK, markersize=9)
    axes.annotate('reference point', (0.0, 0.0), (4, 5), textcoords='offset points', fontsize=8, color=INK)
    axes.set_title('strikes on the mirror', fontsize=10, color=INK, loc='left')
    _tidy(axes, 'u / mm', 'v / mm')


def _spot_view(axes: Axes, scene: SetupScene) -> None:
    """Where the PSD's beam comes back."""
    assert scene.psd is not None
    spot = (scene.psd[2] - scene.psd[0]) @ scene.triad[:2].T * 1e6
    axes.plot(*spot.T, color=PSD, linewidth=0.7, alpha=0.6)
    axes.scatter(*spot.T, c=np.arange(len(spot)), cmap='YlOrBr', edgecolor=PSD, linewidth=0.4, s=16, zorder=3)
    axes.annotate('first stop', spot[0], (5, 5), textcoords='offset points', fontsize=8, color=INK)
    axes.set_title('return spot on the PSD', fontsize=10, color=INK, loc='left')
    _tidy(axes, 'u / µm', 'v / µm')


def _tidy(axes: Axes, x: str, y: str) -> None:
    axes.set_aspect('equal', adjustable='datalim')
    axes.margins(0.12)
    axes.set_xlabel(x, fontsize=9, color=INK)
    axes.set_ylabel(y, fontsize=9, color=INK)
    axes.tick_params(labelsize=8, colors=FAINT)
    axes.grid(alpha=0.25)
    for side in axes.spines.values():
        side.set_color(BOX)
