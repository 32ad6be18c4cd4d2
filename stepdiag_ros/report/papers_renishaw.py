"""Renishaw 2016, laser diagonal measurements: the worked numbers and the plots of figs. 9–15."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from stepdiag_ros.estimate.body_diagonal import (
    deviations_of,
    diagonal_length,
    evaluate_runs,
    worst_deviation,
)
from stepdiag_ros.estimate.readings import face_sight, simulate
from stepdiag_ros.estimate.squareness_diagonals import face_squareness
from stepdiag_ros.estimate.step_diagonal import evaluate as evaluate_vector
from stepdiag_ros.estimate.stepwise import increments
from stepdiag_ros.model.description import DIAGONALS, Machine
from stepdiag_ros.model.machine import Curve, GeometricErrors, tool_pose
from stepdiag_ros.model.sensor import Misalignment
from stepdiag_ros.report.papers_common import GREEN, RED, save, slopes, step_sights, table, traced

CUBE = Machine('cube', 'FXYZ', (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
SIZE = 10e-6
"""All simulated errors of the figures: 10 µm over a metre."""


@dataclass(frozen=True)
class Plot:
    """One of the published plots: number, caption, the machine's errors in the XY plane and its chain."""

    number: int
    caption: str
    errors: GeometricErrors
    chain: str = 'FXYZ'
    noise: float = 0.0


def _curve(place: np.ndarray, value: np.ndarray) -> Curve:
    return Curve(place, value)


def plots() -> list[Plot]:
    """The seven machines, 1 m by 1 m."""
    s = np.linspace(0.0, 1.0, 81)
    bow, slope = 4.0 * SIZE * s * (1.0 - s), 4.0 * SIZE * (1.0 - 2.0 * s)
    line = SIZE * s
    # A yaw whose linear motion was set right along the middle of the volume.
    x_bow = {'EYX': _curve(s, bow)}
    x_yaw = {'ECX': _curve(s, slope), 'EXX': _curve(s, 0.5 * slope)}
    y_bow = {'EXY': _curve(s, bow), 'ECY': _curve(s, -slope), 'EYY': _curve(s, 0.5 * slope)}
    square = {'EC0Y': -SIZE}
    return [
        Plot(9, 'perfect machine (a little noise)', GeometricErrors.zero(), noise=0.15e-6),
        Plot(10, 'squareness, 10 µm/m', GeometricErrors({}, square)),
        Plot(11, 'linear error of X, +10 µm/m', GeometricErrors({'EXX': _curve(s, line)}, {})),
        Plot(12, 'straightness of X, 10 µm', GeometricErrors(x_bow, {})),
        Plot(13, 'straightness of X with its yaw', GeometricErrors(x_bow | x_yaw, {})),
        Plot(14, 'straightness of Y with its yaw', GeometricErrors(y_bow, {}), 'FYXZ'),
        Plot(15, 'squareness, straightness, angles', GeometricErrors(
            {'EYX': _curve(s, 0.7 * bow), 'ECX': _curve(s, 0.7 * slope),
             'EXX': _curve(s, 0.35 * slope + 0.5 * line), 'EXY': _curve(s, 0.4 * np.sin(7.0 * s) * SIZE)},
            {'EC0Y': -0.6 * SIZE})),
    ]


def traces(plot: Plot, targets: int = 41) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position along a diagonal (n,) and the deviations of green (from the origin) and red (n,) [m]."""
    part = np.linspace(0.0, 1.0, targets)
    rng = np.random.default_rng(plot.number)
    found = []
    for start, step in (((0.0, 0.0), (1.0, 1.0)), ((1.0, 0.0), (-1.0, 1.0))):
        place = np.zeros((targets, 3))
        place[:, :2] = start + part[:, None] * step
        point, _ = tool_pose(plot.errors, place, np.zeros(3), plot.chain)
        deviation = (point - place)[:, :2] @ np.array(step) / np.sqrt(2.0)
        found.append(deviation - deviation[0] + plot.noise * rng.standard_normal(targets))
    return part * np.sqrt(2.0), found[0], found[1]


def draw_plots(out: Path) -> str:
    figure = Figure(figsize=(15, 10.5), layout='constrained')
    axes = figure.subplots(4, 4)
    for place, plot in enumerate(plots()):
        left, right = axes[place // 2, 2 * (place % 2):2 * (place % 2) + 2]
        _draw_machine(left, plot)
        along, green, red = traces(plot)
        right.plot(along, green * 1e6, color=GREEN, label='from (0, 0)')
        right.plot(along, red * 1e6, color=RED, linestyle='--', label='from (X, 0)')
        right.set_ylim(-13, 13)
        right.axhline(0.0, color='0.7', linewidth=0.8)
        right.set_xlabel('along the diagonal [m]', fontsize=8)
        right.set_ylabel('deviation [µm]', fontsize=8)
        right.tick_params(labelsize=8)
        left.set_title(f'Fig. {plot.number}: {plot.caption}', fontsize=9, loc='left')
    axes[0, 1].legend(fontsize=8)
    for spare in axes[3, 2:]:
        spare.axis('off')
    return save(figure, out, 'renishaw_figures_9_to_15.png')


def _draw_machine(axes, plot: Plot) -> None:
    """The machine's grid, errors ten thousand times enlarged, with the diagonals measured."""
    enlarge, line = 1e4, np.linspace(0.0, 1.0, 41)
    for fixed in np.linspace(0.0, 1.0, 6):
        for swap in (False, True):
            place = np.zeros((41, 3))
            place[:, 0], place[:, 1] = (fixed, line) if swap else (line, fixed)
            point, _ = tool_pose(plot.errors, place, np.zeros(3), plot.chain)
            bent = place + enlarge * (point - place)
            axes.plot(bent[:, 0], bent[:, 1], color='#1b6ca8', linewidth=0.9)
            axes.plot(place[:, 0], place[:, 1], color='0.75', linewidth=0.5, linestyle=':')
    axes.annotate('', (1, 1), (0, 0), arrowprops={'arrowstyle': '->', 'color': GREEN})
    axes.annotate('', (0, 1), (1, 0), arrowprops={'arrowstyle': '->', 'color': RED})
    axes.set_aspect('equal')
    axes.set_xlim(-0.25, 1.25)
    axes.set_ylim(-0.25, 1.25)
    axes.axis('off')


def worked_numbers() -> list[tuple[str, str, float, str]]:
    """(what, published, computed, format) of every number in the text."""
    long = Machine('m', 'FXYZ', (2.0, 1.0, 0.5), (0.0, 0.0, 0.0))
    crossed = slopes(long, 25e-6, -100e-6)
    rows = [('diagonal of 2 × 1 × 0.5 m [m]', '2.291288',
             diagonal_length(GeometricErrors.zero(), long, 'ppp'), '.6f'),
            ('its change with X +25, Y −100 µm/m [µm]', '< 0.1',
             1e6 * (diagonal_length(crossed, long, 'ppp')
                    - diagonal_length(GeometricErrors.zero(), long, 'ppp')), '.4f'),
            ('volumetric error of that machine [µm]', 'over 100', 1e6 * worst_deviation(crossed, long), '.1f')]
    for name, slope, diagonal_um, volumetric in (('A', (50e-6, 0.0, 0.0), '28.9', '50'),
                                                 ('B', (100e-6, -50e-6, -25e-6), '14.4', '115')):
        errors = slopes(CUBE, *slope)
        rows.append((f'machine {name}: diagonal test Ed [µm]', diagonal_um, 1e6 * ed(CUBE, errors), '.1f'))
        rows.append((f'machine {name}: volumetric error [µm]', volumetric,
                     1e6 * worst_deviation(errors, CUBE), '.1f'))
    _, green, red = traces(plots()[1])
    rows.append(('fig. 10: squareness from its diagonals [µrad]', '10',
                 1e6 * float(face_squareness(1.0, 1.0, green[-1], red[-1])), '.3f'))
    long_c = slopes(CUBE, 0.0, 0.0, 100e-6)
    rows.append(('machine C: diagonals [m]', '1.732109', diagonal_length(long_c, CUBE, 'ppp'), '.6f'))
    cell = simulate(CUBE, 20, step_sights(CUBE, 20, DIAGONALS), long_c, measure=traced)
    removed = evaluate_vector(cell, slopes='removed')
    for name in ('EXX', 'EYY', 'EZZ'):
        rows.append((f'machine C: {name} found, slopes removed [µm/m]', '33.3',
                     1e6 * removed.curve(name)[1][-1], '.1f'))
        rows.append((f'machine C: {name} left after that compensation [µm/m]',
                     '66.7' if name == 'EZZ' else '−33.3',
                     1e6 * ((100e-6 if name == 'EZZ' else 0.0) - removed.curve(name)[1][-1]), '.1f'))
    step = mirror_steps()
    rows += [('mirror 0.2 mm/m, 50 mm steps: X step [µm]', '7', 1e6 * step[0], '.2f'),
             ('the Z step of the same [µm]', '−7', 1e6 * step[1], '.2f'),
             ('accumulated over a metre of X [µm]', '140', 20e6 * step[0], '.1f')]
    return rows


def ed(machine: Machine, errors: GeometricErrors) -> float:
    """Diagonal systematic deviation Ed [m] of a known machine."""
    return evaluate_runs({n: (*deviations_of(errors, machine, n, 11), None) for n in DIAGONALS}).Ed


def mirror_steps() -> np.ndarray:
    """Extra reading of an X and a Z step on the 1:1 face, mirror at 0.2 mm/m, (2,) [m]; traced."""
    sight = face_sight(CUBE, 'xz', 'p', 20, standoff=0.1)
    about_y = float(sight.triad[0] @ [0.0, 1.0, 0.0])
    cell = simulate(CUBE, 20, [sight], GeometricErrors.zero(),
                    {sight.name: Misalignment(mirror=(0.2e-3 * about_y, 0.0))}, traced)
    steps = increments(sight, cell.setups[sight.name].displacement_m, 20)[[0, 2], 0, 0]
    return steps - 0.05 / np.sqrt(2.0)


def page(out: Path) -> str:
    rows = [(what, published, format(value, form)) for what, published, value, form in worked_numbers()]
    return ('# Renishaw 2016: laser diagonal measurements\n\n'
            'Source: Renishaw, *Laser diagonal measurements for machine tool performance assessment*, '
            'H-5650-2053-01, after Chapman 2003. Methods: `body_diagonal`, `squareness_diagonals`, '
            '`step_diagonal`.\n\n## Worked numbers\n\n'
            + table(('what', 'published', 'here'), rows)
            + '\nAll are reached. The step diagonals of machine C and the misaligned mirror go through '
              'the traced scene, the lengths through the exact chain. Machine C\'s 33.3 µm/m belong to the '
              'practice of ascribing every slope to the mirror (`slopes=\'removed\'`); the plain vector '
              'method with a perfect mirror gives 100 µm/m to Z.\n\n## Figures 9 to 15\n\n'
            + draw_plots(out)
            + '\nLeft the machine (errors 10⁴ times enlarged), right the deviations along its two diagonals. '
              'The published pictures are lost; shapes and captions follow the text:\n\n'
              '- 10: the diagonal that is stretched rises, the other falls alike. 11: both rise alike.\n'
              '- 12: both are bowed; the direction depends on the direction of measurement.\n'
              '- 13: with the yaw that belongs to the bow, both are inverted. This needs the yaw\'s arm '
              'counted from the middle of the volume, as in the text\'s machine "adjusted with a laser through '
              'the centre": with an arm from y = 0 there would be a slope as well. The ends agree: the overall '
              'length does not show the yaw (the text\'s fig. 4).\n'
              '- 14: with the red diagonal measured the other way round it would be 13. Only a chain in which Y '
              'carries X (here FYXZ) gives a yaw of Y an arm in the plane; on FXYZ it has none.\n'
              '- 15: the text gives no amounts; one mixture of many.\n')
