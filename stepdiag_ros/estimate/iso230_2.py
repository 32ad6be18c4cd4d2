"""Positioning accuracy of one linear axis, ISO 230-2: A, E, R, B and M.

At each of m targets P_i the deviation ``x_ij = measured − target`` is read n times
from each side.  With means x̄_i↑, x̄_i↓ and standard deviations s_i↑, s_i↓ (n − 1)

    B_i = x̄_i↑ − x̄_i↓                      B = max |B_i|
    x̄_i = (x̄_i↑ + x̄_i↓)/2                  M = max x̄_i − min x̄_i
    R_i↑ = 4 s_i↑,  R_i↓ = 4 s_i↓           R↑ = max R_i↑,  R↓ = max R_i↓
    R_i = max(2 s_i↑ + 2 s_i↓ + |B_i|, R_i↑, R_i↓)     R = max R_i
    E = max(x̄_i↑, x̄_i↓) − min(x̄_i↑, x̄_i↓)
    A = max(x̄_i↑ + 2 s_i↑, x̄_i↓ + 2 s_i↓) − min(x̄_i↑ − 2 s_i↑, x̄_i↓ − 2 s_i↓)

and E↑, E↓, A↑, A↓ the same for one direction alone.

Assumes: the reference measures along the axis and its own scale is right; where it
is not (a reference of unknown scale and zero), :func:`deviations` fits both, and
then M, E and A say nothing of the axis's scale.  Cannot see: straightness, angles
and squareness; angles only through the Abbe offset of the measured line.  A drift
during the cycles goes into s, and with it into R and A, not into E, B and M.

Where every cycle counts from a zero of its own, as after a reset at its first target, the error of the arrival there is
in all its readings, and s would be up to √2 too large everywhere but at that target, where it would be zero.  The
cycles are then shifted to agree on average; what the shift takes of the scatter of its N arrivals is made good,

    s² ← s² N/(N − 1)

which is right for arrivals that err independently.  Means, B, E and M do not depend on the shift.

Source: ISO 230-2 (2014), clause 3 and annexes; written from its definitions.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stepdiag_ros.errors import StepdiagError
from stepdiag_ros.estimate.iso_rules import shortfalls
from stepdiag_ros.estimate.readings import CellReadings
from stepdiag_ros.estimate.traceability import Traceability
from stepdiag_ros.model.description import Machine


@dataclass(frozen=True)
class AxisResult:
    """ISO 230-2 of one axis.  All arrays (m,) by target, all lengths [m].

    ``E``, ``A`` and ``R`` are bidirectional; ``*_up``, ``*_down`` unidirectional.  R and A are
    None with a single run a direction: a standard deviation needs two.  ``letter`` of the axis, where it is known.
    """

    target_m: np.ndarray
    mean_up: np.ndarray
    mean_down: np.ndarray
    s_up: np.ndarray | None
    s_down: np.ndarray | None
    runs: int
    letter: str = ''

    @property
    def reversal(self) -> np.ndarray:
        return self.mean_up - self.mean_down

    @property
    def B(self) -> float:
        return float(np.max(np.abs(self.reversal)))

    @property
    def mean_reversal(self) -> float:
        return float(np.mean(self.reversal))

    @property
    def M(self) -> float:
        return float(np.ptp((self.mean_up + self.mean_down) / 2.0))

    @property
    def E(self) -> float:
        return float(np.ptp([self.mean_up, self.mean_down]))

    @property
    def E_up(self) -> float:
        return float(np.ptp(self.mean_up))

    @property
    def E_down(self) -> float:
        return float(np.ptp(self.mean_down))

    def _spread(self, means: list, deviations: list) -> float | None:
        if self.s_up is None:
            return None
        means, two = np.array(means), 2.0 * np.array(deviations)
        return float(np.max(means + two) - np.min(means - two))

    @property
    def A(self) -> float | None:
        return self._spread([self.mean_up, self.mean_down], [self.s_up, self.s_down])

    @property
    def A_up(self) -> float | None:
        return self._spread([self.mean_up], [self.s_up])

    @property
    def A_down(self) -> float | None:
        return self._spread([self.mean_down], [self.s_down])

    @property
    def R_up(self) -> float | None:
        return None if self.s_up is None else float(np.max(4.0 * self.s_up))

    @property
    def R_down(self) -> float | None:
        return None if self.s_down is None else float(np.max(4.0 * self.s_down))

    @property
    def R(self) -> float | None:
        if self.s_up is None:
            return None
        both = 2.0 * self.s_up + 2.0 * self.s_down + np.abs(self.reversal)
        return float(np.max([both, 4.0 * self.s_up, 4.0 * self.s_down]))

    def to_json_dict(self) -> dict[str, Any]:
        names = ('A', 'A_up', 'A_down', 'E', 'E_up', 'E_down', 'R', 'R_up', 'R_down', 'B',
                 'mean_reversal', 'M')
        return {**{f'{name}_m': getattr(self, name) for name in names}, 'runs': self.runs,
                'target_m': [float(v) for v in self.target_m],
                'mean_up_m': [float(v) for v in self.mean_up],
                'mean_down_m': [float(v) for v in self.mean_down]}


@dataclass(frozen=True)
class LinearTest:
    """ISO 230-2 of every axis that a log holds a linear run of.

    ``sigma_m``: standard uncertainty [m] of each of :meth:`figures` by the whole budget, empty where not computed.
    ``wanted``: the figures of each axis, attributes of :class:`AxisResult`.  ``cautions``: what they rest on, a
    sentence each.
    """

    axes: dict[str, AxisResult]
    method: str = 'iso230_2'
    sigma_m: Mapping[str, float] = field(default_factory=dict)
    traceability: Traceability | None = None
    wanted: tuple[str, ...] = ('A', 'E', 'R', 'B', 'M')
    cautions: tuple[str, ...] = ()

    @property
    def remarks(self) -> tuple[str, ...]:
        """What the test falls short of, and its cautions, a sentence each."""
        return (*(text for name, axis in self.axes.items() for text in shortfalls(name, axis.target_m, axis.runs)),
                *self.cautions)

    def letter(self, name: str) -> str:
        """X, Y or Z: what the line ``name`` measures."""
        return self.axes[name].letter or name[-1].upper()

    def figures(self) -> dict[str, float]:
        """The figures [m] of each axis by name, e.g. ``E lin_x``; without those that need more cycles."""
        named = {f'{figure} {name}': getattr(axis, figure) for name, axis in self.axes.items()
                 for figure in self.wanted}
        return {name: value for name, value in named.items() if value is not None}

    def repeat_sigma(self, cell: CellReadings) -> dict[str, float]:
        """Standard uncertainty [m] of the figures by repeats: of means, and in R and A of standard deviations, in
        those of one direction of that direction's."""
        found = {}
        for figure in self.figures():
            letter, name = figure.split()
            axis = self.axes[name]
            mean = 2.0 * float(cell.setups[name].displacement_sigma_m.max())
            spread = 0.0
            if letter[0] in 'AR':
                scatter = {'up': [axis.s_up], 'down': [axis.s_down]}.get(letter[2:], [axis.s_up, axis.s_down])
                spread = 4.0 * float(np.max(scatter)) / np.sqrt(2.0 * (axis.runs - 1))
            found[figure] = float(np.hypot(mean, spread))
        return found

    def slope_sigma(self, slopes: Mapping[str, np.ndarray], machine: Machine) -> dict[str, float]:
        """What uncertain slopes (k,) [1] of EXX, EYY, EZZ do to A, E and M [m], of one direction too."""
        found = {}
        for figure in self.figures():
            letter, name = figure.split()
            slope = np.linalg.norm(slopes.get(f'E{self.letter(name) * 2}', 0.0))
            if letter[0] in 'AEM':
                found[figure] = float(slope * np.ptp(self.axes[name].target_m))
        return found

    def text(self) -> str:
        """For people, µm; R and A need two cycles."""
        figures = ('A', 'E', 'R', 'B', 'M')
        lines = [f'{self.method}: ISO 230-2 [µm]', '',
                 f'{"":6} ' + ' '.join(f'{f:>9}' for f in figures) + '   cycles']
        for name, axis in self.axes.items():
            values = [getattr(axis, f) for f in figures]
            lines.append(f'{name:6} ' + ' '.join(f'{"–" if v is None else f"{1e6 * v:.3f}":>9}' for v in values)
                         + f'   {axis.runs}')
            if self.sigma_m:
                sigma = [self.sigma_m.get(f'{f} {name}') for f in figures]
                cells = ' '.join(f'{"–" if s is None else f"{2e6 * s:.3f}":>9}' for s in sigma)
                lines.append(f'U, k=2 {cells}   –')
        return '\n'.join(lines)

    @property
    def status(self) -> str:
        """``ok``, or that the lengths are no metres."""
        return 'ok' if self.traceability is None else self.traceability.status

    def to_json_dict(self) -> dict[str, Any]:
        tied = self.traceability
        return {'method': self.method, 'status': self.status, 'sigma_m': dict(self.sigma_m),
                'remarks': list(self.remarks), 'traceability': None if tied is None else tied.to_json_dict(),
                'axes': {name: result.to_json_dict() for name, result in self.axes.items()}}


def evaluate(target_m: np.ndarray, up_m: np.ndarray, down_m: np.ndarray, zeroed: bool = False) -> AxisResult:
    """One axis from ``target_m`` (m,) and deviations ``up_m``, ``down_m`` (runs, m) [m].

    ``zeroed``: each cycle counts from a zero of its own, and begins its way down where its way up ended,
    at the last target.
    """
    target = np.asarray(target_m, float)
    up, down = (np.atleast_2d(np.asarray(v, float)) for v in (up_m, down_m))
    for name, runs in (('up', up), ('down', down)):
        if runs.shape[1] != target.size:
            raise StepdiagError(f'iso230_2: the {name} runs have {runs.shape[1]} targets, expected '
                                f'{target.size}; give one deviation per target')
        if not np.isfinite(runs).all():
            raise StepdiagError(f'iso230_2: a deviation of the {name} runs is not a number; '
                                'leave incomplete cycles out')
    if len(up) != len(down):
        raise StepdiagError(f'iso230_2: {len(up)} runs up but {len(down)} down; '
                            'give as many of either')
    several, made_good = len(up) > 1, 1.0
    if several and zeroed:
        arrivals = np.concatenate([up, down[:, :-1]], axis=1)
        shift = arrivals.mean(axis=1, keepdims=True)
        up, down = up - shift + shift.mean(), down - shift + shift.mean()
        made_good = np.sqrt(arrivals.shape[1] / (arrivals.shape[1] - 1))
    return AxisResult(target, up.mean(0), down.mean(0),
                      made_good * up.std(0, ddof=1) if several else None,
                      made_good * down.std(0, ddof=1) if several else None, len(up))


def from_rows(cycle: np.ndarray, direction: np.ndarray, target_m: np.ndarray,
              measured_m: np.ndarray, fit_reference: bool = False) -> AxisResult:
    """One axis from a table of single readings, all (k,); direction +1 or −1.

    ``fit_reference`` takes out scale and zero of the reference by one straight line through
    all readings (needed where both are arbitrary, as with a triangulation sensor).
    """
    cycle, direction = np.asarray(cycle), np.asarray(direction)
    target, measured = np.asarray(target_m, float), np.asarray(measured_m, float)
    deviation = deviations(target, measured) if fit_reference else measured - target
    targets, place = np.unique(target, return_inverse=True)
    runs = []
    for sign in (1, -1):
        mine = direction == sign
        cycles, row = np.unique(cycle[mine], return_inverse=True)
        table = np.full((len(cycles), len(targets)), np.nan)
        table[row, place[mine]] = deviation[mine]
        complete = np.isfinite(table).all(axis=1)
        if not complete.any():
            raise StepdiagError(f'iso230_2: no complete cycle in direction {sign:+d}; a '
                                'bidirectional test visits every target from both sides')
        runs.append(table[complete])
    shared = min(len(r) for r in runs)
    return evaluate(targets, runs[0][:shared], runs[1][:shared])


def deviations(target_m: np.ndarray, measured_m: np.ndarray) -> np.ndarray:
    """Deviations in the axis's own unit of length: (a + b·measured) − target by least squares.

    The axis is taken as right on average, the reference gets the scale ``b`` and zero ``a``.
    """
    target, measured = np.asarray(target_m, float), np.asarray(measured_m, float)
    slope, zero = np.polyfit(target, measured, 1)
    return (measured - zero) / slope - target
