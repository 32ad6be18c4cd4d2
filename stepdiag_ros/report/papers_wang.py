"""Wang & Liotto 2003: the equations of body diagonals, step diagonals and lines against the exact model."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from stepdiag_ros.estimate import face_diagonal, linear_lines, step_diagonal
from stepdiag_ros.estimate.body_diagonal import deviations_of
from stepdiag_ros.estimate.gauge import to_reference_lines
from stepdiag_ros.estimate.readings import ALIGNED, Sight, face_sight, simulate
from stepdiag_ros.model.description import DIAGONALS, Machine
from stepdiag_ros.model.machine import CURVES, Curve, GeometricErrors, tool_pose
from stepdiag_ros.report.papers_common import (
    CONVENTIONAL,
    ENHANCED,
    TRUE,
    drawn_machine,
    save,
    small,
    step_sights,
    table,
    traced,
)

BOX = Machine('box', 'FXYZ', (0.8, 0.6, 0.5), (0.0, 0.0, 0.0))
STEPS = 5
RATE = 20e-6
"""Pitch and yaw of X of the example [rad/m]."""


def example() -> GeometricErrors:
    """Pitch EBX and yaw ECX of X, both growing evenly."""
    place = np.array([0.0, 0.8])
    return GeometricErrors({'EBX': Curve(place, RATE * place), 'ECX': Curve(place, -RATE * place)}, {})


def printed_body(x: np.ndarray) -> np.ndarray:
    """Angular terms of eq. 1 along ppp for :func:`example`: Ay·ac/r − Az·ab/r with the travels for a, b, c."""
    part = x / BOX.volume[0]
    d = np.array(BOX.volume) / np.linalg.norm(BOX.volume)
    return RATE * x * (part * BOX.volume[2] * d[0] + part * BOX.volume[1] * d[0])


def printed_steps() -> np.ndarray:
    """Angular terms of eqs. 5–7, added up over the stops of ppp (3 STEPS + 1,)."""
    a, b, c = np.array(BOX.volume) / STEPS
    factor = np.sqrt((4 * a * a + b * b + c * c) / (b * b + c * c))
    total = [0.0]
    for k in range(1, STEPS + 1):
        angle = RATE * a * k
        term = factor * (c * angle + b * angle)
        total += [total[-1] + term, total[-1] + term, total[-1]]
    return np.array(total)


def exact_steps() -> np.ndarray:
    """What the angles of :func:`example` do to the readings of ppp, traced (3 STEPS + 1,) [m]."""
    sight = step_sights(BOX, STEPS, ['ppp'])
    bent, straight = (simulate(BOX, STEPS, sight, e, measure=traced).setups['ppp'].displacement_m[:, 0]
                      for e in (example(), GeometricErrors.zero()))
    return bent - straight


def draw_angles(out: Path) -> str:
    figure = Figure(figsize=(9.5, 4.6), layout='constrained')
    axes = figure.subplots()
    stop = np.arange(3 * STEPS + 1)
    axes.plot(stop, exact_steps() * 1e6, 'o-', color=TRUE, label='flat mirror, traced')
    _, deviation = deviations_of(example(), BOX, 'ppp', STEPS + 1)
    axes.plot(stop[::3], deviation * 1e6, 'x', color='#1b6ca8', markersize=9,
              label='retroreflector, exact chain')
    axes.plot(stop[::3], printed_body(np.linspace(0, 0.8, STEPS + 1)) * 1e6, 's', mfc='none',
              color=ENHANCED, markersize=11, label='eq. 1')
    axes.plot(stop, printed_steps() * 1e6, '^--', color=CONVENTIONAL, label='eqs. 5–7, added up')
    axes.set_xlabel('stop along ppp (X, Y, Z, X, …)')
    axes.set_ylabel('change of the reading [µm]')
    axes.set_title('Pitch and yaw of X, ±20 µrad/m, on a step diagonal of 0.8 × 0.6 × 0.5 m', fontsize=10)
    axes.legend(fontsize=9)
    axes.grid(alpha=0.3)
    return save(figure, out, 'wang_liotto_angular_terms.png')


def worst(solution, errors: GeometricErrors) -> float:
    """Largest deviation of a solution's curves and squareness from a known machine [m, rad]."""
    true = to_reference_lines(errors)
    off = [np.abs(solution.curve(n)[1] - true.curves[n](solution.curve(n)[0])).max()
           for n in CURVES if solution.has(n)]
    off += [abs(solution.squareness(n)[0] - v) for n, v in true.square.items() if solution.has(n)]
    return float(max(off))


def exactness() -> list[tuple[str, ...]]:
    """Each method on its own assumptions and off them, through the traced scene."""
    straight, bent = drawn_machine(BOX, 10, angles=False), drawn_machine(BOX, 10)
    angles = GeometricErrors({n: c for n, c in bent.curves.items() if n[1] in 'ABC'}, {})
    rows = []
    sights = step_sights(BOX, 10, list(DIAGONALS))

    def body(errors: GeometricErrors, **more) -> float:
        return worst(step_diagonal.evaluate(simulate(BOX, 10, sights, errors, measure=traced), **more), errors)

    rows.append(('sequential step diagonal, eqs. 5–16', small(body(straight), 'm'), small(body(bent), 'm'),
                 small(body(bent, angles=angles), 'm')))
    faces = [face_sight(BOX, 'xy', s, 10, 0.2) for s in 'pn']

    def face(errors: GeometricErrors, **more) -> float:
        cell = simulate(BOX, 10, faces, errors, measure=traced)
        return worst(face_diagonal.evaluate(cell, 'xy', **more), errors)

    rows.append(('step face diagonals, eqs. 19–22', small(face(straight), 'm'), small(face(bent), 'm'),
                 small(face(bent, angles=angles), 'm')))
    rows.append(('three lines of X, eq. 23', small(three_lines(straight), 'm, rad'),
                 small(three_lines(bent), 'm, rad'), '–'))
    return rows


def three_lines(errors: GeometricErrors) -> float:
    """Largest deviation of EXX, EBX, ECX from three lines along the edges (0,0), (Y,0), (0,Z); traced."""
    place, arms, deviation = np.linspace(0.0, BOX.volume[0], 11), [], []
    for y, z in ((0.0, 0.0), (BOX.volume[1], 0.0), (0.0, BOX.volume[2])):
        positions = np.stack([place, np.full(11, y), np.full(11, z)], axis=1)
        sight = Sight('lin_x', np.array([1.0, 0.0, 0.0]), positions, np.zeros(11, int), 0.1)
        point, attitude = tool_pose(errors, positions, BOX.tool)
        from_beam = traced(sight, BOX, ALIGNED, point, attitude)[0][:, 0]
        deviation.append(from_beam - from_beam[0] - place)
        arms.append((0.0, y, z))
    found = linear_lines.evaluate({'X': linear_lines.Lines(place, np.array(arms), np.array(deviation))})
    zero = Curve(np.zeros(1), np.zeros(1))
    return float(max(np.abs(found.curve(n)[1] - errors.curves.get(n, zero)(place)).max()
                     for n in ('EXX', 'EBX', 'ECX')))


def printed_lines() -> list[tuple[str, str, str]]:
    """The closed solution of section 6 as printed: what goes in, what comes out [µm, µrad]."""
    m, p = np.array([0.0, 0.5, 0.1]), np.array([0.1, 0.0, 0.6])
    true = np.array([4e-6, 10e-6, -20e-6])
    out = linear_lines.printed_solution(true[0] + m * true[1] + p * true[2], m, p)
    return [(name, f'{a * 1e6:.1f}', f'{b * 1e6:.1f}')
            for name, a, b in zip(('Dx(x)', 'Ay(x)', 'Az(x)'), true, out, strict=True)]


def page(out: Path) -> str:
    return ('# Wang & Liotto 2003: body diagonals, sequential step diagonal, lines\n\n'
            'Source: *A theoretical analysis of 4 body diagonal displacement measurement and sequential step '
            'diagonal measurement*. Methods: `body_diagonal`, `step_diagonal`, `face_diagonal`, '
            '`linear_lines`.\n\n## Exact on their own assumptions\n\n'
            'Largest deviation from a machine with drawn errors of some micrometres and, in the third column, '
            'angular motions of some microradians; readings from the traced scene.\n\n'
            + table(('method', 'no angular motions', 'with angular motions', 'angles known'), exactness())
            + '\nThe paper has no numerical example. What is left with known angles, and of three lines with '
              'angles, is of second order (micrometre times microradian, angle times sideways motion).\n\n'
              '## The angular terms\n\n' + draw_angles(out)
            + '\nEq. 1 and the exact chain agree on ppp: pitch and yaw of X act through the arms y and z. For '
              'npp, pnp and ppn the paper counts the arms from each diagonal\'s own start; on one machine '
              'they are counted from the axes, which adds the terms of a constant arm (see '
              '[chains](../explanation/chains.md)). Eqs. 5–7 take in the Z step what the X step brought: added '
              'up over a step they give zero, in contradiction to eq. 1 and to the traced mirror, whose reading '
              'keeps `x (c·Ay − b·Az)/r`. The factors f, g, h of the paper are not found in the exact model. '
              'The estimators use the exact terms.\n\n'
              '## Three lines: the printed solution\n\n'
            + table(('', 'put in [µm, µrad]', 'returned as printed'), printed_lines())
            + '\nThe formula printed for `Ay` is that of `Az`, the one for `Az` gives `−Ay`, and `Dx` comes with '
              'the sign turned. Also, with the offsets m and p named as in the text ("in y and z") pitch would '
              'act over the sideways offset; it acts over the height, and yaw over the sideways offset with a minus '
              'sign. `linear_lines` solves the system itself.\n')
