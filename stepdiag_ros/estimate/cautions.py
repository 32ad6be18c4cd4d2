"""Whether a log is one of those on which methods of the literature are known to fail; a sentence each.

Four cases, each shown on a known machine in docs/papers: two axes with equal steps that read alike in every diagonal
(a mirror squared to the machine's diagonal does that), diagonals without linear setups (they do not tell the axes'
slopes apart), and angular motions, which the vector method takes for translations and lengths of diagonals for
squareness.  Diagonals are found by what they are, of the body or of faces, whatever the log calls them.

Source: Ibaraki, Goto, Matsubara 2006; Renishaw 2016; Wang & Liotto 2003.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from stepdiag_ros.estimate.of_ways import by_short_names, of_kind
from stepdiag_ros.estimate.readings import CellReadings
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.estimate.squareness_diagonals import body_squareness
from stepdiag_ros.estimate.step_diagonal import angular_effect
from stepdiag_ros.model.description import DIAGONALS
from stepdiag_ros.model.machine import AXES, CURVES, SQUARENESS, Curve, GeometricErrors

ALIKE = 1e-6
"""Steps of two axes that differ by a smaller share are equal."""
ANGLES = tuple(name for name in CURVES if name[1] in 'ABC')


def cautions(cell: CellReadings, solution: Solution | None) -> tuple[str, ...]:
    """What a reader of several methods' answers must know of this log; ``solution``: the enhanced method's."""
    body, face = _stepped(cell, 'body'), _stepped(cell, 'face')
    if not body and not face and not any(setup.sight.kind.endswith('diagonal') for setup in cell.setups.values()):
        return ()
    found = (*_alike(cell, body, 'diagonal', 'step_diagonal finds'),
             *_alike(cell, face, 'face diagonal', 'the methods of faces alone (face_diagonal_xy, …) find'),
             _without_lines(cell), _angles(cell, body + face, solution), _sheared(cell, solution))
    return tuple(text for text in found if text)


def _stepped(cell: CellReadings, space: str) -> list[str]:
    """Names of the step diagonals of the ``body`` or of faces, ``face``."""
    short = [name for name in DIAGONALS if name in cell.setups and space == 'body']
    return short + of_kind(cell, f'{space} step diagonal')


def _alike(cell: CellReadings, names: list[str], which: str, who: str) -> list[str]:
    """Pairs of axes that read the same in every diagonal that moves both by equal steps, within the noise."""
    found = []
    for i, j in ((0, 1), (0, 2), (1, 2)):
        apart, known = [0.0], [0.0]
        for name in names:
            setup = cell.setups[name]
            travel = np.abs(setup.sight.positions[-1] - setup.sight.positions[0])
            if not travel[i] or abs(travel[i] - travel[j]) > ALIKE * travel[i]:
                continue
            change, moved = np.diff(setup.displacement_m[:, 0]), setup.sight.axis[1:]
            apart.append(abs(abs(change[moved == i].sum()) - abs(change[moved == j].sum())))
            # Each sum is of as many differences of two readings as there are steps.
            known.append(2.0 * 2.0 * np.sqrt(np.sum(moved == i)) * float(setup.displacement_sigma_m.max()))
        if len(apart) > 1 and all(a <= u for a, u in zip(apart, known, strict=True)):
            found.append(
                f'{AXES[i]} and {AXES[j]} read alike in every {which} (largest difference {1e6 * max(apart):.3f} µm, '
                f'U {1e6 * max(known):.3f} µm, k = 2): either the two axes are alike and every mirror stood square '
                "to its laser, or the mirrors were squared to the machine's diagonal; then the steps tell no more than "
                f"the diagonals' lengths, and {who} the mean of both axes (docs/papers/mirror_squared.md)")
    return found


def _without_lines(cell: CellReadings) -> str:
    moved = [tuple(np.flatnonzero(np.ptp(s.sight.positions, axis=0))) for s in cell.setups.values()]
    missing = [letter for axis, letter in enumerate(AXES) if (axis,) not in moved]
    if not missing:
        return ''
    return (f'no linear setup of {", ".join(missing)}: diagonals do not tell the slopes of single axes apart where '
            'mirrors may be off; measure them by linear setups (docs/papers/machine_c.md)')


def _angles(cell: CellReadings, names: list[str], solution: Solution | None) -> str:
    """By how much the angles that were found move a reading that the vector method takes for translations."""
    if not names or solution is None or not all(solution.has(name) for name in ANGLES):
        return ''
    if all(cell.setups[name].spot_m is None and len(cell.setups[name].sight.beams) < 3 for name in names):
        return ('the log shows no angles (no spots, fewer than three beams): the vector method takes them for zero, '
                'and nothing here says whether they are (docs/papers/angles_in_a_step_diagonal.md)')
    angles = replace(solution.errors, curves={n: c for n, c in solution.errors.curves.items() if n in ANGLES},
                     square={})
    effects = {name: angular_effect(cell, name, angles)[:, 0] for name in names}
    name = max(names, key=lambda n: np.abs(effects[n]).max())
    stop = int(np.abs(effects[name]).argmax())
    size, expanded = float(effects[name][stop]), 2.0 * _sigma(cell, name, stop, solution)
    if abs(size) <= max(expanded, 2.0 * float(cell.setups[name].displacement_sigma_m.max())):
        return ''
    return (f'the angular motions found move the readings of the diagonals by up to {1e6 * abs(size):.3f} ± '
            f'{1e6 * expanded:.3f} µm (k = 2; {name}, stop {stop}): the vector method takes that for '
            'translations (docs/papers/angles_in_a_step_diagonal.md)')


def _sheared(cell: CellReadings, solution: Solution | None) -> str:
    """By how much the angles that were found change the squareness that the lengths of the four diagonals give."""
    cell = by_short_names(cell, straight=True)
    names = [name for name in DIAGONALS if name in cell.setups]
    if solution is None or len(names) < len(DIAGONALS) or not all(solution.has(name) for name in ANGLES):
        return ''
    angles = replace(solution.errors, curves={n: c for n, c in solution.errors.curves.items() if n in ANGLES},
                     square={})

    def squareness(errors: GeometricErrors) -> np.ndarray:
        return body_squareness(cell.machine, {n: float(angular_effect(cell, n, errors)[-1, 0]) for n in names}).value
    effect, rows, slopes = squareness(angles), *_alone(solution, squareness)
    variance = np.einsum('ik,kl,il->i', slopes, solution.covariance[np.ix_(rows, rows)], slopes)
    expanded = 2.0 * np.sqrt(np.maximum(variance, 0.0))
    most = int(np.argmax(np.abs(effect) - expanded))
    if abs(effect[most]) <= expanded[most]:
        return ''
    return (f'the angular motions found shear the volume as a squareness {SQUARENESS[most]} of '
            f'{1e6 * effect[most]:.3f} ± {1e6 * expanded[most]:.3f} µrad (k = 2) would: squareness_diagonals takes '
            'that for squareness, or does not see a squareness that it undoes (docs/papers/machine_c.md)')


def _alone(solution: Solution, of: Callable[[GeometricErrors], np.ndarray]) -> tuple[list[int], np.ndarray]:
    """Rows of the angles in a solution, and what ``of`` (p,) each changes per radian (p, rows)."""
    rows = [row for row, (curve, _) in enumerate(solution.names) if curve in ANGLES]
    step, slopes = 1e-6, []
    for row in rows:
        curve, knot = solution.names[row]
        place = np.asarray(solution.positions[curve])
        slopes.append(of(GeometricErrors({curve: Curve(place, step * (np.arange(len(place)) == knot))}, {})) / step)
    return rows, np.array(slopes).T


def _sigma(cell: CellReadings, name: str, stop: int, solution: Solution) -> float:
    """Standard uncertainty [m] of what the angles do to one reading, through each angle's own value."""
    rows, [slopes] = _alone(solution, lambda errors: angular_effect(cell, name, errors)[stop, :1])
    return float(np.sqrt(max(slopes @ solution.covariance[np.ix_(rows, rows)] @ slopes, 0.0)))
