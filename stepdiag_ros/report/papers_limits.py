"""Where the published methods fail: one short page a case, each with the failure computed on a known machine."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stepdiag_ros.estimate import face_diagonal, squareness_diagonals, step_diagonal
from stepdiag_ros.estimate.body_diagonal import worst_deviation
from stepdiag_ros.estimate.readings import CellReadings, face_sight, simulate
from stepdiag_ros.estimate.stepwise import increments
from stepdiag_ros.model.description import DIAGONALS, Machine
from stepdiag_ros.model.machine import CURVES, SQUARENESS, Curve, GeometricErrors
from stepdiag_ros.model.sensor import Misalignment
from stepdiag_ros.report.papers_common import CONVENTIONAL, ENHANCED, TRUE, save, slopes, step_sights, table, traced
from stepdiag_ros.report.papers_renishaw import CUBE, ed

PLATE = Machine('plate', 'FXYZ', (0.5, 0.5, 0.5), (0.0, 0.0, 0.0))
BLOCKS = 5
PLATES_UM = ((5.0, 5.0), (10.0, 0.0), (0.0, 10.0), (20.0, -10.0))
"""Positioning errors of X and Y at 500 mm [µm]: machines of one diagonal."""
EQUAL_SUMS = ((100e-6 / 3,) * 3, (0.0, 0.0, 100e-6), (100e-6, -50e-6, 50e-6))
"""Slopes of X, Y, Z [m/m] of three machines of one sum; the second is machine C."""
BOX = Machine('box', 'FXYZ', (0.8, 0.6, 0.5), (0.0, 0.0, 0.0))
SHEARED = ((20e-6, 0.0, 0.0), (20e-6, -40e-6, 0.0), (20e-6, -40e-6, -20e-6 * 0.6 / 0.8))
"""Squareness EC0Y, yaw of X at its end [rad] and slope of EXX [m/m]: the yaw undoes what the squareness does to
crossing diagonals, the slope what both do to all."""
YAWS = (0.0, 5e-6, 10e-6, 20e-6, 40e-6)
"""Yaw of X [rad] over its travel."""


def plate(x_um: float, y_um: float, angles: tuple[float, float]) -> CellReadings:
    """Both face diagonals of a plate, the mirrors turned in the plane by ``angles`` [rad] (pp, np)."""
    sights = [face_sight(PLATE, 'xy', sign, BLOCKS, 0.1) for sign in 'pn']
    mirrors = {sight.name: Misalignment(mirror=tuple(angle * (sight.triad[:2] @ [0.0, 0.0, 1.0])))
               for sight, angle in zip(sights, angles, strict=True)}
    return simulate(PLATE, BLOCKS, sights, slopes(PLATE, x_um * 2e-6, y_um * 2e-6), mirrors, traced)


def step_difference(cell: CellReadings) -> np.ndarray:
    """R_x − R_y, summed over all blocks, of each setup (2,) [m]."""
    sums = [np.abs(increments(setup.sight, setup.displacement_m, BLOCKS)[:2, :, 0].sum(axis=1))
            for setup in cell.setups.values()]
    return np.array([x - y for x, y in sums])


def squared_mirror(x_um: float, y_um: float) -> tuple[float, float]:
    """Turns of both mirrors that make the two ends of the cross diagonal read alike."""
    trial = 1e-5
    at_zero = step_difference(plate(x_um, y_um, (0.0, 0.0)))
    slope = (step_difference(plate(x_um, y_um, (trial, trial))) - at_zero) / trial
    angle = -at_zero / slope
    for _ in range(2):
        angle = angle - step_difference(plate(x_um, y_um, tuple(angle))) / slope
    return float(angle[0]), float(angle[1])


def mirror_rows() -> list[tuple[float, ...]]:
    """EXX and EYY at the end put in, found with an aligned and with a squared mirror, and
    R_x − R_y of the squared one [µm]."""
    rows = []
    for x, y in PLATES_UM:
        squared = plate(x, y, squared_mirror(x, y))
        ends = [found.curve(name)[1][-1] * 1e6
                for found in (face_diagonal.evaluate(plate(x, y, (0.0, 0.0)), 'xy'),
                              face_diagonal.evaluate(squared, 'xy')) for name in ('EXX', 'EYY')]
        rows.append((x, y, *ends, float(np.max(np.abs(step_difference(squared)))) * 1e6))
    return rows


def mirror_page(out: Path) -> str:
    rows = mirror_rows()
    figure, axes = _panel()
    rows.sort(key=lambda row: row[0] - row[1])
    put = [x - y for x, y, *_ in rows]
    axes.plot(put, put, '--', color=TRUE, label='put in')
    axes.plot(put, [row[2] - row[3] for row in rows], 's', color=ENHANCED, label='mirror square to the laser')
    axes.plot(put, [row[4] - row[5] for row in rows], 'o', color=CONVENTIONAL, label='mirror squared to the diagonal')
    _finish(axes, 'EXX − EYY at the end, put in [µm]', 'found [µm]')
    return _page(
        'Mirror squared to the diagonal: R_x = R_y',
        'Source: Ibaraki, Goto, Matsubara 2006, on the alignment of the mirror. A mirror is set so that both ends of '
        'the cross diagonal read alike. On a square face every X step then reads what the Y step reads, whatever the '
        'machine does; the step diagonal is a plain diagonal.',
        ('EXX, EYY put in [µm]', 'found, mirror square to the laser', 'found, mirror squared to the diagonal',
         'R_x − R_y, squared [µm]'),
        [(f'{x:.1f}, {y:.1f}', f'{a:.2f}, {b:.2f}'.replace('-0.00', '0.00'), f'{c:.2f}, {d:.2f}', f'{abs(r):.4f}')
         for x, y, a, b, c, d, r in rows],
        save(figure, out, 'mirror_squared.png'),
        'The conventional evaluation finds the mean of both axes for all four machines. The new formulation takes EXX '
        'and EYY from linear runs instead. `stepdiag evaluate` and `stepdiag compare` warn where two axes with equal '
        'steps read alike in every diagonal.')


def equal_rows() -> list[tuple[float, ...]]:
    """Slopes of X, Y, Z put in and found with slopes removed [µm/m], Ed and volumetric error [µm]."""
    rows = []
    for given in EQUAL_SUMS:
        errors = slopes(CUBE, *given)
        cell = simulate(CUBE, 10, step_sights(CUBE, 10, DIAGONALS), errors, measure=traced)
        found = step_diagonal.evaluate(cell, slopes='removed')
        rows.append((*(1e6 * s for s in given), *(found.curve(n)[1][-1] * 1e6 for n in ('EXX', 'EYY', 'EZZ')),
                     1e6 * ed(CUBE, errors), 1e6 * worst_deviation(errors, CUBE)))
    return rows


def sheared_rows() -> list[tuple[float, ...]]:
    """EC0Y, yaw of X [µrad] and slope of EXX put in [µm/m]; largest change of a diagonal's length [µm], EC0Y found
    [µrad] and volumetric error [µm]."""
    rows = []
    for square, yaw, slope in SHEARED:
        errors = GeometricErrors({'ECX': Curve(np.array([0.0, 0.8]), np.array([0.0, yaw])),
                                  'EXX': Curve(np.array([0.0, 0.8]), np.array([0.0, 0.8 * slope]))}, {'EC0Y': square})
        cell = simulate(BOX, 8, step_sights(BOX, 8, DIAGONALS), errors, measure=traced)
        longer = {name: float(setup.displacement_m[-1, 0]) - float(np.linalg.norm(BOX.volume))
                  for name, setup in cell.setups.items()}
        found = squareness_diagonals.body_squareness(BOX, longer).squareness('EC0Y')[0]
        rows.append((1e6 * square, 1e6 * yaw, 1e6 * slope, 1e6 * max(abs(v) for v in longer.values()), 1e6 * found,
                     1e6 * worst_deviation(errors, BOX)))
    return rows


def equal_page(out: Path) -> str:
    rows = equal_rows()
    figure = Figure(figsize=(9.5, 3.6), layout='constrained')
    for axes, row in zip(figure.subplots(1, 3, sharey=True), rows, strict=True):
        axes.bar(np.arange(3) - 0.2, row[:3], 0.38, color=TRUE, label='put in')
        axes.bar(np.arange(3) + 0.2, row[3:6], 0.38, color=CONVENTIONAL, label='found, slopes removed')
        axes.set_xticks(range(3), ['EXX', 'EYY', 'EZZ'])
        _finish(axes, f'Ed {row[6]:.1f} µm, volume {row[7]:.0f} µm', 'slope [µm/m]')
    return _page(
        'What body diagonals cannot see: machine C',
        'Source: Renishaw 2016, machine C. In a cube the four body diagonals know the sum of the slopes of X, Y and '
        'Z, not their shares: three machines with the same four diagonals.',
        ('EXX, EYY, EZZ put in [µm/m]', 'found, slopes ascribed to the mirror', 'Ed [µm]', 'volumetric error [µm]'),
        [(', '.join(f'{v:.1f}' for v in row[:3]), ', '.join(f'{v:.1f}' for v in row[3:6]), f'{row[6]:.1f}',
          f'{row[7]:.1f}') for row in rows],
        save(figure, out, 'machine_c.png'),
        'The errors cancel or share themselves out along every diagonal; a compensation by the found slopes makes the '
        'second and third machine worse along an axis. Linear setups tell the axes apart; `stepdiag compare` and '
        '`stepdiag evaluate --method` warn where a log has none.\n\n## Squareness that they cannot see\n\nA yaw that '
        'grows along X shears a face as squareness does. On a machine of 800 × 600 × 500 mm one can undo the other, '
        'and a linear error what is left in the lengths:\n\n' + table(
            ('EC0Y put in [µrad]', 'yaw of X at its end [µrad]', 'slope of EXX [µm/m]',
             'largest change of a diagonal [µm]', 'EC0Y found [µrad]', 'volumetric error [µm]'),
            [(f'{a:.0f}', f'{b:.0f}', f'{c:.1f}', f'{d:.2f}', f'{e:.2f}'.replace('-0.00', '0.00'), f'{f:.1f}')
             for a, b, c, d, e, f in sheared_rows()])
        + '\nThe ends of the third machine\'s diagonals say that nothing is wrong. Tilts show the yaw; the commands '
        'warn where the angles of a log change the squareness that its diagonals give.')


def angle_rows() -> list[tuple[float, ...]]:
    """Yaw of X [µrad], largest error of translation curves and squareness without and with known angles [µm, µrad]."""
    rows = []
    for yaw in YAWS:
        errors = GeometricErrors({'ECX': Curve(np.linspace(0.0, 0.8, 3), yaw * np.array([0.0, 0.25, 1.0]))}, {})
        cell = simulate(BOX, 8, step_sights(BOX, 8, DIAGONALS), errors, measure=traced)
        found = [step_diagonal.evaluate(cell, angles=angles) for angles in (None, errors)]
        # The machine has no translation errors: what is found is error.
        rows.append((1e6 * yaw, *(max(1e6 * float(np.abs(one.curve(n)[1]).max()) for n in CURVES if one.has(n))
                                  for one in found),
                     1e6 * max(abs(found[0].squareness(n)[0]) for n in SQUARENESS)))
    return rows


def angle_page(out: Path) -> str:
    rows = angle_rows()
    figure, axes = _panel()
    for column, colour, words in ((1, CONVENTIONAL, 'angles taken for zero'), (2, ENHANCED, 'angles known')):
        axes.plot([row[0] for row in rows], [row[column] for row in rows], 'o-', color=colour, label=words)
    _finish(axes, 'yaw of X at the end of its travel [µrad]', 'largest error of a found curve [µm]')
    return _page(
        'Angular errors in a step diagonal',
        'Source: Wang & Liotto 2003 against the exact model; the criticism is that of Soons and Chapman. The '
        'sequential step diagonal takes angular motions for zero. On a machine of 800 × 600 × 500 mm whose only error '
        'is a yaw of X, what the vector method finds is all error:',
        ('yaw of X at the end [µrad]', 'largest error, angles taken for zero [µm]', 'largest error, angles known [µm]',
         'squareness found, none is there [µrad]'),
        [(f'{a:.0f}', f'{b:.2f}', f'{c:.2f}', f'{d:.2f}') for a, b, c, d in rows],
        save(figure, out, 'angles_in_a_step_diagonal.png'),
        'A detector beside the interferometer measures the angles, and the enhanced method uses them. `stepdiag '
        'compare` says by how much the angles of a log move the readings that the vector method takes for '
        'translations.')


def _page(title: str, text: str, heads: tuple[str, ...], rows: list[tuple[str, ...]], picture: str, end: str) -> str:
    return f'# {title}\n\n{text}\n\n{table(heads, rows)}\n{picture}\n{end}\n'


def _panel() -> tuple[Figure, Axes]:
    figure = Figure(figsize=(8.0, 4.2), layout='constrained')
    return figure, figure.subplots()


def _finish(axes: Axes, across: str, up: str) -> None:
    axes.set_xlabel(across)
    axes.set_ylabel(up)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
