"""What a measurement before and one after show: figures with U, decided against tolerances, held to a prediction.

Decision by ISO 14253-1: a figure conforms where it lies inside its tolerance by its U or more, does not conform where
it lies outside by more than its U, and is undecided between.  U is of k = 2, of the largest deviation in the volume the
half width that covers 95 %.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from stepdiag_ros.compensate.approach import NONE, Reversal, sizes
from stepdiag_ros.compensate.compensation import K
from stepdiag_ros.compensate.document import Predicted
from stepdiag_ros.compensate.largest import largest
from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.body_diagonal import DiagonalTest
from stepdiag_ros.estimate.prediction import Prediction, deviation, predict
from stepdiag_ros.estimate.solution import Solution
from stepdiag_ros.model.description import Machine
from stepdiag_ros.model.machine import AXES, CURVES, SQUARENESS

VOLUMETRIC, DIAGONAL_E, DIAGONAL_B = 'volumetric', 'E', 'B'
CONFORMS, FAILS, UNDECIDED = 'conforms', 'does not conform', 'undecided'
MOST_KNOTS = 21
AGREES = 4.0
"""Combined standard uncertainties within which errors must agree with a prediction: of 160 values one in a hundred
machines has one beyond by chance."""


@dataclass(frozen=True)
class Figure:
    """One figure: name, unit (m or rad), values with U before and after (before None: unknown), tolerance, decision."""

    name: str
    unit: str
    before: float | None
    before_spread: float | None
    after: float
    after_spread: float
    tolerance: float | None = None
    along: tuple[tuple[float, float], ...] = ()
    """Of a curve: size and U at each of its positions, each of which is decided."""

    @property
    def decision(self) -> str:
        """One of :data:`CONFORMS`, :data:`FAILS`, :data:`UNDECIDED`; '' without a tolerance."""
        if self.tolerance is None:
            return ''
        return worst_of(decided(*one, self.tolerance) for one in self.along or ((self.after, self.after_spread),))


def worst_of(decisions: Iterable[str]) -> str:
    """One that does not conform, else one undecided, else conforms."""
    said = set(decisions)
    return next(word for word in (FAILS, UNDECIDED, CONFORMS) if word in said)


def decided(value: float, spread: float, tolerance: float) -> str:
    """ISO 14253-1: what a ``value`` with its U ``spread`` says of ``tolerance``, all non-negative."""
    if value + spread <= tolerance:
        return CONFORMS
    return FAILS if value - spread > tolerance else UNDECIDED


@dataclass(frozen=True)
class Agreement:
    """The measurement after against the prediction.

    ``volumetric``: measured less predicted largest deviation [m], with U; ``off``: errors that differ by more than
    :data:`AGREES` combined standard uncertainties, with how many.
    """

    volumetric: float
    spread: float
    off: Mapping[str, float]

    @property
    def agrees(self) -> bool:
        return abs(self.volumetric) <= self.spread and not self.off


@dataclass(frozen=True)
class Verified:
    """All figures, the decision over those with a tolerance, fields before and after at the same points,
    ``at`` (3,) [m] the place of the largest deviation after."""

    machine: Machine
    figures: tuple[Figure, ...]
    before: Prediction
    after: Prediction
    at: np.ndarray
    agreement: Agreement | None

    @property
    def decision(self) -> str:
        """The worst of all decisions: one that does not conform, else one undecided, else conforms."""
        return worst_of(figure.decision for figure in self.figures if figure.decision)

    def to_json_dict(self) -> dict[str, Any]:
        agreement = None if self.agreement is None else {
            'as_predicted': self.agreement.agrees, 'volumetric_difference_m': self.agreement.volumetric,
            'U_m': self.agreement.spread, 'errors_off': dict(self.agreement.off)}
        return {'decision': self.decision, 'machine': self.machine.name,
                'rule': 'ISO 14253-1; U with k = 2, of the volumetric error 95 %',
                'figures': [{'name': f.name, 'unit': f.unit, 'before': f.before, 'U_before': f.before_spread,
                             'after': f.after, 'U_after': f.after_spread, 'tolerance': f.tolerance,
                             'decision': f.decision or None} for f in self.figures],
                'largest_at_m': [float(v) for v in self.at],
                'prediction': agreement}


def verified(before: Solution, after: Solution, machine: Machine, tolerances: Mapping[str, float],
             diagonals: tuple[DiagonalTest | None, DiagonalTest | None] = (None, None),
             predicted: Predicted | None = None, reversals: tuple[Reversal, Reversal] = (NONE, NONE)) -> Verified:
    """Compare two evaluations of ``machine``.

    ``tolerances`` by figure: ``volumetric``, ``E``, ``B`` [m], or an error's name [m or rad].  ``diagonals``: ISO 230-6
    before and after, with the uncertainty of the whole budget.  ``reversals``: lost motion of the axes before and
    after, which the volumetric error counts from the worst side.  :class:`StepdiagError` for a tolerance of a figure
    that the logs do not give.
    """
    tool = np.asarray(machine.tool) if predicted is None else predicted.tool
    points = _points(after, machine)
    fields = [predict(solution, machine, points, tool) for solution in (before, after)]
    whole = [largest(solution, machine, tool, field, lost)
             for solution, field, lost in zip((before, after), fields, reversals, strict=True)]
    rows = [(VOLUMETRIC, 'm', *whole[0][:2], *whole[1][:2])]
    rows += _diagonal_rows(diagonals)
    for name in (*CURVES, *SQUARENESS):
        if after.has(name):
            known = _size(before, name) if before.has(name) else (None, None)
            rows.append((name, 'm' if name[1] in AXES else 'rad', *known, *_size(after, name)))
    figures = tuple(Figure(*row, tolerances.get(row[0]), _along(after, row[0])) for row in rows)
    missing = [name for name in tolerances if name not in {figure.name for figure in figures}]
    if missing:
        raise StepdiagError(f'--tolerance {missing[0]}: the log after does not give it; it gives '
                            f'{", ".join(figure.name for figure in figures)}')
    agreement = None if predicted is None else _agreement(after, fields[1], whole[1], machine, predicted)
    return Verified(machine, figures, *fields, whole[1][2], agreement)


def _points(solution: Solution, machine: Machine) -> np.ndarray:
    """All knots of the volume, corners included (n, 3) [m]; an axis that was not measured stands at 0."""
    axes = []
    for axis in range(3):
        names = [f'E{m}{AXES[axis]}' for m in 'XYZABC' if solution.has(f'E{m}{AXES[axis]}')]
        knots = np.asarray(solution.positions[names[0]], float) if names else np.zeros(1)
        axes.append(knots if len(knots) <= MOST_KNOTS else np.linspace(knots[0], knots[-1], MOST_KNOTS))
    return np.stack(np.meshgrid(*axes, indexing='ij'), axis=-1).reshape(-1, 3)


def _size(solution: Solution, name: str) -> tuple[float, float]:
    """Largest absolute value of an error and U there."""
    if name in SQUARENESS:
        value, sigma = solution.squareness(name)
        return abs(value), K * sigma
    _, value, sigma = solution.curve(name)
    row = int(np.argmax(np.abs(value)))
    return float(abs(value[row])), K * float(sigma[row] or sigma.max())


def _along(solution: Solution, name: str) -> tuple[tuple[float, float], ...]:
    """Size and U of a curve at each of its positions; nothing of what is none."""
    if name not in CURVES:
        return ()
    _, value, sigma = solution.curve(name)
    return tuple((float(abs(v)), K * float(s)) for v, s in zip(value, sigma, strict=True))


def _diagonal_rows(tests: tuple[DiagonalTest | None, DiagonalTest | None]) -> list[tuple]:
    """E and B of ISO 230-6 before and after, with U of the whole budget."""
    first, second = tests
    if second is None:
        return []
    rows = []
    for name, worst in ((DIAGONAL_E, 'Ed'), (DIAGONAL_B, 'Bd')):
        known = [(None, None) if test is None or worst not in test.figures() else
                 (test.figures()[worst], K * test.sigma_m[worst]) for test in (first, second)]
        if known[1][0] is not None:
            rows.append((name, 'm', *known[0], *known[1]))
    return rows


def _agreement(after: Solution, field: Prediction, figure: tuple[float, float, np.ndarray], machine: Machine,
               predicted: Predicted) -> Agreement:
    """Measured against predicted: the largest deviation at the same places, and every error at its positions."""
    expected = deviation(predicted.errors, machine, field.points, predicted.tool)
    size, spread, _ = figure
    difference = size - float(np.max(sizes(expected, predicted.reversal)))
    off = {}
    for name, sigma in predicted.sigma.items():
        if not after.has(name):
            continue
        if name in SQUARENESS:
            value, own = after.squareness(name)
            apart, total = np.array([value - predicted.errors.square[name]]), np.hypot(own, sigma)
        else:
            position, values, own = after.curve(name)
            curve = predicted.errors.curves[name]
            apart, total = values - curve(position), np.hypot(own, np.interp(position, curve.position, sigma))
        score = float(np.max(np.abs(apart)[total > 0.0] / total[total > 0.0], initial=0.0))
        if score > AGREES:
            off[name] = score
    return Agreement(difference, float(np.hypot(spread, predicted.spread_m)), off)
