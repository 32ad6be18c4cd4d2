"""Results of several methods beside a known machine, error by error.

The truth and every solution are brought to the same reference lines first
(:mod:`~stepdiag_ros.estimate.gauge`); a curve's deviation is the largest at the plan's
positions.  Methods that give figures of merit instead of errors are set beside the same
figures computed for the known machine.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.body_diagonal import DiagonalTest, diagonal
from stepdiag_ros.estimate.gauge import to_reference_lines
from stepdiag_ros.estimate.iso230_2 import LinearTest
from stepdiag_ros.estimate.readings import observe, sight_of
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.model.description import Description
from stepdiag_ros.model.machine import AXES, CURVES, SQUARENESS, Curve, GeometricErrors
from stepdiag_ros.model.path import plan_positions

GROUPS = {
    'positioning': tuple(f'E{a}{a}' for a in AXES),
    'straightness': tuple(n for n in CURVES if n[1] in 'XYZ' and n[1] != n[2]),
    'angles': tuple(n for n in CURVES if n[1] in 'ABC'),
    'squareness': SQUARENESS,
}


@dataclass(frozen=True)
class Comparison:
    """Deviations from the reference: method → error name → largest deviation [m or rad].

    ``within_k2``: method → share of the values that agree with the reference within two standard
    deviations (of values that have one); None where no value has one.  ``sigma``: method → error or figure → largest
    standard uncertainty by the whole budget [m or rad].
    """

    reference: str
    errors: GeometricErrors
    positions: Mapping[str, np.ndarray]
    deviation: Mapping[str, Mapping[str, float]]
    within_k2: Mapping[str, float | None]
    figures: Mapping[str, list[tuple[str, float, float]]]
    sigma: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def largest_sigma(self, method: str, group: str) -> float | None:
        """Largest standard uncertainty of a method in one of :data:`GROUPS`; None where it gives none."""
        found = [self.sigma[method][n] for n in GROUPS[group] if n in self.sigma.get(method, {})]
        return max(found) if found else None

    def worst(self, method: str, group: str) -> float | None:
        """Largest deviation of a method in one of :data:`GROUPS`; None where it gives none."""
        found = [self.deviation[method][n] for n in GROUPS[group] if n in self.deviation[method]]
        return max(found) if found else None


def truth_of(text: str, description: Description, log_name: str, source: str) -> GeometricErrors:
    """The known machine out of a truth file.

    Understood: the contract's answer (``errors`` with ``position_m`` and ``value``), or ``geometry``
    with lists at the plan's positions and ``square``, bare or below the log's name.
    """
    try:
        data = json.loads(text)
    except json.JSONDecodeError as error:
        raise StepdiagError(f'{source}: line {error.lineno}: not JSON: {error.msg}') from None
    except (ValueError, RecursionError) as error:     # a number of too many digits; brackets without end
        raise StepdiagError(f'{source}: not JSON: {str(error)[:80] or type(error).__name__}') from None
    if isinstance(data, dict) and log_name in data:
        data = data[log_name]
    if not isinstance(data, dict) or not ('errors' in data or 'geometry' in data):
        raise StepdiagError(f'{source}: neither "errors" nor "geometry" for log {log_name!r}; give the '
                            'answer of `stepdiag evaluate --json` or a truth.json that names the log')
    curves, square = {}, {}
    body = data.get('errors') or data.get('geometry')
    squares = body.get('square', body) if isinstance(body, dict) else None
    if not isinstance(squares, dict):
        raise StepdiagError(f'{source}: "errors" or "geometry" is no object; give each error by its name')
    for name in CURVES:
        if name in body:
            given = body[name]
            position = plan_positions(description, AXES.index(name[2]))
            if isinstance(given, dict):
                position, given = _numbers(given.get('position_m'), f'{source}: {name}.position_m'), given.get('value')
            value = _numbers(given, f'{source}: {name}')
            if value.shape != position.shape or value.ndim != 1:
                raise StepdiagError(f'{source}: {name} has {value.size} values, the plan '
                                    f'{position.size} positions')
            curves[name] = Curve(position, value)
    for name in SQUARENESS:
        if name in squares:
            given = squares[name]
            value = _numbers(given.get('value') if isinstance(given, dict) else given, f'{source}: {name}')
            if value.ndim:
                raise StepdiagError(f'{source}: {name} has {value.size} values; give one')
            square[name] = float(value)
    return GeometricErrors(curves, square)


def _numbers(given: Any, where: str) -> np.ndarray:
    """``given`` as an array; :class:`StepdiagError` where it holds anything but finite numbers."""
    try:
        value = np.array(given, float)
    except (TypeError, ValueError, OverflowError):
        value = np.array(np.nan)
    if not np.all(np.isfinite(value)):
        raise StepdiagError(f'{where}: {str(given)[:60]!r} where finite numbers belong')
    return value


def compare(results: Mapping[str, Any], reference: GeometricErrors, name: str,
            description: Description) -> Comparison:
    """Set results (name → Solution or figures of merit) beside a reference machine."""
    reference = to_reference_lines(reference)
    positions = {n: plan_positions(description, AXES.index(n[2])) for n in CURVES}
    deviation, within, figures, uncertain = {}, {}, {}, {}
    for method, result in results.items():
        if not isinstance(result, Solution):
            figures[method] = _figures(result, reference, description)
            uncertain[method] = dict(getattr(result, 'sigma_m', {}))
            continue
        deviation[method], uncertain[method], hits = {}, {}, []
        for curve in CURVES:
            if result.has(curve):
                place, value, sigma = result.curve(curve)
                true = reference.curves.get(curve, Curve(np.zeros(1), np.zeros(1)))(place)
                deviation[method][curve] = float(np.max(np.abs(value - true)))
                uncertain[method][curve] = float(np.max(sigma))
                hits += list(np.abs(value - true)[sigma > 0] <= 2.0 * sigma[sigma > 0])
        for square in SQUARENESS:
            if result.has(square):
                value, sigma = result.squareness(square)
                off = abs(value - reference.square.get(square, 0.0))
                deviation[method][square], uncertain[method][square] = off, sigma
                hits += [off <= 2.0 * sigma] if sigma > 0 else []
        within[method] = float(np.mean(hits)) if hits else None
    return Comparison(name, reference, positions, deviation, within, figures, uncertain)


def _figures(result: Any, reference: GeometricErrors,
             description: Description) -> list[tuple[str, float, float]]:
    """(name, measured, of the reference) of a result that has figures of merit, [m]."""
    rows = []
    if isinstance(result, DiagonalTest):
        for name, measured in result.diagonals.items():
            rows.append((f'E {name}', measured.E, diagonal(*read_by(reference, description, name)).E))
        rows.append(('Ed', result.Ed, max(r[2] for r in rows)))
        if result.Bd is not None:
            rows.append(('Bd', result.Bd, 0.0))
    if isinstance(result, LinearTest):
        for name, axis in result.axes.items():
            rows.append((f'E {name}', axis.E, float(np.ptp(read_by(reference, description, name)[1]))))
            rows.append((f'B {name}', axis.B, 0.0))
    return rows


def read_by(errors: GeometricErrors, description: Description, name: str) -> tuple[np.ndarray, np.ndarray]:
    """What a well aligned setup reads of a known machine where it stands on its line: positions along the line and
    deviations (n,) [m], rotations over the levers of tool and beam included."""
    sight = sight_of(description, name)
    along = (sight.positions - sight.positions[0]) @ sight.direction
    beside = np.linalg.norm(sight.positions - sight.positions[0] - along[:, None] * sight.direction, axis=1)
    on_line = beside < 1e-9 + 1e-9 * along[-1]
    length = observe(sight, description.machine, errors)[0][:, 0]
    return along[on_line], (length - length[0] - along)[on_line]


def _doubled(sigma: float | None) -> float | None:
    return None if sigma is None else 2.0 * sigma


def _expanded(sigma: float | None) -> str:
    return '–' if sigma is None else f'{2e6 * sigma:.3f}'


def text_table(comparison: Comparison, details: bool = True) -> str:
    """The comparison as a table for the terminal, µm and µrad."""
    # The reference beside itself would be a column of zeros.
    methods = [m for m in comparison.deviation if m != comparison.reference]
    width = max([14, *map(len, methods)])
    lines = [f'Largest deviation from {comparison.reference}, µm and µrad '
             '(all in the reference lines of ISO 230-1)',
             ' ' * 13 + ''.join(f'{m:>{width + 2}}' for m in methods)]

    def row(label: str, values: list[float | None]) -> str:
        cells = [('–' if v is None else f'{v * 1e6:.3f}' if v < 1e-3 else f'{v * 1e6:.0f}')
                 for v in values]
        return f'{label:<13}' + ''.join(f'{c:>{width + 2}}' for c in cells)

    if not methods:
        lines = [f'No other method than {comparison.reference} gives errors on this log.']
    for group in GROUPS if methods else ():
        lines.append(row(group, [comparison.worst(m, group) for m in methods]))
        lines.append(row('  U (k = 2)', [_doubled(comparison.largest_sigma(m, group)) for m in methods]))
    shares = [comparison.within_k2[m] for m in methods]
    if methods:
        lines.append(f'{"within k = 2":<13}' + ''.join(
            f'{"–" if s is None else f"{100 * s:.0f} %":>{width + 2}}' for s in shares))
    if details:
        lines.append('')
        for name in (*CURVES, *SQUARENESS):
            values = [comparison.deviation[m].get(name) for m in methods]
            if any(v is not None for v in values):
                lines.append(row(name, values))
    for method, rows in comparison.figures.items():
        lines += ['', f'{method}: µm', f'{"":<13}{"measured":>12}{"U (k = 2)":>12}{comparison.reference:>14}']
        own = comparison.sigma.get(method, {})
        lines += [f'{n:<13}{a * 1e6:>12.3f}{_expanded(own.get(n)):>12}{b * 1e6:>14.3f}' for n, a, b in rows]
    return '\n'.join(lines)
